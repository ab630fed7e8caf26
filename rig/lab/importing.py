"""Import of measured data as a recording, by a map from columns to sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.files import sha256_of
from rig.lab.clock import RATE_TOLERANCE, SampleTimes, even
from rig.lab.column import Column
from rig.lab.import_map import Map, Source, read_map
from rig.lab.recorded import recorded_date
from rig.lab.tables import Table, read_table
from rig.lab.units import si_factor
from rig.model.description import Rig
from rig.recording import RECORDED, channel_groups, with_history, writing
from rig.recording.writer import SAMPLES_AT_ONCE


def import_file(source: Path, map_path: Path, out: Path) -> tuple[str, ...]:
    """Write a recording of measured data and return the processing steps, which are also in its provenance.

    Values are converted to SI: value times scale times unit. Raises RigError with one sentence if the map, the rig or
    the data cannot be used; nothing is written then.
    """
    mapping, rig = read_map(map_path, out)
    keys = [entry.column for entry in (*mapping.forces, *mapping.sensors.values(), mapping.time) if entry]
    table = read_table(source, mapping.csv, keys)
    date, date_origin = recorded_date(source, mapping.csv, [column.recorded for column in table.columns.values()])
    origin = {"source": source.name, "source_sha256": sha256_of(source), RECORDED: date}
    table = replace(table, notes=(*table.notes, f"recorded {date} by {date_origin}"))
    return _import(table, origin, str(source), mapping, rig, map_path, out)


def import_columns(columns: Sequence[Column], source: str, map_path: Path, out: Path) -> tuple[str, ...]:
    """Import columns in memory, described by `source`, as `import_file` does."""
    return _import(Table.of(columns), {"source": source}, source, *read_map(map_path, out), map_path, out)


def _import(
    table: Table,
    origin: Mapping[str, str],
    source: str,
    mapping: Map,
    rig: Rig,
    map_path: Path,
    out: Path,
) -> tuple[str, ...]:
    forces = mapping.forces
    sources = {name: ("force", source) for name, source in zip(rig.force_names, forces, strict=False)}
    sources |= {s.name: (s.quantity, mapping.sensors[s.name]) for s in rig.sensors}
    try:
        columns, factors = source_columns(table, sources)
    except RigError as error:
        raise RigError(f"{map_path}: {error}") from error
    try:
        clock = clock_of(table, list(columns.values()), mapping.time, mapping.sample_rate_hz)
        rows = rows_in_si(columns, factors)
        values, resampled = even(rows, clock, rig.sample_rate_hz, mapping.resample)
    except RigError as error:
        raise RigError(f"{source}: {error}") from error
    steps = (
        f"{rows.shape[1]} samples of {len(rows)} columns read from {origin['source']}",
        "made SI: " + ", ".join(f"{n} = {factors[n]:.9g} x column {c.name!r}" for n, c in columns.items()),
        *(() if forces else ("no force was measured: its channel is zero",)),
        *resampled,
        *table.notes,
    )
    provenance = {
        "made_by": "rig import",
        **origin,
        "map": map_path.name,
    }
    unforced = dict.fromkeys(rig.force_names, np.broadcast_to(0.0, values.shape[1]))
    _write(out, rig, unforced | dict(zip(columns, values, strict=True)), with_history(provenance, *steps))
    return steps


def source_columns(
    table: Table, sources: Mapping[str, tuple[str, Source]]
) -> tuple[dict[str, Column], dict[str, float]]:
    """Columns by source name, with the factors from their numbers to the SI unit of the quantity.

    Raises RigError if a column is not there, does not fit the others, or is in no unit of the quantity.
    """
    columns = {name: table.column(entry.column) for name, (_, entry) in sources.items()}
    _check_columns(columns)
    return columns, {name: _factor(quantity, entry, columns[name]) for name, (quantity, entry) in sources.items()}


def rows_in_si(columns: Mapping[str, Column], factors: Mapping[str, float]) -> Float[np.ndarray, "channels samples"]:
    """Columns in SI as rows; raises RigError if a number overflows."""
    rows = np.empty((len(columns), next(iter(columns.values())).values.size))
    for row, (name, column) in zip(rows, columns.items(), strict=True):
        with np.errstate(over="ignore"):
            np.multiply(factors[name], column.values, out=row)
        if not np.isfinite(row).all():
            raise RigError(
                f"column {column.name!r} times {factors[name]:g} is too large for a number; correct its scale"
            )
    return rows


def clock_of(table: Table, columns: Sequence[Column], time: Source | None, sample_rate_hz: float | None) -> SampleTimes:
    """Sampling times by a column of time, or at the given rate or that of the file."""
    samples = columns[0].values.size
    if time is not None:
        column = table.column(time.column)
        if column.values.size != samples or not np.isfinite(column.values).all():
            raise RigError(f"its time, column {column.name!r}, does not hold {samples} finite numbers; repair it")
        stamps_s = rows_in_si({"time": column}, {"time": time.scale * si_factor("time", time.unit or "s")})[0]
        return SampleTimes.of_stamps(stamps_s)
    rates = {c.sample_rate_hz for c in columns if c.sample_rate_hz is not None}
    if wrong := [rate for rate in rates if not 0 < rate < np.inf]:
        raise RigError(f"it says that it is sampled at {wrong[0]} Hz; give its sampling rate or column of time")
    rate = sample_rate_hz or min(rates, default=None)
    if rate is None:
        raise RigError("it does not say when its samples were taken; give their sampling rate or column of time")
    for column_rate in rates:
        if abs(column_rate / rate - 1) > RATE_TOLERANCE:
            raise RigError(f"it has columns at {column_rate:.6g} and at {rate:.6g} Hz; all need one rate")
    return SampleTimes.of_rate(rate, samples)


def _write(
    out: Path, rig: Rig, rows: Mapping[str, Float[np.ndarray, " samples"]], provenance: Mapping[str, str]
) -> None:
    groups = channel_groups(rig)
    with writing(out, rig, groups, provenance) as recording:
        for first in range(0, next(iter(rows.values())).size, SAMPLES_AT_ONCE):
            span = slice(first, first + SAMPLES_AT_ONCE)
            recording.append_all({name: np.stack([rows[c][span] for c in g.names]) for name, g in groups.items()})


def _check_columns(columns: Mapping[str, Column]) -> None:
    """Raise RigError unless columns are distinct, of equal length and finite."""
    first_use: dict[int, str] = {}
    first_name, reference = next(iter(columns.items()))
    for name, column in columns.items():
        if first := first_use.get(id(column)):
            raise RigError(f"column {column.name!r} is given to both {first!r} and {name!r}; each needs its own")
        first_use[id(column)] = name
        if column.values.size != reference.values.size:
            raise RigError(
                f"column {column.name!r} has {column.values.size} samples, the {first_name} {reference.values.size}; "
                "export them over the same time"
            )
        if not np.isfinite(column.values).all():
            sample = int(np.argmin(np.isfinite(column.values)))
            raise RigError(
                f"column {column.name!r} is not a finite number at sample {sample}; repair the record or cut it there"
            )


def _factor(quantity: str, entry: Source, column: Column) -> float:
    """Factor from a column's numbers to SI; raises RigError if file and map state different units."""
    if entry.unit is None and column.unit is None:
        raise RigError(f"column {column.name!r} has no unit; add unit = ... in the map")
    factor = si_factor(quantity, entry.unit or column.unit or "")
    if entry.unit and column.unit:
        try:
            file_factor = si_factor(quantity, column.unit)
        except RigError:  # what programs put there is often no unit at all, such as "EU"
            file_factor = factor
        if file_factor != factor:
            raise RigError(f"column {column.name!r} is in {column.unit!r} by the file, {entry.unit!r} by the map")
    return factor * entry.scale
