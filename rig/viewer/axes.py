"""Axes of plots over other quantities than time, drawn in a 2D view: frame, ticks, units and a legend."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from rig.viewer.drawing import pixels, send_labels, send_static
from rig.viewer.palette import GRID, STEEL, Colour

WIDTH, HEIGHT = 1.6, 1.0
LABEL_HALF_HEIGHT = 0.06
"""Half the height of a label where the view is a sixth of a window of 1920 pixels."""
MAX_TICK_COUNT = 6


@dataclass(frozen=True)
class Axes:
    """Ranges and names, with units, of both axes; logarithmic ones have a tick at each decade."""

    x: tuple[float, float]
    y: tuple[float, float]
    x_name: str
    y_name: str
    is_logarithmic: bool = False

    def points(self, x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"]) -> Float[np.ndarray, "points 2"]:
        """Coordinates in the view, whose y points downwards; values beyond an axis are clipped to its ends."""
        return np.stack([WIDTH * self._axis_fraction(x, self.x), -HEIGHT * self._axis_fraction(y, self.y)], axis=1)

    def _axis_fraction(
        self, values: Float[np.ndarray, " points"], span: tuple[float, float]
    ) -> Float[np.ndarray, " points"]:
        clipped_values = np.clip(values, *span)
        axis_scale = np.log10 if self.is_logarithmic else np.asarray
        low_end, high_end = axis_scale(np.array(span))
        return np.asarray((axis_scale(clipped_values) - low_end) / (high_end - low_end))

    def send(self, stream: rr.RecordingStream, entity_path: str, colour_by_name: Mapping[str, Colour]) -> None:
        """Send the frame, the grid with its tick labels, the names of the axes, and the legend beside it.

        The viewer draws labels below their points: the label of y is below the end of its line.
        """
        x_ticks, y_ticks = (decades(*span) if self.is_logarithmic else tick_values(*span) for span in (self.x, self.y))
        tick_xs = self.points(x_ticks, np.full(x_ticks.size, self.y[0]))[:, 0].tolist()
        tick_ys = self.points(np.full(y_ticks.size, self.x[0]), y_ticks)[:, 1].tolist()
        grid = [[[x, 0], [x, -HEIGHT]] for x in tick_xs] + [[[-0.25, y], [WIDTH, y]] for y in tick_ys]
        frame = [[0, 0], [WIDTH, 0], [WIDTH, -HEIGHT], [0, -HEIGHT], [0, 0]]
        colours = [GRID] * len(grid) + [STEEL]
        send_static(stream, f"{entity_path}/grid", rr.LineStrips2D([*grid, frame], colors=colours, radii=pixels(0.5)))
        label_positions = [[x, 0.5 * LABEL_HALF_HEIGHT] for x in tick_xs] + [[-0.15, y] for y in tick_ys]
        label_positions += [[WIDTH / 2, 3 * LABEL_HALF_HEIGHT], [0.0, -HEIGHT - 0.15]]
        label_texts = [f"{value:.6g}" for value in (*x_ticks, *y_ticks)] + [self.x_name, self.y_name]
        send_labels(stream, f"{entity_path}/figures", label_positions, label_texts, STEEL)
        for legend_row, (name, colour) in enumerate(colour_by_name.items()):
            name_position = [WIDTH + 0.4, -HEIGHT + 2.6 * LABEL_HALF_HEIGHT * legend_row]
            send_labels(stream, f"{entity_path}/legend/{legend_row}", [name_position], [name], colour)


def axes_view(
    origin: str, view_name: str, **view_settings: rrb.VisibleTimeRange | list[rr.VisibleTimeRange]
) -> rrb.Spatial2DView:
    """View of a plot sent by `Axes.send`."""
    visual_bounds = rrb.VisualBounds2D(x_range=[-0.35, WIDTH + 0.75], y_range=[-HEIGHT - 0.2, 5.5 * LABEL_HALF_HEIGHT])
    return rrb.Spatial2DView(origin=origin, name=view_name, visual_bounds=visual_bounds, **view_settings)


def tick_values(lowest: float, highest: float) -> Float[np.ndarray, " figures"]:
    """Ticks, six at most, from low to high, at multiples of 1, 2 or 5 times a power of ten."""
    decade, span = 10.0 ** np.floor(np.log10((highest - lowest) / MAX_TICK_COUNT)), highest - lowest
    step = decade * next(multiple for multiple in (1, 2, 5, 10, 20) if multiple * decade * (MAX_TICK_COUNT - 1) >= span)
    first_multiple = np.ceil(lowest / step - 1e-9) + 0.0  # not -0
    return step * np.arange(first_multiple, np.floor(highest / step + 1e-9) + 1)


def decades(lowest: float, highest: float) -> Float[np.ndarray, " figures"]:
    """Powers of ten from low to high."""
    return 10.0 ** np.arange(np.ceil(np.log10(lowest) - 1e-9), np.floor(np.log10(highest) + 1e-9) + 1)
