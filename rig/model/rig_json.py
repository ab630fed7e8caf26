"""Words of rig.json that stand for values of the types: "ground", null for no stop, a law without a type."""

import math
from typing import Any

from rig.errors import RigError, hint
from rig.model.components import GROUND
from rig.model.contact_laws.base import CLEARANCES
from rig.model.nodes import set_node_positions

SCHEMA_KEY = "$schema"
"""Key that names the JSON Schema of rig.json, which is read over."""


def normalised_rig_json(decoded: Any) -> Any:
    """Description in the values of the types: a law without a type is a dead zone, a clearance of null infinite, and
    "ground" no station of a contact and the ground's of a sensor; nodes' names are their positions
    (`rig.model.nodes`). The name of its JSON Schema is left out.

    Raises RigError, without the file's name, for another word than "ground", and for an unknown node.
    """
    if not isinstance(decoded, dict):
        return decoded
    decoded.pop(SCHEMA_KEY, None)
    if _is_ground_word(decoded.get("force_at"), "force_at"):
        del decoded["force_at"]
    for index, sensor in enumerate(_objects_in(decoded, "sensors")):
        if _is_ground_word(sensor.get("station"), f"sensors[{index}].station"):
            sensor["station"] = {"body": GROUND}
    for index, contact in enumerate(_objects_in(decoded, "contacts")):
        if _is_ground_word(contact.get("against"), f"contacts[{index}].against"):
            contact["against"] = None
        if isinstance(law := contact.get("law"), dict):
            law.setdefault("type", "dead_zone")
            law |= {field: math.inf for field in CLEARANCES if field in law and law[field] is None}
    set_node_positions(decoded)
    return decoded


def _is_ground_word(value: Any, key: str) -> bool:
    """True for the word "ground" in place of a station; raises RigError for another word."""
    if isinstance(value, str) and value != GROUND:
        raise RigError(
            f"{key} is {value!r}{hint(value, [GROUND])}; give a station, "
            f'{{"body": ..., "position_m": ...}}, or {GROUND!r}'
        )
    return isinstance(value, str)


def _objects_in(decoded: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Objects of a list in a JSON object; empty if it is no such list, which its type refuses."""
    items = decoded.get(key)
    return [item for item in items if isinstance(item, dict)] if isinstance(items, list) else []
