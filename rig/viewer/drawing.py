"""Drawing into an .rrd file: colours, styles, and columns in batches of rows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float

from rig.viewer.palette import Colour

TIMELINE = "sim_time"
DIAGNOSIS, GAP_OVER_TIME, KEY, PREDICTION = "diagnosis", "gap_over_time", "key", "prediction"
ROWS = 8192

LEGEND_ROWS = 9
"""Largest number of names per column of a legend."""


def entity(*parts: str) -> str:
    """Entity path of these names, with their special characters escaped."""
    return str(rr.new_entity_path(list(parts)))


def legend_of(origin: str) -> str:
    """Origin of the legend view of a plot."""
    return f"/legend/{origin.strip('/')}"


def style(stream: rr.RecordingStream, path: str, layout: rr.AsComponents) -> None:
    stream.log(path, layout, static=True)


def send(stream: rr.RecordingStream, path: str, time_s: Float[np.ndarray, " rows"], kind: Any, **columns: Any) -> None:
    """Send columns of an archetype over time, in batches of ROWS."""
    for first in range(0, time_s.size, ROWS):
        rows = slice(first, first + ROWS)
        index = rr.TimeColumn(TIMELINE, duration=time_s[rows])
        stream.send_columns(path, [index], kind.columns(**{name: values[rows] for name, values in columns.items()}))


def send_lines(
    stream: rr.RecordingStream,
    path: str,
    time_s: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "channels samples"],
    names: Sequence[str],
    colours: Sequence[Colour],
) -> None:
    """Send the lines of a time series; zoomed out, a pixel shows the extreme values, not their mean."""
    layout = rr.SeriesLines(
        names=names,
        colors=[colours[i % len(colours)] for i in range(len(names))],
        widths=[1.5] * len(names),
        aggregation_policy=rr.components.AggregationPolicy.MinMax,
    )
    style(stream, path, layout)
    send(stream, path, time_s, rr.Scalars, scalars=np.ascontiguousarray(values.T))


def send_labels(
    stream: rr.RecordingStream, path: str, places: Sequence[Sequence[float]], words: Sequence[str], colour: Colour
) -> None:
    """Send texts centred below their positions."""
    style(stream, path, rr.Points2D(places, colors=[colour], radii=0, labels=words, show_labels=True))


def send_legend(stream: rr.RecordingStream, origin: str, names: Sequence[tuple[str, Colour]]) -> None:
    """Send the legend of a plot for the view beside it; in two columns beyond LEGEND_ROWS names."""
    columns = 1 if len(names) <= LEGEND_ROWS else 2
    rows = max(LEGEND_ROWS, -(-len(names) // columns))
    for number, (name, colour) in enumerate(names):
        place = [1.2 * (2 * (number % columns) - columns + 1), LEGEND_ROWS / rows * (number // columns)]
        send_labels(stream, f"{legend_of(origin)}/{number}", [place], [name], colour)


def pixels(radius: float) -> float:
    return float(rr.Radius.ui_points(radius))
