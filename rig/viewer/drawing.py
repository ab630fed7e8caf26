"""Drawing into an .rrd file: colours, styles, and columns in batches of rows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float

from rig.viewer.palette import Colour

TIMELINE = "sim_time"
DIAGNOSIS, GAP_OVER_TIME, KEY, PREDICTION = "diagnosis", "gap_over_time", "key", "prediction"
ROWS_PER_BATCH = 8192

LAYER_WIDTHS_PX = (3.5, 1.5)
"""Widths of a line over time and of those that are drawn over it and may coincide with it."""
LEGEND_ROW_COUNT = 9
"""Largest number of names per column of a legend."""


def entity(*parts: str) -> str:
    """Entity path of these names, with their special characters escaped."""
    return str(rr.new_entity_path(list(parts)))


def legend_of(origin: str) -> str:
    """Origin of the legend view of a plot."""
    return f"/legend/{origin.strip('/')}"


def send_static(stream: rr.RecordingStream, entity_path: str, components: rr.AsComponents) -> None:
    stream.log(entity_path, components, static=True)


def send(
    stream: rr.RecordingStream, entity_path: str, time_s: Float[np.ndarray, " rows"], archetype: Any, **columns: Any
) -> None:
    """Send columns of an archetype over time, in batches of ROWS_PER_BATCH."""
    for first_row in range(0, time_s.size, ROWS_PER_BATCH):
        row_span = slice(first_row, first_row + ROWS_PER_BATCH)
        column_batches = archetype.columns(**{name: column[row_span] for name, column in columns.items()})
        stream.send_columns(entity_path, [rr.TimeColumn(TIMELINE, duration=time_s[row_span])], column_batches)


def send_lines(
    stream: rr.RecordingStream,
    entity_path: str,
    time_s: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "channels samples"],
    line_names: Sequence[str],
    colours: Sequence[Colour],
    width_px: float = 1.5,
) -> None:
    """Send the lines of a time series; zoomed out, a pixel shows the extreme values, not their mean."""
    line_style = rr.SeriesLines(
        names=line_names,
        colors=[colours[channel_index % len(colours)] for channel_index in range(len(line_names))],
        widths=[width_px] * len(line_names),
        aggregation_policy=rr.components.AggregationPolicy.MinMax,
    )
    send_static(stream, entity_path, line_style)
    send(stream, entity_path, time_s, rr.Scalars, scalars=np.ascontiguousarray(values.T))


def send_labels(
    stream: rr.RecordingStream, path: str, positions: Sequence[Sequence[float]], texts: Sequence[str], colour: Colour
) -> None:
    """Send texts centred below their positions."""
    send_static(stream, path, rr.Points2D(positions, colors=[colour], radii=0, labels=texts, show_labels=True))


def send_legend(stream: rr.RecordingStream, origin: str, names_and_colours: Sequence[tuple[str, Colour]]) -> None:
    """Send the legend of a plot for the view beside it; in two columns beyond LEGEND_ROW_COUNT names."""
    column_count = 1 if len(names_and_colours) <= LEGEND_ROW_COUNT else 2
    row_count = max(LEGEND_ROW_COUNT, -(-len(names_and_colours) // column_count))
    for index, (name, colour) in enumerate(names_and_colours):
        row, column = divmod(index, column_count)
        position = [1.2 * (2 * column - column_count + 1), LEGEND_ROW_COUNT / row_count * row]
        send_labels(stream, f"{legend_of(origin)}/{index}", [position], [name], colour)


def pixels(radius_px: float) -> float:
    return float(rr.Radius.ui_points(radius_px))
