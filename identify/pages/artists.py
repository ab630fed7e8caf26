"""Artists of a matplotlib figure drawn by Bokeh: curves, steps, bars, error bars, points, hexagons, meshes, labels.

Notes for maintainers
1. `is_drawable` says whether all artists of an axes are known; a figure with any other stays a picture.
2. Cells (hexagons, meshes) and coloured points take the colour map and the limits of the matplotlib artist, and the
   label of the figure's colour bar.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from jaxtyping import Float

MOST_POINTS = 2500
"""Most points of a curve; of more, the minimum and maximum of every bucket are kept, as a screen shows them."""
COLOUR_BAR = "<colorbar>"
"""Label that matplotlib gives to the axes of a colour bar."""
_PX_PER_POINT = 1.33
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
_MARKERS = {"^": "triangle", "v": "inverted_triangle", "|": "dash", "_": "dash"}
_ALIGNMENTS = {"center": "center", "left": "left", "right": "right"}
_BASELINES = {
    "center": "middle",
    "center_baseline": "middle",
    "bottom": "bottom",
    "top": "top",
    "baseline": "alphabetic",
}
LabelledRenderers = Iterator[tuple[str, Any]]
"""Labels and their Bokeh renderers; a label that begins with _ is not shown."""


def is_drawable(axes: Any) -> bool:
    """True if `draw_artists` and `tick_names` can show everything in the axes."""
    from matplotlib.collections import LineCollection, PathCollection, PolyCollection, QuadMesh
    from matplotlib.patches import Rectangle, StepPatch
    from matplotlib.ticker import FuncFormatter

    computes_ticks = any(
        isinstance(axis.get_major_formatter(), FuncFormatter) and axis.get_scale() != "log" and not tick_names(axis)
        for axis in (axes.xaxis, axes.yaxis)
    )
    known = (LineCollection, PathCollection, PolyCollection, QuadMesh)
    collections_known = all(type(artist) in known for artist in axes.collections)
    patches_known = all(isinstance(patch, Rectangle | StepPatch) for patch in axes.patches)
    return collections_known and patches_known and not computes_ticks and all(map(_is_bar_label, axes.texts))


def _is_bar_label(text: Any) -> bool:
    """True if a text stands beside a point of the data, at a distance in points, without an arrow."""
    return getattr(text, "xycoords", None) == "data" and text.arrowprops is None and text.anncoords == "offset points"


def tick_names(axis: Any) -> dict[float, str]:
    """Names on an axis by their places, which are fixed; empty for an axis of numbers."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter

    formatter, locator = axis.get_major_formatter(), axis.get_major_locator()
    if not (isinstance(locator, FixedLocator) and isinstance(formatter, FixedFormatter | FuncFormatter)):
        return {}
    return {float(place): formatter(place, number) for number, place in enumerate(locator.locs)}


def draw_artists(axes: Any, plot: Any, figure: Any) -> LabelledRenderers:
    """Renderers of all artists of the axes with their labels, from the bottom up."""
    labels = {}
    for container in axes.containers:
        for member in container:
            members = member if isinstance(member, tuple | list) else [member]
            labels.update({id(artist): container.get_label() for artist in members})

    def label_of(artist: Any) -> str:
        return str(labels.get(id(artist), artist.get_label()))

    artists = sorted([*axes.patches, *axes.collections, *axes.lines], key=lambda artist: artist.get_zorder())
    draw = {"Line2D": _line, "StepPatch": _steps, "LineCollection": _segments, "QuadMesh": _mesh} | {
        "PathCollection": _points
    }
    for bar_style, group in groupby(artists, key=lambda artist: _bar_style(artist, label_of(artist), axes)):
        if bar_style is not None:
            yield bar_style.label, _bars(list(group), bar_style, plot)
            continue
        for artist in group:
            for renderer in draw.get(type(artist).__name__, _hexagons)(artist, axes, plot, figure):
                yield label_of(artist), renderer
    for text in axes.texts:
        _label(text, plot)


