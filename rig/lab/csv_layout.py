"""Layout of a CSV file of known form: which name, unit, start and rate belongs to which column, and how many lines."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import islice, pairwise
from pathlib import Path

from rig.errors import RigError
from rig.lab.csv_text import (
    TextForm,
    cell_kind_letters,
    cells_of,
    finite_number_or_none,
    is_number,
    lines_of,
    names_in,
    sample_lines,
)
from rig.lab.recorded import MAX_HEADER_LINES
from rig.lab.units import is_unit, name_and_unit, quantity_of

TIME_NAME_PATTERN = re.compile(
    r"^\W*(t|time|zeit|temps|tiempo|x_?value|x-?axis|x|second|sek|timestamp|elapsed|datetime|date)(?![a-z])|time|zeit",
    re.IGNORECASE,
)
SHOWN_LINES = 50
"""First lines of samples by which it is told which names belong to the columns, if there are more names."""
HEADER_LINE_COUNT = 12
"""Lines above the samples among which the names and units are."""
_LABEL_PATTERN = re.compile(
    r":$|^\W*(label|title|titel|name|signal|channel|kanal|data|item|no|nr|number|index|comment|units?|einheit)\W*$",
    re.IGNORECASE,
)
"""Label in the first cell of a line of names, which belongs to no column."""
_UNIT_LABEL_PATTERN = re.compile(r"^\W*[vy]?[ _-]?(axis )?(units?|einheit(en)?)([ _]?labels?)?\W*$", re.IGNORECASE)
_TIME_UNIT_LABEL_PATTERN = re.compile(r"^\W*[hxt][ _-]?(axis )?(units?|einheit(en)?)\W*$", re.IGNORECASE)
"""Labels in the first cell of lines of units."""
_REMARK_PATTERN = re.compile(r"^\W*(comments?|kommentare?|notes?|remarks?|bemerkung|marker|event)\W*$", re.IGNORECASE)
"""Name of a last column that is often empty."""
_COUNT_PATTERN = re.compile(
    r"^\W*((number|no\.?|#) of (data )?(samples|points|values)|samples|samples (per|/) channel|sample (count|size)|"
    r"(data )?points|block ?size|record (length|size)|(x-?axis|data) size|messwerte|"
    r"anzahl (der )?(messwerte|werte|samples|punkte))\W*(?P<count>\d+)?\s*$",
    re.IGNORECASE,
)
_START_PATTERN = re.compile(r"^\W*(x_?0|h[_ ]?offset|x[_ -]?offset)\W*$", re.IGNORECASE)
_INTERVAL_PATTERN = re.compile(r"^\W*(delta[_ ]?x|h[_ ]?resolution|x[_ -]?increment)\W*$", re.IGNORECASE)
_DATE_PATTERN = re.compile(r"(\d{4})[-/.](\d\d?)[-/.](\d\d?)")
_TIME_OF_DAY_PATTERN = re.compile(r"(\d\d?):(\d\d?):(\d\d?(?:[.,]\d+)?)$")


@dataclass(frozen=True)
class TextLayout:
    """A CSV file: the cells of its header, and the names and units (perhaps empty) of its columns.

    units_line is the number of the line of units (None: none), first_line that of the first line behind those skipped;
    line_count is that of the lines of samples. rate_hz_by_column and start_s_by_column are those of columns for which
    the header states different ones. ragged_line has another number of cells (its cells and number). several_sentence
    says that several records follow one another, the first of record_lines; it is empty if it is not so. notes say what
    was decided about the header.
    """

    path: Path
    form: TextForm
    header: tuple[tuple[str, ...], ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    rate_hz_by_column: Mapping[int, float]
    start_s_by_column: Mapping[int, float]
    has_names: bool
    units_line: int | None
    first_line: int
    line_count: int
    record_lines: int
    cell_count: int
    ragged_line: tuple[int, int] | None = None
    several_sentence: str = ""
    notes: tuple[str, ...] = ()

    @property
    def ragged_sentence(self) -> str:
        """Which line has another number of cells; empty if none has."""
        if self.ragged_line is None:
            return ""
        ragged_count, line_number = self.ragged_line
        return f"the number of columns changed from {self.cell_count} to {ragged_count} in line {line_number}"

    def unit(self, column_index: int) -> str | None:
        """Unit by the line of units, else by the name of the column."""
        return self.units[column_index] or name_and_unit(self.names[column_index])[1]


@dataclass(frozen=True)
class _SampleLines:
    """Shape of the lines of samples: cells of the first one without trailing_empty_count, empty in all, at its end.

    first_line_by_count maps every number of cells to the first line with that number; shown are the first lines, and
    joint the lines on both sides of the end of the record that the header states.
    """

    cell_count: int
    line_count: int
    first_line_by_count: Mapping[int, int]
    trailing_empty_count: int
    shown: tuple[tuple[str, ...], ...]
    joint: tuple[tuple[int, tuple[str, ...]], ...]


def layout_of(path: Path, form: TextForm) -> TextLayout:
    """Layout of a file of this form; raises RigError if it is not text in the encoding, or names and cells disagree."""
    lines = lines_of(path, form.encoding)
    header_lines = list(islice(lines, min(form.lines_before_names, MAX_HEADER_LINES)))
    name_line = next(islice(lines, form.lines_before_names - len(header_lines), None), None)
    if name_line is None:
        raise RigError(f"{path}: has no line after the first {form.lines_before_names}; check lines_before_names")
    listed_names = _joined_units(names_in(name_line, form.delimiter), form.delimiter)
    has_names = form.names
    if has_names is None:
        has_names = not all(is_number(name, form.decimal) for name in listed_names if name)
    if has_names:
        header_lines += [name_line, *islice(lines, min(form.lines_after_names, MAX_HEADER_LINES))]
    header = tuple(tuple(names_in(line.rstrip("\r\n"), form.delimiter)) for line in header_lines)
    skipped_count = form.lines_before_names + has_names + form.lines_after_names
    stated_counts = _stated_sample_counts(header)
    record_lines = max(stated_counts, default=0) if form.sample_lines is None else 0
    shape = _count_sample_lines(path, form, skipped_count, record_lines)
    near_rows = [row for row in header[-HEADER_LINE_COUNT:] if len(row) >= shape.cell_count and is_units_row(row)]
    units_row = _row_of_units(near_rows)
    names, units, notes = _names_and_units(path, listed_names if has_names else [], units_row, shape, form)
    several_sentence = ""
    if record_lines and shape.line_count != record_lines:
        several_sentence, note = _count_sentences(record_lines, names, shape, form.decimal)
        notes = (*notes, note) if note else notes
    if len(set(stated_counts)) > 1:
        notes = (
            *notes,
            f"the header states {' and '.join(map(str, dict.fromkeys(stated_counts)))} samples of channels",
        )
    if form.sample_lines is not None:
        notes = (*notes, f"the first {shape.line_count} lines of samples are read, as sample_lines says")
    rate_hz_by_column, start_s_by_column = _stated_clocks(header, names, form.decimal)
    return TextLayout(
        path=path,
        form=form,
        header=header,
        names=names,
        units=units,
        rate_hz_by_column=rate_hz_by_column,
        start_s_by_column=start_s_by_column,
        has_names=has_names,
        units_line=header.index(units_row) + 1 if units_row and any(units) else None,
        first_line=skipped_count + 1,
        line_count=shape.line_count,
        record_lines=record_lines,
        cell_count=shape.cell_count,
        ragged_line=_ragged_line(shape, len(names)),
        several_sentence=several_sentence,
        notes=notes,
    )


def _row_of_units(rows: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Row of the units of the columns: one that is called so, else the last that is not called the unit of the time."""
    named_rows = [row for row in rows if _UNIT_LABEL_PATTERN.match(row[0])]
    other_rows = [row for row in rows if not _TIME_UNIT_LABEL_PATTERN.match(row[0])]
    return next(iter((named_rows or other_rows)[::-1]), ())


