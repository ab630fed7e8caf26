"""The slow part of a relative displacement that integrating accelerations loses: a cubic spline held by a prior."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix, diags

KNOT_S = 0.1


@dataclass(frozen=True)
class Drift:
    """Prior of the drift b(t) by the accelerometers.

    acceleration_m_per_s2 is b'' as measured, below the corner of the integration; noise_density (m/s^2/sqrt(Hz)) is
    its one-sided noise. spring_n_per_m is a spring to the ground under the contact, which holds the zero, and
    damper_n_s_per_m a damper beside it.
    """

    acceleration_m_per_s2: Float[np.ndarray, " samples"]
    noise_density: float
    spring_n_per_m: float
    damper_n_s_per_m: float = 0.0

    @property
    def unfollowed_m(self) -> float:
        """Standard deviation of the twice integrated noise above the frequency that the knots can follow.

        The integral of (s / (2 pi f)^2)^2 from f = 1/(2 knot) on is s^2 / (16 pi^4 3 f^3).
        """
        return float(self.noise_density / (4 * np.pi**2 * np.sqrt(3 * (0.5 / KNOT_S) ** 3)))


@dataclass(frozen=True)
class Spline:
    """b = value @ knots and b' = rate @ knots at every sample.

    The prior is a least-squares one: curvature @ knots = target, rows already divided by their standard deviation.
    """

    value: csr_matrix
    rate: csr_matrix
    curvature: csr_matrix
    target: Float[np.ndarray, " curvatures"]

    @property
    def knots(self) -> int:
        return int(self.value.shape[1])


def spline(samples: int, sample_rate_hz: float, drift: Drift | None, knot_s: float = KNOT_S) -> Spline:
    """A cubic spline over a record with a knot every `knot_s`; without drift one without knots, which is zero.

    The noise of b'' is white with one-sided density s, so its mean over a knot interval h has the variance s^2 / 2h.
    """
    if drift is None:
        nothing = csr_matrix((samples, 0))
        return Spline(nothing, nothing, csr_matrix((0, 0)), np.zeros(0))
    time = np.arange(samples) / sample_rate_hz
    inner = np.linspace(0.0, time[-1], max(4, int(np.ceil(time[-1] / knot_s))) + 1)
    width = inner[1]
    places = np.concatenate([-width * np.arange(3, 0, -1), inner, inner[-1] + width * np.arange(1, 4)])
    second = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(inner.size, places.size - 4)) / width**2
    error = drift.noise_density / np.sqrt(2 * width)
    return Spline(
        value=csr_matrix(BSpline.design_matrix(time, places, 3)),
        rate=_derivative(time, places),
        curvature=csr_matrix(second / error),
        target=np.interp(inner, time, drift.acceleration_m_per_s2) / error,
    )


def _derivative(time: Float[np.ndarray, " samples"], places: Float[np.ndarray, " places"]) -> csr_matrix:
    """The first derivative as differences of quadratic splines: b' = sum_i (c_i - c_(i-1)) / h B2_i."""
    width = places[1] - places[0]
    quadratic = csr_matrix(BSpline.design_matrix(time, places[1:-1], 2))
    count = places.size - 4
    differences = diags([-1.0, 1.0], [0, 1], shape=(count - 1, count)) / width
    return csr_matrix(quadratic @ differences)
