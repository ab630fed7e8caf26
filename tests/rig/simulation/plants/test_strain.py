"""Strain gauges: -h w'' by beam theory, alike in both plants, on a modal basis too, and never of a moving base."""

import numpy as np
import pytest

from rig.model.beam import Beam
from rig.model.description import BaseMotion, Clamp, PointMass, Rig, Sensor, StaticLoad, Station
from rig.model.structure import structure_of
from rig.simulation.motion import concatenated
from rig.simulation.plants import PLANTS, plant_named

STEP_S = 2.0**-12
BEAM = Beam(name="b", ends="clamped-free", length_m=1.1, width_m=0.05, thickness_m=0.01, damping_ratio=0.1)
PLACES_M = np.linspace(0, 0.99, 10)
TIP = Station("b", BEAM.length_m)


def gauges(fibre_m=None):
    stations = (Station("b", float(x)) for x in PLACES_M)
    return tuple(Sensor(name=f"{s.position_m:.3f}", station=s, quantity="strain", fibre_m=fibre_m) for s in stations)


def machine(**changes):
    plain = {
        "name": "cantilever",
        "bodies": (BEAM,),
        "contacts": (),
        "force_at": TIP,
        "sensors": gauges(),
        "sample_rate_hz": 512.0,
    }
    return Rig(**plain | changes)


def strains(plant, rig, force_n):
    return concatenated(plant_named(plant)(rig, force_n, STEP_S, lambda _: None)).sensed


def tone(samples):
    return np.sin(2 * np.pi * 20 * np.arange(samples) * STEP_S)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("fibre_m", [None, -3e-3])
def test_under_a_tip_load_it_is_that_of_beam_theory(plant, fibre_m):
    """epsilon = -h F (l - x) / E I: where a force upwards bends the beam up, the upper side becomes shorter."""
    load_n, height_m = 2.0, fibre_m or BEAM.thickness_m / 2
    rig = machine(sensors=gauges(fibre_m), loads=(StaticLoad(station=TIP, force_n=load_n),))
    expected = -height_m * load_n * (BEAM.length_m - PLACES_M) / BEAM.bending_stiffness_n_m2
    strain = strains(plant, rig, np.zeros(100))
    np.testing.assert_allclose(strain, np.tile(expected[:, None], 100), atol=5e-3 * np.abs(expected).max())


@pytest.mark.parametrize(
    "attached",
    [
        {},
        {
            "masses": (PointMass(station=Station("b", 0.6), mass_kg=0.5),),
            "clamps": (Clamp(body="b", rotational_n_m_per_rad=5e3),),
        },
    ],
    ids=["bare", "attached"],
)
def test_both_plants_bend_alike(attached):
    finite, modal = (strains(plant, machine(**attached), tone(4096)) for plant in ("ancf", "modal"))
    assert np.all(finite.std(axis=1) > 1e-7)
    assert np.abs(finite - modal).max() < 0.01 * np.abs(finite).max()


def test_a_modal_basis_bends_as_its_beam():
    places_m, shapes = np.linspace(0, BEAM.length_m, 45), 16
    basis = structure_of(
        "b",
        BEAM.length_m,
        BEAM.frequencies_hz(shapes),
        BEAM.damping_ratios(shapes),
        places_m,
        BEAM.shapes(places_m, shapes),
    )
    rigs = (machine(bodies=(body,), sensors=gauges(4e-3)) for body in (BEAM, basis))
    beam_strain, basis_strain = (strains("modal", rig, tone(2048)) for rig in rigs)
    assert np.abs(beam_strain - basis_strain).max() < 0.01 * np.abs(beam_strain).max()


@pytest.mark.parametrize("plant", PLANTS)
def test_a_base_that_moves_slowly_bends_by_inertia_alone(plant):
    """w'' = -rho A a (l - x)^2 / 2 E I; the displacement of the base, much larger than that of the tip, is none."""
    base = BaseMotion(acceleration_rms_m_per_s2=0.2, low_hz=0.3, high_hz=0.7)
    tip = Sensor(name="tip", station=TIP, quantity="acceleration")
    sensed = strains(plant, machine(base_motion=base, sensors=(*gauges(), tip)), np.zeros(round(6 / STEP_S)))
    curvature_per_acceleration = (
        BEAM.mass_per_length_kg_per_m * (BEAM.length_m - PLACES_M) ** 2 / (2 * BEAM.bending_stiffness_n_m2)
    )
    expected = BEAM.thickness_m / 2 * curvature_per_acceleration[:, None] * sensed[-1]
    settled = slice(round(1.5 / STEP_S), None)
    assert np.abs(sensed[:-1] - expected)[:, settled].max() < 0.03 * np.abs(expected).max()
