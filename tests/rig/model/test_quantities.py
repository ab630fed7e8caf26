"""Measurement operators: what a strain gauge delivers of a beam, by theory and by both plants."""

import msgspec
import numpy as np
import pytest

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.description import PointMass, Rig, Sensor, Station, from_json, to_json
from rig.model.modes import modes_of
from rig.model.oscillator import Oscillator
from rig.model.structure import structure_of
from rig.simulation.motion import joined
from rig.simulation.plants import PLANTS, plant_named

BEAM = Beam(name="beam", ends="clamped-free", length_m=1.0, width_m=0.05, thickness_m=0.02, damping_ratio=0.3)
PLACES_M = (0.0, 0.2, 0.55, 0.8)


def gauge(position_m, name="gauge", **more):
    return Sensor(name=name, station=Station("beam", position_m), quantity="strain", **more)


def rig_with(*sensors, bodies=(BEAM,), **more):
    return Rig(
        name="strained",
        bodies=bodies,
        contacts=(),
        force_at=Station(bodies[0].name, bodies[0].length_m),
        sensors=sensors,
        sample_rate_hz=1024.0,
        **more,
    )


@pytest.mark.parametrize("ends", ["clamped-free", "free-free"])
@pytest.mark.parametrize("mass_kg", [0.0, 0.3])
def test_curvatures_are_second_derivatives_of_the_shapes(ends, mass_kg):
    beam = msgspec.structs.replace(BEAM, ends=ends)
    masses = (PointMass(station=Station("beam", 0.7), mass_kg=mass_kg),) if mass_kg else ()
    modes = modes_of(rig_with(bodies=(beam,), masses=masses), beam)
    x, step = np.array([0.106, 0.456, 0.906]), 2e-3
    beside = [modes.shapes(x + k * step, 8) for k in (-1, 0, 1)]
    expected = (beside[0] - 2 * beside[1] + beside[2]) / step**2
    np.testing.assert_allclose(modes.curvatures(x, 8), expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("name", PLANTS)
def test_a_static_tip_load_strains_a_cantilever_as_theory_says(name):
    """epsilon = h F (L - x) / (E I) on the side that is stretched, so less than zero where w'' is above."""
    rig, force_n = rig_with(*(gauge(x, f"at {x}") for x in PLACES_M)), 5.0
    rise = np.minimum(1.0, np.arange(8192) / 4096)
    motion = joined(
        plant_named(name)(rig, force_n * rise**3 * (10 - 15 * rise + 6 * rise**2), 2.0**-13, lambda _: None)
    )
    expected = -0.01 * force_n * (1 - np.array(PLACES_M)) / BEAM.bending_stiffness_n_m2
    np.testing.assert_allclose(motion.sensed[:, -1], expected, rtol=0.02, atol=0.01 * np.abs(expected).max())


def test_a_gauge_at_another_fibre_and_on_a_structure():
    places = np.linspace(0, 1, 41)
    shapes = BEAM.shapes(places, 4)
    structure = structure_of("beam", 1.0, BEAM.frequencies_hz(4), BEAM.damping_ratios(4), places, shapes)
    rig = rig_with(gauge(0.4, fibre_m=-0.002), bodies=(structure,))
    assert rig.fibre_m(rig.sensors[0]) == -0.002
    np.testing.assert_allclose(structure.curvatures(places, 4), BEAM.curvatures(places, 4), atol=0.05 * 86)
    with pytest.raises(RigError, match="how thick 'beam' is there is not known; give fibre_m"):
        rig_with(gauge(0.4), bodies=(structure,))


def test_a_base_that_moves_strains_nothing_by_itself():
    rig = rig_with(gauge(0.3), Sensor(name="tip", station=Station("beam", 1.0), quantity="displacement"))
    assert rig.sensors[0].measures.bends
    assert not rig.sensors[1].measures.bends


def test_a_gauge_comes_back_from_json_and_bad_ones_are_named():
    rig = rig_with(gauge(0.3, fibre_m=0.004))
    assert from_json(to_json(rig), "rig.json") == rig
    with pytest.raises(RigError, match=r"fibre_m is 0\.0; give it to strain gauges, other than zero"):
        gauge(0.3, fibre_m=0.0)
    with pytest.raises(RigError, match="fibre_m"):
        Sensor(name="a", station=Station("beam"), quantity="velocity", fibre_m=0.1)
    mass = Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01)
    with pytest.raises(RigError, match="measures strain of 'mass', a mass; put it on a beam"):
        rig_with(Sensor(name="a", station=Station("mass"), quantity="strain"), bodies=(mass,))
    with pytest.raises(RigError, match="Invalid enum value 'temperature'"):
        from_json(to_json(rig).replace(b'"strain"', b'"temperature"'), "rig.json")
