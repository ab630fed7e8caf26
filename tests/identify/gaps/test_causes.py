"""Effects in words: sizes with their directions, never a negative distance."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.causes import is_at_limit, phrase
from identify.gaps.search.candidates import Candidate
from rig.effects import effects
from rig.effects.base import Scale
from rig.model.description import Station, Support
from rig.simulation.reference import BarrelCradle

RIG = replace(BarrelCradle().rig(), supports=(Support(station=Station("cradle", 0.6)),))


def worded(name, shift_m, **given):
    kind, scale = effects()[name], Scale(RIG, 14.0, 60.0)
    (place, *_) = kind.placements(RIG, ["barrel_0000mm_acceleration"])
    placed = scale.with_place(place)
    candidate = Candidate(kind, place, kind.parameters(placed), kind.typical(placed))
    return phrase(candidate, np.array([shift_m]), RIG, **given)


@pytest.mark.parametrize(
    ("name", "shift_m", "words"),
    [
        ("support_position", -8e-3, "a support of the cradle that stands 8.00 mm nearer to the left end"),
        ("support_position", 8e-3, "a support of the cradle that stands 8.00 mm farther from the left end"),
        ("contact_position", -5e-3, "an overlap of the bodies that is 5.00 mm shorter than believed"),
        ("asymmetric_clearance", -3e-4, "a play of contact_1 that lies 0.300 mm lower than believed"),
        ("force_shift", -1e-4, "a force that acts 0.100 ms earlier than measured"),
        ("sensor_delay", 1e-4, "a signal of sensor barrel_0000mm_acceleration that comes 0.100 ms too late"),
        ("contact_position", 5e-3, "an overlap of the bodies that is 5.00 mm longer than believed"),
    ],
)
def test_a_shift_is_told_with_its_direction(name, shift_m, words):
    assert worded(name, shift_m) == words


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("support_position", "a support of the cradle that stands elsewhere"),
        ("contact_position", "an overlap of the bodies that is not as believed"),
        ("force_shift", "a force that acts at another time than measured"),
    ],
)
def test_a_shift_that_is_not_determined_has_no_direction(name, words):
    assert worded(name, 8e-3, with_strength=False) == words


@pytest.mark.parametrize(
    ("name", "relative_value", "expected"),
    [
        ("mass_kg", 1.0, True),
        ("mass_kg", 0.0, False),
        ("relative_position", 1.0, False),
        ("relative_position", 0.0, False),
    ],
)
def test_a_value_at_its_limit_may_lie_beyond_but_not_off_the_body(name, relative_value, expected):
    kind, scale = effects()["added_mass"], Scale(RIG, 14.0, 60.0)
    parameter = next(p for p in kind.parameters(scale.with_place({"body": "barrel"})) if p.name == name)
    assert is_at_limit(parameter, parameter.low + relative_value * (parameter.high - parameter.low)) == expected
