"""JSON Schema of rig.json, from the types that it is read into, for editors that complete and check it."""

from inspect import cleandoc
from typing import Any

import msgspec

from rig.model.contact_laws import DeadZone
from rig.model.contact_laws.base import CLEARANCES
from rig.model.description import GROUND, Contact, Rig, Sensor, Station
from rig.model.nodes import NODE_KEY, POSITION_KEY
from rig.model.rig_json import SCHEMA_KEY
from rig.model.structure import ShapeRow, Structure

JSON_SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema_of(struct_type: type[msgspec.Struct], title: str) -> dict[str, Any]:
    """JSON Schema of a type's JSON, with the object itself at the top."""
    schema = msgspec.json.schema(struct_type)
    definitions = schema["$defs"]
    for definition in definitions.values():
        if "description" in definition:
            definition["description"] = cleandoc(definition["description"])
    object_schema = definitions.pop(struct_type.__name__)
    return {SCHEMA_KEY: JSON_SCHEMA_DIALECT, **object_schema, "title": title, "$defs": definitions}


def rig_schema() -> dict[str, Any]:
    """JSON Schema of rig.json.

    The types leave out what `rig.model.description.from_json` takes besides: null for a stop that is not there,
    "ground", a law without a type, stations by the names of nodes, and the key that names the schema.
    """
    schema = schema_of(Rig, "rig.json")
    definitions = schema["$defs"]
    for definition in definitions.values():
        for field_name, clearance_schema in definition.get("properties", {}).items():
            if field_name in CLEARANCES:
                clearance_schema["type"] = ["number", "null"]
                clearance_schema["description"] = "Clearance, m; null where there is no stop on that side."
    definitions[DeadZone.__name__]["required"].remove("type")
    against_schema = definitions[Contact.__name__]["properties"]["against"]
    against_schema["anyOf"].append({"const": GROUND})
    against_schema["default"] = GROUND
    station_schema = definitions[Sensor.__name__]["properties"]["station"]
    force_at_schema = schema["properties"]["force_at"]
    station_schema["anyOf"] = [{"$ref": station_schema.pop("$ref")}, {"const": GROUND}]
    force_at_schema["anyOf"].append({"const": GROUND})
    force_at_schema["default"] = GROUND
    schema["properties"][SCHEMA_KEY] = {"type": "string"}
    _allow_node_names(definitions)
    return schema


def _allow_node_names(definitions: dict[str, Any]) -> None:
    """Let stations and rows of shapes have a node's name, or its number, in place of a position."""
    named = {"type": ["string", "integer"], "description": "Name of a node of the structure, in place of position_m."}
    station_schema, row_schema = definitions[Station.__name__], definitions[ShapeRow.__name__]
    for definition in (station_schema, row_schema):
        definition["properties"][NODE_KEY] = named
    row_schema["required"].remove(POSITION_KEY)
    row_schema["anyOf"] = [{"required": [POSITION_KEY]}, {"required": [NODE_KEY]}]
    definitions[Structure.__name__]["required"].remove("length_m")
