"""Import of measured data as a recording, by a map from columns to sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.files import sha256_of
from rig.lab.clock import RATE_TOLERANCE, SampleTimes, even_samples_and_steps
from rig.lab.column import Column
from rig.lab.import_map import Map, Source, read_map
from rig.lab.recorded import recorded_date
from rig.lab.tables import Table, read_table
from rig.lab.units import si_factor
from rig.model.description import Rig
from rig.recording import RECORDED, channel_groups, with_processing_steps, writing
from rig.recording.writer import SAMPLES_AT_ONCE


def import_file(source: Path, map_path: Path, out: Path) -> tuple[str, ...]:
    """Write a recording of measured data and return the processing steps, which are also in its provenance.

    Values are converted to SI: value times scale times unit. Raises RigError with one sentence if the map, the rig or
    the data cannot be used; nothing is written then.
    """
    column_map, rig = read_map(map_path, out)
    map_sources = (*column_map.forces, *column_map.sensors.values(), column_map.time)
    table = read_table(source, column_map.csv, [entry.column for entry in map_sources if entry])
    date, date_origin = recorded_date(source, column_map.csv, [column.date_text for column in table.columns.values()])
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
        sample_times = sample_times_of(table, list(columns.values()), column_map.time, column_map.sample_rate_hz)
        si_rows = rows_in_si(columns, si_factors)
        values, resampling_steps = even_samples_and_steps(
            si_rows, sample_times, rig.sample_rate_hz, column_map.resample
        )
    except RigError as error:
        raise RigError(f"{source_label}: {error}") from error
    processing_steps = (
        f"{si_rows.shape[1]} samples of {len(si_rows)} columns read from {origin['source']}",
        "made SI: " + ", ".join(f"{n} = {si_factors[n]:.9g} x column {column.name!r}" for n, column in columns.items()),
        *(() if forces else ("no force was measured: its channel is zero",)),
        *resampling_steps,
        *table.notes,
    )
    provenance = with_processing_steps({"made_by": "rig import", **origin, "map": map_path.name}, *processing_steps)
    zero_forces = dict.fromkeys(rig.force_names, np.broadcast_to(0.0, values.shape[1]))
    _write_recording(out, rig, zero_forces | dict(zip(columns, values, strict=True)), provenance)
    return processing_steps


def columns_and_si_factors(
    table: Table, source_by_name: Mapping[str, tuple[str, Source]]
) -> tuple[dict[str, Column], dict[str, float]]:
    """Columns by source name, with the factors from their numbers to the SI unit of the quantity.

    Raises RigError if a column is not there, does not fit the others, or is in no unit of the quantity.
    """
    columns = {name: table.column(source.column) for name, (_, source) in source_by_name.items()}
    _check_columns(columns)
    si_factors = {name: _factor_to_si(quantity, src, columns[name]) for name, (quantity, src) in source_by_name.items()}
    return columns, si_factors


def rows_in_si(
    column_by_name: Mapping[str, Column], si_factors: Mapping[str, float]
) -> Float[np.ndarray, "channels samples"]:
    """Columns in SI as rows; raises RigError if a number overflows."""
    si_rows = np.empty((len(column_by_name), next(iter(column_by_name.values())).values.size))
    for si_row, (channel_name, column) in zip(si_rows, column_by_name.items(), strict=True):
        with np.errstate(over="ignore"):
            np.multiply(si_factors[channel_name], column.values, out=si_row)
        if not np.isfinite(si_row).all():
            raise RigError(
                f"column {column.name!r} times {si_factors[channel_name]:g} is too large for a number; correct its "
                "scale"
            )
    return si_rows


def sample_times_of(
    table: Table, columns: Sequence[Column], time: Source | None, sample_rate_hz: float | None
) -> SampleTimes:
    """Sampling times by a column of time, or at the given rate or that of the file."""
    sample_count = columns[0].values.size
    if time is not None:
        time_column = table.column(time.column)
        if time_column.values.size != sample_count or not np.isfinite(time_column.values).all():
            raise RigError(
                f"its time, column {time_column.name!r}, does not hold {sample_count} finite numbers; repair it"
            )
        stamps_s = rows_in_si({"time": time_column}, {"time": time.scale * si_factor("time", time.unit or "s")})[0]
        return SampleTimes.of_stamps(stamps_s)
    file_rates_hz = {column.sample_rate_hz for column in columns if column.sample_rate_hz is not None}
    if wrong_rates_hz := [rate_hz for rate_hz in file_rates_hz if not 0 < rate_hz < np.inf]:
        raise RigError(
            f"it says that it is sampled at {wrong_rates_hz[0]} Hz; give its sampling rate or column of time"
        )
    rate_hz = sample_rate_hz or min(file_rates_hz, default=None)
    if rate_hz is None:
        raise RigError("it does not say when its samples were taken; give their sampling rate or column of time")
    for column_rate_hz in file_rates_hz:
        if abs(column_rate_hz / rate_hz - 1) > RATE_TOLERANCE:
            raise RigError(f"it has columns at {column_rate_hz:.6g} and at {rate_hz:.6g} Hz; all need one rate")
    return SampleTimes.of_rate(rate_hz, sample_count)


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
    """Raise RigError unless columns are distinct, of equal length and finite."""
    name_by_column_id: dict[int, str] = {}
    first_name, first_column = next(iter(column_by_name.items()))
    for name, column in column_by_name.items():
        if earlier_name := name_by_column_id.get(id(column)):
            raise RigError(f"column {column.name!r} is given to both {earlier_name!r} and {name!r}; each needs its own")
        name_by_column_id[id(column)] = name
        if column.values.size != first_column.values.size:
            raise RigError(
                f"column {column.name!r} has {column.values.size} samples, the {first_name} "
                f"{first_column.values.size}; export them over the same time"
            )
        if not (is_finite := np.isfinite(column.values)).all():
            raise RigError(
                f"column {column.name!r} is not a finite number at sample {int(np.argmin(is_finite))}; repair the "
                "record or cut it there"
            )


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
