"""Numbers as text, for the pages, the figures and the screen."""

import math
from collections.abc import Sequence

from rig.model.quantities import printed_unit

COVERED = 1.96
"""Half-width of the 95 % interval of a normal distribution in standard errors."""
PLAIN_DIGITS = 3
"""Significant digits of a value in a sentence that has no interval. Display."""
SMALLEST_P_VALUE = 1e-12
"""Smallest p-value that is written as a number: the tails of no distribution are known further out."""
LARGEST_LENGTH_RATIO = 100.0
"""Ratio of record lengths above which none is advised. Display."""


def number(value: float, significant_digits: int = 4) -> str:
    """Value to some significant digits, with a power of ten where it is very large or very small."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    rounded_value = float(f"{value:.{significant_digits - 1}e}")
    power_of_ten = _power_of_ten(rounded_value)
    if not -4 <= power_of_ten < 7:
        return f"{rounded_value:.{significant_digits - 1}e}"
    return (
        f"{round(rounded_value):d}"
        if power_of_ten >= significant_digits
        else f"{rounded_value:.{significant_digits - 1 - power_of_ten}f}"
    )


def percent(share: float) -> str:
    """Share of one in percent, never rounded to 0 % or 100 %."""
    if 0 < share < 0.001:
        return "< 0.1 %"
    if 0.999 < share < 1:
        return "> 99.9 %"
    return f"{100 * share:.1f} %"


def interval(value: float, standard_error: float, unit: str) -> str:
    """Value ± 1.96 standard errors, to two digits of these; the unit "1" is not written."""
    half_width, unit_text = COVERED * standard_error, _unit_text(unit)
    if not math.isfinite(half_width) or half_width <= 0:
        return f"{number(value)}{unit_text} (no interval)"
    half_width = float(f"{half_width:.1e}")
    last_power, first_power = _power_of_ten(half_width) - 1, _power_of_ten(max(abs(value), half_width))
    if not -4 < first_power < 7:
        decimals, power_factor = first_power - last_power, 10.0**first_power
        return (
            f"({value / power_factor:.{decimals}f} ± {half_width / power_factor:.{decimals}f})e{first_power}{unit_text}"
        )
    decimals = max(0, -last_power)
    return f"{round(value, -last_power) + 0.0:.{decimals}f} ± {half_width:.{decimals}f}{unit_text}"


def estimate_words(value: float, standard_error: float, unit: str, plain_words: str = "") -> str:
    """Value in a sentence with its 95 % interval; where it has none the plain words, or the value to three digits."""
    if math.isfinite(standard_error) and standard_error > 0:
        return interval(value, standard_error, unit)
    return plain_words or f"{number(value, PLAIN_DIGITS)}{_unit_text(unit)}"


def change_words(change: float, standard_error: float) -> str:
    """Relative change in per cent with its sign and 95 % interval: "+3.10 ± 0.40 %"."""
    return "+" * (change > 0) + estimate_words(100 * change, 100 * standard_error, "%", f"{100 * change:.2g} %")


def _unit_text(unit: str) -> str:
    return "" if unit == "1" else f" {printed_unit(unit)}"


def joined(words: Sequence[str], conjunction: str = "and") -> str:
    """Enumeration "a, b and c"."""
    *leading_words, last_word = words
    return f"{', '.join(leading_words)} {conjunction} {last_word}" if leading_words else last_word


def p_value_words(p_value: float) -> str:
    """P-value as it is written everywhere: "p = 0.43", "p < 1e-12"."""
    return f"p < {SMALLEST_P_VALUE:g}" if p_value < SMALLEST_P_VALUE else f"p = {number(p_value, 2)}"


def record_length_words(length_ratio: float | None) -> str:
    """Length of a further record over that of this one, rounded up: "about twice as long"; "longer" if it is unknown or
    too large to be advised."""
    if length_ratio is None or not 1 < length_ratio <= LARGEST_LENGTH_RATIO:
        return "longer"
    if length_ratio <= 1.5:
        return "about half as long again"
    step = 1 if length_ratio <= 10 else 10
    times = step * math.ceil(length_ratio / step - 0.05)
    return "about twice as long" if times == 2 else f"about {times} times as long"


def _power_of_ten(value: float) -> int:
    return math.floor(math.log10(abs(value)))
