"""The scatter of an estimate whose residuals are correlated in time: a sandwich estimate over parts of the record."""

import numpy as np
from jaxtyping import Float

PARTS = 16
COUNTED_HZ = 20.0
"""So many samples a second count as independent where tolerances are weighed against them."""


def part_scores(
    influence: Float[np.ndarray, "samples parameters"], residual: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "parts parameters"]:
    """What the residuals of each sixteenth of the record move the parameters by: influence' residual.

    With influence = J (J'J)^-1, the sum of their outer products is a covariance of the parameters that allows for
    residuals which are correlated within a part (White, Econometrica 48, 1980, by clusters).
    """
    parts = zip(np.array_split(influence, PARTS), np.array_split(residual, PARTS), strict=True)
    return np.array([own.T @ rest for own, rest in parts])
