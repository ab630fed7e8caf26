"""Pictures of an unmeasured force: its spectrum, its course, and how it follows the motion."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from identify.pages.style import BLUE, RED
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce

_HEIGHT_IN = 3.2
"""Height of a figure, inches. Display."""
_MOTION_AXIS = {"displacement": 0, "clearance": 0, "velocity": 1, "velocity squared": 1}
"""Axis by which the law of an unmeasured force is drawn: 0 displacement, 1 velocity."""


def drawings(unknown: UnmeasuredForce) -> Iterator[tuple[str, float, Callable[[Any], None]]]:
    """Name, height in inches and drawing function of each picture."""
    if any(value > 0 for value in unknown.spectrum):
        yield "spectrum", _HEIGHT_IN, partial(_spectrum, unknown=unknown)
    if unknown.over_motion and unknown.against in _MOTION_AXIS:
        axis_index = _MOTION_AXIS[unknown.against]
        yield "law", _HEIGHT_IN, partial(_law, mean_force=unknown.over_motion, axis_index=axis_index)
        yield "motion", _HEIGHT_IN, partial(_motion, mean_force=unknown.over_motion)
    if unknown.by_time:
        yield "time", _HEIGHT_IN, partial(_time, unknown=unknown)


def _spectrum(figure: Any, unknown: UnmeasuredForce) -> None:
    axes = figure.subplots()
    unit = "(m/s²)²/Hz" if unknown.kind == "sensor" else "N²/Hz"
    density = np.array(unknown.spectrum)
    middle = np.array(unknown.spectrum_hz)
    axes.semilogy(middle, np.where(density > 0, density, np.nan), color=BLUE, drawstyle="steps-mid")
    axes.axvspan(*unknown.band_hz, color=BLUE, alpha=0.12, lw=0, label="90 % of its power")
    if unknown.frequency_hz is not None:
        axes.axvline(unknown.frequency_hz, color=RED, lw=1.2, ls="--", label=f"{unknown.frequency_hz:.2f} Hz")
    axes.set_xlim(0, float(middle[-1] + middle[0]))
    axes.set(xlabel="frequency, Hz", ylabel=f"spectral density, {unit}")
    figure.suptitle("Its spectrum", fontsize=10)
    figure.legend(loc="outside lower center", ncols=2)


def _law(figure: Any, mean_force: MeanForce, axis_index: int) -> None:
    """Mean force of each cell over displacement (axis 0) or velocity (axis 1), coloured by the other."""
    w, v = (
        np.convolve(edges, [0.5, 0.5], "valid") for edges in (mean_force.displacement_m, mean_force.velocity_m_per_s)
    )
    force = np.array(mean_force.force_n)
    i, j = np.nonzero(force)
    motion = (1e3 * w[i], v[j])
    names = ("displacement there, mm", "velocity there, m/s")
    axes = figure.subplots()
    cell_points = axes.scatter(motion[axis_index], force[i, j], c=motion[1 - axis_index], s=10, cmap="viridis")
    figure.colorbar(cell_points, label=names[1 - axis_index])
    axes.set(xlabel=names[axis_index], ylabel="mean force against the motion, N")
    figure.suptitle("How it follows the motion", fontsize=10)


def _motion(figure: Any, mean_force: MeanForce) -> None:
    axes = figure.subplots()
    force = np.array(mean_force.force_n)
    largest_force_n = float(np.abs(force).max()) or 1.0
    cells = axes.pcolormesh(
        1e3 * np.array(mean_force.displacement_m),
        mean_force.velocity_m_per_s,
        np.where(force == 0, np.nan, force).T,
        cmap="RdBu_r",
        vmin=-largest_force_n,
        vmax=largest_force_n,
    )
    figure.colorbar(cells, label="mean force against the motion, N")
    axes.set(xlabel="displacement there, mm", ylabel="velocity there, m/s")
    figure.suptitle("Over displacement and velocity", fontsize=10)


def _time(figure: Any, unknown: UnmeasuredForce) -> None:
    """Root mean square of the force in equal intervals of time, and before the measured force begins."""
    axes = figure.subplots()
    edges = np.linspace(0, 100, len(unknown.by_time) + 1)
    axes.bar(edges[:-1], unknown.by_time, width=np.diff(edges) * 0.92, align="edge", color=BLUE)
    if unknown.before_excitation > 0:
        rms_n = float(np.sqrt(np.mean(np.square(unknown.by_time))))
        axes.axhline(unknown.before_excitation * rms_n, color=RED, ls="--", label="before the measured force begins")
        figure.legend(loc="outside lower center")
    axes.set(xlim=(0, 100), xlabel="time since the measured force began, %", ylabel="rms, N")
    figure.suptitle("When it acts", fontsize=10)
