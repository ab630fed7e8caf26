"""Axes of plots over other quantities than time, drawn in a 2D view: frame, ticks, units and a legend."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from rig.viewer.drawing import pixels, send_labels, style
from rig.viewer.palette import GRID, STEEL, Colour

WIDTH, HEIGHT = 1.6, 1.0
LABEL_HALF_HEIGHT = 0.06
"""Half the height of a label where the view is a sixth of a window of 1920 pixels."""
MAX_FIGURES = 6


@dataclass(frozen=True)
class Axes:
    """Ranges and names, with units, of both axes; logarithmic ones have a tick at each decade."""

    x: tuple[float, float]
    y: tuple[float, float]
    x_name: str
    y_name: str
    logarithmic: bool = False

    def points(self, x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"]) -> Float[np.ndarray, "points 2"]:
        """Coordinates in the view, whose y points downwards; values beyond an axis are clipped to its ends."""
        return np.stack([WIDTH * self._share(x, self.x), -HEIGHT * self._share(y, self.y)], axis=1)

    def _share(self, values: Float[np.ndarray, " points"], limits: tuple[float, float]) -> Float[np.ndarray, " points"]:
        inside = np.clip(values, *limits)
        scale = np.log10 if self.logarithmic else np.asarray
        low, high = scale(np.array(limits))
        return np.asarray((scale(inside) - low) / (high - low))

    def send(self, stream: rr.RecordingStream, path: str, legend: Mapping[str, Colour]) -> None:
        """Send the frame, the grid with its tick labels, the names of the axes, and the legend beside it.

        The viewer draws labels below their points: the label of y is below the end of its line.
        """
        x, y = (decades(*limits) if self.logarithmic else figures(*limits) for limits in (self.x, self.y))
        across = self.points(x, np.full(x.size, self.y[0])).tolist()
        up = self.points(np.full(y.size, self.x[0]), y).tolist()
        grid = [[[a, 0], [a, -HEIGHT]] for a, _ in across] + [[[-0.25, b], [WIDTH, b]] for _, b in up]
        frame = [[0, 0], [WIDTH, 0], [WIDTH, -HEIGHT], [0, -HEIGHT], [0, 0]]
        colours = [GRID] * len(grid) + [STEEL]
        style(stream, f"{path}/grid", rr.LineStrips2D([*grid, frame], colors=colours, radii=pixels(0.5)))
        places = [[a, 0.5 * LABEL_HALF_HEIGHT] for a, _ in across] + [[-0.15, b] for _, b in up]
        places += [[WIDTH / 2, 3 * LABEL_HALF_HEIGHT], [0.0, -HEIGHT - 0.15]]
        texts = [f"{value:.6g}" for value in (*x, *y)] + [self.x_name, self.y_name]
        send_labels(stream, f"{path}/figures", places, texts, STEEL)
        for row, (name, colour) in enumerate(legend.items()):
            place = [WIDTH + 0.4, -HEIGHT + 2.6 * LABEL_HALF_HEIGHT * row]
            send_labels(stream, f"{path}/legend/{row}", [place], [name], colour)


def axes_view(
    origin: str, name: str, **settings: rrb.VisibleTimeRange | list[rr.VisibleTimeRange]
) -> rrb.Spatial2DView:
    """View of a plot sent by `Axes.send`."""
    bounds = rrb.VisualBounds2D(x_range=[-0.35, WIDTH + 0.75], y_range=[-HEIGHT - 0.2, 5.5 * LABEL_HALF_HEIGHT])
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=bounds, **settings)


def figures(low: float, high: float) -> Float[np.ndarray, " figures"]:
    """Ticks, six at most, from low to high, at multiples of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10((high - low) / MAX_FIGURES))
    step = power * next(m for m in (1, 2, 5, 10, 20) if m * power * (MAX_FIGURES - 1) >= high - low)
    return step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)


def decades(low: float, high: float) -> Float[np.ndarray, " figures"]:
    """Powers of ten from low to high."""
    return 10.0 ** np.arange(np.ceil(np.log10(low) - 1e-9), np.floor(np.log10(high) + 1e-9) + 1)
