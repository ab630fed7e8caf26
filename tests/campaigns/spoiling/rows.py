"""What is done to the samples of one channel."""

import numpy as np
from scipy.interpolate import CubicSpline

from tests.campaigns.spoiling.alteration import Row


def noisy(row: Row, share: float) -> Row:
    return np.asarray(row + share * row.std() * np.random.default_rng(5).standard_normal(row.size))


def tone(row: Row, hz: float, rate: float, share: float) -> Row:
    return np.asarray(share * np.sqrt(2) * row.std() * np.sin(2 * np.pi * hz * np.arange(row.size) / rate + 0.3))


def spiked(row: Row) -> Row:
    found = row.copy()
    found[row.size // 3 :: row.size // 7] += 5 * row.std()
    return found


def one_spike(row: Row) -> Row:
    found = row.copy()
    found[row.size // 2] += 20 * row.std()
    return found


def gone(row: Row, rate: float) -> Row:
    found = row.copy()
    found[row.size // 2 : row.size // 2 + int(rate)] = 0.0
    return found


def held(row: Row, rate: float) -> Row:
    found, width = row.copy(), int(0.01 * rate)
    for begin in range(row.size // 4, row.size - width, row.size // 9):
        found[begin : begin + width] = found[begin]
    return found


def wrapped(row: Row) -> Row:
    most = 0.6 * np.abs(row).max()
    return np.asarray((row + most) % (2 * most) - most)


def integrated(row: Row, rate: float) -> Row:
    spectrum = np.fft.rfft(row)
    omega = 2 * np.pi * np.fft.rfftfreq(row.size, 1 / rate)
    spectrum[1:] /= 1j * omega[1:]
    spectrum[omega < 2 * np.pi * 0.5] = 0
    return np.asarray(np.fft.irfft(spectrum, row.size))


def stretched(row: Row, factor: float) -> Row:
    """Sampled at other times: sample k is taken at k factor, by cubic interpolation."""
    at = np.arange(int((row.size - 1) / max(factor, 1.0)) if factor > 1 else row.size) * factor
    return np.asarray(CubicSpline(np.arange(row.size), row)(at[at <= row.size - 1]))
