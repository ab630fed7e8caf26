"""A free decay: up to where the rig rings, and the frequency and damping of every mode that the record tells.

A mode of amplitude A that falls with the rate alpha, in white noise of the one-sided density s, has its frequency and
its rate known to sqrt(4 alpha^3 s^2 / A^2) rad/s each (Cramer and Rao), which subspaces reach to a factor of two.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import tukey

from identify.signals.ringing import modes_of_decay

RINGS = 1 - 1e-6
"""Of the power of the velocities, beyond noise, lies below the frequency up to which a rig rings."""
FADED = 0.1
"""Of a record, at both ends together, for that spectrum."""
ABOVE, SMOOTHED = 8.0, 9
"""Lines count whose power, smoothed over so many, is more than this multiple of the noise's."""
FREQUENCY, DAMPING = 3e-4, 0.03
"""Relative errors of a mode's frequency and damping ratio at least: what subspaces, the fade and stations leave."""
INEFFICIENT = 2.0
"""Subspaces err by so many times the least that is possible."""
MODES = 12
"""Modes that are looked for."""


@dataclass(frozen=True)
class MeasuredMode:
    """Mode of a free decay: frequency and damping ratio, with the relative standard error of each."""

    frequency_hz: float
    damping_ratio: float
    frequency_error: float
    damping_error: float


def rings_to_hz(
    rows: Float[np.ndarray, "sensors samples"],
    rate_hz: float,
    order: int,
    densities: Float[np.ndarray, " sensors"],
) -> float:
    """Up to which frequency what sensors of this derivative show is more than their noise, by the velocities' power."""
    window = tukey(rows.shape[1], FADED)
    power = np.abs(np.fft.rfft((rows - rows.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2
    noise = (densities**2 * rate_hz / 2 * np.sum(window**2))[:, None]
    hz = np.fft.rfftfreq(rows.shape[1], 1 / rate_hz)
    heard = uniform_filter1d(power, SMOOTHED, axis=1) > ABOVE * noise
    velocity = ((power - noise) * heard)[:, 1:] * hz[1:] ** (2.0 * (1 - order))
    whole = np.cumsum(np.maximum(velocity, 0.0).sum(axis=0))
    return float(hz[1 + np.searchsorted(whole, RINGS * whole[-1])]) if whole[-1] > 0 else 0.0


def measured_modes(
    rows: Float[np.ndarray, "sensors samples"],
    rate_hz: float,
    highest_hz: float,
    densities: Float[np.ndarray, " sensors"],
) -> tuple[MeasuredMode, ...]:
    """The modes that stand out of the noise, with their errors."""
    found = []
    duration_s = rows.shape[1] / rate_hz
    size = float(np.sum(rows**2)) / len(rows)
    for mode in modes_of_decay(rows, rate_hz, highest_hz, MODES):
        omega = 2 * np.pi * mode.frequency_hz
        alpha = mode.damping_ratio * omega
        lasting = max(alpha, 1 / duration_s)
        amplitude = np.sqrt(4 * lasting * mode.share * size / rate_hz)  # the integral of its square is A^2 / 4 alpha
        error = INEFFICIENT * np.sqrt(4 * lasting**3) * float(np.sqrt(np.mean(densities**2))) / amplitude
        known = np.hypot(FREQUENCY, error / omega), np.hypot(DAMPING, error / alpha)
        if known[1] < 1:
            found.append(MeasuredMode(mode.frequency_hz, mode.damping_ratio, float(known[0]), float(known[1])))
    return tuple(found)
