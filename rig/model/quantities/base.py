"""Base of quantities: the measurement operator from a body's transverse motion to the channel's unit."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

Row = Float[np.ndarray, " coordinates"]
Derivatives = Float[np.ndarray, "3 coordinates"]
"""Rows of w, its slope w' and its curvature w'' at a place, over the coordinates."""
METRES_BY_UNIT: Mapping[str, float] = {
    "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "ft": 0.3048, "in": 0.0254, "mil": 2.54e-5,
}  # fmt: skip


def displacement_row(derivatives: Derivatives, _: float) -> Row:
    """Operator of a sensor of w itself: the row of w at its place."""
    return derivatives[0]


def printed_unit(unit: str) -> str:
    """Unit with superscripts, for figures, pages and views: m/s² for m/s^2."""
    return unit.replace("^2", "²").replace("^3", "³")


@dataclass(frozen=True)
class Quantity:
    """d^order/dt^order of a linear operator on w(x): with w = sum shapes(x) q, one row over the coordinates q.

    `operator` makes the row from those of w, w' and w'' at the sensor's place, and the distance of a strain gauge from
    the neutral fibre. `units` are what laboratories write, with their values in `unit`, which is SI.
    """

    name: str
    unit: str
    units: Mapping[str, float]
    order: int
    operator: Callable[[Derivatives, float], Row] = displacement_row
    ac_coupled: bool = False
    """Whether its sensors have a high-pass (IEPE)."""
    uff_kind: int = 0
    """Data type in universal file format 58; 0: general."""
    largest: float = math.inf
    """Largest value on any test rig, in `unit`."""
    translates: bool = field(init=False)
    """Whether it depends on w itself; other quantities show neither a moving base nor a single mass."""
    bends: bool = field(init=False)
    """Whether it depends on the curvature."""

    def __post_init__(self) -> None:
        for flag_name, unit_derivatives in (("translates", (1.0, 0.0, 0.0)), ("bends", (0.0, 0.0, 1.0))):
            object.__setattr__(self, flag_name, bool(np.any(self.operator(np.array(unit_derivatives)[:, None], 1.0))))
