"""The first rig.json and import map of a rig of one's own."""

import msgspec
import numpy as np
import pytest

from rig.errors import RigError
from rig.lab.starting import write_rig_and_map
from rig.lab.starting.analytic import BeamsRig, CantileverRig, MassRig
from rig.lab.starting.base import spread_positions
from rig.lab.starting.masses import ChainRig, TwoMassesRig
from rig.lab.starting.structure import StructureRig
from rig.model.beam import Beam
from rig.model.description import contact_stations, read_rig
from rig.model.structure import structure_of
from rig.simulation.reference import BarrelCradle, Sdof

CONTACT = {"clearance_m": 1e-3, "stiffness_n_per_m": 1e4, "sample_rate_hz": 512.0}
BEAMS = {
    **{f"{beam}_{field}": value for beam in ("cradle", "barrel") for field, value in
       (("length_m", 1.0), ("width_m", 0.05), ("thickness_m", 0.01))},
    "overlap_start_m": 0.45,
    "clearance_m": 5e-3,
    "stiffness_n_per_m": 1e5,
    "sample_rate_hz": 4096.0,
}  # fmt: skip
FIN = Beam(name="fin", ends="free-free", length_m=0.5, width_m=0.03, thickness_m=0.004)
PLACES_M = np.linspace(0, 0.5, 11)


def fin(first=0):
    count = 8
    return structure_of(
        "fin",
        0.5,
        FIN.frequencies_hz(count)[first:],
        FIN.damping_ratios(count)[first:],
        PLACES_M,
        FIN.shapes(PLACES_M, count)[:, first:],
    )


def structure_rig(tmp_path, body=None, **changes):
    path = tmp_path / "fin.json"
    path.write_bytes(msgspec.json.encode(body or fin()))
    return StructureRig(**({"body": path, "contacts_m": (0.1,), "force_m": 0.5} | CONTACT | changes))


def test_the_reference_rigs_come_from_their_numbers():
    mass = MassRig(mass_kg=1.0, frequency_hz=5.0, quantity=("displacement", "acceleration"), **CONTACT).rig()
    expected = Sdof().rig()
    assert (mass.bodies, mass.sensors, mass.force_at) == (expected.bodies, expected.sensors, expected.force_at)
    assert mass.contacts[0].law == expected.contacts[0].law

    expected = BarrelCradle(sensors="acceleration").rig()
    stations = {
        f"{beam}_stations_m": tuple(s.station.position_m for s in expected.sensors if s.station.body == beam)
        for beam in ("cradle", "barrel")
    }
    assert BeamsRig(name="barrel_cradle", **BEAMS, **stations).rig() == expected


def test_sensors_stand_at_every_contact_and_spread_over_the_rest():
    rig = BeamsRig(**BEAMS).rig()
    sensed = {s.station for s in rig.sensors}
    assert {s for c in rig.contacts for s in contact_stations(c)} <= sensed
    for beam in ("cradle", "barrel"):
        places = sorted(s.position_m for s in sensed if s.body == beam)
        assert len(places) == 6
        assert np.diff(places).min() > 0.1
    assert spread_positions([0.5], 1.0, among_m=[0.0, 0.5, 1.0]) == (0.0, 0.5, 1.0)


def test_places_that_do_not_meet_are_refused():
    for changes, said in (
        ({"overlap_start_m": 1.0}, "overlap_start_m is 1.0"),
        ({"contacts_m": (0.2, 0.9)}, "contacts_m has 0.2 m"),
        ({"cradle_width_m": -1.0}, "width_m is -1.0"),
    ):
        with pytest.raises(RigError, match=said):
            BeamsRig(**(BEAMS | changes)).rig()


def test_a_structure_takes_places_of_its_basis(tmp_path):
    rig = structure_rig(tmp_path, contacts_m=(0.1, 0.4004)).rig()
    assert [c.at.position_m for c in rig.contacts] == [PLACES_M[2], PLACES_M[8]]
    assert len(rig.sensors) == 6
    assert {PLACES_M[2], PLACES_M[8], 0.5} <= {s.station.position_m for s in rig.sensors}
    with pytest.raises(RigError, match=r"force_m has 0.42 m.* the nearest place that has is 0.4 m"):
        structure_rig(tmp_path, force_m=0.42).rig()


