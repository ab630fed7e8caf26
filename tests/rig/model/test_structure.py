"""A modal basis as data: the same as the beam it came from, and a sentence for each basis that cannot be."""

import msgspec
import numpy as np
import pytest

from rig.effects import effect_named
from rig.errors import RigError
from rig.lab.importing import import_file
from rig.model.beam import Beam
from rig.model.description import (
    BaseMotion,
    PointMass,
    PointSpring,
    Sensor,
    Station,
    check_shapes_known,
    from_json,
    to_json,
)
from rig.model.modes import CoupledModes, modes_of, participation
from rig.model.structure import ShapeRow, Structure, structure_of
from rig.recording import channel_groups, read, writing
from rig.simulation.motion import concatenated
from rig.simulation.plants import ancf, modal
from rig.simulation.reference import BarrelCradle, Sdof

MACHINE = BarrelCradle(stations=4, noise_density=1e-3).rig()
FINELY = np.linspace(0, 1, 801)
BASIS = msgspec.json.encode(
    {
        "type": "structure",
        "name": "fin",
        "length_m": 0.5,
        "frequencies_hz": [0, 40.5],
        "damping_ratios": [0, 0.02],
        "shapes": [{"position_m": 0, "values": [0.7, 1]}, {"position_m": 0.2, "values": [0.7, -0.8]}],
    }
)


def basis_of(beam, modes=24, positions_m=FINELY):
    return structure_of(
        beam.name,
        beam.length_m,
        beam.frequencies_hz(modes),
        beam.damping_ratios(modes),
        positions_m,
        beam.shapes(positions_m, modes),
    )


def as_data(machine, **how):
    bodies = tuple(basis_of(b, **how) if isinstance(b, Beam) else b for b in machine.bodies)
    return msgspec.structs.replace(machine, bodies=bodies)


def test_a_basis_is_read_from_json_and_written_again():
    text = to_json(MACHINE).replace(b'"barrel"', b'"fin"')
    fin = msgspec.json.decode(BASIS, type=Structure)
    assert fin.natural_hz == (0.0, 40.5)
    assert fin.rows[1] == ShapeRow(0.2, (0.7, -0.8))
    machine = from_json(text, "text")
    machine = msgspec.structs.replace(machine, bodies=(machine.bodies[0], basis_of(machine.bodies[1])))
    assert from_json(to_json(machine), "text") == machine


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (b'"damping_ratios":[0,0.02]', b'"damping_ratios":[0.02]', "there are 1 damping_ratios for 2 frequencies_hz"),
        (b"[0,40.5]", b"[40.5,0]", "frequencies_hz do not ascend; sort the modes"),
        (b"40.5", b"-40.5", "a frequency is -40.5 Hz; give"),
        (b'"frequencies_hz":[0,40.5]', b'"frequencies_hz":[]', "frequencies_hz is empty; give"),
        (b"0.02", b"-0.5", "a damping ratio is -0.5; give"),
        (b"[0.7,-0.8]", b"[0.7]", "there are 1 shape values at 0.2 m for 2 modes; give one each"),
        (b'"position_m":0.2', b'"position_m":0', "the positions of shapes do not ascend; sort them"),
        (b'"position_m":0.2', b'"position_m":0.6', "shapes are given at 0.6 m; give places from 0 to 0.5 m"),
        (b'"length_m":0.5', b'"length_m":0', "length_m is 0.0; give a finite value above zero"),
        (b'"frequencies_hz"', b'"frequencies"', "has no field 'frequencies' (did you mean 'frequencies_hz'?)"),
        (b"-0.8", b"1e300", "bodies[0].shapes[1].values[1] is about 1e300, which nothing is; correct it"),
        (b"40.5", b"1e300", "bodies[0].frequencies_hz[1] is about 1e300, which nothing is; correct it"),
        (b"-0.8", b"NaN", "invalid character"),
        (b"-0.8", b"null", "shapes[1].values[1] is null; give a number"),
    ],
)
def test_a_basis_that_cannot_be_is_refused_in_one_sentence(old, new, sentence):
    assert old in BASIS
    empty = b'{"name":"r","bodies":[%s],"contacts":[],"force_at":{"body":"fin"},"sensors":[],"sample_rate_hz":100}'
    assert from_json(empty % BASIS, "rig.json").body("fin").max_modes == 2
    with pytest.raises(RigError) as caught:
        from_json(empty % BASIS.replace(old, new, 1), "rig.json")
    assert str(caught.value).startswith("rig.json: ")
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(bad):
    fin = msgspec.json.decode(BASIS, type=Structure)
    for changes, sentence in (
        ({"rows": (ShapeRow(0.0, (bad, 1.0)),)}, f"a shape value at 0.0 m is {bad}"),
        ({"rows": (ShapeRow(bad, (1.0, 1.0)),)}, f"shapes are given at {bad} m"),
        ({"natural_hz": (0.0, bad)}, f"a frequency is {bad} Hz"),
        ({"ratios": (0.0, bad)}, f"a damping ratio is {bad}"),
        ({"length_m": bad}, f"length_m is {bad}"),
    ):
        with pytest.raises(RigError, match=f"structure 'fin': {sentence}"):
            msgspec.structs.replace(fin, **changes)
    with pytest.raises(RigError, match="shapes is empty; give the shapes at the contacts"):
        msgspec.structs.replace(fin, rows=())
    with pytest.raises(RigError, match="3 modes asked for; its modal basis has 1 to 2"):
        fin.shapes(np.zeros(1), 3)


