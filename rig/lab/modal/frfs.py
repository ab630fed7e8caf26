"""A structure fitted to frequency response functions (FRFs; UFF dataset 58)."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.lab.modal.file import AXES, Choice, UffFile, line_of
from rig.lab.modal.fit import ModalFit, fit_modes
from rig.lab.units import si_factor
from rig.model.structure import Structure, structure_of
from rig.model.tolerances import Tolerances

_ORDERS = {8: (0, "displacement"), 11: (1, "velocity"), 12: (2, "acceleration")}
_FORCES = (9, 13)
_FRF = 4


def from_frfs(file: UffFile, choice: Choice) -> tuple[Structure, tuple[str, ...], Tolerances]:
    frfs = [one for one in file.sets[58] if one["func_type"] == _FRF]
    if not frfs:
        raise file.wrong("its datasets 58 are no FRFs; export receptances, mobilities or accelerances")
    ends = [((abs(one["rsp_dir"]), one["rsp_node"]), (abs(one["ref_dir"]), one["ref_node"])) for one in frfs]
    axis = AXES.index(choice.direction) + 1 if choice.direction else Counter(e[0][0] for e in ends).most_common(1)[0][0]
    if axis not in (1, 2, 3):
        raise file.wrong("its FRFs do not say their directions; export them with node and direction")
    driving, rows = _common_point(file, frfs, axis)
    nodes, places, length_m, told = line_of(file, choice, rows)
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
    left = max(float(f"{np.median(fit.misfit_of_modes):.2g}"), Tolerances().unmodelled)
    return body, notes, Tolerances(unmodelled=left, highest_hz=float(f"{frequency_hz[-1]:.4g}"))


def _misfits(nodes: Iterable[int], fit: ModalFit) -> Iterable[str]:
    for frequency_hz, ratio in zip(fit.frequencies_hz, fit.ratios, strict=True):
        yield f"mode: {frequency_hz:.6g} Hz, damping ratio {ratio:.4g}"
    for node, error, by_modes in zip(nodes, fit.misfit, fit.misfit_of_modes, strict=True):
        yield f"misfit at node {node}: {error:.2%} rms of the FRF; {by_modes:.2%} by the modes without residuals"


def _common_point(
    file: UffFile, frfs: list[dict[str, Any]], axis: int
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
    file: UffFile, rows: list[tuple[float, dict[str, Any]]]
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


def _labels(file: UffFile, one: Mapping[str, Any], quantity: str) -> tuple[float, float]:
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
