"""Modal analyses in UFF files, written by pyuff from known structures: the structures come back."""

import numpy as np
import pytest
import pyuff

from rig.errors import RigError
from rig.lab.modal import UffSelection, structure_from_uff
from rig.model.beam import Beam
from rig.model.structure import structure_of
from rig.model.tolerances import Tolerances

ARM = Beam(name="arm", ends="clamped-free", length_m=1.0, width_m=0.05, thickness_m=0.01, damping_ratio=0.01)
PLACES_M = np.linspace(0.1, 1.0, 10)
NODES = np.array([30, 7, 12, 1, 22, 5, 40, 3, 18, 9])  # in the order of the places
MODES = 5
HZ, SHAPES = ARM.frequencies_hz(MODES), ARM.shapes(PLACES_M, MODES)
LINES_HZ = np.arange(1, 2401) / 2
DIGITS = 2e-5  # of text with six digits


def nodes(length=1.0, axis=1, numbers=NODES):
    coordinates = np.zeros((3, len(NODES)))
    coordinates[axis] = (PLACES_M - 0.1) * length + 3.0
    return {"type": 15, "node_nums": numbers, **dict(zip("xyz", coordinates, strict=True))}


def units(length=1.0, force=1.0):
    return {
        "type": 164, "units_code": 9, "temp_mode": 1, "length": length, "force": force, "temp": 1.0, "temp_offset": 0.0,
    }  # fmt: skip


def shape(number, hz, values, modal_mass, axis=2, **changes):
    """A dataset 55; the nodes in the order of their numbers."""
    order = np.argsort(NODES)
    vectors = np.zeros((3, len(NODES)), dtype=np.asarray(values).dtype)
    vectors[axis] = np.asarray(values)[order]
    return {
        "type": 55, "analysis_type": 2, "data_ch": 2, "spec_data_type": 8, "load_case": 0, "mode_n": number,
        "freq": hz, "modal_m": modal_mass, "modal_damp_vis": 0.01, "modal_damp_his": 0.0, "node_nums": NODES[order],
        **dict(zip(("r1", "r2", "r3"), vectors, strict=True)), **changes,
    }  # fmt: skip


def normal_modes(**changes):
    masses = (0.5, 2.0, 7.0, 1.0, 30.0)
    return [
        shape(k, HZ[k], SHAPES[:, k] * np.sqrt(mass), mass, **changes) for k, mass in reversed(list(enumerate(masses)))
    ]


def frf(response, reference, order=2, noise=0.0, signs=(1, 1), hz=LINES_HZ, modes=12, **changes):
    """A dataset 58 from one place's number to another's; 12 modes, of which seven lie in the band."""
    omega, natural = 2 * np.pi * hz, 2 * np.pi * ARM.frequencies_hz(modes)[:, None]
    shapes = ARM.shapes(PLACES_M, modes)
    receptance = (shapes[response] * shapes[reference]) @ (1 / (natural**2 - omega**2 + 0.02j * natural * omega))
    values = receptance * (1j * omega) ** order * signs[0] * signs[1]
    rng = np.random.default_rng([response, reference])
    size = noise * np.sqrt(np.mean(np.abs(values) ** 2) / 2)
    return {
        "type": 58, "binary": 1, "id1": f"frf {response}", "func_type": 4,
        "rsp_node": int(NODES[response]), "rsp_dir": 3 * signs[0],
        "ref_node": int(NODES[reference]), "ref_dir": 3 * signs[1],
        "abscissa_spacing": 1, "abscissa_spec_data_type": 18,
        "ordinate_spec_data_type": (8, 11, 12)[order], "ordinate_axis_units_lab": ("m", "m/s", "m/s^2")[order],
        "orddenom_spec_data_type": 13, "orddenom_axis_units_lab": "N",
        "x": hz, "data": values + size * (rng.standard_normal(hz.size) + 1j * rng.standard_normal(hz.size)),
        **changes,
    }  # fmt: skip


def read(tmp_path, datasets, **choice):
    path = tmp_path / "arm.uff"
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(datasets, mode="add")
    return structure_from_uff(path, UffSelection(**choice))[:2]


def check_shapes(body, expected, error):
    shapes = body.shapes(body.positions_m, body.max_modes)
    signs = np.sign(np.sum(shapes * expected, axis=0))
    np.testing.assert_allclose(shapes * signs, expected, atol=error * np.abs(expected).max())


