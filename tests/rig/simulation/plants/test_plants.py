"""Requirements on any plant: convergence as the step goes to zero, energy balance, agreement with the others."""

from functools import cache, partial

import msgspec
import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.integrate import cumulative_trapezoid, solve_ivp

from rig.errors import RigError
from rig.model.contact_laws import PLANE_LAWS, DeadZone
from rig.model.contact_laws.spring import Spring
from rig.model.description import Contact, Rig, Sensor, Station, contact_stations
from rig.model.oscillator import Oscillator
from rig.simulation.excitation import QUIET_S, BandLimitedGaussian, force_history
from rig.simulation.motion import Forces, concatenated
from rig.simulation.plants import PLANTS, ancf, modal, plant_named
from rig.simulation.reference import BarrelCradle, Sdof
from tests.campaigns.engines import tip_difference, young_motion


def simulated(plant, rig, force_n, step_s):
    return concatenated(plant(rig, force_n, step_s, lambda _: None))


@pytest.fixture(params=PLANTS)
def plant(request):
    return plant_named(request.param)


def test_there_is_no_other_plant():
    with pytest.raises(RigError, match="no plant 'bicycle'; there are ancf, modal"):
        plant_named("bicycle")


@pytest.mark.parametrize("side", [-1, 1])
def test_a_mass_with_one_stop_alone_moves_freely_to_the_other_side(plant, side):
    """Its equation of motion, integrated by scipy: one stop 1 mm away, none on the other side."""
    rig, step_s = msgspec.structs.replace(Sdof().rig(), sensors=()), 2.0**-13
    body, (contact,) = rig.bodies[0], rig.contacts
    absent = {"lower_clearance_m" if side > 0 else "upper_clearance_m": np.inf}
    law = msgspec.structs.replace(contact.law, **absent)
    rig = msgspec.structs.replace(rig, contacts=(msgspec.structs.replace(contact, law=law),))
    time_s = np.arange(2**12) * step_s

    def rates(time, state):
        depth_m = side * max(side * state[0] - law.clearance_m, 0.0)
        linear_n = body.stiffness_n_per_m * state[0] + body.damping_n_s_per_m * state[1]
        contact_n = law.stiffness_n_per_m * depth_m
        return [state[1], (4.0 * np.sin(6 * np.pi * time) - linear_n - contact_n) / body.mass_kg]

    exact = solve_ivp(rates, (0, time_s[-1]), [0, 0], t_eval=time_s, rtol=1e-9, atol=1e-12, max_step=1e-3).y[0]
    assert np.ptp(exact) > 3 * law.clearance_m
    motion = simulated(plant, rig, 4.0 * np.sin(6 * np.pi * time_s), step_s)
    assert motion.contact_force_n.any()
    np.testing.assert_allclose(motion.eta_m[0], exact, atol=1e-3 * np.ptp(exact))


def test_one_mass_between_stops_converges_to_its_solution_at_least_with_the_square_of_the_step(plant):
    rig = msgspec.structs.replace(Sdof().rig(), sensors=())
    body, law = rig.bodies[0], rig.contacts[0].law
    amplitudes_n = np.linspace(2, 6, 5)  # the error depends on where in a step each contact falls: an average
    coarsest, duration_s = 9, 1.0
    common_s = np.arange(round(duration_s * 2**coarsest)) * 2.0**-coarsest

    def force(amplitude_n, time_s):
        return amplitude_n * np.sin(2 * np.pi * 3 * time_s)

    def exact(amplitude_n):
        def rates(time_s, state):
            depth_m = max(state[0] - law.upper_clearance_m, 0) + min(state[0] + law.lower_clearance_m, 0)
            contact_n = law.stiffness_n_per_m * depth_m
            linear_n = body.stiffness_n_per_m * state[0] + body.damping_n_s_per_m * state[1]
            return [state[1], (force(amplitude_n, time_s) - linear_n - contact_n) / body.mass_kg]

        span = (0, common_s[-1])
        return solve_ivp(rates, span, [0, 0], t_eval=common_s, rtol=1e-9, atol=1e-12, max_step=2e-3).y[0]

    solutions = np.array([exact(a) for a in amplitudes_n])
    powers = np.arange(coarsest, 14)
    errors = []
    for power in powers:
        time_s = np.arange(round(duration_s * 2**power)) * 2.0**-power
        motions = [simulated(plant, rig, force(a, time_s), 2.0**-power) for a in amplitudes_n]
        assert all(m.contact_force_n.any() for m in motions)
        etas_m = np.array([m.eta_m[0, :: 2 ** (power - coarsest)] for m in motions])
        errors.append(np.linalg.norm(etas_m - solutions) / np.linalg.norm(solutions))
    assert errors[-1] < 1e-3
    order = -np.polyfit(powers, np.log2(errors), 1)[0]
    assert order > 1.7


