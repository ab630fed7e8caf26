"""Which view is photographed; the viewer itself, which needs a driver of graphics, is replaced."""

from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from scenarios import screenshot


class Viewer:
    """Shows a view behind a tab only once it fills the window."""

    def __init__(self):
        self.blueprint = {"/viewport": {"ViewportBlueprint": {"root_container": "c"}}}

    def get_state(self):
        return SimpleNamespace(views=[SimpleNamespace(origin=f"/{o}", view_id=f"id {o}") for o in ("model", "a/b")])

    def set_time(self, *_, **__):
        pass

    def get_blueprint(self, _):
        return SimpleNamespace(blueprint=self.blueprint)

    def set_blueprint(self, blueprint, _):
        self.blueprint = blueprint

    def take_screenshot(self, view):
        assert self.blueprint["/viewport"]["ViewportBlueprint"].get("maximized") == view
        return f"picture of {view}".encode()


@pytest.fixture
def shot(monkeypatch, in_folder, capsys):
    @contextmanager
    def opened(_):
        yield Viewer()

    def run(*words):
        screenshot.main(["r.rrd", *words])
        return capsys.readouterr().out

    del in_folder
    monkeypatch.setattr(screenshot, "_opened", opened)
    monkeypatch.setattr(screenshot, "SETTLE_S", 0.0)
    return run


def test_without_a_file_to_write_the_views_are_listed(shot):
    assert shot().split() == ["a/b", "model"]


@pytest.mark.parametrize("view", ["a/b", "model"])
def test_every_view_that_is_listed_can_be_taken(shot, tmp_path, view):
    shot("--out", "x.png", "--view", view)
    assert (tmp_path / "x.png").read_bytes() == f"picture of id {view}".encode()


def test_the_window_is_taken_without_a_view(shot, tmp_path):
    shot("--out", "x.png")
    assert (tmp_path / "x.png").read_bytes() == b"picture of None"


def test_another_view_is_refused_and_those_that_are_there_named(shot, tmp_path):
    with pytest.raises(SystemExit, match="there is no view 'b'; there are a/b, model"):
        shot("--out", "x.png", "--view", "b")
    assert not list(tmp_path.iterdir())
