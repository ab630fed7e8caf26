"""Measurement operators: derivatives of shapes along a body, strain gauges, and where a sensor may stand."""

import msgspec
import numpy as np
import pytest

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.description import PointMass, Rig, Sensor, Station, from_json, to_json
from rig.model.modes import modes_of
from rig.model.oscillator import Oscillator
from rig.model.quantities import QUANTITIES
from rig.model.structure import structure_of

BEAM = Beam(name="beam", ends="clamped-free", length_m=1.0, width_m=0.05, thickness_m=0.02, damping_ratio=0.3)


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


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("end_condition", ["clamped-free", "free-free"])
@pytest.mark.parametrize("mass_kg", [0.0, 0.3])
def test_slopes_and_curvatures_are_the_derivatives_of_the_shapes(end_condition, mass_kg, order):
    beam = msgspec.structs.replace(BEAM, ends=end_condition)
    masses = (PointMass(station=Station("beam", 0.7), mass_kg=mass_kg),) if mass_kg else ()
    modes = modes_of(rig_with(bodies=(beam,), masses=masses), beam)
    x, step = np.array([0.106, 0.456, 0.906]), 1e-5  # none of them at a node, where the curvature may jump
    expected = (modes.shapes(x + step, 8, order - 1) - modes.shapes(x - step, 8, order - 1)) / (2 * step)
    np.testing.assert_allclose(modes.shapes(x, 8, order), expected, atol=1e-6 * np.abs(expected).max())


def test_a_gauge_at_another_fibre_and_on_a_structure():
    places = np.linspace(0, 1, 41)
    shapes = BEAM.shapes(places, 4)
    structure = structure_of("beam", 1.0, BEAM.frequencies_hz(4), BEAM.damping_ratios(4), places, shapes)
    rig = rig_with(gauge(0.4, fibre_m=-0.002), bodies=(structure,))
    assert rig.fibre_m(rig.sensors[0]) == -0.002
    np.testing.assert_allclose(structure.shapes(places, 4, 2), BEAM.shapes(places, 4, 2), atol=0.05 * 86)
    with pytest.raises(RigError, match="how thick 'beam' is there is not known; give fibre_m"):
        rig_with(gauge(0.4), bodies=(structure,))


@pytest.mark.parametrize("name", QUANTITIES)
def test_only_translations_are_sensed_of_a_moving_base_and_of_a_single_mass(name):
    mass = Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01)
    sensor = Sensor(name="a", station=Station("mass"), quantity=name)
    if sensor.measures.translates:
        assert rig_with(sensor, bodies=(mass,)).fibre_m(sensor) == 0.0
    else:
        with pytest.raises(RigError, match=f"measures {name} of 'mass', a mass; put it on a beam"):
            rig_with(sensor, bodies=(mass,))


def test_a_gauge_comes_back_from_json_and_bad_ones_are_named():
    rig = rig_with(gauge(0.3, fibre_m=0.004))
    assert rig.sensors[0].measures.bends
    assert not rig.sensors[0].measures.translates
    assert from_json(to_json(rig), "rig.json") == rig
    with pytest.raises(RigError, match=r"fibre_m is 0\.0; give it to strain gauges, other than zero"):
        gauge(0.3, fibre_m=0.0)
    with pytest.raises(RigError, match="fibre_m"):
        Sensor(name="a", station=Station("beam"), quantity="velocity", fibre_m=0.1)
    with pytest.raises(RigError, match="quantity is 'temperature'; give 'acceleration' or"):
        from_json(to_json(rig).replace(b'"strain"', b'"temperature"'), "rig.json")