def test_mode_shapes_are_scaled_by_their_modal_mass(tmp_path):
    body, notes = read(tmp_path, [nodes(), *normal_modes()])
    assert (body.name, body.length_m) == ("arm", pytest.approx(0.9))
    np.testing.assert_allclose(body.positions_m, PLACES_M - 0.1, atol=DIGITS)
    np.testing.assert_allclose(body.natural_hz, HZ, rtol=DIGITS)
    np.testing.assert_allclose(body.ratios, 0.01, rtol=DIGITS)
    check_shapes(body, SHAPES, DIGITS)
    assert notes == ("5 modes in direction z, 10 nodes along y, from node 30 at 0 m to node 9 at 0.9 m, from arm.uff",)


def test_millimetres_and_tonnes_become_si(tmp_path):
    """A modal mass of 1 t (mm, N, t) is 1000 kg: at unit modal mass a shape is sqrt(1000) times larger."""
    modes = [shape(k, HZ[k], SHAPES[:, k] * np.sqrt(1000), 1.0) for k in range(MODES)]
    body, _ = read(tmp_path, [units(length=1000.0), nodes(length=1000.0), *modes])
    assert body.length_m == pytest.approx(0.9)
    check_shapes(body, SHAPES, DIGITS)


def test_complex_modes_are_scaled_by_their_modal_a(tmp_path):
    """The modal A of a normal mode with a real shape is 2 i w_d m; here the shapes have a phase."""
    datasets = []
    for k in range(MODES):
        pole = 2 * np.pi * HZ[k] * (-0.01 + 1j * np.sqrt(1 - 1e-4))
        turned = SHAPES[:, k] * np.exp(1j * (0.3 + k)) * 2.0
        modal_a = 2j * pole.imag * (2.0 * np.exp(1j * (0.3 + k))) ** 2
        datasets.append(
            shape(k, HZ[k], turned, 0.0, analysis_type=3, eig=pole, modal_a=modal_a, modal_b=-pole * modal_a)
        )
    body, _ = read(tmp_path, [nodes(), *datasets])
    np.testing.assert_allclose(body.natural_hz, HZ, rtol=DIGITS)
    np.testing.assert_allclose(body.ratios, 0.01, rtol=1e-4)
    check_shapes(body, SHAPES, 5 * DIGITS)
    datasets[0]["r3"] = datasets[0]["r3"] * np.exp(1j * np.linspace(0, 2, len(NODES)))
    with pytest.raises(RigError, match=r"of the mode at 8\.355\d* Hz is out of phase"):
        read(tmp_path, [nodes(), *datasets])


def test_rigid_body_modes_of_a_finite_element_model_and_modes_of_other_directions(tmp_path):
    free = Beam(name="free", ends="free-free", length_m=0.9, width_m=0.05, thickness_m=0.01)
    shapes, hz = free.shapes(PLACES_M - 0.1, 4), free.frequencies_hz(4)
    modes = [shape(k, hz[k] or 3e-4, shapes[:, k], 1.0) for k in range(4)]
    sideways = shape(9, 77.0, shapes[:, 3], 1.0, axis=0)
    body, notes = read(tmp_path, [nodes(), *modes, sideways])
    assert body.natural_hz[:2] == (0.0, 0.0)
    assert body.max_modes == 4
    assert np.sum(body.translation() ** 2) == pytest.approx(free.mass_kg, rel=1e-4)
    assert notes[1] == "1 modes without motion in direction z are left out"
    sideways_body, _ = read(tmp_path, [nodes(), *modes, sideways], direction="x")
    assert 77.0 in sideways_body.natural_hz


def test_places_can_be_told_and_nodes_chosen(tmp_path):
    chosen = {"nodes": (30, 12, 9), "positions_m": (0.1, 0.3, 1.0), "length_m": 1.2}
    body, _ = read(tmp_path, normal_modes(), **chosen)
    assert (body.positions_m.tolist(), body.length_m) == ([0.1, 0.3, 1.0], 1.2)
    check_shapes(body, SHAPES[[0, 2, 9]], DIGITS)
    for changes, said in (
        ({"nodes": (30, 99)}, "has no data at node 99"),
        ({"nodes": (30, 12)}, "has 2 nodes, and 3 positions_m are given"),
        ({"positions_m": ()}, r"has no coordinates of node 30 \(dataset 15\)"),
    ):
        with pytest.raises(RigError, match=said):
            read(tmp_path, normal_modes(), **(chosen | changes))


