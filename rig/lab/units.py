"""The units in which a laboratory writes its numbers, and what makes them SI."""

from rig.errors import RigError

STANDARD_GRAVITY = 9.80665
_INCH = 0.0254
_POUND_FORCE = 4.4482216152605
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": _INCH}
FACTORS: dict[str, dict[str, float]] = {
    "displacement": _LENGTHS,
    "velocity": {f"{unit}/s": factor for unit, factor in _LENGTHS.items()},
    "acceleration": {
        **{f"{unit}/s^2": factor for unit, factor in _LENGTHS.items()},
        "g": STANDARD_GRAVITY,
        "mg": 1e-3 * STANDARD_GRAVITY,
    },
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": _POUND_FORCE},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
}
"""By quantity: the unit's value in SI."""
_SPELLINGS = {"\u00b5": "u", "\u03bc": "u", "\u00b2": "^2", "**2": "^2", "/s2": "/s^2", "/s/s": "/s^2", " ": ""}


def si_factor(quantity: str, unit: str) -> float:
    """What a number in this unit is multiplied by to be SI; raises RigError if the quantity has no such unit."""
    known = FACTORS[quantity]
    plain = plainly(unit)
    if plain not in known:
        raise RigError(f"{unit!r} is no unit of {quantity}; give one of {', '.join(known)}")
    return known[plain]


def plainly(unit: str) -> str:
    """The unit in one spelling: m/s², m/s**2 and m/s2 are m/s^2, µm is um."""
    for spelling, plain in _SPELLINGS.items():
        unit = unit.replace(spelling, plain)
    return unit
