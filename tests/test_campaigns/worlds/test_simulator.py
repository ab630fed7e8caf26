"""The simulator against theory, against itself at another step, and against the modal plant on the same force."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.linalg import expm

from rig.simulation.excitation import BandLimitedGaussian, force_history
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.laws import StopLaw, energy_j
from tests.campaigns.worlds.machine import Place, with_hung
from tests.campaigns.worlds.simulator import STEP_S, at_rest, model_of, propagator
from tests.test_campaigns.worlds.examples import alone, beam, inputs, ran, to_ground

STOP = StopLaw(lower_m=1e-3, upper_m=1e-3, stiffness_below_n_per_m=1e5, stiffness_above_n_per_m=1e5)
FORCE = BandLimitedGaussian(rms_n=15.0, low_hz=0.5, high_hz=100.0, seed=3)
RIG = believed_rig("own", np.random.default_rng(1))


@pytest.mark.parametrize(("omega", "zeta"), [(0.0, 0.0), (0.4, 0.02), (50.0, 0.01), (8e4, 0.01), (300.0, 0.0)])
def test_a_step_is_that_of_the_matrix_exponential(omega, zeta):
    h = STEP_S
    whole = np.zeros((4, 4))  # of q, q', p, dp/ds with s = t / h
    whole[0, 1], whole[1] = h, [-(omega**2) * h, -2 * zeta * omega * h, h, 0]
    whole[2, 3] = 1.0
    exact = expm(whole)
    own, begin, end = propagator(np.array([omega]), np.array([zeta]), h)
    scale = max(abs(exact[:2, :2]).max(), 1.0)
    np.testing.assert_allclose(own[:, 0].reshape(2, 2), exact[:2, :2], rtol=1e-9, atol=1e-10 * scale)
    np.testing.assert_allclose(end[:, 0], exact[:2, 3], rtol=1e-10)
    np.testing.assert_allclose(begin[:, 0], exact[:2, 2] - exact[:2, 3], rtol=1e-10)


def test_an_undamped_beam_between_stops_keeps_its_energy():
    machine = alone(beam(damping_ratio=0.0), links=[to_ground(STOP)])
    model = model_of(machine)
    start = np.zeros((2, len(model.omega)))
    start[1, :3] = [0.4, 0.2, -0.3]
    _, states, link_n, _ = ran(machine, inputs(1.0), start)
    modal_j = np.sum(states[:, 1] ** 2 + (model.omega * states[:, 0]) ** 2, axis=1) / 2
    stop_j = np.array([energy_j(STOP, float(x)) for x in states[::50, 0] @ model.rows[0]])
    total_j = modal_j[::50] + stop_j
    assert np.mean(link_n != 0) > 0.05
    assert stop_j.max() > 0.1 * total_j[0]
    np.testing.assert_allclose(total_j, total_j[0], rtol=1e-4)


def test_a_free_beam_under_a_constant_force_falls():
    """The centre of mass moves by F t^2 / (2 m), whatever the beam's bending does."""
    bar = beam(clamped=False)
    mass_kg = bar.mass_per_length_kg_per_m
    machine = alone(bar)
    model, states, _, _ = ran(machine, inputs(0.25, np.ones_like))
    centre = states[-1, 0] @ -model.gains[-1] / mass_kg
    assert centre == pytest.approx((len(states) - 1) ** 2 * STEP_S**2 / (2 * mass_kg), rel=1e-7)


def test_a_shaken_cantilever_follows_its_ground_slowly_and_a_free_one_stays():
    """Far below the first mode the tip moves with the ground; a free beam is carried by nothing."""

    def ground(time_s):
        return np.sin(2 * np.pi * 0.5 * time_s)

    machine = alone(beam(damping_ratio=0.05))
    known = inputs(4.0, ground=ground)
    tip = ran(machine, known)[3][0]
    late = slice(round(2 / STEP_S), None)
    np.testing.assert_allclose(tip[late], known[:-1, 2][late], atol=0.02)
    free = alone(beam(clamped=False))
    np.testing.assert_allclose(ran(free, inputs(0.5, ground=ground))[3], 0, atol=1e-5)


def test_a_hung_mass_has_its_own_frequency_and_momentum_is_kept():
    mass_kg, hertz = 2e-3, 120.0
    law = StopLaw(spring_n_per_m=mass_kg * (2 * np.pi * hertz) ** 2)
    heavy = beam(clamped=False, density_kg_per_m3=7850e3)
    machine = with_hung(alone(heavy), "hung", Place("bar", 0.5), mass_kg, law)
    model = model_of(machine)
    start = np.zeros((2, len(model.omega)))
    start[1, -1] = 1.0
    _, states, _, _ = ran(machine, inputs(1.0), start)
    spectrum = np.abs(np.fft.rfft(states[:, 1, -1] * np.hanning(len(states)), 8 * len(states)))
    found = np.argmax(spectrum) / (8 * len(states) * STEP_S)
    assert found == pytest.approx(hertz, abs=0.1)
    momentum = states[:, 1] @ -model.gains[-1]
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-6)


