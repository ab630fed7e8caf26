"""Transverse velocity: laser vibrometer, geophone."""

from rig.model.quantities.base import METRES_BY_UNIT, Quantity

VELOCITY = Quantity(
    "velocity", "m/s", {f"{unit}/s": m for unit, m in METRES_BY_UNIT.items()}, order=1, uff_kind=11, largest=1e4
)
