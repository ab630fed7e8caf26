"""MCAP files of other recorders, which are no measured data that is imported, and no recordings of a rig."""

import json

import pytest
from mcap.writer import CompressionType, Writer

from rig.errors import RigError
from rig.lab.looking import proposed_import_map
from rig.recording import read
from tests.running import exit_status


def write(path, topics):
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        schema_id = writer.register_schema("sample", "jsonschema", b"{}")
        for topic in topics:
            channel_id = writer.register_channel(topic, "json", schema_id)
            for k in range(20):
                data = json.dumps({"value": 0.5 * k}).encode()
                writer.add_message(channel_id, log_time=k * 10**6, data=data, publish_time=k * 10**6)
        writer.finish()
    return path


@pytest.mark.parametrize("command", [("identify", "check"), ("rig", "import"), ("rig", "info")])
def test_it_is_said_what_the_file_is_and_how_to_convert_it(tmp_path, capsys, command):
    program, *words = command
    assert exit_status(program, *words, write(tmp_path / "bag.mcap", ["/force", "/acc/mass"])) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "bag.mcap: is an MCAP file of another recorder, without rig.json" in line
    assert "(topics: /force (json), /acc/mass (json)); export their numbers with their times to CSV" in line
    assert "rename" not in line


def test_many_topics_are_counted(tmp_path):
    with pytest.raises(RigError, match=r"/t5 \(json\) and 3 more\)"):
        read(write(tmp_path / "bag.mcap", [f"/t{k}" for k in range(9)]))


def test_a_cut_file_is_of_another_recorder_too(tmp_path):
    path = write(tmp_path / "bag.mcap", ["/force"])
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(RigError, match=r"of another recorder, without rig.json \(topics: none is whole\)"):
        proposed_import_map(path, None)


def test_a_recording_needs_no_import(tmp_path):
    path = tmp_path / "r.mcap"
    assert exit_status("rig", "record", "sdof", "--plant", "modal", "--duration", 2, "--out", path) == 0
    with pytest.raises(RigError, match=r"r\.mcap: is a recording already, which needs no import"):
        proposed_import_map(path, None)
