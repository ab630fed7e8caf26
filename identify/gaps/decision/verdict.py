"""Decision from validated hypotheses: their probabilities, the named effects, the evidence and its verdict."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identify.gaps.decision.bounds import Difference, share_bounds
from identify.gaps.decision.comparison import (
    PRIOR_UNKNOWN,
    TEMPERATURE,
    ValidatedHypothesis,
    nominal_of,
    probabilities,
    removed_share,
)
from identify.gaps.decision.null_reference import NullReference, p_value
from identify.gaps.decision_table import DIFFERENCE_P_VALUE, USUAL_P_VALUE, Evidence, Strength, Verdict
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import Matters
from identify.gaps.search.candidates import ATTACHED_FIELDS, Candidate
from identify.gaps.search.hypothesis import Hypothesis
from identify.gaps.unmeasured_force.force import SAME_M
from identify.gaps.unmeasured_force.location import ForcePlace
from identify.pages.wording import COVERED
from rig.model.description import Rig

UNKNOWN_PLACES = 100
"""Distinguishable places of an unknown force (bodies of some metres, 20 mm each). Derived: two bodies of 1 m, 20 mm
apart, the accuracy of a weak force's place."""
RIVAL_PROBABILITY = 0.05
"""Probability from which a hypothesis cannot be told from the likeliest one. Set by hand."""
CORRECTING_VERDICTS = (Verdict.SMALL, Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED)
"""Verdicts with which named effects correct the rig."""


@dataclass(frozen=True)
class WeightedHypothesis:
    """A validated hypothesis and its posterior probability."""

    validated: ValidatedHypothesis
    probability: float


@dataclass(frozen=True)
class ForceRivals:
    """-2 ln p of the validation record with an unmeasured force: with the best one in the nominal rig, and with the
    best one beside the hypothesis `accompanied`. None where no force was looked for."""

    minus_two_log_nominal: float | None = None
    accompanied: ValidatedHypothesis | None = None
    minus_two_log_accompanied: float | None = None


@dataclass(frozen=True)
class Decision:
    """Evidence with its verdict, the hypotheses, likeliest first, and the probability of something unmeasured.

    named is the hypothesis of the named effects alone, if it was validated, else the likeliest one with effects.
    """

    evidence: Evidence
    weighted: tuple[WeightedHypothesis, ...]
    probability_unmeasured: float
    named: ValidatedHypothesis | None

    @property
    def verdict(self) -> Verdict:
        return self.evidence.verdict

    @property
    def nominal(self) -> ValidatedHypothesis:
        """Hypothesis of the nominal rig."""
        return nominal_of([item.validated for item in self.weighted])

    @property
    def probability_nothing(self) -> float:
        return next(item.probability for item in self.weighted if item.validated is self.nominal)

    @property
    def corrects_rig(self) -> bool:
        """True if named effects correct the rig."""
        return self.verdict in CORRECTING_VERDICTS and bool(self.evidence.named) and not self.evidence.vetoed

    @property
    def likeliest_rig(self) -> Rig | None:
        """Rig with the named effects and the fitted nuisance parameters, whatever the verdict."""
        return self.named.corrected_rig if self.named else None

    @property
    def corrected_rig(self) -> Rig | None:
        return self.likeliest_rig if self.corrects_rig else None

    @property
    def named_misfit(self) -> Misfit:
        """Misfit with the named effects, or of the nominal rig without any."""
        return self.named.misfit if self.named else self.nominal.misfit

    @property
    def misfit_to_describe(self) -> Misfit:
        """Misfit with the named effects if they explain a part, else of the nominal rig."""
        return self.named_misfit if self.verdict == Verdict.PARTLY_EXPLAINED else self.nominal.misfit


def decide(
    ranked: Sequence[ValidatedHypothesis],
    difference: Difference,
    null_reference: NullReference,
    matters: Matters,
    rivals: ForceRivals | None = None,
    vetoed: bool = False,
) -> Decision:
    """Decide from validated hypotheses, likeliest first.

    An unmeasured force is a rival of the effects; a force beside them adds its likelihood to theirs. Where the records
    differ from the nominal rig but the validation record alone does not show it, the fitted record counts too.
    """
    rivals, nominal = rivals or ForceRivals(), nominal_of(ranked)
    held_back_shows = (
        difference.p_value >= DIFFERENCE_P_VALUE or p_value(null_reference, nominal.misfit) < USUAL_P_VALUE
    )
    scores = [item.log_posterior if held_back_shows else item.log_posterior_of_both for item in ranked]
    for k, validated in enumerate(ranked):
        if validated is rivals.accompanied:
            with_force = _force_log_posterior(validated.log_prior, rivals.minus_two_log_accompanied)
            scores[k] = float(np.logaddexp(scores[k], with_force))
    scores.append(_force_log_posterior(0.0, rivals.minus_two_log_nominal))
    *shares, probability_unmeasured = (float(p) for p in probabilities(np.array(scores)))
    weighted = tuple(
        WeightedHypothesis(*pair) for pair in sorted(zip(ranked, shares, strict=True), key=lambda pair: -pair[1])
    )
    likeliest = next((item.validated for item in weighted if item.validated.hypothesis.candidates), None)
    strengths = strengths_of(likeliest.hypothesis, weighted) if likeliest else ()
    named = _named_hypothesis(likeliest, strengths, ranked) if likeliest else None
    named_or_nominal = named or nominal
    contacts = [quantity.name for quantity in difference.contacts]
    evidence = Evidence(
        p_value=difference.p_value,
        quantities=difference.quantities,
        strengths=strengths,
        p_value_after=p_value(null_reference, named_or_nominal.misfit),
        quantities_after=share_bounds(named_or_nominal.misfit, contacts, matters),
        removed=removed_share(nominal.misfit, named_or_nominal.nominal_misfit, named_or_nominal.misfit, matters),
        vetoed=vetoed,
        held_back_shows=held_back_shows,
    )
    return Decision(evidence, weighted, probability_unmeasured, named)


