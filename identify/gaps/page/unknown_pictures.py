"""An unknown force in pictures: where it acts on the rig, its spectrum, when it acts, and how it follows the motion."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from identify.gaps.unmeasured_force.location import offset_m
from identify.pages.style import BLUE, GREY, INK, RED
from identify.pages.wording import COVERED
from rig.model.description import Rig, Station
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce

_HEIGHT_IN = 3.2
_HALF = 0.09
"""Half the height of a body, where bodies lie one below the other."""
_REACH = 0.34
"""How far arrows reach beyond the middle of a body."""
_CLOSE = 0.14
"""Contacts closer than this share of the rig's length are not both named."""
_FOLLOWED = {"displacement": 0, "clearance": 0, "velocity": 1, "velocity squared": 1}
"""Whether a law grows with the displacement or the velocity."""


def drawn(unknown: UnmeasuredForce, rig: Rig) -> Iterator[tuple[str, float, Callable[[Any], None]]]:
    """Name, height in inches, and the function that draws."""
    yield "place", 1.5 + 0.8 * len(rig.bodies), partial(_place, unknown=unknown, rig=rig)
    if any(value > 0 for value in unknown.spectrum):
        yield "spectrum", _HEIGHT_IN, partial(_spectrum, unknown=unknown)
    if unknown.over_motion and unknown.against in _FOLLOWED:
        along = _FOLLOWED[unknown.against]
        yield "law", _HEIGHT_IN, partial(_law, mean=unknown.over_motion, along=along)
        yield "motion", _HEIGHT_IN, partial(_motion, mean=unknown.over_motion)
    if unknown.by_time:
        yield "time", _HEIGHT_IN, partial(_time, unknown=unknown)


def left_ends_m(rig: Rig) -> dict[str, float]:
    """Left end of each body along the first, m: stations that touch lie one above the other."""
    ends: dict[str, float] = {}
    for body in rig.bodies:
        touching = [
            ends[other] - offset_m(rig, other, body.name)
            for other in ends
            if any(c.against is not None and {c.at.body, c.against.body} == {other, body.name} for c in rig.contacts)
        ]
        ends[body.name] = touching[0] if touching else 0.0
    return ends


def _place(figure: Any, unknown: UnmeasuredForce, rig: Rig) -> None:
    """Bodies side by side, what touches and drives them, and the unknown in red, along the measured direction."""
    axes = figure.subplots()
    ends = left_ends_m(rig)
    rows = {body.name: -float(i) for i, body in enumerate(rig.bodies)}
    longest = max(body.length_m for body in rig.bodies) or 1.0

    def at(station: Station) -> tuple[float, float]:
        return ends[station.body] + station.position_m, rows[station.body]

    for body in rig.bodies:
        x, y = ends[body.name], rows[body.name]
        length = body.length_m or 0.08 * longest
        start = x if body.length_m else x - length / 2
        colour = RED if body.name in unknown.growth else "#d5dae0"
        axes.fill_between([start, start + length], y - _HALF, y + _HALF, color=colour, ec=INK, lw=0.8, zorder=2)
        if getattr(body, "ends", "") == "clamped-free":
            axes.fill_between([x - 0.02 * longest, x], y - 0.26, y + 0.26, fc="white", ec=INK, hatch="////", lw=0)
    _contacts(axes, rig, at, longest)
    sound = np.array([at(s.station) for s in rig.sensors if s.name != unknown.sensor]).reshape(-1, 2)
    axes.plot(sound[:, 0], sound[:, 1] + _HALF, "v", ms=5, color="white", mec=INK, zorder=4, label="sensors")
    for x, y in map(at, rig.forces):
        _arrow(axes, (x, y - _REACH), (x, y - _HALF), GREY, "->")
    axes.plot([], [], color=GREY, lw=2.2, marker=(3, 0, 0), label="measured force" + "s" * (len(rig.forces) > 1))
    _unknown(axes, unknown, rig, at)
    axes.set_yticks(list(rows.values()), list(rows))
    axes.set_ylim(min(rows.values()) - 0.5, 0.5)
    axes.margins(x=0.05)
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(f"distance from the left end of the {rig.bodies[0].name}, m")
    figure.legend(loc="outside upper center", ncols=4)


