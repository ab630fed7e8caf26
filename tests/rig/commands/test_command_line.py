"""Conventions of all commands: failure and progress."""

import re
import sys
import time

import pytest
import typer

from rig.commands import command_line
from rig.commands.command_line import StoppedError, fitted, help_filled_by, progress_bar, progress_spinner, run, say
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


def test_progress_is_drawn_on_a_terminal(capsys):
    with environment(FORCE_COLOR="1"), progress_bar("weighing") as progress:
        progress(0.37)
    out, err = capsys.readouterr()
    assert out == ""
    assert "weighing" in err
    assert "37%" in err


@pytest.mark.parametrize(("bar", "said"), [(True, r"weighing: 37%, \d+ s"), (False, r"weighing: \d+ s")])
def test_progress_is_lines_without_a_terminal(capsys, monkeypatch, bar, said):
    monkeypatch.setattr(command_line, "PROGRESS_LINE_PERIOD_S", 0.05)
    with environment(), progress_bar("weighing") if bar else progress_spinner("weighing") as progress:
        if bar:
            progress(0.37)
        time.sleep(0.3)
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) > 1
    assert all(re.fullmatch(said, line) for line in err.splitlines())


@pytest.mark.parametrize("progress_of", [progress_bar, progress_spinner])
def test_short_work_says_nothing_without_a_terminal(capsys, progress_of):
    with environment(), progress_of("weighing"):
        pass
    assert capsys.readouterr() == ("", "")


def test_a_sign_of_life_is_shown_on_a_terminal(capsys):
    with environment(FORCE_COLOR="1"), progress_spinner("weighing"):
        pass
    assert "weighing" in capsys.readouterr().err


SENTENCE = "  results/a_path_that_is_longer_than_any_line: 10.06 ± 0.34 mm of it, or 52.0 % of the time; record longer"


@pytest.mark.parametrize("width", [18, 30, 31, 32, 33, 34, 35, 80])
def test_lines_are_broken_between_words_and_keep_their_indent(width):
    lines = fitted(SENTENCE, width).split("\n")
    assert " ".join(line.strip() for line in lines) == SENTENCE.strip()
    for line in lines:
        assert line.startswith("  ")
        assert len(line) <= width or " " not in line.strip()
        assert not line.strip().startswith(("±", "%", "0.34"))


@pytest.mark.parametrize("terminal", [True, False])
def test_sentences_are_broken_on_a_terminal_and_whole_in_a_pipe(capsys, monkeypatch, terminal):
    app = typer.Typer(pretty_exceptions_enable=False)

    @app.command()
    def fail():
        say(SENTENCE)
        raise RigError(SENTENCE.strip())

    for stream in (sys.stdout, sys.stderr):
        monkeypatch.setattr(stream, "isatty", lambda: terminal)
    exit_status("rig", columns=50, main=lambda: run(app, "rig"))
    for text in capsys.readouterr():
        lines = text.splitlines()
        assert (len(lines) > 1) == terminal
        assert max(map(len, lines)) <= 50 or not terminal


def test_a_paragraph_of_the_help_fills_its_lines(capsys):
    app = typer.Typer(pretty_exceptions_enable=False)

    @app.command(cls=help_filled_by(dict))
    def weigh():
        """Weigh a thing.

        The first line ends here
        but not in the help.
        """

    assert exit_status("rig", "--help", columns=80, main=lambda: app(prog_name="rig")) == 0
    assert "The first line ends here but not in the help." in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [("rig",), ("identify",), ("rig", "record"), ("identify", "contact"), ("rig", "init"), ("rig", "init", "mass")],
)
def test_every_command_has_short_options_for_its_help(capsys, words):
    said = []
    for option in ("-h", "--help"):
        assert exit_status(*words, option) == 0
        said.append(capsys.readouterr().out)
    assert said[0] == said[1]
    assert said[0].split()[:3] == ["Usage:", *words, "[OPTIONS]"][:3]
    assert "<bool>" not in said[0]


@pytest.mark.parametrize("command_name", ["rig", "identify"])
def test_the_version_has_a_short_option(capsys, command_name):
    assert exit_status(command_name, "-V") == 0
    assert capsys.readouterr().out.startswith("rig-identify ")


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("rig", "record", "sdof", "--seconds", "3"), "--duration"),
        (("rig", "record", "sdof", "-o", "r.mcap"), "--out"),
        (("rig", "draw", "r.mcap", "--overwrite"), "--force"),
        (("identify", "law", "r.mcap", "--duration", "3"), "--seconds"),
    ],
)
def test_an_option_of_another_name_is_told_the_one_here(capsys, words, option):
    assert exit_status(*words) == 2
    assert re.search(rf"No such option: {words[3]}\b.*{option}\b", capsys.readouterr().err)  # words by typer's version
