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

MAX_POINTS = 2500
"""Most points of a curve; of more, the minimum and maximum of every bucket are kept, as a screen shows them."""
COLOUR_BAR = "<colorbar>"
"""Label that matplotlib gives to the axes of a colour bar."""
_PX_PER_POINT = 1.33
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
_MARKERS = {"s": "square", "^": "triangle", "v": "inverted_triangle", "|": "dash", "_": "dash"}
_ALIGNMENTS = {"center": "center", "left": "left", "right": "right"}
_BASELINES = {"center": "middle", "center_baseline": "middle", "bottom": "bottom", "top": "top"}
_BASELINES["baseline"] = "alphabetic"
LabelledRenderers = Iterator[tuple[str, Any]]
"""Labels and their Bokeh renderers; a label that begins with _ is not shown."""


def is_drawable(axes: Any) -> bool:
    """True if `draw_artists` and `fixed_tick_names` can show everything in the axes."""
    from matplotlib.collections import LineCollection, PathCollection, PolyCollection, QuadMesh
    from matplotlib.patches import Rectangle, StepPatch
    from matplotlib.ticker import FuncFormatter

    computes_ticks = any(
        isinstance(axis.get_major_formatter(), FuncFormatter)
        and axis.get_scale() != "log"
        and not fixed_tick_names(axis)
        for axis in (axes.xaxis, axes.yaxis)
    )
    known_types = (LineCollection, PathCollection, PolyCollection, QuadMesh)
    are_collections_known = all(type(artist) in known_types for artist in axes.collections)
    are_patches_known = all(isinstance(patch, Rectangle | StepPatch) for patch in axes.patches)
    return are_collections_known and are_patches_known and not computes_ticks and all(map(_is_bar_label, axes.texts))


def _is_bar_label(text: Any) -> bool:
    """True if a text stands beside a point of the data, at a distance in points, without an arrow."""
    return getattr(text, "xycoords", None) == "data" and text.arrowprops is None and text.anncoords == "offset points"


