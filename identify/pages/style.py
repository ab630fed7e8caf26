"""The style that all figures of the pages share."""

from collections.abc import Callable
from io import BytesIO
from typing import Any

from identify.pages.picture import Picture

BLUE, RED, GREY, GREEN, INK = "#1f5fa8", "#c8402f", "#8a8a8a", "#2c8a57", "#444444"
_STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "text.parse_math": False,  # names in a rig.json may hold any sign
}


def picture(draw: Callable[[Any], object], width_in: float = 7.2, height_in: float = 4.2) -> Picture:
    """A new figure in the style of all, drawn by a function."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained", dpi=140)
        FigureCanvasAgg(figure)
        draw(figure)
        for axes in figure.axes:
            for axis in (axes.xaxis, axes.yaxis):
                if axis.get_scale() == "log":
                    _plain_decades(axis)
        file = BytesIO()
        figure.savefig(file, format="png", bbox_inches="tight")
    return Picture(file.getvalue(), figure)


def _plain_decades(axis: Any) -> None:
    """Plain numbers along a logarithmic axis; between the powers of ten only where it spans few."""
    low, high = sorted(axis.get_view_interval())
    few = high < 20 * low
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(lambda value, _: f"{value:g}" if few and f"{value:e}"[0] in "25" else "")
