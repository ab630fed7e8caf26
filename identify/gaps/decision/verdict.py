"""Decision from validated hypotheses: their probabilities, the named effects, the evidence and its verdict."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identify.gaps.decision.bounds import NominalDifference, share_bounds
from identify.gaps.decision.comparison import (
    PRIOR_UNKNOWN,
    TEMPERATURE,
    ValidatedHypothesis,
    nominal_hypothesis_of,
    probabilities,
    removed_share,
)
from identify.gaps.decision.null_reference import NullReference, p_value
from identify.gaps.decision_table import DIFFERENCE_P_VALUE, USUAL_P_VALUE, Evidence, Strength, Verdict
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import Matters
from identify.gaps.search.candidates import ATTACHED_FIELDS, Candidate
from identify.gaps.search.hypothesis import Hypothesis
from identify.gaps.unmeasured_force.force import SAME_PLACE_M
from identify.gaps.unmeasured_force.location import ForcePlace
from identify.pages.wording import COVERED
from rig.model.description import Rig

FORCE_PLACE_COUNT = 100
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
    best one beside the hypothesis `accompanied_hypothesis`. None where no force was looked for."""

    nominal_cost: float | None = None
    accompanied_hypothesis: ValidatedHypothesis | None = None
    accompanied_cost: float | None = None


@dataclass(frozen=True)
class Decision:
    """Evidence with its verdict, the hypotheses, likeliest first, and the probability of something unmeasured.

    named_hypothesis is that of the named effects alone, if it was validated, else the likeliest one with effects.
    """

    evidence: Evidence
    weighted_hypotheses: tuple[WeightedHypothesis, ...]
    probability_unmeasured: float
    named_hypothesis: ValidatedHypothesis | None

    @property
    def verdict(self) -> Verdict:
        return self.evidence.verdict

    @property
    def nominal_hypothesis(self) -> ValidatedHypothesis:
        """Hypothesis of the nominal rig."""
        return nominal_hypothesis_of([weighted.validated for weighted in self.weighted_hypotheses])

    @property
    def probability_nothing(self) -> float:
        weighted_hypotheses, nominal = self.weighted_hypotheses, self.nominal_hypothesis
        return next(weighted.probability for weighted in weighted_hypotheses if weighted.validated is nominal)

    @property
    def corrects_rig(self) -> bool:
        """True if named effects correct the rig."""
        return self.verdict in CORRECTING_VERDICTS and bool(self.evidence.named) and not self.evidence.vetoed

    @property
    def rig_with_named_effects(self) -> Rig | None:
        """Rig with the named effects and the fitted nuisance parameters, whatever the verdict."""
        return self.named_hypothesis.corrected_rig if self.named_hypothesis else None

    @property
    def corrected_rig(self) -> Rig | None:
        return self.rig_with_named_effects if self.corrects_rig else None

    @property
    def named_misfit(self) -> Misfit:
        """Misfit with the named effects, or of the nominal rig without any."""
        return self.named_hypothesis.misfit if self.named_hypothesis else self.nominal_hypothesis.misfit

    @property
    def misfit_to_describe(self) -> Misfit:
        """Misfit with the named effects if they explain a part, else of the nominal rig."""
        return self.named_misfit if self.verdict == Verdict.PARTLY_EXPLAINED else self.nominal_hypothesis.misfit


def decide(
    ranked_hypotheses: Sequence[ValidatedHypothesis],
    difference: NominalDifference,
    null_reference: NullReference,
    matters: Matters,
    force_rivals: ForceRivals | None = None,
    is_vetoed: bool = False,
) -> Decision:
    """Decide from validated hypotheses, likeliest first.

    An unmeasured force is a rival of the effects; a force beside them adds its likelihood to theirs. Where the records
    differ from the nominal rig but the validation record alone does not show it, the fitted record counts too.
    """
    force_rivals, nominal = force_rivals or ForceRivals(), nominal_hypothesis_of(ranked_hypotheses)
    held_back_shows = (
        difference.p_value >= DIFFERENCE_P_VALUE or p_value(null_reference, nominal.misfit) < USUAL_P_VALUE
    )

    def log_posterior_of(validated: ValidatedHypothesis) -> float:
        log_posterior = validated.log_posterior if held_back_shows else validated.log_posterior_of_both_records
        if validated is not force_rivals.accompanied_hypothesis:
            return log_posterior
        log_posterior_with_force = _force_log_posterior(validated.log_prior, force_rivals.accompanied_cost)
        return float(np.logaddexp(log_posterior, log_posterior_with_force))

    log_posteriors = [*map(log_posterior_of, ranked_hypotheses), _force_log_posterior(0.0, force_rivals.nominal_cost)]
    *posteriors, probability_unmeasured = probabilities(np.array(log_posteriors)).tolist()
    weighted_hypotheses = sorted(
        map(WeightedHypothesis, ranked_hypotheses, posteriors), key=lambda weighted: -weighted.probability
    )
    strengths: tuple[Strength, ...] = ()
    named_hypothesis = next((w.validated for w in weighted_hypotheses if w.validated.hypothesis.candidates), None)
    if named_hypothesis:
        strengths = strengths_of(named_hypothesis.hypothesis, weighted_hypotheses)
        named_hypothesis = _named_hypothesis(named_hypothesis, strengths, weighted_hypotheses)
    chosen = named_hypothesis or nominal
    contact_names = [quantity.name for quantity in difference.contact_bounds]
    are_any_named = any(strength.is_named for strength in strengths)
    evidence = Evidence(
        p_value=difference.p_value,
        quantities=difference.quantities,
        strengths=strengths,
        p_value_after=p_value(null_reference, chosen.misfit),
        quantities_after=share_bounds(chosen.misfit, contact_names, matters),
        removed=removed_share(nominal.misfit, chosen.nominal_misfit, chosen.misfit, matters),
        vetoed=is_vetoed,
        held_back_shows=held_back_shows,
        quantities_beside=share_bounds(chosen.nominal_misfit, contact_names, matters) if are_any_named else (),
    )
    return Decision(evidence, tuple(weighted_hypotheses), probability_unmeasured, named_hypothesis)


