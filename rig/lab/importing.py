"""Import of measured data as a recording, by a map from columns to sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from rig.errors import RigError
from rig.files import sha256_of
from rig.lab.clock import RATE_TOLERANCE, SampleTimes, TimedChannels, samples_on_one_clock
from rig.lab.column import Column, missing_row, repetition_count, repetition_words
from rig.lab.import_map import Map, Source, TimeSource, read_map
from rig.lab.recorded import recorded_date
from rig.lab.tables import Table, read_table
from rig.lab.units import si_factor
from rig.limits import MAX_NUMBER
from rig.model.description import Rig
from rig.recording import RECORDED, channel_groups, with_processing_steps, writing
from rig.recording.writer import SAMPLES_AT_ONCE


def import_file(source: Path, map_path: Path, out: Path) -> tuple[str, ...]:
    """Write a recording of measured data and return the processing steps, which are also in its provenance.

    Values are converted to SI: value times scale times unit. Raises RigError with one sentence if the map, the rig or
    the data cannot be used; nothing is written then.
    """
    column_map, rig = read_map(map_path, out)
    table = read_table(source, column_map.csv, column_map.columns)
    latest_first = sorted(table.columns.values(), key=lambda column: -(column.start_s or 0.0))
    date, date_origin = recorded_date(source, column_map.csv, [column.date_text for column in latest_first])
    origin_entries = {"source": source.name, "source_sha256": sha256_of(source), RECORDED: date}
    table = replace(table, notes=(*table.notes, f"recorded {date} by {date_origin}"))
    return _import(table, origin_entries, str(source), column_map, rig, map_path, out)


def import_columns(columns: Sequence[Column], source_label: str, map_path: Path, out: Path) -> tuple[str, ...]:
    """Import columns in memory, described by `source_label`, as `import_file` does."""
    return _import(Table.of(columns), {"source": source_label}, source_label, *read_map(map_path, out), map_path, out)


def _import(
    table: Table, origin: Mapping[str, str], source_label: str, column_map: Map, rig: Rig, map_path: Path, out: Path
) -> tuple[str, ...]:
    forces = column_map.forces
    source_by_channel = {name: ("force", force) for name, force in zip(rig.force_names, forces, strict=False)}
    source_by_channel |= {sensor.name: (sensor.quantity, column_map.sensors[sensor.name]) for sensor in rig.sensors}
    try:
        columns, si_factors = columns_and_si_factors(table, source_by_channel)
    except RigError as error:
        raise RigError(f"{map_path}: {error}") from error
    try:
        time_by_channel = {name: source.time or column_map.time for name, (_, source) in source_by_channel.items()}
        groups, notes = timed_channels(
            table,
            columns,
            si_factors,
            time_by_channel,
            column_map.sample_rate_hz,
            (rig.sample_rate_hz,),
            column_map.csv.cut_incomplete_end,
        )
        row_by_channel, resampling_steps = samples_on_one_clock(groups, rig.sample_rate_hz, column_map.resample)
    except RigError as error:
        raise RigError(f"{source_label}: {error}") from error
    processing_steps = (
        f"{max(group.times.sample_count for group in groups)} samples of {len(columns)} columns read from "
        f"{origin['source']}",
        "made SI: " + ", ".join(f"{n} = {si_factors[n]:.9g} x column {column.name!r}" for n, column in columns.items()),
        *(() if forces else ("no force was measured: its channel is zero",)),
        *resampling_steps,
        *notes,
        *table.notes,
    )
    provenance = with_processing_steps({"made_by": "rig import", **origin, "map": map_path.name}, *processing_steps)
    zeros = np.broadcast_to(0.0, next(iter(row_by_channel.values())).size)
    _write_recording(out, rig, dict.fromkeys(rig.force_names, zeros) | row_by_channel, provenance)
    return processing_steps


def columns_and_si_factors(
    table: Table, source_by_name: Mapping[str, tuple[str, Source]]
) -> tuple[dict[str, Column], dict[str, float]]:
    """Columns by source name, with the factors from their numbers to the SI unit of the quantity.

    Raises RigError if a column is not there, is given twice, or is in no unit of the quantity.
    """
    columns = {name: table.column(source.column) for name, (_, source) in source_by_name.items()}
    _check_columns(columns)
    si_factors = {name: _factor_to_si(quantity, src, columns[name]) for name, (quantity, src) in source_by_name.items()}
    return columns, si_factors


def timed_channels(
    table: Table,
    column_by_name: Mapping[str, Column],
    si_factors: Mapping[str, float],
    time_by_name: Mapping[str, TimeSource | None],
    sample_rate_hz: float | None,
    expected_hz: Sequence[float] = (),
    is_end_cut: bool = False,
) -> tuple[list[TimedChannels], tuple[str, ...]]:
    """Channels in SI, those sampled at the same times together, and what was seen of them in words.

    Times are those of a column, else of sample_rate_hz or of the rate that a column states; of stamps with few digits,
    one of expected_hz. Raises RigError if the times of a channel are not known, or a number is beyond what anything
    measures.
    """
    starts_s = _stated_starts_s(column_by_name)
    groups: list[tuple[SampleTimes, list[tuple[str, Bool[np.ndarray, " lines"]]]]] = []
    notes: list[str] = []
    raster_by_name = {
        name: (time, None if time else column_by_name[name].sample_rate_hz) for name, time in time_by_name.items()
    }
    for raster in dict.fromkeys(raster_by_name.values()):
        time, _ = raster
        columns = {name: column for name, column in column_by_name.items() if raster_by_name[name] == raster}
        time_column = None if time is None else table.column(time.column)
        line_count = _line_count(columns, time_column, is_end_cut, bool(starts_s))
        longest = max(column.values.size for column in (*columns.values(), *filter(None, [time_column])))
        if line_count is not None and longest > line_count:
            notes.append(f"the last {longest - line_count} lines are incomplete and were left out")
        for name, column in columns.items():
            is_sampled = _is_sampled(column, line_count)
            if time is None or time_column is None:
                times = _times_of_rate(column, is_sampled, sample_rate_hz, starts_s.get(name))
            else:
                times = _times_of_stamps(time, time_column, is_sampled, expected_hz)
                times = replace(times, start_s=starts_s[name]) if len(set(starts_s.values())) > 1 else times
            same = next((channels for other_times, channels in groups if other_times.is_same_as(times)), None)
            if same is None:
                groups.append((times, same := []))
            same.append((name, is_sampled))
    timed_groups = [_in_si(times, channels, column_by_name, si_factors) for times, channels in groups]
    for group in timed_groups:
        for name, row in zip(group.names, group.values, strict=True):
            if (repeat_count := repetition_count(row)) > 1:
                notes.append(repetition_words(name, repeat_count, group.times.rate_hz))
    return timed_groups, tuple(dict.fromkeys(notes))


def _in_si(
    times: SampleTimes,
    channels: Sequence[tuple[str, Bool[np.ndarray, " lines"]]],
    column_by_name: Mapping[str, Column],
    si_factors: Mapping[str, float],
) -> TimedChannels:
    """Channels of the same times in SI; raises RigError at a number beyond what anything measures."""
    si_rows = np.empty((len(channels), times.sample_count))
    for si_row, (name, is_sampled) in zip(si_rows, channels, strict=True):
        column = column_by_name[name]
        values = column.values[: is_sampled.size]
        with np.errstate(over="ignore"):
            np.multiply(si_factors[name], values if is_sampled.all() else values[is_sampled], out=si_row)
        if np.abs(si_row).max() > MAX_NUMBER:
            sample = int(np.argmax(np.abs(si_row)))
            if abs(column.values[is_sampled.nonzero()[0][sample]]) > MAX_NUMBER:
                raise RigError(
                    f"column {column.name!r} is {column.values[is_sampled.nonzero()[0][sample]]:g} at sample {sample}, "
                    "which nothing measures: a mark of overload, perhaps; repair the record or leave that channel out"
                )
            raise RigError(
                f"column {column.name!r} times {si_factors[name]:g} is too large for a number; correct its scale"
            )
    first_column = column_by_name[channels[0][0]]
    return TimedChannels(f"column {first_column.name!r}", tuple(name for name, _ in channels), si_rows, times)


def _stated_starts_s(column_by_name: Mapping[str, Column]) -> dict[str, float]:
    """Start of each channel, s, on the clock of the file; empty if it states none.

    Raises RigError if it states different ones, and none of a channel.
    """
    starts_s = {name: column.start_s for name, column in column_by_name.items() if column.start_s is not None}
    if len(starts_s) == len(column_by_name) or len(set(starts_s.values())) < 2:
        return starts_s if len(starts_s) == len(column_by_name) else {}
    silent = next(column.name for name, column in column_by_name.items() if name not in starts_s)
    raise RigError(
        f"it does not say when column {silent!r} begins, and other columns begin up to "
        f"{max(starts_s.values()) - min(starts_s.values()):.6g} s apart; export them with their times"
    )


def _line_count(
    columns: Mapping[str, Column], time_column: Column | None, is_end_cut: bool, are_starts_stated: bool
) -> int | None:
    """Lines over which columns that share their times reach; None if each has a start and rate of its own.

    Raises RigError if they are unlike and the end is not to be cut.
    """
    if time_column is None and are_starts_stated:
        return None
    dense_columns = {name: column for name, column in columns.items() if np.isfinite(column.values).all()}
    counts = {column.name: column.values.size for column in dense_columns.values()}
    if time_column is not None:
        counts[time_column.name] = time_column.values.size
    longest = max(column.values.size for column in columns.values())
    line_count = (min if is_end_cut else max)(counts.values(), default=longest)
    for column in (*filter(None, [time_column]), *columns.values()):
        is_shorter = column.values.size < line_count and missing_row(_padded(column.values, line_count)) is not None
        if is_shorter or (column.values.size > line_count and not is_end_cut):
            others = f"its time, column {time_column.name!r}," if time_column else "another"
            raise RigError(
                f"column {column.name!r} has {column.values.size} samples, {others} {line_count}; export them over "
                "the same time, give it a time of its own, or cut the record (of a text: cut_incomplete_end = true)"
            )
    return line_count


def _padded(values: Float[np.ndarray, " samples"], line_count: int) -> Float[np.ndarray, " lines"]:
    return np.concatenate([values, np.full(max(0, line_count - values.size), np.nan)])


def _is_sampled(column: Column, line_count: int | None) -> Bool[np.ndarray, " lines"]:
    """Lines in which a column has a number; raises RigError unless it has one in all, or regularly in some."""
    values = column.values[:line_count]
    row = missing_row(values)
    if row is not None:
        raise RigError(
            f"column {column.name!r} is not a finite number at sample {row}; repair the record or cut it there"
        )
    return np.isfinite(values)


def _times_of_stamps(
    time: TimeSource,
    time_column: Column,
    is_sampled: Bool[np.ndarray, " lines"],
    expected_hz: Sequence[float],
) -> SampleTimes:
    """Sampling times by a column of time, at the lines in which a channel has a number."""
    stamps = time_column.values[: is_sampled.size][is_sampled[: time_column.values.size]]
    sample_count = int(is_sampled.sum())
    if stamps.size != sample_count or not np.isfinite(stamps).all():
        raise RigError(f"its time, column {time_column.name!r}, does not hold {sample_count} finite numbers; repair it")
    unit_s = time.scale * si_factor("time", time.unit or time_column.unit or "s")
    return SampleTimes.of_stamps(stamps, unit_s, time_column.last_digit, expected_hz)


def _times_of_rate(
    column: Column, is_sampled: Bool[np.ndarray, " lines"], sample_rate_hz: float | None, start_s: float | None
) -> SampleTimes:
    """Sampling times by the rate of the map or that of the file, at the lines in which a channel has a number."""
    file_rate_hz = column.sample_rate_hz
    if file_rate_hz is not None and not 0 < file_rate_hz < np.inf:
        raise RigError(f"it says that it is sampled at {file_rate_hz} Hz; give its sampling rate or column of time")
    rate_hz = sample_rate_hz or file_rate_hz
    if rate_hz is None:
        raise RigError("it does not say when its samples were taken; give their sampling rate or column of time")
    if file_rate_hz is not None and abs(file_rate_hz / rate_hz - 1) > RATE_TOLERANCE:
        raise RigError(
            f"column {column.name!r} is sampled at {file_rate_hz:.6g} Hz by the file, {rate_hz:.6g} Hz by the map; "
            "leave one out"
        )
    rows = np.flatnonzero(is_sampled)
    step = int(rows[1] - rows[0]) if rows.size > 1 else 1
    return SampleTimes.of_rate(rate_hz / step, rows.size, (start_s or 0.0) + float(rows[:1].sum()) / rate_hz)


def _write_recording(
    out: Path, rig: Rig, samples_by_channel: Mapping[str, Float[np.ndarray, " samples"]], provenance: Mapping[str, str]
) -> None:
    channels_by_group = channel_groups(rig)
    with writing(out, rig, channels_by_group, provenance) as recording_writer:
        for first_sample in range(0, next(iter(samples_by_channel.values())).size, SAMPLES_AT_ONCE):
            sample_span = slice(first_sample, first_sample + SAMPLES_AT_ONCE)
            values_by_group = {
                group_name: np.stack([samples_by_channel[channel_name][sample_span] for channel_name in channels.names])
                for group_name, channels in channels_by_group.items()
            }
            recording_writer.append_all(values_by_group)


def _check_columns(column_by_name: Mapping[str, Column]) -> None:
    """Raise RigError unless columns are distinct."""
    name_by_column_id: dict[int, str] = {}
    for name, column in column_by_name.items():
        if earlier_name := name_by_column_id.get(id(column)):
            raise RigError(f"column {column.name!r} is given to both {earlier_name!r} and {name!r}; each needs its own")
        name_by_column_id[id(column)] = name


def _factor_to_si(quantity: str, source: Source, column: Column) -> float:
    """Factor from a column's numbers to SI; raises RigError if file and map state different units."""
    if source.unit is None and column.unit is None:
        raise RigError(f"column {column.name!r} has no unit; add unit = ... in the map")
    map_factor = si_factor(quantity, source.unit or column.unit or "")
    if source.unit and column.unit:
        try:
            file_factor = si_factor(quantity, column.unit)
        except RigError:  # what programs put there is often no unit at all, such as "EU"
            file_factor = map_factor
        if file_factor != map_factor:
            raise RigError(f"column {column.name!r} is in {column.unit!r} by the file, {source.unit!r} by the map")
    return map_factor * source.scale
