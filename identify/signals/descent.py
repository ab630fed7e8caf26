"""The one Gauss-Newton: steps of a problem that is linearised anew, each cut back until the cost falls."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

TRIES = 6
"""Of a step, shorter and shorter, until the cost falls."""


@runtime_checkable
class Costly(Protocol):
    """State of a fit: its parameters, and the sum of squares at them."""

    @property
    def cost(self) -> float: ...


State = TypeVar("State", bound=Costly)


@dataclass(frozen=True)
class Step(Generic[State]):
    """Step of a linearisation: the state after a share of it, None where there is no such state.

    promised is what the whole step takes off the cost if the linearisation holds.
    """

    after: Callable[[float], State | None]
    promised: float


StepOf = TypeVar("StepOf", bound=Step[Any])


def descended(
    start: State, step_from: Callable[[State], StepOf], least_fall: Callable[[State], float], most: int
) -> tuple[State, StepOf]:
    """The state at which the cost is least, by at most so many steps, and the last step that was tried.

    A step that does not lower the cost is cut to the least of the parabola through both costs with the slope at its
    beginning. The last step is a whole one, or the second in a row, by which the cost falls by less than `settled`
    says.
    """
    at, cost, slow = start, start.cost, 0
    for _ in range(most):
        step, share, least = step_from(at), 1.0, least_fall(at)
        there, fell = None, -np.inf
        for _ in range(TRIES):
            there = step.after(share)
            fell = cost - there.cost if there is not None else -np.inf
            if fell > 0 or step.promised < least:
                break
            share *= np.clip(step.promised * share / (2 * step.promised * share - fell), 0.1, 0.5)
        if there is None or not fell > 0:
            break
        at, cost = there, cost - fell
        slow = slow + 1 if fell < least else 0
        if slow and (share == 1 or slow == 2):
            break
    return at, step
