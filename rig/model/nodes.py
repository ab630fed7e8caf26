"""Places of a modal basis by the names of its nodes, as rig.json may give them instead of positions.

A row of shapes may have a name, `"node": "17"`, and a station may give it, `{"body": "plate", "node": "17"}`. Where no
row of a structure has a position (the points of a plate have no common axis), its positions are the numbers of the rows
from 0, which stand for the names alone: `has_axis` of such a structure is false, and its length is their range.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from rig.errors import RigError, hint
from rig.model.structure import Structure

NODE, POSITION = "node", "position_m"
MAX_LISTED = 12
"""Nodes that an error lists where no name is near."""


def with_positions(decoded: Mapping[str, Any]) -> None:
    """Set the positions of the rows and stations of a decoded rig.json that are given by a node's name.

    Raises RigError, without the file's name, of a name that the basis lacks or has twice, and of a station with both a
    name and another position.
    """
    bodies = decoded.get("bodies")
    positions_by_body: dict[str, dict[str, float]] = {}
    for body_number, body in enumerate(bodies if isinstance(bodies, list) else []):
        if isinstance(body, dict) and body.get("type") == Structure.__struct_config__.tag:
            positions_by_body[str(body.get("name"))] = _nodes(f"bodies[{body_number}]", body)
    for json_place, station in _stations({key: value for key, value in decoded.items() if key != "bodies"}, ""):
        _set_position(json_place, station, positions_by_body)


def _nodes(json_place: str, body: dict[str, Any]) -> dict[str, float]:
    """Positions by the names of the nodes of a structure, whose rows get positions where none has one."""
    rows = body.get("shapes")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        return {}
    for row in rows:
        _name_as_text(row)
    if rows and all(NODE in row and POSITION not in row for row in rows):
        for index, row in enumerate(rows):
            row[POSITION] = float(index)
        body["length_m"] = max(float(len(rows) - 1), 1.0)
        body["has_axis"] = False
    named_rows = [row for row in rows if isinstance(row.get(NODE), str) and POSITION in row]
    names = [row[NODE] for row in named_rows]
    if duplicates := [name for name in names if names.count(name) > 1]:
        raise RigError(f"{json_place}.shapes: more than one node is named {duplicates[0]!r}; names must differ")
    return {row[NODE]: row[POSITION] for row in named_rows}


def _stations(value: Any, json_place: str, depth: int = 4) -> Iterator[tuple[str, dict[str, Any]]]:
    """Stations with a node, and their places in the description, to so many levels."""
    if isinstance(value, dict) and "body" in value and NODE in value:
        yield json_place, value
    if not depth:
        return
    if isinstance(value, dict):
        for key, child in value.items():
            yield from _stations(child, f"{json_place}.{key}" if json_place else str(key), depth - 1)
    elif isinstance(value, list):
        for index, child in enumerate(value):
            yield from _stations(child, f"{json_place}[{index}]", depth - 1)


def _set_position(place: str, station: dict[str, Any], positions_by_body: Mapping[str, Mapping[str, float]]) -> None:
    _name_as_text(station)
    body_name, node_name = str(station["body"]), station.pop(NODE)
    if not isinstance(node_name, str):
        raise RigError(f"{place}.node is {node_name!r}; give the name of a node, as text or number")
    nodes = positions_by_body.get(body_name, {})
    if not nodes:
        raise RigError(f"{place}.node is {node_name!r}, and {body_name!r} has no nodes with names; give position_m")
    if node_name not in nodes:
        listed_names = ", ".join(list(nodes)[:MAX_LISTED]) + (", ..." if len(nodes) > MAX_LISTED else "")
        raise RigError(
            f"{place}.node is {node_name!r}{hint(node_name, nodes)}; the modal basis of {body_name!r} has "
            f"{listed_names}"
        )
    if station.setdefault(POSITION, nodes[node_name]) != nodes[node_name]:
        raise RigError(
            f"{place} gives node {node_name!r}, which stands at {nodes[node_name]} m, and position_m "
            f"{station[POSITION]}; leave one out"
        )


def _name_as_text(value: dict[str, Any]) -> None:
    """Take a node's number as its name."""
    if isinstance(value.get(NODE), int) and not isinstance(value[NODE], bool):
        value[NODE] = str(value[NODE])


def place_name(body: Any, position_m: float) -> str:
    """Position on a body in words; the name of the node where the places of a modal basis have no axis."""
    node = None if not isinstance(body, Structure) or body.has_axis else body.node_at(position_m)
    return f"{position_m:g} m" if node is None else f"node {node}"
