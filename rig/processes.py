"""Independent runs of one function over processes, in order.

joblib's workers need no guarded main module in the scripts of users, and take functions that were made in functions.
"""

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from joblib import Parallel, cpu_count, delayed
from joblib.externals.loky import get_reusable_executor

WORTH_S = 15.0
"""Seconds of remaining work from which on processes are started, as each imports what it needs for 2 to 3 s."""
MAX_PROCESSES = 4
"""Number of processes at most by default, as a diagnosis takes up to 1 GB in each."""

Run = TypeVar("Run")
Result = TypeVar("Result")


def mapped(
    function: Callable[[Run], Result],
    runs: Sequence[Run],
    processes: int | None = None,
    report_finished: Callable[[int], None] = lambda _: None,
) -> list[Result]:
    """Results of `function` for every run, in their order, over so many processes; by default one a core.

    The first runs are done in this process, until it is known that the rest is worth others. LOKY_MAX_CPU_COUNT limits
    the cores. Errors are raised as they occur.
    """
    workers = processes or min(cpu_count(), MAX_PROCESSES)
    results: list[Result] = []
    begin = time.monotonic()
    while len(results) < len(runs):
        remaining = len(runs) - len(results)
        worth = bool(results) and remaining * (time.monotonic() - begin) / len(results) > WORTH_S
        if workers > 1 and remaining > 1 and worth:
            parallel = Parallel(n_jobs=min(workers, remaining), return_as="generator")
            for result in parallel(delayed(function)(run) for run in runs[len(results) :]):
                results.append(result)
                report_finished(len(results))
            break
        results.append(function(runs[len(results)]))
        report_finished(len(results))
    return results


def end_processes() -> None:
    """End the processes of `mapped`, which otherwise wait for more runs for five minutes and keep their memory."""
    get_reusable_executor().shutdown(kill_workers=True)
