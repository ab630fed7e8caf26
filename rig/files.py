"""Files that are written whole or not at all: beside, on the disk, then renamed."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from rig.errors import RigError


def part_of(path: Path) -> Path:
    """Where a recording is written before it is renamed; raises RigError if either name is a symbolic link."""
    part = path.with_name(path.name + ".part")
    for place in (path, part):
        if place.is_symlink():
            raise RigError(f"{place}: is a symbolic link; name the file itself")
    return part


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A place beside, where the file is to be written; renamed to `path` once it is on the disk, removed if it fails.

    Each process has its own place: of two writers of one file, the last one's stands. Raises RigError if `path` is a
    symbolic link or cannot be written.
    """
    part = part_of(path).with_suffix(f".{os.getpid()}.part")
    try:
        yield part
        with part.open("rb+") as written:
            os.fsync(written.fileno())
        part.replace(path)
    except OSError as error:
        raise RigError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        with suppress(OSError):
            part.unlink()


def write_bytes(data: bytes, path: Path) -> None:
    """Raises RigError as `atomic_write` does."""
    with atomic_write(path) as part:
        part.write_bytes(data)


def write_json(value: object, path: Path) -> None:
    """What msgspec encodes, indented by two."""
    write_bytes(msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n", path)
