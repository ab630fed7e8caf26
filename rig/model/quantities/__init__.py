"""What sensors measure. One file each: adding a quantity is adding a file, which is found by itself."""

from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Literal

from rig.model.quantities.base import Quantity

__all__ = ["QUANTITIES", "Quantity", "QuantityName"]

QUANTITIES: dict[str, Quantity] = {
    one.name: one
    for module in iter_modules(__path__, f"{__name__}.")
    for one in vars(import_module(module.name)).values()
    if isinstance(one, Quantity)
}
"""Every quantity by the name that rig.json calls it."""

if TYPE_CHECKING:
    QuantityName = str
else:
    QuantityName = Literal[tuple(QUANTITIES)]
