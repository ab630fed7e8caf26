"""The commands in this process, and a set of sound files for them to read: those of one mass, 30 s."""

import signal
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

import identify
from identify.results import ContactResult
from tests.running import exit_status

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
    def unsound_recording(self) -> Path:
        return self.folder / "unsound.mcap"

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
def command(capsys):
    """Runs a command in this process: exit status, standard output, standard error."""

    def run(*words):
        capsys.readouterr()
        return exit_status(*words, columns=200), *capsys.readouterr()

    return run


@pytest.fixture(scope="session")
def sound(tmp_path_factory):
    found = Sound(tmp_path_factory.mktemp("sound"))
    for words in (
        ("rig", "record", "sdof", *SMALL, "--out", found.recording),
        ("rig", "record", "sdof", *SMALL, "--effect", "force_gain:factor=3", "--out", found.unsound_recording),
        ("rig", "export", found.recording, "--format", "csv", "--out", found.table, "--map", found.map),
    ):
        assert exit_status(*words) == 0
    answer = identify.contact(found.recording)
    answer.save(found.contact.parent)
    return replace(found, answer=answer)


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
