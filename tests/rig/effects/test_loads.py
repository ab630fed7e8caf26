"""Static loads bend and press, and the base carries what stands on it but not what floats."""

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from rig.effects import effect_named
from rig.errors import RigError
from rig.model.description import RISE_S, PointDamper, Sensor, StaticLoad, Station
from rig.model.oscillator import Oscillator
from rig.simulation.excitation import QUIET_S
from rig.simulation.plants.loading import base_motion, true_force
from rig.simulation.reference import BarrelCradle, Sdof

MACHINE = BarrelCradle(stations=4).rig()
STEP_S = 2.0**-12
QUANTITIES = ("displacement", "velocity", "acceleration")


@pytest.mark.parametrize("force_n", [3.0, -3.0])
def test_a_preload_bends_the_cradle_and_stays(run, force_n):
    """F x^2 (3 l - x) / 6 E I."""
    machine = effect_named(f"preload:force_n={force_n},body=cradle,relative_position=1").applied_to(MACHINE)
    motion = run(machine, np.zeros(400), STEP_S)
    cradle = machine.body("cradle")
    for sensor, row in zip(machine.sensors, motion.sensed, strict=True):
        x, length = sensor.station.position_m, cradle.length_m
        expected = force_n * x**2 * (3 * length - x) / (6 * cradle.bending_stiffness_n_m2)
        if sensor.station.body == "barrel" or sensor.quantity == "acceleration":
            expected = 0.0
        scale = abs(force_n) / (3 * cradle.bending_stiffness_n_m2)
        scale *= (2 * np.pi * cradle.frequencies_hz(1)[0]) ** 2 if sensor.quantity == "acceleration" else 1.0
        np.testing.assert_allclose(row, expected, atol=2e-3 * scale)


def test_a_preload_on_one_mass(run):
    machine = effect_named("preload:force_n=0.4").applied_to(Sdof(sensors="displacement").rig())
    expected = 0.4 / machine.bodies[0].stiffness_n_per_m
    np.testing.assert_allclose(run(machine, np.zeros(99), STEP_S).sensed[0], expected, rtol=1e-6)


def test_a_load_that_nothing_holds_is_refused(run):
    load = StaticLoad(station=Station("barrel", 0.5), force_n=1.0)
    with pytest.raises(RigError, match="nothing holds a body against its static load; add a spring or a contact"):
        run(msgspec.structs.replace(MACHINE, contacts=(), loads=(load,)), np.zeros(9), STEP_S)


def test_a_load_on_a_free_mass_with_a_damper_moves_it_from_rest(run):
    """m v' = F - c v."""
    mass_kg, damping, force_n = 2.0, 4.0, 0.5
    body = Oscillator(name="mass", mass_kg=mass_kg, frequency_hz=0.0, damping_ratio=0.0)
    station = Station("mass")
    machine = msgspec.structs.replace(
        Sdof(sensors="displacement").rig(),
        bodies=(body,),
        contacts=(),
        dampers=(PointDamper(station=station, damping_n_s_per_m=damping),),
        loads=(StaticLoad(station=station, force_n=force_n),),
    )
    time_s = STEP_S * (np.arange(8000) + 0.5)  # the plants differ by a step in when it begins
    decay_s = mass_kg / damping
    expected = force_n / damping * (time_s - decay_s * (1 - np.exp(-time_s / decay_s)))
    np.testing.assert_allclose(run(machine, np.zeros(8000), STEP_S).sensed[0], expected, atol=1e-4 * expected[-1])


def test_a_load_on_a_free_beam_with_a_damper_at_its_place_moves_it_from_rest(run):
    """The bent beam is at rest at first, though elastic modes feel the load too; then the damper carries all of it."""
    damping, force_n, middle = 40.0, 0.5, Station("barrel", 0.5)
    machine = msgspec.structs.replace(
        MACHINE,
        contacts=(),
        dampers=(PointDamper(station=middle, damping_n_s_per_m=damping),),
        loads=(StaticLoad(station=middle, force_n=force_n),),
        sensors=tuple(replace_quantity(s) for s in MACHINE.sensors if s.station.body == "barrel"),
    )
    speeds = run(machine, np.zeros(8000), STEP_S).sensed
    assert np.abs(speeds[:, 0]).max() < 0.02 * force_n / damping
    np.testing.assert_allclose(speeds[:, -400:].mean(axis=1), force_n / damping, rtol=1e-3)


@pytest.mark.parametrize("at_m", [0.0, 1.0])
def test_a_damper_elsewhere_does_not_resist_a_load(run, at_m):
    """The load would turn the beam without end."""
    machine = msgspec.structs.replace(
        MACHINE,
        contacts=(),
        dampers=(PointDamper(station=Station("barrel", at_m), damping_n_s_per_m=40.0),),
        loads=(StaticLoad(station=Station("barrel", 0.5), force_n=0.5),),
    )
    with pytest.raises(RigError, match="nothing holds a body against its static load"):
        run(machine, np.zeros(9), STEP_S)


def replace_quantity(sensor):
    return msgspec.structs.replace(sensor, quantity="velocity")


