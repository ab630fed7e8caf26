"""Tasks over processes: kept, resumed, and finished although a process is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest

from rig.commands.tasks import outcomes_of_tasks, run_tasks
from rig.errors import RigError


class Square(msgspec.Struct, frozen=True):
    """A number; `deadly` is a file whose absence kills the process that squares it."""

    number: int
    deadly: str | None = None


class Squared(msgspec.Struct, frozen=True):
    square: int


def squared(task: Square) -> Squared:
    if task.deadly and not Path(task.deadly).exists():
        Path(task.deadly).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return Squared(task.number**2)


def dying(_: Square) -> Squared:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def deadly_at_zero(task: Square) -> Squared:
    return Squared(task.number**2) if task.number else dying(task)


def sleeping(task: Square) -> Squared:
    time.sleep(task.number)
    return Squared(task.number)


def inverted(task: Square) -> Squared:
    return Squared(1 // task.number)


@pytest.mark.parametrize("dask", [None, "local"])
def test_a_killed_process_loses_its_own_task_alone(tmp_path, dask):
    tasks = [Square(n, str(tmp_path / "killed") if n == 3 else None) for n in range(6)]
    assert run_tasks(squared, tasks, Squared, tmp_path / "kept", dask) == [Squared(n**2) for n in range(6)]
    assert (tmp_path / "killed").exists()


def test_what_is_kept_is_not_computed_again(tmp_path):
    tasks = [Square(n) for n in range(3)]
    run_tasks(squared, tasks[:2], Squared, tmp_path)
    first = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert run_tasks(squared, tasks, Squared, tmp_path)[2] == Squared(4)
    assert {path: path.stat().st_mtime_ns for path in first} == first


def test_a_task_that_always_kills_its_process_takes_no_other_with_it(tmp_path):
    """It is the first, so that every pool that has it beside others breaks."""
    outcomes = outcomes_of_tasks(deadly_at_zero, [Square(n) for n in range(8)], Squared, tmp_path)
    assert outcomes[1:] == [Squared(n**2) for n in range(1, 8)]
    assert isinstance(outcomes[0], RigError)
    assert "its process was lost 3 times" in str(outcomes[0])
    assert len(list(tmp_path.glob("*.json"))) == 7


def test_an_interruption_ends_the_processes_and_keeps_what_is_done(tmp_path):
    """The first tasks are quick, the last would sleep for ten minutes; then the command goes on with these."""
    program = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "  # ignored in the background
    program += "from rig.commands.tasks import outcomes_of_tasks, run_tasks; from pathlib import Path; import sys; "
    program += f"sys.path.insert(0, {str(Path(__file__).parent)!r}); import test_tasks as t; "
    program += f"run_tasks(t.sleeping, [t.Square(n) for n in (0, 0, 1, 600, 700)], t.Squared, Path({str(tmp_path)!r}))"
    with subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True) as process:
        while len(list(tmp_path.glob("*.json"))) < 2:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        started = time.monotonic()
        error = process.communicate(timeout=60)[1]
    assert time.monotonic() - started < 30
    assert "StoppedError: interrupted; 3 of 5 results are kept" in error
    assert error.count("Traceback") == 1


def test_a_scheduler_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(RigError, match="no scheduler answers there"):
        run_tasks(squared, [Square(1)], Squared, tmp_path, "tcp://127.0.0.1:9")


def test_a_task_that_fails_does_not_stop_the_others(tmp_path):
    with pytest.raises(ZeroDivisionError):
        run_tasks(inverted, [Square(0), *(Square(n) for n in range(1, 5))], Squared, tmp_path)
    assert len(list(tmp_path.glob("*.json"))) == 4
