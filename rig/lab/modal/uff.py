"""A structure from the UFF file of a modal analysis: mode shapes at nodes (dataset 55), or FRFs (dataset 58)."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.lab.column import UnreadableError
from rig.lab.modal.fit import ModalFit, fit_modes, lines_in_band
from rig.lab.uff import UffUnits, uff_units
from rig.lab.units import si_factor
from rig.model.structure import Structure, structure_of
from rig.model.tolerances import Tolerances

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")


@dataclass(frozen=True)
class UffSelection:
    """Selection from a UFF file; None and () leave it to the file. axis is that along the body.

    exponential_window_s is the decay time tau of an analyser's window exp(-t / tau) on the responses.
    """

    axis: Axis | None = None
    direction: Axis | None = None
    nodes: tuple[int, ...] = ()
    positions_m: tuple[float, ...] = ()
    length_m: float | None = None
    band_hz: tuple[float, ...] = ()
    exponential_window_s: float | None = None


@dataclass(frozen=True)
class UffFile:
    """Datasets of a file by type, coordinates of its nodes (m), and its units."""

    path: Path
    datasets: Mapping[int, list[dict[str, Any]]]
    nodes_m: Mapping[int, Float[np.ndarray, " 3"]]
    units: UffUnits

    def error(self, sentence: str) -> RigError:
        return RigError(f"{self.path}: {sentence}")


def structure_from_uff(path: Path, choice: UffSelection) -> tuple[Structure, tuple[str, ...], Tolerances | None]:
    """Structure named after the file, notes on its data and fit, and for FRFs its tolerances.

    The tolerances are the share of the FRFs that the modes leave unexplained, and the upper end of their band.

    Mode shapes phi (dataset 55) are divided by sqrt(modal mass), which makes them mass-normalised; FRFs (58) are
    fitted, and their residues give the shapes, r_ok = phi_ok phi_dk with the driving point d. Raises RigError if the
    file cannot be read or does not hold what it takes.
    """
    file = read_uff(path)
    if file.datasets.get(55):
        return *structure_from_shapes(file, choice), None
    if file.datasets.get(58):
        return structure_from_frfs(file, choice)
    raise file.error("holds neither mode shapes (dataset 55) nor FRFs (dataset 58); export either")


def read_uff(path: Path) -> UffFile:
    """Read the datasets of a modal analysis; raise RigError if the file is invalid."""
    with needs_extra("lab", f"{path}: a UFF file"):
        import pyuff

    try:
        units = uff_units(path) or UffUnits(1.0, 1.0)
        reader = pyuff.UFF(str(path))
        datasets: dict[int, list[dict[str, Any]]] = {}
        for dataset_index, dataset_type in enumerate(map(int, reader.get_set_types())):
            if dataset_type in (15, 55, 58, 2411):
                with np.errstate(all="ignore"):  # what is not finite is refused where it is used
                    datasets.setdefault(dataset_type, []).append(reader.read_sets(dataset_index))
        node_coordinates = {
            int(node): np.array([x, y, z])
            for dataset in (*datasets.get(15, []), *datasets.get(2411, []))
            for node, x, y, z in zip(dataset["node_nums"], dataset["x"], dataset["y"], dataset["z"], strict=True)
        }
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror or error}); check the name") from error
    except UnreadableError as error:
        raise RigError(f"{path}: cannot be read as UFF ({error}); export it again") from error
    except Exception as error:  # what the format's library raises on a bad file is not to be listed
        raise RigError(f"{path}: cannot be read as UFF, whole or in part; export it again") from error
    if not (0 < units.length < np.inf and 0 < units.force < np.inf):
        raise RigError(f"{path}: its units (dataset 164) are no numbers above zero; export it again")
    nodes_m = {node: coordinates / units.length for node, coordinates in node_coordinates.items()}
    return UffFile(path, datasets, nodes_m, units)


def nodes_along_body(
    file: UffFile, choice: UffSelection, nodes: Iterable[int]
) -> tuple[tuple[int, ...], Float[np.ndarray, " places"], float, str]:
    """Nodes along the body, their positions from its left end (m), its length (m), and a note on them."""
    chosen = choice.nodes or tuple(sorted(set(nodes)))
    if missing_nodes := sorted(set(chosen) - set(nodes)):
        raise file.error(f"has no data at node {missing_nodes[0]}; leave it out of nodes")
    if choice.positions_m:
        if len(choice.positions_m) != len(chosen):
            raise file.error(f"has {len(chosen)} nodes, and {len(choice.positions_m)} positions_m are given; give each")
        positions_m, placed = np.array(choice.positions_m), "as given"
    else:
        if unplaced := [node for node in chosen if node not in file.nodes_m]:
            raise file.error(f"has no coordinates of node {unplaced[0]} (dataset 15); export them, or give positions_m")
        coordinates = np.array([file.nodes_m[node] for node in chosen])
        axis_index = AXES.index(choice.axis) if choice.axis else int(np.argmax(np.ptp(coordinates, axis=0)))
        positions_m, placed = coordinates[:, axis_index] - coordinates[:, axis_index].min(), f"along {AXES[axis_index]}"
    position_order = np.argsort(positions_m, kind="stable")
    line_nodes, positions_m = tuple(chosen[k] for k in position_order), positions_m[position_order]
    length_m = choice.length_m or float(positions_m[-1])
    if coincident_indices := np.flatnonzero(np.diff(positions_m) <= 1e-6 * length_m).tolist():
        first_node, second = line_nodes[coincident_indices[0]], line_nodes[coincident_indices[0] + 1]
        raise file.error(f"nodes {first_node} and {second} are at one place {placed}; name those of one line by nodes")
    extent = f"from node {line_nodes[0]} at {positions_m[0]:.6g} m to node {line_nodes[-1]} at {positions_m[-1]:.6g} m"
    return line_nodes, positions_m, length_m, f"{len(line_nodes)} nodes {placed}, {extent}"


RIGID_HZ = 0.01
"""Frequency below which a mode is a rigid-body mode, up to the rounding of a finite-element program."""
MIN_SHARE_IN_DIRECTION = 0.05
"""Least share of a mode's motion in the direction of vibration."""
MAX_OUT_OF_PHASE = 0.2
"""Largest share of a shape out of phase that a normal mode may approximate."""


