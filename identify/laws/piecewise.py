"""Laws f(eta) held against a low-passed contact force: any law's error, a curve without a law, straight pieces."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from identify.signals.law_evaluation import evaluated, interpolated, low_passed
from identify.signals.scores import part_scores

HATS, TOGETHER = 81, 9
MOST_KNEES = 8
STIFFENING = 1e-3
WORSE = 1.02
"""A knee is left out if the error of the fit without it is at most this multiple."""
FINEST = 1e-3
"""Errors are told apart down to this share of the force's standard deviation."""

Signal = Float[np.ndarray, "*shape"]
Function = Callable[..., Signal]
Rows = slice


@dataclass(frozen=True)
class Course:
    """A relative displacement by its runs, from one turning point to the next, in which it only grows or only falls."""

    steps_m: tuple[float, ...]
    """From each turning point to the next."""
    run: Int[np.ndarray, " more"]
    """The run of each sample."""
    since_turn_m: Float[np.ndarray, " more"]


def course_of(eta_m: Float[np.ndarray, " more"]) -> Course:
    turns = np.flatnonzero(np.diff(np.sign(np.diff(eta_m)))) + 1
    begins = np.concatenate([[0], turns])
    run = np.repeat(np.arange(begins.size), np.diff(begins, append=eta_m.size))
    return Course(tuple(np.diff(eta_m[begins]).tolist()), run, eta_m - eta_m[begins][run])


class LawWithMemory(ABC):
    """A law whose force depends on the course of the relative displacement since its first sample."""

    @abstractmethod
    def along(self, course: Course) -> Float[np.ndarray, " more"]:
        """The force at every sample."""

    def __call__(self, eta_m: Float[np.ndarray, " more"]) -> Float[np.ndarray, " more"]:
        """The force along a relative displacement, all samples from the first on."""
        return self.along(course_of(eta_m))


@dataclass(frozen=True)
class Sampled:
    """A contact force (N), low-passed, and the relative displacement (m) that it belongs to.

    Of every sample of the force there are `factor` of the relative displacement, which has the rate. Rows at the ends,
    which the low-pass falsifies, are left to the user's choice of rows.
    """

    eta_m: Float[np.ndarray, " more"]
    force_n: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    factor: int

    @property
    def at_force_m(self) -> Float[np.ndarray, " samples"]:
        """The relative displacement at the force's samples."""
        return self.eta_m[:: self.factor][: self.force_n.size]

    @cached_property
    def course(self) -> Course:
        """Course of the displacement, for laws with a memory."""
        return course_of(interpolated(self.eta_m, self.sample_rate_hz))

    def low_passed(
        self, law: Function | LawWithMemory, *beside: Float[np.ndarray, " more"]
    ) -> Float[np.ndarray, "*rows samples"]:
        """law(eta, *beside), without aliasing, as the force is low-passed."""
        if isinstance(law, LawWithMemory):
            force = low_passed(law.along(self.course), self.sample_rate_hz, self.factor)
        else:
            force = evaluated(law, np.stack([self.eta_m, *beside]), self.sample_rate_hz, self.factor)
        return force[..., : self.force_n.size]

    def error_n(self, law: Function | LawWithMemory, rows: Rows) -> float:
        """Rms of the force less the low-passed law."""
        return float(np.sqrt(np.mean((self.force_n - self.low_passed(law))[rows] ** 2)))


def unfiltered(seen: Sampled, rows: Rows) -> Float[np.ndarray, " fewer"]:
    """The force as a function of eta would be before the low-pass, scatter included: no law is assumed.

    A curve of 81 straight pieces is fitted under the low-pass (linear least squares, lightly held straight); what the
    low-pass does to that curve is taken off the force.
    """
    places = np.linspace(seen.eta_m.min(), seen.eta_m.max(), HATS)
    width = places[1] - places[0]
    hats = np.concatenate([seen.low_passed(partial(_hats, some, width)) for some in np.split(places, TOGETHER)]).T
    straight = STIFFENING * np.sqrt(np.sum(hats[rows] ** 2) / HATS) * np.diff(np.eye(HATS), 2, axis=0)
    system = np.concatenate([hats[rows], straight])
    heights = np.linalg.lstsq(system, np.concatenate([seen.force_n[rows], np.zeros(HATS - 2)]), rcond=None)[0]
    return (seen.force_n - hats @ heights + np.interp(seen.at_force_m, places, heights))[rows]


def _hats(places_m: Float[np.ndarray, " places"], width_m: float, eta_m: Signal) -> Float[np.ndarray, "places *shape"]:
    return np.stack([np.clip(1 - np.abs(eta_m - place) / width_m, 0, None) for place in places_m])


def polynomial(seen: Sampled, rows: Rows, degree: int) -> Function:
    """The polynomial in eta that fits the rows best under the low-pass."""
    size = float(np.abs(seen.eta_m).max())
    columns = seen.low_passed(lambda eta: np.stack([(eta / size) ** n for n in range(degree + 1)]))
    found = np.linalg.lstsq(columns[:, rows].T, seen.force_n[rows], rcond=None)[0]
    return lambda eta: np.polynomial.polynomial.polyval(eta / size, found)


