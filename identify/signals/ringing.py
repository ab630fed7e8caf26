"""Modes of a free decay, their frequencies and damping ratios, by a subspace method."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import resample_poly

MAX_LAGS = 40
"""Consecutive samples in a column of the Hankel matrix."""
RATE_TO_HIGHEST_HZ = 2.5
"""Sampling rate of the decimated signals, over the highest frequency."""
MIN_ENERGY_SHARE = 1e-5
"""Smallest share of the signals' energy of a mode."""
MAX_DAMPING_RATIO = 0.3


@dataclass(frozen=True)
class RingingMode:
    """Mode of a free decay, with its share of the signals' energy."""

    frequency_hz: float
    damping_ratio: float
    energy_share: float


def modes_of_decay(
    signals: Float[np.ndarray, "channels samples"], sample_rate_hz: float, highest_hz: float, max_modes: int
) -> list[RingingMode]:
    """Modes of a decay up to a frequency, at most `max_modes`, in the order of their frequencies.

    The subspace of the Hankel matrix is shifted by one sample by a matrix with the eigenvalues exp(p / rate), where
    p = -zeta omega +- i omega sqrt(1 - zeta^2) are the poles; amplitudes follow by least squares.
    """
    decimation = max(1, int(sample_rate_hz / (RATE_TO_HIGHEST_HZ * highest_hz)))
    slow_signals = (
        resample_poly(signals - signals.mean(axis=1, keepdims=True), 1, decimation, axis=1)
        if decimation > 1
        else signals
    )
    slow_rate_hz, lag_count = sample_rate_hz / decimation, min(MAX_LAGS, slow_signals.shape[1] // 3)
    if lag_count < 2 or not np.any(slow_signals):
        return []
    windows = np.lib.stride_tricks.sliding_window_view(slow_signals, slow_signals.shape[1] - lag_count + 1, axis=1)
    hankel = windows.transpose(1, 0, 2).reshape(lag_count * len(slow_signals), -1)
    subspace = np.linalg.eigh(hankel @ hankel.T)[1][:, ::-1][:, : 2 * max_modes]
    shift_matrix = np.linalg.lstsq(subspace[: -len(slow_signals)], subspace[len(slow_signals) :], rcond=None)[0]
    eigenvalues = np.linalg.eigvals(shift_matrix)
    poles = np.log(eigenvalues[np.abs(eigenvalues) > 1e-9].astype(complex)) * slow_rate_hz
    poles, time_s = poles[poles.imag > 0], np.arange(slow_signals.shape[1]) / slow_rate_hz
    unit_decays = np.exp(np.minimum(poles[:, None].real, 0.0) * time_s) * np.exp(1j * poles[:, None].imag * time_s)
    decay_basis = np.concatenate([unit_decays.real, unit_decays.imag])
    amplitudes, modes = np.linalg.lstsq(decay_basis.T, slow_signals.T, rcond=1e-9)[0], []
    for pole_index, pole in enumerate(poles):
        mode_signals = (
            decay_basis[[pole_index, pole_index + len(poles)]].T @ amplitudes[[pole_index, pole_index + len(poles)]]
        )
        damping_ratio = float(-pole.real / abs(pole))
        energy_share = float(np.sum(mode_signals**2) / np.sum(slow_signals**2))
        frequency_hz = float(abs(pole) / (2 * np.pi))
        if 0 < damping_ratio < MAX_DAMPING_RATIO and frequency_hz < highest_hz and energy_share > MIN_ENERGY_SHARE:
            modes.append(RingingMode(frequency_hz, damping_ratio, energy_share))
    return sorted(modes, key=lambda mode: mode.frequency_hz)
