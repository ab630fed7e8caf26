"""JSON Schema of rig.json, from the types that it is read into, for editors that complete and check it."""

from inspect import cleandoc
from typing import Any

import msgspec

from rig.model.contact_laws import DeadZone
from rig.model.contact_laws.base import CLEARANCES
from rig.model.description import GROUND, Contact, Rig, Sensor, Station
from rig.model.nodes import NODE, POSITION
from rig.model.rig_json import SCHEMA_KEY
from rig.model.structure import ShapeRow, Structure

JSON_SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema_of(kind: type[msgspec.Struct], title: str) -> dict[str, Any]:
    """JSON Schema of a type's JSON, with the object itself at the top."""
    schema = msgspec.json.schema(kind)
    definitions = schema["$defs"]
    for definition in definitions.values():
        if "description" in definition:
            definition["description"] = cleandoc(definition["description"])
    top = definitions.pop(kind.__name__)
    return {SCHEMA_KEY: JSON_SCHEMA_DIALECT, **top, "title": title, "$defs": definitions}


def rig_schema() -> dict[str, Any]:
    """JSON Schema of rig.json.

    The types leave out what `rig.model.description.from_json` takes besides: null for a stop that is not there,
    "ground", a law without a type, stations by the names of nodes, and the key that names the schema.
    """
    schema = schema_of(Rig, "rig.json")
    definitions = schema["$defs"]
    for definition in definitions.values():
        for name, clearance in definition.get("properties", {}).items():
            if name in CLEARANCES:
                clearance["type"] = ["number", "null"]
                clearance["description"] = "Clearance, m; null where there is no stop on that side."
    definitions[DeadZone.__name__]["required"].remove("type")
    against = definitions[Contact.__name__]["properties"]["against"]
    against["anyOf"].append({"const": GROUND})
    against["default"] = GROUND
    station = definitions[Sensor.__name__]["properties"]["station"]
    force_at = schema["properties"]["force_at"]
    station["anyOf"] = [{"$ref": station.pop("$ref")}, {"const": GROUND}]
    force_at["anyOf"].append({"const": GROUND})
    force_at["default"] = GROUND
    schema["properties"][SCHEMA_KEY] = {"type": "string"}
    _name_nodes(definitions)
    return schema


def _name_nodes(definitions: dict[str, Any]) -> None:
    """Let stations and rows of shapes have a node's name, or its number, in place of a position."""
    named = {"type": ["string", "integer"], "description": "Name of a node of the structure, in place of position_m."}
    station, row = definitions[Station.__name__], definitions[ShapeRow.__name__]
    for definition in (station, row):
        definition["properties"][NODE] = named
    row["required"].remove(POSITION)
    row["anyOf"] = [{"required": [POSITION]}, {"required": [NODE]}]
    definitions[Structure.__name__]["required"].remove("length_m")
