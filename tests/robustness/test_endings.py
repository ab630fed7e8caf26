"""Ctrl-C and SIGTERM at any moment: one sentence, status 130, and no file that is not whole."""

import signal
import subprocess
import sys
import time

import pytest

from rig.recording import read

COMMANDS = {
    "record": lambda _, out: ("rig", "record", "sdof", "--plant", "modal", "--duration", 5000, "--out", out / "o.mcap"),
    "import": lambda s, out: ("rig", "import", s.table, "--map", s.map, "--out", out / "o.mcap"),
    "export": lambda s, out: ("rig", "export", s.recording, "--format", "csv", "--out", out / "o.csv"),
    "view": lambda s, out: ("rig", "view", s.recording, "--out", out / "o.rrd"),
    "check": lambda s, _: ("identify", "check", s.recording),
    "contact": lambda s, out: ("identify", "contact", s.recording, "--out", out),
    "law": lambda s, out: ("identify", "law", s.recording, "--out", out),
    "gap": lambda s, out: ("identify", "gap", s.recording, "--null-reference", out / "o.json", "--out", out),
}
AFTER_S = (0.3, 1.5)
"""While the libraries load, and within the work or after it."""
ENDINGS = [(name, signal.SIGTERM) for name in COMMANDS] + [("record", signal.SIGINT), ("contact", signal.SIGINT)]


@pytest.mark.parametrize(("command_name", "ending"), ENDINGS)
def test_a_command_that_is_ended_says_so_and_leaves_nothing_half(sound, tmp_path, command_name, ending):
    for after_s in AFTER_S:
        out = tmp_path / str(after_s)
        out.mkdir()
        name, *words = map(str, COMMANDS[command_name](sound, out))
        begun = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # as a terminal has it
        program = [sys.executable, "-c", f"{begun}; from rig.commands.start import {name}; {name}()", *words]
        with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
            time.sleep(after_s)
            running.send_signal(ending)
            try:
                _, said = running.communicate(timeout=60)
            except subprocess.TimeoutExpired:
                running.kill()
                raise
        if (running.returncode, said) not in ((0, ""), (-ending, "")):  # done before, or as Python itself was ending
            assert running.returncode == 130, said
            assert said.startswith(f"{name}: interrupted"), said
            assert said.count("\n") == 1, said
        assert not list(out.rglob("*.part"))
        for recording in out.glob("o.mcap"):
            read(recording)


def test_an_interrupt_that_a_callback_of_compiled_code_swallows_comes_again():
    program = """
import ctypes, signal, sys, time
from rig.commands.command_line import repeat_lost_interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)  # as a terminal has it
sys.unraisablehook = repeat_lost_interrupt
def interrupted(): raise KeyboardInterrupt
ctypes.CFUNCTYPE(None)(interrupted)()
print("goes on", flush=True)
begun_s = time.monotonic()
while time.monotonic() < begun_s + 10: pass
print("never ended")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert ended.stdout == "goes on\n"
    assert ended.stderr.rstrip().endswith("KeyboardInterrupt")
