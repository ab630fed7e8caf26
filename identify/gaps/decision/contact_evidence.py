"""Evidence for and against hypotheses from the contact fit of all records.

The statistic of a record is hardly sensitive to the damping of a contact, which the contact fit determines to a few per
cent. With d the distance of the n fitted quantities (clearances, stiffness, damping) of a contact from its law in a
hypothesis, C their covariance and S that of the tolerances,

    -2 ln p  +=  d' (C + S)^-1 d - n        of every contact whose law is the nominal one in other numbers

The expectation n is subtracted, so that a law of another kind, to which the fit does not apply, is neither favoured
nor penalised. Values of the fit beyond their tolerances make a hypothesis of their own.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from identify.gaps.decision.bounds import NominalDifference, law_distance
from identify.gaps.decision.comparison import (
    ValidatedHypothesis,
    log_priors,
    nominal_hypothesis_of,
    validate_hypotheses,
)
from identify.gaps.decision.prepare import PreparedRecordings
from identify.gaps.residual.likelihood import misfit
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Residual
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.contact_laws import (
    LawEstimate,
    LawOutcomes,
    law_outcomes,
    parameters_alone_differ,
    with_contact_fit,
)
from identify.gaps.search.hypothesis import CHANCE_PULL, Hypothesis
from identify.gaps.search.nominal import fit_nuisance
from rig.model.description import Contact, Rig
from rig.model.tolerances import Tolerances
from rig.recording import Recording

CONTACT_EFFECTS = ("contact_clearance", "contact_stiffness", "contact_damping")
"""Effects on the quantities of a contact fit, in their order."""


def with_contact_evidence(
    prepared: PreparedRecordings,
    candidates: Sequence[Candidate],
    ranked: Sequence[ValidatedHypothesis],
    difference: NominalDifference,
    validation_residual: Residual,
) -> list[ValidatedHypothesis]:
    """Hypotheses with their `contact_minus_two_log`, and that of the contact fit itself; the likeliest first.

    validation_residual is that of the nominal rig on the validation record.
    """
    estimates, validation = difference.contact_estimates, prepared.validation_recording
    contact_hypothesis = _hypothesis_of_contact_fit(
        prepared, candidates, estimates, nominal_hypothesis_of(ranked).hypothesis
    )
    hypotheses = list(ranked)
    if contact_hypothesis and all(
        contact_hypothesis.effect_names != validated.hypothesis.effect_names for validated in ranked
    ):
        log_prior_by_effects = log_priors([contact_hypothesis], candidates)
        record, variances = validation.record, validation.nominal_variances
        hypotheses += validate_hypotheses(
            record, variances, validation_residual, [contact_hypothesis], log_prior_by_effects
        )
    hypotheses_with_costs = [with_contact_cost(validated, estimates, validation.record) for validated in hypotheses]
    return sorted(hypotheses_with_costs, key=lambda validated: -validated.log_posterior)


def with_contact_cost(
    validated: ValidatedHypothesis, estimates: Sequence[LawEstimate], record: Record
) -> ValidatedHypothesis:
    """Hypothesis with the `contact_minus_two_log` of all contacts that the fit determines."""
    costs = (contact_minus_two_log(estimate, record.rig, validated.rig, record.tolerances) for estimate in estimates)
    return replace(validated, contact_minus_two_log=float(sum(costs)))


def contact_minus_two_log(
    estimate: LawEstimate, nominal_rig: Rig, hypothesis_rig: Rig, tolerances: Tolerances
) -> float:
    """-2 ln p of one contact in `hypothesis_rig`: d' (C + S)^-1 d - n; zero for a law of another kind."""
    nominal_contact = _contact_of_estimate(nominal_rig, estimate)
    contact = _contact_of_estimate(hypothesis_rig, estimate)
    if not parameters_alone_differ(contact.law, nominal_contact.law):
        return 0.0
    return law_distance(estimate, contact, nominal_contact, tolerances).chi_squared - estimate.quantity_values.size


def _contact_of_estimate(rig: Rig, estimate: LawEstimate) -> Contact:
    return next(contact for contact in rig.contacts if contact.name == estimate.contact_name)


def _hypothesis_of_contact_fit(
    prepared: PreparedRecordings,
    candidates: Sequence[Candidate],
    estimates: Sequence[LawEstimate],
    nominal_hypothesis: Hypothesis,
) -> Hypothesis | None:
    """Nominal rig with the effects of the contact fit, on the searched record; None without any."""
    fitted = hypothesis_with_contact_effects(prepared, candidates, estimates, nominal_hypothesis)
    if fitted is None:
        return None
    searched_recording = prepared.searched_recording
    residual = fit_nuisance(searched_recording.record, fitted.applied_to(searched_recording.record.rig))[1]
    return replace(fitted, misfit=misfit(searched_recording.record, searched_recording.nominal_variances, residual))


def hypothesis_with_contact_effects(
    prepared: PreparedRecordings,
    candidates: Sequence[Candidate],
    estimates: Sequence[LawEstimate],
    hypothesis: Hypothesis,
    outcomes_of: Callable[[Recording, Rig, Tolerances], LawOutcomes] = law_outcomes,
) -> Hypothesis | None:
    """Hypothesis with effects on all parameters that the fit puts more than `CHANCE_PULL` standard deviations off.

    Their values are those of the contact fit of the fitted records. None where none is off, or the fit determines none.
    """
    record, off_names = prepared.validation_recording.record, set[str]()
    for estimate in estimates:
        contact = _contact_of_estimate(record.rig, estimate)
        distance = law_distance(estimate, contact, contact, record.tolerances)
        are_off = np.abs(distance.parameter_distances) > CHANCE_PULL * np.sqrt(np.diag(distance.covariance))
        off_names |= {f"{effect}:{contact.name}" for effect, off in zip(CONTACT_EFFECTS, are_off, strict=False) if off}
    added_candidates = tuple(candidate for candidate in candidates if candidate.name in off_names)
    if not added_candidates:
        return None
    neutral_strengths = np.array([candidate.neutral_strength for candidate in added_candidates])
    initial_hypothesis = Hypothesis(
        (*hypothesis.candidates, *added_candidates),
        np.append(hypothesis.values, neutral_strengths),
        block_diag(hypothesis.covariance, np.zeros((neutral_strengths.size, neutral_strengths.size))),
        hypothesis.misfit,
    )
    recordings = [observation.recording for observation in prepared.fitted_recordings]
    fitted_hypothesis = with_contact_fit(initial_hypothesis, recordings, record.tolerances, outcomes_of)
    return None if fitted_hypothesis is initial_hypothesis else fitted_hypothesis
