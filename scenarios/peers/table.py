"""Table of the methods: errors, intervals and seconds over the recordings of each rig, as rows of text."""

from collections.abc import Sequence

import msgspec
import numpy as np

from scenarios.peers.given import ContactAnswer

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
    pairs = [pair for o in outcomes for pair in zip(o.answers, o.true, strict=False)]
    return (
        [100 * abs(a.clearance_m / d - 1) for a, (d, _) in pairs if a.clearance_m is not None],
        [100 * abs(a.stiffness_n_per_m / k - 1) for a, (_, k) in pairs],
    )


def covering(outcomes: Sequence[PeerOutcome]) -> tuple[int, int]:
    """Number of intervals that hold the true value, and of all intervals."""
    inside = []
    for outcome in outcomes:
        for answer, (clearance_m, stiffness_n_per_m) in zip(outcome.answers, outcome.true, strict=False):
            if answer.clearance_m is not None and answer.clearance_reach_m is not None:
                inside.append(abs(answer.clearance_m - clearance_m) <= answer.clearance_reach_m)
            if answer.stiffness_reach_n_per_m is not None:
                inside.append(abs(answer.stiffness_n_per_m - stiffness_n_per_m) <= answer.stiffness_reach_n_per_m)
    return sum(inside), len(inside)


def row(title: str, prior_knowledge: str, outcomes: Sequence[PeerOutcome]) -> tuple[str, ...]:
    """Row of one method on one rig: median and largest errors, intervals, mean seconds of the CPU."""
    answered = [o for o in outcomes if not o.failure]
    clearance, stiffness = errors_percent(answered)
    covered, intervals = covering(answered)
    failed = f" ({len(outcomes) - len(answered)} of {len(outcomes)} failed)" if len(answered) < len(outcomes) else ""
    return (
        outcomes[0].trial.rig,
        title + failed,
        _median_and_largest(clearance) if clearance else "told",
        _median_and_largest(stiffness),
        f"{covered} of {intervals}" if intervals else "none",
        f"{float(f'{np.mean([o.cpu_s for o in answered]):.2g}'):g}" if answered else "",
        prior_knowledge,
    )


def _median_and_largest(errors: Sequence[float]) -> str:
    return f"{np.median(errors):.2g}, {max(errors):.2g}" if len(errors) else ""
