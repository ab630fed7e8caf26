"""The command `rig`."""

import json
import math
from collections.abc import Sequence
from functools import reduce
from inspect import getdoc
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from rig.commands.cli_files import draw, export_, fmu, format_help_texts, import_, recover, schema
from rig.commands.cli_init import init
from rig.commands.cli_view import view
from rig.commands.command_line import (
    CommandApp,
    Force,
    Json,
    StoppedError,
    Version,
    check_file_ending,
    help_filled_by,
    literal_console,
    progress_bar,
    progress_spinner,
    refuse_existing,
    run,
    say,
)
from rig.commands.demo import demo
from rig.commands.doctor import doctor as installation
from rig.errors import RigError, hint

if TYPE_CHECKING:
    from numpy import ndarray

    from rig.model.description import Body, Rig, Station
    from rig.recording import Recording, Signals
    from rig.simulation.own import UserRig
    from rig.simulation.reference import Reference
else:
    # what a command needs of the other rooms is imported when it runs: the help is shown at once
    ndarray = Body = Rig = Station = Recording = Signals = UserRig = Reference = Any

app = CommandApp(no_args_is_help=True)

FREQUENCY_COUNT = 4
"""Frequencies of a body that are printed."""
LEAST_FREQUENCY_HZ = 1e-3
"""Frequency up to which a mode is a rigid-body mode, by rounding."""
File = Annotated[Path, typer.Argument(metavar="FILE", help="The recording, an .mcap file.")]


@app.callback()
def _callback(version: Version = False) -> None:
    """A virtual test rig: simulates a structure with clearances and records it as a laboratory would."""


def _record_help_texts() -> dict[str, str]:
    """Words for the help of `rig record`: reference rigs, plants, and every setting and effect with its defaults."""
    from rig.effects import effects
    from rig.simulation.own import UserRigSettings
    from rig.simulation.plants import PLANTS
    from rig.simulation.reference import REFERENCES, settings_in_order

    def defaults_text(struct_type: type[msgspec.Struct]) -> str:
        return ", ".join(f"{field.name}={field.default}" for field in settings_in_order(struct_type))

    settings_by_rig = {**REFERENCES, "FILE.json": UserRigSettings}
    paragraphs = (
        *(f"Settings of {name}: {defaults_text(settings_type)}" for name, settings_type in settings_by_rig.items()),
        "None stands for a value that follows from the rig: rms_n moves the contacts by some clearances.",
        *(f"Effect {name}: {defaults_text(kind)}. {_first_paragraph(kind)}" for name, kind in effects().items()),
    )
    return {"references": ", ".join(REFERENCES), "plants": ", ".join(PLANTS), "settings": "\n\n".join(paragraphs)}


def _first_paragraph(documented_class: type) -> str:
    """First paragraph of a class's docstring."""
    return " ".join((getdoc(documented_class) or "").partition("\n\n")[0].split())


