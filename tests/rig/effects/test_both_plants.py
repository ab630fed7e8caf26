"""Both plants move alike under every effect, as long as contact is young and slopes are small."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.effects import effect_named, effects
from rig.model.description import PointSpring, Station
from rig.simulation.motion import concatenated
from rig.simulation.plants import ancf, modal
from rig.simulation.reference import BarrelCradle, Sdof

AMPLITUDE = 0.01
"""Of the reference's clearance and force: with slopes so small the beams of both plants are linear."""
OF_THE_CHANNELS = {"sensor_gain", "sensor_delay", "common_gain"}
STRONG = {  # magnitudes that show within a fifth of a second at a hundredth of the amplitude
    "asymmetric_clearance": "shift_m=5e-6",
    "nonlinear_contact": "cubic_n_per_m3=3e14",
    "coulomb_friction": "force_n=0.02",
    "hardening_spring": "cubic_n_per_m3=1e10",
    "preload": "force_n=0.02",
    "clearance_wear": "growth_per_minute=20",
    "hertz_stop": "reference_force_n=0.2",
    "ground_friction": "force_n=0.02",
    "ground_damper": "damping_n_s_per_m=10",
    "tone": "cosine_n=0.5,sine_n=-1,frequency_hz=20",
    "force_shift": "shift_s=1e-3",
}
MACHINES = {
    "barrel_cradle": BarrelCradle(
        clearance_1_m=AMPLITUDE * 5e-3, clearance_2_m=AMPLITUDE * 5e-3, stations=4, sensors="displacement"
    ).rig(),
    "sdof": Sdof(clearance_m=AMPLITUDE * 1e-3, sensors="displacement").rig(),
}
SUPPORT = PointSpring(station=Station("cradle", 0.6), stiffness_n_per_m=1e5)
MACHINES["barrel_cradle"] = replace(MACHINES["barrel_cradle"], springs=(SUPPORT,))
STEP_S = 2.0**-13
NOT_FOR_ONE_MASS = {"clamp_compliance", "contact_position", "support_position", "youngs_modulus"}
CASES = [
    (rig_name, name)
    for rig_name in MACHINES
    for name in effects()
    if name not in OF_THE_CHANNELS and not (rig_name == "sdof" and name in NOT_FOR_ONE_MASS)
]


def motion_of(plant, machine):
    time_s = np.arange(round(0.12 / STEP_S)) * STEP_S
    lines_hz = (7, 19, 31, 55, 80)
    force_n = AMPLITUDE * 20 * np.sum([np.sin(2 * np.pi * f * time_s + k) for k, f in enumerate(lines_hz)], axis=0)
    return concatenated(plant.simulate(machine, force_n * np.clip(time_s / 0.05, 0, 1), STEP_S, lambda _: None))


@pytest.fixture(scope="module")
def nominal():
    return {rig_name: motion_of(modal, machine).sensed for rig_name, machine in MACHINES.items()}


@pytest.mark.parametrize(("rig_name", "name"), CASES)
def test_both_plants_move_alike_under_every_effect(nominal, rig_name, name):
    machine = effect_named(f"{name}:{STRONG.get(name, '')}").applied_to(MACHINES[rig_name])
    modes, elements = motion_of(modal, machine), motion_of(ancf, machine)
    assert modes.contact_force_n.any()
    size = np.linalg.norm(modes.sensed)
    assert np.linalg.norm(modes.sensed - elements.sensed) < 2e-3 * size
    assert np.linalg.norm(modes.sensed - nominal[rig_name]) > 5e-3 * size
