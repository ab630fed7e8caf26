"""One channel of a file of measured data."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Column:
    """Its name and samples; unit and sample rate are None where the file does not say them."""

    name: str
    values: Float[np.ndarray, " samples"]
    unit: str | None = None
    sample_rate_hz: float | None = None
