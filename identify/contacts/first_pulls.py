"""A first guess of how a record that begins in motion began: what the modes' free motion from there adds to a contact's
force may be many times the force.

A contact is open for much of the time. So theta of

    force(t) = theta' nuisance_n(t) + contact force(t)

is found by least absolute deviations, with the prior of one on each theta.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from identify.contacts.start import ContactRecord
from identify.signals.refit import refit_until_settled

ROUNDS = 30
LEAST = 1e-3
"""Deviations below this share of the median one weigh no more."""


def first_pulls(seen: ContactRecord) -> Float[np.ndarray, " nuisances"]:
    """Zero of all that are not initial; by iteratively reweighted least squares."""
    pulls = np.zeros(len(seen.nuisance_n))
    if not np.any(seen.initial):
        return pulls
    columns = seen.nuisance_n[seen.initial].astype(float)

    def reweighted(theta: Float[np.ndarray, " initial"]) -> Float[np.ndarray, " initial"]:
        size = np.abs(seen.force_n - theta @ columns)
        middle = max(float(np.median(size)), 1e-300)
        weighed = columns / np.maximum(size, LEAST * middle)
        prior = np.eye(len(columns)) / middle
        return np.linalg.solve(weighed @ columns.T + prior, weighed @ seen.force_n)

    pulls[seen.initial] = refit_until_settled(pulls[seen.initial], reweighted, rounds=ROUNDS)
    return pulls


def contact_alone(seen: ContactRecord, pulls: Float[np.ndarray, " nuisances"]) -> ContactRecord:
    """Without what a first guess adds to its force."""
    return replace(seen, force_n=seen.force_n - pulls @ seen.nuisance_n) if pulls.any() else seen
