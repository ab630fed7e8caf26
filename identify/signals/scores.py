"""Covariance of an estimate whose residuals are correlated in time: a sandwich estimate over parts of a record."""

import numpy as np
from jaxtyping import Float, Int

PART_COUNT = 16
QUIET_QUANTILE, MIN_EFFECTIVE_PARTS = 0.25, 5.0
INDEPENDENT_RATE_HZ = 20.0
"""Samples a second that count as independent where residuals are weighed against tolerances."""


def cluster_scores(
    influence: Float[np.ndarray, "samples parameters"],
    residual: Float[np.ndarray, " samples"],
    part_starts: Int[np.ndarray, " parts"] | None = None,
) -> Float[np.ndarray, "parts parameters"]:
    """Scores influence' residual of each part: by how much its residuals move the parameters.

    The parts are sixteenths of the record, or begin at `part_starts`. With influence = J (J'J)^-1, the sum of the outer
    products of the scores is a covariance of the parameters that allows for residuals correlated within a part (White,
    Econometrica 48, 1980, by clusters).
    """
    first_samples = even_cluster_starts(residual.size) if part_starts is None else part_starts
    part_bounds = zip(first_samples, np.append(first_samples[1:], residual.size), strict=True)
    return np.array([influence[start:stop].T @ residual[start:stop] for start, stop in part_bounds])


def even_cluster_starts(sample_count: int) -> Int[np.ndarray, " parts"]:
    """First samples of sixteenths of the record."""
    part_samples = np.array_split(np.arange(sample_count), PART_COUNT)
    return np.array([samples[0] if samples.size else sample_count for samples in part_samples])


def equal_information_starts(influence: Float[np.ndarray, " samples"]) -> Int[np.ndarray, " parts"]:
    """First samples of sixteenths of the record, or of equally informative parts where information is concentrated.

    Of parts with shares w of the squared influence, 1 / sum(w^2) are effective. Few are, for instance, in a decay.
    """
    even_starts, information_sum = even_cluster_starts(influence.size), np.cumsum(influence**2)
    information_shares = np.add.reduceat(influence**2, even_starts) / max(float(information_sum[-1]), 1e-300)
    if information_shares.sum() == 0 or 1 / np.sum(information_shares**2) >= MIN_EFFECTIVE_PARTS:
        return even_starts
    inner_starts = np.searchsorted(information_sum, information_sum[-1] * np.arange(1, PART_COUNT) / PART_COUNT)
    return np.unique(np.append(0, inner_starts))


def quiet_interval_std(signal: Float[np.ndarray, "*rows samples"]) -> Float[np.ndarray, "*rows"]:
    """Standard deviation that a quarter of the sixteenths of each row do not exceed: a bound of lasting noise."""
    part_deviations = [samples.std(axis=-1) for samples in np.array_split(signal, PART_COUNT, axis=-1)]
    return np.asarray(np.quantile(part_deviations, QUIET_QUANTILE, axis=0))
