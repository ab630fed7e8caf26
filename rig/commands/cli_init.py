"""The command `rig init`: a first rig.json and import map, from options or from questions."""

import json
import re
import sys
from collections.abc import Callable, Mapping
from decimal import Decimal
from functools import partial
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import msgspec
import typer
from typer.main import get_group

from rig.commands.command_line import CommandApp, CommandGroup, Force, Json, progress_spinner, refuse_existing, say
from rig.model.decoding import explained

if TYPE_CHECKING:
    from rig.lab.starting import Start
else:
    Start = Any  # loaded with the kinds of rigs, when one is asked for

RigKind = type[Start]
Out = Annotated[Path, typer.Option(help="The folder for rig.json and map.toml; made if need be.")]
_EXAMPLES = {
    "mass": "--mass-kg 1 --frequency-hz 5 --clearance-m 1e-3 --stiffness-n-per-m 1e4 --sample-rate-hz 512 --out lab",
    "two_masses": "--masses-kg 1,2 --frequencies-hz 6,9 --stops upper --clearance-m 5e-4 --stiffness-n-per-m 2e4 "
    "--sample-rate-hz 1024 --quantity acceleration,displacement --out lab",
    "chain": "--masses-kg 6.5,6.5,6.5 --springs-n-per-m 5e5 --contacts 3-2 --stops upper --clearance-m 1e-4 "
    "--stiffness-n-per-m 1e6 --sample-rate-hz 1024 --quantity acceleration,displacement --out lab",
    "cantilever": "--length-m 0.5 --width-m 0.03 --thickness-m 0.005 --clearance-m 5e-4 --stiffness-n-per-m 5e4 "
    "--sample-rate-hz 4096 --out lab",
    "beams": "--cradle-length-m 1.2 --barrel-length-m 1.5 --overlap-start-m 0.5 ... --out lab",
    "structure": "--from-uff fin.uff --contacts-m 0.2 --force-m 0.5 --clearance-m 1e-4 ... --out lab",
    "measured": "--from-record level1.mat --force-column Force --columns 'Acceleration[1],Acceleration[2]' --unit "
    "m/s^2 --positions-m 0,0.5 --force-m 0 --sample-rate-hz 400 --out lab",
}


UNITS_BY_ENDING: dict[str, Mapping[str, str]] = {
    "_n_per_m": {"N/m": "1", "N/mm": "1e3", "N/um": "1e6", "kN/m": "1e3", "kN/mm": "1e6", "MN/m": "1e6"},
    "_n_s_per_m": {"Ns/m": "1", "Ns/mm": "1e3", "kNs/m": "1e3"},
    "_kg_per_m3": {"kg/m^3": "1", "g/cm^3": "1e3"},
    "_kg_m2": {"kgm^2": "1", "kgmm^2": "1e-6"},
    "_kg": {"kg": "1", "g": "1e-3", "t": "1e3"},
    "_hz": {"Hz": "1", "kHz": "1e3"},
    "_pa": {"Pa": "1", "MPa": "1e6", "GPa": "1e9"},
    "_m": {"m": "1", "cm": "1e-2", "mm": "1e-3", "um": "1e-6"},
}
"""SI value of each unit, by the end of an option's name."""
UNKNOWN_TEXTS = ("unknown", "?")
_NUMBER_WITH_UNIT = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?![eE][-+]?\d)([^\d\s.,].*)")
_PLAIN_UNIT = str.maketrans(
    {" ": "", "*": "", "\u00b7": "", "\u00b5": "u", "\u03bc": "u", "\u00b2": "^2", "\u00b3": "^3"}
)


class KindGroup(CommandGroup):
    """Group of one command for each kind of rig, made when one is asked for: the kinds are slow to import."""

    def list_commands(self, ctx: Any) -> list[str]:
        self._add_kinds()
        return super().list_commands(ctx)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        self._add_kinds()
        return super().get_command(ctx, cmd_name)

    def _add_kinds(self) -> None:
        if self.commands:
            return
        from rig.lab.starting import KINDS

        kinds_app = CommandApp()
        for kind_name, kind in KINDS.items():
            kinds_app.command(kind_name)(_kind_command(kind_name, kind))
        self.commands.update(get_group(kinds_app).commands)


init = CommandApp(cls=KindGroup, no_args_is_help=True)


@init.callback()
def _callback() -> None:
    """Write a first rig.json and an import map for a rig of your own.

    Numbers are in SI units, or say theirs: 0.5mm, 100N/mm. What you do not know of a contact, leave out.

    Example: rig init mass --help
    """


