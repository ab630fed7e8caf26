"""Evidence for and against hypotheses from the contact fit of all records.

The statistic of a record is hardly sensitive to the damping of a contact, which the contact fit determines to a few per
cent. With d the distance of the n fitted quantities (clearances, stiffness, damping) of a contact from its law in a
hypothesis, C their covariance and S that of the tolerances,

    -2 ln p  +=  d' (C + S)^-1 d - n        of every contact whose law is the nominal one in other numbers

The expectation n is subtracted, so that a law of another kind, to which the fit does not apply, is neither favoured
nor penalised. Values of the fit beyond their tolerances make a hypothesis of their own.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identify.gaps.decision.bounds import NominalDifference, law_distance
from identify.gaps.decision.comparison import ValidatedHypothesis, log_priors, nominal_of, validate_hypotheses
from identify.gaps.decision.prepare import PreparedRecordings
from identify.gaps.residual.likelihood import misfit
from identify.gaps.residual.residual import Residual
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.contact_laws import LawEstimate, numbers_alone_differ, with_contact_fit
from identify.gaps.search.hypothesis import CHANCE_PULL, Hypothesis
from identify.gaps.search.nominal import fit_nuisance
from rig.model.description import Contact, Rig
from rig.model.tolerances import Tolerances

CONTACT_EFFECTS = ("contact_clearance", "contact_stiffness", "contact_damping")
"""Effects on the quantities of a contact fit, in their order."""


def with_contact_evidence(
    prepared: PreparedRecordings,
    candidates: Sequence[Candidate],
    ranked_hypotheses: Sequence[ValidatedHypothesis],
    difference: NominalDifference,
    validation_residual: Residual,
) -> list[ValidatedHypothesis]:
    """Hypotheses with their `contact_minus_two_log`, and that of the contact fit itself; the likeliest first.

    validation_residual is that of the nominal rig on the validation record.
    """
    law_estimates, validation = difference.contact_estimates, prepared.validation_recording
    record, hypotheses = validation.record, list(ranked_hypotheses)
    contact_hypothesis = _hypothesis_of_contact_fit(
        prepared, candidates, law_estimates, nominal_of(ranked_hypotheses).hypothesis
    )
    if contact_hypothesis is not None and all(
        contact_hypothesis.effect_names != ranked_hypothesis.hypothesis.effect_names
        for ranked_hypothesis in ranked_hypotheses
    ):
        log_prior_by_effects = log_priors([contact_hypothesis], candidates)
        hypotheses += validate_hypotheses(
            record, validation.nominal_variances, validation_residual, [contact_hypothesis], log_prior_by_effects
        )
    with_evidence = []
    for hypothesis in hypotheses:
        contact_costs = (
            contact_minus_two_log(law_estimate, record.rig, hypothesis.rig, record.tolerances)
            for law_estimate in law_estimates
        )
        with_evidence.append(replace(hypothesis, contact_minus_two_log=float(sum(contact_costs))))
    return sorted(with_evidence, key=lambda ranked_hypothesis: -ranked_hypothesis.log_posterior)


def contact_minus_two_log(
    estimate: LawEstimate, nominal_rig: Rig, hypothesis_rig: Rig, tolerances: Tolerances
) -> float:
    """-2 ln p of one contact in `hypothesis_rig`: d' (C + S)^-1 d - n; zero for a law of another kind."""
    nominal_contact = _contact_of_estimate(nominal_rig, estimate)
    contact = _contact_of_estimate(hypothesis_rig, estimate)
    if not numbers_alone_differ(contact.law, nominal_contact.law):
        return 0.0
    return law_distance(estimate, contact, nominal_contact, tolerances).chi_squared - estimate.quantity_values.size


def _contact_of_estimate(rig: Rig, estimate: LawEstimate) -> Contact:
    return next(contact for contact in rig.contacts if contact.name == estimate.contact_name)


def _hypothesis_of_contact_fit(
    prepared: PreparedRecordings,
    candidates: Sequence[Candidate],
    law_estimates: Sequence[LawEstimate],
    nominal_hypothesis: Hypothesis,
) -> Hypothesis | None:
    """Effects on all parameters that the fit puts more than `CHANCE_PULL` standard deviations off; None without any."""
    record, effect_names = prepared.searched_recording.record, list[str]()
    for estimate in law_estimates:
        contact = _contact_of_estimate(record.rig, estimate)
        measured_distance = law_distance(estimate, contact, contact, record.tolerances)
        is_off = np.abs(measured_distance.parameter_distances) > CHANCE_PULL * np.sqrt(
            np.diag(measured_distance.covariance)
        )
        effect_names += [
            f"{CONTACT_EFFECTS[quantity_index]}:{contact.name}"
            for quantity_index in np.flatnonzero(is_off[: len(CONTACT_EFFECTS)])
        ]
    selected_candidates = tuple(candidate for candidate in candidates if candidate.name in effect_names)
    if not selected_candidates:
        return None
    neutral_strengths = np.array([candidate.neutral_strength for candidate in selected_candidates])
    initial_hypothesis = Hypothesis(
        selected_candidates,
        neutral_strengths,
        np.zeros((neutral_strengths.size, neutral_strengths.size)),
        nominal_hypothesis.misfit,
    )
    recordings = [observation.recording for observation in prepared.fitted_recordings]
    fitted_hypothesis = with_contact_fit(initial_hypothesis, recordings, record.tolerances)
    if fitted_hypothesis is initial_hypothesis:
        return None
    residual = fit_nuisance(record, fitted_hypothesis.applied_to(record.rig))[1]
    return replace(fitted_hypothesis, misfit=misfit(record, prepared.searched_recording.nominal_variances, residual))
