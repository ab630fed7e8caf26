"""Table of the methods: errors, intervals and seconds over the recordings of each rig, as rows of text."""

from collections.abc import Sequence

import msgspec
import numpy as np

from scenarios.peers.peer_data import ContactAnswer

HEADINGS = ("rig", "method", "clearance error, %", "stiffness error, %", "intervals that cover", "CPU, s", "told")


class PeerTrial(msgspec.Struct, frozen=True):
    """One method on one recording."""

    method: str
    rig: str
    seed: int


class PeerOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """Answers of a method to one recording beside the true values, or the reason why there are none."""

    trial: PeerTrial
    versions: str
    true: tuple[tuple[float, float], ...]
    """Clearance (m) and stiffness (N/m) of each contact."""
    answers: tuple[ContactAnswer, ...] = ()
    cpu_s: float = 0.0
    failure: str = ""


def errors_percent(outcomes: Sequence[PeerOutcome]) -> tuple[list[float], list[float]]:
    """Sizes of the errors of all clearances and of all stiffnesses, in per cent of the true values."""
    pairs = [pair for outcome in outcomes for pair in zip(outcome.answers, outcome.true, strict=False)]
    return (
        [100 * abs(a.clearance_m / d - 1) for a, (d, _) in pairs if a.clearance_m is not None],
        [100 * abs(a.stiffness_n_per_m / k - 1) for a, (_, k) in pairs],
    )


def coverage_counts(outcomes: Sequence[PeerOutcome]) -> tuple[int, int]:
    """Number of intervals that hold the true value, and of all intervals."""
    is_covered = []
    for outcome in outcomes:
        for answer, (true_m, true_n_per_m) in zip(outcome.answers, outcome.true, strict=False):
            if answer.clearance_m is not None and answer.clearance_half_width_m is not None:
                is_covered.append(abs(answer.clearance_m - true_m) <= answer.clearance_half_width_m)
            if answer.stiffness_half_width_n_per_m is not None:
                is_covered.append(abs(answer.stiffness_n_per_m - true_n_per_m) <= answer.stiffness_half_width_n_per_m)
    return sum(is_covered), len(is_covered)


def row(title: str, prior_knowledge: str, outcomes: Sequence[PeerOutcome]) -> tuple[str, ...]:
    """Row of one method on one rig: median and largest errors, intervals, mean seconds of the CPU."""
    succeeded = [outcome for outcome in outcomes if not outcome.failure]
    clearance_errors, stiffness_errors = errors_percent(succeeded)
    covered_count, interval_count = coverage_counts(succeeded)
    failed_count = len(outcomes) - len(succeeded)
    failure_note = f" ({failed_count} of {len(outcomes)} failed)" if failed_count else ""
    return (
        outcomes[0].trial.rig,
        title + failure_note,
        _median_and_largest(clearance_errors) if clearance_errors else "told",
        _median_and_largest(stiffness_errors),
        f"{covered_count} of {interval_count}" if interval_count else "none",
        f"{float(f'{np.mean([o.cpu_s for o in succeeded]):.2g}'):g}" if succeeded else "",
        prior_knowledge,
    )


def _median_and_largest(errors: Sequence[float]) -> str:
    return f"{np.median(errors):.2g}, {max(errors):.2g}" if len(errors) else ""
