"""A figure of matplotlib as a plot to work with in a browser: zoom, read off, switch curves. Bokeh draws it."""

import json
from collections.abc import Iterator
from html import escape
from itertools import count, groupby
from textwrap import fill
from typing import Any

import numpy as np
from jaxtyping import Float

MOST_POINTS = 2500
"""Of a curve; of more, the least and the largest of every bucket are kept, as a screen shows them."""
_PX_PER_IN, _PX_PER_POINT = 100, 1.33
_LEAST_PX, _NARROWEST_PX = 180, 290
"""Height of a panel; panels that would be narrower than the other stand one below the other."""
_LONG = 30
"""Of a label, in letters: longer ones stand one below the other, as a phone has no room for two."""
_TITLE = 36
"""Letters in a line of a title, as a phone shows no more."""
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
"""Where a logarithmic axis has numbers: evenly within a decade, at 1, 2, 5 in a few, else at powers of ten."""
_LOG_NUMBER = """const n = +tick.toPrecision(6)
return n < 1e-3 || n >= 1e7 ? n.toExponential().replace('+', '') : String(n)"""
_PLAIN_POWER = 7
"""Below ten to it, numbers at an axis are written out."""
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
_MARKERS = {"^": "triangle", "v": "inverted_triangle", "|": "dash", "_": "dash"}
_BAR = "<colorbar>"
_numbers = count(1)
Drawn = Iterator[tuple[str, Any]]
"""Labels and what Bokeh draws below them; a label that begins with _ is not shown."""


def interactive(figure: Any) -> str:
    """HTML that needs `library` on its page; empty if the figure shows what is no curve, bar or hexagon."""
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
    name = f"plot_{next(_numbers)}"
    item = json.dumps(json_item(Column(children=rows, sizing_mode="stretch_width"), name)).replace("<", "\\u003c")
    heading = f"<h3>{escape(title)}</h3>" if title else ""
    return f'{heading}<div id="{name}" class="plot"></div><script>Bokeh.embed.embed_item({item})</script>'


def library() -> str:
    """The script that draws the plots, for a page that needs no other file."""
    from bokeh.resources import Resources

    script, *_settings = Resources(mode="inline", components=["bokeh"]).js_raw
    return f"<script>{script}</script>"


def _row_of(axes: Any) -> int:
    return int(axes.get_subplotspec().rowspan.start)


def _is_plain(axes: Any) -> bool:
    """True if the figure shows nothing that `_draw` cannot draw."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patches import Rectangle, StepPatch
    from matplotlib.ticker import FixedFormatter, FuncFormatter

    named = any(
        isinstance(axis.get_major_formatter(), FixedFormatter | FuncFormatter) and axis.get_scale() != "log"
        for axis in (axes.xaxis, axes.yaxis)
    )
    known = all(type(one) in (LineCollection, PolyCollection) for one in axes.collections)
    return known and not named and not axes.texts and all(isinstance(p, Rectangle | StepPatch) for p in axes.patches)


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

    def shared(way: str, siblings: Any, limits: tuple[float, float]) -> Any:
        key = way, frozenset(map(id, siblings.get_siblings(axes)))
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
    for drawn, axis in ((plot.xaxis, axes.xaxis), (plot.yaxis, axes.yaxis)):
        drawn.axis_label = PlainText(text=_label(axes, axis))
        drawn.axis_label_text_font_style = "normal"
        if axis.get_scale() == "log":
            drawn.formatter = CustomJSTickFormatter(code=_LOG_NUMBER)
            drawn.ticker = CustomJSTicker(major_code=_LOG_TICKS)
        else:
            drawn.formatter.power_limit_high = _PLAIN_POWER
    if axes.get_title():
        plot.title = Title(text=PlainText(text=fill(axes.get_title(), _TITLE)))
    by_label: dict[str, list[Any]] = {}
    for label, renderer in _draw(axes, plot, figure):
        by_label.setdefault(label, []).append(renderer)
    shown = {label: each for label, each in by_label.items() if label[:1] not in ("", "_")}
    if shown:
        longest = max(map(len, shown))
        items = [LegendItem(label={"value": label}, renderers=each) for label, each in shown.items()]
        plot.add_layout(
            Legend(items=items, click_policy="hide", ncols=1 if longest > _LONG else 2, label_text_font_size="11px"),
            "above",
        )
        plot.legend.update(location="top_left", border_line_color=None, padding=0, spacing=6, margin=0, glyph_height=14)
    plot.add_tools(HoverTool(tooltips=[("x", "$x{0.[0000]}"), ("y", "$y{0.[0000]}")]))
    return plot


def _label(axes: Any, axis: Any) -> str:
    """Its own, or that of the axis that shares its scale and stands at the figure's edge."""
    siblings = axes.get_shared_x_axes() if axis is axes.xaxis else axes.get_shared_y_axes()
    others = (one.xaxis if axis is axes.xaxis else one.yaxis for one in siblings.get_siblings(axes))
    return next((each.get_label().get_text() for each in (axis, *others) if each.get_label().get_text()), "")


