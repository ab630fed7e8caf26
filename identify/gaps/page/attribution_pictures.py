"""Pictures of where the mismatch lies: by channel, modal equation, station, band, time, contact state and motion."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from identify.gaps.page.axes import MOST_LABELS, lying_bars, short
from identify.gaps.results import Attribution, ResidualMap, Share
from identify.pages.style import BLUE, INK

_ROW_IN, _FRAME_IN, _HEIGHT_IN = 0.3, 1.0, 3.2


def drawn(where: Attribution) -> Iterator[tuple[str, float, Callable[[Any], None]]]:
    """Name, height in inches, and the function that draws; not where all shares are zero, as the acceleration's of a
    single mass, whose gap lies in the contact force."""
    if any(any(stations.values()) for stations in where.positions_m.values()):
        yield "positions", 0.6 + 1.5 * len(where.positions_m), partial(_positions, bodies=where.positions_m)
    if any(s.share for s in where.band_hz):
        yield "band", _HEIGHT_IN, partial(_row, shares=where.band_hz, title="By frequency", along="band, Hz")
    for name, shares, title in (
        ("channels", where.channels, "By channel"),
        ("modal_equations", where.modal_equations, "By modal equation"),
        ("parts", where.parts, "Linear structure or contact laws"),
        ("contact_state", where.contact_state, "By contact state"),
    ):
        if any(shares.values()):
            yield name, _FRAME_IN + _ROW_IN * len(shares), partial(_bars, shares=shares, title=title)
    if any(s.share for s in where.time_s):
        yield "time", _HEIGHT_IN, partial(_row, shares=where.time_s, title="Over time", along="time, s")
    for j, (contact, surface) in enumerate(where.surface.items(), 1):
        yield f"surface_{j}", _HEIGHT_IN, partial(_surface, surface=surface, contact=contact)


def _bars(figure: Any, shares: Mapping[str, float], title: str) -> None:
    sizes = [100 * s for s in shares.values()]
    axes = lying_bars(figure, [short(n) for n in shares], sizes, [f"{s:.1f}" for s in sizes], BLUE)
    axes.margins(x=0.18)
    axes.set(xlabel="share of the gap, %")
    figure.suptitle(title, fontsize=10)


def _row(figure: Any, shares: Sequence[Share], title: str, along: str) -> None:
    axes = figure.subplots()
    axes.bar(np.arange(len(shares)), [100 * s.share for s in shares], width=0.85, color=BLUE)
    few = slice(None, None, -(-len(shares) // MOST_LABELS))
    names = [short(f"{s.begin:.3g} to {s.end:.3g}") for s in shares]
    axes.set_xticks(np.arange(len(shares))[few], names[few], rotation=40, ha="right", rotation_mode="anchor")
    axes.grid(axis="x", visible=False)
    axes.set(xlabel=along, ylabel="share of the gap, %", title=title)


def _positions(figure: Any, bodies: Mapping[str, Mapping[float, float]]) -> None:
    """Each body as a thick line from its left end, a bar at every station."""
    panels = figure.subplots(len(bodies), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    longest = max([at for stations in bodies.values() for at in stations], default=0.0) or 1.0
    for axes, (body, stations) in zip(panels, bodies.items(), strict=True):
        places = np.array(list(stations))
        sizes = 100 * np.array(list(stations.values()))
        axes.plot([0.0, max(places.max(initial=0.0), 0.02 * longest)], [0, 0], color=INK, lw=5, zorder=3)
        bars = axes.bar(places, sizes, width=0.04 * longest, color=BLUE)
        axes.plot(places, 0 * places, "^", ms=5, color="white", mec=INK, zorder=4, clip_on=False)
        if places.size <= MOST_LABELS:
            axes.bar_label(bars, [f"{s:.0f}" for s in sizes], padding=2)
        axes.margins(y=0.22)
        axes.set_title(short(body), loc="left", fontsize=9)
    panels[-1].set_xlabel("distance from the left end, m")
    figure.supylabel("share of the gap, %", fontsize=9)
    figure.suptitle("Along the bodies (stations marked)", fontsize=10)


def _surface(figure: Any, surface: ResidualMap, contact: str) -> None:
    axes = figure.subplots()
    share = 100 * np.array(surface.share)
    cells = axes.pcolormesh(
        1e3 * np.array(surface.eta_m), surface.rate_m_per_s, np.where(share > 0, share, np.nan).T, cmap="viridis_r"
    )
    figure.colorbar(cells, label="share of the gap, %")
    axes.set(xlabel="displacement, mm", ylabel="velocity, m/s", title=f"At {short(contact)}")
