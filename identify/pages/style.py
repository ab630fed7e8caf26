"""The style that all figures of the pages share."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rig.files import atomic_write

BLUE, RED, GREY, GREEN = "#1f5fa8", "#c8402f", "#8a8a8a", "#2c8a57"


@contextmanager
def saved(path: Path) -> Iterator[Any]:
    """A new figure in the style of all, saved when the block has drawn it."""
    style = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "figure.dpi": 130, "axes.spines.top": False}
    with mpl.rc_context({**style, "axes.spines.right": False, "legend.frameon": False}):
        figure = _new_figure()
        yield figure
        with atomic_write(path) as part:
            figure.savefig(part, format="png", bbox_inches="tight")


def _new_figure() -> Any:
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
