"""Decoded JSON or TOML as a type; an error says at which place, what is allowed there, and which name is nearest."""

import re
from collections.abc import Iterable
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from rig.errors import RigError, hint

T = TypeVar("T")
SYNONYMS = {
    "cantilever": "clamped-free",
    "clamped": "clamped-free",
    "fixed-free": "clamped-free",
    "free": "free-free",
    "mass": "oscillator",
    "modal": "structure",
    "accelerometer": "acceleration",
    "strain gauge": "strain",
}
"""Other programs' words for values of rig.json."""
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "an object",
    "null": "null",
}
_PLACE_PATTERN = re.compile(r"(?s)(.*) - at `\$(.*)`$")
_PATH_STEP_PATTERN = re.compile(r"\.([^.\[\]]+)|\[(\d+|\.\.\.)\]")
_QUOTED_PATTERN = re.compile(r"[`']([^`']*)[`']")


def converted(decoded: Any, target_type: type[T], source_label: str) -> T:
    """Decoded JSON or TOML as a type.

    Raises RigError with `source_label` and the explained reason if it does not fit.
    """
    try:
        return msgspec.convert(decoded, target_type)
    except msgspec.ValidationError as error:
        raise RigError(f"{source_label}: {explained(error, decoded, target_type)}") from error


def explained(error: msgspec.ValidationError, decoded: Any, target_type: Any) -> str:
    """Sentence on a type error in decoded values: place, fault, allowed values, nearest name."""
    place_match = _PLACE_PATTERN.fullmatch(str(error))
    message, json_path = place_match.groups() if place_match else (str(error), "")
    json_place = json_path.removeprefix(".").replace("[...]", "")
    if isinstance(error.__cause__, RigError):
        return f"{error.__cause__}" + (f" (at {json_place})" if json_place else "")
    expected_type, json_value = _type_and_value_at(inspect.type_info(target_type), decoded, json_path)
    quoted_words = _QUOTED_PATTERN.findall(message)
    if message.startswith("Invalid ") and (choices := _allowed_values(expected_type)):
        return f"{json_place or 'it'} is {json_value!r}{nearest(json_value, choices)}; give {_comma_separated(choices)}"
    if message.startswith("Object "):
        return _field_sentence(_object_label(json_place, expected_type), expected_type, message, quoted_words[0])
    if message.startswith("Expected ") and len(quoted_words) == 2:
        expected_words, given_words = (
            " or ".join(_WORDS.get(word, word) for word in quoted_types.split(" | ")) for quoted_types in quoted_words
        )
        return f"{json_place or 'it'} is {given_words}; give {expected_words}"
    return f"{json_place}: {message}" if json_place else message


def _field_sentence(label: str, type_info: Any, message: str, field_name: str) -> str:
    """Sentence on an unknown or a missing field of an object."""
    known, tags = _field_names(type_info), _tags_by_field(type_info)
    if "unknown" in message:
        return f"{label} has no field {field_name!r}{nearest(field_name, known)}; it has {', '.join([*tags, *known])}"
    if field_name in tags:
        return f"{label} lacks {field_name!r}; give {_comma_separated(tags[field_name])}"
    return f"{label} lacks {field_name!r}; it needs {', '.join(_field_names(type_info, required_only=True))}"


def nearest(word: Any, candidates: Iterable[str]) -> str:
    """Suggestion as `rig.errors.hint` gives it, also for a word that other programs use."""
    candidate_names = [str(candidate) for candidate in candidates]
    synonym = SYNONYMS.get(str(word).lower(), "")
    return f" (did you mean {synonym!r}?)" if synonym in candidate_names else hint(str(word), candidate_names)


def _object_label(json_place: str, type_info: Any) -> str:
    tag_label = f"the {type_info.tag}" if isinstance(type_info, inspect.StructType) and type_info.tag else ""
    return f"{tag_label} {json_place}".strip() or "it"


def _type_and_value_at(type_info: Any, value: Any, json_path: str) -> tuple[Any, Any]:
    """Type and value at a path as msgspec writes it, such as .bodies[0].ends."""
    for key, index_text in _PATH_STEP_PATTERN.findall(json_path):
        type_info = _union_member(type_info, value)
        if key and key in _tags_by_field(type_info):
            return _AllowedTags(_tags_by_field(type_info)[key]), value.get(key)
        if isinstance(type_info, inspect.StructType):
            type_info = next(field.type for field in type_info.fields if field.encode_name == key)
            value = value.get(key)
        elif isinstance(type_info, inspect.DictType):
            type_info, value = type_info.value_type, next(iter(value.values()), None)
        else:
            type_info, value = _item_type(type_info, index_text), value[int(index_text)]
    return _union_member(type_info, value), value


class _AllowedTags(msgspec.Struct, frozen=True):
    """Allowed values of a tag, in place of a type."""

    values: tuple[str, ...]


def _item_type(type_info: Any, index_text: str) -> Any:
    return type_info.item_types[int(index_text)] if isinstance(type_info, inspect.TupleType) else type_info.item_type


def _union_member(type_info: Any, value: Any) -> Any:
    """Member of a union to which a value belongs; the union itself if neither tag nor kind decides."""
    if not isinstance(type_info, inspect.UnionType):
        return type_info
    struct_types = [member for member in type_info.types if isinstance(member, inspect.StructType)]
    if isinstance(value, dict):
        matching_types = [
            member for member in struct_types if member.tag_field and value.get(member.tag_field) == member.tag
        ]
        return (
            next(iter(matching_types or struct_types[:1]), type_info)
            if matching_types or len(struct_types) == 1
            else type_info
        )
    if isinstance(value, list):
        list_types = (inspect.VarTupleType, inspect.TupleType, inspect.ListType)
        return next((member for member in type_info.types if isinstance(member, list_types)), type_info)
    return next((member for member in type_info.types if isinstance(member, inspect.LiteralType)), type_info)


def _tags_by_field(type_info: Any) -> dict[str, tuple[str, ...]]:
    """Allowed tags of a union of structs, or of a struct, by the name of their field."""
    member_types = type_info.types if isinstance(type_info, inspect.UnionType) else (type_info,)
    tagged_types = [member for member in member_types if isinstance(member, inspect.StructType) and member.tag_field]
    return {tagged_types[0].tag_field: tuple(str(member.tag) for member in tagged_types)} if tagged_types else {}  # type: ignore[dict-item]


def _allowed_values(type_info: Any) -> tuple[str, ...]:
    return tuple(str(v) for v in type_info.values) if isinstance(type_info, inspect.LiteralType | _AllowedTags) else ()


def _field_names(type_info: Any, required_only: bool = False) -> tuple[str, ...]:
    struct_fields = type_info.fields if isinstance(type_info, inspect.StructType) else ()
    return tuple(field.encode_name for field in struct_fields if field.required or not required_only)


def _comma_separated(words: Iterable[str]) -> str:
    return " or ".join(repr(word) for word in words)
