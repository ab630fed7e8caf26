"""Modes of a rig's bodies as datasets of a UFF file: units (164), nodes (15) and mode shapes (55)."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from rig.model.description import Body, Rig, Station, stations_of
from rig.model.modes import mode_count, modes_of

MODES = 24
"""Modes of a beam, as in a replay by the plant `modal`."""
PLACES = 2 * MODES + 1
SAME_NODE = 1e-4
"""Distance, relative to the length, below which two places are one node."""
NODES_PER_BODY = 1000
"""Numbering: node 2003 is the third of the second body."""


def nodes_of(rig: Rig) -> dict[Station, int]:
    """Node numbers: PLACES nodes from end to end of a beam, the places of a modal basis, and all stations."""
    numbers: dict[Station, int] = {}
    stations = (*stations_of(rig), *rig.forces)
    for count, body in enumerate(rig.bodies, start=1):
        places = {s.position_m for s in stations if s.body == body.name}
        tolerance_m = SAME_NODE * body.length_m
        places |= {x for x in body.places(PLACES).tolist() if all(abs(x - place) > tolerance_m for place in places)}
        first = NODES_PER_BODY * count + 1
        numbers |= {Station(body.name, place): first + k for k, place in enumerate(sorted(places))}
    return numbers


def mode_shapes(rig: Rig, nodes: Mapping[Station, int]) -> Iterator[dict[str, Any]]:
    """Shapes (1/sqrt(kg), modal mass one) in z at nodes along x, which count from each body's left end.

    As nothing but the contacts joins the bodies, each mode moves one of them, and holds the nodes of no other.
    """
    yield {"type": 164, "units_code": 1, "temp_mode": 1, "length": 1.0, "force": 1.0, "temp": 1.0, "temp_offset": 0.0}
    numbers, zero = np.array([*nodes.values()]), np.zeros(len(nodes))
    x = np.array([station.position_m for station in nodes])
    systems = {"def_cs": zero, "disp_cs": zero, "color": zero}
    yield {"type": 15, "node_nums": numbers, **systems, "x": x, "y": zero, "z": zero}
    for body in rig.bodies:
        yield from _of_body(rig, body, {s.position_m: n for s, n in nodes.items() if s.body == body.name})


def _of_body(rig: Rig, body: Body, nodes: Mapping[float, int]) -> Iterator[dict[str, Any]]:
    modes, count = modes_of(rig, body), mode_count(body, MODES)
    numbers, shapes = np.array([*nodes.values()]), modes.shapes(np.array([*nodes]), count)
    rows = zip(modes.frequencies_hz(count), modes.damping_ratios(count), shapes.T, strict=True)
    for number, (frequency_hz, ratio, shape) in enumerate(rows, start=1):
        yield _dataset(f"{body.name} mode {number}", number, float(frequency_hz), float(ratio), numbers, shape)


def _dataset(
    name: str, number: int, frequency_hz: float, ratio: float, nodes: np.ndarray, shape: Float[np.ndarray, " nodes"]
) -> dict[str, Any]:
    zero = np.zeros(shape.size)
    return {
        "type": 55,
        "id1": name,
        "analysis_type": 2,  # normal mode
        "data_ch": 2,  # translations alone
        "spec_data_type": 8,  # displacement
        "load_case": 0,
        "mode_n": number,
        "freq": frequency_hz,
        "modal_m": 1.0,
        "modal_damp_vis": ratio,
        "modal_damp_his": 0.0,
        "node_nums": nodes,
        "r1": zero,
        "r2": zero,
        "r3": shape,
    }
