"""Units of laboratory data: their factors to SI, their spellings, and where they stand in the name of a column."""

import re
from collections.abc import Mapping

from rig.errors import RigError
from rig.model.quantities import QUANTITIES

_POUND_FORCE = 4.4482216152605
FACTORS: dict[str, Mapping[str, float]] = {
    **{quantity.name: quantity.units for quantity in QUANTITIES.values()},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": _POUND_FORCE},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
}
"""Value of each unit in SI, by quantity."""
_PLAIN_BY_SPELLING = {
    "\u00b5": "u",
    "\u03bc": "u",
    "\u03b5": "strain",
    "\u00b2": "^2",
    "\u207b": "-",
    "\u00b7": "*",
    "**2": "^2",
    "/s2": "/s^2",
    "/s/s": "/s^2",
    "/sec^2": "/s^2",
    "*s^-2": "/s^2",
    "*s-2": "/s^2",
    " ": "",
}
_UNIT_BY_ALIAS = {
    "ms-2": "m/s^2",
    "ms-^2": "m/s^2",
    "ms^-2": "m/s^2",
    "m/ss": "m/s^2",
    "m/(s^2)": "m/s^2",
    "gn": "g",
    "g_n": "g",
    "G": "g",
    "ms-1": "m/s",
    "ms^-1": "m/s",
    "newton": "N",
    "Newton": "N",
    "lbs": "lbf",
    "S": "s",
    "sec": "s",
    "Sec": "s",
    "sek": "s",
    "Sek": "s",
    "Sek.": "s",
    "second": "s",
    "seconds": "s",
    "Seconds": "s",
    "Second": "s",
    "Sekunden": "s",
    "msec": "ms",
    "usec": "us",
    "microstrain": "ustrain",
    "uStrain": "ustrain",
    "ue": "ustrain",
    "strain": "m/m",
}
"""Other spellings of a whole unit."""
SCALED_UNITS = frozenset(
    {"V", "mV", "uV", "\u00b5V", "Volt", "Volts", "VOLT", "A", "mA", "-", "1", "EU", "counts", "mV/V", "pC"}
)
"""Units of a channel whose scale is not in the file."""
OTHER_UNITS = SCALED_UNITS | frozenset({
    "Ohm", "C", "degC", "\u00b0C", "\u00b0F", "K", "rpm", "1/min", "min^-1", "Hz", "kHz", "bar", "mbar", "Pa", "hPa",
    "kPa", "MPa", "psi", "deg", "\u00b0", "rad", "rad/s", "deg/s", "Nm", "kg", "kgf", "W",
})  # fmt: skip
"""Units that stand in files of measured data and belong to none of the quantities."""
MAX_HEADER_LENGTH = 200
"""Characters of a column's header in which a unit is looked for."""
_UNIT_IN_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({](?P<unit>[^\[\](){}]{1,20})[\])}]\s*$")
_UNIT_SEPARATOR = re.compile(r"\s*(?:/|,\s|\bin\b)\s*")
_UNIT_AFTER_UNDERSCORE = re.compile(r"^(?P<name>.*[^\W_])_(?P<unit>[^\W_]{1,3})$")


def si_factor(quantity: str, unit: str) -> float:
    """Factor from this unit to SI; raises RigError if the quantity has no such unit."""
    factor_by_unit = FACTORS[quantity]
    plain_unit = canonical_unit(unit)
    if plain_unit not in factor_by_unit:
        raise RigError(f"{unit!r} is no unit of {quantity}; give one of {', '.join(factor_by_unit)}")
    return factor_by_unit[plain_unit]


def canonical_unit(unit: str) -> str:
    """Unit in a canonical spelling: m/s², m/s**2, ms^-2 and m/s2 become m/s^2, µm becomes um, Sek becomes s."""
    for spelling, plain_spelling in _PLAIN_BY_SPELLING.items():
        unit = unit.replace(spelling, plain_spelling)
    return _UNIT_BY_ALIAS.get(unit, unit)


def quantity_of(unit: str | None) -> str | None:
    """Quantity that has this unit, also force and time; None if there is none."""
    plain_unit = canonical_unit(unit or "")
    return next((quantity for quantity, factor_by_unit in FACTORS.items() if plain_unit in factor_by_unit), None)


def is_unit(text: str) -> bool:
    """True if a text is a unit, of a known quantity or another."""
    return quantity_of(text) is not None or text in OTHER_UNITS


def name_and_unit(header: str, guess: bool = False) -> tuple[str, str | None]:
    """Name and unit of a column's header: "acc tip [m/s^2]", "F (N)", "x_1 / mm"; the unit None if it has none.

    A word in square brackets is a unit whatever it is, one in others or after a slash or comma only if it is known.
    With `guess` so is one after an underscore, as in "time_s".
    """
    if len(header) > MAX_HEADER_LENGTH:
        return header, None
    if (match := _UNIT_IN_BRACKETS.match(header)) and match["name"]:
        unit = match["unit"].strip()
        if not unit.isdigit() and (is_unit(unit) or header.rstrip().endswith("]")):
            return match["name"], unit
    for match in _UNIT_SEPARATOR.finditer(header):
        unit = header[match.end() :].strip()
        if match.start() and is_unit(unit) and not unit.isdigit():
            return header[: match.start()], unit
    if guess and (match := _UNIT_AFTER_UNDERSCORE.match(header)):
        unit = match["unit"]
        if is_unit(unit) and not unit.isdigit() and unit not in ("h", "d"):  # acc_h is horizontal
            return match["name"], unit
    return header, None
