"""The contact laws. One file each: adding a law is adding a file, which is found by itself."""

from typing import TYPE_CHECKING, Union

from rig.model.contact_laws.base import ContactLaw, penetration_m, stop_positions_m_and_sides
from rig.model.contact_laws.dead_zone import DeadZone
from rig.registry import subclasses

__all__ = ["LAWS", "PLANE_LAWS", "AnyLaw", "ContactLaw", "DeadZone", "penetration_m", "stop_positions_m_and_sides"]

LAWS: dict[str, type[ContactLaw]] = {
    str(tag): kind for kind in subclasses(__path__, __name__, ContactLaw) if (tag := kind.__struct_config__.tag)
}
"""Every law by the `type` that rig.json calls it."""
PLANE_LAWS = tuple(law for law in LAWS.values() if not law.spatial)
"""Laws of one direction."""

if TYPE_CHECKING:
    AnyLaw = ContactLaw
else:
    AnyLaw = Union[tuple(LAWS.values())]  # noqa: UP007 - made at run time