def _draw(axes: Any, plot: Any, figure: Any) -> Drawn:
    """Everything of the axes, from the bottom up."""
    labels = {}
    for container in axes.containers:
        parts = [part for some in container for part in (some if isinstance(some, tuple | list) else [some])]
        labels.update({id(part): container.get_label() for part in parts})
    artists = sorted([*axes.patches, *axes.collections, *axes.lines], key=lambda artist: artist.get_zorder())
    for artist in artists:
        label = labels.get(id(artist), artist.get_label())
        draw = {"Line2D": _line, "StepPatch": _steps, "Rectangle": _bar, "LineCollection": _segments}
        for renderer in draw.get(type(artist).__name__, _hexagons)(artist, axes, plot, figure):
            yield label, renderer


def _line(line: Any, axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    colour, alpha = _hex(line.get_color()), line.get_alpha() or 1.0
    width = _PX_PER_POINT * line.get_linewidth()
    x, y = (np.asarray(each, dtype=float) for each in line.get_data())
    dash = _DASHES.get(line.get_linestyle())
    style = {"line_color": colour, "line_alpha": alpha, "line_width": width, "line_dash": dash or "solid"}
    along, across = line.get_transform().contains_branch_seperately(axes.transData)
    if not (along and across):
        yield plot.vspan(x=x[:1], **style) if along else plot.hspan(y=y[:1], **style)
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
        look = {"fill_color": face, "line_color": edge, "fill_alpha": alpha, "line_alpha": alpha, "angle": angle}
        yield plot.scatter(x, y, marker=_MARKERS.get(marker, "circle"), size=size, **look)


def _steps(patch: Any, _axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    values, edges, _ = patch.get_data()
    colour, width = _hex(patch.get_edgecolor()), _PX_PER_POINT * patch.get_linewidth()
    yield plot.line(np.repeat(edges, 2)[1:-1], np.repeat(values, 2), line_color=colour, line_width=width)


def _bar(patch: Any, axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    left, low, width, height = patch.get_x(), patch.get_y(), patch.get_width(), patch.get_height()
    look = {"fill_color": _hex(patch.get_facecolor()), "fill_alpha": patch.get_alpha() or 1.0, "line_color": None}
    along, across = patch.get_transform().contains_branch_seperately(axes.transData)
    if along and across:
        yield plot.quad(left=left, right=left + width, bottom=low, top=low + height, **look)
    elif along:
        yield plot.vstrip(x0=left, x1=left + width, **look)
    else:
        yield plot.hstrip(y0=low, y1=low + height, **look)


def _segments(lines: Any, _axes: Any, plot: Any, _figure: Any) -> Iterator[Any]:
    """Bars of errors."""
    ends = [np.asarray(segment, dtype=np.float32) for segment in lines.get_segments()]
    look = {"line_color": _hex(lines.get_colors()[0]), "line_width": _PX_PER_POINT * lines.get_linewidths()[0]}
    yield plot.multi_line([e[:, 0].tolist() for e in ends], [e[:, 1].tolist() for e in ends], **look)


def _hexagons(cells: Any, _axes: Any, plot: Any, figure: Any) -> Iterator[Any]:
    """Hexagons of matplotlib's hexbin: one form at many places, coloured by a value, with a bar that says which."""
    from bokeh.models import ColorBar, LinearColorMapper
    from bokeh.transform import transform
    from matplotlib.colors import to_hex

    form, places = cells.get_paths()[0].vertices[:6], np.asarray(cells.get_offsets())
    values, (low, high) = np.asarray(cells.get_array(), dtype=float), cells.get_clim()
    mapper = LinearColorMapper([to_hex(cells.cmap(level)) for level in np.linspace(0, 1, 64)], low=low, high=high)
    corners = (places[:, None] + form).reshape(-1, 2)
    short = [[float(f"{value:.4g}") for value in row] for row in corners.T]
    x, y = ([row[k : k + 6] for k in range(0, len(row), 6)] for row in short)
    source = {"x": x, "y": y, "value": values.tolist()}
    yield plot.patches("x", "y", source=source, fill_color=transform("value", mapper), line_color=None)
    (bar,) = [one for one in figure.axes if one.get_label() == _BAR and one.get_position().y0 >= 0][:1]
    plot.add_layout(ColorBar(color_mapper=mapper, title=bar.get_ylabel(), width=10, padding=4), "right")


def _fewer(
    x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], joined: bool
) -> tuple[Float[np.ndarray, " fewer"], Float[np.ndarray, " fewer"]]:
    """Points, at most MOST_POINTS, in single precision: of a line the extremes of every bucket, of dots every n-th."""
    kept = np.arange(0, x.size, -(-x.size // MOST_POINTS) or 1)
    if x.size > MOST_POINTS and joined:
        buckets = np.array_split(np.arange(x.size), MOST_POINTS // 2)
        kept = np.array([b[k] for b in buckets for k in sorted((int(np.argmin(y[b])), int(np.argmax(y[b]))))])
    return x[kept].astype(np.float32), y[kept].astype(np.float32)


def _hex(colour: Any) -> str | None:
    from matplotlib.colors import to_hex

    return None if isinstance(colour, str) and colour == "none" else str(to_hex(colour))
