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
_PLACE = re.compile(r"(?s)(.*) - at `\$(.*)`$")
_STEP = re.compile(r"\.([^.\[\]]+)|\[(\d+|\.\.\.)\]")
_QUOTED = re.compile(r"[`']([^`']*)[`']")


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
    place_match = _PLACE.fullmatch(str(error))
    text, path = place_match.groups() if place_match else (str(error), "")
    place = path.removeprefix(".").replace("[...]", "")
    if isinstance(error.__cause__, RigError):
        return f"{error.__cause__}" + (f" (at {place})" if place else "")
    expected_type, value = _type_and_value_at(inspect.type_info(target_type), decoded, path)
    quoted_words = _QUOTED.findall(text)
    if text.startswith("Invalid ") and (allowed := _values(expected_type)):
        return f"{place or 'it'} is {value!r}{nearest(value, allowed)}; give {_comma_separated(allowed)}"
    if text.startswith("Object "):
        return _about_fields(_owner(place, expected_type), expected_type, text, quoted_words[0])
    if text.startswith("Expected ") and len(quoted_words) == 2:
        expected, given_value = (
            " or ".join(_WORDS.get(word, word) for word in quoted_types.split(" | ")) for quoted_types in quoted_words
        )
        return f"{place or 'it'} is {given_value}; give {expected}"
    return f"{place}: {text}" if place else text


def _about_fields(owner: str, type_info: Any, text: str, field: str) -> str:
    """Sentence on an unknown or a missing field of an object."""
    fields, tags = _fields(type_info), _tags(type_info)
    if "unknown" in text:
        return f"{owner} has no field {field!r}{nearest(field, fields)}; it has {', '.join([*tags, *fields])}"
    if field in tags:
        return f"{owner} lacks {field!r}; give {_comma_separated(tags[field])}"
    return f"{owner} lacks {field!r}; it needs {', '.join(_fields(type_info, required=True))}"


def nearest(word: Any, candidates: Iterable[str]) -> str:
    """Suggestion as `rig.errors.hint` gives it, also for a word that other programs use."""
    names = [str(candidate) for candidate in candidates]
    synonym = SYNONYMS.get(str(word).lower(), "")
    return f" (did you mean {synonym!r}?)" if synonym in names else hint(str(word), names)


def _owner(place: str, type_info: Any) -> str:
    kind = f"the {type_info.tag}" if isinstance(type_info, inspect.StructType) and type_info.tag else ""
    return f"{kind} {place}".strip() or "it"


def _type_and_value_at(type_info: Any, value: Any, path: str) -> tuple[Any, Any]:
    """Type and value at a path as msgspec writes it, such as .bodies[0].ends."""
    for key, number in _STEP.findall(path):
        type_info = _union_member(type_info, value)
        if key and key in _tags(type_info):
            return _Tags(_tags(type_info)[key]), value.get(key)
        if isinstance(type_info, inspect.StructType):
            type_info = next(field.type for field in type_info.fields if field.encode_name == key)
            value = value.get(key)
        elif isinstance(type_info, inspect.DictType):
            type_info, value = type_info.value_type, next(iter(value.values()), None)
        else:
            type_info, value = _item(type_info, number), value[int(number)]
    return _union_member(type_info, value), value


class _Tags(msgspec.Struct, frozen=True):
    """Allowed values of a tag, in place of a type."""

    values: tuple[str, ...]


def _item(type_info: Any, number: str) -> Any:
    return type_info.item_types[int(number)] if isinstance(type_info, inspect.TupleType) else type_info.item_type


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


def _tags(type_info: Any) -> dict[str, tuple[str, ...]]:
    """Allowed tags of a union of structs, or of a struct, by the name of their field."""
    member_types = type_info.types if isinstance(type_info, inspect.UnionType) else (type_info,)
    tagged_types = [member for member in member_types if isinstance(member, inspect.StructType) and member.tag_field]
    return {tagged_types[0].tag_field: tuple(str(member.tag) for member in tagged_types)} if tagged_types else {}  # type: ignore[dict-item]


def _values(type_info: Any) -> tuple[str, ...]:
    return tuple(str(v) for v in type_info.values) if isinstance(type_info, inspect.LiteralType | _Tags) else ()


def _fields(type_info: Any, required: bool = False) -> tuple[str, ...]:
    fields = type_info.fields if isinstance(type_info, inspect.StructType) else ()
    return tuple(field.encode_name for field in fields if field.required or not required)


def _comma_separated(words: Iterable[str]) -> str:
    return " or ".join(repr(w) for w in words)
