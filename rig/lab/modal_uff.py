"""A structure from the UFF file of a modal analysis: mode shapes at nodes (dataset 55), or FRFs (dataset 58)."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.lab.modal_fit import ModalFit, fit_modes
from rig.lab.units import si_factor
from rig.model.structure import Structure, structure_of

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
RIGID_HZ = 0.01
"""A mode shape below is that of a rigid-body mode: a finite-element program gives it by rounding."""
ACROSS = 0.05
"""A mode with less than this share of its motion in the direction is not the structure's."""
COMPLEX = 0.2
"""A shape with more than this share out of phase has no normal mode near it."""
_ORDERS = {8: (0, "displacement"), 11: (1, "velocity"), 12: (2, "acceleration")}
_FORCES = (9, 13)
_FRF = 4


@dataclass(frozen=True)
class Choice:
    """What of a UFF file is meant; None and () leave it to the file."""

    along: Axis | None = None
    direction: Axis | None = None
    nodes: tuple[int, ...] = ()
    positions_m: tuple[float, ...] = ()
    length_m: float | None = None
    band_hz: tuple[float, ...] = ()


@dataclass(frozen=True)
class _File:
    """The datasets of a file by type, its nodes' coordinates in metres, and what its units are of SI's."""

    path: Path
    sets: Mapping[int, list[dict[str, Any]]]
    nodes_m: Mapping[int, Float[np.ndarray, " 3"]]
    length: float
    force: float

    def wrong(self, sentence: str) -> RigError:
        return RigError(f"{self.path}: {sentence}")


def structure_from_uff(path: Path, choice: Choice) -> tuple[Structure, tuple[str, ...]]:
    """The structure, named like the file, and sentences on what was taken and how well FRFs are fitted.

    Mode shapes phi (dataset 55) are divided by sqrt(modal mass), which makes them mass-normalised; FRFs (58) are
    fitted, and their residues give the shapes, r_ok = phi_ok phi_dk with the driving point d. Raises RigError if the
    file cannot be read or does not hold what it takes.
    """
    file = _read(path)
    if file.sets.get(55):
        shapes = _ModeShapes(file, choice)
        return shapes.structure(), shapes.notes
    if file.sets.get(58):
        return _from_frfs(file, choice)
    raise file.wrong("holds neither mode shapes (dataset 55) nor FRFs (dataset 58); export either")


def _read(path: Path) -> _File:
    import pyuff

    try:
        with path.open("rb"):
            pass
        reader = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in reader.get_set_types()]
        sets: dict[int, list[dict[str, Any]]] = {}
        for place, kind in enumerate(kinds):
            if kind in (15, 55, 58, 164, 2411):
                sets.setdefault(kind, []).append(reader.read_sets(place))
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror or error}); check the name") from error
    except Exception as error:  # what the format's library raises on a bad file is not to be listed
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise RigError(f"{path}: cannot be read as UFF ({reason}); export it again") from error
    units = sets.get(164, [{}])[-1]
    length, force = (float(units.get(name) or 1.0) for name in ("length", "force"))
    if not (0 < length < np.inf and 0 < force < np.inf):
        raise RigError(f"{path}: its units (dataset 164) are no numbers above zero; export it again")
    nodes = {
        int(node): np.array([x, y, z]) / length
        for one in (*sets.get(15, []), *sets.get(2411, []))
        for node, x, y, z in zip(one["node_nums"], one["x"], one["y"], one["z"], strict=True)
    }
    return _File(path, sets, nodes, length, force)


