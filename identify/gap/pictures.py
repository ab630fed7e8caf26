"""The pictures of a diagnosis: where the gap is, why it is there, how far it shrinks. Computes no estimate."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from io import BytesIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from identify.gap.results import Curve, Gap, Share, Surface
from identify.gap.wording import cause_name, closed, none_of_these
from identify.wording import number, percent

Draw = Callable[[Any], None]

_BLUE, _RED, _GREY, _GREEN = "#1f5fa8", "#c8402f", "#8a8a8a", "#2c8a57"
_WIDTH_IN, _ROW_IN, _FRAME_IN, _HEIGHT_IN = 4.8, 0.3, 1.0, 3.2
_LONGEST = 34
"""Letters of a name beside a bar."""
_MOST_LABELS = 12
_DECADES = 20.0
"""Sizes further apart than this are drawn over decades."""
_STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "text.parse_math": False,  # names of sensors may hold any sign
}


def pictures(gap: Gap) -> dict[str, bytes]:
    """PNG files by name, which begins with the section: is, where, why or far. What the diagnosis lacks is left out."""
    return {name: _png(draw, height) for name, height, draw in _drawn(gap)}


def _drawn(gap: Gap) -> Iterator[tuple[str, float, Draw]]:
    """Name, height in inches, and the function that draws."""
    where = gap.where
    yield "is_size", _height(3 if gap.verdict == "effect" else 2), partial(_size, gap=gap)
    for name, shares, title in (
        ("channels", where.channels, "By channel"),
        ("modal_equations", where.modal_equations, "By modal equation"),
        ("parts", where.parts, "Linear structure or contact laws"),
        ("contact_state", where.contact_state, "By contact state"),
    ):
        if shares:
            yield f"where_{name}", _height(len(shares)), partial(_bars, shares=shares, title=title)
    if where.positions_m:
        yield "where_positions", 0.6 + 1.5 * len(where.positions_m), partial(_positions, bodies=where.positions_m)
    if where.band_hz:
        yield "where_band", _HEIGHT_IN, partial(_row, shares=where.band_hz, title="By frequency", along="band, Hz")
    if where.time_s:
        yield "where_time", _HEIGHT_IN, partial(_row, shares=where.time_s, title="Over time", along="time, s")
    for j, (contact, surface) in enumerate(where.surface.items(), 1):
        yield f"where_surface_{j}", _HEIGHT_IN, partial(_surface, surface=surface, contact=contact)
    if gap.causes:
        height = _height(1.5 * len(gap.causes) + 2)
        yield "why_probability", height, partial(_probability, gap=gap)
        yield "why_left", height, partial(_left, gap=gap)
    yield "far_closure", _height(3), partial(_closure, gap=gap)
    for j, curve in enumerate(gap.curves, 1):
        yield f"far_curve_{j}", _HEIGHT_IN, partial(_curve, curve=curve)


def _png(draw: Draw, height_in: float) -> bytes:
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained", dpi=160)
        FigureCanvasAgg(figure)
        draw(figure)
        content = BytesIO()
        figure.savefig(content, format="png")
        return content.getvalue()


def _height(rows: float | int) -> float:
    return _FRAME_IN + _ROW_IN * rows


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…"


def _stacked(name: str) -> str:
    """A cause, one effect a line."""
    first, *others = name.split(" + ")
    return "\n".join([_short(first), *(_short(f"+ {other}") for other in others)])


def _lying(
    figure: Any, names: Sequence[str], sizes: Sequence[float], said: Sequence[str], colours: Sequence[str], left: float
) -> Any:
    """Lying bars that begin at `left`, the first on top, with what is said of each at its end."""
    axes = figure.subplots()
    bars = axes.barh(np.arange(len(names)), np.array(sizes) - left, left=left, height=0.62, color=colours)
    axes.bar_label(bars, said, padding=4)
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    return axes


def _decades(axis: Any) -> None:
    """Plain numbers along a logarithmic axis; between the powers of ten only where it spans few."""
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    low, high = sorted(axis.get_view_interval())
    axis.set_major_formatter(plain)
    few = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    axis.set_minor_formatter(few if high < 20 * low else NullFormatter())


def _sized(figure: Any, names: Sequence[str], sizes: Sequence[float], label: str, title: str) -> None:
    """Lying bars of gap sizes over decades, the first that of the believed rig; the floor is marked at 1."""
    low, high = 0.6 * min([s for s in sizes if s > 0] + [1.0]), max(*sizes, 1.0)
    colours = [_RED] + [_BLUE] * (len(sizes) - 1)
    axes = _lying(figure, names, sizes, [number(s, 3) for s in sizes], colours, low)
    axes.set_xscale("log")
    axes.set_xlim(low, 1.5 * high * (high / low) ** 0.2)
    _decades(axes.xaxis)
    axes.axvline(1.0, color=_GREEN, lw=1.6, ls="--", label="what nulls leave")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0)
    axes.set_xlabel(label)
    figure.suptitle(title, fontsize=10)


def _size(figure: Any, gap: Gap) -> None:
    names, sizes = ["rig as believed"], [gap.size]
    if gap.verdict == "effect" and gap.causes:
        names, sizes = [*names, "with the likeliest cause"], [*sizes, gap.causes[0].left]
    _sized(figure, names, sizes, "size of the gap (nulls leave 1)", "Size of the gap")


def _bars(figure: Any, shares: Mapping[str, float], title: str) -> None:
    sizes = [100 * s for s in shares.values()]
    names = [_short(n) for n in shares]
    axes = _lying(figure, names, sizes, [f"{s:.1f}" for s in sizes], [_BLUE] * len(sizes), 0.0)
    axes.margins(x=0.18)
    axes.set(xlabel="share of the gap, %")
    figure.suptitle(title, fontsize=10)


def _row(figure: Any, shares: Sequence[Share], title: str, along: str) -> None:
    axes = figure.subplots()
    axes.bar(np.arange(len(shares)), [100 * s.share for s in shares], width=0.85, color=_BLUE)
    few = slice(None, None, -(-len(shares) // _MOST_LABELS))
    names = [_short(s.what.removesuffix(" Hz").removesuffix(" s")) for s in shares]
    axes.set_xticks(np.arange(len(shares))[few], names[few], rotation=40, ha="right", rotation_mode="anchor")
    axes.grid(axis="x", visible=False)
    axes.set(xlabel=along, ylabel="share of the gap, %", title=title)


def _positions(figure: Any, bodies: Mapping[str, Mapping[str, float]]) -> None:
    """Each body as a thick line from its left end, a bar at every station."""
    panels = figure.subplots(len(bodies), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    longest = max([float(at) for stations in bodies.values() for at in stations], default=0.0) or 1.0
    for axes, (body, stations) in zip(panels, bodies.items(), strict=True):
        places = np.array([float(at) for at in stations])
        sizes = 100 * np.array(list(stations.values()))
        axes.plot([0.0, max(places.max(initial=0.0), 0.02 * longest)], [0, 0], color="#444444", lw=5, zorder=3)
        bars = axes.bar(places, sizes, width=0.04 * longest, color=_BLUE)
        axes.plot(places, 0 * places, "^", ms=5, color="white", mec="#444444", zorder=4, clip_on=False)
        if places.size <= _MOST_LABELS:
            axes.bar_label(bars, [f"{s:.0f}" for s in sizes], padding=2)
        axes.margins(y=0.22)
        axes.set_title(_short(body), loc="left", fontsize=9)
    panels[-1].set_xlabel("distance from the left end, m")
    figure.supylabel("share of the gap, %", fontsize=9)
    figure.suptitle("Along the bodies (stations marked)", fontsize=10)


def _surface(figure: Any, surface: Surface, contact: str) -> None:
    axes = figure.subplots()
    share = 100 * np.array(surface.share)
    cells = axes.pcolormesh(
        1e3 * np.array(surface.eta_m), surface.rate_m_per_s, np.where(share > 0, share, np.nan).T, cmap="viridis_r"
    )
    figure.colorbar(cells, label="share of the gap, %")
    axes.set(xlabel="displacement, mm", ylabel="velocity, m/s", title=f"At {_short(contact)}")


def _probability(figure: Any, gap: Gap) -> None:
    name, rest = none_of_these(gap)
    sizes = [100 * c.probability for c in gap.causes] + [100 * rest]
    names = [_stacked(cause_name(c)) for c in gap.causes] + [name]
    said = [percent(s / 100) for s in sizes]
    axes = _lying(figure, names, sizes, said, [_BLUE] * len(gap.causes) + [_GREY], 0.0)
    axes.set(xlim=(0, 130), xticks=range(0, 101, 25), xlabel="probability, %")
    figure.suptitle("What causes the gap", fontsize=10)


def _left(figure: Any, gap: Gap) -> None:
    sizes = [gap.size, *(c.left for c in gap.causes)]
    names = ["rig as believed", *(_stacked(cause_name(c)) for c in gap.causes)]
    _sized(figure, names, sizes, "left of the gap (nulls leave 1)", "What each cause leaves on the validation record")


def _closure(figure: Any, gap: Gap) -> None:
    found = gap.closure
    sizes = [found.before, found.floor, found.after]
    far = min(sizes) > 0 and max(sizes) > _DECADES * min(sizes)
    start = 0.5 * min(sizes) if far else 0.0
    axes = _lying(
        figure, ["before", "floor", "after"], sizes, [number(s, 3) for s in sizes], [_RED, _GREEN, _BLUE], start
    )
    if far:
        axes.set_xscale("log")
        axes.set_xlim(start, 1.2 * max(sizes) * (max(sizes) / start) ** 0.2)
        _decades(axes.xaxis)
    axes.margins(x=0.2)
    axes.set_xlabel("mean square of the whitened residual")
    figure.suptitle(f"Closed: {closed(found)}", fontsize=10)


def _curve(figure: Any, curve: Curve) -> None:
    axes = figure.subplots()
    for values, colour, width, label in (
        (curve.measured, _GREY, 2.4, "measured"),
        (curve.believed, _RED, 1.0, "simulated as believed"),
        (curve.corrected, _BLUE, 1.0, "simulated, corrected"),
    ):
        axes.plot(curve.x, values, color=colour, lw=width, ls="--" if colour == _RED else "-", label=label)
    if curve.logarithmic:
        axes.set_yscale("log", nonpositive="mask")
        _decades(axes.yaxis)
    figure.legend(loc="outside lower center", ncols=3, columnspacing=1.0, handlelength=1.6)
    axes.set(xlabel=curve.x_label, ylabel=curve.y_label)
    axes.set_title(curve.name, wrap=True)
