"""Transverse velocity: laser vibrometer, geophone."""

from rig.model.quantities.base import LENGTHS, Quantity

VELOCITY = Quantity(
    "velocity", "m/s", {f"{unit}/s": m for unit, m in LENGTHS.items()}, order=1, uff_kind=11, largest=1e4
)