def is_units_row(cells: Sequence[str]) -> bool:
    """True if at least half of the filled cells of a line of a header are units, and no other is a name of the time."""
    filled_cells = [cell for cell in cells if cell]
    other_cells = [cell for cell in filled_cells if not is_unit(cell.strip("[]()"))]  # "s" is a unit, "time" is none
    unit_count = len(filled_cells) - len(other_cells)
    is_time_named = any(map(TIME_NAME_PATTERN.search, other_cells))
    unit_count *= any(not cell.isdigit() for cell in filled_cells)  # 1 is a unit, and often a number of something
    return len(cells) > 1 and unit_count > 0 and unit_count >= len(filled_cells) / 2 and not is_time_named


def _joined_units(names: list[str], delimiter: str) -> list[str]:
    """Names between white space, with units in brackets joined to the name before."""
    joined_names: list[str] = []
    for name in names:
        if delimiter == " " and joined_names and name[:1] in ("[", "(") and name[-1:] in ("]", ")"):
            joined_names[-1] += f" {name}"
        else:
            joined_names.append(name)
    return joined_names


def _count_sample_lines(path: Path, form: TextForm, skipped_line_count: int, record_lines: int) -> _SampleLines:
    delimiter = form.delimiter
    numbered_lines = sample_lines(path, form, skipped_line_count)
    line_number, first_line = next(numbered_lines, (0, ""))
    if not first_line:
        raise RigError(f"{path}: holds no samples; export it again")
    first_cell_count = len(cells_of(first_line, delimiter))
    first_line_by_count, line_count = {first_cell_count: line_number}, 1
    trailing_empty_count = _trailing_empty_count(first_line, delimiter)
    shown, joint = [tuple(cells_of(first_line, delimiter))], []
    for line_number, line in numbered_lines:
        is_unquoted = '"' not in line and delimiter != " "
        count = line.count(delimiter) + 1 if is_unquoted else len(cells_of(line, delimiter))
        if count not in first_line_by_count:
            first_line_by_count[count] = line_number
        if trailing_empty_count:
            trailing_empty_count = min(trailing_empty_count, _trailing_empty_count(line, delimiter))
        if line_count < SHOWN_LINES:
            shown.append(tuple(cells_of(line, delimiter)))
        if record_lines and line_count in (1, record_lines - 1, record_lines):
            joint.append((line_number, tuple(cells_of(line, delimiter))))
        line_count += 1
    filled_line = first_line.rsplit(delimiter, trailing_empty_count)[0] if trailing_empty_count else first_line
    filled_count = len(cells_of(filled_line, delimiter))
    line_by_count = {count - first_cell_count + filled_count: number for count, number in first_line_by_count.items()}
    return _SampleLines(filled_count, line_count, line_by_count, trailing_empty_count, tuple(shown), tuple(joint))


