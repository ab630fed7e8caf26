"""Hypotheses compared on the record that was not fitted: posterior probabilities, and what each closes and leaves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gap.likelihood import Misfit, Reference, misfit
from identify.gap.residual import Base, Residual
from identify.gap.search.joint import Hypothesis
from identify.gap.search.nominal import fit_nuisance
from identify.gap.spectra import Record
from rig.errors import RigError

TEMPERATURE = 4.0
"""-2 ln p counts for so much less between hypotheses than within one: what lasts of the unmodelled is shared by
neighbouring bands and by both records. Found by the likelihood of the right names on the tuning seeds of the blind
worlds (`python -m scenarios.blind_gap calibrate`)."""
PRIOR_NOTHING, PRIOR_SINGLE, PRIOR_PAIR, PRIOR_UNKNOWN = 0.3, 0.35, 0.15, 0.2
"""Before anything was recorded: no gap, one effect, two effects, something that the library does not hold."""


@dataclass(frozen=True)
class Judged:
    """A hypothesis with its rig laid against the validation record, nuisance parameters fitted there anew."""

    hypothesis: Hypothesis
    base: Base
    residual: Residual
    misfit: Misfit
    log_prior: float

    @property
    def score(self) -> float:
        """Log posterior up to a constant: of the hypothesis given the validation record."""
        return self.log_prior - self.misfit.minus_two_log / (2 * TEMPERATURE)


def judged(
    record: Record, reference: Reference, hypotheses: Sequence[Hypothesis], priors: Mapping[frozenset[str], float]
) -> list[Judged]:
    """Every hypothesis that the validation record can hold, the likeliest first."""
    found = []
    for one in hypotheses:
        try:
            base, at = fit_nuisance(record, one.applied_to(record.rig), rounds=1)
        except RigError:
            continue
        found.append(Judged(one, base, at, misfit(record, reference, base, at), priors[one.key]))
    return sorted(found, key=lambda j: -j.score)


def log_priors(hypotheses: Sequence[Hypothesis], names: Sequence[str], placed: Mapping[str, int]) -> dict[frozenset[str], float]:
    """Every effect of the library is as likely as any other, and as likely at each of its places."""
    singles = len(names)
    pairs = singles * (singles - 1) / 2
    found = {}
    for one in hypotheses:
        places = float(np.prod([placed[p.kind.name] for p in one.parts])) if one.parts else 1.0
        among = {0: PRIOR_NOTHING, 1: PRIOR_SINGLE / singles, 2: PRIOR_PAIR / pairs}[len(one.parts)]
        found[one.key] = float(np.log(among / places))
    return found


def probabilities(scores: Float[np.ndarray, " hypotheses"]) -> Float[np.ndarray, " hypotheses"]:
    """From log posteriors up to a constant."""
    likely = np.exp(scores - scores.max())
    return np.asarray(likely / likely.sum())
