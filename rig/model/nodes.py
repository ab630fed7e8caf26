"""Places of a modal basis by the names of its nodes, as rig.json may give them instead of positions.

A row of shapes may have a name, `"node": "17"`, and a station may give it, `{"body": "plate", "node": "17"}`. Where no
row of a structure has a position (the points of a plate have no common axis), its positions are the numbers of the rows
from 0, which stand for the names alone: `has_axis` of such a structure is false, and its length is their range.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from rig.errors import RigError, hint
from rig.model.structure import Structure

NODE_KEY, POSITION_KEY = "node", "position_m"
MAX_LISTED_NODES = 12
"""Nodes that an error lists where no name is near."""


def set_node_positions(decoded: Mapping[str, Any]) -> None:
    """Set the positions of the rows and stations of a decoded rig.json that are given by a node's name.

    Raises RigError, without the file's name, of a name that the basis lacks or has twice, and of a station with both a
    name and another position.
    """
    bodies = decoded.get("bodies")
    positions_by_body: dict[str, dict[str, float]] = {}
    for body_number, body in enumerate(bodies if isinstance(bodies, list) else []):
        if isinstance(body, dict) and body.get("type") == Structure.__struct_config__.tag:
            positions_by_body[str(body.get("name"))] = _node_positions_m(f"bodies[{body_number}]", body)
    for json_place, station in _node_stations({key: value for key, value in decoded.items() if key != "bodies"}, ""):
        _set_position(json_place, station, positions_by_body)


def _node_positions_m(json_place: str, body: dict[str, Any]) -> dict[str, float]:
    """Positions by the names of the nodes of a structure, whose rows get positions where none has one."""
    rows = body.get("shapes")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        return {}
    for row in rows:
        _name_as_text(row)
    if rows and all(NODE_KEY in row and POSITION_KEY not in row for row in rows):
        for index, row in enumerate(rows):
            row[POSITION_KEY] = float(index)
        body["length_m"] = max(float(len(rows) - 1), 1.0)
        body["has_axis"] = False
    named_rows = [row for row in rows if isinstance(row.get(NODE_KEY), str) and POSITION_KEY in row]
    node_names = [row[NODE_KEY] for row in named_rows]
    if duplicates := [node_name for node_name in node_names if node_names.count(node_name) > 1]:
        raise RigError(f"{json_place}.shapes: more than one node is named {duplicates[0]!r}; names must differ")
    return {row[NODE_KEY]: row[POSITION_KEY] for row in named_rows}


def _node_stations(json_value: Any, json_place: str, level_count: int = 4) -> Iterator[tuple[str, dict[str, Any]]]:
    """Stations with a node, and their places in the description, to so many levels."""
    if isinstance(json_value, dict) and "body" in json_value and NODE_KEY in json_value:
        yield json_place, json_value
    if not level_count:
        return
    if isinstance(json_value, dict):
        for key, json_child in json_value.items():
            yield from _node_stations(json_child, f"{json_place}.{key}" if json_place else str(key), level_count - 1)
    elif isinstance(json_value, list):
        for index, json_child in enumerate(json_value):
            yield from _node_stations(json_child, f"{json_place}[{index}]", level_count - 1)


def _set_position(place: str, station: dict[str, Any], positions_by_body: Mapping[str, Mapping[str, float]]) -> None:
    _name_as_text(station)
    body_name, node_name = str(station["body"]), station.pop(NODE_KEY)
    if not isinstance(node_name, str):
        raise RigError(f"{place}.node is {node_name!r}; give the name of a node, as text or number")
    nodes = positions_by_body.get(body_name, {})
    if not nodes:
        raise RigError(f"{place}.node is {node_name!r}, and {body_name!r} has no nodes with names; give position_m")
    if node_name not in nodes:
        listed_names = ", ".join(list(nodes)[:MAX_LISTED_NODES]) + (", ..." if len(nodes) > MAX_LISTED_NODES else "")
        raise RigError(
            f"{place}.node is {node_name!r}{hint(node_name, nodes)}; the modal basis of {body_name!r} has "
            f"{listed_names}"
        )
    if station.setdefault(POSITION_KEY, nodes[node_name]) != nodes[node_name]:
        raise RigError(
            f"{place} gives node {node_name!r}, which stands at {nodes[node_name]} m, and position_m "
            f"{station[POSITION_KEY]}; leave one out"
        )


def _name_as_text(named_object: dict[str, Any]) -> None:
    """Take a node's number as its name."""
    if isinstance(named_object.get(NODE_KEY), int) and not isinstance(named_object[NODE_KEY], bool):
        named_object[NODE_KEY] = str(named_object[NODE_KEY])


def place_name(body: Any, position_m: float) -> str:
    """Position on a body in words; the name of the node where the places of a modal basis have no axis."""
    node_name = None if not isinstance(body, Structure) or body.has_axis else body.node_at(position_m)
    return f"{position_m:g} m" if node_name is None else f"node {node_name}"
