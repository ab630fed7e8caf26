"""What every benchmark returns, and how CPU time is taken."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A measured figure; with a target it passes at `at_least` or above, or at `at_most` or below."""

    name: str
    value: float
    unit: str = ""
    at_least: float | None = None
    at_most: float | None = None

    @property
    def target(self) -> str:
        if self.at_least is not None:
            return f"at least {self.at_least:g}"
        return "" if self.at_most is None else f"at most {self.at_most:g}"

    @property
    def verdict(self) -> str:
        if not self.target:
            return ""
        met = self.value >= self.at_least if self.at_least is not None else self.value <= self.at_most
        return "met" if met else "MISSED"


def least_cpu_s(work: Callable[[], object], times: int = 3) -> float:
    """CPU seconds of this process, the least of several runs: what disturbs a run only adds to it."""
    return min(_cpu_s(work) for _ in range(times))


def _cpu_s(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin
