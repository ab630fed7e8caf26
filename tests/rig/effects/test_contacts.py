"""Effects on contacts: equilibrium under a known load, the force law in motion, and dissipated work."""

import msgspec
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq

from rig.effects import effect_named
from rig.model.contact_laws import DeadZone
from rig.model.contact_laws.dead_zone import FRICTION_SPEED_M_PER_S
from rig.model.description import Sensor, StaticLoad, Station, contact_stations
from rig.simulation.reference import BarrelCradle, Sdof

MACHINE = BarrelCradle(stations=4, sensors="displacement").rig()
STEP_S = 2.0**-14
LOAD_N = 11.0


def resting(run, machine, load_n=LOAD_N):
    """Relative displacement and force of both contacts with the floating barrel pressed down at its middle.

    The law of the lever: 0.05 and 0.5 of 0.55 m.
    """
    load = StaticLoad(station=Station("barrel", 0.5), force_n=load_n)
    motion = run(msgspec.structs.replace(machine, loads=(load,)), np.zeros(9), STEP_S)
    force_n = motion.contact_force_n[:, 0]
    np.testing.assert_allclose(force_n, load_n * np.array([0.05, 0.5]) / 0.55, rtol=1e-6)
    np.testing.assert_allclose(motion.eta_m, np.tile(motion.eta_m[:, :1], 9), rtol=1e-4)  # it stays at rest
    return motion.eta_m[:, 0], force_n


def test_a_larger_play_and_a_stiffer_stop(run):
    law = MACHINE.contacts[0].law
    clearance_m, stiffness = law.upper_clearance_m, law.stiffness_n_per_m
    for text, play, stiff in (("contact_clearance:factor=1.2", 1.2, 1.0), ("contact_stiffness:factor=0.5", 1.0, 0.5)):
        for sign in (1, -1):
            eta, force_n = resting(run, effect_named(text).applied_to(MACHINE), sign * LOAD_N)
            expected = sign * clearance_m * play + force_n / (stiffness * stiff)
            np.testing.assert_allclose(eta, expected, rtol=1e-6)


def test_a_gap_that_stands_off_centre(run):
    law = MACHINE.contacts[0].law
    machine = effect_named("asymmetric_clearance:shift_m=1e-3").applied_to(MACHINE)
    for sign in (1, -1):
        eta, force_n = resting(run, machine, sign * LOAD_N)
        expected = sign * law.clearance_m + 1e-3 + force_n / law.stiffness_n_per_m
        np.testing.assert_allclose(eta, expected, rtol=1e-6)


def test_a_stop_that_stiffens(run):
    law = MACHINE.contacts[0].law
    cubic = 1e13
    eta, force_n = resting(run, effect_named(f"nonlinear_contact:cubic_n_per_m3={cubic}").applied_to(MACHINE))
    for eta_m, force in zip(eta, force_n, strict=True):
        depth = brentq(lambda d, f=force: law.stiffness_n_per_m * d + cubic * d**3 - f, 0, 1e-3, xtol=1e-14)
        assert eta_m == pytest.approx(law.upper_clearance_m + depth, rel=1e-7)
    assert cubic * (eta[1] - law.upper_clearance_m) ** 2 > 0.1 * law.stiffness_n_per_m


@pytest.mark.parametrize("exponent", [1.2, 1.5, 2.0])
def test_a_stop_of_another_power(run, exponent):
    """F = k d (depth / d)^p, with d = F_reference / k."""
    law, reference_n = MACHINE.contacts[0].law, 3.0
    text = f"hertz_stop:exponent={exponent},reference_force_n={reference_n}"
    for sign in (1, -1):
        eta, force_n = resting(run, effect_named(text).applied_to(MACHINE), sign * LOAD_N)
        depth = reference_n / law.stiffness_n_per_m * (np.abs(force_n) / reference_n) ** (1 / exponent)
        np.testing.assert_allclose(eta, sign * (law.clearance_m + depth), rtol=1e-6)


@pytest.mark.parametrize(("side", "sign"), [("upper", 1), ("lower", -1)])
def test_one_stop_alone(run, side, sign):
    law = MACHINE.contacts[0].law
    machine = effect_named(f"one_stop:factor=0.4,side={side}").applied_to(MACHINE)
    for pressed in (1, -1):
        eta, force_n = resting(run, machine, pressed * LOAD_N)
        stiffness = law.stiffness_n_per_m * (0.4 if pressed == sign else 1.0)
        np.testing.assert_allclose(eta, pressed * law.clearance_m + force_n / stiffness, rtol=1e-6)


