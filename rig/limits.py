"""Bounds on what an untrusted file may cost, for every reader: memory, nesting and keys.

A file of n bytes may take BASE_BYTES + BYTES_PER_FILE_BYTE * n of memory while it is read. What needs more is read in
pieces, or refused before it is decoded. Links from a file to another are never followed.
"""

import json
from typing import Any

from rig.errors import RigError, TooLargeError

BASE_BYTES = 300_000_000
BYTES_PER_FILE_BYTE = 8
MAX_JSON_BYTES = 16 * 1024 * 1024
"""Decoded, a text of JSON takes up to some 24 times its size."""
PROGRAM_BYTES = 130_000_000
"""Of BASE_BYTES, what the program takes before it reads anything."""
MAX_ITEMS = 100_000
"""Columns, datasets, elements of structs and cells, or segments that a file may list."""
MAX_DEPTH = 32
"""How deep groups, structs, cells and keys may be nested."""
MAX_NAME = 1000
"""Characters of one name in a file."""


def memory_bound_bytes(file_bytes: int) -> int:
    """Memory that reading a file of so many bytes may take."""
    return BASE_BYTES + BYTES_PER_FILE_BYTE * file_bytes


def check_decoded_size(decoded_bytes: int | float, file_bytes: int, content: str) -> None:
    """Raise TooLargeError if `content` ("PATH: dataset 'x'"), once decoded, exceeds the bound of its file."""
    bound = memory_bound_bytes(file_bytes)
    if decoded_bytes > bound:
        raise TooLargeError(
            f"{content} would take {decoded_bytes / 1e6:.0f} MB of memory, and a file of {file_bytes / 1e6:.3g} MB may "
            f"take {bound / 1e6:.0f} MB; export it in parts, at a lower rate, or without compression"
        )


class Held:
    """Memory that a reader takes for what it keeps of a file, counted as it grows against the bound of the file."""

    def __init__(self, file_bytes: int, content: str) -> None:
        self._file_bytes, self._content = file_bytes, content
        self._bound_bytes, self._held_bytes = memory_bound_bytes(file_bytes), 0

    def add(self, count_bytes: int) -> None:
        """Raise TooLargeError beyond the bound."""
        self._held_bytes += count_bytes
        if self._held_bytes > self._bound_bytes:
            check_decoded_size(self._held_bytes, self._file_bytes, self._content)


def check_json(text: bytes, source: str) -> None:
    """Raise RigError if a text of JSON is too large, or an object in it gives a key twice, of which one would be lost.

    Whether it is JSON at all is for its decoder to say.
    """
    if len(text) > MAX_JSON_BYTES:
        raise RigError(f"{source}: has {len(text)} bytes; give at most {MAX_JSON_BYTES >> 20} MiB of JSON")
    try:
        json.loads(text, object_pairs_hook=unique_keys, parse_int=len, parse_float=len)
    except RigError as error:
        raise RigError(f"{source}: {error}") from error
    except (ValueError, RecursionError):
        return


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object of these pairs; raises RigError, without the name of the file, if a key is given twice."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise RigError(f"the key {key!r} is given twice in one object; give it once")
        found[key] = value
    return found
