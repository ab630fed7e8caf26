"""Import map proposed for a file of measured data, with what was seen of it as comments."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from rig.errors import RigError, has_no_control_characters, one_line
from rig.lab.clock import MAX_DECIMATION, RATE_TOLERANCE
from rig.lab.column import Blocks
from rig.lab.csv_text import TEXT_SUFFIXES, TextForm
from rig.lab.import_map import PLACEHOLDER
from rig.lab.looking.clock import ClockProposal, clock_in
from rig.lab.looking.columns import ColumnSummary, FileSummary, summary_of_blocks
from rig.lab.looking.csv_columns import summary_of_csv
from rig.lab.looking.roles import ColumnRole, channel_columns_and_rejections, is_called_force, named_quantity, roles_of
from rig.lab.matlab import matlab_blocks
from rig.lab.recorded import recorded_date
from rig.lab.tables import with_blocks
from rig.lab.units import MASS_UNITS, canonical_unit, quantity_of, unit_of_force
from rig.limits import MAX_NAME_LENGTH
from rig.model.description import Rig
from rig.recording import RIG_NAME


@dataclass(frozen=True)
class Proposal:
    """Text of a map (TOML), its comments that say what was seen, and how many values are left to fill in."""

    text: str
    facts: tuple[str, ...]
    placeholder_count: int


def proposed_import_map(source_path: Path, rig: Rig | None, rig_name: str = RIG_NAME) -> Proposal:
    """Map proposed for a file, with a placeholder for each value that neither the file nor the rig states.

    rig_name is the path of rig.json that the map names. Raises RigError with one sentence if no map can import
    the file.
    """
    file_summary = with_blocks(source_path, TextForm(), lambda blocks: _summary_by_suffix(source_path, blocks))
    channels, left_out_reasons = channel_columns_and_rejections(file_summary.columns)
    if not channels:
        reasons = "; ".join(f"{_column_label(column)}: {reason}" for column, reason in left_out_reasons[:6])
        reasons = reasons or "it has no columns of numbers"
        raise RigError(f"{source_path}: no column of it is a measured channel ({reasons}); check what was exported")
    clock = clock_in(file_summary, channels, rig.sample_rate_hz if rig else None)
    if clock.column is not None:
        channels = tuple(channel for channel in channels if channel.number != clock.column.number)
        left_out_reasons = tuple((c, reason) for c, reason in left_out_reasons if c.number != clock.column.number)
    roles = roles_of(channels)
    date_text, date_origin = recorded_date(source_path, file_summary.form, [column.date_text for column in channels])
    facts = (
        *file_summary.facts,
        f"{channels[0].sample_count if channels else 0} samples of {len(channels)} channels; {clock.note}",
        f"recorded {date_text} by {date_origin}",
        *_rate_advice(clock, rig, rig_name),
    )
    key_by_number = _key_by_number(file_summary)
    map_lines = [
        f"rig = {json.dumps(rig_name)}" + ("" if rig else "  # the machine and its contacts; rig init writes it"),
        *_clock_lines(clock, key_by_number, rig),
        *_form_lines(file_summary.form),
        *_force_lines(roles, left_out_reasons, key_by_number, rig),
        "",
        "[sensors]",
        *_sensor_lines(roles, key_by_number, rig),
        *(f"# left out: {_column_label(column)} ({reason})" for column, reason in left_out_reasons),
    ]
    entries = (line.partition("  # ")[0] for line in map_lines if not line.startswith("#"))
    unfilled_count = sum(map_entry.count(f'= "{PLACEHOLDER}"') for map_entry in entries)
    heading_facts = [f"{source_path.name}: {facts[0]}", *facts[1:]]
    if unfilled_count:
        heading_facts.append(
            f'{unfilled_count} values are left to fill in, marked "{PLACEHOLDER}"; delete a sensor that is not needed'
        )
    map_text = "\n".join([*(f"# {one_line(fact)}" for fact in heading_facts), *map(one_line, map_lines), ""])
    return Proposal(map_text, tuple(map(one_line, facts)), unfilled_count)


def _summary_by_suffix(source_path: Path, blocks: Blocks) -> FileSummary:
    suffix = source_path.suffix.lower()
    if suffix in TEXT_SUFFIXES:
        return summary_of_csv(source_path)
    if suffix == ".mat":
        return summary_of_blocks(source_path, matlab_blocks(source_path, min_value_count=1))
    return summary_of_blocks(source_path, blocks)


def _key_by_number(file_summary: FileSummary) -> dict[int, str | int]:
    """Name of each column for the map, or its number if the name does not tell it from the others."""
    name_counts = Counter(column.name for column in file_summary.columns)

    def is_telling(name: str) -> bool:
        is_short = 0 < len(name) <= MAX_NAME_LENGTH
        return (
            name_counts[name] == 1
            and has_no_control_characters(name)
            and name == name.strip()
            and is_short
            and name != PLACEHOLDER
        )

    return {column.number: column.name if is_telling(column.name) else column.number for column in file_summary.columns}


def _column_label(column: ColumnSummary) -> str:
    return one_line(f"column {column.number} {column.name!r}" if column.name else f"column {column.number}")


def _rate_advice(clock: ClockProposal, rig: Rig | None, rig_name: str) -> Iterator[str]:
    if rig is None or clock.rate_hz is None:
        return
    rate_ratio = clock.rate_hz / rig.sample_rate_hz
    if rate_ratio < 1 - RATE_TOLERANCE or rate_ratio > MAX_DECIMATION:
        yield f"sample_rate_hz of {rig_name} is {rig.sample_rate_hz:g}; correct it to {clock.rate_hz:.9g}"


def _clock_lines(clock: ClockProposal, key_by_number: dict[int, str | int], rig: Rig | None) -> Iterator[str]:
    if clock.column is not None:
        yield f"time = {_entry_text(key_by_number[clock.column.number], {'unit': clock.unit or PLACEHOLDER})}"
    elif clock.rate_hz is None:
        yield f'sample_rate_hz = "{PLACEHOLDER}"'
    elif not clock.note.endswith("itself"):
        yield f"sample_rate_hz = {clock.rate_hz!r}  # {clock.note}"
    if clock.fault:
        yield f"resample = true  # {clock.fault}"
    elif rig and clock.rate_hz is not None and clock.rate_hz / rig.sample_rate_hz > 1 + RATE_TOLERANCE:
        yield f"resample = true  # to the {rig.sample_rate_hz:g} Hz of the rig"


def _form_lines(form: TextForm) -> Iterator[str]:
    """Line of the CSV form, with what differs from the default."""
    default, values = TextForm(), msgspec.structs.asdict(form)
    changed = [f"{name} = {json.dumps(value)}" for name, value in values.items() if value != getattr(default, name)]
    if changed:
        yield f"csv = {{ {', '.join(changed)} }}"


def _force_lines(
    roles: Sequence[ColumnRole],
    left_out_reasons: Sequence[tuple[ColumnSummary, str]],
    key_by_number: dict[int, str | int],
    rig: Rig | None,
) -> Iterator[str]:
    force_roles = [role for role in roles if role.quantity == "force"]
    doubts_of_forces = [
        *((column, f"is left out: {reason}") for column, reason in left_out_reasons if is_called_force(column)),
        *((role.column, f"is in {role.column.unit}") for role in roles if named_quantity(role.column) == "force"),
    ]
    if not force_roles and doubts_of_forces:
        doubts = "; ".join(f"{_column_label(column)} {doubt}" for column, doubt in doubts_of_forces)
        yield f'force = "{PLACEHOLDER}"  # {doubts}; name the column of the force and its unit, or export it again'
        return
    if not force_roles and rig is not None and all(rig.is_on_ground(station) for station in rig.forces):
        yield 'force = "none"  # rig.json has no force_at: its base shakes'
        return
    if not force_roles:
        yield (
            f'force = "{PLACEHOLDER}"  # no column says that it is one: move its entry here from below, '
            '{ column = ..., unit = "N", body = ..., position_m = ... }, or give "none" of a free decay'
        )
        return
    is_placed = rig is not None and len(rig.forces) == len(force_roles)
    place_entry = {} if is_placed else _place_fields(rig)
    entries = [_entry_text(key_by_number[role.column.number], _unit_fields(role) | place_entry) for role in force_roles]
    note = "; ".join(f"{_column_label(role.column)} is {_range_text(role)}" for role in force_roles)
    if is_placed and rig is not None:
        note += ", and acts at " + ", ".join(f"{station.position_m:g} m of {station.body}" for station in rig.forces)
    yield f"force = {entries[0] if len(entries) == 1 else '[' + ', '.join(entries) + ']'}  # {note}"


def _sensor_lines(roles: Sequence[ColumnRole], key_by_number: dict[int, str | int], rig: Rig | None) -> Iterator[str]:
    station_by_sensor = {sensor.name: sensor.station for sensor in rig.sensors} if rig else {}
    sensor_roles = [role for role in roles if role.quantity != "force"]
    if rig is not None and any(role.name not in station_by_sensor for role in sensor_roles):
        body_places = [body.name if body.is_mass else f"{body.name} (0 to {body.length_m:g} m)" for body in rig.bodies]
        names_hint = f"; sensors of rig.json need no place if they are named as there: {', '.join(station_by_sensor)}"
        yield f"# bodies: {', '.join(body_places)}{names_hint if station_by_sensor else ''}"
    for role in sensor_roles:
        entry_fields, sensor_note = _unit_fields(role), _range_text(role)
        if station := station_by_sensor.get(role.name):
            sensor_note += f", at {station.position_m:g} m of {station.body}"
        else:
            entry_fields |= {"quantity": role.quantity or PLACEHOLDER} | _place_fields(rig)
        entry = _entry_text(key_by_number[role.column.number], entry_fields)
        yield f"{json.dumps(role.name, ensure_ascii=False)} = {entry}  # {sensor_note}"


def _unit_fields(role: ColumnRole) -> dict[str, object]:
    """Unit of an entry, with a scale where the file's unit is of no quantity."""
    if _known_unit(role):
        return {"unit": _known_unit(role)}
    return dict.fromkeys(("unit", "scale") if role.column.unit else ("unit",), PLACEHOLDER)


