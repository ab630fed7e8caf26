"""The style that all figures of the pages share."""

from collections.abc import Callable
from io import BytesIO
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

BLUE, RED, GREY, GREEN = "#1f5fa8", "#c8402f", "#8a8a8a", "#2c8a57"
_STYLE = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "figure.dpi": 130,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "text.parse_math": False,  # names in a rig.json may hold any sign
}


def png(draw: Callable[[Any], object]) -> bytes:
    """A new figure in the style of all, drawn by a function, as a PNG file."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(7.2, 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        for axes in figure.axes:
            for axis in (axes.xaxis, axes.yaxis):
                if axis.get_scale() == "log":
                    plain_decades(axis)
        file = BytesIO()
        figure.savefig(file, format="png", bbox_inches="tight")
    return file.getvalue()


def plain_decades(axis: Any) -> None:
    """Plain numbers along a logarithmic axis; between the powers of ten only where it spans few."""
    low, high = sorted(axis.get_view_interval())
    few = high < 20 * low
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(lambda value, _: f"{value:g}" if few and f"{value:e}"[0] in "25" else "")
