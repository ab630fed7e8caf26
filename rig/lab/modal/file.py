"""The UFF file of a modal analysis, and the nodes of it that lie along a body."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.lab.column import UnreadableError
from rig.lab.uff import check_whole

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")


@dataclass(frozen=True)
class Choice:
    """Choice of what is read of a UFF file; None and () leave it to the file."""

    along: Axis | None = None
    direction: Axis | None = None
    nodes: tuple[int, ...] = ()
    positions_m: tuple[float, ...] = ()
    length_m: float | None = None
    band_hz: tuple[float, ...] = ()


@dataclass(frozen=True)
class UffFile:
    """The datasets of a file by type, its nodes' coordinates in metres, and what its units are of SI's."""

    path: Path
    sets: Mapping[int, list[dict[str, Any]]]
    nodes_m: Mapping[int, Float[np.ndarray, " 3"]]
    length: float
    force: float

    def wrong(self, sentence: str) -> RigError:
        return RigError(f"{self.path}: {sentence}")


def read_uff(path: Path) -> UffFile:
    """The datasets of a modal analysis; raises RigError if the file is none."""
    with needs_extra("lab", f"{path}: a UFF file"):
        import pyuff

    try:
        check_whole(path)
        reader = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in reader.get_set_types()]
        sets: dict[int, list[dict[str, Any]]] = {}
        for place, kind in enumerate(kinds):
            if kind in (15, 55, 58, 164, 2411):
                with np.errstate(all="ignore"):  # what is not finite is refused where it is used
                    sets.setdefault(kind, []).append(reader.read_sets(place))
        nodes = {
            int(node): np.array([x, y, z])
            for one in (*sets.get(15, []), *sets.get(2411, []))
            for node, x, y, z in zip(one["node_nums"], one["x"], one["y"], one["z"], strict=True)
        }
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror or error}); check the name") from error
    except UnreadableError as error:
        raise RigError(f"{path}: cannot be read as UFF ({error}); export it again") from error
    except Exception as error:  # what the format's library raises on a bad file is not to be listed
        raise RigError(f"{path}: cannot be read as UFF, whole or in part; export it again") from error
    units = sets.get(164, [{}])[-1]
    length, force = (float(units.get(name) or 1.0) for name in ("length", "force"))
    if not (0 < length < np.inf and 0 < force < np.inf):
        raise RigError(f"{path}: its units (dataset 164) are no numbers above zero; export it again")
    return UffFile(path, sets, {node: place / length for node, place in nodes.items()}, length, force)


def line_of(
    file: UffFile, choice: Choice, nodes: Iterable[int]
) -> tuple[tuple[int, ...], Float[np.ndarray, " places"], float, str]:
    """The nodes along the body, their places from its left end, its length, and a sentence on them."""
    wanted = choice.nodes or tuple(sorted(set(nodes)))
    if missing := sorted(set(wanted) - set(nodes)):
        raise file.wrong(f"has no data at node {missing[0]}; leave it out of nodes")
    if choice.positions_m:
        if len(choice.positions_m) != len(wanted):
            raise file.wrong(f"has {len(wanted)} nodes, and {len(choice.positions_m)} positions_m are given; give each")
        places, along = np.array(choice.positions_m), "as given"
    else:
        if lost := [node for node in wanted if node not in file.nodes_m]:
            raise file.wrong(f"has no coordinates of node {lost[0]} (dataset 15); export them, or give positions_m")
        coordinates = np.array([file.nodes_m[node] for node in wanted])
        axis = AXES.index(choice.along) if choice.along else int(np.argmax(np.ptp(coordinates, axis=0)))
        places, along = coordinates[:, axis] - coordinates[:, axis].min(), f"along {AXES[axis]}"
    order = np.argsort(places, kind="stable")
    ordered, places = tuple(wanted[k] for k in order), places[order]
    length_m = choice.length_m or float(places[-1])
    if same := np.flatnonzero(np.diff(places) <= 1e-6 * length_m).tolist():
        one, other = ordered[same[0]], ordered[same[0] + 1]
        raise file.wrong(f"nodes {one} and {other} are at one place {along}; name those of one line by nodes")
    nodes_at = f"from node {ordered[0]} at {places[0]:.6g} m to node {ordered[-1]} at {places[-1]:.6g} m"
    return ordered, places, length_m, f"{len(ordered)} nodes {along}, {nodes_at}"
