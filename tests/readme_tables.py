"""The tables of READMEs that follow from the code. `python -m tests.readme_tables` writes them; a test compares."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from identify.contacts.refusals import CAUSES, REMEDIES
from rig.effects import effects
from rig.effects.base import Effect, parameters_of
from rig.model.beam import Beam
from rig.model.contact_laws import LAWS
from rig.model.description import (
    BaseMotion,
    Clamp,
    Contact,
    ForceSensor,
    PointDamper,
    PointMass,
    PointSpring,
    Rig,
    Sensor,
    StaticLoad,
    Station,
    Support,
    Tone,
)
from rig.model.oscillator import Oscillator
from rig.model.quantities import QUANTITIES
from rig.model.structure import ShapeRow, Structure

ROOT = Path(__file__).parents[1]
OBJECTS: dict[str, type[msgspec.Struct]] = {
    "the rig": Rig,
    "bodies, `type` beam": Beam,
    "bodies, `type` oscillator": Oscillator,
    "bodies, `type` structure": Structure,
    "shapes of a structure": ShapeRow,
    "contacts": Contact,
    **{
        f"law of a contact, `type` {name}{' (also where none is given)' * (name == 'dead_zone')}": law
        for name, law in LAWS.items()
    },
    "sensors": Sensor,
    "station, force_at (or a list of them, where several measured forces act at once), at, against": Station,
    "masses": PointMass,
    "springs": PointSpring,
    "supports": Support,
    "dampers": PointDamper,
    "clamps": Clamp,
    "loads": StaticLoad,
    "tones": Tone,
    "base_motion": BaseMotion,
    "force_sensor": ForceSensor,
}
PLACES = ("contact", "body", "beam", "sensor")


def by_place() -> list[type[Effect]]:
    """The effects: of contacts, of bodies, of beams, of sensors, of all else; by name among each."""
    where = {k: next((i for i, p in enumerate(PLACES) if p in k.__struct_fields__), 9) for k in effects().values()}
    return sorted(where, key=lambda kind: (where[kind], kind.name))


def ranged_by_rig(kind: type[Effect]) -> bool:
    return kind.parameters.__func__ is not Effect.parameters.__func__


def effect_rows() -> Iterator[str]:
    for kind in by_place():
        first, default = (f"`{kind.name}`", str(kind.__doc__)), kind()
        for about in parameters_of(kind):
            by_rig = ranged_by_rig(kind) and about.name != "relative_position"
            low_high = "set by the rig" if by_rig else f"{about.low:g} to {about.high:g}"
            cells = (*first, f"`{about.name}`", about.unit, f"{getattr(default, about.name):g}", low_high)
            yield f"| {' | '.join(cells)} |"
            first = ("", "")


def range_lines() -> Iterator[str]:
    for kind in filter(ranged_by_rig, by_place()):
        says = str(kind.parameters.__doc__).splitlines()[0]
        yield f"- `{kind.name}`: {says[0].lower()}{says[1:]}"


def field_rows() -> Iterator[str]:
    for name, kind in OBJECTS.items():
        yield f"| {name} | {', '.join(map(field_text, msgspec.structs.fields(kind)))} |"


def field_text(field: msgspec.structs.FieldInfo) -> str:
    """Its name, with its default where it has one."""
    if field.required:
        return f"`{field.encode_name}`"
    default = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    if isinstance(default, bool | str):
        return f"`{field.encode_name}` ({str(default).lower()})"
    text = "none" if default in (None, ()) else "as below" if isinstance(default, msgspec.Struct) else f"{default:g}"
    return f"`{field.encode_name}` ({text})"


def quantity_rows() -> Iterator[str]:
    for name, quantity in QUANTITIES.items():
        yield f"| `{name}` | {quantity.unit} | {', '.join(quantity.units)} | {'yes' if quantity.translates else 'no'} |"


def refusal_rows() -> Iterator[str]:
    for code, (cause, remedy) in CAUSES.items():
        yield f"| `{code}` | {re.sub(r'{[^}]*}', '…', cause)} | {REMEDIES[remedy]} |"


TABLES: tuple[tuple[str, str, Callable[[], Iterator[str]]], ...] = (
    ("rig/effects/README.md", "|---|---|---|---|---|---|", effect_rows),
    ("rig/effects/README.md", "Ranges set by the rig:\n", range_lines),
    ("rig/recording/README.md", "|---|---|", field_rows),
    ("rig/model/README.md", "|---|---|---|---|", quantity_rows),
    ("identify/REFUSALS.md", "| code | cause | what to do |\n|---|---|---|", refusal_rows),
)
"""The README, the line above the rows (of which the README has one), and the rows."""


def written(text: str, above: str, rows: Callable[[], Iterator[str]]) -> str:
    """The text with these rows: they end at an empty line."""
    before, _, after = text.partition(f"\n{above}\n")
    kept = after.partition("\n\n")[2]
    return f"{before}\n{above}\n{chr(10).join(rows())}\n\n{kept}"


if __name__ == "__main__":
    for readme, above, rows in TABLES:
        text = (ROOT / readme).read_text(encoding="utf-8")
        (ROOT / readme).write_text(written(text, above, rows), encoding="utf-8")
