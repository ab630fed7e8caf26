"""A first guess of what moves a contact's force more than the contact itself: how a record that begins in motion began.

A contact is open for much of the time. So theta of

    force(t) = theta' nuisance_n(t) + contact force(t)

is found by least absolute deviations, with the prior of one on each theta.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from identify.contacts.start import ContactRecord

LARGE = 0.1
"""A nuisance parameter counts if one standard deviation of it is so large a share of the force's root mean square."""
ROUNDS = 30
LEAST = 1e-3
"""Deviations below this share of the median one weigh no more."""


def first_pulls(seen: ContactRecord) -> Float[np.ndarray, " nuisances"]:
    """Zero of all that do not count; by iteratively reweighted least squares."""
    pulls = np.zeros(len(seen.nuisance_n))
    sizes = np.array([np.sqrt(np.mean(row.astype(float) ** 2)) for row in seen.nuisance_n])
    counted = np.flatnonzero(sizes > LARGE * np.sqrt(np.mean(seen.force_n**2)))
    if not counted.size:
        return pulls
    columns = seen.nuisance_n[counted].astype(float)
    left = seen.force_n
    for _ in range(ROUNDS):
        size = np.abs(left)
        middle = max(float(np.median(size)), 1e-300)
        weighed = columns / np.maximum(size, LEAST * middle)
        prior = np.eye(counted.size) / middle
        pulls[counted] = np.linalg.solve(weighed @ columns.T + prior, weighed @ seen.force_n)
        left = seen.force_n - pulls[counted] @ columns
    return pulls


def contact_alone(seen: ContactRecord, pulls: Float[np.ndarray, " nuisances"]) -> ContactRecord:
    """With a force that lacks what so large nuisance parameters add to it."""
    return replace(seen, force_n=seen.force_n - pulls @ seen.nuisance_n) if pulls.any() else seen
