"""Mutated files by the thousand, and what answers from them: python -m tests.fuzz --cases 20000 --seed 1.

Every case ends in the right numbers or in one sentence, within 10 s of the processor and the memory that its files may
take: 300 MB and 8 times their size (rig/limits.py). What does not is listed with its number, by which it is run again
alone, in this process: --only NUMBER.
"""

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter, defaultdict
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import numpy as np

LONGEST_S = 10
MOST_BYTES = 10**9
ONE_WORKERS = 4000
"""Cases, before another process goes on: what they leave of a heap counts as memory."""
ALONE = {"OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
"""Threads would be given memory that they never use, which counts."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="The number of one case.")
    parser.add_argument("--keep", type=Path, help="Folder for the files of that case.")
    parser.add_argument("--work", type=int, nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.work:
        _work(asked.seed, range(*asked.work))
    elif asked.only is not None:
        with TemporaryDirectory() as folder:
            place = asked.keep or Path(folder)
            place.mkdir(parents=True, exist_ok=True)
            print(_run(asked.seed, asked.only, place))
    else:
        sys.exit(_all(asked.seed, asked.cases))


def _all(seed: int, cases: int) -> int:
    """Runs all cases in worker processes, one after the other, and prints what became of them."""
    begin, counts, slowest, faults = time.monotonic(), defaultdict(Counter), Counter(), []
    largest, first = 0, 0
    while first < cases:
        words = [
            sys.executable,
            "-m",
            "tests.fuzz",
            "--seed",
            str(seed),
            "--work",
            str(first),
            str(min(first + ONE_WORKERS, cases)),
        ]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=os.environ | ALONE) as worker:
            printed = ""
            for line in worker.stdout:
                if not line.startswith('["'):  # as LAPACK does of what is not finite
                    printed += line
                    continue
                kind, outcome, seconds, size = json.loads(line)
                outcome, printed = f"prints {printed!r}" if printed else outcome, ""
                counts[kind][outcome if outcome in ("right", "refused") else "FAULT"] += 1
                slowest[kind], largest = max(slowest[kind], seconds), max(largest, size)
                if outcome not in ("right", "refused"):
                    faults.append(f"case {first} ({kind}): {outcome}")
                    print(faults[-1], file=sys.stderr, flush=True)
                first += 1
        if worker.returncode:
            from tests.fuzz.cases import CYCLE

            died = (
                "it ran too long"
                if -worker.returncode in (signal.SIGPROF, signal.SIGALRM)
                else f"ended by {worker.returncode}"
            )
            kind = CYCLE[first % len(CYCLE)]
            counts[kind]["FAULT"] += 1
            faults.append(f"case {first} ({kind}): {died}")
            print(faults[-1], file=sys.stderr, flush=True)
            first += 1
    print("| files | cases | right | refused | faults | slowest, CPU s |\n|---|---|---|---|---|---|")
    for kind, found in counts.items():
        row = (sum(found.values()), found["right"], found["refused"], found["FAULT"], f"{slowest[kind]:.2g}")
        print(f"| {kind} | " + " | ".join(map(str, row)) + " |")
    print(
        f"{sum(sum(c.values()) for c in counts.values())} cases of seed {seed} in {time.monotonic() - begin:.0f} s, "
        f"{len(faults)} faults, at most {largest / 1e6:.0f} MB"
    )
    return 1 if faults else 0


def _work(seed: int, numbers: range) -> None:
    """Runs cases in this process, which ends if one needs too long, and prints a line of JSON for each."""
    from tests.fuzz import judging
    from tests.fuzz.cases import BARREL, CYCLE, KINDS, SDOF, simulate

    with TemporaryDirectory() as folder:  # what is compiled once is no case's time or memory
        for kind in KINDS.values():
            with suppress(AssertionError):  # judged as a case
                kind(np.random.default_rng(0), Path(mkdtemp(dir=folder)))
        for rig in (SDOF, BARREL):
            simulate(rig, Path(folder) / "warm.mcap")
    judging.largest_bytes = 0
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, used + MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES, MOST_BYTES))
    for number in numbers:
        with TemporaryDirectory() as folder:
            signal.setitimer(signal.ITIMER_PROF, LONGEST_S)  # of this process, however busy the machine is
            signal.alarm(10 * LONGEST_S)
            begin = time.process_time()
            outcome = _run(seed, number, Path(folder))
            seconds = time.process_time() - begin
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.alarm(0)
        print(json.dumps([CYCLE[number % len(CYCLE)], outcome, seconds, judging.largest_bytes]), flush=True)


def _run(seed: int, number: int, folder: Path) -> str:
    from tests.fuzz.cases import CYCLE, KINDS

    work = KINDS[CYCLE[number % len(CYCLE)]]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a warning is printed, and is no sentence
            warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves the file open that it cannot write
            return work(np.random.default_rng([seed, number]), folder)
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        mine = [f for f in frames if f.filename.startswith((f"{Path.cwd()}/rig/", f"{Path.cwd()}/identify/"))] or frames
        place = f"{Path(mine[-1].filename).name}:{mine[-1].lineno}"
        return f"{type(error).__name__} at {place}: {str(error)[:400]}"


if __name__ == "__main__":
    main()
