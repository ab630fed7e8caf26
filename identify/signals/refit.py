"""Refits of an estimate, with its weights and its linearisation, until it no longer changes."""

from collections.abc import Callable
from typing import TypeVar

Estimate = TypeVar("Estimate")


def never_settled(_previous: Estimate, _next: Estimate) -> bool:
    """Criterion of a fixed number of refits."""
    return False


def refit_until_settled(
    estimate: Estimate,
    refit: Callable[[Estimate], Estimate],
    is_settled: Callable[[Estimate, Estimate], bool] = never_settled,
    *,
    max_rounds: int,
    min_rounds: int = 0,
) -> Estimate:
    """Fixed point x of x_(k+1) = refit(x_k), to the tolerance of `is_settled(x_k, x_(k+1))`.

    At most `max_rounds` refits are made, at least `min_rounds` whatever `is_settled` says. To keep only improvements,
    let `refit` return the estimate that it was given if the new one is no better: no change counts as settled.
    """
    for round_number in range(1, max_rounds + 1):
        previous = estimate  # the one before it, which may be large, is let go first
        estimate = refit(previous)
        if round_number >= min_rounds and is_settled(previous, estimate):
            break
    return estimate
