"""Effects in words: sizes with their directions, never a negative distance."""

import re

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


@pytest.mark.parametrize("name", effects())
def test_every_value_of_an_effect_has_its_interval_in_its_own_unit(name):
    """Value ± 1.96 standard errors to two digits of these, of each parameter that the words hold: as it is, in
    thousandths, per cent, as a change in per cent, or along the body."""
    kind, scale = effects()[name], Scale(RIG, 14.0, 60.0)
    (place, *_) = kind.placements(RIG, ["barrel_0000mm_acceleration"])
    placed = scale.with_place(place)
    candidate = Candidate(kind, place, kind.parameters(placed), kind.typical(placed))
    values = np.array([0.3 * parameter.low + 0.7 * parameter.high for parameter in candidate.parameters])
    errors = np.abs(values) * np.linspace(0.011, 0.017, values.size)
    words = phrase(candidate, values, RIG, standard_errors=errors)
    number = r"\(?([0-9.]+) ± ([0-9.]+)(?:\)e(-?[0-9]+))?"
    stated = [(float(f"{a}e{power or 0}"), float(f"{b}e{power or 0}")) for a, b, power in re.findall(number, words)]
    shown = [p.name for p in candidate.parameters if f"{{{p.name}}}" in kind.words or p.name == "relative_position"]
    assert len(stated) == len(shown) > 0, words
    length_m = RIG.body(place.get("body") or RIG.first_driven_body).length_m
    for value, half_width in stated:
        assert any(
            half_width == pytest.approx(factor * 1.96 * error, rel=0.051)
            and value == pytest.approx(factor * abs(true - offset), abs=0.051 * half_width)
            for true, error in zip(values, errors, strict=True)
            for factor, offset in ((1, 0), (1e3, 0), (100, 0), (100, 1), (length_m, 0))
        ), (words, value, half_width)


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
