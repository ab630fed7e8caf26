"""A structure from the UFF file of a modal analysis: mode shapes at nodes (dataset 55), or FRFs (dataset 58)."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.lab.column import UnreadableError
from rig.lab.modal.fit import ModalFit, fit_modes
from rig.lab.uff import check_whole
from rig.lab.units import si_factor
from rig.model.structure import Structure, structure_of
from rig.model.tolerances import Tolerances

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")


@dataclass(frozen=True)
class Choice:
    """Selection from a UFF file; None and () leave it to the file. axis is that along the body."""

    axis: Axis | None = None
    direction: Axis | None = None
    nodes: tuple[int, ...] = ()
    positions_m: tuple[float, ...] = ()
    length_m: float | None = None
    band_hz: tuple[float, ...] = ()


@dataclass(frozen=True)
class UffFile:
    """Datasets of a file by type, coordinates of its nodes (m), and its units of length and force per SI unit."""

    path: Path
    sets: Mapping[int, list[dict[str, Any]]]
    nodes_m: Mapping[int, Float[np.ndarray, " 3"]]
    length_factor: float
    force_factor: float

    def wrong(self, sentence: str) -> RigError:
        return RigError(f"{self.path}: {sentence}")


def structure_from_uff(path: Path, choice: Choice) -> tuple[Structure, tuple[str, ...], Tolerances | None]:
    """Structure named after the file, notes on its data and fit, and for FRFs its tolerances.

    The tolerances are the share of the FRFs that the modes leave unexplained, and the upper end of their band.

    Mode shapes phi (dataset 55) are divided by sqrt(modal mass), which makes them mass-normalised; FRFs (58) are
    fitted, and their residues give the shapes, r_ok = phi_ok phi_dk with the driving point d. Raises RigError if the
    file cannot be read or does not hold what it takes.
    """
    file = read_uff(path)
    if file.sets.get(55):
        shapes = ModeShapes(file, choice)
        return shapes.structure(), shapes.notes, None
    if file.sets.get(58):
        return from_frfs(file, choice)
    raise file.wrong("holds neither mode shapes (dataset 55) nor FRFs (dataset 58); export either")


def read_uff(path: Path) -> UffFile:
    """Read the datasets of a modal analysis; raise RigError if the file is invalid."""
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
            for dataset in (*sets.get(15, []), *sets.get(2411, []))
            for node, x, y, z in zip(dataset["node_nums"], dataset["x"], dataset["y"], dataset["z"], strict=True)
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
    """Nodes along the body, their positions from its left end (m), its length (m), and a note on them."""
    selected = choice.nodes or tuple(sorted(set(nodes)))
    if missing := sorted(set(selected) - set(nodes)):
        raise file.wrong(f"has no data at node {missing[0]}; leave it out of nodes")
    if choice.positions_m:
        if len(choice.positions_m) != len(selected):
            raise file.wrong(
                f"has {len(selected)} nodes, and {len(choice.positions_m)} positions_m are given; give each"
            )
        places, placement = np.array(choice.positions_m), "as given"
    else:
        if unplaced := [node for node in selected if node not in file.nodes_m]:
            raise file.wrong(f"has no coordinates of node {unplaced[0]} (dataset 15); export them, or give positions_m")
        coordinates = np.array([file.nodes_m[node] for node in selected])
        axis = AXES.index(choice.axis) if choice.axis else int(np.argmax(np.ptp(coordinates, axis=0)))
        places, placement = coordinates[:, axis] - coordinates[:, axis].min(), f"along {AXES[axis]}"
    order = np.argsort(places, kind="stable")
    ordered, places = tuple(selected[k] for k in order), places[order]
    length_m = choice.length_m or float(places[-1])
    if coincident := np.flatnonzero(np.diff(places) <= 1e-6 * length_m).tolist():
        first_node, second_node = ordered[coincident[0]], ordered[coincident[0] + 1]
        raise file.wrong(
            f"nodes {first_node} and {second_node} are at one place {placement}; name those of one line by nodes"
        )
    nodes_at = f"from node {ordered[0]} at {places[0]:.6g} m to node {ordered[-1]} at {places[-1]:.6g} m"
    return ordered, places, length_m, f"{len(ordered)} nodes {placement}, {nodes_at}"


RIGID_HZ = 0.01
"""Frequency below which a mode is a rigid-body mode, up to the rounding of a finite-element program."""
MIN_SHARE_IN_DIRECTION = 0.05
"""Least share of a mode's motion in the direction of vibration."""
MAX_OUT_OF_PHASE = 0.2
"""Largest share of a shape out of phase that a normal mode may approximate."""


