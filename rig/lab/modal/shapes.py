"""Mode shapes at nodes (UFF dataset 55), mass-normalised."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from rig.lab.modal.file import AXES, Choice, UffFile, line_of
from rig.model.structure import Structure, structure_of

RIGID_HZ = 0.01
"""A mode shape below is that of a rigid-body mode: a finite-element program gives it by rounding."""
ACROSS = 0.05
"""A mode with less than this share of its motion in the direction is not the structure's."""
COMPLEX = 0.2
"""A shape with more than this share out of phase has no normal mode near it."""


class ModeShapes:
    """The mode shapes of a file, mass-normalised in SI."""

    def __init__(self, file: UffFile, choice: Choice) -> None:
        self.file = file
        sets = sorted((_mode(file, one) for one in file.sets[55]), key=lambda mode: mode.frequency_hz)
        sets = [mode for mode in sets if set(choice.nodes) <= set(mode.shapes)] or sets
        shared = set.intersection(*(set(mode.shapes) for mode in sets))
        if not (shared or choice.nodes):
            raise file.wrong("no node is in all its mode shapes, as of several bodies; name those of one by nodes")
        self.nodes, self.places, self.length_m, told = line_of(file, choice, shared)
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


def _mode(file: UffFile, one: Mapping[str, Any]) -> _Mode:
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
