"""The scatter of an estimate whose residuals are correlated in time: a sandwich estimate over parts of the record."""

import numpy as np
from jaxtyping import Float, Int

PARTS = 16
QUIET_PARTS, LEAST_PARTS = 0.25, 5.0
COUNTED_HZ = 20.0
"""So many samples a second count as independent where tolerances are weighed against them."""


def part_scores(
    influence: Float[np.ndarray, "samples parameters"],
    residual: Float[np.ndarray, " samples"],
    begins: Int[np.ndarray, " parts"] | None = None,
) -> Float[np.ndarray, "parts parameters"]:
    """Scores: what the residuals of each sixteenth of the record, or of the parts that begin there, move the parameters
    by: influence' residual.

    With influence = J (J'J)^-1, the sum of their outer products is a covariance of the parameters that allows for
    residuals which are correlated within a part (White, Econometrica 48, 1980, by clusters).
    """
    begins = even_parts(residual.size) if begins is None else begins
    ends = np.append(begins[1:], residual.size)
    return np.array([influence[a:b].T @ residual[a:b] for a, b in zip(begins, ends, strict=True)])


def even_parts(samples: int) -> Int[np.ndarray, " parts"]:
    """Beginnings of sixteenths of the record."""
    return np.array([part[0] if part.size else samples for part in np.array_split(np.arange(samples), PARTS)])


def telling_parts(influence: Float[np.ndarray, " samples"]) -> Int[np.ndarray, " parts"]:
    """Beginnings of sixteenths or, where a few of them tell nearly all, as of a decay, of parts that tell as much each.

    A part tells w, its share of the influence's square; the number of those that tell is 1 / sum(w^2).
    """
    begins = even_parts(influence.size)
    told = np.cumsum(influence**2)
    by_part = np.add.reduceat(influence**2, begins) / max(float(told[-1]), 1e-300)
    if by_part.sum() == 0 or 1 / np.sum(by_part**2) >= LEAST_PARTS:
        return begins
    ends = np.searchsorted(told, told[-1] * np.arange(1, PARTS) / PARTS)
    return np.unique(np.append(0, ends))


def quietest(signal: Float[np.ndarray, "*rows samples"]) -> Float[np.ndarray, "*rows"]:
    """The standard deviation that a quarter of the sixteenths of each row do not exceed: of noise that lasts for the
    whole record no more."""
    deviations = [part.std(axis=-1) for part in np.array_split(signal, PARTS, axis=-1)]
    return np.asarray(np.quantile(deviations, QUIET_PARTS, axis=0))
