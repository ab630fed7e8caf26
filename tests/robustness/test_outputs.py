"""Outputs that cannot be written: one sentence, status 1, and nothing of it there, for every command that writes."""

import os
import resource
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

START = ["--mass-kg=1", "--frequency-hz=5", "--clearance-m=1e-3", "--stiffness-n-per-m=1e4", "--sample-rate-hz=512"]
SCRIPTS = Path(sys.executable).parent
FILES = {
    "record": lambda _, out: ("rig", "record", "sdof", "--plant", "modal", "--duration", 2, "--out", out),
    "view": lambda s, out: ("rig", "view", s.recording, "--out", out),
    "recover": lambda s, out: ("rig", "recover", s.recording, "--out", out),
    "import": lambda s, out: ("rig", "import", s.table, "--map", s.map, "--out", out),
    "export csv": lambda s, out: ("rig", "export", s.recording, "--format", "csv", "--out", out),
    "export uff": lambda s, out: ("rig", "export", s.recording, "--format", "uff", "--out", out),
    "export mat": lambda s, out: ("rig", "export", s.recording, "--format", "mat", "--out", out),
    "draw": lambda s, out: ("rig", "draw", s.recording, "--out", out),
    "null reference": lambda s, out: ("identify", "gap", s.recording, "--null-reference", out),
}
"""Commands that write a file, by the sound files and the place where it is to be."""
ENDINGS = {
    "record": ".mcap",
    "view": ".rrd",
    "recover": ".mcap",
    "import": ".mcap",
    "export csv": ".csv",
    "export uff": ".uff",
    "export mat": ".mat",
    "draw": ".svg",
    "null reference": ".json",
}
FOLDERS = {
    "init": lambda _, out: ("rig", "init", "mass", *START, "--out", out),
    "contact": lambda s, out: ("identify", "contact", s.recording, "--out", out),
    "law": lambda s, out: ("identify", "law", s.recording, "--seconds", 1, "--out", out),
    "gap": lambda s, out: ("identify", "gap", s.recording, "--out", out),
}


SLOW = ("law", "gap", "null reference")
"""Not to be waited for here: their files are written as those of the others are."""


@pytest.mark.parametrize("command_name", [name for name in (*FILES, *FOLDERS) if name not in SLOW])
def test_a_disk_that_is_full_is_said_and_leaves_nothing_that_is_taken_for_whole(
    command, sound, tmp_path, at_most, command_name
):
    out = tmp_path / f"o{ENDINGS.get(command_name, '')}"
    words = {**FILES, **FOLDERS}[command_name](sound, out)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, limit[1]))
    try:
        with at_most(60):
            status, said, err = command(*words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert (status, said) == (1, ""), err
    assert err.count("\n") == 1
    assert "cannot be written" in err
    left = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert left <= {"o.mcap.part", "o.truth.mcap.part"}, left  # what `rig recover` saves of a recording


@pytest.mark.parametrize(
    "words",
    [
        lambda s: ("rig", "info", s.recording),
        lambda s: ("rig", "check", s.recording, "--json"),
        lambda s: ("identify", "contact", s.recording),
        lambda s: ("rig", "doctor"),  # noqa: ARG005
    ],
)
@pytest.mark.parametrize("output", ["full", "closed"])
def test_a_standard_output_that_takes_nothing_is_said(sound, words, output):
    program, *rest = map(str, words(sound))
    code = f"from {program}.commands.cli import main; main()"
    closing = (lambda: os.close(1)) if output == "closed" else None
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", code, *rest],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=closing,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr.startswith(f"{program}: standard output")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("errors", "unbuffered"), [(subprocess.PIPE, ""), (subprocess.STDOUT, "1")], ids=["output", "output and errors"]
)
@pytest.mark.parametrize(
    ("command_line", "status"),
    [
        ("rig info {recording}", 0),
        ("identify check {unsound_recording}", 1),
        ("rig --help", 0),
        ("rig-identify doctor", 0),
        ("rig-identify rig info {recording}", 0),
    ],
)
def test_a_reader_that_leaves_changes_nothing(sound, command_line, status, errors, unbuffered):
    """As `rig info FILE | head -1`: nothing is said of the pipe, and the status is that of the command."""
    name, *words = command_line.format(recording=sound.recording, unsound_recording=sound.unsound_recording).split()
    function = {"rig-identify": "both"}.get(name, name)
    program = f"import sys; sys.argv = {[name, *words]!r}; from rig.commands.start import {function}; {function}()"
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-c", program],
        stdout=writing,
        stderr=errors,
        env=os.environ | {"PYTHONUNBUFFERED": unbuffered, "PATH": f"{SCRIPTS}{os.pathsep}{os.environ['PATH']}"},
        check=False,
    )
    os.close(writing)
    assert (done.returncode, done.stderr or b"") == (status, b"")


@pytest.mark.parametrize("spelling", ["dots", "hard link", "symbolic folder", "relative"])
@pytest.mark.parametrize("command_name", [n for n in FILES if n not in ("record",)])
def test_a_source_is_never_written_over_however_it_is_spelt(command, sound, in_folder, command_name, spelling):
    tmp_path, effect_phrases = in_folder, FILES[command_name]
    source = tmp_path / "r.mcap"
    source.write_bytes(sound.recording.read_bytes())
    (tmp_path / "sub").mkdir()
    with suppress(OSError):
        (tmp_path / "also").symlink_to(tmp_path)
    out = {
        "dots": tmp_path / "sub" / ".." / "r.mcap",
        "hard link": tmp_path / "other.mcap",
        "symbolic folder": tmp_path / "also" / "r.mcap",
        "relative": Path("sub/../r.mcap"),
    }[spelling]
    if spelling == "hard link":
        os.link(source, out)
    read_from = type(sound)(tmp_path)
    words = effect_phrases(read_from, out)
    if command_name == "import":
        words = ("rig", "import", source, "--map", sound.map, "--out", out)
    forced = () if command_name == "null reference" else ("--force",)
    status, said, err = command(*words, *forced)
    assert (status, said) == (1, "")
    assert "would be written over" in err
    assert source.read_bytes() == sound.recording.read_bytes()
