"""Free motion of one mode over time, and its transform as sampled sensors show it, which is known exactly.

Of q'' + 2 zeta omega q' + omega^2 q = 0 with the poles p_1, p_2, an initial displacement q_0 and velocity q_0' cause
q_0 u(t) + q_0' v(t) with

    u = (p_2 exp(p_1 t) - p_1 exp(p_2 t)) / (p_2 - p_1),   v = (exp(p_2 t) - exp(p_1 t)) / (p_2 - p_1)

A sensor shows the sum over its samples, the first one halved, under a half cosine at the record's end: a sum of
geometric series (`tapered_exponential_spectrum`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float

Poles = Complex[np.ndarray, "2"] | Float[np.ndarray, "2"]
LEAST_LOG_DECAY = 1e-6
"""Decay over a record, as a logarithm, that an undamped mode has in sums over samples, which are 0/0 at its line."""


def free_motion(
    natural_hz: float, damping_ratio: float, initial_order: int, time_s: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "3 samples"]:
    """u (order 0, of a unit displacement) or v (order 1, of a unit velocity) with its two derivatives in time."""
    if natural_hz == 0:
        ones, zeros = np.ones_like(time_s), np.zeros_like(time_s)
        return np.stack([time_s, ones, zeros] if initial_order else [ones, zeros, zeros])
    poles = _poles(natural_hz, damping_ratio)
    exponentials = [np.exp(pole * time_s) for pole in poles]
    derivatives = [
        _derivative_from_pole_terms(poles, exponentials, initial_order, k) / (poles[1] - poles[0]) for k in range(3)
    ]
    return np.asarray(np.real(derivatives))


def _poles(natural_hz: float, damping_ratio: float) -> Poles:
    """Poles of a mode, 1/s; critical damping is avoided, where they coincide."""
    zeta = damping_ratio if abs(damping_ratio - 1) > 1e-6 else 1 + 1e-6
    return 2 * np.pi * natural_hz * (-zeta + np.array([1, -1]) * np.emath.sqrt(zeta**2 - 1))


def _derivative_from_pole_terms(
    poles: Poles, pole_terms: Sequence[np.ndarray], initial_order: int, derivative_order: int
) -> np.ndarray:
    """(p_2 - p_1) times a derivative of u (order 0) or v (order 1), from the terms of exp(p_1 t) and exp(p_2 t)."""
    p_1, p_2 = poles
    if initial_order:
        return np.asarray(p_2**derivative_order * pole_terms[1] - p_1**derivative_order * pole_terms[0])
    return np.asarray(p_2 * p_1**derivative_order * pole_terms[0] - p_1 * p_2**derivative_order * pole_terms[1])


@dataclass(frozen=True, eq=False)
class Sampling:
    """Sampling of a free motion: the order of the measured derivative, how many of the samples a taper fades, and the
    circular frequencies of the lines."""

    derivative_order: int
    rate_hz: float
    sample_count: int
    fading_samples: int
    omega: Float[np.ndarray, " lines"]

    @cached_property
    def phases(self) -> tuple[Complex[np.ndarray, " lines"], ...]:
        """exp(-i omega n / rate) after one sample, after those that count in full, and after those that fade."""
        sample_counts = 1, self.sample_count - self.fading_samples, self.fading_samples
        return tuple(np.exp(-1j * self.omega * n / self.rate_hz) for n in sample_counts)


def tapered_exponential_spectrum(pole: complex, sampling: Sampling) -> Complex[np.ndarray, " lines"]:
    """Transform of exp(pole t) over M samples, the first one halved, and F more that fade (`kinematics.taper`).

    With z = exp((pole - i omega) / rate), the sum (z^n - 1) / (z - 1) of z^0 to z^(n - 1), and c = cos(pi / F),

        (z^M - 1) / (z - 1) - 1/2 + z^M / 2 [ (z^F - 1) / (z - 1) - (z^F + 1) (z - c) / (z^2 - 2 c z + 1) ]
    """
    constant_count, fading_count = sampling.sample_count - sampling.fading_samples, sampling.fading_samples
    z, z_constant, z_fading = (
        np.exp(pole * count / sampling.rate_hz) * phases
        for count, phases in zip((1, constant_count, fading_count), sampling.phases, strict=True)
    )
    cosine, geometric_factor = np.cos(np.pi / fading_count), 1 / (z - 1)
    fading_sum = (z_fading - 1) * geometric_factor - (z_fading + 1) * (z - cosine) / (z * (z - 2 * cosine) + 1)
    return np.asarray((z_constant - 1) * geometric_factor - 0.5 + 0.5 * z_constant * fading_sum)


def sampled_accelerations(
    natural_hz: float, damping_ratio: float, sampling: Sampling
) -> Complex[np.ndarray, "2 lines"]:
    """Accelerations by the sampled derivative of u and of v, over the sample rate."""
    poles, order = _poles(natural_hz, damping_ratio), sampling.derivative_order
    poles = poles - max(0.0, LEAST_LOG_DECAY * sampling.rate_hz / sampling.sample_count + float(np.max(np.real(poles))))
    tapered_sums = [tapered_exponential_spectrum(complex(pole), sampling) for pole in poles]
    acceleration_factor = (1j * sampling.omega) ** (2 - order) / ((poles[1] - poles[0]) * sampling.rate_hz)
    return np.stack(
        [acceleration_factor * _derivative_from_pole_terms(poles, tapered_sums, k, order) for k in range(2)]
    )
