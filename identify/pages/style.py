"""The style that all figures of the pages share."""

from collections.abc import Callable
from io import BytesIO
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from identify.pages.decades import plain_decades

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