class ModeShapes:
    """Mode shapes of a file (dataset 55), mass-normalised in SI."""

    def __init__(self, file: UffFile, choice: Choice) -> None:
        self.file = file
        sets = sorted((_mode(file, dataset) for dataset in file.sets[55]), key=lambda mode: mode.frequency_hz)
        sets = [mode for mode in sets if set(choice.nodes) <= set(mode.shapes)] or sets
        shared = set.intersection(*(set(mode.shapes) for mode in sets))
        if not (shared or choice.nodes):
            raise file.wrong("no node is in all its mode shapes, as of several bodies; name those of one by nodes")
        self.nodes, self.places, self.length_m, line_text = line_of(file, choice, shared)
        vectors = np.array([[mode.shapes[node] for node in self.nodes] for mode in sets])  # modes nodes 3
        size = np.sqrt(np.sum(np.abs(vectors) ** 2, axis=1))
        if not size.any():
            raise file.wrong("its mode shapes are zero at the nodes; export them again")
        elastic = np.array([mode.frequency_hz >= RIGID_HZ for mode in sets])
        axis = AXES.index(choice.direction) if choice.direction else int(np.argmax((size[elastic] ** 2).sum(axis=0)))
        share = size[:, axis] / np.maximum(np.linalg.norm(size, axis=1), 1e-300)
        is_kept = (share > MIN_SHARE_IN_DIRECTION) | ~elastic
        self.modes = [mode for mode, keep in zip(sets, is_kept, strict=True) if keep]
        self.notes: tuple[str, ...] = (
            f"{len(self.modes)} modes in direction {AXES[axis]}, {line_text}, from {file.path.name}",
        )
        if dropped := len(sets) - len(self.modes):
            self.notes += (f"{dropped} modes without motion in direction {AXES[axis]} are left out",)
        if not all(m.ratio for m in self.modes if m.frequency_hz >= RIGID_HZ):
            self.notes += ("a mode has no damping in the file; set damping_ratios in rig.json",)
        self.shapes, out_of_phase = _real(vectors[is_kept, :, axis].T)
        if out_of_phase.max(initial=0.0) > MAX_OUT_OF_PHASE:
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
            [str(node) for node in self.nodes],
        )


@dataclass(frozen=True)
class _Mode:
    frequency_hz: float
    ratio: float
    shapes: Mapping[int, Complex[np.ndarray, " 3"]]
    """Mass-normalised vectors by node."""


def _mode(file: UffFile, dataset: Mapping[str, Any]) -> _Mode:
    """Mode of a dataset 55: a normal mode, or a complex one with its eigenvalue and modal A."""
    if dataset["analysis_type"] == 2:
        frequency_hz = float(dataset["freq"])
        ratio = float(dataset["modal_damp_vis"]) or float(dataset["modal_damp_his"]) / 2
        mass = complex(dataset["modal_m"])
    elif dataset["analysis_type"] in (3, 7):
        pole = complex(dataset["eig"])
        frequency_hz = abs(pole) / (2 * np.pi)
        ratio = -pole.real / abs(pole) if pole else 0.0
        mass = complex(dataset["modal_a"]) / (2j * pole.imag) if pole.imag else 0j
    else:
        raise file.wrong(f"dataset 55 {dataset['id1'].strip()!r} is no mode (analysis type {dataset['analysis_type']})")
    if not (np.isfinite(mass) and abs(mass) > 0 and np.isfinite(frequency_hz) and 0 <= ratio < 1):
        raise file.wrong(
            f"the mode at {frequency_hz:g} Hz states the modal mass {abs(mass):g} and the damping ratio {ratio:g}; "
            "scale the shapes to unit modal mass and export them again"
        )
    # x = phi q: of length and force units in which the energies m q'^2 / 2 are, phi / sqrt(m) in 1/sqrt(kg)
    si = np.sqrt(file.force_factor / file.length_factor) / np.sqrt(mass)
    vectors = np.stack([dataset["r1"], dataset["r2"], dataset["r3"]], axis=1) * si
    if not np.isfinite(vectors).all():
        raise file.wrong(f"the shape of the mode at {frequency_hz:g} Hz is not finite; export it again")
    return _Mode(frequency_hz, ratio, dict(zip((int(n) for n in dataset["node_nums"]), vectors, strict=True)))


