"""The one loop of refits: an estimate, its weights and its linearisation renewed by each other until they stand."""

from collections.abc import Callable
from typing import TypeVar

Estimate = TypeVar("Estimate")


def never(_before: Estimate, _after: Estimate) -> bool:
    """The criterion of a fixed number of refits."""
    return False


def refit_until_settled(
    estimate: Estimate,
    refit: Callable[[Estimate], Estimate],
    settled: Callable[[Estimate, Estimate], bool] = never,
    *,
    rounds: int,
    at_least: int = 0,
) -> Estimate:
    """The fixed point x of x_(k+1) = refit(x_k), to the tolerance of `settled(x_k, x_(k+1))`.

    At most `rounds` refits are made, and `at_least` so many whatever `settled` says. To keep only what improves, let
    `refit` return the estimate it was given where the new one is no better: no change is a settled one.
    """
    for count in range(1, rounds + 1):
        before, estimate = estimate, refit(estimate)
        if count >= at_least and settled(before, estimate):
            break
    return estimate
