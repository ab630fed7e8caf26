"""Units of laboratory data: their factors to SI, their spellings, and where they stand in the name of a column."""

import re
from collections.abc import Mapping

from rig.errors import RigError
from rig.model.quantities import QUANTITIES

_KILOGRAM_FORCE, _POUND_FORCE = 9.80665, 4.4482216152605
FACTORS: dict[str, Mapping[str, float]] = {
    **{quantity.name: quantity.units for quantity in QUANTITIES.values()},
    "force": {
        "N": 1.0, "uN": 1e-6, "mN": 1e-3, "daN": 10.0, "kN": 1e3, "MN": 1e6, "dyn": 1e-5,
        "gf": 1e-3 * _KILOGRAM_FORCE, "kgf": _KILOGRAM_FORCE, "tf": 1e3 * _KILOGRAM_FORCE,
        "ozf": _POUND_FORCE / 16, "lbf": _POUND_FORCE, "kip": 1e3 * _POUND_FORCE,
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
}  # fmt: skip
"""Value of each unit in SI, by quantity."""
_PLAIN_BY_SPELLING = {
    "\u00b5": "u",
    "\u03bc": "u",
    "\u03b5": "strain",
    "\u00b2": "^2",
    "\u207b": "-",
    "\u00b7": "*",
    "\u2019": "'",
    "**2": "^2",
    "/seconds": "/s",
    "/second": "/s",
    "/sec": "/s",
    "/s2": "/s^2",
    "/s/s": "/s^2",
    "*s^-2": "/s^2",
    "*s-^2": "/s^2",
    "*s-2": "/s^2",
    " ": "",
}
_SPELLINGS_BY_UNIT = {
    "m/s^2": "ms-2 ms-^2 ms^-2 m.s-2 m.s^-2 m/ss m/(s^2)",
    "m/s": "ms-1 ms^-1 m.s-1 mps",
    "cm/s^2": "Gal gal Gals gals",
    "g": "gn g_n G g's gs Gs G's gee gees",
    "ft/s": "fps",
    "in/s": "ips",
    "in/s^2": "ips^2 ips2 ips/s",
    "m": "meter meters metre metres",
    "mm": "millimeter millimeters millimetre millimetres",
    "um": "micron microns micrometer micrometers micrometre micrometres",
    "ft": "foot feet",
    "in": 'inch inches "',
    "mil": "mils thou thous",
    "N": "newton newtons",
    "kN": "KN kilonewton kilonewtons",
    "daN": "DAN dan decanewton",
    "dyn": "dyne dynes",
    "kgf": "kp kg_f kg-f kgforce kilopond",
    "gf": "gramforce pond",
    "lbf": "lb lbs pound pounds lb_f lb-f lbsf lbfs #f poundforce pound-force poundsforce",
    "ozf": "oz ounce ounces ounceforce",
    "kip": "kips klbf klb klbs",
    "s": "S sec sek sek. second seconds sekunde sekunden",
    "ms": "msec msecs millisecond milliseconds millisekunden",
    "us": "usec usecs microsecond microseconds mikrosekunden",
    "min": "minute minutes minuten",
    "ustrain": "microstrain ue ustrains",
    "m/m": "strain",
}
_UNIT_BY_ALIAS = {alias: unit for unit, aliases in _SPELLINGS_BY_UNIT.items() for alias in aliases.split()}
"""Other spellings of a whole unit, or of the length in one; words of three and more letters in any case."""
MASS_UNITS = frozenset({
    "kg", "KG", "Kg", "kgs", "kilogram", "kilograms", "lb", "LB", "lbs", "LBS", "pound", "pounds", "oz", "OZ", "ounce",
    "ounces",
})  # fmt: skip
"""Units of mass that stand for its weight; kg only of what is a force by its name."""
SCALED_UNITS = frozenset(
    {"V", "mV", "uV", "\u00b5V", "Volt", "Volts", "VOLT", "A", "mA", "-", "1", "EU", "counts", "mV/V", "pC"}
)
"""Units of a channel whose scale is not in the file."""
FOREIGN_UNITS = frozenset({
    "Ohm", "C", "degC", "\u00b0C", "\u00b0F", "degF", "K", "rpm", "1/min", "min^-1", "Hz", "kHz", "bar", "mbar", "Pa",
    "hPa", "kPa", "MPa", "psi", "deg", "\u00b0", "rad", "rad/s", "deg/s", "\u00b0/s", "rad/s^2", "deg/s^2", "Nm",
    "N*m", "W", "kW", "dB", "%RH",
})  # fmt: skip
"""Units of quantities that no sensor of a rig measures."""
OTHER_UNITS = SCALED_UNITS | FOREIGN_UNITS | MASS_UNITS
"""Units that stand in files of measured data and belong to none of the quantities."""
_NO_UNIT_WORDS = {"", "none", "n/a", "unknown", "undefined", "no unit", "(null)", "null", "?"}
MAX_HEADER_LENGTH = 200
"""Characters of a column's header in which a unit is looked for."""
_UNIT_IN_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({](?P<unit>[^\[\](){}]{1,20})[\])}]\s*$")
_UNIT_SEPARATOR = re.compile(r"\s*(?:/|,\s|\bin\b)\s*")
_UNIT_AFTER_UNDERSCORE = re.compile(r"^(?P<name>.*[^\W_])_(?P<unit>[^\W_]{1,3})$")


