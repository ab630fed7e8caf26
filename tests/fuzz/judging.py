"""The judgement of a case: the right numbers, or one sentence, within the memory that its files may take."""

from collections.abc import Callable
from pathlib import Path

from rig.errors import RigError
from rig.limits import memory_bound_bytes

largest_bytes = 0
"""Memory that any case of this process has taken beyond what the process had."""


def refused_or_right(folder: Path, work: Callable[[], object]) -> str:
    """Does the work with the files that are in the folder."""
    file_bytes = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    before = _start_of_peak()
    try:
        outcome = _outcome(folder, work)
    finally:
        taken = _memory_bytes("VmHWM") - before
        global largest_bytes  # noqa: PLW0603
        largest_bytes = max(largest_bytes, taken)
    bound = memory_bound_bytes(file_bytes)
    assert taken <= bound, f"takes {taken / 1e6:.0f} MB, and its files of {file_bytes} bytes may take {bound / 1e6:.0f}"
    return outcome


def refused(folder: Path, work: Callable[[], object]) -> str:
    """As of files that must not be believed."""
    outcome = refused_or_right(folder, work)
    assert outcome == "refused", "is believed"
    return outcome


def _outcome(folder: Path, work: Callable[[], object]) -> str:
    try:
        work()
    except RigError as error:
        sentence = str(error)
        assert sentence.startswith("/"), f"names no file: {sentence[:300]}"
        assert sentence.isprintable(), f"not one printable line: {sentence[:300]!r}"
        assert len(sentence) < 2000, f"a sentence of {len(sentence)} characters: {sentence[:300]}"
        assert "enough memory" not in sentence, "needs too much memory"
        assert not list(folder.glob("*.part")), f"leaves {list(folder.glob('*.part'))}"
        return "refused"
    return "right"


def _start_of_peak() -> int:
    """The memory of this process, from which on its peak is counted again."""
    Path("/proc/self/clear_refs").write_text("5")
    return _memory_bytes("VmRSS")


def _memory_bytes(entry: str) -> int:
    status = Path("/proc/self/status").read_text()
    return int(status.split(f"{entry}:")[1].split()[0]) * 1024