def test_the_base_moves_as_it_is_told():
    machine = effect_named("base_motion:acceleration_rms_m_per_s2=0.3,low_hz=5,high_hz=9").applied_to(MACHINE)
    samples = round(8 / STEP_S)
    base = base_motion(machine, samples, STEP_S)
    assert all(history[0] == 0 for history in base)
    assert np.sqrt(np.mean(base[2] ** 2)) == pytest.approx(0.3, rel=0.05)
    for lower, higher in pairwise(base):
        error = np.abs(np.gradient(lower, STEP_S) - higher)[1:-1].max()
        assert error < 1e-3 * np.abs(higher).max()
    settled = base[2][round(RISE_S / STEP_S) :]
    spectrum = np.abs(np.fft.rfft(settled * np.hanning(settled.size))) ** 2
    frequency_hz = np.fft.rfftfreq(settled.size, STEP_S)
    inside = (frequency_hz > 4.5) & (frequency_hz < 9.5)
    assert spectrum[~inside].sum() < 1e-3 * spectrum.sum()
    same_seed, other_seed = (
        base_motion(effect_named(f"base_motion:low_hz=5,high_hz=9,seed={seed}").applied_to(MACHINE), samples, STEP_S)
        for seed in (1, 2)
    )
    np.testing.assert_allclose(same_seed[2] * 0.6, base[2])
    assert np.corrcoef(same_seed[2], other_seed[2])[0, 1] < 0.5
    finer = base_motion(machine, 2 * samples, STEP_S / 2)
    np.testing.assert_allclose(finer[0][::2], base[0], atol=1e-9 * np.abs(base[0]).max())


def test_a_base_motion_that_does_not_fit_is_refused():
    machine = effect_named("base_motion:low_hz=10.1,high_hz=10.2").applied_to(MACHINE)
    with pytest.raises(RigError, match=r"no line of 10\.1 to 10\.2 Hz fits 1 s; record longer"):
        base_motion(machine, 4096, STEP_S)
    with pytest.raises(RigError, match=r"a base motion up to 10\.2 Hz needs at most 1/\(4 high_hz\)"):
        base_motion(machine, 4096, 0.1)


def with_all_quantities(machine):
    stations = dict.fromkeys(s.station for s in machine.sensors)
    sensors = (Sensor(name=f"{k}{q}", station=s, quantity=q) for k, s in enumerate(stations) for q in QUANTITIES)
    return msgspec.structs.replace(machine, sensors=tuple(sensors))


def test_a_shaking_base_drives_one_mass_by_its_spring(run):
    """m a + c (v - v_base) + k (w - w_base) = 0 with all that the sensors show, which is motion in space."""
    machine = with_all_quantities(effect_named("base_motion").applied_to(Sdof(clearance_m=1.0).rig()))
    body, samples = machine.bodies[0], round(2 / STEP_S)
    base = base_motion(machine, samples, STEP_S)
    motion = run(machine, np.zeros(samples), STEP_S)
    displacement, velocity, acceleration = motion.sensed
    spring = body.stiffness_n_per_m * (displacement - base[0])
    damper = body.damping_n_s_per_m * (velocity - base[1])
    residual_n = body.mass_kg * acceleration + damper + spring
    assert np.linalg.norm(residual_n[2:]) < 2e-3 * np.linalg.norm(spring)
    np.testing.assert_allclose(motion.eta_m[0], displacement - base[0], atol=1e-12)
    assert np.abs(acceleration[: round(QUIET_S / STEP_S)]).max() > 0.1 * np.abs(acceleration).max()


def test_a_shaking_base_moves_the_cradle_but_not_the_floating_barrel(run):
    machine = effect_named("base_motion:low_hz=1,high_hz=2,acceleration_rms_m_per_s2=0.1").applied_to(MACHINE)
    machine = with_all_quantities(
        msgspec.structs.replace(machine, contacts=tuple(msgspec.structs.replace(c, law=WIDE) for c in machine.contacts))
    )
    samples = round(1.2 / STEP_S)
    base = base_motion(machine, samples, STEP_S)
    motion = run(machine, np.zeros(samples), STEP_S)
    for sensor, row in zip(machine.sensors, motion.sensed, strict=True):
        scale = np.abs(base[sensor.measures.order]).max()
        if sensor.station.body == "barrel":
            assert np.abs(row).max() < 2e-3 * scale
        elif sensor.station.position_m < 0.3:  # near the clamp
            np.testing.assert_allclose(row, base[sensor.measures.order], atol=0.1 * scale)
    tip = next(
        row
        for s, row in zip(machine.sensors, motion.sensed, strict=True)
        if s.station == Station("cradle", 1.0) and s.quantity == "displacement"
    )
    bending_m = tip - base[0]
    first = machine.body("cradle").frequencies_hz(1)[0]
    assert np.abs(bending_m).max() < 3 * np.abs(base[2]).max() / (2 * np.pi * first) ** 2
    assert np.abs(bending_m).max() > np.abs(base[2]).max() / (2 * np.pi * first) ** 2


WIDE = msgspec.structs.replace(MACHINE.contacts[0].law, lower_clearance_m=1.0, upper_clearance_m=1.0)


def test_the_true_force_is_the_measured_one_of_a_while_ago_without_its_gain():
    time_s = np.arange(4000) * STEP_S
    force_n = np.sin(2 * np.pi * 40 * time_s) ** 3
    for lag_steps in (3, 2.5, -2.5):
        lag_s = lag_steps * STEP_S
        machine = effect_named("force_gain:factor=1.1").applied_to(
            effect_named(f"force_shift:shift_s={lag_s}").applied_to(MACHINE)
        )
        true_n = true_force(machine, force_n, STEP_S)
        before = np.clip(time_s - lag_s, 0.0, time_s[-1])  # the measured force stays at its first and last values
        np.testing.assert_allclose(true_n, np.sin(2 * np.pi * 40 * before) ** 3 / 1.1, atol=1e-5)
        slices = [true_force(machine, force_n, STEP_S, slice(k, k + 500)) for k in range(0, 4000, 500)]
        np.testing.assert_allclose(np.concatenate(slices), true_n, atol=1e-12)
