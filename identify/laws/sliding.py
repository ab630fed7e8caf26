"""Dry friction behind a backlash: a law with a memory, f of the course of eta rather than of eta."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from identify.laws.piecewise import Course, LawWithMemory, Rows, Sampled
from identify.signals.scores import part_scores

BACKLASHES, STIFFNESSES = (0.02, 0.1, 0.3, 0.6), (3.0, 10.0, 40.0)
"""Starts: the backlash in ranges of eta, and the stiffness in ranges of the force over those of eta."""
FIRST, ROUGH = 3, 1e-2
"""So many of the starts are followed until the sum of squares falls by a smaller share; then the best to the end."""
SLIDES = 0.85
"""The quantile of the force either way from which its sliding force starts."""
STEP = 1e-3


@dataclass(frozen=True)
class SlidingFriction(LawWithMemory):
    """A slider that rubs, reached through a backlash B by a spring k to either side::

        s' = eta' while -B/2 - F_lower / k <= s <= B/2 + F_upper / k, which s never leaves
        f = k (s - B/2)  for s > B/2,   k (s + B/2)  for s < -B/2,   0 between

    s is how far eta is from the middle of the backlash; it begins at 0. So f is F_upper while eta grows for long,
    -F_lower while it falls, and after a reversal nothing while the backlash is crossed. errors are standard errors in
    the order of the fields.
    """

    upper_n: float
    lower_n: float
    backlash_m: float
    stiffness_n_per_m: float
    errors: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def along(self, course: Course) -> Float[np.ndarray, " more"]:
        half, k = self.backlash_m / 2, self.stiffness_n_per_m
        low, high = -half - self.lower_n / k, half + self.upper_n / k
        at_turns = [0.0]
        for step in course.steps_m:
            at_turns.append(min(max(at_turns[-1] + step, low), high))
        s = np.clip(np.array(at_turns)[course.run] + course.since_turn_m, low, high)
        return np.asarray(k * (s - np.clip(s, -half, half)))


def sliding_friction(seen: Sampled, rows: Rows) -> SlidingFriction:
    """The friction that fits some rows of the force best under the low-pass; standard errors as of straight pieces."""
    force = seen.force_n[rows]
    most_n, least_n = (max(float(np.quantile(sign * force, SLIDES)), 1e-9 * np.ptp(force)) for sign in (1, -1))
    span_m, span_n = float(np.ptp(seen.eta_m)), most_n + least_n
    scale = np.log([most_n, least_n, span_m, span_n / span_m])

    def law(logarithms: Float[np.ndarray, " parameters"]) -> SlidingFriction:
        upper, lower, backlash, stiffness = np.exp(scale + logarithms).tolist()
        return SlidingFriction(upper, lower, backlash, stiffness)

    def error(logarithms: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " rows"]:
        return (force - seen.low_passed(law(logarithms))[rows]) / span_n

    starts = [np.log([1.0, 1.0, b, k]) for b, k in product(BACKLASHES, STIFFNESSES)]
    starts.sort(key=lambda start: float(np.sum(error(start) ** 2)))
    fit = partial(least_squares, error, bounds=(np.full(4, -12.0), np.full(4, 8.0)), diff_step=STEP, max_nfev=30)
    rough = min((fit(start, ftol=ROUGH) for start in starts[:FIRST]), key=lambda one: float(one.cost))
    found = fit(rough.x)
    slopes = _slopes(error, found.x)
    scores = part_scores(slopes @ np.linalg.pinv(slopes.T @ slopes), -error(found.x))
    relative = np.sqrt(np.sum(scores**2, axis=0))
    values = np.exp(scale + found.x)
    upper, lower, backlash, stiffness = values.tolist()
    return SlidingFriction(upper, lower, backlash, stiffness, tuple((values * relative).tolist()))


def _slopes(
    error: Callable[[Float[np.ndarray, " parameters"]], Float[np.ndarray, " rows"]],
    at: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, "rows parameters"]:
    return np.stack([(error(at + s) - error(at - s)) / (2 * STEP) for s in STEP * np.eye(at.size)], axis=1)