def structure_from_shapes(file: UffFile, choice: UffSelection) -> tuple[Structure, tuple[str, ...]]:
    """Structure of the mode shapes of a file (dataset 55), mass-normalised in SI, and notes on it."""
    modes = sorted((_mode_of(file, dataset) for dataset in file.datasets[55]), key=lambda mode: mode.frequency_hz)
    modes = [mode for mode in modes if set(choice.nodes) <= set(mode.vector_by_node)] or modes
    common_nodes = set.intersection(*(set(mode.vector_by_node) for mode in modes))
    if not (common_nodes or choice.nodes):
        raise file.error("no node is in all its mode shapes, as of several bodies; name those of one by nodes")
    nodes, positions_m, length_m, line_note = nodes_along_body(file, choice, common_nodes)
    mode_vectors = np.array([[mode.vector_by_node[node] for node in nodes] for mode in modes])  # modes nodes 3
    amplitudes = np.sqrt(np.sum(np.abs(mode_vectors) ** 2, axis=1))
    if not amplitudes.any():
        raise file.error("its mode shapes are zero at the nodes; export them again")
    frequencies_hz = np.array([mode.frequency_hz for mode in modes])
    ratios = np.array([mode.damping_ratio for mode in modes])
    is_elastic = frequencies_hz >= RIGID_HZ
    axis_index = int(np.argmax((amplitudes[is_elastic] ** 2).sum(axis=0)))
    if choice.direction:
        axis_index = AXES.index(choice.direction)
    direction_shares = amplitudes[:, axis_index] / np.maximum(np.linalg.norm(amplitudes, axis=1), 1e-300)
    moves_in_axis = (direction_shares > MIN_SHARE_IN_DIRECTION) | ~is_elastic
    frequencies_hz, ratios, is_elastic = frequencies_hz[moves_in_axis], ratios[moves_in_axis], is_elastic[moves_in_axis]
    notes = [f"{frequencies_hz.size} modes in direction {AXES[axis_index]}, {line_note}, from {file.path.name}"]
    if dropped_count := len(modes) - frequencies_hz.size:
        notes.append(f"{dropped_count} modes without motion in direction {AXES[axis_index]} are left out")
    if not ratios[is_elastic].all():
        notes.append("a mode has no damping in the file; set damping_ratios in rig.json")
    shapes, out_of_phase = _real_shapes(mode_vectors[moves_in_axis, :, axis_index].T)
    if out_of_phase.max(initial=0.0) > MAX_OUT_OF_PHASE:
        raise file.error(
            f"{out_of_phase.max():.0%} of the mode at {frequencies_hz[np.argmax(out_of_phase)]:g} Hz is out of phase; "
            "a structure has normal modes, export those"
        )
    frequencies_hz, ratios = np.where(is_elastic, frequencies_hz, 0.0), np.where(is_elastic, ratios, 0.0)
    frequencies_hz, ratios, window_notes = _without_window(file, choice, frequencies_hz, ratios)
    notes += window_notes
    node_names = [str(node) for node in nodes]
    return structure_of(file.path.stem, length_m, frequencies_hz, ratios, positions_m, shapes, node_names), tuple(notes)


