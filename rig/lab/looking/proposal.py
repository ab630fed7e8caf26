"""Import map proposed for a file of measured data, with what was seen of it as comments."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.errors import RigError, is_plain, one_line
from rig.lab.clock import MAX_DECIMATION, RATE_TOLERANCE
from rig.lab.column import Blocks
from rig.lab.csv_text import TEXT_SUFFIXES, TextForm
from rig.lab.import_map import PLACEHOLDER
from rig.lab.looking.clock import SeenClock, clock_in
from rig.lab.looking.columns import SeenColumn, SeenFile, seen_blocks
from rig.lab.looking.csv_columns import seen_csv
from rig.lab.looking.roles import Role, candidates_in, roles_of
from rig.lab.matlab import matlab_blocks
from rig.lab.recorded import recorded_date
from rig.lab.tables import with_blocks
from rig.lab.units import plainly, quantity_of
from rig.limits import MAX_NAME
from rig.model.description import Rig
from rig.recording import RIG_NAME


@dataclass(frozen=True)
class Proposal:
    """Text of a map (TOML), its comments that say what was seen, and how many values are left to fill in."""

    text: str
    facts: tuple[str, ...]
    placeholder_count: int


def look_at(source: Path, rig: Rig | None, rig_name: str = RIG_NAME) -> Proposal:
    """Map proposed for a file, with a placeholder for each value that neither the file nor the rig states.

    rig_name is the path of rig.json that the map names. Raises RigError with one sentence if no map can import
    the file.
    """
    file = with_blocks(source, TextForm(), lambda blocks: _file_content(source, blocks))
    channels, left_out = candidates_in(file.columns)
    if not channels:
        reasons = "; ".join(f"{_label(c)}: {reason}" for c, reason in left_out[:6]) or "it has no columns of numbers"
        raise RigError(f"{source}: no column of it is a measured channel ({reasons}); check what was exported")
    clock = clock_in(file, channels, rig.sample_rate_hz if rig else None)
    if clock.column is not None:
        channels = tuple(c for c in channels if c.number != clock.column.number)
        left_out = tuple((c, reason) for c, reason in left_out if c.number != clock.column.number)
    roles = roles_of(channels)
    date, origin = recorded_date(source, file.form, [column.recorded for column in channels])
    facts = (
        *file.facts,
        f"{channels[0].samples if channels else 0} samples of {len(channels)} channels; {clock.note}",
        f"recorded {date} by {origin}",
        *_rate_advice(clock, rig, rig_name),
    )
    keys = _keys(file)
    lines = [
        f"rig = {json.dumps(rig_name)}" + ("" if rig else "  # the machine and its contacts; rig init writes it"),
        *_clock_lines(clock, keys, rig),
        *_form_lines(file.form),
        *_force_lines(roles, keys, rig),
        "",
        "[sensors]",
        *_sensor_lines(roles, keys, rig),
        *(f"# left out: {_label(column)} ({reason})" for column, reason in left_out),
    ]
    placeholder_count = sum(
        line.partition("  # ")[0].count(f'= "{PLACEHOLDER}"') for line in lines if not line.startswith("#")
    )
    heading = [f"{source.name}: {facts[0]}", *facts[1:]]
    if placeholder_count:
        heading.append(
            f'{placeholder_count} values are left to fill in, marked "{PLACEHOLDER}"; '
            "delete a sensor that is not needed"
        )
    text = "\n".join([*(f"# {one_line(fact)}" for fact in heading), *map(one_line, lines), ""])
    return Proposal(text, tuple(map(one_line, facts)), placeholder_count)


def _file_content(source: Path, blocks: Blocks) -> SeenFile:
    suffix = source.suffix.lower()
    if suffix in TEXT_SUFFIXES:
        return seen_csv(source)
    if suffix == ".mat":
        return seen_blocks(source, matlab_blocks(source, least_values=1))
    return seen_blocks(source, blocks)


def _keys(file: SeenFile) -> dict[int, str | int]:
    """Name of each column for the map, or its number if the name does not tell it from the others."""
    times = Counter(column.name for column in file.columns)
    return {
        c.number: c.name
        if times[c.name] == 1
        and is_plain(c.name)
        and c.name == c.name.strip()
        and 0 < len(c.name) <= MAX_NAME
        and c.name != PLACEHOLDER
        else c.number
        for c in file.columns
    }


def _label(column: SeenColumn) -> str:
    return one_line(f"column {column.number} {column.name!r}" if column.name else f"column {column.number}")


def _rate_advice(clock: SeenClock, rig: Rig | None, rig_name: str) -> Iterator[str]:
    if rig is None or clock.rate_hz is None:
        return
    ratio = clock.rate_hz / rig.sample_rate_hz
    if ratio < 1 - RATE_TOLERANCE or ratio > MAX_DECIMATION:
        yield f"sample_rate_hz of {rig_name} is {rig.sample_rate_hz:g}; correct it to {clock.rate_hz:.9g}"


def _clock_lines(clock: SeenClock, keys: dict[int, str | int], rig: Rig | None) -> Iterator[str]:
    if clock.column is not None:
        yield f"time = {_entry(keys[clock.column.number], {'unit': clock.unit or PLACEHOLDER})}"
    elif clock.rate_hz is None:
        yield f'sample_rate_hz = "{PLACEHOLDER}"'
    elif not clock.note.endswith("itself"):
        yield f"sample_rate_hz = {clock.rate_hz!r}  # {clock.note}"
    higher = rig is not None and clock.rate_hz is not None and clock.rate_hz / rig.sample_rate_hz > 1 + RATE_TOLERANCE
    if clock.fault:
        yield f"resample = true  # {clock.fault}"
    elif higher and rig is not None:
        yield f"resample = true  # to the {rig.sample_rate_hz:g} Hz of the rig"


def _form_lines(form: TextForm) -> Iterator[str]:
    """Line of the CSV form, with what differs from the default."""
    default = TextForm()
    changed = {
        field: value for field in form.__struct_fields__ if (value := getattr(form, field)) != getattr(default, field)
    }
    if changed:
        yield "csv = { " + ", ".join(f"{k} = {json.dumps(v)}" for k, v in changed.items()) + " }"


def _force_lines(roles: Sequence[Role], keys: dict[int, str | int], rig: Rig | None) -> Iterator[str]:
    forces = [role for role in roles if role.quantity == "force"]
    if not forces:
        yield (
            f'force = "{PLACEHOLDER}"  # no column says that it is one: move its entry here from below, '
            '{ column = ..., unit = "N", body = ..., position_m = ... }, or give "none" of a free decay'
        )
        return
    placed = rig is not None and len(rig.forces) == len(forces)
    entries = [_entry(keys[role.column.number], _unit_keys(role) | ({} if placed else _place(rig))) for role in forces]
    note = "; ".join(f"{_label(role.column)} is {_range(role)}" for role in forces)
    if placed and rig is not None:
        note += ", and acts at " + ", ".join(f"{s.position_m:g} m of {s.body}" for s in rig.forces)
    yield f"force = {entries[0] if len(entries) == 1 else '[' + ', '.join(entries) + ']'}  # {note}"


def _sensor_lines(roles: Sequence[Role], keys: dict[int, str | int], rig: Rig | None) -> Iterator[str]:
    sensor_by_name = {sensor.name: sensor for sensor in rig.sensors} if rig else {}
    sensors = [role for role in roles if role.quantity != "force"]
    if rig is not None and any(role.name not in sensor_by_name for role in sensors):
        places = ", ".join(b.name if b.is_mass else f"{b.name} (0 to {b.length_m:g} m)" for b in rig.bodies)
        named = (
            f"; sensors of rig.json need no place if they are named as there: {', '.join(sensor_by_name)}"
            if sensor_by_name
            else ""
        )
        yield f"# bodies: {places}{named}"
    for role in sensors:
        name = json.dumps(role.name, ensure_ascii=False)
        fields = _unit_keys(role)
        note = _range(role)
        if role.name in sensor_by_name:
            station = sensor_by_name[role.name].station
            note += f", at {station.position_m:g} m of {station.body}"
        else:
            fields |= {"quantity": role.quantity or PLACEHOLDER} | _place(rig)
        yield f"{name} = {_entry(keys[role.column.number], fields)}  # {note}"


def _unit_keys(role: Role) -> dict[str, object]:
    """Unit of an entry, with a scale where the file's unit is of no quantity."""
    unit = role.column.unit
    if quantity_of(unit):
        return {"unit": plainly(unit or "")}
    return dict.fromkeys(("unit", "scale") if unit else ("unit",), PLACEHOLDER)


def _place(rig: Rig | None) -> dict[str, object]:
    """Body and place, as far as a rig with one body states them."""
    if rig is None or len(rig.bodies) != 1:
        return {"body": PLACEHOLDER, "position_m": PLACEHOLDER}
    body = rig.bodies[0]
    return {"body": body.name, "position_m": 0.0 if body.is_mass else PLACEHOLDER}


def _entry(column: str | int, fields: dict[str, object]) -> str:
    content = {"column": column, **fields}
    return "{ " + ", ".join(f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in content.items()) + " }"


def _range(role: Role) -> str:
    column = role.column
    unit = f" {column.unit}" if column.unit else ""
    text = f"{column.lowest:.4g} to {column.highest:.4g}{unit}"
    if unit and not quantity_of(column.unit):
        return f"{text}; unit is what it measures, scale how much of it one {column.unit} is"
    return text if unit else f"{text}, without a unit in the file"
