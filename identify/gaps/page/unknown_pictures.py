"""Pictures of an unmeasured force: its place on the rig, its spectrum, its course, and how it follows the motion."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from identify.pages.style import BLUE, GREY, INK, RED
from identify.pages.wording import COVERED
from rig.model.description import Rig, Station
from rig.model.layout import left_ends
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce

_HEIGHT_IN = 3.2
"""Height of a figure, inches. Display."""
_HALF_HEIGHT = 0.09
"""Half the height of a drawn body, where rows of bodies are one apart."""
_ARROW_REACH = 0.34
"""Distance of an arrow's tail from the middle of a body."""
_MIN_LABEL_SPACING = 0.14
"""Share of the longest body's length below which only one of two contacts is named."""
_MOTION_AXIS = {"displacement": 0, "clearance": 0, "velocity": 1, "velocity squared": 1}
"""Axis by which the law of an unmeasured force is drawn: 0 displacement, 1 velocity."""


def drawings(unknown: UnmeasuredForce, rig: Rig) -> Iterator[tuple[str, float, Callable[[Any], None]]]:
    """Name, height in inches and drawing function of each picture."""
    yield "place", 1.5 + 0.8 * len(rig.bodies), partial(_place, unknown=unknown, rig=rig)
    if any(value > 0 for value in unknown.spectrum):
        yield "spectrum", _HEIGHT_IN, partial(_spectrum, unknown=unknown)
    if unknown.over_motion and unknown.against in _MOTION_AXIS:
        axis_index = _MOTION_AXIS[unknown.against]
        yield "law", _HEIGHT_IN, partial(_law, mean_force=unknown.over_motion, axis_index=axis_index)
        yield "motion", _HEIGHT_IN, partial(_motion, mean_force=unknown.over_motion)
    if unknown.by_time:
        yield "time", _HEIGHT_IN, partial(_time, unknown=unknown)


def _place(figure: Any, unknown: UnmeasuredForce, rig: Rig) -> None:
    """Bodies in rows with contacts, sensors and measured forces, and the unmeasured force in red."""
    axes = figure.subplots()
    offsets_m = left_ends(rig)
    rows = {body.name: -float(i) for i, body in enumerate(rig.bodies)}
    longest_m = max(body.length_m for body in rig.bodies) or 1.0

    def coordinates(station: Station) -> tuple[float, float]:
        return offsets_m[station.body] + station.position_m, rows[station.body]

    for body in rig.bodies:
        x, y = offsets_m[body.name], rows[body.name]
        length = body.length_m or 0.08 * longest_m
        start = x if body.length_m else x - length / 2
        colour = RED if body.name in unknown.growth else "#d5dae0"
        axes.fill_between(
            [start, start + length], y - _HALF_HEIGHT, y + _HALF_HEIGHT, color=colour, ec=INK, lw=0.8, zorder=2
        )
        if getattr(body, "ends", "") == "clamped-free":
            axes.fill_between([x - 0.02 * longest_m, x], y - 0.26, y + 0.26, fc="white", ec=INK, hatch="////", lw=0)
    _contacts(axes, rig, coordinates, longest_m)
    sound = np.array([coordinates(s.station) for s in rig.sensors if s.name != unknown.sensor]).reshape(-1, 2)
    axes.plot(sound[:, 0], sound[:, 1] + _HALF_HEIGHT, "v", ms=5, color="white", mec=INK, zorder=4, label="sensors")
    for x, y in map(coordinates, rig.forces):
        _arrow(axes, (x, y - _ARROW_REACH), (x, y - _HALF_HEIGHT), GREY, "->")
    axes.plot([], [], color=GREY, lw=2.2, marker=(3, 0, 0), label="measured force" + "s" * (len(rig.forces) > 1))
    _unknown(axes, unknown, rig, coordinates)
    axes.set_yticks(list(rows.values()), list(rows))
    axes.set_ylim(min(rows.values()) - 0.5, 0.5)
    axes.margins(x=0.05)
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(f"distance from the left end of the {rig.bodies[0].name}, m")
    figure.legend(loc="outside upper center", ncols=4)


def _contacts(axes: Any, rig: Rig, coordinates: Callable[[Station], tuple[float, float]], longest_m: float) -> None:
    labelled_x_m: list[float] = []
    for contact in rig.contacts:
        (x, upper_y), lower_y = coordinates(contact.at), None
        if contact.against is not None:
            lower_y = coordinates(contact.against)[1]
        line_y = (
            (upper_y - _HALF_HEIGHT, upper_y - 0.42) if lower_y is None else sorted((upper_y, lower_y), reverse=True)
        )
        axes.plot([x, x], line_y, color=INK, lw=1.2, ls=":", zorder=1)
        if (
            all(abs(x - named_x_m) > _MIN_LABEL_SPACING * longest_m for named_x_m in labelled_x_m)
            and lower_y is not None
        ):
            axes.annotate(contact.name, (x, (upper_y + lower_y) / 2), (4, 0), textcoords="offset points", va="center")
            labelled_x_m.append(x)
    if rig.contacts:
        axes.plot([], [], color=INK, lw=1.2, ls=":", label="contacts")


def _unknown(
    axes: Any, unknown: UnmeasuredForce, rig: Rig, coordinates: Callable[[Station], tuple[float, float]]
) -> None:
    if unknown.growth:
        axes.plot([], [], color=RED, lw=5, label="stiffness changes")
    for sensor in rig.sensors:
        if sensor.name == unknown.sensor:
            x, y = coordinates(sensor.station)
            axes.plot([x], [y + _HALF_HEIGHT], "v", ms=10, color=RED, mec=INK, zorder=6, label=f"sensor {sensor.name}")
    if unknown.body is None or unknown.position_m is None:
        return
    x, y = coordinates(Station(unknown.body, unknown.position_m))
    reach_m = COVERED * (unknown.position_error_m or 0.0)
    rows_y = [y]
    if unknown.against_body is not None:
        rows_y.append(coordinates(Station(unknown.against_body, unknown.against_position_m or 0.0))[1])
        _arrow(axes, (x, rows_y[0]), (x, rows_y[1]), RED, "<->")
    else:
        _arrow(axes, (x, y - _ARROW_REACH - 0.1), (x, y + _ARROW_REACH + 0.1), RED, "<->")
    for row_y in rows_y:
        axes.fill_between(
            [x - reach_m, x + reach_m],
            row_y - _HALF_HEIGHT,
            row_y + _HALF_HEIGHT,
            color=RED,
            alpha=0.35,
            lw=1,
            zorder=3,
        )
        axes.plot([x], [row_y], "o", ms=7, color=RED, mec="white", zorder=6)
    name = "unknown pair of forces" if len(rows_y) > 1 else "unknown force"
    axes.plot([], [], color=RED, lw=2.6, marker="o", label=f"{name}, {unknown.body} at {unknown.position_m:.2f} m")


def _arrow(axes: Any, tail: tuple[float, float], head: tuple[float, float], colour: str, style: str) -> None:
    axes.annotate("", head, tail, arrowprops={"arrowstyle": style, "color": colour, "lw": 2.4}, zorder=5)


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
