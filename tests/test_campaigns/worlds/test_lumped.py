"""Masses in a row against theory: frequencies, momentum and energy, decay."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import hilbert

from rig.errors import RigError
from tests.campaigns.worlds.forces import Blows, Release
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.laws import StopLaw, energy_j
from tests.campaigns.worlds.lumped import lumped_modes
from tests.campaigns.worlds.machine import Link, Lumped, Machine, MotionSensor, Place
from tests.campaigns.worlds.simulator import at_rest, model_of
from tests.test_campaigns.worlds.examples import inputs, ran

MASS_KG, SPRING = 2.0, 2.0 * (2 * np.pi * 12.0) ** 2


def row(count, grounded=True, damping_ratio=0.0, **changes):
    numbers = {
        "name": "row",
        "positions_m": tuple((0.2 * np.arange(count)).tolist()),
        "masses_kg": (MASS_KG,) * count,
        "grounded_n_per_m": (SPRING * grounded, *(0.0,) * (count - 1)),
        "between_n_per_m": (SPRING,) * (count - 1),
        "damping_ratio": damping_ratio,
        "frequency_factors": (1.0,) * count,
        "damping_factors": (1.0,) * count,
    }
    return Lumped(**numbers | changes)


def machine(body, links=(), quantity="displacement"):
    places = [Place("row", x) for x in body.positions_m]
    sensors = tuple(MotionSensor(name=f"s{k}", at=p, quantity=quantity) for k, p in enumerate(places))
    return Machine(beams=(), contacts=tuple(links), force_at=places[0], sensors=sensors, lumped=(body,))


@pytest.mark.parametrize("count", [1, 3, 4])
def test_a_held_chain_has_the_frequencies_of_theory(count):
    """omega_j = 2 sqrt(k / m) sin((2 j - 1) pi / (2 (2 n + 1)))."""
    expected = 2 * np.sqrt(SPRING / MASS_KG) * np.sin((2 * np.arange(1, count + 1) - 1) * np.pi / (4 * count + 2))
    np.testing.assert_allclose(lumped_modes(row(count)).omega_rad_per_s, expected, rtol=1e-12)


def test_a_free_frame_has_the_frequencies_of_theory():
    """omega_j = 2 sqrt(k / m) sin(j pi / (2 n)), j from 0, and carries its mass in the first mode."""
    modes = lumped_modes(row(4, grounded=False, damping_ratio=0.01))
    expected = 2 * np.sqrt(SPRING / MASS_KG) * np.sin(np.arange(4) * np.pi / 8)
    np.testing.assert_allclose(modes.omega_rad_per_s, expected, rtol=1e-9)
    assert modes.damping_ratio.tolist() == [0.0, 0.01, 0.01, 0.01]
    np.testing.assert_allclose(np.abs(modes.carried), [np.sqrt(4 * MASS_KG), 0, 0, 0], atol=1e-7)


def test_a_mass_and_a_spring_that_are_fixed_to_it_count():
    body = row(1, masses=((0.0, 0.5),), springs=((0.0, 300.0),))
    assert lumped_modes(body).omega_rad_per_s[0] == pytest.approx(np.sqrt((SPRING + 300.0) / 2.5))
    with pytest.raises(RigError, match="do not hold it"):
        lumped_modes(row(1, springs=((0.0, -2 * SPRING),)))


def test_an_undamped_chain_between_stops_keeps_its_energy():
    law = StopLaw(lower_m=1e-3, upper_m=2e-3, stiffness_below_n_per_m=5e4, stiffness_above_n_per_m=2e4)
    rig = machine(row(3), [Link(name="stop", at=Place("row", 0.4), against=Place("row", 0.2), law=law)])
    model = model_of(rig)
    start = np.zeros((2, 3))
    start[1] = [0.3, 0.2, -0.2]
    _, states, link_n, _ = ran(rig, inputs(1.0), start)
    total_j = np.sum(states[:, 1] ** 2 + (model.omega * states[:, 0]) ** 2, axis=1)[::50] / 2
    total_j = total_j + [energy_j(law, float(x)) for x in states[::50, 0] @ model.rows[0]]
    assert np.mean(link_n != 0) > 0.05
    np.testing.assert_allclose(total_j, total_j[0], rtol=1e-4)


def test_a_released_mass_decays_at_its_rate_from_where_it_was_held():
    """x = x0 exp(-zeta omega t) cos(...), x0 = F / k; no force is measured."""
    zeta, rate_hz = 0.01, 1024.0
    found = measured(machine(row(1, damping_ratio=zeta)), Release(held_n=5.0, before_s=0.05), 4096, rate_hz, 1)
    assert not found.force_n.any()
    envelope = np.abs(hilbert(found.delivered[0]))[512:-512]
    slope = np.polyfit(np.arange(envelope.size) / rate_hz, np.log(envelope), 1)[0]
    assert slope == pytest.approx(-zeta * 2 * np.pi * 12.0, rel=2e-3)
    at_begin = 5.0 / SPRING * np.exp(-zeta * 2 * np.pi * 12.0 * (0.05 + 512 / rate_hz))
    assert envelope[0] == pytest.approx(at_begin, rel=0.02)


def test_a_release_begins_where_spring_and_stop_balance_the_force():
    law = StopLaw(lower_m=1e-3, upper_m=1e-3, stiffness_below_n_per_m=SPRING, stiffness_above_n_per_m=SPRING)
    rig = machine(row(1), [Link(name="stop", at=Place("row"), against=None, law=law)])
    model = model_of(rig)
    held_n = 3e-3 * SPRING
    assert model.sensed[0] @ at_rest(model, held_n) == pytest.approx(2e-3, rel=1e-6)  # k x + k (x - 1 mm) = 3 mm k


def test_a_blow_gives_its_momentum_and_is_measured_unless_it_came_before():
    """A half-sine of peak p and width w has the momentum 2 p w / pi; a free mass keeps it."""
    free = machine(row(1, grounded=False), quantity="velocity")
    blow = Blows(blows=((0.5, 10.0),), width_s=0.02)
    found = measured(free, blow, 1024, 1024.0, 1)
    impulse = 2 * 10.0 * 0.02 / np.pi
    assert found.force_n.sum() / 1024.0 == pytest.approx(impulse, rel=1e-3)
    assert found.delivered[0, 700] == pytest.approx(impulse / MASS_KG, rel=1e-3)
    before = measured(free, replace(blow, blows=((-0.1, 10.0),)), 1024, 1024.0, 1)
    assert not before.force_n.any()
    np.testing.assert_allclose(before.delivered[0], impulse / MASS_KG, rtol=1e-3)


def test_a_mass_on_a_shaken_base_moves_against_it_as_under_its_inertial_force():
    pushed = machine(row(1, damping_ratio=0.02))
    shaken = replace(pushed, cell=replace(pushed.cell, base_kg=MASS_KG))
    blow = Blows(blows=((0.2, 30.0),), width_s=0.01)
    one, other = (measured(m, blow, 1024, 1024.0, 1) for m in (pushed, shaken))
    np.testing.assert_allclose(one.force_n, other.force_n)
    np.testing.assert_allclose(one.delivered, other.delivered, atol=1e-6 * np.abs(one.delivered).max())


@pytest.mark.parametrize(("quantity", "order"), [("displacement", 0), ("velocity", 1)])
def test_sensors_of_motion_are_integrals_of_acceleration(quantity, order):
    body = row(3, damping_ratio=0.01)
    blow = Blows(blows=((0.1, 30.0),), width_s=0.02)
    moved = measured(machine(body, quantity=quantity), blow, 4096, 2048.0, 1).delivered[2]
    bent = measured(machine(body, quantity="acceleration"), blow, 4096, 2048.0, 1).delivered[2]
    for _ in range(2 - order):
        moved = np.gradient(moved, 1 / 2048.0)
    np.testing.assert_allclose(moved[10:-10], bent[10:-10], atol=5e-3 * np.abs(bent).max())


def test_crosstalk_is_a_share_of_the_channels_beside():
    plain = machine(row(3, damping_ratio=0.01))
    first, second, third = plain.sensors
    mixed = replace(plain, sensors=(first, replace(second, crosstalk=(0.004, -0.003)), third))
    blow = Blows(blows=((0.1, 30.0),), width_s=0.02)
    a, b = (measured(m, blow, 2048, 1024.0, 1).delivered for m in (plain, mixed))
    np.testing.assert_allclose(b[1], a[1] + 0.004 * a[0] - 0.003 * a[2], atol=1e-12)
    np.testing.assert_array_equal(b[[0, 2]], a[[0, 2]])