@pytest.mark.parametrize(("order", "roving", "noise"), [(0, "sensor", 0.0), (1, "hammer", 0.0), (2, "hammer", 0.01)])
def test_frfs_are_fitted(tmp_path, order, roving, noise):
    """Frequencies within 1e-4, damping ratios within 1 %, shapes within 1 % of the largest, at 1 % noise."""
    driving = 9
    points = [(k, driving) if roving == "sensor" else (driving, k) for k in range(10)]
    datasets = [frf(*pair, order, noise, signs=(1, -1)) for pair in points]
    body, notes = read(tmp_path, [nodes(), *datasets])
    mode_count = body.max_modes
    assert mode_count == 7  # up to 1200 Hz
    np.testing.assert_allclose(body.natural_hz, ARM.frequencies_hz(mode_count), rtol=1e-4)
    np.testing.assert_allclose(body.ratios, 0.01, rtol=0.01)
    check_shapes(body, ARM.shapes(PLACES_M, mode_count), 0.01)
    assert "driven at node 9" in notes[0]

    misfits = [note.split() for note in notes if note.startswith("misfit at node ")]
    said = {int(words[3][:-1]): words[9] for words in misfits}
    omega, natural = 2 * np.pi * LINES_HZ, 2 * np.pi * np.array(body.natural_hz)[:, None]
    shapes = body.shapes(body.positions_m, mode_count)
    for place, dataset in enumerate(datasets):
        modes = (shapes[place] * shapes[driving]) @ (
            1 / (natural**2 - omega**2 + 2j * np.array(body.ratios)[:, None] * natural * omega)
        )
        measured = -dataset["data"] * (1j * omega) ** (2 - order)
        error = np.sqrt(np.mean(np.abs(measured + omega**2 * modes) ** 2) / np.mean(np.abs(measured) ** 2))
        assert said[NODES[place]] == f"{error:.2%}"
    assert structure_from_uff(tmp_path / "arm.uff", UffSelection())[2] == Tolerances(
        unmodelled=float(f"{np.median([float(x[:-1]) for x in said.values()]) / 100:.2g}"), highest_hz=1200.0
    )


def test_the_misfit_of_frfswithout_keys_other_modes_is_their_noise(tmp_path):
    _, notes = read(tmp_path, [nodes(), *(frf(k, 9, noise=0.01, modes=7) for k in range(10))])
    said = [float(word[:-1]) for note in notes if note.startswith("misfit") for word in note.split() if "%" in word]
    np.testing.assert_allclose(said, 1.0, atol=0.05)
    assert len(said) == 20


def test_modes_in_a_band_alone(tmp_path):
    body, _ = read(tmp_path, [nodes(), *(frf(k, 9) for k in range(10))], band_hz=(20.0, 400.0))
    np.testing.assert_allclose(body.natural_hz, HZ[1:4], rtol=1e-4)


def test_frfs_in_other_units(tmp_path):
    in_g = [frf(k, 9) for k in range(10)]
    for dataset in in_g:
        dataset["data"] = dataset["data"] / 9.80665 * 4.4482216152605
        dataset |= {"ordinate_axis_units_lab": "g", "orddenom_axis_units_lab": "lbf"}
    body, _ = read(tmp_path, [nodes(), *in_g])
    check_shapes(body, ARM.shapes(PLACES_M, body.max_modes), 0.01)


def without_keys(dataset, *keys):
    return {key: value for key, value in dataset.items() if key not in keys}


FRFS = [frf(k, 9) for k in range(10)]


