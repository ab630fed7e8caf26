"""Commands run in this process, as a terminal of a given width and without a display starts them."""

import os
import sys
from unittest import mock

import pytest

from identify.commands.cli import main as identify_main
from rig.commands.cli import main as rig_main

MAINS = {"rig": rig_main, "identify": identify_main}
UNSET = ("DISPLAY", "WAYLAND_DISPLAY", "FORCE_COLOR")


def environment(**variables):
    """Context in which these environment variables are set, and there is neither display nor colour but by them."""
    inherited = {name: value for name, value in os.environ.items() if name not in UNSET}
    return mock.patch.dict(os.environ, inherited | variables, clear=True)


def exit_status(*words, columns=120, main=None, **variables):
    """Exit status of a command, given by its words."""
    with environment(COLUMNS=str(columns), **variables), mock.patch.object(sys, "argv", [str(w) for w in words]):
        with pytest.raises(SystemExit) as stopped:
            (main or MAINS[words[0]])()
        return stopped.value.code or 0
