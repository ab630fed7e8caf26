"""Pictures of figures in a common style."""

from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from rig.files import write_bytes

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


@dataclass(frozen=True)
class Picture:
    """PNG file and the matplotlib figure that it shows; a notebook displays it."""

    png: bytes = field(repr=False)
    """Contents of the PNG file."""
    figure: Any = field(repr=False, compare=False, default=None)
    """Matplotlib figure, to change and to save in another format."""

    def save(self, path: str | Path) -> None:
        """Write the PNG file."""
        write_bytes(self.png, Path(path))

    def _repr_png_(self) -> bytes:
        return self.png


def picture(draw: Callable[[Any], object], width_in: float = 7.2, height_in: float = 4.2) -> Picture:
    """Picture of a new figure in the common style, drawn by a function."""
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
                    _set_plain_log_labels(axis)
        png_buffer = BytesIO()
        figure.savefig(png_buffer, format="png", bbox_inches="tight")
    return Picture(png_buffer.getvalue(), figure)


def _set_plain_log_labels(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers, between the powers of ten only where it spans few."""
    lowest_value, highest_value = sorted(axis.get_view_interval())
    is_narrow = highest_value < 20 * lowest_value
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(lambda value, _: f"{value:g}" if is_narrow and f"{value:e}"[0] in "25" else "")