@dataclass(frozen=True)
class _Mode:
    frequency_hz: float
    damping_ratio: float
    vector_by_node: Mapping[int, Complex[np.ndarray, " 3"]]
    """Mass-normalised vectors by node."""


def _mode_of(file: UffFile, dataset: Mapping[str, Any]) -> _Mode:
    """Mode of a dataset 55: a normal mode, or a complex one with its eigenvalue and modal A."""
    if dataset["analysis_type"] == 2:
        frequency_hz = float(dataset["freq"])
        damping_ratio = float(dataset["modal_damp_vis"]) or float(dataset["modal_damp_his"]) / 2
        modal_mass = complex(dataset["modal_m"])
    elif dataset["analysis_type"] in (3, 7):
        pole = complex(dataset["eig"])
        frequency_hz = abs(pole) / (2 * np.pi)
        damping_ratio = -pole.real / abs(pole) if pole else 0.0
        modal_mass = complex(dataset["modal_a"]) / (2j * pole.imag) if pole.imag else 0j
    else:
        raise file.error(f"dataset 55 {dataset['id1'].strip()!r} is no mode (analysis type {dataset['analysis_type']})")
    if not (np.isfinite(modal_mass) and abs(modal_mass) > 0 and np.isfinite(frequency_hz) and 0 <= damping_ratio < 1):
        raise file.error(
            f"the mode at {frequency_hz:g} Hz states the modal mass {abs(modal_mass):g} and the damping ratio "
            f"{damping_ratio:g}; scale the shapes to unit modal mass and export them again"
        )
    # x = phi q: of length and force units in which the energies m q'^2 / 2 are, phi / sqrt(m) in 1/sqrt(kg)
    shape_factor = np.sqrt(file.units.force / file.units.length) / np.sqrt(modal_mass)
    shape_vectors = np.stack([dataset["r1"], dataset["r2"], dataset["r3"]], axis=1) * shape_factor
    if not np.isfinite(shape_vectors).all():
        raise file.error(f"the shape of the mode at {frequency_hz:g} Hz is not finite; export it again")
    return _Mode(frequency_hz, damping_ratio, dict(zip(map(int, dataset["node_nums"]), shape_vectors, strict=True)))


def _real_shapes(
    shapes: Complex[np.ndarray, "places modes"],
) -> tuple[Float[np.ndarray, "places modes"], Float[np.ndarray, " modes"]]:
    """Real part of each shape after the rotation that makes it most real, and its share out of phase."""
    rotated_shapes = shapes * np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=0)))
    shape_norms = np.maximum(np.linalg.norm(rotated_shapes, axis=0), 1e-300)
    return rotated_shapes.real, np.linalg.norm(rotated_shapes.imag, axis=0) / shape_norms


_ORDER_AND_QUANTITY_BY_CODE = {8: (0, "displacement"), 11: (1, "velocity"), 12: (2, "acceleration")}
_FORCE_CODES = (9, 13)
_FRF_FUNCTION_CODE = 4


