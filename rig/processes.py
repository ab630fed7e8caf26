"""Independent runs of one function over processes, in order.

joblib's workers need no guarded main module in the scripts of users, and take functions that were made in functions.
"""

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from joblib import Parallel, cpu_count, delayed
from joblib.externals.loky import get_reusable_executor

MIN_REMAINING_S = 15.0
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
    min_remaining_s: float = MIN_REMAINING_S,
) -> list[Result]:
    """Results of `function` for every run, in their order, over so many processes; by default one a core.

    Runs are done in this process until their time says that the remaining ones would take longer than
    `min_remaining_s`. The processes end with the last run, as they keep their memory. LOKY_MAX_CPU_COUNT limits the
    cores. Errors are raised as they occur.
    """
    process_count = processes or min(cpu_count(), MAX_PROCESSES)
    results: list[Result] = []
    started_s = time.monotonic()

    def add_result(result: Result) -> None:
        results.append(result)
        report_finished(len(results))

    for run in runs:
        remaining_count = len(runs) - len(results)
        mean_run_s = (time.monotonic() - started_s) / max(len(results), 1)
        if results and min(process_count, remaining_count) > 1 and remaining_count * mean_run_s > min_remaining_s:
            break
        add_result(function(run))
    if remaining_runs := runs[len(results) :]:
        parallel_runs = Parallel(n_jobs=min(process_count, len(remaining_runs)), return_as="generator")
        try:
            for result in parallel_runs(delayed(function)(run) for run in remaining_runs):
                add_result(result)
        finally:
            get_reusable_executor().shutdown(kill_workers=True)
    return results
