"""What every stage of a diagnosis costs: CPU time and peak memory of blind cases, each in a process of its own.

python -m tests.campaigns.stage_costs out/blind/recordings/case_003.mcap --null-references-of out/found/null_references
"""

import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Annotated, TypeVar

import typer
from rich.console import Console
from rich.table import Table

from rig.commands.command_line import run

STAGES = ("imports and reading", "preparation", "search", "judgement", "description", "page")
app = typer.Typer(pretty_exceptions_enable=False)
Result = TypeVar("Result")


@dataclass
class StageCosts:
    """Verdict, CPU seconds and peak memory (MB) of one diagnosis by its stages."""

    verdict: str = ""
    cpu_s: dict[str, float] = field(default_factory=dict)
    peak_mb: dict[str, float] = field(default_factory=dict)

    def total_cpu_s(self) -> float:
        return sum(self.cpu_s.values())

    def total_peak_mb(self) -> float:
        return max(self.peak_mb.values())

    def measured(self, stage: str, work: Callable[[], Result]) -> Result:
        """Result of a stage, whose costs are kept; the first one's count from the start of the process."""
        begun_s = time.process_time() if self.cpu_s else 0.0
        _forget_peak()
        result = work()
        self.cpu_s[stage], self.peak_mb[stage] = time.process_time() - begun_s, peak_mb()
        return result


@app.command()
def stage_costs(
    recordings: Annotated[list[Path], typer.Argument(help="Fitted recordings of blind cases, NAME.mcap each.")],
    null_references_of: Annotated[
        Path | None, typer.Option(help="Folder of null references; what lacks there is made, in `preparation`.")
    ] = None,
) -> None:
    """Diagnoses every case in a fresh process with one thread, and prints what each stage takes."""
    for library in ("OPENBLAS", "OMP", "MKL"):  # CPU time counts threads that wait
        os.environ[f"{library}_NUM_THREADS"] = "1"
    os.environ["LOKY_MAX_CPU_COUNT"] = "1"
    costs = [costs_apart(path, null_references_of) for path in recordings]
    table = Table(title="CPU s, and peak memory in MB, by stage")
    for heading in ("case", "verdict", *STAGES, "all"):
        table.add_column(heading, justify="left" if heading in ("case", "verdict") else "right")
    for path, cost in zip(recordings, costs, strict=True):
        cells = [f"{cost.cpu_s[stage]:.1f}, {cost.peak_mb[stage]:.0f}" for stage in STAGES]
        total = f"{cost.total_cpu_s():.1f}, {cost.total_peak_mb():.0f}"
        table.add_row("/".join(path.with_suffix("").parts[-4::3]), cost.verdict, *cells, total)
    console = Console() if sys.stdout.isatty() else Console(width=170)
    console.print(table)
    cpu_s, peak_mb = (median(f(c) for c in costs) for f in (StageCosts.total_cpu_s, StageCosts.total_peak_mb))
    console.print(f"median of {len(costs)} cases: {cpu_s:.1f} s, {peak_mb:.0f} MB")


def costs_apart(path: Path, null_references: Path | None) -> StageCosts:
    """Costs of one case in a process of its own, so that time and memory are its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes:
        return processes.submit(costs_of, path, null_references).result()


def costs_of(path: Path, null_references: Path | None) -> StageCosts:
    """Costs of the diagnosis of NAME.mcap, validated on NAME_validate.mcap."""
    costs = StageCosts()
    from identify.gaps.decision import answer, judge, prepare
    from identify.gaps.page.report import write_all
    from rig.recording import read

    validate = path.with_name(f"{path.stem}_validate.mcap")
    fit, held = costs.measured(STAGES[0], lambda: (read(path), read(validate)))
    simulator = prepare.simulator_named("modal")
    prepared = costs.measured(
        STAGES[1], lambda: prepare.prepare_recordings(fit, held, simulator, null_references, None)
    )
    found = costs.measured(STAGES[2], lambda: prepare.search(prepared))
    judgement = costs.measured(STAGES[3], lambda: judge.judge(prepared, found, answer.DEFAULT_MATTERS))
    gap = costs.measured(STAGES[4], lambda: answer.describe(prepared, found, judgement, answer.DEFAULT_MATTERS))
    corrected = judgement.decision.corrected_rig or fit.rig
    with TemporaryDirectory() as folder:
        costs.measured(STAGES[5], lambda: write_all(gap, corrected, path.stem, Path(folder), (path, validate), ()))
    costs.verdict = gap.verdict
    return costs


def _forget_peak() -> None:
    """Let the peak of the resident memory begin anew."""
    Path("/proc/self/clear_refs").write_text("5")


def peak_mb() -> float:
    """Peak of this process's resident memory: `ru_maxrss` also counts its parent's before it was started."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return float(line.split()[1]) / 1e3


if __name__ == "__main__":
    run(import_module("tests.campaigns.stage_costs").app, "tests.campaigns.stage_costs")
