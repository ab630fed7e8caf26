"""Running many tasks: pure functions of their parameters, spread over processes, each result kept on disk."""

import hashlib
import importlib.metadata
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import typer
from threadpoolctl import threadpool_limits

from rig.commands.command_line import progress_bar
from rig.errors import RigError
from rig.extras import needs_extra
from rig.files import write_bytes

Parameters = TypeVar("Parameters", bound=msgspec.Struct)
Result = TypeVar("Result", bound=msgspec.Struct)
Dask = Annotated[
    str | None, typer.Option("--dask", help="Address of a dask scheduler, or local; by default a process a core.")
]
LOSSES = 3
"""So many times a process may be lost, which loses its own task alone, before the tasks are given up."""


def run_tasks(
    function: Callable[[Parameters], Result],
    parameters: Sequence[Parameters],
    result_type: type[Result],
    folder: Path,
    dask: str | None = None,
) -> list[Result]:
    """The results of a function for each set of parameters, in their order.

    A result is kept in the folder under a hash of the function's name, its parameters and this package's version, and
    not computed again. Processes of one thread each run the tasks: one a core, or those of `dask`. A task that fails
    does not stop the others; the first failure is raised at the end. Raises RigError if processes keep being lost, or
    no such scheduler answers.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{_key(function, p)}.json" for p in parameters]
    for _ in range(LOSSES):
        missing = [(p, path) for p, path in zip(parameters, paths, strict=True) if not path.exists()]
        if not missing:
            break
        with _executor(dask) as executor, progress_bar(f"{len(missing)} of {len(parameters)} tasks") as progress:
            waiting = {executor.submit(_alone, function, p): path for p, path in missing}
            for done, future in enumerate(as_completed(waiting), start=1):
                if future.exception() is None:
                    write_bytes(msgspec.json.encode(future.result()), waiting[future])
                progress(done / len(missing))
        errors = [error for future in waiting if (error := future.exception())]
        if any(isinstance(error, BrokenProcessPool) for error in errors):
            continue  # with what is still missing
        if errors:
            raise errors[0]
    else:
        raise RigError(f"{folder}: processes were lost {LOSSES} times (out of memory?); run the command again to go on")
    return [msgspec.json.decode(path.read_bytes(), type=result_type) for path in paths]


@contextmanager
def _executor(dask: str | None) -> Iterator[Executor]:
    if dask is None:
        processes = ProcessPoolExecutor(os.cpu_count())
        try:
            yield processes
        finally:
            processes.shutdown(cancel_futures=True)
        return
    with needs_extra("cluster", "--dask"):
        from distributed import Client
    local = {"n_workers": os.cpu_count(), "threads_per_worker": 1, "dashboard_address": None}
    try:
        client = Client(**local) if dask == "local" else Client(dask, timeout=10)
    except (OSError, ValueError) as error:
        raise RigError(f"--dask {dask}: no scheduler answers there ({error}); start one, or give local") from error
    with client:
        yield client.get_executor(retries=LOSSES)


def _alone(function: Callable[[Parameters], Result], parameters: Parameters) -> Result:
    """On one thread: as many tasks as cores run beside one another."""
    with threadpool_limits(1):
        return function(parameters)


def _key(function: Callable[[Parameters], Result], parameters: Parameters) -> str:
    name = f"{function.__module__}.{function.__qualname__} {importlib.metadata.version('rig-identify')}"
    return hashlib.sha256(name.encode() + msgspec.json.encode(parameters)).hexdigest()[:24]
