"""How large a number may be, in a sample or in a description."""

import math
from typing import Any

from rig.errors import RigError

LARGEST = 1e30
"""No sensor measures more, in any unit; what is larger overflows in the squares of squares."""


def check_largest(given: Any, source: str, place: str = "") -> None:
    """Raises RigError if a number in what was decoded from JSON is beyond what anything is; places are named."""
    if isinstance(given, dict):
        for key, value in given.items():
            check_largest(value, source, f"{place}.{key}" if place else str(key))
    elif isinstance(given, list):
        for number, value in enumerate(given):
            check_largest(value, source, f"{place}[{number}]")
    elif isinstance(given, int | float) and abs(given) > LARGEST:
        raise RigError(f"{source}: {place} is about 1e{math.log10(abs(given)):.0f}, which nothing is; correct it")
