"""Hostile surroundings of every command: places that cannot be written, devices, pipes, names that would be obeyed."""

import os
import shutil
import subprocess
import sys

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from rig.recording import channel_groups, read, writing
from rig.recording.recovery import recover
from rig.simulation.reference import Sdof
from tests.running import exit_status

NAMES = ["[/]", "[bold]x[/bold]", "$x^$", "a/b", "a b ", "=1+1", "µ", "#", "%s{0}"]
LONG = "x" * 300
RIG = (sys.executable, "-c", "from rig.commands.cli import main; main()")


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A recording, its export with a map, and its rig.json."""
    folder = tmp_path_factory.mktemp("kept")
    record_named(folder / "r.mcap", "mass")
    for words in (
        ("export", "r.mcap", "--format", "csv", "--out", "r.csv", "--map", "map.toml"),
        ("draw", "r.mcap", "--out", "r.svg"),
    ):
        subprocess.run([*RIG, *words], cwd=folder, check=True)
    return folder


def record_named(path, name, samples=6000):
    """The one-mass rig with its sensors and its contact named so; any samples will do."""
    rig = Sdof(sensors="displacement").rig()
    rig = msgspec.structs.replace(
        rig,
        name=name,
        sensors=(msgspec.structs.replace(rig.sensors[0], name=name),),
        contacts=(msgspec.structs.replace(rig.contacts[0], name=name),),
    )
    rng = np.random.default_rng(1)
    with writing(path, rig, channel_groups(rig), {"made_by": name}) as recording:
        for group, channels in channel_groups(rig).items():
            recording.append(group, 1e-3 * rng.standard_normal((len(channels.names), samples)))


@pytest.fixture
def command(kept, in_folder, capsys):
    """Runs a command in a copy of the folder: exit status, standard output, standard error."""
    shutil.copytree(kept, in_folder, dirs_exist_ok=True)
    (in_folder / "a_file").write_text("precious")
    (in_folder / "link").symlink_to("a_file")
    (in_folder / "linked").symlink_to(in_folder)
    os.mkfifo(in_folder / "pipe")

    def run(program, *words):
        return exit_status(program, *words, columns=400), *capsys.readouterr()

    return run


FILES = [
    ("rig", "record", "sdof", "--plant", "modal", "--duration", "2"),
    ("rig", "export", "r.mcap", "--format", "csv"),
    ("rig", "import", "r.csv", "--map", "map.toml"),
    ("rig", "recover", "r.mcap"),
    ("rig", "view", "r.mcap"),
    ("rig", "draw", "r.mcap"),
]
FOLDERS = [
    ("rig", "init", "mass", "--mass-kg", "1", "--frequency-hz", "5", "--clearance-m", "1e-3"),
    ("identify", "contact", "r.mcap"),
    ("identify", "law", "r.mcap"),
    ("identify", "gap", "r.mcap", "--validate", "r.mcap"),
]


def snapshot(folder):
    return {p.name: p.lstat().st_mtime_ns for p in folder.iterdir()}


@pytest.mark.parametrize("words", FILES, ids=lambda w: w[1])
@pytest.mark.parametrize(
    "place", ["a_file/x", "pipe", "link", "/dev/full", LONG, "r.mcap", "linked/r.mcap", "linked/./linked/r.mcap"]
)
def test_a_file_that_cannot_be_written_is_refused_before_the_work(command, tmp_path, words, place):
    before = snapshot(tmp_path)
    overwrites = place.endswith("r.mcap") and words[1] in ("record", "import")
    status, out, err = command(*words, "--out", place, *(() if overwrites else ("--force",)))
    assert (status, out) == (1, "")
    assert err.count("\n") == 1
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("words", FOLDERS, ids=lambda w: w[1])
@pytest.mark.parametrize("place", ["a_file", "a_file/x", "pipe", "/dev/full", LONG])
def test_a_folder_that_cannot_be_made_is_refused(command, tmp_path, words, place):
    before = snapshot(tmp_path)
    status, out, err = command(*words, "--out", place)
    assert (status, out) == (1, "")
    assert err.count("\n") == 1
    assert place[:100] in err
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("source", ["pipe", "/dev/zero", "missing", "."])
@pytest.mark.parametrize(
    "words",
    [
        ("rig", "check", "{}"),
        ("rig", "info", "{}"),
        ("rig", "view", "{}"),
        ("rig", "draw", "{}"),
        ("rig", "recover", "{}", "--out", "o.mcap"),
        ("rig", "view", "r.mcap", "--contact", "{}"),
        ("rig", "import", "{}", "--map", "map.toml", "--out", "o.mcap"),
        ("rig", "import", "r.csv", "--map", "{}", "--out", "o.mcap"),
        ("identify", "check", "{}"),
        ("identify", "contact", "{}"),
        ("identify", "law", "{}"),
        ("identify", "gap", "{}", "--validate", "r.mcap"),
        ("identify", "contact", "r.mcap", "--tolerances", "{}"),
        ("identify", "gap", "r.mcap", "--validate", "r.mcap", "--null-reference", "{}"),
        ("identify", "gap", "r.mcap", "--validate", "r.mcap", "--rig", "{}"),
    ],
    ids=" ".join,
)
def test_what_is_no_file_is_not_read(command, words, source):
    status, _, err = command(*(word.format(source) for word in words))
    assert status == 1
    assert err.count("\n") == 1
    assert "Traceback" not in err


@pytest.mark.parametrize("name", NAMES)
def test_names_are_shown_as_they_are_and_come_back(command, tmp_path, name):
    record_named(tmp_path / "n.mcap", name)
    assert name in command("rig", "info", "n.mcap")[1]
    for form, ending in (("csv", "csv"), ("uff", "uff"), ("mat", "mat")):
        data = f"n.{ending}"
        assert command("rig", "export", "n.mcap", "--format", form, "--out", data, "--map", "m.toml", "--force")[0] == 0
        assert command("rig", "import", data, "--map", "m.toml", "--out", "b.mcap", "--force")[0] == 0
        back, first = read(tmp_path / "b.mcap"), read(tmp_path / "n.mcap")
        assert back.rig == first.rig
        np.testing.assert_allclose(back.signals["displacement"].values, first.signals["displacement"].values, rtol=1e-6)
    assert command("rig", "draw", "n.mcap", "--out", "n.svg")[0] == 0
    status, out, err = command("identify", "contact", "n.mcap")
    assert "Traceback" not in out + err
    assert status in (0, 1)


@pytest.mark.parametrize("name", ["", "\x1b[31m", "a\nb", "\ud800", "x" * 10**6])
def test_names_that_would_be_obeyed_are_refused(command, kept, name):
    given = msgspec.json.decode((kept / "rig.json").read_bytes())
    given["sensors"][0]["name"] = name
    text = msgspec.json.encode(given) if name != "\ud800" else b'{"name": "\\ud800"}'
    (kept / "bad.json").write_bytes(text)
    status, out, err = command("rig", "draw", str(kept / "bad.json"), "--out", "o.svg")
    assert (status, out) == (1, "")
    assert err.count("\n") == 1
    assert len(err) < 3000
    assert "\x1b" not in err


@pytest.mark.parametrize("kind", ["bodies", "sensors", "contacts"])
def test_thousands_of_things_are_refused_at_once(command, kept, kind):
    given = msgspec.json.decode((kept / "rig.json").read_bytes())
    given[kind] = [{**given[kind][0], "name": f"{kind} {k}"} for k in range(20_000)]
    (kept / "many.json").write_bytes(msgspec.json.encode(given))
    status, out, err = command("rig", "draw", str(kept / "many.json"), "--out", "o.svg")
    assert (status, out) == (1, "")
    assert "20000" in err
    assert err.count("\n") == 1


def test_recovery_keeps_what_other_programs_put_there(kept, tmp_path):
    with (tmp_path / "f.mcap").open("wb") as stream, (kept / "r.mcap").open("rb") as source:
        writer, reader = Writer(stream), make_reader(source)
        writer.start()
        numbers = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in numbers:
                own = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                numbers[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, own, channel.metadata
                )
            writer.add_message(
                numbers[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        for one in reader.iter_attachments():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        for one in reader.iter_metadata():
            writer.add_metadata(one.name, one.metadata)
        foreign = writer.register_channel("/camera", "json", 0)
        writer.add_message(foreign, 5, b'{"frame": 1}', 5)
        writer.add_attachment(0, 0, "photo.txt", "text/plain", b"a photo")
        writer.add_metadata("weather", {"rain": "no"})
        writer.finish()
    recover(tmp_path / "f.mcap", tmp_path / "saved.mcap")
    with (tmp_path / "saved.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert [m.data for _, c, m in reader.iter_messages() if c.topic == "/camera"] == [b'{"frame": 1}']
        assert b"a photo" in [a.data for a in reader.iter_attachments()]
        assert {"rain": "no"} in [m.metadata for m in reader.iter_metadata()]
    np.testing.assert_array_equal(read(tmp_path / "saved.mcap").force_n, read(kept / "r.mcap").force_n)


def test_without_a_place_for_compiled_code_commands_still_run(kept):
    environment = os.environ | {"NUMBA_CACHE_DIR": "/dev/full/none", "HOME": "/dev/null"}
    words = ["check", str(kept / "r.mcap")]
    done = subprocess.run(
        [*RIG, *words],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