def _known_unit(role: ColumnRole) -> str | None:
    """Canonical unit of a column; None if the file has none, or one of no quantity."""
    file_unit = role.column.unit or ""
    plain_unit = unit_of_force(file_unit) if role.quantity == "force" else canonical_unit(file_unit)
    return plain_unit if quantity_of(plain_unit) else None


def _place_fields(rig: Rig | None) -> dict[str, object]:
    """Body and place, as far as a rig with one body states them."""
    if rig is None or len(rig.bodies) != 1:
        return {"body": PLACEHOLDER, "position_m": PLACEHOLDER}
    body = rig.bodies[0]
    return {"body": body.name, "position_m": 0.0 if body.is_mass else PLACEHOLDER}


def _entry_text(column_key: str | int, entry_fields: dict[str, object]) -> str:
    all_fields = {"column": column_key, **entry_fields}
    return "{ " + ", ".join(f"{key} = {json.dumps(v, ensure_ascii=False)}" for key, v in all_fields.items()) + " }"


def _range_text(role: ColumnRole) -> str:
    column = role.column
    unit_text = f" {column.unit}" if column.unit else ""
    range_text = f"{column.lowest:.4g} to {column.highest:.4g}{unit_text}"
    known_unit = _known_unit(role)
    if column.unit in MASS_UNITS:
        range_text += f", and {column.unit} is taken as {known_unit}" if known_unit else ""
    if unit_text and not known_unit:
        return f"{range_text}; unit is what it measures, scale how much of it one {column.unit} is"
    return range_text if unit_text else f"{range_text}, without a unit in the file"