def _trailing_empty_count(line: str, delimiter: str) -> int:
    """Number of empty cells at the end of a line."""
    return 0 if delimiter == " " else line.count(delimiter, len(line.rstrip(" \t" + delimiter)))


def _ragged_line(shape: _SampleLines, used_count: int) -> tuple[int, int] | None:
    """Cells and number of the first line of most cells that has another number of them; None if there is none.

    Of last columns without a name there may be any number.
    """
    ragged_lines = [
        (cell_count, line_number)
        for cell_count, line_number in shape.first_line_by_count.items()
        if cell_count != shape.cell_count and (cell_count < used_count or used_count == shape.cell_count)
    ]
    return max(ragged_lines, default=None)


def _names_and_units(
    path: Path, listed_names: list[str], units_row: Sequence[str], shape: _SampleLines, form: TextForm
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Names and units of the columns, and what was decided in words.

    Without names, or where nothing tells which of too many names belong to the columns, they are column 1, column 2,
    ... Raises RigError if there are fewer names than columns.
    """
    cell_count = shape.cell_count
    numbers_as_names = tuple(f"column {number}" for number in range(1, cell_count + 1))
    name_count = max((number for number, name in enumerate(listed_names, start=1) if name), default=0)
    if listed_names and (cell_count > len(listed_names) or not name_count or not cell_count):
        raise RigError(f"{path}: {name_count} names for {cell_count} columns; check the line of names")
    unit_cells = [cell.strip("[]() ") for cell in units_row]
    while unit_cells and not unit_cells[-1]:
        unit_cells.pop()
    if unit_cells and not is_unit(unit_cells[0]):  # a label, such as "Unit"
        unit_cells[0] = ""
    if not listed_names:
        return numbers_as_names, _spread(unit_cells, 0, cell_count), ()
    if name_count <= cell_count:
        return tuple(listed_names[:name_count]), _spread(unit_cells, 0, name_count), ()
    shift = _shift_of_names(listed_names[:name_count], unit_cells, shape, form)
    if shift is None:
        note = (
            f"{name_count} names ({', '.join(listed_names[:name_count][:8])}) for {cell_count} columns, and nothing "
            "tells which of them belong to the columns, which are called by their numbers"
        )
        return numbers_as_names, ("",) * cell_count, (note,)
    dropped_names = [name for name in (*listed_names[:shift], *listed_names[shift + cell_count : name_count]) if name]
    units_shift = shift if len(unit_cells) > cell_count else 0
    notes = (f"no column belongs to the name {' or '.join(map(repr, dropped_names))}",) if shift else ()
    return tuple(listed_names[shift : shift + cell_count]), _spread(unit_cells, units_shift, cell_count), notes


def _spread(cells: Sequence[str], first: int, count: int) -> tuple[str, ...]:
    chosen_cells = tuple(cells[first : first + count])
    return chosen_cells + ("",) * (count - len(chosen_cells))


def _shift_of_names(names: list[str], units_row: list[str], shape: _SampleLines, form: TextForm) -> int | None:
    """Number of names at the beginning that belong to no column; None if nothing tells it.

    A time stands above numbers that increase, units stand above columns, and a name left over is a label or a remark.
    """
    cell_count = shape.cell_count
    if form.delimiter == " ":  # a name may be of several words
        return None
    is_ascending = [_is_ascending([row[k] for row in shape.shown if k < len(row)], form) for k in range(cell_count)]
    scores = []
    for shift in range(len(names) - cell_count + 1):
        score = 1.0 if shift == 0 and len(names) <= cell_count + shape.trailing_empty_count else 0.0
        units = _spread(units_row, shift if len(units_row) > cell_count else 0, cell_count)
        for name, unit, ascends in zip(names[shift:], units, is_ascending, strict=False):
            bare_name, own_unit = name_and_unit(name, guess=True)
            column_unit = unit or own_unit
            is_time = TIME_NAME_PATTERN.search(bare_name) is not None or quantity_of(column_unit) == "time"
            if ascends is not None:
                score += (2.0 if ascends else -2.0) if is_time else -0.5 if ascends else 0.0
            score += 0.5 if column_unit else 0.0
            if unit and own_unit is None and is_time != (quantity_of(unit) == "time"):
                score -= 1.0
        score += sum(1.0 for name in names[:shift] if _LABEL_PATTERN.search(name) or not name)
        score += sum(1.0 for name in names[shift + cell_count :] if _REMARK_PATTERN.search(name))
        scores.append(score)
    order = sorted(range(len(scores)), key=lambda shift: -scores[shift])
    return order[0] if scores[order[0]] > scores[order[1]] else None


def _is_ascending(cells: Sequence[str], form: TextForm) -> bool | None:
    """True if the first cells of a column increase, or are dates; None if they are too few or too empty to tell."""
    kinds = cell_kind_letters(cells, form.decimal)
    if kinds.count("d") > len(kinds) / 2:
        return True
    numbers = [number for cell in cells if (number := finite_number_or_none(cell.strip(), form.decimal)) is not None]
    if len(numbers) < 4:
        return None
    return all(later > earlier for earlier, later in pairwise(numbers))


def _stated_sample_counts(header: Sequence[Sequence[str]]) -> list[int]:
    """Numbers of samples (per channel, perhaps) that a header states."""
    for row in header:
        for k, cell in enumerate(row):
            match = _COUNT_PATTERN.match(cell[:100])
            if match is None:
                continue
            texts = [match["count"]] if match["count"] else [text.strip() for text in row[k + 1 :]]
            if counts := [int(text) for text in texts if text.isdigit() and 1 < len(text) < 12 and int(text) > 1]:
                return counts
    return []


def _count_sentences(record_lines: int, names: Sequence[str], shape: _SampleLines, decimal: str) -> tuple[str, str]:
    """Sentence that several records follow, and a note; both empty if the time goes on beyond the stated count."""
    if shape.line_count < record_lines:
        return "", f"the header states {record_lines} samples, and only {shape.line_count} lines follow"
    cells_by_place = [shape.shown[0], *(cells for _, cells in shape.joint)]
    for k, name in enumerate(names):
        if (
            TIME_NAME_PATTERN.search(name)
            and all(k < len(cells) for cells in cells_by_place)
            and len(cells_by_place) > 3
        ):
            first, second, last, following = (
                finite_number_or_none(cells[k].strip(), decimal) for cells in cells_by_place
            )
            if first is None or second is None or last is None or following is None:
                if all(cell_kind_letters([cells[k]], decimal) == "d" for cells in cells_by_place):
                    return "", ""
                continue
            if abs((following - last) - (second - first)) <= 0.5 * abs(second - first):
                return (
                    "",
                    f"the header states {record_lines} samples, and {shape.line_count} lines of one record follow",
                )
    record_count = -(-shape.line_count // record_lines)
    return (
        f"its header states {record_lines} samples, and {shape.line_count} lines of samples follow: {record_count} "
        f"records one after another, the second from line {shape.joint[-1][0]}"
    ), ""


def _stated_clocks(
    header: Sequence[Sequence[str]], names: Sequence[str], decimal: str
) -> tuple[dict[int, float], dict[int, float]]:
    """Rate, Hz, and start, s, of the columns, where lines of the header state different ones of them."""
    columns = [k for k, name in enumerate(names) if name and not TIME_NAME_PATTERN.search(name)]
    cells_by_label: dict[str, list[str]] = {}
    for row in header:
        filled_cells = [cell.strip() for cell in row[1:] if cell.strip()]
        if row and len(filled_cells) == len(columns) > 1:
            cells_by_label[row[0].strip(' :"').lower()] = filled_cells
    starts_s = [0.0] * len(columns)
    intervals_s: list[float] = []
    for label, cells in cells_by_label.items():
        values = [finite_number_or_none(cell, decimal) for cell in cells]
        numbers = [value for value in values if value is not None]
        if len(numbers) == len(columns) and _START_PATTERN.match(label):
            starts_s = [start_s + number for start_s, number in zip(starts_s, numbers, strict=True)]
        elif len(numbers) == len(columns) and _INTERVAL_PATTERN.match(label) and min(numbers) > 0:
            intervals_s = numbers
    times_s = [_seconds_of_day(cell) for cell in cells_by_label.get("time", [])]
    days = [_day_number(cell) for cell in cells_by_label.get("date", [])]
    if times_s:
        days = days if len(days) == len(times_s) else [0] * len(times_s)
        starts_s = [
            start_s + time_s + 86400.0 * (day - days[0])
            for start_s, time_s, day in zip(starts_s, times_s, days, strict=True)
        ]
    return (
        dict(zip(columns, (1 / interval_s for interval_s in intervals_s), strict=True))
        if len(set(intervals_s)) > 1
        else {},
        dict(zip(columns, starts_s, strict=True)) if len(set(starts_s)) > 1 else {},
    )


def _seconds_of_day(cell: str) -> float:
    match = _TIME_OF_DAY_PATTERN.match(cell)
    return 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3].replace(",", ".")) if match else 0.0


def _day_number(cell: str) -> int:
    match = _DATE_PATTERN.match(cell)
    try:
        return date(int(match[1]), int(match[2]), int(match[3])).toordinal() if match else 0
    except ValueError:
        return 0