def test_contacts_elsewhere_share_a_load_otherwise(run):
    shift_m = 0.02
    machine = effect_named(f"contact_position:shift_m={shift_m}").applied_to(MACHINE)
    assert [c.at.position_m for c in machine.contacts] == pytest.approx([0, 0.55 - shift_m])
    assert [c.against.position_m for c in machine.contacts] == pytest.approx([0.45 + shift_m, 1.0])
    load = StaticLoad(station=Station("barrel", 0.5), force_n=LOAD_N)
    force_n = run(msgspec.structs.replace(machine, loads=(load,)), np.zeros(3), STEP_S).contact_force_n[:, 0]
    assert force_n[1] == pytest.approx(LOAD_N * 0.5 / (0.55 - shift_m), rel=1e-6)
    assert force_n.sum() == pytest.approx(LOAD_N, rel=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "contact_damping:damping_n_s_per_m=40",
        "coulomb_friction:force_n=0.5",
        "nonlinear_contact:cubic_n_per_m3=1e11",
        "clearance_wear:growth_per_minute=60",
        "hertz_stop:exponent=1.7,reference_force_n=5",
        "one_stop:factor=0.5,side=upper",
        "one_stop:factor=2,side=lower",
    ],
)
def test_the_force_follows_its_law_in_motion(run, text):
    machine = effect_named(text).applied_to(MACHINE)
    stations = [s for c in machine.contacts for s in contact_stations(c)]
    sensors = tuple(Sensor(name=str(k), station=s, quantity="velocity") for k, s in enumerate(stations))
    machine = msgspec.structs.replace(machine, sensors=sensors)
    time_s = np.arange(round(0.3 / STEP_S)) * STEP_S
    motion = run(machine, 60 * np.sin(2 * np.pi * 12 * time_s), STEP_S)
    for j, contact in enumerate(machine.contacts):
        rate = motion.sensed[2 * j] - motion.sensed[2 * j + 1]
        expected = contact.law.force_n(motion.eta_m[j], rate, time_s)
        nominal_n = MACHINE.contacts[j].law.force_n(motion.eta_m[j], rate)
        closed = contact.law.penetration_m(motion.eta_m[j], time_s) != 0
        assert np.count_nonzero(closed) > 100
        shows = False
        for samples in (closed, ~closed):
            size = np.linalg.norm(expected[samples])
            assert np.linalg.norm((motion.contact_force_n[j] - expected)[samples]) <= 0.01 * size
            shows |= np.linalg.norm((expected - nominal_n)[samples]) > 0.02 * size
        assert shows


def test_wear_opens_the_gap_in_proportion_to_time():
    law = effect_named("clearance_wear:growth_per_minute=0.3").applied_to(MACHINE).contacts[0].law
    for minutes in (0.0, 0.5, 2.0):
        play = law.clearance_m * (1 + 0.3 * minutes)
        eta = np.array([-play - 1e-3, -play, 0.0, play, play + 1e-3])
        np.testing.assert_allclose(law.penetration_m(eta, 60 * minutes), [-1e-3, 0, 0, 0, 1e-3], atol=1e-15)


def test_friction_takes_the_work_of_its_force_along_the_way(run):
    friction_n = 0.2
    machine = effect_named(f"coulomb_friction:force_n={friction_n}").applied_to(
        Sdof(clearance_m=1.0, damping_ratio=0.0).rig()
    )
    mass = Station("mass")
    machine = msgspec.structs.replace(
        machine, sensors=tuple(Sensor(name=q, station=mass, quantity=q) for q in ("displacement", "velocity"))
    )
    body, step_s = machine.bodies[0], 2.0**-12
    time_s = np.arange(round(2.0 / step_s)) * step_s
    blow = np.where(time_s < 0.1, 40 * np.sin(np.pi * time_s / 0.1) ** 2, 0.0)
    displacement, velocity = run(machine, blow, step_s).sensed[:, time_s > 0.1]
    energy = body.mass_kg * velocity**2 / 2 + body.stiffness_n_per_m * displacement**2 / 2
    work = cumulative_trapezoid(
        friction_n * velocity * np.tanh(velocity / FRICTION_SPEED_M_PER_S), dx=step_s, initial=0
    )
    assert work[-1] > 0.2 * energy[0]
    np.testing.assert_allclose(energy + work, energy[0], rtol=2e-3)
    turns = np.flatnonzero(np.diff(np.sign(velocity)))
    peaks = np.abs(displacement[turns])  # dry friction: each half swing is shorter by 2 F / k
    assert np.all(np.diff(peaks) < 0)
    assert -np.mean(np.diff(peaks[:10])) == pytest.approx(2 * friction_n / body.stiffness_n_per_m, rel=0.05)


def test_the_law_is_odd_in_motion_with_equal_sides():
    law = DeadZone(
        lower_clearance_m=1e-3,
        upper_clearance_m=1e-3,
        stiffness_n_per_m=1e4,
        damping_n_s_per_m=3.0,
        cubic_n_per_m3=1e9,
        friction_n=0.5,
        wear_m_per_s=1e-4,
    )
    rng = np.random.default_rng(1)
    eta, rate, time_s = 3e-3 * rng.standard_normal(99), rng.standard_normal(99), rng.uniform(0, 9, 99)
    np.testing.assert_array_equal(law.force_n(-eta, -rate, time_s), -law.force_n(eta, rate, time_s))
