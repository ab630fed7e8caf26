"""Transverse acceleration: accelerometer."""

from rig.model.quantities.base import METRES_BY_UNIT, Quantity

STANDARD_GRAVITY = 9.80665

ACCELERATION = Quantity(
    "acceleration",
    "m/s^2",
    {f"{unit}/s^2": m for unit, m in METRES_BY_UNIT.items()} | {"g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY},
    order=2,
    ac_coupled=True,
    uff_kind=12,
    largest=1e7,
)