STOPS = {"lower_clearance_m": 1e-3, "upper_clearance_m": 2e-3, "damping_n_s_per_m": 20.0}


@pytest.mark.parametrize(
    "law",
    [
        DeadZone(**STOPS, stiffness_n_per_m=2e4, friction_n=0.3, lower_stiffness_ratio=0.5, wear_m_per_s=3e-4),
        DeadZone(**STOPS, stiffness_n_per_m=2e4, exponent=1.5, cubic_n_per_m3=1e9, open_damping_n_s_per_m=1.0),
        *(kind(**STOPS, stiffness_n_per_m=2e4) for kind in PLANE_LAWS if kind.has_stops),
        Spring(stiffness_n_per_m=2e4, damping_n_s_per_m=5.0),
    ],
    ids=lambda law: type(law).__name__,
)
def test_one_mass_with_any_law_moves_as_a_solver_says(plant, law):
    rig = Sdof().rig()
    contacts = tuple(msgspec.structs.replace(c, law=law) for c in rig.contacts)
    rig = msgspec.structs.replace(rig, sensors=(), contacts=contacts)
    time_s = np.arange(2**14) * 2.0**-14
    motion = simulated(plant, rig, 5 * np.sin(6 * np.pi * time_s), 2.0**-14)
    if law.has_stops:
        assert np.count_nonzero(np.diff(law.penetration_m(motion.eta_m[0], time_s) != 0)) > 4
    expected_m = solved_displacement_m(law)
    assert np.linalg.norm(motion.eta_m[0] - expected_m) < 1e-3 * np.linalg.norm(expected_m)


@cache
def solved_displacement_m(law):
    """Displacement of the reference mass with one contact under 5 N at 3 Hz, by scipy's solver, at 2^14 Hz."""
    (body,) = Sdof().rig().bodies

    def rates(now_s, state):
        linear_n = body.stiffness_n_per_m * state[0] + body.damping_n_s_per_m * state[1]
        contact_n = law.formula(law, float(state[0]), float(state[1]), now_s)
        return [state[1], (5 * np.sin(6 * np.pi * now_s) - linear_n - contact_n) / body.mass_kg]

    time_s = np.arange(2**14) * 2.0**-14
    return solve_ivp(rates, (0, 1), [0, 0], t_eval=time_s, rtol=1e-9, atol=1e-12, max_step=2e-3).y[0]


