"""Interactive plot of a matplotlib figure, drawn by Bokeh: zoom, read values, hide curves."""

import json
from collections.abc import Iterator
from html import escape
from itertools import count, groupby
from textwrap import fill
from typing import Any

import numpy as np
from jaxtyping import Float

MOST_POINTS = 2500
"""Most points of a curve; of more, the minimum and maximum of every bucket are kept, as a screen shows them."""
_PX_PER_IN, _PX_PER_POINT = 100, 1.33
_LEAST_PX, _NARROWEST_PX = 180, 290
"""Least height of a panel, and least width, below which panels stand one below the other."""
_LONG_LABEL = 30
"""Characters from which labels of a legend stand one below the other, as a phone has no room for two."""
_TITLE_LINE = 36
"""Characters in a line of a title, as many as a phone shows."""
_LOG_TICKS = """const {start, end} = cb_data.range, decades = Math.log10(end / start), ticks = []
if (decades < 1) {
  const size = 10 ** Math.floor(Math.log10(end - start)), count = (end - start) / size
  const step = size * (count < 2 ? 0.2 : count < 5 ? 0.5 : 1)
  for (let n = Math.ceil(start / step); n * step <= end; n++) ticks.push(n * step)
} else
  for (let power = Math.floor(Math.log10(start)); power <= Math.log10(end); power++)
    for (const digit of decades < 2.5 ? [1, 2, 5] : power % Math.ceil(decades / 6) ? [] : [1])
      ticks.push(digit * 10 ** power)
return ticks"""
"""Ticks of a logarithmic axis: evenly spaced within a decade, at 1, 2, 5 over a few, else at powers of ten."""
_LOG_NUMBER = """const n = +tick.toPrecision(6)
return n < 1e-3 || n >= 1e7 ? n.toExponential().replace('+', '') : String(n)"""
_PLAIN_POWER = 7
"""Power of ten below which the numbers of an axis are written out."""
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
_MARKERS = {"^": "triangle", "v": "inverted_triangle", "|": "dash", "_": "dash"}
_BAR = "<colorbar>"
_plot_numbers = count(1)
LabelledRenderers = Iterator[tuple[str, Any]]
"""Labels and their Bokeh renderers; a label that begins with _ is not shown."""