def _label(text: Any, plot: Any) -> None:
    """Text beside a point."""
    from bokeh.models import Label, PlainText

    if not text.get_text():
        return
    (x, y), (dx, dy) = map(float, text.xy), map(float, text.xyann)
    plot.add_layout(
        Label(
            x=x,
            y=y,
            x_offset=_PX_PER_POINT * dx,
            y_offset=_PX_PER_POINT * dy,
            text=PlainText(text=text.get_text()),
            text_font_size="11px",
            text_align=_ALIGNMENTS[text.get_ha()],
            text_baseline=_BASELINES[text.get_va()],
        )
    )


def _line(line: Any, axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    colour, alpha = _hex(line.get_color()), line.get_alpha() or 1.0
    width = _PX_PER_POINT * line.get_linewidth()
    x, y = (np.asarray(row, dtype=float) for row in line.get_data())
    dash = _DASHES.get(line.get_linestyle())
    style = {"line_color": colour, "line_alpha": alpha, "line_width": width, "line_dash": dash or "solid"}
    data_x, data_y = line.get_transform().contains_branch_seperately(axes.transData)
    if not (data_x and data_y):
        yield plot.vspan(x=x[:1], **style) if data_x else plot.hspan(y=y[:1], **style)
        return
    joined = dash is not None and line.get_linewidth() > 0
    x, y = _fewer(x, y, joined)
    if joined and line.get_drawstyle() == "steps-mid":
        yield plot.step(x, y, mode="center", **style)
    elif joined:
        yield plot.line(x, y, **style)
    marker = str(line.get_marker())
    if marker not in ("None", "", " "):
        size = _PX_PER_POINT * line.get_markersize() * (0.6 if marker == "." else 1.0)
        angle = np.pi / 2 if marker == "|" else 0.0
        face, edge = _hex(line.get_markerfacecolor()), _hex(line.get_markeredgecolor())
        colours = {"fill_color": face, "line_color": edge, "fill_alpha": alpha, "line_alpha": alpha}
        yield plot.scatter(x, y, marker=_MARKERS.get(marker, "circle"), size=size, angle=angle, **colours)


def _steps(patch: Any, _axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    values, edges, _ = patch.get_data()
    colour, width = _hex(patch.get_edgecolor()), _PX_PER_POINT * patch.get_linewidth()
    yield plot.line(np.repeat(edges, 2)[1:-1], np.repeat(values, 2), line_color=colour, line_width=width)


@dataclass(frozen=True)
class _BarStyle:
    """Label and look of the bars of one renderer; data_x and data_y are false where the bars span the axes."""

    label: str
    colour: str | None
    alpha: float
    data_x: bool
    data_y: bool


def _bar_style(artist: Any, label: str, axes: Any) -> _BarStyle | None:
    """Style of a bar; None for any other artist."""
    if type(artist).__name__ != "Rectangle":
        return None
    data_x, data_y = artist.get_transform().contains_branch_seperately(axes.transData)
    return _BarStyle(label, _hex(artist.get_facecolor()), artist.get_alpha() or 1.0, data_x, data_y)


def _bars(patches: Sequence[Any], style: _BarStyle, plot: Any) -> Any:
    """Bars of one style as one renderer: each would cost as much as a curve."""
    x_left, y_low, width, height = (
        np.array([float(getattr(patch, f"get_{side}")()) for patch in patches])
        for side in ("x", "y", "width", "height")
    )
    look = {"fill_color": style.colour, "fill_alpha": style.alpha, "line_color": None}
    if style.data_x and style.data_y:
        return plot.quad(left=x_left, right=x_left + width, bottom=y_low, top=y_low + height, **look)
    if style.data_x:
        return plot.vstrip(x0=x_left, x1=x_left + width, **look)
    return plot.hstrip(y0=y_low, y1=y_low + height, **look)


def _segments(lines: Any, _axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    """Error bars."""
    segments = [np.asarray(segment, dtype=np.float32) for segment in lines.get_segments()]
    style = {"line_color": _hex(lines.get_colors()[0]), "line_width": _PX_PER_POINT * lines.get_linewidths()[0]}
    x, y = ([segment[:, column].tolist() for segment in segments] for column in (0, 1))
    yield plot.multi_line(x, y, **style)


def _hexagons(cells: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Hexagons of matplotlib's hexbin: one shape at many centres, coloured by a value, with a colour bar."""
    from bokeh.transform import transform

    hexagon, centres = cells.get_paths()[0].vertices[:6], np.asarray(cells.get_offsets())
    values, mapper = np.asarray(cells.get_array(), dtype=float), _colour_mapper(cells)
    corners = (centres[:, None] + hexagon).reshape(-1, 2)
    rounded = [[float(f"{value:.4g}") for value in row] for row in corners.T]
    x, y = ([row[k : k + 6] for k in range(0, len(row), 6)] for row in rounded)
    source = {"x": x, "y": y, "value": values.tolist()}
    yield plot.patches("x", "y", source=source, fill_color=transform("value", mapper), line_color=None)
    _add_colour_bar(plot, mapper, figure)


def _mesh(cells: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Cells of matplotlib's pcolormesh between straight edges, coloured by a value; those without one are left out."""
    from bokeh.transform import transform

    corners, values = cells.get_coordinates(), np.ma.filled(cells.get_array(), np.nan).astype(float)
    x, y = corners[0, :, 0], corners[:, 0, 1]
    rows, columns = np.nonzero(np.isfinite(values))
    mapper = _colour_mapper(cells)
    source = {
        "left": x[columns].tolist(),
        "right": x[columns + 1].tolist(),
        "bottom": y[rows].tolist(),
        "top": y[rows + 1].tolist(),
        "value": [float(f"{value:.4g}") for value in values[rows, columns]],
    }
    yield plot.quad(
        "left", "right", "top", "bottom", source=source, fill_color=transform("value", mapper), line_color=None
    )
    _add_colour_bar(plot, mapper, figure)


def _points(points: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Points of matplotlib's scatter, of one colour or coloured by a value."""
    from bokeh.transform import transform

    x, y = np.asarray(points.get_offsets(), dtype=float).T
    size, values = _PX_PER_POINT * float(np.sqrt(points.get_sizes()[0])), points.get_array()
    if values is None:
        yield plot.scatter(x, y, size=size, color=_hex(points.get_facecolor()[0]))
        return
    mapper = _colour_mapper(points)
    source = {"x": x.tolist(), "y": y.tolist(), "value": np.asarray(values, dtype=float).tolist()}
    yield plot.scatter("x", "y", source=source, size=size, color=transform("value", mapper))
    _add_colour_bar(plot, mapper, figure)


def _colour_mapper(artist: Any) -> Any:
    from bokeh.models import LinearColorMapper
    from matplotlib.colors import to_hex

    low, high = artist.get_clim()
    return LinearColorMapper([to_hex(artist.cmap(level)) for level in np.linspace(0, 1, 64)], low=low, high=high)


def _add_colour_bar(plot: Any, mapper: Any, figure: Any) -> None:
    """Colour bar with the label of the figure's own, if it has one."""
    from bokeh.models import ColorBar

    bars: Sequence[Any] = [axes for axes in figure.axes if axes.get_label() == COLOUR_BAR]
    for bar in [axes for axes in bars if axes.get_position().y0 >= 0][:1]:
        plot.add_layout(ColorBar(color_mapper=mapper, title=bar.get_ylabel(), width=10, padding=4), "right")


def _fewer(
    x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], joined: bool
) -> tuple[Float[np.ndarray, " fewer"], Float[np.ndarray, " fewer"]]:
    """Points in single precision, at most MOST_POINTS: extremes of every bucket of a line, every n-th of dots."""
    indices = np.arange(0, x.size, -(-x.size // MOST_POINTS) or 1)
    if x.size > MOST_POINTS and joined:
        buckets = np.array_split(np.arange(x.size), MOST_POINTS // 2)
        extremes = [sorted((int(np.argmin(y[bucket])), int(np.argmax(y[bucket])))) for bucket in buckets]
        indices = np.array([bucket[k] for bucket, pair in zip(buckets, extremes, strict=True) for k in pair])
    return x[indices].astype(np.float32), y[indices].astype(np.float32)


def _hex(colour: Any) -> str | None:
    from matplotlib.colors import to_hex

    return None if isinstance(colour, str) and colour == "none" else str(to_hex(colour))
