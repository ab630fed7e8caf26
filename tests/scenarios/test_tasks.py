"""Tasks over processes: kept, resumed, and finished although a process is killed."""

import os
import signal
from pathlib import Path

import msgspec
import pytest

from rig.errors import RigError
from scenarios.tasks import run_tasks


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


def test_a_process_that_always_dies_is_given_up(tmp_path):
    with pytest.raises(RigError, match="processes were lost"):
        run_tasks(dying, [Square(1)], Squared, tmp_path)


def test_a_scheduler_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(RigError, match="no scheduler answers there"):
        run_tasks(squared, [Square(1)], Squared, tmp_path, "tcp://127.0.0.1:9")


def test_a_task_that_fails_does_not_stop_the_others(tmp_path):
    with pytest.raises(ZeroDivisionError):
        run_tasks(inverted, [Square(0), *(Square(n) for n in range(1, 5))], Squared, tmp_path)
    assert len(list(tmp_path.glob("*.json"))) == 4