@pytest.mark.parametrize(
    ("datasets", "said"),
    [
        ([nodes()], "holds neither mode shapes (dataset 55) nor FRFs (dataset 58)"),
        ([nodes(), *(d | {"modal_m": 0.0} for d in normal_modes())], "states the modal mass 0 "),
        ([nodes(), *(d | {"modal_damp_vis": 1.5} for d in normal_modes())], "damping ratio 1.5"),
        ([nodes(), *(d | {"r3": d["r3"] * np.nan} for d in normal_modes())], "is not finite"),
        ([nodes(), *(d | {"r3": d["r3"] * 0} for d in normal_modes())], "are zero at the nodes"),
        ([nodes(length=0.0), *normal_modes()], "nodes 1 and 3 are at one place along x"),
        ([units(length=-1.0), nodes(), *normal_modes()], "its units (dataset 164) are no numbers above zero"),
        ([nodes(), *FRFS[:9]], "has no FRF of a driving point in direction z"),
        ([nodes(), *(d | {"func_type": 1, "data": d["data"].real} for d in FRFS)], "are no FRFs"),
        ([nodes(), *(d | {"ordinate_spec_data_type": 0} for d in FRFS)], "does not say that it is a displacement"),
        ([nodes(), *(d | {"ordinate_axis_units_lab": "furlong"} for d in FRFS)], "'furlong' is no unit"),
        ([nodes(), *FRFS[1:], frf(0, 9, hz=LINES_HZ + 1)], "has other frequencies than the first"),
        ([nodes(), *(d | {"data": -d["data"]} for d in FRFS)], "no mode stands out with a positive residue"),
        ([nodes(), *(d | {"data": 0 * d["data"]} for d in FRFS)], "an FRF is zero"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_sentence(tmp_path, datasets, said):
    with pytest.raises(RigError) as caught:
        read(tmp_path, datasets)
    assert str(caught.value).startswith(f"{tmp_path / 'arm.uff'}: ")
    assert said in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"t,F\n0,1\n", b"\x00\xff" * 100, "half", "short"])
def test_what_is_no_uff_file_is_refused(tmp_path, content, capfd):
    path = tmp_path / "arm.uff"
    if isinstance(content, str):
        read(tmp_path, [nodes(), *normal_modes()])
        complete = path.read_bytes()
        half = complete[: len(complete) * 2 // 3]
        last = b" 0.00000E+00\n    -1\n"  # of the last node
        content = (
            half[: half.rindex(b"\n") - 20] + b"\n    -1\n"
            if content == "half"
            else complete.replace(last, b"\n    -1\n", 1)
        )
        assert content != complete
    path.write_bytes(content)
    with pytest.raises(RigError, match=r"arm\.uff: ") as caught:
        structure_from_uff(path, UffSelection())
    assert "\n" not in str(caught.value)
    path.unlink()
    with pytest.raises(RigError, match="cannot be opened"):
        structure_from_uff(path, UffSelection())
    assert capfd.readouterr() == ("", "")


def test_a_structure_of_one_mode_with_the_same_frequency_twice_is_kept(tmp_path):
    body, _ = read(tmp_path, [nodes(), *(shape(k, 50.0, SHAPES[:, k], 1.0) for k in range(2))])
    named = [body.node_at(x) for x in body.positions_m]
    assert sorted(map(int, named)) == sorted(nodes()["node_nums"])
    shapes = body.shapes(body.positions_m, 2)
    assert body == structure_of(
        "arm", body.length_m, np.full(2, 50.0), np.full(2, 0.01), body.positions_m, shapes, named
    )


def windowed_frfs(window_s, ratio=0.004, places=range(10), driving=9):
    """FRFs of responses times exp(-t / window_s): receptances at a frequency that is complex by 1 / window_s."""
    s = 2j * np.pi * LINES_HZ + 1 / window_s
    natural, shapes = 2 * np.pi * ARM.frequencies_hz(12)[:, None], ARM.shapes(PLACES_M, 12)
    by_mode = 1 / (natural**2 + 2 * ratio * natural * s + s**2)
    return [frf(k, driving, order=0, data=np.asarray((shapes[k] * shapes[driving]) @ by_mode, complex)) for k in places]


@pytest.mark.parametrize("window_s", [0.3, 1.0])
def test_an_exponential_window_is_taken_off_the_damping(tmp_path, window_s):
    body, notes = read(tmp_path, [nodes(), *windowed_frfs(window_s)], exponential_window_s=window_s)
    np.testing.assert_allclose(body.natural_hz, ARM.frequencies_hz(body.max_modes), rtol=1e-3)
    np.testing.assert_allclose(body.ratios, 0.004, atol=4e-4)
    assert f"the window exp(-t / {window_s:g} s) is taken off the damping ratios" in notes


def test_damping_that_falls_as_a_window_leaves_it_is_asked_about(tmp_path):
    _, notes = read(tmp_path, [nodes(), *windowed_frfs(0.2)])
    (question,) = [note for note in notes if "1/frequency" in note]
    assert "a window of 0.2 s on the responses" in question
    assert "--exponential-window-s" in question
    _, notes = read(tmp_path, [nodes(), *(frf(k, 9) for k in range(10))])
    assert not [note for note in notes if "1/frequency" in note]


@pytest.mark.parametrize(("window_s", "words"), [(0.05, "0.05, which adds"), (0.0, "a finite time above zero")])
def test_a_window_that_leaves_no_damping_is_refused(tmp_path, window_s, words):
    with pytest.raises(RigError, match=words):
        read(tmp_path, [nodes(), *windowed_frfs(0.2)], exponential_window_s=window_s)
