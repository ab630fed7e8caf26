"""Bounds on what an untrusted file may cost, for every reader: memory, nesting and keys.

A file of n bytes may take BASE_BYTES + BYTES_PER_FILE_BYTE * n of memory while it is read. What needs more is read in
pieces, or refused before it is decoded. Links from a file to another are never followed.
"""

from rig.errors import RigError

BASE_BYTES = 300_000_000
BYTES_PER_FILE_BYTE = 8
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
    """Raise RigError if `content` ("PATH: dataset 'x'"), once decoded, exceeds the bound of its file."""
    bound = memory_bound_bytes(file_bytes)
    if decoded_bytes > bound:
        raise RigError(
            f"{content} would take {decoded_bytes / 1e6:.0f} MB of memory, and a file of {file_bytes / 1e6:.3g} MB may "
            f"take {bound / 1e6:.0f} MB; export it in parts, at a lower rate, or without compression"
        )