def fixed_tick_names(axis: Any) -> dict[float, str]:
    """Names on an axis by their places, which are fixed; empty for an axis of numbers."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter

    formatter, locator = axis.get_major_formatter(), axis.get_major_locator()
    if not (isinstance(locator, FixedLocator) and isinstance(formatter, FixedFormatter | FuncFormatter)):
        return {}
    return {float(position): formatter(position, index) for index, position in enumerate(locator.locs)}


def fixed_tick_positions(axis: Any) -> list[float]:
    """Places of the ticks of an axis that were set; empty where the axis chooses them."""
    from matplotlib.ticker import FixedLocator

    locator = axis.get_major_locator()
    return [float(position) for position in locator.locs] if isinstance(locator, FixedLocator) else []


def draw_artists(axes: Any, plot: Any, figure: Any) -> LabelledRenderers:
    """Renderers of all artists of the axes with their labels, from the bottom up."""
    labels: dict[int, str] = {}
    for container in axes.containers:
        for bar_or_bars in container:
            bars = bar_or_bars if isinstance(bar_or_bars, tuple | list) else [bar_or_bars]
            labels |= {id(bar): container.get_label() for bar in bars}

    def label_of(artist: Any) -> str:
        return str(labels.get(id(artist), artist.get_label()))

    artists = sorted([*axes.patches, *axes.collections, *axes.lines], key=lambda artist: artist.get_zorder())
    draw_functions = {
        "Line2D": _draw_line,
        "StepPatch": _draw_steps,
        "LineCollection": _draw_error_bars,
        "QuadMesh": _draw_mesh,
        "PathCollection": _draw_points,
    }
    for style, alike in groupby(artists, key=lambda artist: _bar_style(artist, label_of(artist), axes)):
        if style is not None:
            yield style.label, _draw_bars(list(alike), style, plot)
            continue
        for artist in alike:
            draw = draw_functions.get(type(artist).__name__, _draw_hexagons)
            for renderer in draw(artist, axes, plot, figure):
                yield label_of(artist), renderer
    for text in axes.texts:
        _draw_label(text, plot)


def _draw_label(text: Any, plot: Any) -> None:
    """Text beside a point."""
    from bokeh.models import Label, PlainText

    if not text.get_text():
        return
    (x, y), (x_offset_pt, y_offset_pt) = map(float, text.xy), map(float, text.xyann)
    label = Label(
        x=x,
        y=y,
        x_offset=_PX_PER_POINT * x_offset_pt,
        y_offset=_PX_PER_POINT * y_offset_pt,
        text=PlainText(text=text.get_text()),
        text_font_size="11px",
        text_align=_ALIGNMENTS[text.get_ha()],
        text_baseline=_BASELINES[text.get_va()],
    )
    plot.add_layout(label)


def _draw_line(line: Any, axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    colour, alpha = _hex_colour(line.get_color()), line.get_alpha() or 1.0
    width_px = _PX_PER_POINT * line.get_linewidth()
    x, y = (np.asarray(values, dtype=float) for values in line.get_data())
    dash = _DASHES.get(line.get_linestyle())
    style = {"line_color": colour, "line_alpha": alpha, "line_width": width_px, "line_dash": dash or "solid"}
    is_data_x, is_data_y = line.get_transform().contains_branch_seperately(axes.transData)
    if not (is_data_x and is_data_y):
        yield plot.vspan(x=x[:1], **style) if is_data_x else plot.hspan(y=y[:1], **style)
        return
    is_joined = dash is not None and line.get_linewidth() > 0
    x, y = _decimated_points(x, y, is_joined)
    if is_joined and line.get_drawstyle() == "steps-mid":
        yield plot.step(x, y, mode="center", **style)
    elif is_joined:
        yield plot.line(x, y, **style)
    marker = str(line.get_marker())
    if marker not in ("None", "", " "):
        size_px = _PX_PER_POINT * line.get_markersize() * (0.6 if marker == "." else 1.0)
        shape = {
            "marker": _MARKERS.get(marker, "circle"),
            "size": size_px,
            "angle": np.pi / 2 if marker == "|" else 0.0,
        }
        face, edge = _hex_colour(line.get_markerfacecolor()), _hex_colour(line.get_markeredgecolor())
        yield plot.scatter(x, y, fill_color=face, line_color=edge, fill_alpha=alpha, line_alpha=alpha, **shape)


def _draw_steps(patch: Any, _axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    values, edges, _ = patch.get_data()
    colour, width_px = _hex_colour(patch.get_edgecolor()), _PX_PER_POINT * patch.get_linewidth()
    dash = _DASHES.get(patch.get_linestyle(), "solid")
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(values, 2)
    yield plot.line(x, y, line_color=colour, line_width=width_px, line_dash=dash)


@dataclass(frozen=True)
class _BarStyle:
    """Label and look of the bars of one renderer; is_data_x and is_data_y are false where the bars span the axes."""

    label: str
    colour: str | None
    alpha: float
    is_data_x: bool
    is_data_y: bool


def _bar_style(artist: Any, label: str, axes: Any) -> _BarStyle | None:
    """Style of a bar; None for any other artist."""
    if type(artist).__name__ != "Rectangle":
        return None
    is_data_x, is_data_y = artist.get_transform().contains_branch_seperately(axes.transData)
    return _BarStyle(label, _hex_colour(artist.get_facecolor()), artist.get_alpha() or 1.0, is_data_x, is_data_y)


def _draw_bars(patches: Sequence[Any], style: _BarStyle, plot: Any) -> Any:
    """Bars of one style as one renderer: each would cost as much as a curve."""
    rows = [(patch.get_x(), patch.get_y(), patch.get_width(), patch.get_height()) for patch in patches]
    x_left, y_low, width, height = np.array(rows, dtype=float).T
    fill_style = {"fill_color": style.colour, "fill_alpha": style.alpha, "line_color": None}
    if style.is_data_x and style.is_data_y:
        return plot.quad(left=x_left, right=x_left + width, bottom=y_low, top=y_low + height, **fill_style)
    if style.is_data_x:
        return plot.vstrip(x0=x_left, x1=x_left + width, **fill_style)
    return plot.hstrip(y0=y_low, y1=y_low + height, **fill_style)


def _draw_error_bars(lines: Any, _axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    """Error bars."""
    segments = [np.asarray(segment, dtype=np.float32) for segment in lines.get_segments()]
    colour, width_px = _hex_colour(lines.get_colors()[0]), _PX_PER_POINT * lines.get_linewidths()[0]
    x, y = ([segment[:, column].tolist() for segment in segments] for column in (0, 1))
    yield plot.multi_line(x, y, line_color=colour, line_width=width_px)


def _draw_hexagons(cells: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Hexagons of matplotlib's hexbin: one shape at many centres, coloured by a value, with a colour bar."""
    from bokeh.transform import transform

    hexagon, centres = cells.get_paths()[0].vertices[:6], np.asarray(cells.get_offsets())
    values, colour_mapper = np.asarray(cells.get_array(), dtype=float), _colour_mapper(cells)
    corners = (centres[:, None] + hexagon).reshape(-1, 2)
    rounded = ([float(f"{value:.4g}") for value in row] for row in corners.T)
    x, y = ([row[first : first + 6] for first in range(0, len(row), 6)] for row in rounded)
    columns = {"x": x, "y": y, "value": values.tolist()}
    yield plot.patches("x", "y", source=columns, fill_color=transform("value", colour_mapper), line_color=None)
    _add_colour_bar(plot, colour_mapper, figure)


