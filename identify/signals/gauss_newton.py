"""Gauss-Newton with a line search: each step of the linearised problem is shortened until the cost falls."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

MAX_STEP_LENGTHS = 6
"""Lengths of a step that are tried, shorter and shorter, until the cost falls."""


@runtime_checkable
class HasCost(Protocol):
    """State of a fit: its parameters, with the sum of squares as its cost."""

    @property
    def cost(self) -> float: ...


State = TypeVar("State", bound=HasCost)


@dataclass(frozen=True)
class Step(Generic[State]):
    """Step of a linearisation: the state after a share of it, or None where there is no such state.

    predicted_decrease is the fall of the cost by the whole step if the linearisation holds.
    """

    state_after: Callable[[float], State | None]
    predicted_decrease: float


StepOf = TypeVar("StepOf", bound=Step[Any])


def gauss_newton(
    initial_state: State,
    linearize: Callable[[State], StepOf],
    min_cost_fall_of: Callable[[State], float],
    max_steps: int,
    negligible_fall_share: float = 0.0,
) -> tuple[State, StepOf]:
    """State with the least cost after at most `max_steps` steps, and the last step that was tried.

    A step that does not lower the cost is shortened to the minimum of the parabola through both costs with the slope at
    its beginning. The iteration stops after a whole step, or a second step in a row, by which the cost falls by less
    than `min_cost_fall_of` the state before it, and before a step that promises less than `negligible_fall_share` of
    that.
    """
    state, cost, slow_step_count = initial_state, initial_state.cost, 0
    for _ in range(max_steps):
        step, step_share, min_cost_fall = linearize(state), 1.0, min_cost_fall_of(state)
        if step.predicted_decrease < negligible_fall_share * min_cost_fall:
            break
        candidate_state, cost_fall = None, -np.inf
        for _ in range(MAX_STEP_LENGTHS):
            candidate_state = step.state_after(step_share)
            cost_fall = cost - candidate_state.cost if candidate_state is not None else -np.inf
            if cost_fall > 0 or step.predicted_decrease < min_cost_fall:
                break
            predicted_decrease = step.predicted_decrease * step_share
            step_share *= np.clip(predicted_decrease / (2 * predicted_decrease - cost_fall), 0.1, 0.5)
        if candidate_state is None or not cost_fall > 0:
            break
        state, cost = candidate_state, cost - cost_fall
        slow_step_count = slow_step_count + 1 if cost_fall < min_cost_fall else 0
        if slow_step_count and (step_share == 1 or slow_step_count == 2):
            break
    return state, step
