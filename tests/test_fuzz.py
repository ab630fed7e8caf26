"""A short slice of the fuzzing: python -m tests.fuzz --cases 20000 is the whole."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_mutated_files_end_in_the_right_numbers_or_one_sentence():
    words = [sys.executable, "-m", "tests.fuzz", "--cases", "75", "--seed", "7"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "75 cases of seed 7" in done.stdout
    assert done.stderr == ""
