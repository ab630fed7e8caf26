"""Commands run in this process, as a terminal of a given width and without a display starts them."""

import os
import sys
from unittest import mock

import pytest

from identify.commands.cli import main as identify_main
from rig.commands.cli import main as rig_main

MAINS = {"rig": rig_main, "identify": identify_main}
UNSET = ("DISPLAY", "WAYLAND_DISPLAY", "FORCE_COLOR")


def exit_status(*words, columns=120, environment=None, main=None):
    """Exit status of a command, given by its words; `environment` has further variables."""
    inherited = {name: value for name, value in os.environ.items() if name not in UNSET}
    variables = inherited | {"COLUMNS": str(columns)} | (environment or {})
    with mock.patch.dict(os.environ, variables, clear=True), mock.patch.object(sys, "argv", [str(w) for w in words]):
        with pytest.raises(SystemExit) as stopped:
            (main or MAINS[words[0]])()
        return stopped.value.code or 0
