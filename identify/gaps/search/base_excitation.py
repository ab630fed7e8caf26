"""A base that shakes unmeasured: its band and level from what the linear residual holds of its pattern."""

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace as changed
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal.windows import hann

from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.nuisance import residual_scale
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.residual.spectra import SMOOTHED_HZ
from identify.gaps.search.candidates import Candidate
from rig.model.description import BaseMotion

WINDOW_LINES, WINDOW_POWERS = 1.5, 35 / 18
"""Of a Hann window: its noise bandwidth in lines, and by how much it lowers the number of independent powers."""
LEVELS = 10.0 ** np.arange(-9, 3, 0.5)
"""Spectral densities that are tried, (m/s^2)^2/Hz."""


def fit_base_excitation(
    linearization: Linearization, at: Residual, candidate: Candidate, least: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
    """The best base motion (level, lower and upper end of its band) with standard errors, by its likelihood over all
    bands and levels; None where the residual has none of it, or twice its logarithm gains no more than `least`.

    With y the residual, p the pattern of a base motion of unit density, both of unit noise, a density S lowers the
    cost of a line by 2 (|p'y|^2/s (1 - 1/(1 + S s)) - log(1 + S s)), s = |p|^2; the best interval of lines is that
    of largest sum. Every sensor is taken in the level that its residual has around each line, as a model that errs at
    some sensors leaves those of the rest in noise; the noise is then what other patterns hold.
    """
    record = linearization.record
    if len(record.sensors) < len(linearization.seen) + 2:
        return None  # any residual would be a base motion's
    hz = record.omega / (2 * np.pi)
    low, high = float(hz[1]), float(hz[-1])
    everywhere = BaseMotion(acceleration_rms_m_per_s2=float(np.sqrt(high - low)), low_hz=low, high_hz=high)
    shaken = changed(linearization.rig, base_motion=everywhere)
    model = linear_model(record, shaken, linearization.scales.discrepancy, linearization.cache.responses)
    contacts = len(linearization.seen)
    pattern = model.by_input[contacts]
    by_contacts = linearization.model.projection.of(pattern * linearization.model.deviation)[1]
    pattern = pattern - np.einsum("isl,il->sl", model.by_input[:contacts], by_contacts)
    y = _lines(linearization, at)
    around = max(1, round(SMOOTHED_HZ * record.length / record.sample_rate_hz))
    own = np.sqrt(np.maximum(uniform_filter1d(np.abs(y) ** 2, around, axis=1), 1e-300))
    y, pattern = y / own, pattern / own
    size = np.sum(np.abs(pattern) ** 2, axis=0)
    seen = np.abs(np.sum(pattern.conj() * y, axis=0)) ** 2 / np.maximum(size, 1e-300)
    others = (np.sum(np.abs(y) ** 2, axis=0) - seen) / max(1, len(y) - contacts - 1)
    level = np.maximum(uniform_filter1d(others, around), 1e-300)
    seen, size = seen / level, size / level
    bounds = candidate.parameters
    inside = (hz >= bounds["low_hz"].low) & (hz <= bounds["high_hz"].high)
    best, band, density = 0.0, slice(0, 0), 0.0
    for tried in LEVELS:
        total, found = _largest(np.where(inside, _gains(tried, seen, size), 0.0))
        if total > best:
            best, band, density = total, found, tried
    taken = (record.taken.stop - record.taken.start) * record.factor
    if not 2 * best * taken / record.length / WINDOW_LINES > least:
        return None
    density, relative = _density(density, seen[band], size[band], taken / record.length)
    gains = np.where(inside, _gains(density, seen, size), 0.0) * taken / record.length / WINDOW_LINES
    sums = np.concatenate([[0.0], np.cumsum(gains)])
    resolution = record.sample_rate_hz / taken
    middle = (band.start + band.stop) // 2
    low, of_low = _edge(hz[:middle], -sums[:middle], resolution)
    high, of_high = _edge(hz[middle:], sums[middle:-1], resolution)
    rms = float(np.sqrt(density * record.samples / taken * (high - low)))
    values = np.array([np.clip(rms, 0, bounds["acceleration_rms_m_per_s2"].high), low, high])
    of_rms = rms * np.hypot(relative, np.hypot(of_low, of_high) / (high - low)) / 2
    return values, np.array([of_rms, of_low, of_high])


def _gains(
    density: float, seen: Float[np.ndarray, " lines"], size: Float[np.ndarray, " lines"]
) -> Float[np.ndarray, " lines"]:
    """Gains of the log likelihood of each line by a density."""
    return np.asarray(seen * (1 - 1 / (1 + density * size)) - np.log1p(density * size))


def _density(
    start: float, seen: Float[np.ndarray, " lines"], size: Float[np.ndarray, " lines"], share: float
) -> tuple[float, float]:
    """The likeliest density within a decade of a start, and its relative standard error by Fisher's information."""
    ends = np.log(start) + np.array([-1.0, 1.0]) * np.log(10)
    found = minimize_scalar(lambda x: -np.sum(_gains(np.exp(x), seen, size)), bounds=ends, method="bounded")
    density = float(np.exp(found.x))
    heard = density * size / (1 + density * size)
    return density, float(1 / np.sqrt(max(np.sum(heard**2) * share / WINDOW_POWERS, 1e-300)))


def _edge(
    hz: Float[np.ndarray, " lines"], log_likelihood: Float[np.ndarray, " lines"], resolution_hz: float
) -> tuple[float, float]:
    """Mean and standard deviation of a band's edge, anywhere as likely beforehand, smeared by the window."""
    weights = np.exp(log_likelihood - np.max(log_likelihood))
    weights /= weights.sum()
    mean = float(weights @ hz)
    return mean, float(np.sqrt(weights @ (hz - mean) ** 2 + resolution_hz**2))


def _lines(linearization: Linearization, at: Residual) -> Complex[np.ndarray, "sensors lines"]:
    """The residual over time, back on the record's lines, under a window so that no band leaks into another."""
    record = linearization.record
    rows = at.linear[: len(record.sensors)]
    window = hann(rows.shape[1]) * np.sqrt(8 / 3)
    whole = np.fft.rfft(rows * window, record.length // record.factor)
    return np.asarray(whole * record.factor / residual_scale(record))


def _largest(gains: Float[np.ndarray, " lines"]) -> tuple[float, slice]:
    """The interval of largest sum (Kadane)."""
    sums = np.concatenate([[0.0], np.cumsum(gains)])
    lowest = np.minimum.accumulate(sums)
    stop = int(np.argmax(sums - lowest))
    start = int(np.argmin(sums[: stop + 1]))
    return float(sums[stop] - sums[start]), slice(start, stop)
