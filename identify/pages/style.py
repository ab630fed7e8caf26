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
}


def png(draw: Callable[[Any], object]) -> bytes:
    """A new figure in the style of all, drawn by a function, as a PNG file."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(7.2, 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        file = BytesIO()
        figure.savefig(file, format="png", bbox_inches="tight")
    return file.getvalue()
