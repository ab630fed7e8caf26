"""Files are whole or not there."""

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Event

import pytest

from rig.errors import RigError
from rig.files import atomic_write, check_target, locked_part_path, sync_and_rename, write_bytes, write_json
from rig.recording import channel_groups, writing
from rig.simulation.reference import Sdof

RIG = Sdof().rig()


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "value.json"
    write_json({"a": 1}, path)
    assert path.read_text() == '{\n  "a": 1\n}\n'
    assert list(tmp_path.iterdir()) == [path]


def test_what_fails_leaves_the_old_file_and_nothing_beside(tmp_path):
    path = tmp_path / "value.json"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), atomic_write(path) as part_path:
        part_path.write_text("half a pair: \ud800", encoding="utf-8")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_two_writers_wait_for_each_other(tmp_path):
    path, began = tmp_path / "value", Event()

    def write_slowly():
        with atomic_write(path) as part_path:
            part_path.write_text("the fir")
            began.set()
            time.sleep(0.2)
            part_path.write_text("the first")

    with ThreadPoolExecutor() as pool:
        first = pool.submit(write_slowly)
        began.wait()
        write_bytes(b"the second", path)
        assert first.done()
    assert path.read_text() == "the second"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("interruption", [None, KeyboardInterrupt])
def test_the_next_writers_place_is_left_alone(tmp_path, monkeypatch, interruption):
    """A writer that has renamed its file owns nothing beside it any more, not even when it is interrupted."""
    next_part = tmp_path / "value.part"

    def rename_as_the_next_begins(part_path, path):
        sync_and_rename(part_path, path)
        next_part.write_text("the next")

    for user in ("rig.files", "rig.recording.writer"):
        monkeypatch.setattr(f"{user}.sync_and_rename", rename_as_the_next_begins)
    write_bytes(b"whole", tmp_path / "value")
    assert next_part.read_text() == "the next"
    with suppress(KeyboardInterrupt), writing(tmp_path / "value", RIG, channel_groups(RIG), {}):
        if interruption is not None:
            raise interruption
    assert next_part.read_text() == "the next"


def test_a_place_that_another_writer_keeps_is_refused(tmp_path):
    path = tmp_path / "value"
    with (
        locked_part_path(path),
        pytest.raises(RigError, match="is being written by another program"),
        locked_part_path(path),
    ):
        pass


@pytest.mark.parametrize("name", ["missing/value", "a_file/value"])
def test_where_nothing_can_be_written_is_said(tmp_path, name):
    (tmp_path / "a_file").write_text("")
    with pytest.raises(RigError, match="cannot be written"), atomic_write(tmp_path / name) as part_path:
        part_path.write_text("x")


def test_a_symbolic_link_is_refused(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    with pytest.raises(RigError, match="symbolic link"), atomic_write(tmp_path / "link"):
        pass


def test_a_source_with_a_null_byte_in_its_name_is_refused(tmp_path):
    with pytest.raises(RigError, match="its name has control characters"):
        check_target(tmp_path / "out.mcap", Path("a\0b"))
