"""Springs, dampers, friction and tones between a body and the ground: deflection, frequency, decay, amplitude."""

import msgspec
import numpy as np
import pytest
from scipy.optimize import brentq

from rig.effects import effect_named
from rig.errors import RigError
from rig.model.contact_laws.dead_zone import FRICTION_SPEED_M_PER_S
from rig.model.description import RISE_S, Sensor, StaticLoad, Station
from rig.model.modes import modes_of
from rig.simulation.reference import BarrelCradle, Sdof

STEP_S = 2.0**-12
MASS = Station("mass")


def without_contacts(machine, **sensors):
    """The machine without its contacts, with one sensor at each of the stations, named by its quantity."""
    placed = tuple(Sensor(name=q, station=s, quantity=q) for q, s in sensors.items())
    return msgspec.structs.replace(machine, contacts=(), sensors=placed)


def one_mass(damping_ratio=0.0, quantity="displacement"):
    return without_contacts(Sdof(damping_ratio=damping_ratio).rig(), **{quantity: MASS})


@pytest.mark.parametrize("share", [0.6, -0.6])
def test_a_linear_spring_moves_the_frequency_of_one_mass(run, share):
    """f = sqrt((k + k_added) / m) / 2 pi, counted over the zero crossings of a free decay."""
    body = one_mass().bodies[0]
    added = share * body.stiffness_n_per_m
    machine = effect_named(f"linear_spring:stiffness_n_per_m={added}").applied_to(one_mass())
    time_s = np.arange(round(4.0 / STEP_S)) * STEP_S
    blow = np.where(time_s < 0.02, 40.0, 0.0)
    displacement_m = run(machine, blow, STEP_S).sensed[0][time_s > 0.1]
    before_crossing = np.flatnonzero(np.diff(np.sign(displacement_m)))
    crossings = before_crossing - displacement_m[before_crossing] / (
        displacement_m[before_crossing + 1] - displacement_m[before_crossing]
    )
    found_hz = (len(crossings) - 1) / 2 / ((crossings[-1] - crossings[0]) * STEP_S)
    assert found_hz == pytest.approx(np.sqrt(1 + share) * body.frequency_hz, rel=1e-4)


@pytest.mark.parametrize("share", [2.0, -0.5])
def test_a_linear_spring_under_a_cantilever_takes_its_part_of_a_load(run, share):
    """w = F / (3 E I / l^3 + k) at the end."""
    machine = BarrelCradle().rig()
    cradle = machine.body("cradle")
    tip, stiffness = Station("cradle", cradle.length_m), 3 * cradle.bending_stiffness_n_m2 / cradle.length_m**3
    machine = effect_named(f"linear_spring:stiffness_n_per_m={share * stiffness},body=cradle").applied_to(
        without_contacts(machine, displacement=tip)
    )
    machine = msgspec.structs.replace(machine, loads=(StaticLoad(station=tip, force_n=2.0),))
    displacement_m = run(machine, np.zeros(9), STEP_S).sensed[0]
    np.testing.assert_allclose(displacement_m, 2.0 / (stiffness * (1 + share)), rtol=2e-3)


def test_a_spring_that_takes_away_more_than_there_is_is_refused():
    for body, stiffness in (("cradle", -3000.0), ("barrel", -1.0)):
        with pytest.raises(RigError, match=f"negative stiffness on '{body}' are more than what holds it"):
            effect_named(f"linear_spring:stiffness_n_per_m={stiffness},body={body}").applied_to(BarrelCradle().rig())
    with pytest.raises(RigError, match="on 'mass' are more than what holds it"):
        effect_named("linear_spring:stiffness_n_per_m=-1e6").applied_to(Sdof().rig())


def test_a_softening_spring_at_rest(run):
    """k w - |k3| w^3 = F."""
    stiffness = one_mass().bodies[0].stiffness_n_per_m
    machine = effect_named(f"hardening_spring:cubic_n_per_m3={-1e4 * stiffness}").applied_to(one_mass(0.01))
    machine = msgspec.structs.replace(machine, loads=(StaticLoad(station=MASS, force_n=0.003 * stiffness),))
    displacement_m = run(machine, np.zeros(9), STEP_S).sensed[0]
    expected = brentq(lambda w: w - 1e4 * w**3 - 0.003, 0, 0.0057)
    assert expected > 0.0033
    np.testing.assert_allclose(displacement_m, expected, rtol=1e-4)


def test_a_softening_spring_that_is_driven_too_far_lets_go(run):
    stiffness = one_mass().bodies[0].stiffness_n_per_m
    machine = effect_named(f"hardening_spring:cubic_n_per_m3={-1e4 * stiffness}").applied_to(one_mass(0.01))
    time_s = np.arange(round(1.5 / STEP_S)) * STEP_S
    with pytest.raises(RigError, match=r"a softening spring has let go|failed between|diverged"):
        run(machine, 0.02 * stiffness * np.clip(time_s, 0, 1), STEP_S)
    displacement_m = run(machine, 0.001 * stiffness * np.clip(time_s, 0, 1), STEP_S).sensed[0]
    assert np.abs(displacement_m).max() < 0.01


