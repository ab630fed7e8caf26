"""Library of unmodelled effects, one file each, which are found by themselves (what else one needs: CONTRIBUTING)."""

import msgspec

from rig.effects.base import Effect
from rig.errors import RigError, meant
from rig.model.decoding import explained
from rig.registry import subclasses


def effects() -> dict[str, type[Effect]]:
    """Every effect by its name, in alphabetical order."""
    return {kind.name: kind for kind in sorted(subclasses(__path__, __name__, Effect), key=lambda kind: kind.name)}


def effect_named(text: str) -> Effect:
    """The effect that a text NAME or NAME:PARAMETER=VALUE,... asks for; what is left out has its default.

    Raises RigError for an unknown name or parameter and for a value that does not fit.
    """
    name, _, assignments = text.partition(":")
    kinds = effects()
    if name not in kinds:
        raise RigError(f"no effect {name!r}{meant(name, kinds)}; there are {', '.join(kinds)}")
    kind, values = kinds[name], {}
    for assignment in assignments.split(",") if assignments else []:
        parameter, equals, value = assignment.partition("=")
        if not equals:
            raise RigError(f"effect {name}: {assignment!r} is not PARAMETER=VALUE")
        if parameter not in kind.__struct_fields__:
            names = kind.__struct_fields__
            raise RigError(
                f"effect {name} has no parameter {parameter!r}{meant(parameter, names)}; it has {', '.join(names)}"
            )
        values[parameter] = value
    try:
        return msgspec.convert(values, kind, strict=False)
    except msgspec.ValidationError as error:
        raise RigError(f"effect {name}: {explained(error, values, kind)}") from error
