"""Refits of an estimate, with its weights and its linearisation, until it no longer changes."""

from collections.abc import Callable
from typing import TypeVar

Estimate = TypeVar("Estimate")


def never(_before: Estimate, _after: Estimate) -> bool:
    """Criterion of a fixed number of refits."""
    return False


def refit_until_settled(
    estimate: Estimate,
    refit: Callable[[Estimate], Estimate],
    settled: Callable[[Estimate, Estimate], bool] = never,
    *,
    rounds: int,
    at_least: int = 0,
) -> Estimate:
    """Fixed point x of x_(k+1) = refit(x_k), to the tolerance of `settled(x_k, x_(k+1))`.

    At most `rounds` refits are made, and `at_least` so many whatever `settled` says. To keep only improvements, let
    `refit` return the estimate that it was given if the new one is no better: no change counts as settled.
    """
    for count in range(1, rounds + 1):
        before, estimate = estimate, refit(estimate)
        if count >= at_least and settled(before, estimate):
            break
    return estimate