def strengths_of(hypothesis: Hypothesis, weighted: Sequence[WeightedHypothesis]) -> tuple[Strength, ...]:
    """Strength of every effect of a hypothesis, and the inclusion probability of it or a look-alike in its place.

    Of several strengths of an effect, the one that is most standard errors from its neutral value.
    """
    strengths, first_column = [], 0
    errors = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    for candidate in hypothesis.candidates:
        columns = range(first_column, first_column := first_column + len(candidate.parameters))
        look_alikes = _look_alikes(hypothesis, candidate, weighted)
        neutral_values = {
            k: p.neutral for k, p in zip(columns, candidate.parameters, strict=True) if p.neutral is not None
        }
        significance = {
            k: abs(hypothesis.values[k] - neutral) / max(errors[k], 1e-300) for k, neutral in neutral_values.items()
        }
        k = max(significance, key=lambda column: float(significance[column]))
        value, half_width = float(hypothesis.values[k]), float(COVERED * errors[k])
        names = {candidate.name, *look_alikes}
        probability = sum(item.probability for item in weighted if names & set(item.validated.hypothesis.key))
        interval = (value - half_width, value + half_width)
        strengths.append(Strength(candidate.name, probability, interval, float(neutral_values[k]), look_alikes))
    return tuple(strengths)


def strengths_exclude_neutral(hypothesis: Hypothesis) -> bool:
    """True if a hypothesis has effects, and the 95 % interval of every strength excludes its neutral value."""
    strengths = strengths_of(hypothesis, ())
    return bool(strengths) and all(not s.interval_95[0] <= s.neutral <= s.interval_95[1] for s in strengths)


def _look_alikes(
    hypothesis: Hypothesis, candidate: Candidate, weighted: Sequence[WeightedHypothesis]
) -> tuple[str, ...]:
    """Names of candidates that replace an effect in other hypotheses above `RIVAL_PROBABILITY`."""
    key = Counter(hypothesis.key)
    look_alikes: list[str] = []
    for rival in (item.validated.hypothesis for item in weighted if item.probability > RIVAL_PROBABILITY):
        added, removed = Counter(rival.key) - key, key - Counter(rival.key)
        if removed == Counter([candidate.name]) and added.total() == 1:
            look_alikes += added
    return tuple(dict.fromkeys(look_alikes))


def _named_hypothesis(
    likeliest: ValidatedHypothesis, strengths: Sequence[Strength], ranked: Sequence[ValidatedHypothesis]
) -> ValidatedHypothesis:
    """Hypothesis of the named effects alone; the likeliest one if none is named, or if that was not validated."""
    key = tuple(sorted(s.effect for s in strengths if s.is_named))
    return next((item for item in ranked if key and item.hypothesis.key == key), likeliest)


def acts_at_effects(force: ForcePlace, nominal: Rig, corrected: Rig) -> bool:
    """True if an unmeasured force acts at an attachment, or at a contact or in a sensor that effects changed.

    One force of another law is then a rival of the effects, no companion.
    """
    if force.kind == "sensor":
        changed = [
            after.name for before, after in zip(nominal.sensors, corrected.sensors, strict=True) if before != after
        ]
        return changed == [force.sensor]
    pairs = zip(corrected.contacts, nominal.contacts, strict=True)
    effect_stations = [contact.at for contact, nominal_contact in pairs if contact.law != nominal_contact.law]
    for kind in ATTACHED_FIELDS:
        effect_stations += [item.station for item in getattr(corrected, kind)[len(getattr(nominal, kind)) :]]
    return any(
        force_station.body == station.body and abs(force_station.position_m - station.position_m) <= SAME_M
        for force_station in force.stations
        for station in effect_stations
    )


def _force_log_posterior(log_prior: float, cost: float | None) -> float:
    """Log posterior of an unmeasured force, which may be at any of `UNKNOWN_PLACES`; -inf without one."""
    if cost is None:
        return -np.inf
    return log_prior + float(np.log(PRIOR_UNKNOWN / UNKNOWN_PLACES)) - cost / (2 * TEMPERATURE)
