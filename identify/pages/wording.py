"""Numbers as text, for the pages, the figures and the screen."""

import math

from rig.model.quantities import printed_unit

COVERED = 1.96
"""Half-width of the 95 % interval of a normal distribution in standard errors."""


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
    half_width = COVERED * standard_error
    unit_text = "" if unit == "1" else f" {printed_unit(unit)}"
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


def _power_of_ten(value: float) -> int:
    return math.floor(math.log10(abs(value)))