def structure_from_frfs(file: UffFile, choice: UffSelection) -> tuple[Structure, tuple[str, ...], Tolerances]:
    frfs = [frf for frf in file.datasets[58] if frf["func_type"] == _FRF_FUNCTION_CODE]
    if not frfs:
        raise file.error("its datasets 58 are no FRFs; export receptances, mobilities or accelerances")
    axis = Counter(abs(frf["rsp_dir"]) for frf in frfs).most_common(1)[0][0]
    if choice.direction:
        axis = AXES.index(choice.direction) + 1
    if axis not in (1, 2, 3):
        raise file.error("its FRFs do not say their directions; export them with node and direction")
    driving_node, frf_by_node = _driving_point_and_frfs(file, frfs, axis)
    nodes, positions_m, length_m, line_note = nodes_along_body(file, choice, frf_by_node)
    if driving_node not in nodes:
        raise file.error(f"the driving point, node {driving_node}, is not among nodes; add it")
    frequency_hz, accelerance = _accelerances_of(file, [frf_by_node[node] for node in nodes])
    is_in_band = lines_in_band(frequency_hz, choice.band_hz)
    frequency_hz, accelerance = frequency_hz[is_in_band], accelerance[:, is_in_band]
    try:
        modal_fit = fit_modes(frequency_hz, accelerance, nodes.index(driving_node))
    except RigError as error:
        raise file.error(str(error)) from error
    shapes, node_names = modal_fit.shapes(nodes.index(driving_node)), [str(node) for node in nodes]
    frequencies_hz, damping_ratios, window_notes = _without_window(
        file, choice, modal_fit.frequencies_hz, modal_fit.damping_ratios
    )
    body = structure_of(file.path.stem, length_m, frequencies_hz, damping_ratios, positions_m, shapes, node_names)
    first_note = (
        f"{body.max_modes} modes fitted to {len(nodes)} FRFs of direction {AXES[axis - 1]}, {frequency_hz[0]:g} to "
        f"{frequency_hz[-1]:g} Hz, driven at node {driving_node}; {line_note}, from {file.path.name}"
    )
    left_out_notes = [f"left out: {len(frfs) - len(nodes)} FRFs"] if len(frfs) > len(nodes) else []
    unmodelled_share = max(float(f"{np.median(modal_fit.misfits_of_modes):.2g}"), Tolerances().unmodelled)
    tolerances = Tolerances(unmodelled=unmodelled_share, highest_hz=float(f"{frequency_hz[-1]:.4g}"))
    mode_notes = [
        f"mode: {frequency_hz:.6g} Hz, damping ratio {damping_ratio:.4g}"
        for frequency_hz, damping_ratio in zip(frequencies_hz, damping_ratios, strict=True)
    ]
    notes = (first_note, *left_out_notes, *mode_notes, *window_notes, *_misfit_notes(nodes, modal_fit))
    return body, notes, tolerances


MIN_WINDOW_SHARE = 0.6
"""Least share of the lowest mode's damping ratio that a window would explain where the ratios fall as one leaves them.
Set by hand."""


def _without_window(
    file: UffFile, choice: UffSelection, natural_hz: Float[np.ndarray, " modes"], ratios: Float[np.ndarray, " modes"]
) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, " modes"], tuple[str, ...]]:
    """Frequencies (Hz) and damping ratios without the window that the analyser put on the responses; a note on it.

    A window exp(-t / tau) moves each pole by -1 / tau: the decay rate zeta omega grows by it, the damped frequency
    stays. Raises RigError for a window that leaves a mode no damping.
    """
    window_s = choice.exponential_window_s
    if window_s is None:
        return natural_hz, ratios, _window_question(natural_hz, ratios)
    if not 0 < window_s < np.inf:
        raise RigError(
            f"exponential_window_s is {window_s}; give the decay time of the window, a finite time above zero"
        )
    is_elastic = natural_hz > 0
    decay_rates_per_s = 2 * np.pi * natural_hz * ratios - is_elastic / window_s
    if (is_lighter := decay_rates_per_s < 0).any():
        first_index = int(np.argmax(is_lighter))
        raise file.error(
            f"exponential_window_s is {window_s:g}, which adds "
            f"{1 / (2 * np.pi * natural_hz[first_index] * window_s):.3g} to the damping ratio of the mode at "
            f"{natural_hz[first_index]:.4g} Hz, and the file has "
            f"{ratios[first_index]:.3g}; give the time in which the window falls to 37 %, or leave the option out"
        )
    true_hz = np.hypot(natural_hz * np.sqrt(1 - ratios**2), decay_rates_per_s / (2 * np.pi))
    true_ratios = np.divide(decay_rates_per_s, 2 * np.pi * true_hz, out=np.zeros_like(true_hz), where=is_elastic)
    return true_hz, true_ratios, (f"the window exp(-t / {window_s:g} s) is taken off the damping ratios",)


def _window_question(natural_hz: Float[np.ndarray, " modes"], ratios: Float[np.ndarray, " modes"]) -> tuple[str, ...]:
    """Question after a window, where the decay rates are those of one, constant, and a damping ratio that all modes
    share: the ratios then fall as 1 / frequency."""
    omega, found_ratios = 2 * np.pi * natural_hz[natural_hz > 0], ratios[natural_hz > 0]
    if omega.size < 2 or (np.diff(found_ratios) >= 0).any() or found_ratios[-1] <= 0:
        return ()
    added_per_s, _ = scipy.optimize.nnls(np.stack([1 / omega, np.ones_like(omega)], axis=1), found_ratios)[0]
    if added_per_s / omega[0] < MIN_WINDOW_SHARE * found_ratios[0]:
        return ()
    return (
        f"the damping ratios fall as 1/frequency, as a window of {1 / added_per_s:.2g} s on the responses leaves them; "
        "if the analyser had one, give --exponential-window-s, the time in which it falls to 37 %",
    )


