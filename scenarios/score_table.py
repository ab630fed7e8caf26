"""The scoreboard as a table: a row a rate, a column a world."""

from collections.abc import Mapping

from rich.table import Table

from scenarios.calibration import Calibration, Tempered
from scenarios.scoreboard import Rate, Score


def shown(boards: Mapping[str, Score], title: str) -> Table:
    """The scoreboards of several worlds side by side."""
    table = Table(title=title)
    table.add_column("")
    for name, board in boards.items():
        table.add_column(f"{name}, {board.cases} cases", justify="right")
    for rates in zip(*(board.rates for board in boards.values()), strict=True):
        table.add_row(rates[0].name, *(_told(rate) for rate in rates))
    several = boards.values()
    table.add_row("closed, of what the true effect closes, median", *(_closure(b) for b in several))
    table.add_row(
        "CPU time of a case, median, largest", *(f"{b.cpu_s_median:.0f} s, {b.cpu_s_largest:.0f} s" for b in several)
    )
    table.add_row("CPU time of a null reference", *(_null_reference(b) for b in several))
    table.add_row("largest memory", *(f"{b.memory_mib_largest:.0f} MiB" for b in several))
    return table


def _told(rate: Rate) -> str:
    """So many of so many, the share and its interval."""
    if not rate.of:
        return "none"
    low, high = (100 * x for x in rate.interval_95)
    return f"{rate.count} of {rate.of}, {100 * rate.count / rate.of:.0f} % ({low:.0f} to {high:.0f})"


def limits_told(board: Score) -> str:
    """The detection limits in one line."""
    return ", ".join(f"{name} {limit:.2g}" for name, limit in board.limits.items())


def calibration_told(found: Calibration) -> str:
    """The reliability and the Brier scores in one line."""
    bins = "; ".join(f"{b.probability:.2f}: {b.right} of {b.of}" for b in found.bins)
    whole = f"{found.brier_whole:.3f} with effects below their limits"
    return (
        f"right by probability: {bins}. Brier score {found.brier:.3f} ({whole}), rule before {found.brier_before:.3f}"
    )


def temperature_told(found: Tempered) -> str:
    """The calibrated temperature in one line."""
    return (
        f"temperature {found.temperature:.3g}: mean ln probability of what is right {found.mean_log_probability:.3f}, "
        f"at present {found.at_present:.3f}; the Brier score is least at {found.by_brier:.2g}; "
        f"{found.cases} cases, of {found.without} more it was not judged"
    )


def _closure(board: Score) -> str:
    return (
        "none"
        if board.share_of_true_closure is None
        else f"{100 * board.share_of_true_closure:.1f} % of {board.closures}"
    )


def _null_reference(board: Score) -> str:
    if board.null_reference_cpu_s_median is None:
        return "made before"
    return f"{board.null_reference_cpu_s_median:.0f} s, {board.null_reference_cpu_s_largest:.0f} s"
