"""The contact laws. One file each: adding a law is adding a file, which is found by itself."""

from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Union

from rig.model.contact_laws.base import ContactLaw, penetration_m
from rig.model.contact_laws.dead_zone import DeadZone

__all__ = ["LAWS", "AnyLaw", "ContactLaw", "DeadZone", "penetration_m"]

LAWS: dict[str, type[ContactLaw]] = {
    str(kind.__struct_config__.tag): kind
    for module in iter_modules(__path__, f"{__name__}.")
    for kind in vars(import_module(module.name)).values()
    if isinstance(kind, type) and issubclass(kind, ContactLaw) and kind.__module__ == module.name
    if kind is not ContactLaw
}
"""Every law by the `type` that rig.json calls it."""

if TYPE_CHECKING:
    AnyLaw = ContactLaw
else:
    AnyLaw = Union[tuple(LAWS.values())]  # noqa: UP007 - made at run time
