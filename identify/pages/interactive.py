"""Interactive plot of a matplotlib figure, drawn by Bokeh: zoom, read values, hide curves."""

import json
from html import escape
from itertools import count, groupby
from textwrap import fill
from typing import Any

from identify.pages.artists import COLOUR_BAR, draw_artists, fixed_tick_names, fixed_tick_positions, is_drawable

_PX_PER_IN, _PX_PER_POINT = 100, 1.33
_LEAST_HEIGHT_PX, _LEAST_WIDTH_PX = 220, 290
"""Least height of a panel, and least width, below which panels stand one below the other."""
_LONG_LABEL_LETTERS = 30
"""Characters from which labels of a legend stand one below the other, as a phone has no room for two."""
_TICK_LINE_LETTERS, _SLANT_RAD = 28, 0.7
"""Characters in a line of a name on an axis, and the angle of names below it, rad."""
_TITLE_LINE_LETTERS = 36
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
_plot_numbers = count(1)


def interactive_html(figure: Any, height_px: int | None = None) -> str:
    """HTML of a figure, which needs `library` on its page; empty if it has what `identify.pages.artists` cannot draw or
    the same scale along both axes, which a plot as wide as its column does not keep.

    With a height, its panels have that height together, one below the other, and only the first has a legend.
    """
    panels = [axes for axes in figure.axes if axes.get_label() != COLOUR_BAR]
    title = figure.get_suptitle()
    is_to_scale = any(axes.get_aspect() == 1.0 for axes in panels)
    has_texts = bool({text.get_text() for text in figure.texts} - {title})
    if is_to_scale or has_texts or not panels or not all(map(is_drawable, panels)):
        return ""
    from bokeh.embed import json_item
    from bokeh.models import Column, Row

    range_by_axes: dict[Any, Any] = {}
    rows = []
    for _, row_panels in groupby(sorted(panels, key=_subplot_row), key=_subplot_row):
        plots = [_plot(axes, figure, range_by_axes) for axes in row_panels]
        rows.append(Row(children=plots, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"}))
    if height_px is not None:
        _limit_height([plot for row in rows for plot in row.children], height_px)
    name = f"plot_{next(_plot_numbers)}"
    item = json.dumps(json_item(Column(children=rows, sizing_mode="stretch_width"), name)).replace("<", "\\u003c")
    heading = f"<h3>{escape(title)}</h3>" if title else ""
    return f'{heading}<div id="{name}" class="plot"></div><script>Bokeh.embed.embed_item({item})</script>'


def _limit_height(plots: list[Any], height_px: int) -> None:
    for plot in plots:
        plot.height = max(_LEAST_HEIGHT_PX, height_px // len(plots))
    for plot in plots[1:]:
        for legend in plot.legend:
            legend.visible = False


def bokeh_script() -> str:
    """Script that draws the plots, for a page that needs no other file."""
    from bokeh.resources import Resources

    script, *_settings = Resources(mode="inline", components=["bokeh"]).js_raw
    return f"<script>{script}</script>"


def _subplot_row(axes: Any) -> int:
    return int(axes.get_subplotspec().rowspan.start)


def _plot(axes: Any, figure: Any, range_by_axes: dict[Any, Any]) -> Any:
    from bokeh.models import HoverTool, PlainText, Range1d, Title
    from bokeh.plotting import figure as new_plot

    def shared_range(direction: str, siblings: Any, limits: tuple[float, float]) -> Any:
        key = direction, frozenset(map(id, siblings.get_siblings(axes)))
        return range_by_axes.setdefault(key, Range1d(*map(float, limits)))

    plot = new_plot(
        x_range=shared_range("x", axes.get_shared_x_axes(), axes.get_xlim()),
        y_range=shared_range("y", axes.get_shared_y_axes(), axes.get_ylim()),
        x_axis_type=axes.get_xscale(),
        y_axis_type=axes.get_yscale(),
        height=max(_LEAST_HEIGHT_PX, round(_PX_PER_IN * figure.get_figheight() * axes.get_position().height)) + 80,
        min_width=_LEAST_WIDTH_PX,
        min_border_left=84,
        sizing_mode="stretch_width",
        tools="box_zoom,pan,wheel_zoom,reset,save",
        active_drag="box_zoom",
    )
    plot.toolbar.logo = None
    for bokeh_axis, axis in ((plot.xaxis, axes.xaxis), (plot.yaxis, axes.yaxis)):
        _set_axis(bokeh_axis, axes, axis)
    if title := axes.get_title() or axes.get_title("left"):
        plot.title = Title(text=PlainText(text=fill(title, _TITLE_LINE_LETTERS)))
    shown: dict[str, list[Any]] = {}
    for label, renderer in draw_artists(axes, plot, figure):
        if label[:1] not in ("", "_"):
            shown.setdefault(label, []).append(renderer)
    if shown:
        _add_legend(plot, shown)
    plot.add_tools(HoverTool(tooltips=[("x", "$x{0.[0000]}"), ("y", "$y{0.[0000]}")]))
    return plot


def _set_axis(bokeh_axis: Any, axes: Any, axis: Any) -> None:
    """Set label, ticks and numbers of an axis as those of a matplotlib axis."""
    from bokeh.models import CustomJSTicker, CustomJSTickFormatter, FixedTicker, PlainText

    bokeh_axis.axis_label = PlainText(text=_axis_label(axes, axis))
    bokeh_axis.axis_label_text_font_style = "normal"
    if names := fixed_tick_names(axis):
        bokeh_axis.ticker = FixedTicker(ticks=list(names))
        bokeh_axis.major_label_orientation = _SLANT_RAD if axis is axes.xaxis else "horizontal"
        texts = {position: PlainText(text=fill(name, _TICK_LINE_LETTERS)) for position, name in names.items()}
        bokeh_axis.major_label_overrides = texts
    elif axis.get_scale() == "log":
        bokeh_axis.formatter = CustomJSTickFormatter(code=_LOG_NUMBER)
        bokeh_axis.ticker = CustomJSTicker(major_code=_LOG_TICKS)
    else:
        bokeh_axis.formatter.power_limit_high = _PLAIN_POWER
        if places := fixed_tick_positions(axis):
            bokeh_axis.ticker = FixedTicker(ticks=places)


def _add_legend(plot: Any, renderers_by_label: dict[str, list[Any]]) -> None:
    """Add a legend above the plot, in which a click hides a curve."""
    from bokeh.models import Legend, LegendItem

    columns = 1 if max(map(len, renderers_by_label)) > _LONG_LABEL_LETTERS else 2
    items = [LegendItem(label={"value": label}, renderers=shown) for label, shown in renderers_by_label.items()]
    plot.add_layout(Legend(items=items, click_policy="hide", ncols=columns, label_text_font_size="11px"), "above")
    plot.legend.update(location="top_left", border_line_color=None, padding=0, spacing=6, margin=0, glyph_height=14)


def _axis_label(axes: Any, axis: Any) -> str:
    """Label of an axis, or of one that shares its scale, which stands at the figure's edge."""
    name = axis.axis_name
    siblings = (axes.get_shared_x_axes() if name == "x" else axes.get_shared_y_axes()).get_siblings(axes)
    sharing_axes = (axis, *(getattr(panel, f"{name}axis") for panel in siblings))
    return next(filter(None, (sharing.get_label().get_text() for sharing in sharing_axes)), "")
