"""Screening of effects by the modes of a free decay: frequencies and damping ratios alone.

A resonance that lies off by more than its width has no slope towards the measured one, so no fit over time or over
frequencies finds its way there; the logarithms of the frequencies have. With z those of measured over believed,

    cost = z' C^-1 z,   C = diag(error^2 + tolerance of the mode^2) + (common tolerance)^2 of the modes of a body
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from identify.gaps.residual.record import Record
from identify.gaps.residual.tuning import matched_modes
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.screening import STRENGTHS, Screened
from rig.errors import RigError
from rig.model.description import Rig

FOLLOWED, SAME = 3, 0.01
"""So many of an effect's places are followed; what ends nearer than this share of the range is the same."""
EVALUATIONS, STEP = 40, 1e-4
"""Steps from each, and the relative change for derivatives, above what modes are computed to."""


def ringing_screening(record: Record, rig: Rig, candidates: Sequence[Candidate]) -> list[Screened]:
    """The gain of the modes' cost for every effect at its best values, the best first; none where no modes are told."""
    if not record.modes:
        return []
    before = float(np.sum(mismatch_of(record, rig) ** 2))
    screened = []
    for candidate in candidates:
        if candidate.kind.stochastic or candidate.kind.grid_screened:
            continue
        screened += [Screened(candidate, before - cost, values) for cost, values in _followed(record, rig, candidate)]
    return sorted(screened, key=lambda one: -one.gain)


def mismatch_of(record: Record, rig: Rig) -> Float[np.ndarray, " mismatch"]:
    """Distance of the measured modes from a rig's, whitened by their errors and the tolerances."""
    modes, tolerances = matched_modes(record.modes, rig), record.tolerances
    own = [tolerances.of_mode(one.body, one.mode) for one in modes]
    together = np.equal.outer([one.body for one in modes], [one.body for one in modes])
    frequency = np.diag([m.measured.frequency_error**2 + t.frequency**2 for m, t in zip(modes, own, strict=True)])
    damping = np.diag([m.measured.damping_error**2 + t.damping**2 for m, t in zip(modes, own, strict=True)])
    covariance = block_diag(frequency + together * tolerances.frequency**2, damping + together * tolerances.damping**2)
    logarithms = np.array([one.logarithms for one in modes]).reshape(-1, 2)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), logarithms.T.ravel()))


def _followed(record: Record, rig: Rig, candidate: Candidate) -> list[tuple[float, Float[np.ndarray, " parameters"]]]:
    """Cost and values downhill from the best strength at each of the best places.

    Few modes may ask for one mass here or for another there: what the sensors show of their shapes tells which.
    """

    def mismatch(values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " mismatch"]:
        return mismatch_of(record, candidate.applied(rig, values))

    low, high = candidate.parameters.bounds
    starts = []
    for place in candidate.starts():
        fits = []
        for strength in candidate.strengths(STRENGTHS):
            values = np.append(strength, place[1:])
            with suppress(RigError):
                fits.append((float(np.sum(mismatch(values) ** 2)), values))
        starts += [min(fits, key=_cost)] if fits else []
    screened: list[tuple[float, Float[np.ndarray, " parameters"]]] = []
    step = {"diff_step": STEP, "x_scale": high - low, "max_nfev": EVALUATIONS}
    for one in sorted(starts, key=_cost)[:FOLLOWED]:
        best = one
        with suppress(RigError, ValueError):
            done = least_squares(mismatch, np.clip(one[1], low, high), bounds=(low, high), method="dogbox", **step)
            best = 2 * float(done.cost), done.x
        if all(np.any(np.abs(best[1] - other) > SAME * (high - low)) for _, other in screened):
            screened.append(best)
    return screened


def _cost(fit: tuple[float, Float[np.ndarray, " parameters"]]) -> float:
    return fit[0]
