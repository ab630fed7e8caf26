"""Standard output and standard error of every command."""

import os
import sys
from io import BufferedWriter, FileIO, TextIOWrapper
from typing import Any


class _Outlet(FileIO):
    """Descriptor of a stream whose reader may leave, as `head` does: what it does not read is dropped."""

    def write(self, content: Any) -> int:
        try:
            return super().write(content)
        except BrokenPipeError:
            null_descriptor = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null_descriptor, self.fileno())
            os.close(null_descriptor)
            return super().write(content)


def prepare_streams(command_name: str) -> None:
    """Escape what cannot be encoded, and let readers leave: the command then goes on to its own exit status.

    Exits if standard output is closed.
    """
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115
    if sys.stdout is None:
        sys.exit(f"{command_name}: standard output is closed; direct it into a file or to {os.devnull}")
    sys.stdout = _prepared(sys.stdout)
    sys.stderr = _prepared(sys.stderr)


def _prepared(stream: Any) -> Any:
    if not isinstance(stream, TextIOWrapper):
        return stream
    if type(stream) is not TextIOWrapper or not isinstance(getattr(stream.buffer, "raw", stream.buffer), FileIO):
        stream.reconfigure(errors="backslashreplace")  # a test's, or a console's of Windows
        return stream
    stream.flush()
    outlet = _Outlet(stream.fileno(), "w", closefd=False)
    return TextIOWrapper(
        outlet if stream.write_through else BufferedWriter(outlet),
        stream.encoding,
        "backslashreplace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
