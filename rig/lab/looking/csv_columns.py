"""Columns of a CSV file whose form is found from its text, with what is ragged about them."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from msgspec.structs import replace

from rig.errors import RigError
from rig.lab.clock import restart_samples
from rig.lab.column import missing_row
from rig.lab.csv_columns import TextColumn, column_of, read_text_columns
from rig.lab.csv_layout import TIME_NAME_PATTERN, Layout, layout_of
from rig.lab.csv_text import TextForm
from rig.lab.looking.columns import FileSummary, column_summary
from rig.lab.looking.csv_dialect import text_form_of
from rig.lab.recorded import stated_sampling_rate_hz
from rig.lab.units import name_and_unit, quantity_of
from rig.limits import PROGRAM_BYTES, check_decoded_size

LEAST_FILLED_SHARE = 0.9
"""Share of the lines, up to its last number, in which a channel has a number, unless it is a slower one."""
LEAST_LENGTH_SHARE = 0.9
"""Share of the lines with its time over which a channel reaches."""
MOST_SKIPPED_SHARE = 0.1
"""Share of the lines that may be skipped at the beginning until all channels have numbers."""
WORKING_BYTES_PER_CELL = 16
"""A number is held as it is read and in the table."""
_DELIMITER_WORDS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "spaces"}


def summary_of_csv(path: Path) -> FileSummary:
    """Columns of a CSV file; raises RigError with a sentence if no map can import it."""
    layout = layout_of(path, text_form_of(path))
    facts: list[str] = []
    if layout.several_sentence:
        facts.append(f"{layout.several_sentence}; the first is taken")
        layout = layout_of(path, replace(layout.form, sample_lines=layout.record_lines))
    needed_bytes = PROGRAM_BYTES + WORKING_BYTES_PER_CELL * len(layout.names) * layout.line_count
    check_decoded_size(needed_bytes, path.stat().st_size, f"{path}: its {len(layout.names)} columns")
    line_numbers, text_columns = read_text_columns(layout, range(len(layout.names)))
    _check_one_block(path, line_numbers, text_columns)
    restart_rows = [_restart_row(c) for k, c in enumerate(text_columns) if _is_time(layout, k, c)]
    restart_row = min((row for row in restart_rows if row), default=0)
    if restart_row:
        facts.append(
            f"its time begins again in line {line_numbers[restart_row]}: records of {restart_row} and more lines "
            "follow one another, of which the first is taken"
        )
        layout = layout_of(path, replace(layout.form, sample_lines=restart_row))
        line_numbers, text_columns = read_text_columns(layout, range(len(layout.names)))
    return _summary(layout, line_numbers, text_columns, tuple(facts))


@dataclass(frozen=True)
class _Rasters:
    """Rows of each column from its first number to behind its last, and those of the raster of its time."""

    raster: Int[np.ndarray, " columns"]
    first_rows: Int[np.ndarray, " columns"]
    end_rows: Int[np.ndarray, " columns"]
    is_channel: Bool[np.ndarray, " columns"]

    @property
    def first_row(self) -> int:
        """First row in which all channels have begun."""
        return int(self.first_rows[self.is_channel].max())

    def end_row(self, raster: int) -> int:
        """Row behind the last one in which all channels of a raster have a number."""
        return int(self.end_rows[self.is_channel & (self.raster == raster)].min(initial=np.iinfo(int).max))


def _summary(
    layout: Layout, line_numbers: Int[np.ndarray, " lines"], text_columns: Sequence[TextColumn], found: Sequence[str]
) -> FileSummary:
    form, line_count, path = layout.form, layout.line_count, layout.path
    rasters = _rasters(layout, text_columns)
    if layout.ragged_line is not None and layout.ragged_line[0] > layout.cell_count:
        raise RigError(f"{path}: {layout.ragged_sentence}; check delimiter")
    if not rasters.is_channel.any():
        raise RigError(
            f"{path}: none of its {len(text_columns)} columns has numbers throughout; export the channels at one rate"
        )
    facts = [_encoding_and_delimiter_sentence(form), _line_layout_sentence(layout), *found, *layout.notes]
    first_row = rasters.first_row
    if first_row:
        skipped_count = int(line_numbers[first_row] - line_numbers[0])
        form = _form_with_more_skipped_lines(form, layout, skipped_count, first_row)
        facts.append(f"lines {line_numbers[0]} to {line_numbers[first_row] - 1} lack numbers, and are skipped")
    ends = {raster: rasters.end_row(raster) for raster in set(rasters.raster[rasters.is_channel].tolist())}
    longest_end = max(ends.values())
    is_tail_cut = any(
        rasters.end_rows[rasters.is_channel & (rasters.raster == raster)].max() > end for raster, end in ends.items()
    )
    if longest_end < line_count or is_tail_cut or layout.ragged_line is not None:
        form = replace(form, cut_incomplete_end=True)
    if longest_end < line_count:
        facts.append(
            f"the last {line_count - longest_end} lines, from line {line_numbers[longest_end]} on, are incomplete and "
            "left out"
        )
    columns = []
    for k, text_column in enumerate(text_columns):
        column_end = min(ends.get(int(rasters.raster[k]), longest_end), line_count)
        values = text_column.values[first_row : max(column_end, first_row)]
        fault = _fault(layout, k, text_column, line_numbers, rasters, values, first_row)
        column = column_of(layout, k, text_column, values)
        heading = "" if layout.names[k] == f"column {k + 1}" else layout.names[k]
        unit = layout.units[k] or name_and_unit(heading, guess=True)[1]
        columns.append(
            column_summary(k + 1, dataclasses.replace(column, name=heading, unit=unit), text_column.is_date, fault)
        )
    rate_hz = stated_sampling_rate_hz(layout.header, form.decimal)
    return FileSummary(path, tuple(columns), tuple(facts), form, rate_hz)


def _rasters(layout: Layout, text_columns: Sequence[TextColumn]) -> _Rasters:
    """Raster of each column: that of the last times before it which increase."""
    is_filled = np.array([np.isfinite(text_column.values) for text_column in text_columns])
    first_rows, counts = is_filled.argmax(axis=1), is_filled.sum(axis=1)
    end_rows = np.array([text_column.end for text_column in text_columns])
    rasters, is_behind_time = [0] * len(text_columns), True
    for k, text_column in enumerate(text_columns):
        is_time = _is_time(layout, k, text_column) and _restart_row(text_column) == 0 and counts[k] > 1
        rasters[k] = rasters[k - 1] + (is_time and not is_behind_time) if k else 0
        is_behind_time = is_time
    raster = np.array(rasters)
    longest_ends = np.array([end_rows[raster == number].max() for number in raster])
    is_sparse = np.array(
        [
            end > 0 and count < end and missing_row(text_column.values[:end]) is None
            for text_column, end, count in zip(text_columns, end_rows, counts, strict=True)
        ]
    )
    is_channel = (
        ((counts / np.maximum(end_rows - first_rows, 1) >= LEAST_FILLED_SHARE) | is_sparse)
        & (end_rows >= LEAST_LENGTH_SHARE * longest_ends)
        & (first_rows <= MOST_SKIPPED_SHARE * end_rows)
        & (counts > 0)
    )
    first_rows = np.where(is_sparse, 0, first_rows)
    end_rows = np.where(is_sparse, longest_ends, end_rows)
    return _Rasters(raster, first_rows, end_rows, is_channel)


def _is_time(layout: Layout, column_index: int, text_column: TextColumn) -> bool:
    name, unit = name_and_unit(layout.names[column_index], guess=True)
    unit = layout.units[column_index] or unit
    is_time = quantity_of(unit) == "time" if unit else TIME_NAME_PATTERN.search(name) is not None
    return text_column.is_date or is_time


def _restart_row(text_column: TextColumn) -> int:
    """Row in which a time begins again; 0 if it goes on, or if it decreases otherwise."""
    numbers = text_column.values[np.isfinite(text_column.values)]
    restarts = restart_samples(numbers)
    if not restarts.size:
        return 0
    return int(np.flatnonzero(np.isfinite(text_column.values))[restarts[0]])


def _fault(
    layout: Layout,
    column_index: int,
    text_column: TextColumn,
    line_numbers: Int[np.ndarray, " lines"],
    rasters: _Rasters,
    values: Float[np.ndarray, " rows"],
    first_row: int,
) -> str:
    """Reason why no channel can be made of a column; empty if one can."""
    word = text_column.word
    count = int(np.isfinite(text_column.values).sum())
    if word is not None and count and (word.row < text_column.end or not rasters.is_channel[column_index]):
        return f"line {word.line_number} has {word.text[:50]!r}, {word.reason}"
    if not count:
        return "it has no numbers"
    if not rasters.is_channel[column_index]:
        return f"it has numbers in {count} of {layout.line_count} lines"
    row = missing_row(values)
    if row is None:
        return ""
    return f"it has no number in line {line_numbers[first_row + row]}"


def _check_one_block(path: Path, line_numbers: Int[np.ndarray, " lines"], text_columns: Sequence[TextColumn]) -> None:
    """Raise RigError if lines without any numbers stand between lines of samples."""
    last_end = max(text_column.end for text_column in text_columns)
    has_numbers = np.zeros(last_end, dtype=bool)
    for text_column in text_columns:
        has_numbers |= np.isfinite(text_column.values[:last_end])
    empty_rows = np.flatnonzero(~has_numbers)
    if empty_rows.size:
        raise RigError(
            f"{path}: line {line_numbers[empty_rows[0]]} is no line of samples, and samples follow in line "
            f"{line_numbers[int(empty_rows[-1]) + 1]}; export each block of samples to a file of its own"
        )


def _form_with_more_skipped_lines(form: TextForm, layout: Layout, skipped_count: int, skipped_rows: int) -> TextForm:
    if form.sample_lines is not None:
        form = replace(form, sample_lines=form.sample_lines - skipped_rows)
    if layout.has_names:
        return replace(form, lines_after_names=form.lines_after_names + skipped_count)
    return replace(form, lines_before_names=form.lines_before_names + skipped_count)


def _encoding_and_delimiter_sentence(form: TextForm) -> str:
    encoding = {"utf-8-sig": "UTF-8"}.get(form.encoding, form.encoding)
    delimiter = _DELIMITER_WORDS.get(form.delimiter, repr(form.delimiter))
    return f"text in {encoding}, {delimiter} between columns, decimal {'comma' if form.decimal == ',' else 'point'}"


def _line_layout_sentence(layout: Layout) -> str:
    names_words = f"names in line {layout.form.lines_before_names + 1}" if layout.has_names else "no names"
    units_words = f"units in line {layout.units_line}" if layout.units_line else "no line of units"
    return f"{names_words}, {units_words}, samples from line {layout.first_line}"