def test_three_masses_in_a_chain_move_as_a_solver_says(plant):
    """Each knocks against the next, the last against the ground too: a third body needs nothing of its own."""
    masses = tuple(
        Oscillator(name=f"mass {k}", mass_kg=1.0 + k, frequency_hz=4.0, damping_ratio=0.02) for k in range(3)
    )
    places = [Station(m.name) for m in masses]
    law = DeadZone(lower_clearance_m=4e-4, upper_clearance_m=3e-4, stiffness_n_per_m=2e4, damping_n_s_per_m=10.0)
    pairs = ((0, 1), (1, 2), (2, None))
    rig = Rig(
        name="chain",
        bodies=masses,
        contacts=tuple(
            Contact(name=f"contact {i}", at=places[i], against=None if j is None else places[j], law=law)
            for i, j in pairs
        ),
        force_at=places[0],
        sensors=tuple(
            Sensor(name=m.name, station=place, quantity="displacement") for m, place in zip(masses, places, strict=True)
        ),
        sample_rate_hz=512.0,
    )
    step_s = 2.0**-14
    time_s = np.arange(2**14) * step_s
    weights = np.zeros((3, 3))
    for row, (i, j) in zip(weights, pairs, strict=True):
        row[i], row[2 if j is None else j] = 1.0, 1.0 if j is None else -1.0
    mass_kg, stiffness, damping = (
        np.array([getattr(m, field) for m in masses]) for field in ("mass_kg", "stiffness_n_per_m", "damping_n_s_per_m")
    )

    def contact_n(eta_m, rate_m_per_s):
        depth_m = eta_m - np.clip(eta_m, -4e-4, 3e-4)
        return 2e4 * depth_m + 10.0 * np.minimum(1.0, np.abs(depth_m) / 1e-5) * rate_m_per_s

    def rates(now_s, state):
        x, v = np.split(state, 2)
        push = np.array([8 * np.sin(6 * np.pi * now_s), 0.0, 0.0])
        forces = push - stiffness * x - damping * v - weights.T @ contact_n(weights @ x, weights @ v)
        return np.concatenate([v, forces / mass_kg])

    expected = solve_ivp(rates, (0, 1), np.zeros(6), t_eval=time_s, rtol=1e-9, atol=1e-12, max_step=2e-3).y[:3]
    motion = simulated(plant, rig, 8 * np.sin(6 * np.pi * time_s), step_s)
    assert all(np.count_nonzero(row) > 100 for row in motion.contact_force_n)
    assert np.linalg.norm(motion.sensed - expected) < 3e-3 * np.linalg.norm(expected)


ELEMENTS = 20


def energies(plant, step_s, duration_s):
    """Work done on the barrel and its cradle, and where it went, as functions of time.

    Four Gauss points an element carry a displacement and a velocity sensor each: they determine the cubic of the
    finite elements exactly, hence its kinetic and its bending energy.
    """
    base = BarrelCradle(contact_damping_n_s_per_m=2.0, sensors="displacement").rig()
    points, weights = leggauss(4)
    relative, length = (points + 1) / 2, 1.0 / ELEMENTS
    x = (np.arange(ELEMENTS)[:, None] * length + relative * length).ravel()
    weight = np.tile(weights / 2 * length, ELEMENTS)
    stations = [Station(b.name, float(p)) for b in base.bodies for p in x]
    contact_places = [s for c in base.contacts for s in contact_stations(c)]
    measured = [("displacement", s) for s in stations] + [
        ("velocity", s) for s in [*stations, *contact_places, base.force_at]
    ]
    rig = msgspec.structs.replace(
        base, sensors=tuple(Sensor(name=str(k), station=s, quantity=q) for k, (q, s) in enumerate(measured))
    )
    excitation = BandLimitedGaussian(rms_n=14.0, low_hz=0.5, high_hz=100.0)
    force_n = force_history(excitation, QUIET_S + duration_s, step_s)[round(QUIET_S / step_s) :]
    motion = simulated(plant, rig, force_n, step_s)
    displacement, velocity, at_ends, at_force = np.split(
        motion.sensed, np.cumsum([len(stations), len(stations), len(contact_places)])
    )
    second_derivative = np.stack([0 * relative, 0 * relative, 2 + 0 * relative, 6 * relative], axis=1) / length**2
    curvature_of = second_derivative @ np.linalg.inv(np.vander(relative, increasing=True))
    stored, lost_w = np.zeros(force_n.size), np.zeros(force_n.size)
    for body, q, v in zip(rig.bodies, np.split(displacement, 2), np.split(velocity, 2), strict=True):
        curvature = (curvature_of @ q.reshape(ELEMENTS, 4, -1)).reshape(q.shape)
        stored += weight @ (body.mass_per_length_kg_per_m * v**2 + body.bending_stiffness_n_m2 * curvature**2) / 2
        modes = 16
        rate = (body.mass_per_length_kg_per_m * weight[:, None] * body.shapes(x, modes)).T @ v
        lost_w += 4 * np.pi * body.damping_ratios(modes) * body.frequencies_hz(modes) @ rate**2
    for contact, eta, (velocity_at, against) in zip(rig.contacts, motion.eta_m, at_ends.reshape(2, 2, -1), strict=True):
        depth = contact.law.penetration_m(eta)
        stored += contact.law.stiffness_n_per_m * depth**2 / 2
        lost_w += (contact.law.force_n(eta, velocity_at - against) - contact.law.stiffness_n_per_m * depth) * (
            velocity_at - against
        )
    work = cumulative_trapezoid(force_n * at_force[0], dx=step_s, initial=0)
    closures = np.count_nonzero(np.diff((motion.contact_force_n != 0).astype(int), axis=1) > 0)
    return work, stored, cumulative_trapezoid(lost_w, dx=step_s, initial=0), closures


