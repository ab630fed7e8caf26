"""Units of laboratory data and their factors to SI."""

from collections.abc import Mapping

from rig.errors import RigError
from rig.model.quantities import QUANTITIES

_POUND_FORCE = 4.4482216152605
FACTORS: dict[str, Mapping[str, float]] = {
    **{q.name: q.units for q in QUANTITIES.values()},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": _POUND_FORCE},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
}
"""Value of each unit in SI, by quantity."""
_SPELLINGS = {"\u00b5": "u", "\u03bc": "u", "\u00b2": "^2", "**2": "^2", "/s2": "/s^2", "/s/s": "/s^2", " ": ""}


def si_factor(quantity: str, unit: str) -> float:
    """Factor from this unit to SI; raises RigError if the quantity has no such unit."""
    factors = FACTORS[quantity]
    plain = plainly(unit)
    if plain not in factors:
        raise RigError(f"{unit!r} is no unit of {quantity}; give one of {', '.join(factors)}")
    return factors[plain]


def plainly(unit: str) -> str:
    """Unit in a canonical spelling: m/s², m/s**2 and m/s2 become m/s^2, µm becomes um."""
    for spelling, plain in _SPELLINGS.items():
        unit = unit.replace(spelling, plain)
    return unit
