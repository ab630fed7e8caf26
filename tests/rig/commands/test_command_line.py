"""Conventions of all commands: failure and progress."""

import pytest
import typer

from rig.commands.command_line import StoppedError, progress_bar, run, working
from rig.errors import RigError
from tests.running import environment, exit_status


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (RigError("it is broken; mend it"), 1, "it is broken; mend it"),
        (MemoryError("3 TiB"), 1, "not enough memory for this (3 TiB)"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (StoppedError("interrupted; half is there"), 130, "interrupted; half is there"),
    ],
)
def test_every_command_fails_in_the_same_way(capsys, error, status, said):
    app = typer.Typer(pretty_exceptions_enable=False)

    @app.command()
    def fail():
        raise error

    assert exit_status("rig", main=lambda: run(app, "rig")) == status
    err = capsys.readouterr().err
    assert err.startswith("rig: ")
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("terminal", [True, False])
def test_progress_is_for_terminals(capsys, terminal):
    with environment(**{"FORCE_COLOR": "1"} if terminal else {}), progress_bar("weighing") as progress:
        progress(0.37)
    out, err = capsys.readouterr()
    assert out == ""
    if terminal:
        assert "weighing" in err
        assert "37%" in err
    else:
        assert err == ""


def test_a_sign_of_life_is_silent_when_piped(capsys):
    with environment(), working("weighing"):
        pass
    assert capsys.readouterr() == ("", "")


def test_a_sign_of_life_is_shown_on_a_terminal(capsys):
    with environment(FORCE_COLOR="1"), working("weighing"):
        pass
    assert "weighing" in capsys.readouterr().err
