"""Contact records made by hand."""

from typing import Any

import numpy as np
from jaxtyping import Float

from identify.contacts.contact_record import ContactRecord
from identify.signals.drift import spline


def contact_record(
    force_n: Float[np.ndarray, " samples"], nuisance_n: Float[np.ndarray, "nuisances samples"], **fields: Any
) -> ContactRecord:
    """Record at 1 kHz without motion, noise, drift or errors of displacement sensors, unless `fields` say otherwise."""
    none, still = np.zeros(len(nuisance_n)), np.zeros(force_n.size)
    defaults = {
        "eta_m": still,
        "velocity_m_per_s": still,
        "sample_rate_hz": 1000.0,
        "decimation": 1,
        "quiet_deviation_n": 0.0,
        "noise_n": 0.0,
        "unmodelled_share": 0.0,
        "drift": None,
        "drift_spline": spline(force_n.size, 1000.0, None),
        "force_noise_multiple": none,
        "shifts_eta": none > 0,
        "eta_noise_multiple": np.zeros(0),
        "nuisance_m": np.zeros((0, force_n.size), np.float32),
        "is_initial_state": none > 0,
    }
    return ContactRecord(force_n=force_n, nuisance_n=nuisance_n.astype(np.float32), **defaults | fields)