def _real(
    shapes: Complex[np.ndarray, "places modes"],
) -> tuple[Float[np.ndarray, "places modes"], Float[np.ndarray, " modes"]]:
    """Real part of each shape after the rotation that makes it most real, and its share out of phase."""
    rotation = np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=0)))
    rotated = shapes * rotation
    size = np.maximum(np.linalg.norm(rotated, axis=0), 1e-300)
    return rotated.real, np.linalg.norm(rotated.imag, axis=0) / size


_ORDERS = {8: (0, "displacement"), 11: (1, "velocity"), 12: (2, "acceleration")}
_FORCES = (9, 13)
_FRF = 4


def from_frfs(file: UffFile, choice: Choice) -> tuple[Structure, tuple[str, ...], Tolerances]:
    frfs = [frf for frf in file.sets[58] if frf["func_type"] == _FRF]
    if not frfs:
        raise file.wrong("its datasets 58 are no FRFs; export receptances, mobilities or accelerances")
    coordinates = [((abs(frf["rsp_dir"]), frf["rsp_node"]), (abs(frf["ref_dir"]), frf["ref_node"])) for frf in frfs]
    axis = (
        AXES.index(choice.direction) + 1
        if choice.direction
        else Counter(e[0][0] for e in coordinates).most_common(1)[0][0]
    )
    if axis not in (1, 2, 3):
        raise file.wrong("its FRFs do not say their directions; export them with node and direction")
    driving_node, rows = _common_point(file, frfs, axis)
    nodes, places, length_m, line_text = line_of(file, choice, rows)
    if driving_node not in nodes:
        raise file.wrong(f"the driving point, node {driving_node}, is not among nodes; add it")
    frequency_hz, accelerance = _accelerance(file, [rows[node] for node in nodes])
    if choice.band_hz:
        if len(choice.band_hz) != 2:
            raise RigError(f"band_hz has {len(choice.band_hz)} numbers; give LOW,HIGH")
        inside = (frequency_hz >= choice.band_hz[0]) & (frequency_hz <= choice.band_hz[1])
        frequency_hz, accelerance = frequency_hz[inside], accelerance[:, inside]
    try:
        fit = fit_modes(frequency_hz, accelerance, nodes.index(driving_node))
    except RigError as error:
        raise file.wrong(str(error)) from error
    shapes = fit.residues / np.sqrt(fit.residues[nodes.index(driving_node)])
    body = structure_of(
        file.path.stem, length_m, fit.frequencies_hz, fit.ratios, places, shapes, [str(node) for node in nodes]
    )
    notes = (
        f"{body.max_modes} modes fitted to {len(nodes)} FRFs of direction {AXES[axis - 1]}, {frequency_hz[0]:g} to "
        f"{frequency_hz[-1]:g} Hz, driven at node {driving_node}; {line_text}, from {file.path.name}",
        *(f"left out: {len(frfs) - len(nodes)} FRFs" for _ in range(len(frfs) > len(nodes))),
        *_misfits(nodes, fit),
    )
    unmodelled = max(float(f"{np.median(fit.misfit_of_modes):.2g}"), Tolerances().unmodelled)
    return body, notes, Tolerances(unmodelled=unmodelled, highest_hz=float(f"{frequency_hz[-1]:.4g}"))


