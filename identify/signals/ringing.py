"""The modes of a free decay: frequencies and damping ratios, by subspaces."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import resample_poly

ROWS = 40
"""Samples that follow each other in a column of the Hankel matrix."""
OVERSAMPLED = 2.5
"""The rate at which modes are looked for, over the highest frequency."""
SHARE = 1e-5
"""A mode with less of the signals' energy is none."""
DAMPED = 0.3
"""Largest damping ratio of a mode."""


@dataclass(frozen=True)
class RingingMode:
    """Mode of a free decay, with its share of the signals' energy."""

    frequency_hz: float
    damping_ratio: float
    share: float


def modes_of_decay(
    signals: Float[np.ndarray, "channels samples"], sample_rate_hz: float, highest_hz: float, most: int
) -> list[RingingMode]:
    """The modes of a decay up to a frequency, at most so many, in the order of their frequencies.

    By the subspace of the Hankel matrix, whose shift by a sample has the eigenvalues exp(p / rate) with the poles
    p = -zeta omega +- i omega sqrt(1 - zeta^2); amplitudes by least squares.
    """
    factor = max(1, int(sample_rate_hz / (OVERSAMPLED * highest_hz)))
    rows = resample_poly(signals - signals.mean(axis=1, keepdims=True), 1, factor, axis=1) if factor > 1 else signals
    rate = sample_rate_hz / factor
    deep = min(ROWS, rows.shape[1] // 3)
    if deep < 2 or not np.any(rows):
        return []
    windows = np.lib.stride_tricks.sliding_window_view(rows, rows.shape[1] - deep + 1, axis=1)
    hankel = windows.transpose(1, 0, 2).reshape(deep * len(rows), -1)
    directions = np.linalg.eigh(hankel @ hankel.T)[1][:, ::-1][:, : 2 * most]
    shift = np.linalg.lstsq(directions[: -len(rows)], directions[len(rows) :], rcond=None)[0]
    turns = np.linalg.eigvals(shift)
    poles = np.log(turns[np.abs(turns) > 1e-9].astype(complex)) * rate
    poles = poles[poles.imag > 0]
    time_s = np.arange(rows.shape[1]) / rate
    courses = np.exp(np.minimum(poles[:, None].real, 0.0) * time_s) * np.exp(1j * poles[:, None].imag * time_s)
    basis = np.concatenate([courses.real, courses.imag])
    amplitudes = np.linalg.lstsq(basis.T, rows.T, rcond=1e-9)[0]
    found = []
    for k, pole in enumerate(poles):
        own = basis[[k, k + len(poles)]].T @ amplitudes[[k, k + len(poles)]]
        damping, share = float(-pole.real / abs(pole)), float(np.sum(own**2) / np.sum(rows**2))
        hz = float(abs(pole) / (2 * np.pi))
        if 0 < damping < DAMPED and hz < highest_hz and share > SHARE:
            found.append(RingingMode(hz, damping, share))
    return sorted(found, key=lambda mode: mode.frequency_hz)