def test_what_is_measured_must_stand_where_shapes_are_given():
    sensor = Sensor(name="s", station=Station("barrel", 0.3333), quantity="acceleration")
    for changes, label in (
        ({"sensors": (sensor,)}, "sensor 's'"),
        ({"force_at": sensor.station}, "the force"),
        ({"contacts": (msgspec.structs.replace(MACHINE.contacts[0], at=sensor.station),)}, "contact 'contact_1'"),
    ):
        machine = as_data(msgspec.structs.replace(MACHINE, **changes))
        with pytest.raises(RigError, match=f"rig.json: {label} stands at 0.3333 m of 'barrel', where its modal basis"):
            check_shapes_known(machine, "rig.json")
    check_shapes_known(as_data(MACHINE), "rig.json")


@pytest.mark.parametrize("body", MACHINE.bodies, ids=lambda b: b.name)
def test_shapes_are_exact_where_given_and_near_between(body):
    basis = basis_of(body, modes=8, positions_m=np.linspace(0, 1, 41))
    np.testing.assert_array_equal(basis.shapes(basis.positions_m[::-1], 8), body.shapes(basis.positions_m[::-1], 8))
    between = (basis.positions_m[1:] + basis.positions_m[:-1]) / 2
    scale = np.abs(body.shapes(between, 8)).max()
    np.testing.assert_allclose(basis.shapes(between, 8), body.shapes(between, 8), atol=2e-3 * scale)
    step = 1e-4
    slopes = (body.shapes(between + step, 8) - body.shapes(between - step, 8)) / (2 * step)
    np.testing.assert_allclose(basis.shapes(between, 8, order=1), slopes, atol=5e-3 * np.abs(slopes).max())


def test_beyond_the_given_places_a_shape_goes_straight_on():
    free = MACHINE.body("barrel")
    basis = basis_of(free, modes=2, positions_m=np.linspace(0.2, 0.7, 6))  # a rigid body's shapes are straight
    np.testing.assert_allclose(basis.shapes(np.array([0.0, 1.0]), 2), free.shapes(np.array([0.0, 1.0]), 2))
    single = basis_of(free, modes=2, positions_m=np.array([0.5]))
    np.testing.assert_allclose(single.shapes(np.array([0.1, 0.9]), 2), free.shapes(np.array([0.5, 0.5]), 2))


def test_attachments_change_the_modes_as_they_change_those_of_the_beam():
    station = Station("barrel", 0.55)
    attached = {
        "masses": (PointMass(station=Station("barrel", 1.0), mass_kg=0.3),),
        "springs": (PointSpring(station=station, stiffness_n_per_m=2e4, rotational_n_m_per_rad=30.0),),
    }
    beam, basis = (
        modes_of(m, m.body("barrel"))
        for m in (msgspec.structs.replace(x, **attached) for x in (MACHINE, as_data(MACHINE, modes=40)))
    )
    assert isinstance(basis, CoupledModes)
    # a rotational spring bends a truncated basis slowly: its moment makes the series of the slopes converge as 1/n
    np.testing.assert_allclose(basis.frequencies_hz(8), beam.frequencies_hz(8), rtol=2e-3)
    np.testing.assert_array_equal(basis.damping_ratios(8), beam.damping_ratios(8))
    shapes, exact = (np.abs(m.shapes(np.linspace(0, 1, 21), 5)) for m in (basis, beam))
    np.testing.assert_allclose(shapes, exact, atol=0.01 * exact.max())


