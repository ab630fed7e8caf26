"""Hypotheses compared on the record that was not fitted: posterior probabilities, and what each closes and leaves."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.fit import fit
from identify.gaps.residual.likelihood import Misfit, Reference, misfit
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, residual_of
from identify.gaps.results import Matters
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis, applied, steps_of
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.model.description import Rig

TEMPERATURE = 6.0
"""-2 ln p counts for so much less between hypotheses than within one: what lasts of the unmodelled is shared by
neighbouring bands and by both records. On tuning cases the likelihood of the right hypotheses is largest at 7.9, the
Brier score least at 5.1."""
PRIOR_NOTHING, PRIOR_SOME, PRIOR_UNKNOWN = 0.3, 0.5, 0.2
"""Before anything was recorded: nothing, effects of the library, something that the library does not hold."""
ANOTHER = 0.43
"""Of machines with k effects so many have k + 1: as 0.15 to 0.35, two effects to one."""
DRAWS = 400


@dataclass(frozen=True)
class Judged:
    """A hypothesis with its rig laid against the validation record, nuisance parameters fitted there anew.

    rig is the believed one with the effects; corrected also holds what was fitted beside them, and leaves misfit.
    without is what the believed rig leaves with the same nuisance parameters: what the effects, by themselves, close.
    Of a base that moves, which is no function of time, it is what the believed rig leaves with its own. contact_fit is
    -2 ln p of its contact laws by the contact fit of all records, where that was made.
    """

    hypothesis: Hypothesis
    rig: Rig
    corrected: Rig
    misfit: Misfit
    without: Misfit
    log_prior: float
    contact_fit: float = 0.0

    @property
    def log_posterior(self) -> float:
        """Given the validation record, and the contact fit, whose covariance needs no temperature; up to a constant."""
        return self.log_prior - self.misfit.minus_two_log / (2 * TEMPERATURE) - self.contact_fit / 2

    @property
    def log_posterior_of_both(self) -> float:
        """Given the record that was fitted too."""
        return self.log_posterior - self.hypothesis.cost / (2 * TEMPERATURE)


def judged(
    record: Record,
    reference: Reference,
    believed: Residual,
    hypotheses: Sequence[Hypothesis],
    priors: Mapping[tuple[str, ...], float],
    progress: Callable[[float], None] = lambda _: None,
) -> list[Judged]:
    """Every hypothesis that the validation record can hold, the likeliest first.

    `believed` is the residual of the believed rig there. What each record has its own of (the phase of a tone) is
    fitted anew.
    """
    found = []
    alone = misfit(record, reference, believed)
    for i, one in enumerate(hypotheses):
        rig, corrected, left, without = record.rig, record.rig, alone, alone
        if one.parts:
            try:
                rig = of_this_record(record, one)
                linearization, at = fit_nuisance(record, rig, rounds=1)
            except RigError:
                continue
            corrected = at.corrected_rig
            left, without = misfit(record, reference, at), left_without(record, reference, linearization, at) or alone
        found.append(Judged(one, rig, corrected, left, without, priors[one.key]))
        progress((i + 1) / len(hypotheses))
    return sorted(found, key=lambda j: -j.log_posterior)


def left_without(record: Record, reference: Reference, linearization: Linearization, at: Residual) -> Misfit | None:
    """Misfit of the nominal rig with the nuisance parameters of a rig with effects.

    None where the residuals have not the same rows: a base that moves has one more.
    """
    if (linearization.rig.base_motion is None) != (record.rig.base_motion is None):
        return None
    unknowns = tuple(c.unknowns for c in at.contacts)
    return misfit(record, reference, residual_of(linearization, record.rig, at.nuisance, unknowns))


def of_this_record(record: Record, one: Hypothesis) -> Rig:
    """The rig with the hypothesis, and what every record has its own of (a tone's phase) fitted to this one."""
    own_of = {part.name: part.kind.of_a_record for part in one.parts}
    own = [i for i, p in enumerate(one.parameters) if p.name in own_of[p.of]]
    if not own:
        return one.applied_to(record.rig)

    def build(values: Float[np.ndarray, " own"]) -> Rig:
        every = one.values.copy()
        every[own] = values
        return applied(record.rig, one.parts, every)

    about = record.rig  # with a base motion's row, if there is one
    for part, values in zip(one.parts, one.split(), strict=True):
        about = part.applied(about, values) if part.kind.stochastic else about
    linearization, at = fit_nuisance(record, about, rounds=1)
    steps = steps_of(one.parts)[own]
    low, high = (ends[own] for ends in one.parameters.bounds)
    return build(fit(linearization, build, one.values[own], steps, (low, high), at).values)


def log_priors(hypotheses: Sequence[Hypothesis], known: Sequence[Candidate]) -> dict[tuple[str, ...], float]:
    """Every effect of the library is as likely as any other, and as likely at each of its places."""
    placed = Counter(candidate.kind.name for candidate in known)
    return {one.key: log_prior(one.effects, placed) for one in hypotheses}


def log_prior(effects: Sequence[str], placed: Mapping[str, int]) -> float:
    """Log prior of effects at one place each, of which one may stand twice; `placed` counts the places of every effect.

    With K effects in the library k of them have C(K + k - 1, k) sets, all as likely.
    """
    count = len(effects)
    if not count:
        return float(np.log(PRIOR_NOTHING))
    among = PRIOR_SOME * (1 - ANOTHER) * ANOTHER ** (count - 1) / comb(max(1, len(placed)) + count - 1, count)
    return float(np.log(among) - sum(np.log(placed[name]) for name in effects))


def probabilities(log_posteriors: Float[np.ndarray, " hypotheses"]) -> Float[np.ndarray, " hypotheses"]:
    """Probabilities of log posteriors that are known up to a constant."""
    likely = np.exp(log_posteriors - log_posteriors.max())
    return np.asarray(likely / likely.sum())


def size(left: Misfit, matters: Matters) -> float:
    """The size of a gap in units of what matters."""
    return matters.times(left.share, left.contact_shares.tolist())


def closed(without: Misfit, after: Misfit, matters: Matters) -> float:
    """The share of the gap that effects close: 1 - size after / size without them; zero where there was none."""
    whole = size(without, matters)
    return 1 - size(after, matters) / whole if whole > 0 else 0.0


def removed(nominal: Misfit, without: Misfit, after: Misfit, matters: Matters) -> float:
    """The share of the gap that effects remove. Where nothing is left beyond noise without them either, as tolerances
    or free contact forces take it up, it is the share of what strains these: |pulls|^2 and the excess of -2 ln p."""
    if size(without, matters) > 0:
        return closed(without, after, matters)
    whole, rest = (float(left.pulls @ left.pulls) + left.excess for left in (nominal, after))
    return 1 - rest / whole if whole > 0 else 0.0


def closed_interval(without: Misfit, after: Misfit, matters: Matters) -> tuple[float, float]:
    """Its 95 % interval: a bootstrap over the seconds of the record."""
    rng = np.random.default_rng(0)
    seconds = len(after.left)
    drawn = rng.integers(0, seconds, (DRAWS, seconds))
    many = [closed(without.drawn(d), after.drawn(d), matters) for d in drawn]
    low, high = np.quantile(many, [0.025, 0.975])
    return float(low), float(high)