def si_factor(quantity: str, unit: str) -> float:
    """Factor from this unit to SI; raises RigError if the quantity has no such unit."""
    factor_by_unit = FACTORS[quantity]
    plain_unit = unit_of_force(unit) if quantity == "force" else canonical_unit(unit)
    if plain_unit not in factor_by_unit:
        raise RigError(f"{unit!r} is no unit of {quantity}; give one of {', '.join(factor_by_unit)}")
    return factor_by_unit[plain_unit]


def canonical_unit(unit: str) -> str:
    """Unit in a canonical spelling: m/s², m/s**2, ms^-2 and m/s2 become m/s^2, µm um, Sek s, lb and lbs lbf."""
    for spelling, plain_spelling in _PLAIN_BY_SPELLING.items():
        unit = unit.replace(spelling, plain_spelling)
    length, slash, per_time = unit.partition("/")
    plain_unit = _UNIT_BY_ALIAS.get(unit) or _known_word(unit) or f"{_known_word(length) or length}{slash}{per_time}"
    is_in_capitals = plain_unit.isupper() and not _is_known(plain_unit) and not plain_unit.startswith("NM")  # newtons
    lower_case_unit = canonical_unit(plain_unit.lower()) if is_in_capitals else plain_unit
    return lower_case_unit if _is_known(lower_case_unit) else plain_unit


def unit_of_force(unit: str) -> str:
    """Canonical unit of what is known to be a force, in which kg stands for kgf."""
    plain_unit = canonical_unit(unit)
    return "kgf" if unit in MASS_UNITS and not _is_known(plain_unit) else plain_unit


def stated_unit(text: str | None) -> str | None:
    """Unit in a field of a file; None if the field is empty or says that there is none."""
    unit = (text or "").strip().strip("[]").strip()
    return None if unit.lower() in _NO_UNIT_WORDS else unit


def quantity_of(unit: str | None) -> str | None:
    """Quantity that has this unit, also force and time; None if there is none."""
    plain_unit = canonical_unit(unit or "")
    return next((quantity for quantity, factor_by_unit in FACTORS.items() if plain_unit in factor_by_unit), None)


def _is_known(plain_unit: str) -> bool:
    return any(plain_unit in factor_by_unit for factor_by_unit in FACTORS.values())


def _known_word(word: str) -> str | None:
    """Unit that a word of three and more characters spells in any case."""
    return _UNIT_BY_ALIAS.get(word.lower()) if len(word) > 2 else None


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
