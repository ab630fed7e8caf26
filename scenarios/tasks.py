"""Running many tasks: pure functions of their parameters, spread over processes, each result kept on disk."""

import hashlib
import importlib.metadata
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TypeVar

import msgspec
from threadpoolctl import threadpool_limits

from rig.command_line import progress_bar

Parameters = TypeVar("Parameters", bound=msgspec.Struct)
Result = TypeVar("Result", bound=msgspec.Struct)


def run_tasks(
    function: Callable[[Parameters], Result],
    parameters: Sequence[Parameters],
    result_type: type[Result],
    folder: Path,
    executor: Executor | None = None,
) -> list[Result]:
    """The results of a function for each set of parameters, in their order.

    A result is kept in the folder under a hash of the function's name, its parameters and this package's version, and
    not computed again. By default one process a core, with one thread, runs the tasks; any executor will do.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{_key(function, p)}.json" for p in parameters]
    missing = [(p, path) for p, path in zip(parameters, paths, strict=True) if not path.exists()]
    if missing:
        pool = executor or ProcessPoolExecutor(os.cpu_count(), initializer=threadpool_limits, initargs=(1,))
        with progress_bar(f"{len(missing)} of {len(parameters)} tasks") as progress:
            try:
                waiting = {pool.submit(function, p): path for p, path in missing}
                for done, future in enumerate(as_completed(waiting), start=1):
                    _keep(future.result(), waiting[future])
                    progress(done / len(missing))
            finally:
                if executor is None:
                    pool.shutdown(cancel_futures=True)
    return [msgspec.json.decode(path.read_bytes(), type=result_type) for path in paths]


def _key(function: Callable[[Parameters], Result], parameters: Parameters) -> str:
    name = f"{function.__module__}.{function.__qualname__} {importlib.metadata.version('rig-identify')}"
    return hashlib.sha256(name.encode() + msgspec.json.encode(parameters)).hexdigest()[:24]


def _keep(result: Result, path: Path) -> None:
    part = path.with_suffix(".part")
    part.write_bytes(msgspec.json.encode(result))
    part.replace(path)