@pytest.mark.parametrize("load_n", [3.0, -5.0])
def test_a_loaded_rig_rests_where_its_forces_balance(load_n):
    nominal = nominal_machine(RIG)
    machine = replace(nominal, loads=((Place("barrel", 0.3), load_n),))
    model = model_of(machine)
    rest = at_rest(model)
    _, states, link_n, acceleration = ran(machine, inputs(0.2))
    np.testing.assert_allclose(states[0, 0], rest)
    assert link_n[0].sum() == pytest.approx(load_n, rel=1e-4)
    assert link_n[0, 1] * 0.55 == pytest.approx(load_n * 0.3, rel=1e-4)  # moments about the barrel's left end
    assert np.abs(acceleration).max() < 1e-3


def test_friction_stops_a_floating_mass():
    """From v a mass m comes to rest after m v^2 / (2 F), but for the rounding of the law at low speed."""
    bar = beam(clamped=False, density_kg_per_m3=5 * 7850.0)
    machine = alone(bar, 0.5, links=[to_ground(StopLaw(friction_n=50.0), position_m=0.5)])
    model = model_of(machine)
    mass_kg = bar.mass_per_length_kg_per_m
    start = np.zeros((2, len(model.omega)))
    start[1] = 1.0 * -model.gains[-1]
    _, states, _, _ = ran(machine, inputs(0.7), start)
    centre = states[:, 0] @ -model.gains[-1] / mass_kg
    speed = states[:, 1] @ -model.gains[-1] / mass_kg
    slow = np.argmax(speed < 0.1)
    assert centre[slow] == pytest.approx(mass_kg * (1 - 0.1**2) / (2 * 50.0), rel=2e-3)
    assert abs(speed[-1]) < 0.01


def test_a_falling_modulus_lowers_the_frequency():
    """After the whole fall the first mode is slower by the root of what is left."""
    fall = 0.3
    machine = alone(beam(damping_ratio=0.0, fall=fall, fall_s=4.0))
    model = model_of(machine)
    start = np.zeros((2, len(model.omega)))
    start[1, 0] = 1.0
    q = ran(machine, inputs(4.0), start)[1][:, 0, 0]
    crossings = np.flatnonzero((q[:-1] < 0) & (q[1:] >= 0)) * STEP_S
    first, last = (1 / np.diff(part).mean() for part in (crossings[:3], crossings[-3:]))
    middle_s = crossings[-3:].mean()
    expected = model.omega[0] / (2 * np.pi) * np.sqrt(1 - fall * middle_s / 4.0)
    assert last == pytest.approx(expected, rel=3e-3)
    assert first > last * 1.1


@pytest.fixture(scope="module")
def of_the_modal_plant():
    force = force_history(FORCE, 2.0, STEP_S)
    return force, concatenated(modal.simulate(RIG, force, STEP_S, lambda _: None, modes_per_beam=24))


def test_the_modal_plant_moves_alike(of_the_modal_plant):
    """Within 2e-5 before the first contact, below 1 kHz within 5e-4 over 0.2 s from there; other meshes and laws."""
    force, theirs = of_the_modal_plant
    machine = nominal_machine(RIG)
    known = np.stack([force, np.ones_like(force), np.zeros_like(force)], axis=1)
    _, _, link_n, mine = ran(machine, known)
    struck = int(np.argmax((theirs.contact_force_n != 0).any(axis=0)))
    before, after = slice(0, struck), slice(struck, struck + round(0.2 / STEP_S))
    assert difference(mine[:, before], theirs.sensed[:, before]) < 2e-5
    assert difference(link_n.T[:, after], theirs.contact_force_n[:, after]) < 2e-4
    assert difference(*(below_1_khz(x[:, after]) for x in (mine, theirs.sensed))) < 5e-4


def test_a_quarter_of_the_step_changes_little(of_the_modal_plant):
    """State errors over 0.2 s of contact, of the norm: displacements below 2e-5, velocities below 1e-4."""
    force, theirs = of_the_modal_plant
    machine = nominal_machine(RIG)
    struck = int(np.argmax((theirs.contact_force_n != 0).any(axis=0)))
    ends = struck + round(0.2 / STEP_S) + 2
    fine = force_history(FORCE, 2.0, STEP_S / 4)[: 4 * ends]
    runs = []
    for values, step_s in ((force[:ends], STEP_S), (fine, STEP_S / 4)):
        known = np.stack([values, np.ones_like(values), np.zeros_like(values)], axis=1)
        runs.append(ran(machine, known, step_s=step_s)[1])
    coarse, fine_states = runs[0][struck:], runs[1][4 * struck :: 4][: ends - struck - 1]
    for part, most in ((0, 2e-5), (1, 1e-4)):
        assert difference(coarse[:, part], fine_states[:, part]) < most


def difference(one, other):
    return np.linalg.norm(one - other) / np.linalg.norm(other)


def below_1_khz(rows):
    spectrum = np.fft.rfft(rows, axis=1)
    spectrum[:, np.fft.rfftfreq(rows.shape[1], STEP_S) > 1000] = 0
    return np.fft.irfft(spectrum, rows.shape[1], axis=1)
