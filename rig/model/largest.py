"""Largest number in a sample or in a description."""

import math
from typing import Any

from rig.errors import RigError

LARGEST = 1e30
"""No sensor measures more, in any unit; what is larger overflows in the squares of squares."""


def check_largest(given: Any, source: str) -> None:
    """Raises RigError if a number in what was decoded from JSON is beyond what anything is; its place is named."""
    left: list[tuple[tuple[Any, ...], Any]] = [((), given)]
    while left:
        place, value = left.pop()
        if isinstance(value, dict):
            left.extend(((place, f".{key}"), inner) for key, inner in value.items())
        elif isinstance(value, list):
            left.extend(((place, f"[{number}]"), inner) for number, inner in enumerate(value))
        elif isinstance(value, int | float) and abs(value) > LARGEST:
            raise RigError(
                f"{source}: {_name(place)} is about 1e{math.log10(abs(value)):.0f}, which nothing is; correct it"
            )


def _name(place: tuple[Any, ...]) -> str:
    """bodies[0].mass_kg, from the innermost key outwards."""
    keys = []
    while place:
        place, key = place
        keys.append(key)
    return "".join(reversed(keys)).removeprefix(".")
