"""Effects in words: sizes with their directions, never a negative distance."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.causes import phrase
from identify.gaps.search.candidates import Candidate
from rig.effects import effects
from rig.effects.base import Scale
from rig.model.description import Station, Support
from rig.simulation.reference import BarrelCradle

RIG = replace(BarrelCradle().rig(), supports=(Support(station=Station("cradle", 0.6)),))


def worded(name, shift_m, **given):
    kind, scale = effects()[name], Scale(RIG, 14.0, 60.0)
    (place, *_) = kind.placements(RIG, [])
    placed = scale.with_place(place)
    return phrase(
        Candidate(kind, place, kind.parameters(placed), kind.typical(placed)), np.array([shift_m]), RIG, **given
    )


@pytest.mark.parametrize(
    ("name", "shift_m", "words"),
    [
        ("support_position", -8e-3, "a support of the cradle that stands 8.00 mm nearer to the left end"),
        ("support_position", 8e-3, "a support of the cradle that stands 8.00 mm farther from the left end"),
        ("contact_position", -5e-3, "contacts whose bodies lie 5.00 mm less far along each other than believed"),
        ("contact_position", 5e-3, "contacts whose bodies lie 5.00 mm farther along each other than believed"),
    ],
)
def test_a_shift_is_told_with_its_direction(name, shift_m, words):
    assert worded(name, shift_m) == words


def test_a_shift_that_is_not_determined_has_no_direction():
    assert worded("support_position", 8e-3, with_strength=False) == "a support of the cradle that stands elsewhere"
