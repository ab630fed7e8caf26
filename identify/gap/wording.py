"""How the numbers of a diagnosis are written, on the page, in the pictures and on the screen."""

import math

from identify.gap.results import Cause, Closure, Gap, Value

COVERED = 1.96
"""Standard errors on either side of a value that hold 95 % of a normal distribution."""
VERDICTS = {"no_gap": "no gap", "effect": "effect found", "none_of_these": "gap, but none of the known effects"}


def number(value: float, digits: int = 4) -> str:
    """The value to so many significant digits; with a power of ten where it is very large or very small."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    rounded = float(f"{value:.{digits - 1}e}")
    power = _power(rounded)
    if not -4 <= power < 7:
        return f"{rounded:.{digits - 1}e}"
    return f"{round(rounded):d}" if power >= digits else f"{rounded:.{digits - 1 - power}f}"


def percent(share: float) -> str:
    """A share of one in percent, without claiming that anything is certain."""
    if 0 < share < 0.001:
        return "< 0.1 %"
    if 0.999 < share < 1:
        return "> 99.9 %"
    return f"{100 * share:.1f} %"


def interval(found: Value) -> str:
    """value ± 1.96 standard errors, to two digits of the latter."""
    value, half = found.value, COVERED * found.standard_error
    unit = "" if found.unit == "1" else f" {found.unit}"
    if not math.isfinite(half) or half <= 0:
        return f"{number(value)}{unit} (no interval)"
    half = float(f"{half:.1e}")
    last, first = _power(half) - 1, _power(max(abs(value), half))
    if not -4 < first < 7:
        digits, scale = first - last, 10.0**first
        return f"({value / scale:.{digits}f} ± {half / scale:.{digits}f})e{first}{unit}"
    digits = max(0, -last)
    return f"{round(value, -last):.{digits}f} ± {half:.{digits}f}{unit}"


def cause_name(cause: Cause) -> str:
    """Its effects with the places that they act at: "added_mass (barrel) + preload"."""
    named = []
    for effect in cause.effects:
        places = [place for field, place in cause.places.items() if field.split(".")[0] == effect]
        named.append(f"{effect} ({', '.join(places)})" if places else effect)
    return " + ".join(named)


def none_of_these(gap: Gap) -> tuple[str, float]:
    """What the causes leave of probability one, and its name."""
    name = "none of them" if gap.verdict == "no_gap" else "none of these"
    return name, max(0.0, 1.0 - sum(c.probability for c in gap.causes))


def closed(found: Closure) -> str:
    """The closed fraction with its 95 % interval; near the floor a fraction would mean nothing."""
    if found.closed_fraction is None:
        return "at the floor"
    whole = f"{100 * found.closed_fraction:.1f} %"
    if found.interval_95 is None:
        return whole
    low, high = found.interval_95
    return f"{whole} (95 % interval {100 * low:.1f} % to {100 * high:.1f} %)"


def _power(value: float) -> int:
    return math.floor(math.log10(abs(value)))
