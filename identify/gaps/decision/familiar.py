"""Figures of a record that people know: how much it shakes, how long and how often contacts are closed."""

import numpy as np

from identify.gaps.residual.residual import Linearization


def familiar_figures(linearization: Linearization) -> dict[str, tuple[float, str]]:
    """Value and unit by name; contacts as the linearisation's rig has them."""
    accelerations = linearization.record.in_time(linearization.record.delivered)
    found = {"acceleration, rms of all sensors": (float(np.sqrt(np.mean(accelerations**2))), "m/s^2")}
    seconds = accelerations.shape[1] / linearization.record.rate_hz
    for contact, seen in zip(linearization.model.rig.contacts, linearization.seen, strict=True):
        found[f"time that {contact.name} is closed"] = 100 * float(np.mean(seen.closed)), "%"
        found[f"impacts of {contact.name}"] = float(np.sum(np.diff(seen.closed) > 0)) / seconds, "1/s"
    return found
