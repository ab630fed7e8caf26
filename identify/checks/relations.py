"""Relation of a measured signal to a predicted one: gain, delay, coherence, and the gain over frequency."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

UNIT_FACTORS = {
    "g instead of m/s^2, or the reverse": 9.80665,
    "thousandths (mm, kN, mV)": 1e3,
    "millionths": 1e6,
    "inches": 1 / 0.0254,
    "feet": 1 / 0.3048,
    "pounds": 4.4482216,
    "centimetres or Gal": 100.0,
    "root mean square for peak": float(np.sqrt(2)),
}
"""Usual mistakes of units, each possible in either direction."""
UNIT_FACTOR_TOLERANCE = 0.03
"""Relative deviation within which a factor is taken for a usual one."""
MIN_COHERENCE = 0.5
"""A channel whose coherence with its prediction is lower does not follow the motion."""
MAX_DELAY_S = 0.1
BAND_COUNT = 10

PerLine = Float[np.ndarray, " lines"]
Spectrum = Complex[np.ndarray, " lines"]


@dataclass(frozen=True)
class Relation:
    """measured = gain predicted e^(-i omega delay_s), which explains the share `coherence` of the measured power."""

    gain: float
    delay_s: float
    coherence: float


def relation(
    omega: PerLine, measured: Spectrum, predicted: Spectrum, line_weights: PerLine, max_delay_s: float = MAX_DELAY_S
) -> Relation:
    """Relation at the delay of the highest coherence; the gain's sign makes the covariance positive there."""
    cross_spectrum = predicted.conj() * measured * line_weights**2
    predicted_power = float(np.sum((np.abs(predicted) * line_weights) ** 2))
    measured_power = float(np.sum((np.abs(measured) * line_weights) ** 2))
    if not (predicted_power > 0 and measured_power > 0):
        return Relation(0.0, 0.0, 0.0)
    delay_step_s = 0.25 * np.pi / float(omega[-1])
    tried_delays_s = delay_step_s * np.arange(-int(max_delay_s / delay_step_s), int(max_delay_s / delay_step_s) + 1)
    batches_s = np.array_split(tried_delays_s, 8)
    covariances = np.concatenate(
        [(np.exp(1j * delay_s[:, None] * omega) @ cross_spectrum).real for delay_s in batches_s]
    )
    best_delay_index = int(np.argmax(np.abs(covariances)))
    delay_s = tried_delays_s[best_delay_index]
    for _ in range(4):  # of the real part's slope
        delayed_cross_spectrum = np.exp(1j * delay_s * omega) * cross_spectrum
        covariance_slope = float(np.sum((1j * omega * delayed_cross_spectrum).real))
        covariance_curvature = float(np.sum((-(omega**2) * delayed_cross_spectrum).real))
        if covariance_curvature:
            delay_s -= float(np.clip(covariance_slope / covariance_curvature, -delay_step_s, delay_step_s))
    covariance = float(np.sum((np.exp(1j * delay_s * omega) * cross_spectrum).real))
    return Relation(covariance / predicted_power, float(delay_s), covariance**2 / (predicted_power * measured_power))


def unit_mistake(gain: float) -> str | None:
    """Mistake of units that multiplies a channel by this gain, or None."""
    for mistake_words, factor in UNIT_FACTORS.items():
        if any(abs(abs(gain) * tried_factor - 1) < UNIT_FACTOR_TOLERANCE for tried_factor in (factor, 1 / factor)):
            return mistake_words
    return None


def band_gain_fit(
    omega: PerLine, measured: Spectrum, predicted: Spectrum, line_weights: PerLine
) -> tuple[Float[np.ndarray, " bands"], float, Float[np.ndarray, " bands"]]:
    """Size of the complex gain in each band, unexplained share of the measured power, and the bands' centres, Hz."""
    band_edge_indices = np.searchsorted(omega, np.geomspace(omega[0], omega[-1], BAND_COUNT + 1)[1:-1])
    indices_by_band = [indices for indices in np.split(np.arange(omega.size), band_edge_indices) if indices.size > 5]
    complex_gains, residual_power = [], 0.0
    for indices in indices_by_band:
        measured_band = measured[indices] * line_weights[indices]
        predicted_band = predicted[indices] * line_weights[indices]
        gain = np.vdot(predicted_band, measured_band) / max(float(np.vdot(predicted_band, predicted_band).real), 1e-300)
        complex_gains.append(gain)
        residual_power += float(np.sum(np.abs(measured_band - gain * predicted_band) ** 2))
    measured_power = float(np.sum(np.abs(measured * line_weights) ** 2)) or 1.0
    centres_hz = np.array([omega[indices[indices.size // 2]] for indices in indices_by_band]) / (2 * np.pi)
    return np.abs(complex_gains), residual_power / measured_power, centres_hz
