"""Modes of a rig's bodies as datasets of a UFF file: units (164), nodes (15) and mode shapes (55)."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from rig.model.description import Body, Rig, Station, rig_stations
from rig.model.modes import mode_count, modes_of

MAX_MODES_PER_BEAM = 24
"""Modes of a beam, as in a replay by the plant `modal`."""
PLACE_COUNT = 2 * MAX_MODES_PER_BEAM + 1
SAME_NODE_SHARE = 1e-4
"""Distance, relative to the length, below which two places are one node."""
NODES_PER_BODY = 1000
"""Numbering: node 2003 is the third of the second body."""


def node_number_by_station(rig: Rig) -> dict[Station, int]:
    """Node numbers: PLACE_COUNT nodes from end to end of a beam, the places of a modal basis, and all stations."""
    number_by_station: dict[Station, int] = {}
    stations = (*rig_stations(rig), *rig.forces)
    for body_number, body in enumerate(rig.bodies, start=1):
        positions_m = {station.position_m for station in stations if station.body == body.name}
        tolerance_m = SAME_NODE_SHARE * body.length_m
        positions_m |= {
            x_m
            for x_m in body.places(PLACE_COUNT).tolist()
            if all(abs(x_m - position_m) > tolerance_m for position_m in positions_m)
        }
        first_number = NODES_PER_BODY * body_number + 1
        number_by_station |= {
            Station(body.name, position_m): first_number + index for index, position_m in enumerate(sorted(positions_m))
        }
    return number_by_station


def mode_shapes(rig: Rig, node_by_station: Mapping[Station, int]) -> Iterator[dict[str, Any]]:
    """Shapes (1/sqrt(kg), modal mass one) in z at nodes along x, which count from each body's left end.

    As nothing but the contacts joins the bodies, each mode moves one of them, and holds the nodes of no other.
    """
    yield {"type": 164, "units_code": 1, "temp_mode": 1, "length": 1.0, "force": 1.0, "temp": 1.0, "temp_offset": 0.0}
    node_numbers, zeros = np.array([*node_by_station.values()]), np.zeros(len(node_by_station))
    x_m = np.array([station.position_m for station in node_by_station])
    zero_columns = {"def_cs": zeros, "disp_cs": zeros, "color": zeros}
    yield {"type": 15, "node_nums": node_numbers, **zero_columns, "x": x_m, "y": zeros, "z": zeros}
    for body in rig.bodies:
        body_nodes = {s.position_m: node for s, node in node_by_station.items() if s.body == body.name}
        yield from _mode_shape_datasets(rig, body, body_nodes)


def _mode_shape_datasets(rig: Rig, body: Body, node_by_position: Mapping[float, int]) -> Iterator[dict[str, Any]]:
    modes, taken_count = modes_of(rig, body), mode_count(body, MAX_MODES_PER_BEAM)
    shapes = modes.shapes(np.array([*node_by_position]), taken_count)
    mode_rows = zip(modes.frequencies_hz(taken_count), modes.damping_ratios(taken_count), shapes.T, strict=True)
    zeros = np.zeros(len(node_by_position))
    for mode_number, (frequency_hz, damping_ratio, shape) in enumerate(mode_rows, start=1):
        yield {
            "type": 55,
            "id1": f"{body.name} mode {mode_number}",
            "analysis_type": 2,  # normal mode
            "data_ch": 2,  # translations alone
            "spec_data_type": 8,  # displacement
            "load_case": 0,
            "mode_n": mode_number,
            "freq": float(frequency_hz),
            "modal_m": 1.0,
            "modal_damp_vis": float(damping_ratio),
            "modal_damp_his": 0.0,
            "node_nums": np.array([*node_by_position.values()]),
            "r1": zeros,
            "r2": zeros,
            "r3": shape,
        }
