"""The modes that an exported UFF file holds come back as those of the bodies."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.errors import RigError
from rig.lab.exporting import export
from rig.lab.modal import UffSelection, structure_from_uff
from rig.lab.mode_shapes import MAX_MODES_PER_BEAM, node_number_by_station
from rig.model.description import PointMass, Station
from rig.model.modes import modes_of
from rig.model.structure import structure_of
from rig.recording import channel_groups, read, writing
from rig.simulation.reference import BarrelCradle, Sdof

DIGITS = 2e-5
"""Of text with six digits."""


@pytest.fixture
def exported(tmp_path):
    """The UFF file of a short recording of a rig."""

    def written(rig):
        groups = channel_groups(rig)
        with writing(tmp_path / "r.mcap", rig, groups, {}) as recording:
            for name, group in groups.items():
                recording.append(name, np.zeros((len(group.names), 64)))
        export(read(tmp_path / "r.mcap"), "uff", tmp_path / "r.uff", None)
        return tmp_path / "r.uff"

    return written


def check_modes(structure, modes, places_m, count):
    """Frequencies, damping ratios and, up to its sign, each shape."""
    assert structure.max_modes == count
    assert structure.frequencies_hz(count) == pytest.approx(modes.frequencies_hz(count), rel=DIGITS)
    ratios = np.where(modes.frequencies_hz(count) > 0, modes.damping_ratios(count), 0.0)
    assert structure.damping_ratios(count) == pytest.approx(ratios, rel=DIGITS)
    shapes, expected = structure.shapes(places_m, count), modes.shapes(places_m, count)
    signs = np.sign(np.sum(shapes * expected, axis=0))
    np.testing.assert_allclose(shapes * signs, expected, atol=DIGITS * np.abs(expected).max())


@pytest.mark.parametrize("mass_kg", [0.0, 0.3])
def test_each_body_of_two_beams_comes_back_by_its_nodes(exported, mass_kg):
    """The modes include those of a mass at the cradle's end."""
    rig = BarrelCradle(stations=4).rig()
    if mass_kg:
        rig = replace(rig, masses=(PointMass(station=Station("cradle", 1.0), mass_kg=mass_kg),))
    path, nodes = exported(rig), node_number_by_station(rig)
    for body in rig.bodies:
        node_at = {s.position_m: n for s, n in nodes.items() if s.body == body.name}
        structure, _, _ = structure_from_uff(path, UffSelection(nodes=tuple(node_at.values())))
        assert structure.length_m == pytest.approx(body.length_m)
        check_modes(structure, modes_of(rig, body), np.array([*node_at]), MAX_MODES_PER_BEAM)


def test_a_modal_basis_comes_back_at_its_places(exported):
    rig = BarrelCradle(stations=4).rig()
    cradle, barrel = rig.bodies
    places = np.unique([0.0, *(s.position_m for s in node_number_by_station(rig) if s.body == "barrel"), 1.0])
    basis = structure_of("barrel", 1.0, barrel.frequencies_hz(6), np.full(6, 0.01), places, barrel.shapes(places, 6))
    rig = replace(rig, bodies=(cradle, basis))
    node_numbers = tuple(n for s, n in node_number_by_station(rig).items() if s.body == "barrel")
    structure, _, _ = structure_from_uff(exported(rig), UffSelection(nodes=node_numbers))
    check_modes(structure, basis, places, 6)


def test_two_bodies_without_nodes_are_refused(exported):
    with pytest.raises(RigError, match="as of several bodies; name those of one by nodes"):
        structure_from_uff(exported(BarrelCradle(stations=4).rig()), UffSelection())


def test_a_mass_is_exported_too(exported):
    assert exported(Sdof().rig()).stat().st_size > 0
