"""A base that shakes and a sensor on it, in both plants and against closed forms."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import lsim

from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.description import ON_GROUND, BaseMotion, Contact, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.model.quantities import QUANTITIES
from rig.simulation import prediction
from rig.simulation.motion import concatenated
from rig.simulation.plants import ancf, modal
from rig.simulation.plants.loading import base_motion

STEP_S = 2.0**-12
MASS = Oscillator(name="mass", mass_kg=2.0, frequency_hz=12.0, damping_ratio=0.1)
BEAM = Beam(name="beam", ends="clamped-free", length_m=0.5, width_m=0.03, thickness_m=0.008)
SHAKEN = BaseMotion(acceleration_rms_m_per_s2=3.0, low_hz=3.0, high_hz=60.0, start_s=0.5)
PLANTS = {"modal": modal.simulate, "ancf": ancf.simulate}


def rig_on(base, *bodies, contacts=(), quantities=("acceleration",)):
    places = [ON_GROUND, *(Station(b.name, b.length_m) for b in bodies)]
    sensors = tuple(Sensor(name=f"{p.body} {q}", station=p, quantity=q) for p in places for q in quantities)
    return Rig(name="r", bodies=bodies, contacts=contacts, sensors=sensors, sample_rate_hz=2048.0, base_motion=base)


def moved(rig, plant, duration_s):
    return concatenated(PLANTS[plant](rig, np.zeros(round(duration_s / STEP_S)), STEP_S, lambda _: None))


@pytest.mark.parametrize("plant", PLANTS)
def test_a_sensor_on_the_ground_shows_the_motion_of_the_base(plant):
    quantities = [name for name, quantity in QUANTITIES.items() if quantity.translates]
    rig = rig_on(SHAKEN, MASS, quantities=quantities)
    motion = moved(rig, plant, 1.0)
    base = base_motion(rig, round(1.0 / STEP_S), STEP_S)
    for sensor, row in zip(rig.sensors[: len(quantities)], motion.sensed, strict=False):
        np.testing.assert_array_equal(row, base[sensor.measures.order])
    before = motion.sensed[:, : round(0.5 / STEP_S)]
    np.testing.assert_array_equal(before, 0.0)
    assert np.all(motion.sensed.std(axis=1) > 0)


@pytest.mark.parametrize("plant", PLANTS)
def test_a_mass_has_the_transmissibility_of_an_oscillator_on_a_shaken_base(plant):
    """(2 zeta w s + w^2) / (s^2 + 2 zeta w s + w^2) from acceleration to acceleration in space."""
    base, mass = moved(rig_on(SHAKEN, MASS), plant, 3.0).sensed
    omega, twice = 2 * np.pi * MASS.frequency_hz, 2 * MASS.damping_ratio
    transmissibility = [twice * omega, omega**2], [1.0, twice * omega, omega**2]
    _, expected, _ = lsim(transmissibility, base, np.arange(base.size) * STEP_S)
    assert np.linalg.norm(mass - expected) < 5e-3 * np.linalg.norm(expected)


def test_the_plants_agree_on_a_cantilever_that_meets_a_stop_on_its_base():
    law = DeadZone(lower_clearance_m=3e-4, upper_clearance_m=4e-4, stiffness_n_per_m=2e4, damping_n_s_per_m=5.0)
    stop = Contact(name="stop", at=Station("beam", 0.5), law=law)
    rig = rig_on(SHAKEN, BEAM, contacts=(stop,), quantities=("displacement",))
    of_modal, of_ancf = (moved(rig, plant, 1.5) for plant in PLANTS)
    assert np.any(of_modal.contact_force_n)
    relative = of_modal.sensed[1] - of_modal.sensed[0]
    np.testing.assert_allclose(of_modal.eta_m[0], relative, atol=1e-12)
    assert np.linalg.norm(of_ancf.eta_m[0] - relative) < 0.03 * np.linalg.norm(relative)


def test_a_base_without_motion_leaves_the_rig_at_rest():
    rig = replace(rig_on(None, MASS), base_motion=None)
    np.testing.assert_array_equal(moved(rig, "modal", 0.1).sensed, 0.0)


@pytest.mark.parametrize("plant", PLANTS)
def test_an_inertial_force_on_the_ground_shakes_the_base_in_place_of_its_description(plant):
    """Minus the acceleration of a base, N/kg, moves the sensors on base and body as that base does."""
    rig = rig_on(SHAKEN, MASS, quantities=("displacement", "acceleration"))
    described = moved(rig, plant, 2.0)
    acceleration = described.sensed[1]
    driven = concatenated(
        PLANTS[plant](
            rig_on(None, MASS, quantities=("displacement", "acceleration")), -acceleration, STEP_S, lambda _: None
        )
    )
    for row, expected in zip(driven.sensed, described.sensed, strict=True):
        assert np.linalg.norm(row - expected) < 1e-3 * np.linalg.norm(expected)
    np.testing.assert_array_equal(driven.sensed[1], acceleration)


def test_a_prediction_on_a_measured_base_is_the_motion_against_it():
    """From states against the base, under its inertial force, in the sampled motion of the plant."""
    rig = replace(rig_on(SHAKEN, MASS, quantities=("displacement", "velocity", "acceleration")), sample_rate_hz=2048.0)
    base_m, base_rate, base_acceleration, mass_m, mass_rate, _ = moved(rig, "modal", 2.0).sensed[:, ::2]
    motion = np.stack([mass_m - base_m, mass_rate - base_rate])
    starts, samples = np.array([1500, 2500]), 800
    states = motion[:, None, starts].transpose(2, 0, 1)
    predicted = prediction.modal(rig, -base_acceleration[None], starts, samples, (Station("mass"),), states)
    for window, start in zip(predicted, starts, strict=True):
        expected = motion[:, start : start + samples]
        error = np.linalg.norm(window[:, 0] - expected, axis=1)
        assert np.all(error < 2e-3 * np.linalg.norm(expected, axis=1))