def test_energy_adds_up_over_a_run_with_contacts(plant):
    work, stored, lost, closures = energies(plant, 2.0**-13, 1.0)
    assert closures > 10
    assert lost[-1] > 0.3 * work[-1]
    assert np.abs(work - stored - lost).max() < 0.005 * np.abs(work).max()


@pytest.fixture(scope="module")
def young():
    return young_motion(ancf.simulate, 2.0**-15)


@pytest.mark.parametrize("modes", [12, 16])
def test_both_plants_move_alike_while_contact_is_young(young, modes):
    motion = young_motion(partial(modal.simulate, modes_per_beam=modes), young.step_s)
    assert motion.contact_force_n.any()
    for body, difference in tip_difference(young, motion).items():
        assert difference < 0.03, body


def test_both_plants_move_alike_under_two_forces(young):
    second_station = Station("cradle", 0.6)
    two, motion = (young_motion(p.simulate, young.step_s, beside=second_station) for p in (ancf, modal))
    for body, difference in tip_difference(two, motion).items():
        assert difference < 0.03, body
    assert max(tip_difference(two, young).values()) > 0.3  # the second force matters


def sensed_under(plant, rig, forces):
    """The sensors under forces by the places where they act."""
    rig = msgspec.structs.replace(
        rig, force_at=tuple(station for station, _ in forces) if len(forces) > 1 else forces[0][0]
    )
    return simulated(plant, rig, Forces(tuple(force_n for _, force_n in forces)), 2.0**-13).sensed


def test_two_forces_at_one_place_are_their_sum(plant):
    time_s = np.arange(1600) * 2.0**-13
    rig, force_n = BarrelCradle(stations=4).rig(), 40.0 * (1 - np.cos(2 * np.pi * np.outer([20.0, 33.0], time_s)))
    both = sensed_under(plant, rig, [(rig.force_at, row) for row in force_n])
    together = sensed_under(plant, rig, [(rig.force_at, force_n.sum(axis=0))])
    size = np.abs(together).max(axis=1)
    assert size.min() > 0  # the barrel has met its cradle
    assert np.all(np.abs(both - together).max(axis=1) < 1e-6 * size)


def test_without_contacts_the_motion_under_two_forces_is_the_sum_of_those_under_each(plant):
    rig = msgspec.structs.replace(BarrelCradle(stations=4).rig(), contacts=())
    force_n = 1e-3 * np.random.default_rng(1).standard_normal((2, 800))  # so small that ancf is linear
    forces = list(zip((rig.force_at, Station("cradle", 0.6)), force_n, strict=True))
    both, first, second = sensed_under(plant, rig, forces), *(sensed_under(plant, rig, [force]) for force in forces)
    assert np.all(np.abs(both - first - second).max(axis=1) < 1e-5 * np.abs(both).max(axis=1))


def test_as_many_forces_as_the_rig_has_are_asked_for(plant):
    with pytest.raises(RigError, match="rig 'sdof' is driven by 1 of force, not 2"):
        simulated(plant, Sdof().rig(), Forces((np.zeros(9), np.zeros(9))), 2.0**-13)


def test_six_modes_are_too_few_for_that(young):
    difference = tip_difference(young, young_motion(partial(modal.simulate, modes_per_beam=6), young.step_s))
    assert max(difference.values()) > 0.03


def test_at_the_full_amplitude_too(young):
    """3 to 4 % whatever the step: there the beams turn far enough for their geometry to show."""
    full = young_motion(ancf.simulate, young.step_s, scale=1.0)
    linear = young_motion(modal.simulate, young.step_s, scale=1.0)
    for body, difference in tip_difference(full, linear).items():
        assert difference < 0.05, body
