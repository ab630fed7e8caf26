"""Slow part of a relative displacement that is lost in integrating accelerations: a cubic spline with a prior."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.sparse import block_diag, csr_matrix, diags, eye, hstack, spmatrix, vstack

from identify.signals.kinematics import CORNER_HZ

HIGHEST_DRIFT_HZ = 10.0
"""Highest frequency up to which the drift follows what accelerometers show of motion across their axes: a stiff stop
makes broad forces of such errors of a relative displacement. Set by hand."""
SLOW_DRIFT_HZ = HIGHEST_DRIFT_HZ / 2
"""Highest frequency at which the drift follows further errors of accelerometers. Set by hand."""
OCTAVE_COUNT = int(np.ceil(np.log2(HIGHEST_DRIFT_HZ / CORNER_HZ)))
"""Octaves from the corner of the integration to the highest frequency of the drift."""
KNOT_SPACING_S = 0.5 / HIGHEST_DRIFT_HZ
"""Distance of the spline's knots, s."""


@dataclass(frozen=True)
class DriftPrior:
    """Prior of the drift b(t) by the accelerometers.

    acceleration_m_per_s2 is the measured b'' below the corner of the integration, with the one-sided noise_density
    (m/s^2/sqrt(Hz)), and slow_noise_density <= noise_density below `SLOW_DRIFT_HZ`.
    spring_n_per_m is a spring to the ground under the contact, which fixes the zero, and damper_n_s_per_m a damper
    beside it. slow_force_density (N/s^2/sqrt(Hz)) is that of the second derivative of the force's error that no
    displacement of the contact makes, where a spring holds the bodies.
    """

    acceleration_m_per_s2: Float[np.ndarray, " samples"]
    noise_density: float
    slow_noise_density: float
    spring_n_per_m: float
    damper_n_s_per_m: float = 0.0
    slow_force_density: float = 0.0

    @property
    def noise_above_knot_band_m(self) -> float:
        """Standard deviation of the twice integrated noise above the frequency that the knots can follow.

        The integral of (s / (2 pi f)^2)^2 from f = `HIGHEST_DRIFT_HZ` on is s^2 / (16 pi^4 3 f^3).
        """
        return float(self.noise_density / (4 * np.pi**2 * np.sqrt(3 * HIGHEST_DRIFT_HZ**3)))


@dataclass(frozen=True)
class DriftSpline:
    """Spline b = value @ knots, with b' = rate @ knots, at every sample, and the force force_n @ knots beside it.

    Its prior is a least-squares one, curvature @ knots = curvature_target, rows divided by their standard deviation.
    """

    value: csr_matrix
    rate: csr_matrix
    force_n: csr_matrix
    curvature: csr_matrix
    curvature_target: Float[np.ndarray, " curvatures"]

    @property
    def knot_count(self) -> int:
        return int(self.value.shape[1])


def slow_force_density(
    error_density: Float[np.ndarray, " lines"], omega: Float[np.ndarray, " lines"]
) -> tuple[float, float]:
    """Density s_z (N/s^2/sqrt(Hz)) of the slow part of a force's error of a one-sided density (N^2/Hz), and the
    standard deviation (N) of the rest.

    Below `HIGHEST_DRIFT_HZ` what exceeds the density in the octave above is s_z^2 omega^2 / (omega^6 + omega_c^6) in
    the mean of the octaves from the corner omega_c of the integration on.
    """
    frequency_hz = omega / (2 * np.pi)
    line_spacing_hz = frequency_hz[-1] - frequency_hz[-2]
    is_above, is_next = frequency_hz >= HIGHEST_DRIFT_HZ, (frequency_hz / HIGHEST_DRIFT_HZ).astype(int) == 1
    fast_density = float(error_density[is_next].mean()) if is_next.any() else 0.0
    excess = np.maximum(error_density - fast_density, 0.0) * (omega**4 + (2 * np.pi * CORNER_HZ) ** 6 / omega**2)
    octave_numbers = np.floor(np.log2(np.maximum(frequency_hz, 1e-9) / CORNER_HZ))
    octave_means = [
        excess[~is_above & (octave_numbers == octave)].mean()
        for octave in range(OCTAVE_COUNT)
        if np.any(~is_above & (octave_numbers == octave))
    ]
    rest_variance = error_density[is_above].sum() * line_spacing_hz + fast_density * HIGHEST_DRIFT_HZ
    return float(np.sqrt(np.mean(octave_means))) if octave_means else 0.0, float(np.sqrt(rest_variance))