def _misfits(nodes: Iterable[int], modal_fit: ModalFit) -> Iterable[str]:
    for frequency_hz, ratio in zip(modal_fit.frequencies_hz, modal_fit.ratios, strict=True):
        yield f"mode: {frequency_hz:.6g} Hz, damping ratio {ratio:.4g}"
    for node, error, by_modes in zip(nodes, modal_fit.misfit, modal_fit.misfit_of_modes, strict=True):
        yield f"misfit at node {node}: {error:.2%} rms of the FRF; {by_modes:.2%} by the modes without residuals"


def _common_point(
    file: UffFile, frfs: list[dict[str, Any]], axis: int
) -> tuple[int, dict[int, tuple[float, dict[str, Any]]]]:
    """Driving point that most FRFs in the direction share, and their signs and FRFs by the node of the other end.

    The shared point may be where the force acts or, by reciprocity (a roving hammer), where the sensor sits.
    """
    by_point: dict[int, dict[int, tuple[float, dict[str, Any]]]] = {}
    for frf in frfs:
        if abs(frf["rsp_dir"]) == axis == abs(frf["ref_dir"]):
            response, reference = int(frf["rsp_node"]), int(frf["ref_node"])
            signed = (float(np.sign(frf["rsp_dir"] * frf["ref_dir"])), frf)
            by_point.setdefault(reference, {})[response] = signed
            by_point.setdefault(response, {}).setdefault(reference, signed)
    complete = {point: rows for point, rows in by_point.items() if point in rows}
    if not complete:
        raise file.wrong(
            f"has no FRF of a driving point in direction {AXES[axis - 1]} (one node for force and response), without "
            "which shapes have no scale; measure it too"
        )
    point = max(complete, key=lambda candidate: len(complete[candidate]))
    return point, complete[point]


def _accelerance(
    file: UffFile, rows: list[tuple[float, dict[str, Any]]]
) -> tuple[Float[np.ndarray, " lines"], Complex[np.ndarray, "frfs lines"]]:
    """Frequencies (Hz) and accelerances (SI) from receptances, mobilities or accelerances."""
    frequency_hz = np.asarray(rows[0][1]["x"], dtype=float)
    accelerances = []
    for sign, frf in rows:
        label = f"the FRF {str(frf['id1']).strip()!r} at node {frf['rsp_node']}"
        order, quantity = _ORDERS.get(frf["ordinate_spec_data_type"], (None, ""))
        if order is None or frf["orddenom_spec_data_type"] not in _FORCES:
            raise file.wrong(f"{label} does not say that it is a displacement, velocity or acceleration over a force")
        hz = np.asarray(frf["x"], dtype=float)
        if hz.shape != frequency_hz.shape or not np.allclose(hz, frequency_hz, rtol=1e-6):
            raise file.wrong(f"{label} has other frequencies than the first; export them over the same lines")
        if len(frf["data"]) != hz.size or not (np.isfinite(frf["data"]).all() and np.isfinite(hz).all()):
            raise file.wrong(f"{label} is cut off or not finite; export it again")
        length, force = _unit_factors(file, frf, quantity)
        accelerances.append(sign * length / force * np.asarray(frf["data"]) * (2j * np.pi * hz) ** (2 - order))
    return frequency_hz, np.array(accelerances)


def _unit_factors(file: UffFile, frf: Mapping[str, Any], quantity: str) -> tuple[float, float]:
    """SI values of the units of response and force, from their labels or else from dataset 164."""
    response, force = (str(frf[f"{axis}_axis_units_lab"]).strip() for axis in ("ordinate", "orddenom"))
    response = response.split("/N")[0].strip("() ") if not force or force == "NONE" else response
    try:
        return (
            si_factor(quantity, response) if response not in ("", "NONE") else 1 / file.length_factor,
            si_factor("force", force) if force not in ("", "NONE") else 1 / file.force_factor,
        )
    except RigError as error:
        raise file.wrong(str(error)) from error
