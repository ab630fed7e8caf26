"""Numbers as text, for the pages, the figures and the screen."""

import math

from rig.model.quantities import printed_unit

COVERED = 1.96
"""Half-width of the 95 % interval of a normal distribution in standard errors."""


def number(value: float, digits: int = 4) -> str:
    """Value to some significant digits, with a power of ten where it is very large or very small."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    rounded = float(f"{value:.{digits - 1}e}")
    power = _power(rounded)
    if not -4 <= power < 7:
        return f"{rounded:.{digits - 1}e}"
    return f"{round(rounded):d}" if power >= digits else f"{rounded:.{digits - 1 - power}f}"


def percent(share: float) -> str:
    """Share of one in percent, never rounded to 0 % or 100 %."""
    if 0 < share < 0.001:
        return "< 0.1 %"
    if 0.999 < share < 1:
        return "> 99.9 %"
    return f"{100 * share:.1f} %"


def interval(value: float, standard_error: float, unit: str) -> str:
    """Value ± 1.96 standard errors, to two digits of these; the unit "1" is not written."""
    half = COVERED * standard_error
    named = "" if unit == "1" else f" {printed_unit(unit)}"
    if not math.isfinite(half) or half <= 0:
        return f"{number(value)}{named} (no interval)"
    half = float(f"{half:.1e}")
    last, first = _power(half) - 1, _power(max(abs(value), half))
    if not -4 < first < 7:
        digits, scale = first - last, 10.0**first
        return f"({value / scale:.{digits}f} ± {half / scale:.{digits}f})e{first}{named}"
    digits = max(0, -last)
    return f"{round(value, -last) + 0.0:.{digits}f} ± {half:.{digits}f}{named}"


def _power(value: float) -> int:
    return math.floor(math.log10(abs(value)))
