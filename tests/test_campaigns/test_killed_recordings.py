"""A few of the kills: python -m tests.campaigns.killed_recordings --kills 20 is the whole."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent


@pytest.mark.study
def test_what_a_kill_a_full_disk_and_an_interruption_leave_is_whole_and_true():
    words = [sys.executable, "-m", "tests.campaigns.killed_recordings", "--kills", "2", "--seed", "3"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == [
        "whole",
        "kill 1",
        "kill 2",
        "full disk",
        "Ctrl-C",
    ]