def spline(sample_count: int, rate_hz: float, drift: DriftPrior | None) -> DriftSpline:
    """Cubic spline over a record with the prior of `drift`; without a drift, one without knots, which is zero.

    White noise of b'' with the one-sided density s has the variance s^2 / 2h in its mean over a knot interval h, and
    slow noise s_0^2 / 4h in the mean of two, of which the two intervals tell 4h / s^2 already. A slow force is the
    rate of a spline with the spectral density s_z^2 / (omega^6 + omega_c^6): that of noise integrated twice above the
    corner omega_c, and nothing at 0 Hz.
    """
    if drift is None:
        empty_matrix = csr_matrix((sample_count, 0))
        return DriftSpline(empty_matrix, empty_matrix, empty_matrix, csr_matrix((0, 0)), np.zeros(0))
    times_s = np.arange(sample_count) / rate_hz
    inner_knots_s = np.linspace(0.0, times_s[-1], max(4, int(np.ceil(times_s[-1] / KNOT_SPACING_S))) + 1)
    spacing_s = inner_knots_s[1]
    knots_before_s, knots_after_s = -spacing_s * np.arange(3, 0, -1), inner_knots_s[-1] + spacing_s * np.arange(1, 4)
    knots_s = np.concatenate([knots_before_s, inner_knots_s, knots_after_s])
    second_difference = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(inner_knots_s.size, knots_s.size - 4)) / spacing_s**2
    weights = diags([np.sqrt(2 * spacing_s) / drift.noise_density], [0], shape=(inner_knots_s.size,) * 2)
    if drift.slow_noise_density < drift.noise_density:
        slow_weight = np.sqrt(4 * spacing_s * (drift.slow_noise_density**-2 - drift.noise_density**-2))
        pair_means = diags([0.5, 0.5], [0, 1], shape=(inner_knots_s.size - 1, inner_knots_s.size))
        weights = vstack([weights, slow_weight * pair_means.tocsr()[::2]])
    value, rate = csr_matrix(BSpline.design_matrix(times_s, knots_s, 3)), _spline_rate_matrix(times_s, knots_s)
    curvature, no_value = csr_matrix(weights @ second_difference), csr_matrix(value.shape)
    curvature_target = weights @ np.interp(inner_knots_s, times_s, drift.acceleration_m_per_s2)
    if not drift.slow_force_density:
        return DriftSpline(value, rate, no_value, curvature, curvature_target)
    third_difference = diags([-1.0, 3.0, -3.0, 1.0], [0, 1, 2, 3], shape=(inner_knots_s.size - 1, value.shape[1]))
    force_prior = vstack([third_difference / spacing_s**3, (2 * np.pi * CORNER_HZ) ** 3 * eye(value.shape[1])])
    force_prior = np.sqrt(2 * spacing_s) / drift.noise_density * force_prior
    return DriftSpline(
        value=_interleaved_halves(hstack([value, no_value])),
        rate=_interleaved_halves(hstack([rate, no_value])),
        force_n=_interleaved_halves(hstack([no_value, drift.slow_force_density / drift.noise_density * rate])),
        curvature=_interleaved_halves(block_diag([curvature, force_prior])),
        curvature_target=np.concatenate([curvature_target, np.zeros(force_prior.shape[0])]),
    )


def _interleaved_halves(columns: spmatrix) -> csr_matrix:
    """Columns of the first half and of the second, which take turns so that products of them are banded."""
    return csr_matrix(columns.tocsc()[:, np.arange(columns.shape[1]).reshape(2, -1).T.ravel()])


def _spline_rate_matrix(times_s: Float[np.ndarray, " samples"], knots_s: Float[np.ndarray, " places"]) -> csr_matrix:
    """First derivative by differences of quadratic splines: b' = sum_i (c_i - c_(i-1)) / h B2_i."""
    knot_spacing_s = knots_s[1] - knots_s[0]
    quadratic_splines = csr_matrix(BSpline.design_matrix(times_s, knots_s[1:-1], 2))
    spline_count = knots_s.size - 4
    difference_matrix = diags([-1.0, 1.0], [0, 1], shape=(spline_count - 1, spline_count)) / knot_spacing_s
    return csr_matrix(quadratic_splines @ difference_matrix)
