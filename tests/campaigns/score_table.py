"""The scoreboard as a table: a row a rate, a column a world."""

from collections.abc import Mapping

from rich.table import Table

from tests.campaigns.calibration import Calibration, Reliability, Tempered
from tests.campaigns.scoreboard import Rate, Score


def shown(boards: Mapping[str, Score], title: str) -> Table:
    """The scoreboards of several worlds side by side."""
    table = Table(title=title)
    table.add_column("")
    for name, board in boards.items():
        table.add_column(f"{name}, {board.cases} cases", justify="right")
    several = boards.values()
    for rates in zip(*(board.rates for board in several), strict=True):
        table.add_row(rates[0].name, *(_told(rate) for rate in rates))
    table.add_row("false names a case", *(_a_case(b.false_names) for b in several))
    table.add_row("CPU time of a case, median, largest", *(_seconds(b.cpu_s_median, b.cpu_s_largest) for b in several))
    made = [_seconds(b.null_reference_cpu_s_median, b.null_reference_cpu_s_largest) for b in several]
    table.add_row("CPU time of a null reference made", *made)
    memory = [b.memory_mib_largest for b in several]
    table.add_row("largest memory", *("none" if mib is None else f"{mib:.0f} MiB" for mib in memory))
    return table


def _told(rate: Rate) -> str:
    """So many of so many, the share and its interval."""
    if not rate.of:
        return "none"
    low, high = (100 * x for x in rate.interval_95)
    return f"{rate.count} of {rate.of}, {100 * rate.count / rate.of:.0f} % ({low:.0f} to {high:.0f})"


def _a_case(rate: Rate) -> str:
    low, high = rate.interval_95
    return f"{rate.count} in {rate.of}, {rate.count / rate.of:.2f} ({low:.2f} to {high:.2f})"


def _seconds(median: float | None, largest: float | None) -> str:
    return "none" if median is None or largest is None else f"{median:.0f} s, {largest:.0f} s"


def limits_told(board: Score) -> str:
    """The detection limits in one line."""
    return ", ".join(f"{name} {limit:.2g}" for name, limit in board.limits.items())


def calibration_told(found: Calibration) -> str:
    """Reliability, Brier scores, and the p-values of nulls, in one line."""
    nulls = found.nulls
    uniform = f"D = {nulls.distance:.3f}, p = {nulls.p_value:.2g} of {nulls.cases}" if nulls else "none"
    return (
        f"effects of the likeliest set, there by inclusion probability: {_reliability(found.inclusion)}; "
        f"likeliest hypothesis, right by probability: {_reliability(found.sets)}; "
        f"p-values of nulls against uniform ones (Kolmogorov-Smirnov): {uniform}"
    )


def _reliability(found: Reliability | None) -> str:
    if found is None:
        return "none"
    bins = ", ".join(f"{b.probability:.2f}: {b.right} of {b.of}" for b in found.bins)
    return f"{bins}, Brier score {found.brier:.3f}"


def temperature_told(found: Tempered) -> str:
    """The calibrated temperature in one line."""
    return (
        f"temperature {found.temperature:.3g} ({found.interval_95[0]:.3g} to {found.interval_95[1]:.3g}): mean ln "
        f"probability of what is right {found.mean_log_probability:.3f}, "
        f"at present {found.at_present:.3f}; {found.cases} cases, of {found.without} more it was not judged"
    )
