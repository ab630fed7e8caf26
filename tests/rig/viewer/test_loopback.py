"""Every start of rerun: on the loopback address, so that no other computer reaches the recording."""

import subprocess
from pathlib import Path

import pytest

from rig.viewer import viewing, web
from scenarios import screenshot


class StartedError(Exception):
    """The start of a program, with its words."""


def started(*words, **_):
    raise StartedError(*words)


@pytest.mark.parametrize(
    "start",
    [
        viewing.open_viewer,
        lambda path: web.serve(path, lambda _: None),
        screenshot.view_names,
    ],
    ids=["window", "browser", "picture"],
)
def test_rerun_listens_on_the_loopback_address_alone(monkeypatch, tmp_path, start):
    path = Path(tmp_path / "r.rrd")
    path.touch()
    monkeypatch.setattr(subprocess, "Popen", started)
    with pytest.raises(StartedError) as error:
        start(path)
    (words,) = error.value.args
    assert "rerun" in words[2]
    assert words[words.index("--bind") + 1] == "127.0.0.1"