def _draw_mesh(cells: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Cells of matplotlib's pcolormesh between straight edges, coloured by a value; those without one are left out."""
    from bokeh.transform import transform

    corners, values = cells.get_coordinates(), np.ma.filled(cells.get_array(), np.nan).astype(float)
    edge_x, edge_y = corners[0, :, 0], corners[:, 0, 1]
    rows, columns = np.nonzero(np.isfinite(values))
    colour_mapper = _colour_mapper(cells)
    source = {
        "left": edge_x[columns].tolist(),
        "right": edge_x[columns + 1].tolist(),
        "bottom": edge_y[rows].tolist(),
        "top": edge_y[rows + 1].tolist(),
        "value": [float(f"{value:.4g}") for value in values[rows, columns]],
    }
    style = {"fill_color": transform("value", colour_mapper), "line_color": None}
    yield plot.quad("left", "right", "top", "bottom", source=source, **style)
    _add_colour_bar(plot, colour_mapper, figure)


def _draw_points(points: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Points of matplotlib's scatter, of one colour or coloured by a value."""
    from bokeh.transform import transform

    x, y = np.asarray(points.get_offsets(), dtype=float).T
    size_px, values = _PX_PER_POINT * float(np.sqrt(points.get_sizes()[0])), points.get_array()
    if values is None:
        yield plot.scatter(x, y, size=size_px, color=_hex_colour(points.get_facecolor()[0]))
        return
    colour_mapper = _colour_mapper(points)
    columns = {"x": x.tolist(), "y": y.tolist(), "value": np.asarray(values, dtype=float).tolist()}
    yield plot.scatter("x", "y", source=columns, size=size_px, color=transform("value", colour_mapper))
    _add_colour_bar(plot, colour_mapper, figure)


def _colour_mapper(artist: Any) -> Any:
    from bokeh.models import LinearColorMapper
    from matplotlib.colors import to_hex

    low, high = artist.get_clim()
    return LinearColorMapper([to_hex(artist.cmap(share)) for share in np.linspace(0, 1, 64)], low=low, high=high)


def _add_colour_bar(plot: Any, colour_mapper: Any, figure: Any) -> None:
    """Colour bar with the label of the figure's own, if it has one."""
    from bokeh.models import ColorBar

    bars = (axes for axes in figure.axes if axes.get_label() == COLOUR_BAR and axes.get_position().y0 >= 0)
    if (bar := next(bars, None)) is not None:
        plot.add_layout(ColorBar(color_mapper=colour_mapper, title=bar.get_ylabel(), width=10, padding=4), "right")


def _decimated_points(
    x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], is_joined: bool
) -> tuple[Float[np.ndarray, " fewer"], Float[np.ndarray, " fewer"]]:
    """Points in single precision, at most MAX_POINTS: extremes of every bucket of a line, every n-th of dots."""
    indices = np.arange(0, x.size, -(-x.size // MAX_POINTS) or 1)
    if x.size > MAX_POINTS and is_joined:
        buckets = np.array_split(np.arange(x.size), MAX_POINTS // 2)
        extremes = [sorted((bucket[np.argmin(y[bucket])], bucket[np.argmax(y[bucket])])) for bucket in buckets]
        indices = np.ravel(extremes)
    return x[indices].astype(np.float32), y[indices].astype(np.float32)


def _hex_colour(colour: Any) -> str | None:
    from matplotlib.colors import to_hex

    return None if isinstance(colour, str) and colour == "none" else str(to_hex(colour))
