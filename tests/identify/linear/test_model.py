"""Responses of bodies on spectral lines, against the equation of motion, and what a cache keeps of them."""

import weakref

import numpy as np
import pytest

from identify.linear.model import ResponseCache, accelerances, response_of
from identify.signals.recent_values import RecentValues
from rig.model.description import PointDamper, Station
from rig.simulation.reference import BarrelCradle, Sdof

OMEGA = 2 * np.pi * np.linspace(1.0, 60.0, 40)


def test_a_mass_on_a_spring_accelerates_as_its_equation_of_motion_says():
    rig = Sdof().rig()
    (body,) = rig.bodies
    response = response_of(rig, body, ResponseCache(OMEGA))
    natural, ratio = 2 * np.pi * response.dynamics.natural_hz[0], response.dynamics.damping_ratios[0]
    mass_kg = body.mass_kg
    dynamic_stiffness = mass_kg * (natural**2 - OMEGA**2 + 2j * ratio * natural * OMEGA)
    by_force, by_contact = accelerances(rig, [response], rig.forces, [Station(body.name, 0.0)])[:, 0]
    np.testing.assert_allclose(by_force, -(OMEGA**2) / dynamic_stiffness, rtol=1e-12)
    np.testing.assert_allclose(by_contact, -by_force, rtol=1e-12)  # a contact pushes back


def test_forces_and_places_change_places():
    """Maxwell and Betti: G(x, y) = G(y, x); and a contact between two bodies pushes each as a force there would."""
    rig = BarrelCradle().rig()
    cache = ResponseCache(OMEGA)
    responses = [response_of(rig, body, cache) for body in rig.bodies]
    contact = rig.contacts[0]
    places = [contact.at, contact.against]
    assert all(place is not None for place in places)
    made = accelerances(rig, responses, places, places)
    np.testing.assert_allclose(made[0, 1], made[1, 0], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(made[2], made[1] - made[0], rtol=1e-12, atol=1e-15)


def test_dampers_to_the_ground_enter_as_the_equations_of_all_modes_together_say():
    """(diag(omega_m^2 - omega^2 + 2 i zeta_m omega_m omega) + i omega sum_d c_d phi_d phi_d') q = phi_F F."""
    rig = BarrelCradle().rig()
    body = next(b for b in rig.beams if b.clamped)
    undamped = response_of(rig, body, ResponseCache(OMEGA))
    dampers = [PointDamper(station=Station(body.name, x), damping_n_s_per_m=c) for x, c in ((0.9, 70.0), (0.5, 8.0))]
    damped = undamped.damped_by([*dampers, PointDamper(station=Station("barrel", 0.2), damping_n_s_per_m=5.0)])
    shapes, (force_shape,) = undamped.shapes([d.station for d in dampers]), undamped.shapes([Station(body.name, 0.7)])
    natural, zeta = 2 * np.pi * undamped.dynamics.natural_hz, undamped.dynamics.damping_ratios
    coupling = np.einsum("d,dm,dn->mn", [d.damping_n_s_per_m for d in dampers], shapes, shapes)
    accelerations = np.empty((natural.size, OMEGA.size), dtype=complex)
    for line, omega in enumerate(OMEGA):
        stiffness = np.diag(natural**2 - omega**2 + 2j * zeta * natural * omega) + 1j * omega * coupling
        accelerations[:, line] = -(omega**2) * np.linalg.solve(stiffness, force_shape)
    modal_force = np.tile(force_shape[:, None], OMEGA.size).astype(complex)
    scale = np.abs(accelerations).max()
    np.testing.assert_allclose(damped.modal_accelerations(modal_force), accelerations, atol=1e-12 * scale)
    (transfer,) = damped.transfer(shapes, force_shape[None])
    np.testing.assert_allclose(transfer, shapes @ accelerations, atol=1e-12 * scale)
    assert np.abs(undamped.modal_accelerations(modal_force) - accelerations).max() > 0.1 * scale


@pytest.mark.parametrize("size", [0, 4])
def test_a_cache_changes_no_number(size):
    rig = BarrelCradle().rig()
    stations = [s.station for s in rig.sensors]
    cache = ResponseCache(OMEGA, size)
    made = [
        accelerances(rig, [response_of(rig, body, c) for body in rig.bodies], rig.forces, stations)
        for c in (cache, cache, ResponseCache(OMEGA))
    ]
    np.testing.assert_array_equal(made[0], made[1])
    np.testing.assert_array_equal(made[0], made[2])


def test_a_cache_makes_each_body_once_and_goes_with_its_owner():
    rig = BarrelCradle().rig()
    cache = ResponseCache(OMEGA)
    first, second = (response_of(rig, rig.bodies[0], cache) for _ in range(2))
    assert first.dynamics is second.dynamics
    assert first.accelerance is second.accelerance
    gone = weakref.ref(cache)
    del cache, first, second
    assert gone() is None


def test_the_value_used_longest_ago_is_forgotten():
    made, recent = [], RecentValues[int](2)

    def value(key: int) -> int:
        return recent.get(key, lambda: made.append(key) or key)

    assert [value(k) for k in (1, 2, 1, 3, 1, 2)] == [1, 2, 1, 3, 1, 2]
    assert made == [1, 2, 3, 2]


def test_a_rig_without_contacts_has_no_transfer_to_them():
    rig = Sdof().rig()
    cache = ResponseCache(OMEGA)
    dynamics = response_of(rig, rig.bodies[0], cache).dynamics
    assert cache.transfer(dynamics, np.zeros((0, 1)), np.ones((2, 1))).shape == (2, 0, OMEGA.size)
