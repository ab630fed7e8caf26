"""Library of unmodelled effects, one file each, which are found by themselves (what else one needs: CONTRIBUTING)."""

import msgspec

from rig.effects.base import Effect
from rig.errors import RigError, hint
from rig.model.decoding import explained
from rig.registry import subclasses


def effects() -> dict[str, type[Effect]]:
    """Every effect by its name, in alphabetical order."""
    return {
        effect_type.name: effect_type
        for effect_type in sorted(subclasses(__path__, __name__, Effect), key=lambda effect_type: effect_type.name)
    }


def effect_named(text: str) -> Effect:
    """The effect that a text NAME or NAME:PARAMETER=VALUE,... asks for; what is left out has its default.

    Raises RigError for an unknown name or parameter and for a value that does not fit.
    """
    effect_name, _, assignments = text.partition(":")
    effect_types = effects()
    if effect_name not in effect_types:
        raise RigError(
            f"no effect {effect_name!r}{hint(effect_name, effect_types)}; there are {', '.join(effect_types)}"
        )
    effect_type, value_texts = effect_types[effect_name], {}
    for assignment in assignments.split(",") if assignments else []:
        parameter_name, equals, value_text = assignment.partition("=")
        if not equals:
            raise RigError(f"effect {effect_name}: {assignment!r} is not PARAMETER=VALUE")
        if parameter_name not in effect_type.__struct_fields__:
            parameter_names = effect_type.__struct_fields__
            raise RigError(
                f"effect {effect_name} has no parameter {parameter_name!r}{hint(parameter_name, parameter_names)}; it "
                f"has {', '.join(parameter_names)}"
            )
        value_texts[parameter_name] = value_text
    try:
        return msgspec.convert(value_texts, effect_type, strict=False)
    except msgspec.ValidationError as error:
        raise RigError(f"effect {effect_name}: {explained(error, value_texts, effect_type)}") from error