def _kind_command(kind_name: str, kind: RigKind) -> Callable[..., None]:
    """Command that starts one kind of rig, with an option for each field of the kind."""
    from rig.lab.starting import MAP_NAME, write_rig_and_map
    from rig.recording import RIG_NAME

    help_by_field = _help_by_field(kind)

    def command(out: Path, force: bool, as_json: bool, **text_by_field: str | None) -> None:
        refuse_existing(out / RIG_NAME, force, new_folder=True)
        keeps_map = (out / MAP_NAME).is_file() and not force
        if not keeps_map:
            refuse_existing(out / MAP_NAME, force, new_folder=True)
        rig_start = _start_from_texts(kind, help_by_field, {k: v for k, v in text_by_field.items() if v is not None})
        with progress_spinner(f"describing a rig of the kind {kind_name}"):
            rig, rig_notes = rig_start.rig_and_notes()
        rig_path, map_path = write_rig_and_map(rig, rig_start.map_text(rig), out, keeps_map)
        if keeps_map:
            rig_notes = (*rig_notes, f"{map_path}: was there and stays as it is")
        if as_json:
            print(json.dumps({"rig": str(rig_path), "map": str(map_path), "notes": rig_notes}))
            return
        for note in rig_notes:
            say(note)
        say(
            f"{rig_path}{'' if keeps_map else f', {map_path}'}: written; next: rig draw {rig_path}; name your file's "
            f"columns in {map_path.name}, then rig import FILE --map {map_path} --out FILE.mcap"
        )

    command.__doc__ = f"{kind.__doc__}\n\nExample: rig init {kind_name} {_EXAMPLES[kind_name]}"
    options: list[tuple[str, Any, Any]] = [
        (field.name, None, _option(field, help_by_field[field.name])) for field in _fields_in_order(kind)
    ]
    options += [("out", Path(), Out), ("force", False, Force), ("as_json", False, Json)]
    parameters = [Parameter(name, Parameter.KEYWORD_ONLY, default=d, annotation=a) for name, d, a in options]
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {name: annotation for name, _, annotation in options}
    return command


def _fields_in_order(kind: RigKind) -> list[msgspec.structs.FieldInfo]:
    """Fields of a kind in the order of the help: its own first, those of every rig last."""
    from rig.lab.starting import StartWithStops

    shared_field_names = [field.name for field in msgspec.structs.fields(StartWithStops)]
    return sorted(msgspec.structs.fields(kind), key=lambda field: field.name in shared_field_names)


def _help_by_field(kind: RigKind) -> dict[str, str]:
    help_by_field = {}
    for field_name, hint in get_type_hints(kind, include_extras=True).items():
        help_by_field[field_name] = next(m.description or "" for m in get_args(hint)[1:] if isinstance(m, msgspec.Meta))
    return help_by_field


def _option(field: msgspec.structs.FieldInfo, help_text: str) -> Any:
    default = field.default
    if field.required:
        help_text = f"{help_text} Needed."
    elif default not in (None, ()):
        default_text = ",".join(default) if isinstance(default, tuple) else default
        help_text = f"{help_text} Default: {default_text}."
    metavar_by_type_fragment = {
        "Path": "FILE",
        "Literal['both'": "both|upper|lower",
        "tuple[float": "NUMBER,...",
        "tuple[int": "NUMBER,...",
        "float": "NUMBER",
        "int": "NUMBER",
        "": "TEXT",
    }
    metavar = next(text for type_fragment, text in metavar_by_type_fragment.items() if type_fragment in str(field.type))
    option_name = f"--{field.name.replace('_', '-')}"
    return Annotated[str | None, typer.Option(option_name, help=help_text, metavar=metavar, show_default=False)]


def _start_from_texts(kind: RigKind, help_by_field: Mapping[str, str], text_by_field: Mapping[str, str]) -> Start:
    """Start from option texts; missing required fields are prompted for on a terminal.

    Raises typer.BadParameter without a terminal.
    """
    value_by_field = {field_name: _field_value(kind, field_name, text) for field_name, text in text_by_field.items()}
    missing_field_names = [f.name for f in _fields_in_order(kind) if f.required and f.name not in value_by_field]
    if missing_field_names and not sys.stdin.isatty():
        missing_options = ", ".join(f"--{field_name.replace('_', '-')}" for field_name in missing_field_names)
        raise typer.BadParameter(f"missing: {missing_options}")
    for field_name in missing_field_names:
        question = f"{field_name}: {help_by_field[field_name].rstrip('.')}"
        value_by_field[field_name] = typer.prompt(question, value_proc=partial(_field_value, kind, field_name))
    return kind(**value_by_field)


def _in_si(text: str, field_name: str) -> str:
    """Number in SI units from one that may have its unit behind it, of the quantity that a field's name ends in.

    Raises typer.BadParameter for another unit.
    """
    match = _NUMBER_WITH_UNIT.fullmatch(text.strip())
    if match is None:
        return text
    number_text, unit_text = match.groups()
    unit = unit_text.translate(_PLAIN_UNIT)
    units = next((units for ending, units in UNITS_BY_ENDING.items() if field_name.endswith(ending)), {})
    if unit not in units:
        known_words = f"one of {', '.join(units)}" if units else "none here"
        raise typer.BadParameter(
            f"{text!r} has the unit {unit_text!r}; give {known_words}", param_hint=f"--{field_name.replace('_', '-')}"
        )
    return str(Decimal(number_text) * Decimal(units[unit]))


def _field_value(kind: RigKind, field_name: str, text: str) -> Any:
    """Value of a field from its text (a list: separated by commas); raises typer.BadParameter if it does not fit."""
    field_type = get_type_hints(kind)[field_name]
    if text.strip() in UNKNOWN_TEXTS and type(None) in get_args(field_type):
        return None
    if "float" in str(field_type):
        text = ",".join(_in_si(number_text, field_name) for number_text in text.split(","))
    raw_value = text.split(",") if "tuple" in str(field_type) else text
    try:
        return msgspec.convert(raw_value, field_type, strict=False, dec_hook=lambda path_type, value: path_type(value))
    except msgspec.ValidationError as error:
        reason = explained(error, raw_value, field_type)
        raise typer.BadParameter(
            f"{text!r} does not fit: {reason}", param_hint=f"--{field_name.replace('_', '-')}"
        ) from error