def _contacts(axes: Any, rig: Rig, at: Callable[[Station], tuple[float, float]], longest: float) -> None:
    named: list[float] = []
    for contact in rig.contacts:
        (x, top), low = at(contact.at), None
        if contact.against is not None:
            low = at(contact.against)[1]
        ends = (top - _HALF, top - 0.42) if low is None else sorted((top, low), reverse=True)
        axes.plot([x, x], ends, color=INK, lw=1.2, ls=":", zorder=1)
        if all(abs(x - other) > _CLOSE * longest for other in named) and low is not None:
            axes.annotate(contact.name, (x, (top + low) / 2), (4, 0), textcoords="offset points", va="center")
            named.append(x)
    if rig.contacts:
        axes.plot([], [], color=INK, lw=1.2, ls=":", label="contacts")


def _unknown(axes: Any, unknown: UnmeasuredForce, rig: Rig, at: Callable[[Station], tuple[float, float]]) -> None:
    if unknown.growth:
        axes.plot([], [], color=RED, lw=5, label="stiffness changes")
    for sensor in rig.sensors:
        if sensor.name == unknown.sensor:
            x, y = at(sensor.station)
            axes.plot([x], [y + _HALF], "v", ms=10, color=RED, mec=INK, zorder=6, label=f"sensor {sensor.name}")
    if unknown.body is None or unknown.position_m is None:
        return
    x, y = at(Station(unknown.body, unknown.position_m))
    reach = COVERED * (unknown.position_error_m or 0.0)
    places = [y]
    if unknown.against_body is not None:
        places.append(at(Station(unknown.against_body, unknown.against_position_m or 0.0))[1])
        _arrow(axes, (x, places[0]), (x, places[1]), RED, "<->")
    else:
        _arrow(axes, (x, y - _REACH - 0.1), (x, y + _REACH + 0.1), RED, "<->")
    for place in places:
        axes.fill_between([x - reach, x + reach], place - _HALF, place + _HALF, color=RED, alpha=0.35, lw=1, zorder=3)
        axes.plot([x], [place], "o", ms=7, color=RED, mec="white", zorder=6)
    name = "unknown pair of forces" if len(places) > 1 else "unknown force"
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


def _law(figure: Any, mean: MeanForce, along: int) -> None:
    """The mean force of every cell over the displacement or the velocity, in the colour of the other."""
    w, v = (np.convolve(edges, [0.5, 0.5], "valid") for edges in (mean.displacement_m, mean.velocity_m_per_s))
    force = np.array(mean.force_n)
    i, j = np.nonzero(force)
    seen = (1e3 * w[i], v[j])
    names = ("displacement there, mm", "velocity there, m/s")
    axes = figure.subplots()
    dots = axes.scatter(seen[along], force[i, j], c=seen[1 - along], s=10, cmap="viridis")
    figure.colorbar(dots, label=names[1 - along])
    axes.set(xlabel=names[along], ylabel="mean force against the motion, N")
    figure.suptitle("How it follows the motion", fontsize=10)


def _motion(figure: Any, mean: MeanForce) -> None:
    axes = figure.subplots()
    force = np.array(mean.force_n)
    most = float(np.abs(force).max()) or 1.0
    cells = axes.pcolormesh(
        1e3 * np.array(mean.displacement_m),
        mean.velocity_m_per_s,
        np.where(force == 0, np.nan, force).T,
        cmap="RdBu_r",
        vmin=-most,
        vmax=most,
    )
    figure.colorbar(cells, label="mean force against the motion, N")
    axes.set(xlabel="displacement there, mm", ylabel="velocity there, m/s")
    figure.suptitle("Over displacement and velocity", fontsize=10)


def _time(figure: Any, unknown: UnmeasuredForce) -> None:
    """The rms of the force in equal parts of the time, beside what it is before the measured force begins."""
    axes = figure.subplots()
    edges = np.linspace(0, 100, len(unknown.by_time) + 1)
    axes.bar(edges[:-1], unknown.by_time, width=np.diff(edges) * 0.92, align="edge", color=BLUE)
    if unknown.before_excitation > 0:
        whole = float(np.sqrt(np.mean(np.square(unknown.by_time))))
        axes.axhline(unknown.before_excitation * whole, color=RED, ls="--", label="before the measured force begins")
        figure.legend(loc="outside lower center")
    axes.set(xlim=(0, 100), xlabel="time since the measured force began, %", ylabel="rms, N")
    figure.suptitle("When it acts", fontsize=10)
