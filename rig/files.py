"""Files: what is read is a file and no device; what is written is whole or not there: beside, on the disk, renamed."""

import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from rig.errors import RigError, is_plain

try:
    import fcntl
except ImportError:  # Windows, where one writer keeps another from opening the file
    fcntl = None  # type: ignore[assignment]

LONGEST_NAME_BYTES = 255
MOST_BYTES = 256 * 1024 * 1024
"""Of a file that is read in one piece: a map, a description, a report."""
WAIT_S = 30.0
"""How long a small file waits for another writer of it; a recording does not."""


def check_source(path: Path) -> None:
    """Raises RigError if there is no regular file: a device or a pipe may never end."""
    _check_name(path)
    try:
        regular = path.is_file()
        if not regular:
            path.open("rb").close() if path.is_dir() else path.stat()
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror}); check the name") from error
    if not regular:
        raise RigError(f"{path}: is a device, a pipe or the like; give a file")


def contents(path: Path) -> bytes:
    """All of a file; raises RigError if there is none, it is no regular file or larger than MOST_BYTES."""
    check_source(path)
    try:
        if path.stat().st_size > MOST_BYTES:
            raise RigError(f"{path}: has more than {MOST_BYTES >> 20} MiB; this is not the file that is asked for")
        return path.read_bytes()
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); check the file") from error


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_target(path: Path, *sources: Path, new_folder: bool = False) -> None:
    """Raises RigError if no file can be written there, or it is one of those that are read, however it is spelt.

    With new_folder its folder need not be there yet: it is made before the file is.
    """
    part = part_of(path)
    for source in sources:
        _check_name(source)
        if any(_same(place, source) for place in (path, part)):
            raise RigError(f"{path}: would be written over {source}, which is read; give another name")
    folder = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if folder != path.absolute().parent and not new_folder:
        raise RigError(f"{path}: cannot be written (there is no folder {path.parent}); make it, or choose another")
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        why = "cannot be written to" if folder.is_dir() else "is no folder"
        raise RigError(f"{path}: cannot be written ({folder} {why}); choose another place")


def part_of(path: Path) -> Path:
    """Path at which a file is written before it is renamed; raises RigError if neither place may hold one."""
    _check_name(path)
    if not path.name or path.name == "..":
        raise RigError(f"{path}: is a folder; name a file in it")
    part = path.with_name(path.name + ".part")
    if any(len(os.fsencode(name)) > LONGEST_NAME_BYTES for name in part.parts):
        raise RigError(f"{path}: cannot be written (its name is too long); give a shorter one")
    for place in (path, part):
        if place.is_symlink():
            raise RigError(f"{place}: is a symbolic link; name the file itself")
        if place.is_dir():
            raise RigError(f"{place}: is a folder; name a file in it")
        if place.exists() and not place.is_file():
            raise RigError(f"{place}: is a device, a pipe or the like; name a file")
    return part


def make_folder(path: Path) -> None:
    """Make a folder with those above it; raises RigError if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path}: cannot be made a folder ({error.strerror}); choose another place") from error


@contextmanager
def reserved(path: Path, wait_s: float = 0.0) -> Iterator[Path]:
    """The place beside, for this writer alone; raises RigError if another one has it for longer than that.

    What stood there, of a writer that was killed, is this writer's to overwrite.
    """
    part = part_of(path)
    if fcntl is None:
        yield part
        return
    until = time.monotonic() + wait_s
    while (lock := _locked(part, path)) is None:
        if time.monotonic() > until:
            raise RigError(f"{path}: is being written by another program; wait for it, or give another name")
        time.sleep(0.02)
    try:
        yield part
    finally:
        os.close(lock)


def settle(part: Path, path: Path) -> None:
    """Renames, once it is on the disk; then the folder is put there too."""
    with part.open("rb+") as written:
        os.fsync(written.fileno())
    part.replace(path)
    with suppress(OSError):  # not every system opens folders
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A place beside, where the file is to be written; renamed to `path` once it is on the disk, removed if it fails.

    Writers of one file wait for each other: the last one's stands. Raises RigError if it cannot be written.
    """
    with reserved(path, WAIT_S) as part:
        try:
            yield part
            settle(part, path)
        except BaseException as error:  # once settled it stays: what stands there then is the next writer's
            with suppress(OSError):
                part.unlink()
            if not isinstance(error, OSError):
                raise
            raise RigError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error


def write_bytes(data: bytes, path: Path) -> None:
    """Raises RigError as `atomic_write` does."""
    with atomic_write(path) as part:
        part.write_bytes(data)


def write_json(value: object, path: Path) -> None:
    """Write what msgspec encodes, indented by two."""
    write_bytes(msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n", path)


def _locked(part: Path, path: Path) -> int | None:
    """The place, open and locked until it is closed or the process ends; None if another writer has it."""
    try:
        lock = os.open(part, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise RigError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        return None
    except OSError:  # a file system without locks
        return lock
    with suppress(FileNotFoundError):
        if os.path.samestat(os.fstat(lock), part.stat()):  # not renamed meanwhile by the one who had it
            return lock
    os.close(lock)
    return None


def _same(path: Path, other: Path) -> bool:
    if os.path.realpath(path) == os.path.realpath(other):
        return True
    try:
        return path.samefile(other)
    except OSError:
        return False


def _check_name(path: Path) -> None:
    if not is_plain(str(path)):
        raise RigError(f"{path}: its name has control characters, or is not UTF-8; rename it")