@app.command(cls=help_filled_by(_record_help_texts), epilog="{settings}")
def record(
    scenario: Annotated[
        str, typer.Argument(metavar="RIG", help="One of {references}, or a rig of your own: its rig.json.")
    ],
    out: Annotated[Path, typer.Option(help="The recording to write; the truth file is written beside it.")],
    plant: Annotated[
        str | None,
        typer.Option(
            help="Simulator: {plants}. By default ancf (Exudyn); modal, which is fast, where a body is a structure."
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Length of the record, s.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the force and of the sensors' noise.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="A setting, KEY=VALUE; repeat it for more. They are listed below.")
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="What the rig has but its description in the recording does not: NAME[:PARAMETER=VALUE,...]; "
            "repeat it for more. They are listed below."
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Simulate a reference rig, or your own, and record it.

    Example: rig record barrel_cradle --duration 60 --set noise_density=1e-3 --out barrel_cradle.mcap

    Example: rig record rig.json --duration 60 --set rms_n=20 --out own.mcap
    """
    from rig.effects import effect_named
    from rig.recording import truth_path
    from rig.simulation.own import UserRig, default_plant_name
    from rig.simulation.plants import PLANTS, plant_named
    from rig.simulation.record import record as record_rig

    setting_parts = [setting_text.partition("=") for setting_text in settings or []]
    for key, equals, _ in setting_parts:
        if not equals:
            raise typer.BadParameter(f"{key!r} is not KEY=VALUE", param_hint="--set")
    if plant not in {None, *PLANTS}:
        raise typer.BadParameter(f"{plant!r} is none of {', '.join(PLANTS)}", param_hint="--plant")
    setting_texts = {key: value for key, _, value in setting_parts}
    setting_texts |= {} if duration is None else {"duration_s": str(duration)}
    setting_texts |= {} if seed is None else {"seed": str(seed)}
    machine = _reference_or_user_rig(scenario, setting_texts)
    rig = machine.rig()
    excitation = machine.force()
    plant = plant or default_plant_name(rig)
    try:
        actual_rig = reduce(lambda modified_rig, text: effect_named(text).applied_to(modified_rig), effect or [], rig)
    except RigError as error:
        raise typer.BadParameter(str(error), param_hint="--effect") from error
    refuse_existing(out, force)
    check_file_ending(out, (".mcap",), "a recording")
    refuse_existing(truth_path(out), force)
    try:
        with progress_bar(f"recording {out.name} ({plant})") as progress:
            record_rig(
                rig,
                excitation,
                plant=plant_named(plant),
                duration_s=machine.duration_s,
                step_s=machine.step_s,
                path=out,
                progress=progress,
                actual=actual_rig,
            )
    except KeyboardInterrupt:
        if not out.exists():
            raise
        raise StoppedError(f"interrupted; {out} holds what was recorded until then") from None
    if as_json:
        print(json.dumps({"recording": str(out), "truth": str(truth_path(out)), **_force_level_json(machine)}))
    else:
        forces_phrase = "force" if len(rig.forces) == 1 else f"{len(rig.forces)} forces, each"
        force_words = f"{forces_phrase} {excitation.rms_n:g} N rms, {excitation.low_hz:g} to {excitation.high_hz:g} Hz"
        if rig.is_on_ground(rig.forces[0]):
            force_words = "no force, the base shakes"
        say(f"{out}: {machine.duration_s:g} s of {scenario} recorded by the plant {plant}, {force_words}")
        if isinstance(machine, UserRig):
            say(f"the force: {machine.level.rms_n:g} N rms, {machine.level.reason}")
            for warning in machine.warnings:
                say(f"warning: {warning}")
        say(f"{truth_path(out)}: what only a simulator knows")


def _force_level_json(machine: Reference | UserRig) -> dict[str, Any]:
    """Level of the force on a user's rig, why it was chosen and warnings, for JSON; empty for a reference rig."""
    from rig.simulation.own import UserRig

    if not isinstance(machine, UserRig):
        return {}
    return {"force": {"rms_n": machine.level.rms_n, "why": machine.level.reason, "warnings": machine.warnings}}


def _reference_or_user_rig(scenario: str, setting_texts: dict[str, str]) -> Reference | UserRig:
    """Reference rig by its name, or the rig in a JSON file.

    Raises typer.BadParameter for a wrong name or setting, RigError for a file that holds no rig.
    """
    from rig.model.description import read_rig
    from rig.simulation.own import user_rig
    from rig.simulation.reference import REFERENCES, reference

    is_file = Path(scenario).suffix == ".json"
    if not is_file and scenario not in REFERENCES:
        names, suggested_name = ", ".join(REFERENCES), hint(scenario, REFERENCES)
        raise typer.BadParameter(f"{scenario!r} is none of {names}, and no FILE.json{suggested_name}", param_hint="RIG")
    rig = read_rig(Path(scenario)) if is_file else None
    try:
        return reference(scenario, setting_texts) if rig is None else user_rig(rig, setting_texts)
    except RigError as error:
        raise typer.BadParameter(str(error), param_hint="--set") from error


@app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The recording, an .mcap file, or a rig.json.")],
    as_json: Json = False,
) -> None:
    """Print the content of a recording, or the rig that a rig.json describes.

    Example: rig info barrel_cradle.mcap
    """
    from rig.model.description import read_rig, to_json
    from rig.recording import read

    if file.suffix.lower() == ".json":
        described_rig = read_rig(file)
        if as_json:
            print(json.dumps({"rig": json.loads(to_json(described_rig))}))
            return
        count, rate_hz = len(described_rig.sensors), described_rig.sample_rate_hz
        say(f"{file}: rig {described_rig.name}, {count} sensor{'s' * (count != 1)} at {rate_hz:g} Hz")
        _print_rig(described_rig, [_sensor_table(described_rig)])
        return
    with progress_spinner(f"reading {file.name}"):
        recording = read(file)
    if as_json:
        print(json.dumps(_summary_json(recording)))
        return
    say(f"{file}: rig {recording.rig.name}, {recording.duration_s:g} s at {recording.rig.sample_rate_hz:g} Hz")
    channel_tables = [_channel_table(group_name, signals) for group_name, signals in recording.signals.items()]
    _print_rig(recording.rig, channel_tables)
    for key, value in recording.provenance.items():
        say(f"{key}: {value}")


def _print_rig(rig: Rig, channel_tables: Sequence[Table]) -> None:
    """Print tables of the bodies, of the contacts and of channels."""
    from rig.model.contact_laws import stop_positions_m_and_sides

    body_table = _empty_table("Bodies, with what holds them", "body", "kind", "first frequencies, Hz")
    for body in rig.bodies:
        frequency_texts = [f"{frequency_hz:.2f}" for frequency_hz in _first_frequencies_hz(rig, body)]
        body_table.add_row(body.name, body.kind, ", ".join(frequency_texts))
    is_believed = rig.tolerances is None or rig.tolerances.contacts_known
    belief_words = "as rig.json believes" if is_believed else "unknown: where rig.json starts"
    headings = ("contact", "at", "against", "clearance, mm", "stiffness, N/m")
    contact_table = _empty_table(f"Contacts, {belief_words}", *headings)
    for contact in rig.contacts:
        law, against_words = contact.law, "ground" if contact.against is None else _station_text(contact.against)
        clearance_words = (
            ", ".join(f"{1e3 * wall_m:+g}" for wall_m, _ in reversed(stop_positions_m_and_sides(law))) or "no stops"
        )
        if law.spatial:
            clearance_words = f"{1e3 * law.clearance_m:g} all around"
        stiffness_words = f"{law.stiffness_n_per_m:g}"
        contact_table.add_row(contact.name, _station_text(contact.at), against_words, clearance_words, stiffness_words)
    for content_table in (body_table, contact_table, *channel_tables):
        literal_console().print(content_table, "")


def _first_frequencies_hz(rig: Rig, body: Body) -> list[float]:
    """First natural frequencies in y of a body with its masses, springs, supports and clamp, its contacts open."""
    from rig.model.modes import mode_count, modes_of

    frequencies_hz = modes_of(rig, body).frequencies_hz(mode_count(body, FREQUENCY_COUNT + body.rigid_modes))
    elastic_hz = [float(frequency_hz) for frequency_hz in frequencies_hz if frequency_hz > LEAST_FREQUENCY_HZ]
    return elastic_hz[:FREQUENCY_COUNT]


@app.command()
def check(file: File, as_json: Json = False) -> None:
    """Read a whole recording and print whether it is sound.

    Example: rig check barrel_cradle.mcap
    """
    from rig.recording import read

    with progress_spinner(f"reading {file.name}"):
        recording = read(file)
    if as_json:
        print(json.dumps({"file": str(file), "sound": True, "samples": recording.samples}))
    else:
        channel_count = sum(len(signals.channels.names) for signals in recording.signals.values())
        say(f"{file}: sound, {channel_count} channels of {recording.samples} samples")


app.command()(view)
app.command()(demo)
app.command()(recover)
app.command("import", cls=help_filled_by(format_help_texts))(import_)
app.command("export", cls=help_filled_by(format_help_texts))(export_)
app.command()(draw)
app.command()(fmu)
app.command()(schema)
app.add_typer(init, name="init")


@app.command()
def doctor() -> None:
    """Print what is installed, and whether another package or program uses the name rig or identify."""
    raise typer.Exit(installation())


def _summary_json(recording: Recording) -> dict[str, Any]:
    from rig.model.description import to_json

    channels = []
    for group_name, signals in recording.signals.items():
        unit, stations = signals.channels.unit, map(msgspec.to_builtins, signals.channels.stations)
        for name, station, samples in zip(signals.channels.names, stations, signals.values, strict=True):
            channels.append({"group": group_name, "name": name, "station": station, "unit": unit, "rms": _rms(samples)})
    return {
        "rig": json.loads(to_json(recording.rig)),
        "duration_s": recording.duration_s,
        "sample_rate_hz": recording.rig.sample_rate_hz,
        "channels": channels,
        "provenance": dict(recording.provenance),
    }


def _channel_table(group_name: str, signals: Signals) -> Table:
    channels = signals.channels
    table = _empty_table(f"Channels: {group_name}", "channel", "at", f"rms, {channels.unit}")
    for channel_name, station, samples in zip(channels.names, channels.stations, signals.values, strict=True):
        table.add_row(channel_name, "" if station is None else _station_text(station), f"{_rms(samples):.4g}")
    return table


def _sensor_table(rig: Rig) -> Table:
    table = _empty_table("Sensors", "sensor", "at", "noise density, unit/√Hz")
    for sensor in rig.sensors:
        noise_text = f"{sensor.noise_density:g}" if sensor.noise_density else ""
        table.add_row(sensor.name, _station_text(sensor.station), noise_text)
    return table


def _empty_table(title: str, *headings: str) -> Table:
    """Empty table; the column of a heading with a comma, which names a unit, is aligned right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, show_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if "," in heading else "left")
    return table


def _station_text(station: Station) -> str:
    from rig.model.description import ON_GROUND

    direction_suffix = "" if station.direction == "y" else ", z"
    return station.body if station == ON_GROUND else f"{station.body} {station.position_m:g} m{direction_suffix}"


def _rms(samples: ndarray) -> float:
    return math.sqrt((samples**2).mean())


def main() -> None:
    run(app, "rig")