def _line(
    file: _File, choice: Choice, nodes: Iterable[int]
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
    return ordered, places, length_m, f"{len(ordered)} nodes {along}, {length_m:.6g} m"


class _ModeShapes:
    """The mode shapes of a file, mass-normalised in SI."""

    def __init__(self, file: _File, choice: Choice) -> None:
        self.file = file
        sets = sorted((_mode(file, one) for one in file.sets[55]), key=lambda mode: mode.frequency_hz)
        shared = set.intersection(*(set(mode.shapes) for mode in sets))
        self.nodes, self.places, self.length_m, told = _line(file, choice, shared)
        vectors = np.array([[mode.shapes[node] for node in self.nodes] for mode in sets])  # modes nodes 3
        size = np.sqrt(np.sum(np.abs(vectors) ** 2, axis=1))
        if not size.any():
            raise file.wrong("its mode shapes are zero at the nodes; export them again")
        elastic = np.array([mode.frequency_hz >= RIGID_HZ for mode in sets])
        axis = AXES.index(choice.direction) if choice.direction else int(np.argmax((size[elastic] ** 2).sum(axis=0)))
        share = size[:, axis] / np.maximum(np.linalg.norm(size, axis=1), 1e-300)
        kept = (share > ACROSS) | ~elastic
        self.modes = [mode for mode, keep in zip(sets, kept, strict=True) if keep]
        self.notes: tuple[str, ...] = (
            f"{len(self.modes)} modes in direction {AXES[axis]}, {told}, from {file.path.name}",
        )
        if left := len(sets) - len(self.modes):
            self.notes += (f"{left} modes without motion in direction {AXES[axis]} are left out",)
        if not all(m.ratio for m in self.modes if m.frequency_hz >= RIGID_HZ):
            self.notes += ("a mode has no damping in the file; set damping_ratios in rig.json",)
        self.shapes, out_of_phase = _real(vectors[kept, :, axis].T)
        if out_of_phase.max(initial=0.0) > COMPLEX:
            worst = self.modes[int(np.argmax(out_of_phase))]
            raise file.wrong(
                f"{out_of_phase.max():.0%} of the mode at {worst.frequency_hz:g} Hz is out of phase; a structure has "
                "normal modes, export those"
            )

    def structure(self) -> Structure:
        rigid = np.array([mode.frequency_hz < RIGID_HZ for mode in self.modes])
        return structure_of(
            self.file.path.stem,
            self.length_m,
            np.where(rigid, 0.0, [mode.frequency_hz for mode in self.modes]),
            np.where(rigid, 0.0, [mode.ratio for mode in self.modes]),
            self.places,
            self.shapes,
        )


@dataclass(frozen=True)
class _Mode:
    frequency_hz: float
    ratio: float
    shapes: Mapping[int, Complex[np.ndarray, " 3"]]
    """Of every node, mass-normalised."""


def _mode(file: _File, one: Mapping[str, Any]) -> _Mode:
    """A dataset 55: of a normal mode, or of a complex one with its eigenvalue and modal A."""
    if one["analysis_type"] == 2:
        frequency_hz = float(one["freq"])
        ratio = float(one["modal_damp_vis"]) or float(one["modal_damp_his"]) / 2
        mass = complex(one["modal_m"])
    elif one["analysis_type"] in (3, 7):
        pole = complex(one["eig"])
        frequency_hz = abs(pole) / (2 * np.pi)
        ratio = -pole.real / abs(pole) if pole else 0.0
        mass = complex(one["modal_a"]) / (2j * pole.imag) if pole.imag else 0j
    else:
        raise file.wrong(f"dataset 55 {one['id1'].strip()!r} is no mode (analysis type {one['analysis_type']})")
    if not (np.isfinite(mass) and abs(mass) > 0 and np.isfinite(frequency_hz) and 0 <= ratio < 1):
        raise file.wrong(
            f"the mode at {frequency_hz:g} Hz states the modal mass {abs(mass):g} and the damping ratio {ratio:g}; "
            "scale the shapes to unit modal mass and export them again"
        )
    # x = phi q: of length and force units in which the energies m q'^2 / 2 are, phi / sqrt(m) in 1/sqrt(kg)
    si = np.sqrt(file.force / file.length) / np.sqrt(mass)
    vectors = np.stack([one["r1"], one["r2"], one["r3"]], axis=1) * si
    if not np.isfinite(vectors).all():
        raise file.wrong(f"the shape of the mode at {frequency_hz:g} Hz is not finite; export it again")
    return _Mode(frequency_hz, ratio, dict(zip((int(n) for n in one["node_nums"]), vectors, strict=True)))


def _real(
    shapes: Complex[np.ndarray, "places modes"],
) -> tuple[Float[np.ndarray, "places modes"], Float[np.ndarray, " modes"]]:
    """Each shape turned to be as real as can be, and the share of it that is not."""
    turn = np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=0)))
    turned = shapes * turn
    size = np.maximum(np.linalg.norm(turned, axis=0), 1e-300)
    return turned.real, np.linalg.norm(turned.imag, axis=0) / size


