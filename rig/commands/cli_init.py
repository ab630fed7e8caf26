"""The command `rig init`: a first rig.json and import map, from options or from questions."""

import json
import sys
from collections.abc import Callable, Mapping
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
    """Write a first rig.json and an import map for a rig of your own. All numbers are in SI units.

    Example: rig init mass --help
    """


def _kind_command(kind_name: str, kind: RigKind) -> Callable[..., None]:
    """Command that starts one kind of rig, with an option for each field of the kind."""
    from rig.lab.starting import MAP_NAME, write_rig_and_map
    from rig.recording import RIG_NAME

    help_by_field = _help_by_field(kind)

    def command(out: Path, force: bool, as_json: bool, **text_by_field: str | None) -> None:
        for target_path in (out / RIG_NAME, out / MAP_NAME):
            refuse_existing(target_path, force, new_folder=True)
        rig_start = _start_from_texts(kind, help_by_field, {k: v for k, v in text_by_field.items() if v is not None})
        with progress_spinner(f"describing a rig of the kind {kind_name}"):
            rig, rig_notes = rig_start.rig_and_notes()
        written_paths = write_rig_and_map(rig, rig_start.map_text(rig), out)
        if as_json:
            print(json.dumps({"rig": str(written_paths[0]), "map": str(written_paths[1]), "notes": rig_notes}))
            return
        for note in rig_notes:
            say(note)
        say(
            f"{', '.join(map(str, written_paths))}: written; next: rig draw {written_paths[0]}; name your file's "
            f"columns in {written_paths[1].name}, then rig import FILE --map {written_paths[1]} --out FILE.mcap"
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


def _field_value(kind: RigKind, field_name: str, text: str) -> Any:
    """Value of a field from its text (a list: separated by commas); raises typer.BadParameter if it does not fit."""
    field_type = get_type_hints(kind)[field_name]
    raw_value = text.split(",") if "tuple" in str(field_type) else text
    try:
        return msgspec.convert(raw_value, field_type, strict=False, dec_hook=lambda path_type, value: path_type(value))
    except msgspec.ValidationError as error:
        reason = explained(error, raw_value, field_type)
        raise typer.BadParameter(
            f"{text!r} does not fit: {reason}", param_hint=f"--{field_name.replace('_', '-')}"
        ) from error
