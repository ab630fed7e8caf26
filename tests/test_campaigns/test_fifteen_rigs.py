"""The simulator of the fifteen rigs against scipy's solver, its beams against finite elements and each other's laws."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.campaigns.fifteen_rigs.bodies import Section, element_beam, uniform_beam
from tests.campaigns.fifteen_rigs.laboratory import Assembly, TrueContact
from tests.campaigns.fifteen_rigs.piecewise_linear import Pickup, motion

SECTION = Section(0.03, 0.008)
STEP_S, STEPS = 1 / 16384, 4000


def test_the_motion_between_unlike_damped_stops_is_that_of_scipys_solver():
    lower_m, upper_m, stiffness, damping = 4e-4, 5e-4, 5e4, 5.0
    body = uniform_beam(0.6, SECTION, 4, 0.01, True)
    stop = TrueContact("stop", ("beam", 0.6), None, lower_m, upper_m, stiffness, damping)
    machine = Assembly({"beam": body}, [stop], [("beam", 0.4)]).machine()
    force = 20 * np.sin(2 * np.pi * 21 * STEP_S * np.arange(STEPS))
    row, omega = machine.stops[0].row, machine.omega_rad_per_s
    (eta, acceleration), closed = motion(machine, [Pickup(row, 0), Pickup(row, 2)], force[:, None], STEP_S)

    def slope(time_s, x):
        q, v = np.split(x, 2)
        depth = max(row @ q - upper_m, 0.0) + min(row @ q + lower_m, 0.0)
        contact_n = stiffness * depth + damping * (row @ v) * (depth != 0)
        pushed = machine.inputs[0] * np.interp(time_s, STEP_S * np.arange(STEPS), force)
        return np.concatenate([v, -(omega**2) * q - 2 * machine.ratios * omega * v + pushed - row * contact_n])

    times_s = STEP_S * np.arange(STEPS)
    solved = solve_ivp(
        slope, (0, times_s[-1]), np.zeros(8), t_eval=times_s, rtol=1e-9, atol=1e-12, max_step=STEP_S, method="DOP853"
    ).y
    assert closed[0] > 0.1
    np.testing.assert_allclose(eta, row @ solved[:4], atol=1e-4 * np.abs(eta).max())
    expected = [row @ slope(t, x)[4:] for t, x in zip(times_s, solved.T, strict=True)]
    assert np.sqrt(np.mean((acceleration - expected) ** 2)) < 1e-2 * acceleration.std()


@pytest.mark.parametrize("clamped", [True, False])
def test_beams_by_theory_and_by_elements_are_one(clamped):
    theory = uniform_beam(0.6, SECTION, 8, 0.01, clamped)
    elements = element_beam(np.linspace(0, 0.6, 61), [SECTION] * 60, 8, 0.01, clamped)
    rigid = 0 if clamped else 2
    np.testing.assert_allclose(theory.frequencies_hz, elements.frequencies_hz, rtol=1e-4, atol=1e-9)
    for place_m in (0.13, 0.6):
        shapes = (np.abs(body.shapes(place_m)[rigid:]) for body in (theory, elements))
        np.testing.assert_allclose(*shapes, atol=1e-3)


def test_curvatures_and_participations_follow_from_the_shapes():
    body = uniform_beam(0.6, SECTION, 6, 0.01, True)
    places_m = np.linspace(0, 0.6, 3001)
    shapes = np.array([body.shapes(x) for x in places_m])
    second = np.gradient(np.gradient(shapes, places_m, axis=0), places_m, axis=0)
    bent = np.array([body.curvatures(x) for x in places_m])
    np.testing.assert_allclose(second[5:-5], bent[5:-5], atol=1e-4 * np.abs(bent).max())
    mass = SECTION.mass_kg_per_m * np.trapezoid(shapes, places_m, axis=0)
    np.testing.assert_allclose(body.participations, mass, rtol=1e-4)