def strengths_of(hypothesis: Hypothesis, weighted_hypotheses: Sequence[WeightedHypothesis]) -> tuple[Strength, ...]:
    """Strength of every effect of a hypothesis, and the inclusion probability of it or a look-alike in its place.

    Of several strengths of an effect, the one that is most standard errors from its neutral value.
    """
    strengths, first_column = [], 0
    standard_errors = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    for candidate in hypothesis.candidates:
        columns = range(first_column, first_column := first_column + len(candidate.parameters))
        neutral_values = {
            column: parameter.neutral
            for column, parameter in zip(columns, candidate.parameters, strict=True)
            if parameter.neutral is not None
        }
        deviation_in_errors = {
            column: float(abs(hypothesis.values[column] - neutral_value) / max(standard_errors[column], 1e-300))
            for column, neutral_value in neutral_values.items()
        }
        column = max(deviation_in_errors, key=deviation_in_errors.__getitem__)
        strength, half_width = float(hypothesis.values[column]), float(COVERED * standard_errors[column])
        look_alikes = _look_alike_names(hypothesis, candidate, weighted_hypotheses)
        interchangeable_names = {candidate.name, *look_alikes}
        inclusion_probability = sum(
            weighted.probability
            for weighted in weighted_hypotheses
            if interchangeable_names & set(weighted.validated.hypothesis.effect_names)
        )
        interval_95 = (strength - half_width, strength + half_width)
        neutral = float(neutral_values[column])
        strengths.append(Strength(candidate.name, inclusion_probability, interval_95, neutral, look_alikes))
    return tuple(strengths)


def strengths_exclude_neutral(hypothesis: Hypothesis) -> bool:
    """True if a hypothesis has effects, and the 95 % interval of every strength excludes its neutral value."""
    strengths = strengths_of(hypothesis, ())
    return bool(strengths) and not any(
        strength.interval_95[0] <= strength.neutral <= strength.interval_95[1] for strength in strengths
    )


def _look_alike_names(
    hypothesis: Hypothesis, candidate: Candidate, weighted_hypotheses: Sequence[WeightedHypothesis]
) -> tuple[str, ...]:
    """Names of candidates that replace an effect in other hypotheses above `RIVAL_PROBABILITY`."""
    effect_counts = Counter(hypothesis.effect_names)
    look_alike_names: list[str] = []
    for weighted in weighted_hypotheses:
        rival_counts = Counter(weighted.validated.hypothesis.effect_names)
        added_effects, removed_effects = rival_counts - effect_counts, effect_counts - rival_counts
        is_look_alike = removed_effects == Counter([candidate.name]) and added_effects.total() == 1
        if is_look_alike and weighted.probability > RIVAL_PROBABILITY:
            look_alike_names += added_effects
    return tuple(dict.fromkeys(look_alike_names))


def _named_hypothesis(
    likeliest: ValidatedHypothesis, strengths: Sequence[Strength], weighted_hypotheses: Sequence[WeightedHypothesis]
) -> ValidatedHypothesis:
    """Hypothesis of the named effects alone; the likeliest one if none is named, or if that was not validated or would
    by itself not name them."""
    named_effects = tuple(sorted(strength.effect for strength in strengths if strength.is_named))
    for validated in (weighted.validated for weighted in weighted_hypotheses if named_effects):
        if validated.hypothesis.effect_names == named_effects and all(
            strength.is_named for strength in strengths_of(validated.hypothesis, weighted_hypotheses)
        ):
            return validated
    return likeliest


def is_force_at_effects(force_place: ForcePlace, nominal_rig: Rig, corrected_rig: Rig) -> bool:
    """True if an unmeasured force acts at an attachment, or at a contact or in a sensor that effects changed.

    One force of another law is then a rival of the effects, no companion.
    """
    if force_place.kind == "sensor":
        sensor_pairs = zip(nominal_rig.sensors, corrected_rig.sensors, strict=True)
        return [corrected.name for nominal, corrected in sensor_pairs if nominal != corrected] == [
            force_place.sensor_name
        ]
    contact_pairs = zip(nominal_rig.contacts, corrected_rig.contacts, strict=True)
    effect_stations = [corrected.at for nominal, corrected in contact_pairs if nominal.law != corrected.law]
    for field in ATTACHED_FIELDS:
        nominal_count = len(getattr(nominal_rig, field))
        effect_stations += [attached.station for attached in getattr(corrected_rig, field)[nominal_count:]]
    return any(
        force_station.body == effect_station.body
        and abs(force_station.position_m - effect_station.position_m) <= SAME_PLACE_M
        for force_station in force_place.stations
        for effect_station in effect_stations
    )


def _force_log_posterior(log_prior: float, force_minus_two_log: float | None) -> float:
    """Log posterior of an unmeasured force, which may be at any of `FORCE_PLACE_COUNT`; -inf without one."""
    if force_minus_two_log is None:
        return -np.inf
    return log_prior + float(np.log(PRIOR_UNKNOWN / FORCE_PLACE_COUNT)) - force_minus_two_log / (2 * TEMPERATURE)
