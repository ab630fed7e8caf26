"""The assumed-mode plant against exact solutions."""

import msgspec
import numpy as np
import pytest

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.description import Rig, Sensor, Station
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from rig.simulation.reference import BarrelCradle, Sdof

MASS = Station("mass")
FREE = msgspec.structs.replace(
    Sdof(damping_ratio=0.05).rig(),
    contacts=(),
    sensors=tuple(Sensor(name=q, station=MASS, quantity=q) for q in ("displacement", "velocity", "acceleration")),
)


def simulated(rig, force_n, step_s, **options):
    return concatenated(modal.simulate(rig, force_n, step_s, lambda _: None, **options))


def triangle(samples, step_s):
    """A blow that is linear between the samples: up to 100 N at 0.125 s, down to nothing at 0.25 s."""
    return 100.0 * np.interp(np.arange(samples) * step_s, [0, 0.125, 0.25], [0, 1, 0])


@pytest.mark.parametrize("step_s", [2.0**-5, 2.0**-9])
def test_free_vibration_is_exact_at_any_step(step_s):
    motion = simulated(FREE, triangle(round(3 / step_s), step_s), step_s)
    start = round(0.25 / step_s)  # the blow is over
    displacement, velocity, acceleration = motion.sensed[:, start:]
    body = FREE.bodies[0]
    omega, zeta = 2 * np.pi * body.frequency_hz, body.damping_ratio
    damped = omega * np.sqrt(1 - zeta**2)
    time_s = np.arange(displacement.size) * step_s
    sine = (velocity[0] + zeta * omega * displacement[0]) / damped
    expected = np.exp(-zeta * omega * time_s) * (
        displacement[0] * np.cos(damped * time_s) + sine * np.sin(damped * time_s)
    )
    np.testing.assert_allclose(displacement, expected, atol=1e-12 * np.abs(expected).max())
    balance = acceleration + 2 * zeta * omega * velocity + omega**2 * displacement
    np.testing.assert_allclose(balance[1:], 0, atol=1e-9 * np.abs(acceleration).max())


def test_a_blow_gives_its_momentum_to_a_floating_barrel():
    beam = Beam(name="beam", ends="free-free", length_m=1.0, width_m=0.05, thickness_m=0.01)
    places = np.linspace(0, 1, 101)
    rig = Rig(
        name="floating",
        bodies=(beam,),
        contacts=(),
        force_at=Station("beam", 1.0),
        sensors=tuple(Sensor(name=f"{p:.2f}", station=Station("beam", float(p)), quantity="velocity") for p in places),
        sample_rate_hz=1000.0,
    )
    step_s = 2.0**-12
    force_n = triangle(round(2 / step_s), step_s)
    velocity = simulated(rig, force_n, step_s).sensed[:, -1]
    impulse = np.sum(force_n) * step_s
    momentum = beam.mass_per_length_kg_per_m * np.trapezoid(velocity, places)
    turning = beam.mass_per_length_kg_per_m * np.trapezoid(velocity * (places - 0.5), places)
    assert momentum == pytest.approx(impulse, rel=1e-3)
    assert turning == pytest.approx(impulse * 0.5, rel=1e-3)  # the arm of the force about the centre


def test_a_slow_force_bends_the_cradle_by_its_static_deflection():
    beam = Beam(name="beam", ends="clamped-free", length_m=1.0, width_m=0.05, thickness_m=0.01, damping_ratio=0.5)
    tip = Station("beam", 1.0)
    rig = Rig(
        name="cradle",
        bodies=(beam,),
        contacts=(),
        force_at=tip,
        sensors=(Sensor(name="tip", station=tip, quantity="displacement"),),
        sample_rate_hz=1000.0,
    )
    step_s = 2.0**-10
    force_n = 10.0 * np.clip(np.arange(round(4 / step_s)) * step_s, 0, 1)
    deflection = simulated(rig, force_n, step_s, modes_per_beam=30).sensed[0, -1]
    assert deflection == pytest.approx(10.0 / (3 * beam.bending_stiffness_n_m2), rel=1e-5)


def test_blocks_do_not_show(monkeypatch):
    settings = BarrelCradle(stations=4, contact_damping_n_s_per_m=2.0)
    force_n = 20 * np.sin(2 * np.pi * 25 * np.arange(6000) * 2.0**-14)
    single_run = simulated(settings.rig(), force_n, 2.0**-14)
    assert single_run.contact_force_n.any()
    monkeypatch.setattr(modal, "STEPS_PER_BLOCK", 700)
    blocks = list(modal.simulate(settings.rig(), force_n, 2.0**-14, lambda _: None))
    assert [round(b.start_s / b.step_s) for b in blocks] == list(range(0, 6000, 700))
    pieces = concatenated(iter(blocks))
    for name in ("force_n", "sensed", "displacement_m", "eta_m", "contact_force_n"):
        expected, joined_blocks = getattr(single_run, name), getattr(pieces, name)
        np.testing.assert_allclose(
            joined_blocks, expected, atol=1e-12 * np.abs(expected).max()
        )  # the sums' order may differ


def test_progress_runs_to_the_end():
    fractions = []
    list(modal.simulate(FREE, np.zeros(40000), 2.0**-9, fractions.append))
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1


@pytest.mark.parametrize("settings", [{"stiffness_1_n_per_m": 1e12}, {"contact_damping_n_s_per_m": 1e7}])
def test_a_contact_too_stiff_for_the_step_is_refused(settings):
    with pytest.raises(RigError, match=r"too stiff for the step of 0\.0001\d+ s .*; use a smaller step"):
        simulated(BarrelCradle(**settings).rig(), np.zeros(10), 2.0**-13)


def test_a_force_that_is_not_finite_is_refused():
    force_n = np.zeros(10)
    force_n[3] = np.inf
    with pytest.raises(RigError, match=r"diverged near 0\.000 s at step"):
        simulated(FREE, force_n, 2.0**-9)