def _from_frfs(file: _File, choice: Choice) -> tuple[Structure, tuple[str, ...]]:
    frfs = [one for one in file.sets[58] if one["func_type"] == _FRF]
    if not frfs:
        raise file.wrong("its datasets 58 are no FRFs; export receptances, mobilities or accelerances")
    ends = [((abs(one["rsp_dir"]), one["rsp_node"]), (abs(one["ref_dir"]), one["ref_node"])) for one in frfs]
    axis = AXES.index(choice.direction) + 1 if choice.direction else Counter(e[0][0] for e in ends).most_common(1)[0][0]
    if axis not in (1, 2, 3):
        raise file.wrong("its FRFs do not say their directions; export them with node and direction")
    driving, rows = _common_point(file, frfs, axis)
    nodes, places, length_m, told = _line(file, choice, rows)
    if driving not in nodes:
        raise file.wrong(f"the driving point, node {driving}, is not among nodes; add it")
    frequency_hz, accelerance = _accelerance(file, [rows[node] for node in nodes])
    if choice.band_hz:
        if len(choice.band_hz) != 2:
            raise RigError(f"band_hz has {len(choice.band_hz)} numbers; give LOW,HIGH")
        inside = (frequency_hz >= choice.band_hz[0]) & (frequency_hz <= choice.band_hz[1])
        frequency_hz, accelerance = frequency_hz[inside], accelerance[:, inside]
    try:
        fit = fit_modes(frequency_hz, accelerance, nodes.index(driving))
    except RigError as error:
        raise file.wrong(str(error)) from error
    shapes = fit.residues / np.sqrt(fit.residues[nodes.index(driving)])
    body = structure_of(file.path.stem, length_m, fit.frequencies_hz, fit.ratios, places, shapes)
    notes = (
        f"{body.max_modes} modes fitted to {len(nodes)} FRFs of direction {AXES[axis - 1]}, {frequency_hz[0]:g} to "
        f"{frequency_hz[-1]:g} Hz, driven at node {driving}; {told}, from {file.path.name}",
        *(f"left out: {len(frfs) - len(nodes)} FRFs" for _ in range(len(frfs) > len(nodes))),
        *_misfits(nodes, fit),
    )
    return body, notes


def _misfits(nodes: Iterable[int], fit: ModalFit) -> Iterable[str]:
    for frequency_hz, ratio in zip(fit.frequencies_hz, fit.ratios, strict=True):
        yield f"mode: {frequency_hz:.6g} Hz, damping ratio {ratio:.4g}"
    for node, error, by_modes in zip(nodes, fit.misfit, fit.misfit_of_modes, strict=True):
        yield f"misfit at node {node}: {error:.2%} rms of the FRF; {by_modes:.2%} by the modes without residuals"


def _common_point(
    file: _File, frfs: list[dict[str, Any]], axis: int
) -> tuple[int, dict[int, tuple[float, dict[str, Any]]]]:
    """The driving point that most FRFs of the direction share, and by the other end's node its sign and FRF.

    The shared point may be where the force acts or, by reciprocity (a roving hammer), where the sensor sits.
    """
    found: dict[int, dict[int, tuple[float, dict[str, Any]]]] = {}
    for one in frfs:
        if abs(one["rsp_dir"]) == axis == abs(one["ref_dir"]):
            response, reference = int(one["rsp_node"]), int(one["ref_node"])
            signed = (float(np.sign(one["rsp_dir"] * one["ref_dir"])), one)
            found.setdefault(reference, {})[response] = signed
            found.setdefault(response, {}).setdefault(reference, signed)
    complete = {point: rows for point, rows in found.items() if point in rows}
    if not complete:
        raise file.wrong(
            f"has no FRF of a driving point in direction {AXES[axis - 1]} (one node for force and response), without "
            "which shapes have no scale; measure it too"
        )
    point = max(complete, key=lambda one: len(complete[one]))
    return point, complete[point]


def _accelerance(
    file: _File, rows: list[tuple[float, dict[str, Any]]]
) -> tuple[Float[np.ndarray, " lines"], Complex[np.ndarray, "frfs lines"]]:
    """Frequencies and accelerances in SI, of receptances, mobilities or accelerances."""
    frequency_hz = np.asarray(rows[0][1]["x"], dtype=float)
    found = []
    for sign, one in rows:
        what = f"the FRF {str(one['id1']).strip()!r} at node {one['rsp_node']}"
        order, quantity = _ORDERS.get(one["ordinate_spec_data_type"], (None, ""))
        if order is None or one["orddenom_spec_data_type"] not in _FORCES:
            raise file.wrong(f"{what} does not say that it is a displacement, velocity or acceleration over a force")
        x = np.asarray(one["x"], dtype=float)
        if x.shape != frequency_hz.shape or not np.allclose(x, frequency_hz, rtol=1e-6):
            raise file.wrong(f"{what} has other frequencies than the first; export them over the same lines")
        if len(one["data"]) != x.size or not (np.isfinite(one["data"]).all() and np.isfinite(x).all()):
            raise file.wrong(f"{what} is cut off or not finite; export it again")
        length, force = _labels(file, one, quantity)
        found.append(sign * length / force * np.asarray(one["data"]) * (2j * np.pi * x) ** (2 - order))
    return frequency_hz, np.array(found)


def _labels(file: _File, one: Mapping[str, Any], quantity: str) -> tuple[float, float]:
    """SI values of the units of response and force: of their labels, or where these say none, of dataset 164."""
    response, force = (str(one[f"{end}_axis_units_lab"]).strip() for end in ("ordinate", "orddenom"))
    response = response.split("/N")[0].strip("() ") if not force or force == "NONE" else response
    try:
        return (
            si_factor(quantity, response) if response not in ("", "NONE") else 1 / file.length,
            si_factor("force", force) if force not in ("", "NONE") else 1 / file.force,
        )
    except RigError as error:
        raise file.wrong(str(error)) from error
