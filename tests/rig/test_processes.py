"""Independent runs over processes."""

import os
import time

import pytest

from rig.errors import RigError
from rig.processes import mapped


def test_results_come_in_order_from_other_processes_where_the_work_is_worth_it():
    finished = []

    def run(number):
        time.sleep(0.2)
        return number, os.getpid()

    results = mapped(run, range(4), 2, finished.append, min_remaining_s=0.1)
    assert [number for number, _ in results] == [0, 1, 2, 3]
    assert results[0][1] == os.getpid()
    assert os.getpid() not in {process for _, process in results[1:]}
    assert finished == [1, 2, 3, 4]


def test_little_work_stays_in_this_process():
    assert mapped(lambda _: os.getpid(), range(3), 2) == [os.getpid()] * 3
    assert mapped(lambda _: os.getpid(), (), 2) == []


def test_an_error_in_a_process_is_that_of_the_run():
    def run(number):
        time.sleep(0.1)
        if number == 2:
            raise RigError("run 2 cannot be simulated")
        return number

    with pytest.raises(RigError, match="run 2"):
        mapped(run, range(4), 2, min_remaining_s=0.01)