def interactive(figure: Any, height_px: int | None = None) -> str:
    """HTML of a figure, which needs `library` on its page; empty if it has more than curves, bars and hexagons.

    With a height, its panels have that height together, one below the other, and only the first has a legend.
    """
    panels = [axes for axes in figure.axes if axes.get_label() != _BAR]
    title = figure.get_suptitle()
    if {text.get_text() for text in figure.texts} - {title} or not panels or not all(map(_is_plain, panels)):
        return ""
    from bokeh.embed import json_item
    from bokeh.models import Column, Row

    ranges: dict[Any, Any] = {}
    rows = []
    for _, row in groupby(sorted(panels, key=_row_of), key=_row_of):
        plots = [_plot(axes, figure, ranges) for axes in row]
        rows.append(Row(children=plots, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"}))
    if height_px is not None:
        _limit_height([plot for row in rows for plot in row.children], height_px)
    name = f"plot_{next(_plot_numbers)}"
    item = json.dumps(json_item(Column(children=rows, sizing_mode="stretch_width"), name)).replace("<", "\\u003c")
    heading = f"<h3>{escape(title)}</h3>" if title else ""
    return f'{heading}<div id="{name}" class="plot"></div><script>Bokeh.embed.embed_item({item})</script>'


def _limit_height(plots: list[Any], height_px: int) -> None:
    for plot in plots:
        plot.height = max(_LEAST_PX, height_px // len(plots))
    for plot in plots[1:]:
        for legend in plot.legend:
            legend.visible = False


def library() -> str:
    """Script that draws the plots, for a page that needs no other file."""
    from bokeh.resources import Resources

    script, *_settings = Resources(mode="inline", components=["bokeh"]).js_raw
    return f"<script>{script}</script>"


def _row_of(axes: Any) -> int:
    return int(axes.get_subplotspec().rowspan.start)


def _is_plain(axes: Any) -> bool:
    """True if `_draw` can draw everything in the axes."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patches import Rectangle, StepPatch
    from matplotlib.ticker import FixedFormatter, FuncFormatter

    names_ticks = any(
        isinstance(axis.get_major_formatter(), FixedFormatter | FuncFormatter) and axis.get_scale() != "log"
        for axis in (axes.xaxis, axes.yaxis)
    )
    collections_known = all(type(artist) in (LineCollection, PolyCollection) for artist in axes.collections)
    patches_known = all(isinstance(patch, Rectangle | StepPatch) for patch in axes.patches)
    return collections_known and not names_ticks and not axes.texts and patches_known


def _plot(axes: Any, figure: Any, ranges: dict[Any, Any]) -> Any:
    from bokeh.models import (
        CustomJSTicker,
        CustomJSTickFormatter,
        HoverTool,
        Legend,
        LegendItem,
        PlainText,
        Range1d,
        Title,
    )
    from bokeh.plotting import figure as new_plot

    def shared(direction: str, siblings: Any, limits: tuple[float, float]) -> Any:
        key = direction, frozenset(map(id, siblings.get_siblings(axes)))
        return ranges.setdefault(key, Range1d(*map(float, limits)))

    plot = new_plot(
        x_range=shared("x", axes.get_shared_x_axes(), axes.get_xlim()),
        y_range=shared("y", axes.get_shared_y_axes(), axes.get_ylim()),
        x_axis_type=axes.get_xscale(),
        y_axis_type=axes.get_yscale(),
        height=max(_LEAST_PX, round(_PX_PER_IN * figure.get_figheight() * axes.get_position().height)) + 80,
        min_width=_NARROWEST_PX,
        min_border_left=84,
        sizing_mode="stretch_width",
        tools="box_zoom,pan,wheel_zoom,reset,save",
        active_drag="box_zoom",
    )
    plot.toolbar.logo = None
    for bokeh_axis, axis in ((plot.xaxis, axes.xaxis), (plot.yaxis, axes.yaxis)):
        bokeh_axis.axis_label = PlainText(text=_label(axes, axis))
        bokeh_axis.axis_label_text_font_style = "normal"
        if axis.get_scale() == "log":
            bokeh_axis.formatter = CustomJSTickFormatter(code=_LOG_NUMBER)
            bokeh_axis.ticker = CustomJSTicker(major_code=_LOG_TICKS)
        else:
            bokeh_axis.formatter.power_limit_high = _PLAIN_POWER
    if axes.get_title():
        plot.title = Title(text=PlainText(text=fill(axes.get_title(), _TITLE_LINE)))
    by_label: dict[str, list[Any]] = {}
    for label, renderer in _draw(axes, plot, figure):
        by_label.setdefault(label, []).append(renderer)
    labelled = {label: renderers for label, renderers in by_label.items() if label[:1] not in ("", "_")}
    if labelled:
        columns = 1 if max(map(len, labelled)) > _LONG_LABEL else 2
        items = [LegendItem(label={"value": label}, renderers=renderers) for label, renderers in labelled.items()]
        plot.add_layout(
            Legend(items=items, click_policy="hide", ncols=columns, label_text_font_size="11px"),
            "above",
        )
        plot.legend.update(location="top_left", border_line_color=None, padding=0, spacing=6, margin=0, glyph_height=14)
    plot.add_tools(HoverTool(tooltips=[("x", "$x{0.[0000]}"), ("y", "$y{0.[0000]}")]))
    return plot


def _label(axes: Any, axis: Any) -> str:
    """Label of an axis, or of one that shares its scale, which stands at the figure's edge."""
    siblings = axes.get_shared_x_axes() if axis is axes.xaxis else axes.get_shared_y_axes()
    sibling_axes = (panel.xaxis if axis is axes.xaxis else panel.yaxis for panel in siblings.get_siblings(axes))
    labels = (candidate.get_label().get_text() for candidate in (axis, *sibling_axes))
    return next(filter(None, labels), "")


def _draw(axes: Any, plot: Any, figure: Any) -> LabelledRenderers:
    """Renderers of all artists of the axes with their labels, from the bottom up."""
    labels = {}
    for container in axes.containers:
        for member in container:
            members = member if isinstance(member, tuple | list) else [member]
            labels.update({id(artist): container.get_label() for artist in members})
    artists = sorted([*axes.patches, *axes.collections, *axes.lines], key=lambda artist: artist.get_zorder())
    for artist in artists:
        label = labels.get(id(artist), artist.get_label())
        draw = {"Line2D": _line, "StepPatch": _steps, "Rectangle": _bar, "LineCollection": _segments}
        for renderer in draw.get(type(artist).__name__, _hexagons)(artist, axes, plot, figure):
            yield label, renderer


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


def _bar(patch: Any, axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    x_left, y_low, width, height = patch.get_x(), patch.get_y(), patch.get_width(), patch.get_height()
    style = {"fill_color": _hex(patch.get_facecolor()), "fill_alpha": patch.get_alpha() or 1.0, "line_color": None}
    data_x, data_y = patch.get_transform().contains_branch_seperately(axes.transData)
    if data_x and data_y:
        yield plot.quad(left=x_left, right=x_left + width, bottom=y_low, top=y_low + height, **style)
    elif data_x:
        yield plot.vstrip(x0=x_left, x1=x_left + width, **style)
    else:
        yield plot.hstrip(y0=y_low, y1=y_low + height, **style)


def _segments(lines: Any, _axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    """Error bars."""
    segments = [np.asarray(segment, dtype=np.float32) for segment in lines.get_segments()]
    style = {"line_color": _hex(lines.get_colors()[0]), "line_width": _PX_PER_POINT * lines.get_linewidths()[0]}
    x, y = ([segment[:, column].tolist() for segment in segments] for column in (0, 1))
    yield plot.multi_line(x, y, **style)


def _hexagons(cells: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Hexagons of matplotlib's hexbin: one shape at many centres, coloured by a value, with a colour bar."""
    from bokeh.models import ColorBar, LinearColorMapper
    from bokeh.transform import transform
    from matplotlib.colors import to_hex

    hexagon, centres = cells.get_paths()[0].vertices[:6], np.asarray(cells.get_offsets())
    values, (low, high) = np.asarray(cells.get_array(), dtype=float), cells.get_clim()
    mapper = LinearColorMapper([to_hex(cells.cmap(level)) for level in np.linspace(0, 1, 64)], low=low, high=high)
    corners = (centres[:, None] + hexagon).reshape(-1, 2)
    rounded = [[float(f"{value:.4g}") for value in row] for row in corners.T]
    x, y = ([row[k : k + 6] for k in range(0, len(row), 6)] for row in rounded)
    source = {"x": x, "y": y, "value": values.tolist()}
    yield plot.patches("x", "y", source=source, fill_color=transform("value", mapper), line_color=None)
    (bar,) = [axes for axes in figure.axes if axes.get_label() == _BAR and axes.get_position().y0 >= 0][:1]
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