@dataclass(frozen=True)
class PiecewiseLinear:
    """f = offset + slope[0] eta + sum_i (slope[i + 1] - slope[i]) max(eta - knee[i], 0), with covariances."""

    offset_n: float
    knees_m: Float[np.ndarray, " knees"]
    slopes_n_per_m: Float[np.ndarray, " pieces"]
    knee_errors_m: Float[np.ndarray, " knees"]
    slope_errors_n_per_m: Float[np.ndarray, " pieces"]

    def __call__(self, eta: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        force = self.offset_n + self.slopes_n_per_m[0] * eta
        for knee, jump in zip(self.knees_m, np.diff(self.slopes_n_per_m), strict=True):
            force = force + jump * np.maximum(eta - knee, 0.0)
        return force


def slope_jumps(law: Function, low_m: float, high_m: float, share: float = 0.03) -> Float[np.ndarray, " knees"]:
    """Places where a law's slope changes within some thousandths of the range by more than a share of its own range.

    The largest of them, where there are many: the slope of a law that is nearly constant is all rounding.
    """
    eta = np.linspace(low_m, high_m, 4001)
    slope = np.gradient(law(eta), eta)
    reach = 8
    change = np.abs(slope[reach:] - slope[:-reach])
    there = change > share * max(float(np.ptp(slope)), 1e-9 * float(np.abs(slope).max()))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(int), [0]])))
    middle = eta[reach // 2 : -reach // 2]
    runs = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a <= 3 * reach]
    runs = sorted(sorted(runs, key=lambda run: -float(change[slice(*run)].sum()))[:MOST_KNEES])
    return np.array([np.average(middle[a:b], weights=change[a:b]) for a, b in runs])


def straight_pieces(seen: Sampled, rows: Rows, knees_m: Float[np.ndarray, " knees"]) -> PiecewiseLinear:
    """The continuous piecewise-linear law under the low-pass, from these knees; those that do not help are left out.

    The knees by nonlinear least squares, the slopes linear within. Standard errors are sandwich estimates over
    sixteenths of the rows: of the scatter alone, not of what the rig's description may have wrong.
    """
    found, error = _fitted(seen, rows, np.sort(knees_m))
    while found.knees_m.size:
        weakest = int(np.argmin(np.abs(np.diff(found.slopes_n_per_m))))
        fewer, rougher = _fitted(seen, rows, np.delete(found.knees_m, weakest))
        if rougher > WORSE * error + FINEST * float(np.std(seen.force_n[rows])):
            break
        found, error = fewer, rougher
    return found


def _fitted(seen: Sampled, rows: Rows, start_m: Float[np.ndarray, " knees"]) -> tuple[PiecewiseLinear, float]:
    force = seen.force_n[rows]
    low, high = float(seen.eta_m.min()), float(seen.eta_m.max())
    size = high - low

    def linear(knees: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        columns = seen.low_passed(
            lambda eta: np.stack([np.ones_like(eta), eta / size, *(np.maximum(eta / size - k, 0.0) for k in knees)])
        )[:, rows].T
        heights = np.linalg.lstsq(columns, force, rcond=None)[0]
        return columns, heights, force - columns @ heights

    def by_knees(knees: np.ndarray, heights: np.ndarray) -> np.ndarray:
        steps = seen.low_passed(lambda eta: np.stack([(eta / size > k).astype(float) for k in knees]))
        return (heights[2:, None] * steps[:, rows]).T

    def jacobian(knees: np.ndarray) -> np.ndarray:
        columns, heights, _ = linear(knees)
        moved = by_knees(knees, heights)
        return moved - columns @ np.linalg.lstsq(columns, moved, rcond=None)[0]  # the slopes follow

    knees = np.clip(start_m / size, low / size + 0.01, high / size - 0.01)
    if knees.size:
        scale = 1 / max(float(np.std(linear(knees)[2])), 1e-12)
        found = least_squares(
            lambda k: scale * linear(k)[2],
            knees,
            lambda k: scale * jacobian(k),
            bounds=(low / size, high / size),
            x_scale=0.05,
            max_nfev=30,
        )
        knees = np.sort(found.x)
    columns, heights, residual = linear(knees)
    full = np.concatenate([columns, by_knees(knees, heights)], axis=1) if knees.size else columns
    influence = full @ np.linalg.pinv(full.T @ full)
    scores = part_scores(influence, residual)
    count = heights.size
    slope_scores = np.cumsum(scores[:, 1:count], axis=1)
    law = PiecewiseLinear(
        offset_n=float(heights[0]),
        knees_m=knees * size,
        slopes_n_per_m=np.cumsum(heights[1:]) / size,
        knee_errors_m=size * np.sqrt(np.sum(scores[:, count:] ** 2, axis=0)),
        slope_errors_n_per_m=np.sqrt(np.sum(slope_scores**2, axis=0)) / size,
    )
    return law, float(np.sqrt(np.mean(residual**2)))