def _misfit_notes(nodes: Iterable[int], modal_fit: ModalFit) -> Iterable[str]:
    for node, misfit, mode_misfit in zip(nodes, modal_fit.misfits, modal_fit.misfits_of_modes, strict=True):
        yield f"misfit at node {node}: {misfit:.2%} rms of the FRF; {mode_misfit:.2%} by the modes without residuals"


SignedFrf = tuple[float, dict[str, Any]]


def _driving_point_and_frfs(file: UffFile, frfs: list[dict[str, Any]], axis: int) -> tuple[int, dict[int, SignedFrf]]:
    """Driving point that most FRFs in the direction share, and their signs and FRFs by the node of the other end.

    The shared point may be where the force acts or, by reciprocity (a roving hammer), where the sensor sits.
    """
    frfs_by_point: dict[int, dict[int, SignedFrf]] = {}
    for frf in frfs:
        if abs(frf["rsp_dir"]) == axis == abs(frf["ref_dir"]):
            response_node, reference_node = int(frf["rsp_node"]), int(frf["ref_node"])
            signed_frf = (float(np.sign(frf["rsp_dir"] * frf["ref_dir"])), frf)
            frfs_by_point.setdefault(reference_node, {})[response_node] = signed_frf
            frfs_by_point.setdefault(response_node, {}).setdefault(reference_node, signed_frf)
    driving_points = [point for point, frf_by_node in frfs_by_point.items() if point in frf_by_node]
    if not driving_points:
        raise file.error(
            f"has no FRF of a driving point in direction {AXES[axis - 1]} (one node for force and response), without "
            "which shapes have no scale; measure it too"
        )
    driving_point = max(driving_points, key=lambda point: len(frfs_by_point[point]))
    return driving_point, frfs_by_point[driving_point]


def _accelerances_of(
    file: UffFile, signed_frfs: list[SignedFrf]
) -> tuple[Float[np.ndarray, " lines"], Complex[np.ndarray, "frfs lines"]]:
    """Frequencies (Hz) and accelerances (SI) from receptances, mobilities or accelerances."""
    frequency_hz = np.asarray(signed_frfs[0][1]["x"], dtype=float)
    accelerances = []
    for sign, frf in signed_frfs:
        label = f"the FRF {str(frf['id1']).strip()!r} at node {frf['rsp_node']}"
        response_order, quantity = _ORDER_AND_QUANTITY_BY_CODE.get(frf["ordinate_spec_data_type"], (None, ""))
        if response_order is None or frf["orddenom_spec_data_type"] not in _FORCE_CODES:
            raise file.error(f"{label} does not say that it is a displacement, velocity or acceleration over a force")
        line_hz = np.asarray(frf["x"], dtype=float)
        if line_hz.shape != frequency_hz.shape or not np.allclose(line_hz, frequency_hz, rtol=1e-6):
            raise file.error(f"{label} has other frequencies than the first; export them over the same lines")
        if len(frf["data"]) != line_hz.size or not (np.isfinite(frf["data"]).all() and np.isfinite(line_hz).all()):
            raise file.error(f"{label} is cut off or not finite; export it again")
        response_factor, force_factor = _unit_factors(file, frf, quantity)
        frf_factor = sign * response_factor / force_factor
        accelerances.append(frf_factor * np.asarray(frf["data"]) * (2j * np.pi * line_hz) ** (2 - response_order))
    return frequency_hz, np.array(accelerances)


def _unit_factors(file: UffFile, frf: Mapping[str, Any], quantity: str) -> tuple[float, float]:
    """SI values of the units of response and force, from their labels or else from dataset 164."""
    motion_unit, force_unit = (str(frf[f"{axis}_axis_units_lab"]).strip() for axis in ("ordinate", "orddenom"))
    motion_unit = motion_unit.split("/N")[0].strip("() ") if not force_unit or force_unit == "NONE" else motion_unit
    try:
        return (
            si_factor(quantity, motion_unit) if motion_unit not in ("", "NONE") else 1 / file.units.length,
            si_factor("force", force_unit) if force_unit not in ("", "NONE") else 1 / file.units.force,
        )
    except RigError as error:
        raise file.error(str(error)) from error