def test_a_mass_leaves_a_free_structure_free():
    heavier = as_data(
        msgspec.structs.replace(MACHINE, masses=(PointMass(station=Station("barrel", 0.8), mass_kg=1.0),))
    )
    body = heavier.body("barrel")
    modes = modes_of(heavier, body)
    assert np.count_nonzero(modes.frequencies_hz(6) == 0) == 2
    mass_kg = MACHINE.body("barrel").mass_kg + 1.0
    assert np.sum(participation(heavier, body, modes, 24) ** 2) == pytest.approx(mass_kg)


def test_the_base_carries_a_free_structure_and_no_other():
    beam = MACHINE.body("barrel")
    free = basis_of(beam)
    expected = participation(MACHINE, beam, beam, 24)
    np.testing.assert_allclose(participation(MACHINE, free, free, 24), expected, atol=1e-9)
    moving = BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=1.0, high_hz=10.0)
    machine = msgspec.structs.replace(MACHINE, bodies=(MACHINE.body("cradle"), free), base_motion=moving)
    assert machine.base_motion == moving
    with pytest.raises(RigError, match="structure 'cradle': its modal basis does not say how its mass follows"):
        as_data(machine)
    data = as_data(MACHINE)
    with pytest.raises(RigError, match="there are 1 participations for 24 frequencies_hz; give one each, or none"):
        msgspec.structs.replace(data.body("cradle"), participations=(1.0,))


@pytest.mark.parametrize("name", ["youngs_modulus", "clamp_compliance", "contact_position"])
def test_effects_on_a_beam_are_refused(name):
    with pytest.raises(RigError, match=f"effect {name}: rig 'barrel_cradle' has no .*beam.*; choose another place"):
        effect_named(name).applied_to(as_data(MACHINE))


@pytest.mark.parametrize(
    "text", ["", "added_mass:mass_kg=0.2", "hardening_spring:body=cradle", "preload:body=cradle", "structural_damping"]
)
def test_the_plant_moves_a_basis_as_the_beam(text):
    """Both are approximate with an attachment: 80 elements, and 24 modes of the bare beam."""
    machine = effect_named(text).applied_to(MACHINE) if text else MACHINE
    basis_machine = effect_named(text).applied_to(as_data(MACHINE)) if text else as_data(MACHINE)
    force_n = np.concatenate([[0.0], np.random.default_rng(1).standard_normal(600)])
    beam, basis = (concatenated(modal.simulate(m, force_n, 2.0**-14, lambda _: None)) for m in (machine, basis_machine))
    scale = np.abs(beam.displacement_m).max()
    rough = 5e-3 if text.startswith("added_mass") else 1e-9
    np.testing.assert_allclose(basis.displacement_m, beam.displacement_m, atol=rough * scale)


def test_the_plant_takes_no_more_modes_than_there_are():
    machine = as_data(MACHINE, modes=6)
    signals = [
        concatenated(modal.simulate(machine, np.ones(50), 2.0**-14, lambda _: None, modes_per_beam=m)).sensed
        for m in (6, 16)
    ]
    np.testing.assert_array_equal(*signals)


def test_finite_elements_cannot_mesh_a_basis():
    with pytest.raises(RigError, match="the ancf plant meshes beams, and 'cradle' is a modal basis"):
        next(ancf.simulate(as_data(MACHINE), np.zeros(4), 2.0**-12, lambda _: None))


def test_a_recording_and_an_import_are_refused_where_a_row_is_missing(tmp_path):
    machine = as_data(MACHINE, modes=4, positions_m=np.linspace(0, 1, 5))  # none at the contact at 0.45 m
    path = tmp_path / "r.mcap"
    with writing(path, machine, channel_groups(machine), {}) as file:
        for group, channels in channel_groups(machine).items():
            file.append(group, np.zeros((len(channels.names), 2048)))
    (tmp_path / "rig.json").write_bytes(to_json(machine))
    (tmp_path / "map.toml").write_text('force = { column = 1, unit = "N" }\nsensors = {}\n')
    for use in (lambda: read(path), lambda: import_file(tmp_path / "run.csv", tmp_path / "map.toml", tmp_path / "o")):
        with pytest.raises(RigError, match=r"rig.json: sensor 'cradle_0450mm_\w+' stands at 0.45 m of 'cradle', where"):
            use()


@pytest.mark.parametrize("body", [*Sdof().rig().bodies, *MACHINE.bodies, *as_data(MACHINE).bodies], ids=type)
def test_a_heavier_body_keeps_its_frequencies(body):
    heavier = body.scale_mass(1.21)
    modes = min(6, body.max_modes)
    places_m = np.array([0.0, 0.3 * body.length_m])
    np.testing.assert_allclose(heavier.frequencies_hz(modes), body.frequencies_hz(modes))
    np.testing.assert_allclose(heavier.shapes(places_m, modes), body.shapes(places_m, modes) / 1.1)
