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


def converted(decoded: Any, kind: type[T], source: str) -> T:
    """Decoded JSON or TOML as a type.

    Raises RigError with `source` and the explained reason if it does not fit.
    """
    try:
        return msgspec.convert(decoded, kind)
    except msgspec.ValidationError as error:
        raise RigError(f"{source}: {explained(error, decoded, kind)}") from error


def explained(error: msgspec.ValidationError, decoded: Any, kind: Any) -> str:
    """Sentence on a type error in decoded values: place, fault, allowed values, nearest name."""
    matched = _PLACE.fullmatch(str(error))
    text, path = matched.groups() if matched else (str(error), "")
    place = path.removeprefix(".").replace("[...]", "")
    if isinstance(error.__cause__, RigError):
        return f"{error.__cause__}" + (f" (at {place})" if place else "")
    info, value = _type_and_value_at(inspect.type_info(kind), decoded, path)
    quoted = _QUOTED.findall(text)
    if text.startswith("Invalid ") and (allowed := _values(info)):
        return f"{place or 'it'} is {value!r}{nearest(value, allowed)}; give {_comma_separated(allowed)}"
    if text.startswith("Object "):
        return _about_fields(_owner(place, info), info, text, quoted[0])
    if text.startswith("Expected ") and len(quoted) == 2:
        expected, given_value = (" or ".join(_WORDS.get(word, word) for word in side.split(" | ")) for side in quoted)
        return f"{place or 'it'} is {given_value}; give {expected}"
    return f"{place}: {text}" if place else text


def _about_fields(owner: str, info: Any, text: str, field: str) -> str:
    """Sentence on an unknown or a missing field of an object."""
    fields, tags = _fields(info), _tags(info)
    if "unknown" in text:
        return f"{owner} has no field {field!r}{nearest(field, fields)}; it has {', '.join([*tags, *fields])}"
    if field in tags:
        return f"{owner} lacks {field!r}; give {_comma_separated(tags[field])}"
    return f"{owner} lacks {field!r}; it needs {', '.join(_fields(info, required=True))}"


def nearest(word: Any, candidates: Iterable[str]) -> str:
    """Suggestion as `rig.errors.hint` gives it, also for a word that other programs use."""
    names = [str(candidate) for candidate in candidates]
    synonym = SYNONYMS.get(str(word).lower(), "")
    return f" (did you mean {synonym!r}?)" if synonym in names else hint(str(word), names)


def _owner(place: str, info: Any) -> str:
    kind = f"the {info.tag}" if isinstance(info, inspect.StructType) and info.tag else ""
    return f"{kind} {place}".strip() or "it"


def _type_and_value_at(info: Any, value: Any, path: str) -> tuple[Any, Any]:
    """Type and value at a path as msgspec writes it, such as .bodies[0].ends."""
    for key, number in _STEP.findall(path):
        info = _union_member(info, value)
        if key and key in _tags(info):
            return _Tags(_tags(info)[key]), value.get(key)
        if isinstance(info, inspect.StructType):
            info = next(f.type for f in info.fields if f.encode_name == key)
            value = value.get(key)
        elif isinstance(info, inspect.DictType):
            info, value = info.value_type, next(iter(value.values()), None)
        else:
            info, value = _item(info, number), value[int(number)]
    return _union_member(info, value), value


class _Tags(msgspec.Struct, frozen=True):
    """Allowed values of a tag, in place of a type."""

    values: tuple[str, ...]


def _item(info: Any, number: str) -> Any:
    return info.item_types[int(number)] if isinstance(info, inspect.TupleType) else info.item_type


def _union_member(info: Any, value: Any) -> Any:
    """Member of a union to which a value belongs; the union itself if neither tag nor kind decides."""
    if not isinstance(info, inspect.UnionType):
        return info
    structs = [t for t in info.types if isinstance(t, inspect.StructType)]
    if isinstance(value, dict):
        tagged = [t for t in structs if t.tag_field and value.get(t.tag_field) == t.tag]
        return next(iter(tagged or structs[:1]), info) if tagged or len(structs) == 1 else info
    if isinstance(value, list):
        lists = (inspect.VarTupleType, inspect.TupleType, inspect.ListType)
        return next((t for t in info.types if isinstance(t, lists)), info)
    return next((t for t in info.types if isinstance(t, inspect.LiteralType)), info)


def _tags(info: Any) -> dict[str, tuple[str, ...]]:
    """Allowed tags of a union of structs, or of a struct, by the name of their field."""
    types = info.types if isinstance(info, inspect.UnionType) else (info,)
    tagged = [t for t in types if isinstance(t, inspect.StructType) and t.tag_field]
    return {tagged[0].tag_field: tuple(str(t.tag) for t in tagged)} if tagged else {}  # type: ignore[dict-item]


def _values(info: Any) -> tuple[str, ...]:
    return tuple(str(v) for v in info.values) if isinstance(info, inspect.LiteralType | _Tags) else ()


def _fields(info: Any, required: bool = False) -> tuple[str, ...]:
    fields = info.fields if isinstance(info, inspect.StructType) else ()
    return tuple(f.encode_name for f in fields if f.required or not required)


def _comma_separated(words: Iterable[str]) -> str:
    return " or ".join(repr(w) for w in words)
