"""Running many tasks: pure functions of their parameters, spread over processes, each result kept on disk."""

import hashlib
import importlib.metadata
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import typer
from threadpoolctl import threadpool_limits

from rig.commands.command_line import StoppedError, progress_bar
from rig.errors import RigError
from rig.extras import needs_extra
from rig.files import make_folder, write_bytes

Parameters = TypeVar("Parameters", bound=msgspec.Struct)
TaskResult = TypeVar("TaskResult", bound=msgspec.Struct)
Completions = Generator[tuple[int, Future[Any]], None, None]
Dask = Annotated[
    str | None, typer.Option("--dask", help="Address of a dask scheduler, or local; by default a process a core.")
]
MAX_LOST_PROCESSES = 3
"""So many times the process of a task may be lost before the task is given up."""


def run_tasks(
    function: Callable[[Parameters], TaskResult],
    parameter_sets: Sequence[Parameters],
    result_type: type[TaskResult],
    folder: Path,
    dask: str | None = None,
) -> list[TaskResult]:
    """The results of a function for each set of parameters, in their order, by `outcomes_of_tasks`.

    A task that fails does not stop the others; the first failure is raised at the end.
    """
    results: list[TaskResult] = []
    for outcome in outcomes_of_tasks(function, parameter_sets, result_type, folder, dask):
        if isinstance(outcome, BaseException):
            raise outcome
        results.append(outcome)
    return results


def outcomes_of_tasks(
    function: Callable[[Parameters], TaskResult],
    parameter_sets: Sequence[Parameters],
    result_type: type[TaskResult],
    folder: Path,
    dask: str | None = None,
) -> list[TaskResult | BaseException]:
    """Result, or the error in its place, of a function for each set of parameters, in their order.

    A result is kept in the folder under a hash of the function's name, its parameters and this package's version, and
    not computed again; an error is not kept. Processes of one thread each run the tasks: one a core, or those of
    `dask`. A task whose process is lost is tried again by itself, at most MAX_LOST_PROCESSES times; the others go on.
    Raises RigError if no such scheduler answers, StoppedError if interrupted, when the processes end at once.
    """
    make_folder(folder)
    result_paths = [task_result_path(function, parameters, folder) for parameters in parameter_sets]
    unfinished_indices = [task_index for task_index, result_path in enumerate(result_paths) if not result_path.exists()]
    tasks = [parameter_sets[task_index] for task_index in unfinished_indices]
    completions = _completions_on_dask(function, tasks, dask) if dask else _completions_on_processes(function, tasks)
    error_by_number: dict[int, BaseException] = {}
    finished_count = 0
    try:
        with (
            closing(completions),
            progress_bar(f"{len(unfinished_indices)} of {len(parameter_sets)} tasks") as progress,
        ):
            for completed_index, future in completions if tasks else ():
                if error := future.exception():
                    error_by_number[unfinished_indices[completed_index]] = error
                else:
                    write_bytes(msgspec.json.encode(future.result()), result_paths[unfinished_indices[completed_index]])
                finished_count += 1
                progress(finished_count / len(unfinished_indices))
    except KeyboardInterrupt:
        kept_count = sum(result_path.exists() for result_path in result_paths)
        raise StoppedError(
            f"interrupted; {kept_count} of {len(result_paths)} results are kept in {folder}; run the command again "
            "to go on"
        ) from None
    return [
        error_by_number[task_index]
        if task_index in error_by_number
        else msgspec.json.decode(result_path.read_bytes(), type=result_type)
        for task_index, result_path in enumerate(result_paths)
    ]


def task_result_path(function: Callable[[Parameters], TaskResult], parameters: Parameters, folder: Path) -> Path:
    """File in which the result of a task is kept."""
    hashed_name = f"{function.__module__}.{function.__qualname__} {importlib.metadata.version('rig-identify')}"
    return folder / f"{hashlib.sha256(hashed_name.encode() + msgspec.json.encode(parameters)).hexdigest()[:24]}.json"


