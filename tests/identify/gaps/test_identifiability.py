"""Numbers between the given shapes of a body that is known by its modes: told or not, and what is told instead."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.identifiability import identifiable_change
from identify.gaps.search.candidates import Candidate
from identify.gaps.wording import interval
from rig.effects import effects
from rig.effects.base import Scale
from rig.model.description import Rig, Sensor, Station
from rig.model.structure import structure_of
from rig.model.unmeasured_force import Value

HZ, RATIO = np.array([5.0, 9.0]), 0.01
SHAPES = np.array([[0.04, 0.01], [0.08, 0.01]])
"""At either end: of the first mode twice as large at the right one, where it dominates everywhere."""


def rig(second=1.0, places=(0.0, 1.0)):
    shapes = np.array([np.interp(places, (0.0, 1.0), column) for column in SHAPES.T]).T * (1.0, second)
    body = structure_of("wing", 1.0, HZ, np.full(2, RATIO), np.array(places), shapes)
    sensors = tuple(
        Sensor(name=f"s{x}", station=Station("wing", x), quantity="acceleration", noise_density=1e-3) for x in places
    )
    return Rig(
        name="wing", bodies=(body,), contacts=(), force_at=Station("wing"), sensors=sensors, sample_rate_hz=400.0
    )


def said(of, name, strength, place=0.5, error=0.1):
    kind = effects()[name]
    where = next(iter(kind.placements(of, [])))
    scale = Scale(of, 1.0, 60.0).at(where)
    candidate = Candidate(kind, where, kind.parameters(scale), kind.typical(scale))
    return identifiable_change(
        of, candidate, np.array([strength, place]), np.diag([(error * strength) ** 2, 0.0]), 15.0
    )


@pytest.mark.parametrize(
    ("name", "strength", "shift", "unit", "what"),
    [  # of phi(0.5) = 0.06: k phi^2 / (8 pi^2 f), -f m phi^2 / 2, c phi^2 / (4 pi f)
        ("linear_spring", -1000.0, -1000 * 0.06**2 / (8 * np.pi**2 * 5), "Hz", "frequency"),
        ("added_mass", 1.0, -5 * 0.06**2 / 2, "Hz", "frequency"),
        ("ground_damper", 10.0, 100 * 10 * 0.06**2 / (4 * np.pi * 5), "%", "damping ratio"),
    ],
)
def test_the_change_of_the_mode_stands_in_place_of_the_number(name, strength, shift, unit, what):
    words = said(rig(), name, strength)
    head, _, number = words.partition(" changes by ")
    assert head.endswith(f"told: the {what} of the mode at 5.000 Hz")
    value, _, rest = number.partition(" ± ")
    reach, _, ending = rest.partition(" ")
    assert float(value) == pytest.approx(shift, rel=0.03)
    assert float(reach) == pytest.approx(0.196 * abs(shift), rel=0.05)
    assert ending == unit
    assert interval(Value(strength, 0.1 * abs(strength), "N/m", instead=words)) == words


def test_friction_has_no_such_change():
    assert said(rig(), "ground_friction", 1.0).endswith("one mode dominates: the mode at 5.000 Hz")


@pytest.mark.parametrize(
    ("of", "place"),
    [
        (rig(), 1.0),  # a sensor stands there
        (rig(second=20.0), 0.5),  # another mode tells as much
        (rig(places=(0.0, 0.45, 0.55, 1.0)), 0.5),  # its neighbours hardly differ
        (replace(rig(), bodies=(replace(rig().bodies[0], natural_hz=(0.0, 9.0)),)), 0.5),  # it is free
    ],
)
def test_what_shapes_or_several_modes_tell_is_told(of, place):
    assert said(of, "linear_spring", 1000.0, place) == ""