def decay_of(displacement_m, natural_hz):
    """The damping ratio by the logarithmic decrement of the peaks."""
    turns = (
        np.flatnonzero((displacement_m[1:-1] > displacement_m[:-2]) & (displacement_m[1:-1] >= displacement_m[2:])) + 1
    )
    before, turn, behind = displacement_m[turns - 1], displacement_m[turns], displacement_m[turns + 1]
    peaks = turn + (before - behind) ** 2 / (8 * (2 * turn - before - behind))
    rate = -np.polyfit(turns * STEP_S, np.log(peaks), 1)[0]
    return rate / (2 * np.pi * natural_hz)


def test_a_damper_to_the_ground_damps_one_mass(run):
    """zeta = c / (2 m omega), beside the mass's own; the displacement counts, be it as small as it may."""
    body = one_mass().bodies[0]
    omega = 2 * np.pi * body.frequency_hz
    machine = effect_named(f"ground_damper:damping_n_s_per_m={2 * 0.03 * body.mass_kg * omega}").applied_to(
        one_mass(0.01)
    )
    time_s = np.arange(round(3.0 / STEP_S)) * STEP_S
    displacement_m = run(machine, np.where(time_s < 0.02, 4e-4, 0.0), STEP_S).sensed[0][time_s > 0.05]
    assert np.abs(displacement_m).max() < 1e-6
    assert decay_of(displacement_m, body.frequency_hz) == pytest.approx(0.04 / np.sqrt(1 - 0.04**2), rel=2e-3)


def test_a_damper_to_the_ground_damps_a_mode_by_its_motion_there(run):
    """zeta of the cantilever's first mode grows by c phi^2 / (2 omega), to first order in c."""
    machine = BarrelCradle().rig()
    cradle = machine.body("cradle")
    tip, natural_hz = Station("cradle", cradle.length_m), float(cradle.frequencies_hz(1)[0])
    phi = cradle.shapes(np.array([0.7 * cradle.length_m]), 1)[0, 0]
    damping = 0.01 * 2 * 2 * np.pi * natural_hz / phi**2
    machine = msgspec.structs.replace(without_contacts(machine, displacement=tip), force_at=tip)
    machine = effect_named(f"ground_damper:damping_n_s_per_m={damping},relative_position=0.7,body=cradle").applied_to(
        machine
    )
    time_s = np.arange(round(2.0 / STEP_S)) * STEP_S
    smooth = np.where(time_s < 0.125, np.sin(np.pi * time_s / 0.125) ** 2, 0.0)
    displacement_m = run(machine, 0.1 * smooth, STEP_S).sensed[0][time_s > 0.6]
    assert decay_of(displacement_m, natural_hz) == pytest.approx(cradle.damping_ratio + 0.01, rel=0.01)


def test_friction_to_the_ground_shortens_every_swing_alike(run):
    """The amplitude falls by 2 F / k per half swing."""
    friction_n, body = 0.2, one_mass().bodies[0]
    machine = effect_named(f"ground_friction:force_n={friction_n}").applied_to(one_mass())
    time_s = np.arange(round(2.0 / STEP_S)) * STEP_S
    blow = np.where(time_s < 0.1, 40 * np.sin(np.pi * time_s / 0.1) ** 2, 0.0)
    displacement_m = run(machine, blow, STEP_S).sensed[0][time_s > 0.1]
    speed = np.abs(np.diff(displacement_m)).max() / STEP_S
    assert speed > 20 * FRICTION_SPEED_M_PER_S
    turns = np.flatnonzero(np.diff(np.sign(np.diff(displacement_m))))
    peaks = np.abs(displacement_m[turns + 1])[:10]
    assert -np.mean(np.diff(peaks)) == pytest.approx(2 * friction_n / body.stiffness_n_per_m, rel=0.05)


def test_a_tone_moves_one_mass_by_its_receptance(run):
    """w = Re((a - i b) e^(i omega t) / (k - m omega^2 + i omega c)) once the start has died away."""
    frequency_hz, cosine, sine = 7.0, 0.3, -0.5
    body = one_mass(0.1).bodies[0]
    machine = effect_named(f"tone:cosine_n={cosine},sine_n={sine},frequency_hz={frequency_hz}").applied_to(
        one_mass(0.1)
    )
    time_s = np.arange(round(4.0 / STEP_S)) * STEP_S
    displacement_m = run(machine, np.zeros(time_s.size), STEP_S).sensed[0]
    omega = 2 * np.pi * frequency_hz
    size = (cosine - 1j * sine) / (
        body.stiffness_n_per_m - body.mass_kg * omega**2 + 1j * omega * body.damping_n_s_per_m
    )
    late = time_s > RISE_S + 2.5
    expected = (size * np.exp(1j * omega * time_s)).real
    np.testing.assert_allclose(displacement_m[late], expected[late], atol=2e-3 * abs(size))
    assert displacement_m[0] == 0


def test_a_softened_body_has_a_lower_frequency():
    for machine, body in ((Sdof().rig(), "mass"), (BarrelCradle().rig(), "cradle")):
        softer = effect_named(f"linear_spring:stiffness_n_per_m=-300,body={body}").applied_to(machine)
        before, after = (modes_of(m, m.body(body)).frequencies_hz(1)[0] for m in (machine, softer))
        assert 0 < after < before
