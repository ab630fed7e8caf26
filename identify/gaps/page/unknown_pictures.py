"""Pictures of an unmeasured force: its spectrum, its course, and how it follows the motion."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from identify.gaps.unmeasured_force.force_laws import LAW_FORMS
from identify.pages.style import BLUE, INK, RED
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce

_HEIGHT_IN = 3.2
"""Height of a figure, inches. Display."""
_MOTION_AXIS = {"displacement": 0, "clearance": 0, "velocity": 1, "velocity squared": 1}
"""Axis by which the law of an unmeasured force is drawn: 0 displacement, 1 velocity."""
LINE_POINTS = 400
"""Points of the line of a law. Display."""
MIN_CELLS = 4
"""Cells below which no line is drawn over them: the linear part has three unknowns."""


def drawings(unknown_force: UnmeasuredForce) -> Iterator[tuple[str, float, Callable[[Any], None]]]:
    """Name, height in inches and drawing function of each picture."""
    if any(spectral_density > 0 for spectral_density in unknown_force.spectrum):
        yield "spectrum", _HEIGHT_IN, partial(_draw_spectrum, unknown_force=unknown_force)
    if unknown_force.over_motion and unknown_force.against in _MOTION_AXIS:
        axis = _MOTION_AXIS[unknown_force.against]
        yield "law", _HEIGHT_IN, partial(_draw_law, unknown_force, unknown_force.over_motion, axis)
        yield "motion", _HEIGHT_IN, partial(_draw_mean_force_map, mean_force=unknown_force.over_motion)
    if unknown_force.by_time:
        yield "time", _HEIGHT_IN, partial(_draw_rms_by_time, unknown_force=unknown_force)


def _draw_spectrum(figure: Any, unknown_force: UnmeasuredForce) -> None:
    axes = figure.subplots()
    unit = "(m/s²)²/Hz" if unknown_force.kind == "sensor" else "N²/Hz"
    density, centres_hz = np.array(unknown_force.spectrum), np.array(unknown_force.spectrum_hz)
    axes.semilogy(centres_hz, np.where(density > 0, density, np.nan), color=BLUE, drawstyle="steps-mid")
    axes.axvspan(*unknown_force.band_hz, color=BLUE, alpha=0.12, lw=0, label="90 % of its power")
    if (frequency_hz := unknown_force.frequency_hz) is not None:
        axes.axvline(frequency_hz, color=RED, lw=1.2, ls="--", label=f"{frequency_hz:.2f} Hz")
    axes.set_xlim(0, float(centres_hz[-1] + centres_hz[0]))
    axes.set(xlabel="frequency, Hz", ylabel=f"spectral density, {unit}")
    figure.suptitle("Its spectrum", fontsize=10)
    figure.legend(loc="outside lower center", ncols=2)


def _draw_law(unknown_force: UnmeasuredForce, mean_force: MeanForce, axis: int, figure: Any) -> None:
    """Mean force of each cell over displacement (axis 0) or velocity (axis 1), coloured by the other, and the law."""
    displacements_m, velocities_m_per_s = (
        np.convolve(edges, [0.5, 0.5], "valid") for edges in (mean_force.displacement_m, mean_force.velocity_m_per_s)
    )
    mean_forces_n = np.array(mean_force.force_n)
    rows, columns = np.nonzero(mean_forces_n)
    cell_forces_n = mean_forces_n[rows, columns]
    cell_motion = np.stack([displacements_m[rows], velocities_m_per_s[columns]])
    drawn_motion = (1e3 * cell_motion[0], cell_motion[1])
    axis_names = ("displacement there, mm", "velocity there, m/s")
    if (
        law_values := _law_curve_and_cell_forces(unknown_force, cell_motion, axis)
        if cell_forces_n.size >= MIN_CELLS
        else None
    ):
        line_motion, line_forces_n, cell_law_n = law_values
        cell_forces_n = cell_forces_n - _linear_force_difference_n(cell_motion, cell_forces_n, cell_law_n)
    axes = figure.subplots()
    points = axes.scatter(drawn_motion[axis], cell_forces_n, c=drawn_motion[1 - axis], s=10, cmap="coolwarm")
    figure.colorbar(points, label=axis_names[1 - axis])
    if law_values:
        axes.plot((1e3, 1.0)[axis] * line_motion, line_forces_n, color=INK, lw=2.2, label="the law found")
        figure.legend(loc="outside lower center")
    axes.set(xlabel=axis_names[axis], ylabel="mean force against the motion, N")
    figure.suptitle("How it follows the motion", fontsize=10)


def _law_curve_and_cell_forces(
    unknown_force: UnmeasuredForce, cell_motion: Float[np.ndarray, "2 cells"], axis: int
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"], Float[np.ndarray, " cells"]] | None:
    """Motion along the axis and the law there, N, with the other motion zero, and the law in each cell, N; nothing
    without a law."""
    law_form = next((form for form in LAW_FORMS if form.name == unknown_force.law_name), None)
    if law_form is None:
        return None
    values = {name: value.value for name, value in unknown_force.law_parameters.items()}
    coefficients = [values[name] for name in ("coefficient", "cubic")[: len(law_form.coefficient_units)]]

    def law_n(motion: Float[np.ndarray, "2 points"]) -> Float[np.ndarray, " points"]:
        shapes = law_form.unit_forces(
            motion[0] + values.get("offset", 0.0), motion[1], values.get(law_form.parameter_name, 0.0)
        )
        return np.einsum("c,cp->p", coefficients, np.array(shapes))

    line_motion = np.zeros((2, LINE_POINTS))
    line_motion[axis] = np.linspace(cell_motion[axis].min(), cell_motion[axis].max(), LINE_POINTS)
    return line_motion[axis], law_n(line_motion), law_n(cell_motion)


def _linear_force_difference_n(
    cell_motion: Float[np.ndarray, "2 cells"],
    cell_forces_n: Float[np.ndarray, " cells"],
    cell_law_n: Float[np.ndarray, " cells"],
) -> Float[np.ndarray, " cells"]:
    """Part a w + b v + c by which the free force of the cells differs from the law, by least squares, N.

    Tolerances take up much of a force that is linear in the motion, so that the free force lacks such a part. Zero for
    a law that is linear itself.
    """
    linear_columns = np.vstack([cell_motion, np.ones(cell_forces_n.size)]).T

    def linear_part_n(forces_n: Float[np.ndarray, " cells"]) -> Float[np.ndarray, " cells"]:
        return linear_columns @ np.linalg.lstsq(linear_columns, forces_n, rcond=None)[0]

    if np.allclose(linear_part_n(cell_law_n), cell_law_n, rtol=0, atol=1e-6 * np.abs(cell_law_n).max()):
        return np.zeros(cell_forces_n.size)
    return linear_part_n(cell_forces_n - cell_law_n)


def _draw_mean_force_map(figure: Any, mean_force: MeanForce) -> None:
    axes = figure.subplots()
    forces_n = np.array(mean_force.force_n)
    largest_n = float(np.abs(forces_n).max()) or 1.0
    drawn_n = np.where(forces_n == 0, np.nan, forces_n).T
    edges_mm, edges_m_per_s = 1e3 * np.array(mean_force.displacement_m), mean_force.velocity_m_per_s
    mesh = axes.pcolormesh(edges_mm, edges_m_per_s, drawn_n, cmap="RdBu_r", vmin=-largest_n, vmax=largest_n)
    figure.colorbar(mesh, label="mean force against the motion, N")
    axes.set(xlabel="displacement there, mm", ylabel="velocity there, m/s")
    figure.suptitle("Over displacement and velocity", fontsize=10)


def _draw_rms_by_time(figure: Any, unknown_force: UnmeasuredForce) -> None:
    """Root mean square of the force in equal intervals of time, and before the measured force begins."""
    axes = figure.subplots()
    edges = np.linspace(0, 100, len(unknown_force.by_time) + 1)
    axes.bar(edges[:-1], unknown_force.by_time, width=np.diff(edges) * 0.92, align="edge", color=BLUE)
    if unknown_force.before_excitation > 0:
        before_n = unknown_force.before_excitation * float(np.sqrt(np.mean(np.square(unknown_force.by_time))))
        axes.axhline(before_n, color=RED, ls="--", label="before the measured force begins")
        figure.legend(loc="outside lower center")
    axes.set(xlim=(0, 100), xlabel="time since the measured force began, %", ylabel="rms, N")
    figure.suptitle("When it acts", fontsize=10)
