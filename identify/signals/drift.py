"""Slow part of a relative displacement that is lost in integrating accelerations: a cubic spline with a prior."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix, diags, vstack

KNOT_STEP_S = 0.1
"""Distance of the spline's knots, s, unless the prior has its own."""


@dataclass(frozen=True)
class DriftPrior:
    """Prior of the drift b(t) by the accelerometers.

    acceleration_m_per_s2 is the measured b'' below the corner of the integration, with the one-sided noise_density
    (m/s^2/sqrt(Hz)); slow_noise_density is that of the lower half of the band that the knots follow, if it differs.
    spring_n_per_m is a spring to the ground under the contact, which fixes the zero, and damper_n_s_per_m a damper
    beside it.
    """

    acceleration_m_per_s2: Float[np.ndarray, " samples"]
    noise_density: float
    spring_n_per_m: float
    damper_n_s_per_m: float = 0.0
    knot_spacing_s: float = KNOT_STEP_S
    slow_noise_density: float | None = None

    @property
    def highest_hz(self) -> float:
        """Highest frequency that the knots can follow."""
        return 0.5 / self.knot_spacing_s

    @property
    def unfollowed_noise_m(self) -> float:
        """Standard deviation of the twice integrated noise above the frequency that the knots can follow.

        The integral of (s / (2 pi f)^2)^2 from f = `highest_hz` on is s^2 / (16 pi^4 3 f^3).
        """
        return float(self.noise_density / (4 * np.pi**2 * np.sqrt(3 * self.highest_hz**3)))


@dataclass(frozen=True)
class Spline:
    """Spline b = value @ knots, with b' = rate @ knots, at every sample.

    Its prior is a least-squares one, curvature @ knots = curvature_target, rows divided by their standard deviation.
    """

    value: csr_matrix
    rate: csr_matrix
    curvature: csr_matrix
    curvature_target: Float[np.ndarray, " curvatures"]

    @property
    def knot_count(self) -> int:
        return int(self.value.shape[1])


def spline(sample_count: int, rate_hz: float, drift: DriftPrior | None) -> Spline:
    """Cubic spline over a record, with the knots of `drift`; without a drift, one without knots, which is zero.

    White noise of b'' with the one-sided density s has the variance s^2 / 2h in its mean over a knot interval h, and
    slow noise s_0^2 / 4h in the mean of two.
    """
    if drift is None:
        empty_matrix = csr_matrix((sample_count, 0))
        return Spline(empty_matrix, empty_matrix, csr_matrix((0, 0)), np.zeros(0))
    times_s = np.arange(sample_count) / rate_hz
    inner_knots_s = np.linspace(0.0, times_s[-1], max(4, int(np.ceil(times_s[-1] / drift.knot_spacing_s))) + 1)
    spacing_s = inner_knots_s[1]
    knots_before_s, knots_after_s = -spacing_s * np.arange(3, 0, -1), inner_knots_s[-1] + spacing_s * np.arange(1, 4)
    knots_s = np.concatenate([knots_before_s, inner_knots_s, knots_after_s])
    second_difference = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(inner_knots_s.size, knots_s.size - 4)) / spacing_s**2
    weights = diags([np.sqrt(2 * spacing_s) / drift.noise_density], [0], shape=(inner_knots_s.size,) * 2)
    if drift.slow_noise_density is not None:
        slow_weight = np.sqrt(4 * spacing_s) / drift.slow_noise_density
        pair_means = diags([0.5, 0.5], [0, 1], shape=(inner_knots_s.size - 1, inner_knots_s.size))
        weights = vstack([weights, slow_weight * pair_means.tocsr()[::2]])
    return Spline(
        value=csr_matrix(BSpline.design_matrix(times_s, knots_s, 3)),
        rate=_rate_matrix(times_s, knots_s),
        curvature=csr_matrix(weights @ second_difference),
        curvature_target=weights @ np.interp(inner_knots_s, times_s, drift.acceleration_m_per_s2),
    )


def _rate_matrix(times_s: Float[np.ndarray, " samples"], knots_s: Float[np.ndarray, " places"]) -> csr_matrix:
    """First derivative by differences of quadratic splines: b' = sum_i (c_i - c_(i-1)) / h B2_i."""
    knot_spacing_s = knots_s[1] - knots_s[0]
    quadratic_splines = csr_matrix(BSpline.design_matrix(times_s, knots_s[1:-1], 2))
    spline_count = knots_s.size - 4
    difference_matrix = diags([-1.0, 1.0], [0, 1], shape=(spline_count - 1, spline_count)) / knot_spacing_s
    return csr_matrix(quadratic_splines @ difference_matrix)
