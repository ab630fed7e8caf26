"""Bounds on untrusted files for every reader: memory, nesting, keys and the size of numbers.

A file of n bytes may take BASE_BYTES + BYTES_PER_FILE_BYTE * n of memory while it is read. What needs more is read in
pieces, or refused before it is decoded. Links from a file to another are never followed.
"""

import json
import math
from typing import Any, TypeVar

import msgspec

from rig.errors import RigError, TooLargeError

Result = TypeVar("Result")
BASE_BYTES = 300_000_000
BYTES_PER_FILE_BYTE = 8
MAX_JSON_BYTES = 16 * 1024 * 1024
"""Largest JSON text; decoded, it takes up to some 24 times its size."""
PROGRAM_BYTES = 130_000_000
"""Share of BASE_BYTES that the program takes before it reads anything."""
MAX_ITEMS = 100_000
"""Largest number of columns, datasets, elements of structs and cells, or segments in a file."""
MAX_DEPTH = 32
"""Deepest nesting of groups, structs, cells and keys."""
MAX_NAME_LENGTH = 1000
"""Longest name in a file, characters."""
SCHEMA_VERSION = 2
"""Version of the structure of rig.json, contact.json and gap.json that this program writes; it reads all up to it."""


def memory_bound_bytes(file_bytes: int) -> int:
    """Largest memory that reading a file of this size may take, bytes."""
    return BASE_BYTES + BYTES_PER_FILE_BYTE * file_bytes


def check_decoded_size(decoded_bytes: int | float, file_bytes: int, content: str) -> None:
    """Raise TooLargeError if `content` ("PATH: dataset 'x'"), once decoded, exceeds the bound of its file."""
    bound_bytes = memory_bound_bytes(file_bytes)
    if decoded_bytes > bound_bytes:
        raise TooLargeError(
            f"{content} would take {decoded_bytes / 1e6:.0f} MB of memory, and a file of {file_bytes / 1e6:.3g} MB may "
            f"take {bound_bytes / 1e6:.0f} MB; export it in parts, at a lower rate, or without compression"
        )


class MemoryCounter:
    """Count of the memory that a reader keeps of a file, checked against the bound of that file as it grows."""

    def __init__(self, file_bytes: int, content_label: str) -> None:
        self._file_bytes, self._content_label = file_bytes, content_label
        self._bound_bytes, self._held_bytes = memory_bound_bytes(file_bytes), 0

    def add(self, count_bytes: int) -> None:
        """Count these bytes; raise TooLargeError beyond the bound."""
        self._held_bytes += count_bytes
        if self._held_bytes > self._bound_bytes:
            check_decoded_size(self._held_bytes, self._file_bytes, self._content_label)


def check_json_size_and_keys(text: bytes, source_label: str) -> None:
    """Raise RigError if a JSON text is too large or an object in it has a key twice, of which one would be lost.

    Syntax errors are left to the decoder.
    """
    if len(text) > MAX_JSON_BYTES:
        raise RigError(f"{source_label}: has {len(text)} bytes; give at most {MAX_JSON_BYTES >> 20} MiB of JSON")
    try:
        json.loads(text, object_pairs_hook=dict_with_unique_keys, parse_int=len, parse_float=len)
    except RigError as error:
        raise RigError(f"{source_label}: {error}") from error
    except (ValueError, RecursionError):
        return


def dict_with_unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Object of these key-value pairs; raises RigError, without the name of the file, if a key occurs twice."""
    value_by_key: dict[str, Any] = {}
    for key, value in pairs:
        if key in value_by_key:
            raise RigError(f"the key {key!r} is given twice in one object; give it once")
        value_by_key[key] = value
    return value_by_key


MAX_NUMBER = 1e30
"""Largest number, in any unit: beyond any sensor, and a fourth power would overflow."""


def check_largest_number(decoded: Any, source: str) -> None:
    """Raise RigError, with its place, if a number in decoded JSON is beyond MAX_NUMBER."""
    pending_values: list[tuple[tuple[Any, ...], Any]] = [((), decoded)]
    while pending_values:
        path, value = pending_values.pop()
        if isinstance(value, dict):
            pending_values.extend(((path, f".{key}"), json_child) for key, json_child in value.items())
        elif isinstance(value, list):
            pending_values.extend(((path, f"[{index}]"), json_child) for index, json_child in enumerate(value))
        elif isinstance(value, int | float) and abs(value) > MAX_NUMBER:
            raise RigError(
                f"{source}: {_dotted_name(path)} is about 1e{math.log10(abs(value)):.0f}, which nothing is; correct it"
            )


def _dotted_name(key_chain: tuple[Any, ...]) -> str:
    """Name of a place as in `bodies[0].mass_kg`, from (parent, key) pairs."""
    keys = []
    while key_chain:
        key_chain, key = key_chain
        keys.append(key)
    return "".join(reversed(keys)).removeprefix(".")


def decoded_result(text: bytes, result_type: type[Result], source_label: str, file_name: str, advice: str) -> Result:
    """Result in a JSON text, as its type.

    Raises RigError with `source_label` and `advice` if it is no `file_name`, or of a later schema version.
    """
    try:
        check_schema_version(msgspec.json.decode(text), source_label)
        return msgspec.json.decode(text, type=result_type)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RigError(f"{source_label}: is no {file_name} ({error}); {advice}") from error


def check_schema_version(decoded: object, source: str) -> None:
    """Raise RigError if a decoded JSON file is of a later version than this program reads."""
    version = decoded.get("schema_version", SCHEMA_VERSION) if isinstance(decoded, dict) else SCHEMA_VERSION
    if version not in range(1, SCHEMA_VERSION + 1):
        raise RigError(
            f"{source}: schema_version is {version}, and this program reads 1 to {SCHEMA_VERSION}; install a later "
            "rig-identify, or describe the rig as this version does"
        )