def test_rigid_body_modes_of_a_free_body_come_from_its_mass(tmp_path):
    """Against those of the beam itself: the same translation and rotation, mass-normalised."""
    inertia = FIN.mass_kg * FIN.length_m**2 / 12
    inertia_data = {"mass_kg": FIN.mass_kg, "centre_m": 0.25, "inertia_kg_m2": inertia}
    body, *_ = structure_rig(tmp_path, fin(first=2), **inertia_data).structure()
    assert body.natural_hz == fin().natural_hz
    np.testing.assert_allclose(body.shapes(PLACES_M, 8), fin().shapes(PLACES_M, 8), rtol=1e-12, atol=1e-12)
    for wrong, said in (
        ((fin(first=2), inertia_data | {"centre_m": None}), "give all three, or none"),
        ((fin(), inertia_data), "has 2 rigid-body modes already"),
        ((fin(first=2), inertia_data | {"mass_kg": -1.0}), "mass_kg is -1.0"),
    ):
        with pytest.raises(RigError, match=said):
            structure_rig(tmp_path, wrong[0], **wrong[1]).structure()


@pytest.mark.parametrize("content", [b"", b"{}", b"[1, 2]", b'{"type": "beam"}', b"\xff\xfe"])
def test_what_is_no_structure_is_said(tmp_path, content):
    start = structure_rig(tmp_path)
    start.body.write_bytes(content)
    with pytest.raises(RigError, match=r"fin\.json: is no structure"):
        start.rig()
    start.body.unlink()
    with pytest.raises(RigError, match=r"fin\.json: cannot be opened"):
        start.rig()


def test_the_written_rig_is_the_rig(tmp_path):
    start = structure_rig(tmp_path)
    rig = start.rig()
    rig_path, _ = write_rig_and_map(rig, start.map_text(rig), tmp_path / "new" / "lab")
    assert read_rig(rig_path) == rig
    assert sorted(p.name for p in rig_path.parent.iterdir()) == ["map.toml", "rig.json"]
    (tmp_path / "file").write_text("")
    with pytest.raises(RigError, match="cannot be made a folder"):
        write_rig_and_map(rig, start.map_text(rig), tmp_path / "file" / "lab")


def test_a_chain_has_the_frequencies_of_theory():
    """Equal masses, one end held: omega_j = 2 sqrt(k / m) sin((2 j - 1) pi / (4 n + 2)); free: 2 sqrt(k / m) sin(j pi /
    (2 n)) from j = 0."""
    count, mass_kg, spring = 4, 6.5, 2e5
    held = ChainRig(masses_kg=(mass_kg,) * count, springs_n_per_m=(spring,), **CONTACT).rig().bodies[0]
    free = ChainRig(masses_kg=(mass_kg,) * count, springs_n_per_m=(0.0, *[spring] * (count - 1)), **CONTACT).rig()
    scale, j = np.sqrt(spring / mass_kg) / np.pi, np.arange(count)
    np.testing.assert_allclose(held.natural_hz, scale * np.sin((2 * j + 1) * np.pi / (4 * count + 2)))
    np.testing.assert_allclose(free.bodies[0].natural_hz, scale * np.sin(j * np.pi / (2 * count)), atol=1e-9)
    assert np.sum(free.bodies[0].translation() ** 2) == pytest.approx(count * mass_kg)


def test_a_static_force_stretches_the_springs_of_a_chain():
    """The compliance at the last mass is that of the springs in series."""
    springs = (1e5, 2e5, 4e5)
    body = ChainRig(masses_kg=(1.0, 2.0, 3.0), springs_n_per_m=springs, **CONTACT).rig().bodies[0]
    shapes = body.shapes(np.array([3.0]), 3)[0]
    compliance = np.sum((shapes / (2 * np.pi * body.frequencies_hz(3))) ** 2)
    assert compliance == pytest.approx(sum(1 / k for k in springs))


def test_masses_meet_where_it_is_said():
    rig = ChainRig(masses_kg=(1.0, 1.0, 1.0), springs_n_per_m=(1e5,), contacts=("3-1", "2-0"), **CONTACT).rig()
    places = [(c.at.position_m, c.against.position_m if c.against else None) for c in rig.contacts]
    assert places == [(3.0, 1.0), (2.0, None)]
    assert rig.force_at.position_m == 3.0
    assert {s.station.position_m for s in rig.sensors} == {1.0, 2.0, 3.0}


def test_one_stop_alone_and_what_it_needs():
    start = TwoMassesRig(masses_kg=(1.0, 2.0), frequencies_hz=(6.0, 0.0), stops="upper", **CONTACT)
    rig, notes = start.rig_and_notes()
    assert rig.contacts[0].law.sides == (1,)
    assert "--quantity acceleration,displacement" in notes[0]
    assert msgspec.structs.replace(start, quantity=("acceleration", "displacement")).notes() == ()
    assert [b.damping_ratio for b in rig.bodies] == [0.01, 0.0]
    beam = CantileverRig(length_m=0.5, width_m=0.03, thickness_m=0.005, **CONTACT).rig()
    assert beam.contacts[0].law.sides == (-1, 1)
    assert beam.contacts[0].at.position_m == 0.5
    assert len(beam.sensors) == 6
