"""Safe reading and atomic writing of files.

Only regular files are read. A file is written beside its target (FILE.part), synced to the disk and then renamed, so
that it is either complete or absent.
"""

import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

import msgspec

from rig.errors import RigError, has_no_control_characters

try:
    import fcntl
except ImportError:  # Windows, where one writer keeps another from opening the file
    fcntl = None  # type: ignore[assignment]

MAX_NAME_BYTES = 255
MAX_FILE_BYTES = 256 * 1024 * 1024
"""Largest file that is read in one piece: a map, a description, a report."""
SMALL_FILE_WAIT_S = 30.0
"""How long a small file waits for another writer of it; a recording does not."""


def check_source(path: Path) -> None:
    """Raise RigError unless the path is a regular file: a device or a pipe may never end."""
    _check_name(path)
    try:
        is_regular = path.is_file()
        if not is_regular:
            path.open("rb").close() if path.is_dir() else path.stat()
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror}); check the name") from error
    if not is_regular:
        raise RigError(f"{path}: is a device, a pipe or the like; give a file")


def contents(path: Path) -> bytes:
    """Content of a regular file; raises RigError if it cannot be read or is larger than MAX_FILE_BYTES."""
    check_source(path)
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise RigError(f"{path}: has more than {MAX_FILE_BYTES >> 20} MiB; this is not the file that is asked for")
        return path.read_bytes()
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); check the file") from error


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_target(path: Path, *sources: Path, new_folder: bool = False) -> None:
    """Raise RigError if the path cannot be written, or is one of the sources under whatever name.

    With new_folder its folder need not exist yet; the caller makes it.
    """
    part_path = part_path_of(path)
    for source in sources:
        _check_name(source)
        if any(_is_same_file(candidate, source) for candidate in (path, part_path)):
            raise RigError(f"{path}: would be written over {source}, which is read; give another name")
    folder = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if folder != path.absolute().parent and not new_folder:
        raise RigError(f"{path}: cannot be written (there is no folder {path.parent}); make it, or choose another")
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        obstacle = "cannot be written to" if folder.is_dir() else "is no folder"
        raise RigError(f"{path}: cannot be written ({folder} {obstacle}); choose another place")


def part_path_of(path: Path) -> Path:
    """Path FILE.part at which a file is written before it is renamed; raises RigError if either path is unusable."""
    _check_name(path)
    if not path.name or path.name == "..":
        raise RigError(f"{path}: is a folder; name a file in it")
    part_path = path.with_name(path.name + ".part")
    if any(len(os.fsencode(path_part)) > MAX_NAME_BYTES for path_part in part_path.parts):
        raise RigError(f"{path}: cannot be written (its name is too long); give a shorter one")
    for candidate in (path, part_path):
        if candidate.is_symlink():
            raise RigError(f"{candidate}: is a symbolic link; name the file itself")
        if candidate.is_dir():
            raise RigError(f"{candidate}: is a folder; name a file in it")
        if candidate.exists() and not candidate.is_file():
            raise RigError(f"{candidate}: is a device, a pipe or the like; name a file")
    return part_path


def make_folder(path: Path) -> None:
    """Make a folder with those above it; raises RigError if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path}: cannot be made a folder ({error.strerror}); choose another place") from error


def user_cache_folder() -> Path | None:
    """This version's folder in the user's cache folder, made if need be; None where nothing can be written there."""
    base_by_platform = {"win32": os.environ.get("LOCALAPPDATA", ""), "darwin": "~/Library/Caches"}
    base_text = os.environ.get("XDG_CACHE_HOME") or base_by_platform.get(sys.platform) or "~/.cache"
    folder = Path(os.path.expanduser(base_text), "rig-identify", version("rig-identify"))  # noqa: PTH111 - "~" stays
    return folder if folder.is_absolute() and is_writable_folder(folder) else None


def is_writable_folder(folder: Path) -> bool:
    """True if the folder is there or can be made, and a file can be written in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@contextmanager
def locked_part_path(path: Path, wait_s: float = 0.0) -> Iterator[Path]:
    """FILE.part, locked for this writer; raises RigError if another writer holds it for longer than wait_s.

    The remains of a writer that was killed may be overwritten.
    """
    part_path = part_path_of(path)
    if fcntl is None:
        yield part_path
        return
    deadline_s = time.monotonic() + wait_s
    while (descriptor := _lock_descriptor(part_path, path)) is None:
        if time.monotonic() > deadline_s:
            raise RigError(f"{path}: is being written by another program; wait for it, or give another name")
        time.sleep(0.02)
    try:
        yield part_path
    finally:
        os.close(descriptor)


def sync_and_rename(part_path: Path, path: Path) -> None:
    """Sync the file to the disk, rename it to its final path, and sync the folder."""
    with part_path.open("rb+") as file:
        os.fsync(file.fileno())
    part_path.replace(path)
    with suppress(OSError):  # not every system opens folders
        folder_descriptor = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder_descriptor)
        finally:
            os.close(folder_descriptor)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Path at which to write the file; on success it is synced and renamed to `path`, on failure removed.

    Writers of one file wait for each other; the last one prevails. Raises RigError if the file cannot be written.
    """
    with locked_part_path(path, SMALL_FILE_WAIT_S) as part_path:
        try:
            yield part_path
            sync_and_rename(part_path, path)
        except BaseException as error:  # once settled it stays: what stands there then is the next writer's
            with suppress(OSError):
                part_path.unlink()
            if not isinstance(error, OSError):
                raise
            raise RigError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error


def write_bytes(content: bytes, path: Path) -> None:
    """Write a file atomically; raises RigError as `atomic_write` does."""
    with atomic_write(path) as part_path:
        part_path.write_bytes(content)


def write_json(content: object, path: Path) -> None:
    """Write a value as JSON, indented by two, atomically."""
    write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n", path)


def _lock_descriptor(part_path: Path, path: Path) -> int | None:
    """File descriptor of FILE.part, locked until it is closed or the process ends; None if another writer has it."""
    try:
        descriptor = os.open(part_path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise RigError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except OSError:  # a file system without locks
        return descriptor
    with suppress(FileNotFoundError):
        if os.path.samestat(os.fstat(descriptor), part_path.stat()):  # not renamed meanwhile by the one who had it
            return descriptor
    os.close(descriptor)
    return None


def _is_same_file(path: Path, other_path: Path) -> bool:
    if os.path.realpath(path) == os.path.realpath(other_path):
        return True
    try:
        return path.samefile(other_path)
    except OSError:
        return False


def _check_name(path: Path) -> None:
    if not has_no_control_characters(str(path)):
        raise RigError(f"{path}: its name has control characters, or is not UTF-8; rename it")