def _completions_on_dask(
    function: Callable[[Parameters], TaskResult], tasks: Sequence[Parameters], dask: str
) -> Completions:
    """Yield index and future of each task as it completes; dask itself repeats a task whose worker is lost."""
    with needs_extra("cluster", "--dask"):
        from distributed import Client
    local_options = {"n_workers": os.cpu_count(), "threads_per_worker": 1, "dashboard_address": None}
    try:
        client = Client(**local_options) if dask == "local" else Client(dask, timeout=5)
    except (OSError, ValueError) as error:
        raise RigError(f"--dask {dask}: no scheduler answers there ({error}); start one, or give local") from error
    with client, client.get_executor(retries=MAX_LOST_PROCESSES) as executor:
        index_by_future = {
            executor.submit(_run_on_one_thread, function, task): index for index, task in enumerate(tasks)
        }
        for future in as_completed(index_by_future):
            yield index_by_future[future], future


def _completions_on_processes(function: Callable[[Parameters], TaskResult], tasks: Sequence[Parameters]) -> Completions:
    """Yield index and future of each task as it completes, on a process a core.

    A process that is lost breaks its pool, and which of the running tasks it had is unknown: each of these runs again
    when the others are done, in a pool of its own.
    """
    suspect_indices: list[int] = []
    waiting_indices = deque(range(len(tasks)))
    while waiting_indices:
        for task_index, future in _completions_on_pool(function, tasks, waiting_indices, os.cpu_count() or 1):
            if _has_lost_process(future):
                suspect_indices.append(task_index)
            else:
                yield task_index, future
    for task_index in suspect_indices:
        for _ in range(MAX_LOST_PROCESSES - 1):
            ((_, future),) = _completions_on_pool(function, tasks, deque([task_index]), 1)
            if not _has_lost_process(future):
                break
        else:
            loss_reason = f"its process was lost {MAX_LOST_PROCESSES} times (out of memory?)"
            future = Future()
            future.set_exception(RigError(f"{loss_reason}; run the command again to go on"))
        yield task_index, future


def _completions_on_pool(
    function: Callable[[Parameters], TaskResult],
    tasks: Sequence[Parameters],
    waiting_indices: deque[int],
    process_count: int,
) -> Completions:
    """Yield index and future of waiting tasks, of which as many run as there are processes, until the pool breaks."""
    earlier_processes = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(process_count, initializer=_prepare_process)
    index_by_future: dict[Future[Any], int] = {}
    is_broken = False
    try:
        while True:
            try:
                while waiting_indices and not is_broken and len(index_by_future) < process_count:
                    future = pool.submit(_run_on_one_thread, function, tasks[waiting_indices[0]])
                    index_by_future[future] = waiting_indices.popleft()
            except BrokenProcessPool:
                is_broken = True
            if not index_by_future:
                return
            for future in wait(index_by_future, return_when=FIRST_COMPLETED).done:
                is_broken = is_broken or _has_lost_process(future)
                yield index_by_future.pop(future), future
    except BaseException:
        for process in set(multiprocessing.active_children()) - earlier_processes:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _has_lost_process(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _prepare_process() -> None:
    """Let signals end the process at once, without a traceback, and let it end with the one that started it."""
    os.environ["LOKY_MAX_CPU_COUNT"] = "1"  # as the tasks run on every core
    for signal_name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, signal_name) and signal.getsignal(getattr(signal, signal_name)) != signal.SIG_IGN:
            signal.signal(getattr(signal, signal_name), signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if parent := multiprocessing.parent_process():
        parent.join()
        os._exit(1)


def _run_on_one_thread(function: Callable[[Parameters], TaskResult], parameters: Parameters) -> TaskResult:
    """Result of a task, computed on one thread, as a task runs on every core."""
    with threadpool_limits(1):
        return function(parameters)
