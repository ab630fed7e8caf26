"""Runs every benchmark and prints their figures side by side: python -m tests.benchmarks [--only NAME] [--out FILE]."""

import argparse
import os
import platform
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

for _library in ("OPENBLAS", "OMP", "MKL"):  # before numpy: CPU time counts threads that wait
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

BENCHMARKS = ("modal_plant", "ancf_plant", "nifo", "recording", "simulating", "diagnosis")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("--only", choices=BENCHMARKS, action="append", help="Run this one alone; may be repeated.")
    parser.add_argument("--out", type=Path, help="Write the table to this file too (Markdown).")
    asked = parser.parse_args()
    lines = [*_machine(), "", "| benchmark | figure | value | target | |", "|---|---|---|---|---|"]
    print("\n".join(lines), flush=True)
    for name in asked.only or BENCHMARKS:
        for figure in import_module(f"tests.benchmarks.{name}").figures():
            value = f"{figure.value:.3g} {figure.unit}".strip()
            lines.append(f"| {name} | {figure.name} | {value} | {figure.target} | {figure.verdict} |")
            print(lines[-1], flush=True)
    if asked.out:
        asked.out.write_text("\n".join(lines) + "\n")


def _machine() -> list[str]:
    packages = ("numpy", "scipy", "numba", "exudyn", "mcap")
    return [
        f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}",
        f"Python {platform.python_version()}, " + ", ".join(f"{p} {version(p)}" for p in packages),
        "CPU seconds of one process with one BLAS thread, the least of several runs.",
    ]


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or "unknown processor"
    return next((line.split(":")[1].strip() for line in text.splitlines() if line.startswith("model name")), "unknown")


if __name__ == "__main__":
    main()
