"""Modes beyond a description add about as much as its own highest modes tell."""

import numpy as np
import pytest

from identify.linear.model import ResponseCache, responses_of
from identify.linear.truncation import truncations_of
from rig.model.beam import Beam
from rig.model.description import Rig, Sensor, Station
from rig.model.structure import structure_of

PLACES_M = np.array([0.2, 0.35, 0.5, 0.65, 0.8])
OMEGA = 2 * np.pi * np.linspace(1.0, 50.0, 5)
BEAM = Beam(name="body", ends="clamped-free", length_m=1.0, width_m=0.04, thickness_m=0.01)


def plate_modes(count):
    """Frequencies and shapes along a line, at y = 0.37 b, of a simply supported plate of 1 m by 0.7 m and 10 kg."""
    orders = [(m, n, m**2 + (n / 0.7) ** 2) for m in range(1, 60) for n in range(1, 42)]
    lowest = sorted(orders, key=lambda order: order[2])[:count]
    shapes = [2 / np.sqrt(10) * np.sin(m * np.pi * PLACES_M) * np.sin(n * np.pi * 0.37) for m, n, _ in lowest]
    return np.array([25.0 * square for *_, square in lowest]), np.array(shapes).T


def beam_modes(count):
    return BEAM.frequencies_hz(count), BEAM.shapes(PLACES_M, count)


def accelerations_per_newton(modes_of, count, force_place):
    """Accelerations at all places by a newton at one of them, of so many modes; rows are places."""
    hz, shapes = modes_of(count)
    omega = 2 * np.pi * hz[:, None]
    return (shapes * shapes[force_place]) @ (-(OMEGA**2) / (omega**2 - OMEGA**2))


@pytest.mark.parametrize(("modes_of", "known_count", "all_count"), [(plate_modes, 40, 2000), (beam_modes, 8, 40)])
def test_modes_left_out_add_about_a_standard_deviation_where_the_force_acts(modes_of, known_count, all_count):
    hz, shapes = modes_of(known_count)
    body = structure_of("body", 1.0, hz, np.full(known_count, 0.01), PLACES_M, shapes)
    sensors = [
        Sensor(name=f"s{k}", station=Station("body", x), quantity="acceleration") for k, x in enumerate(PLACES_M)
    ]
    unit_response = np.ones((len(sensors), OMEGA.size), complex)
    pulls = []
    for force_place in range(PLACES_M.size):
        station = sensors[force_place].station
        fields = {"name": "r", "bodies": (body,), "contacts": (), "sample_rate_hz": 200.0}
        rig = Rig(**fields, force_at=station, sensors=tuple(sensors))
        responses = responses_of(rig, ResponseCache(OMEGA, 0), True)
        truncations = truncations_of(rig, responses, rig.forces, dict(enumerate(sensors)), unit_response, 1.0)
        left_out = np.subtract(*(accelerations_per_newton(modes_of, n, force_place) for n in (all_count, known_count)))
        own_pulls = [abs(left_out[t.rows[0]] / t.signals_per_newton[0]).max() for t in truncations]
        assert len(own_pulls) == PLACES_M.size
        pulls.append(own_pulls[force_place])
    assert max(pulls) < 1.5
    assert min(pulls) > 0.02
