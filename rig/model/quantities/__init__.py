"""Quantities that sensors measure. One file each: adding a quantity is adding a file, which is found by itself."""

from typing import TYPE_CHECKING, Literal

from rig.model.quantities.base import Quantity, printed_unit
from rig.registry import instances

__all__ = ["QUANTITIES", "Quantity", "QuantityName", "printed_unit"]

QUANTITIES: dict[str, Quantity] = {quantity.name: quantity for quantity in instances(__path__, __name__, Quantity)}
"""Every quantity by the name that rig.json calls it."""

if TYPE_CHECKING:
    QuantityName = str
else:
    QuantityName = Literal[tuple(QUANTITIES)]
