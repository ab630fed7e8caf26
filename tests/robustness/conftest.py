"""The commands in this process, and a set of sound files for them to read: those of one mass, 30 s."""

import signal
import sys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

import identify
from identify.commands import cli as identify_cli
from identify.results import ContactResult
from rig.commands import cli as rig_cli

MAINS = {"rig": rig_cli.main, "identify": identify_cli.main}
SMALL = ("--plant", "modal", "--duration", "25", "--set", "frequency_hz=2", "--set", "high_hz=6")


@dataclass(frozen=True)
class Sound:
    """A recording, the same as a table with its map and rig.json, and a contact.json."""

    folder: Path
    answer: ContactResult | None = None

    @property
    def recording(self) -> Path:
        return self.folder / "r.mcap"

    @property
    def table(self) -> Path:
        return self.folder / "r.csv"

    @property
    def map(self) -> Path:
        return self.folder / "r.toml"

    @property
    def rig(self) -> Path:
        return self.folder / "rig.json"

    @property
    def contact(self) -> Path:
        return self.folder / "results" / "contact.json"


@pytest.fixture
def command(monkeypatch, capsys):
    """Runs a command in this process: exit status, standard output, standard error."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words):
        return run_in_process(monkeypatch, capsys, words)

    return run


@pytest.fixture(scope="session")
def sound(tmp_path_factory):
    found = Sound(tmp_path_factory.mktemp("sound"))
    with pytest.MonkeyPatch.context() as patch:
        for words in (
            ("rig", "record", "sdof", *SMALL, "--out", found.recording),
            ("rig", "export", found.recording, "--format", "csv", "--out", found.table, "--map", found.map),
        ):
            patch.setattr(sys, "argv", [*map(str, words)])
            with pytest.raises(SystemExit) as stopped:
                MAINS[words[0]]()
            assert stopped.value.code in (0, None)
    answer = identify.contact(found.recording)
    answer.save(found.contact.parent)
    return replace(found, answer=answer)


def run_in_process(patch, captured, words):
    captured.readouterr()
    patch.setattr(sys, "argv", [str(word) for word in words])
    with pytest.raises(SystemExit) as stopped:
        MAINS[words[0]]()
    return stopped.value.code or 0, *captured.readouterr()


@pytest.fixture
def at_most():
    """Whoever waits longer than so many seconds is woken with an error."""

    def woken(*_):
        raise AssertionError("it waits")

    @contextmanager
    def limited(seconds):
        before = signal.signal(signal.SIGALRM, woken)
        signal.alarm(seconds)
        try:
            yield
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)

    return limited
