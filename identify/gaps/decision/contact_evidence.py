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

from identify.gaps.decision.bounds import Difference, law_distance
from identify.gaps.decision.comparison import ValidatedHypothesis, log_priors, nominal_of, validate_hypotheses
from identify.gaps.decision.prepare import Prepared
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
    prepared: Prepared,
    candidates: Sequence[Candidate],
    ranked: Sequence[ValidatedHypothesis],
    difference: Difference,
    nominal_residual: Residual,
) -> list[ValidatedHypothesis]:
    """Hypotheses with their `contact_minus_two_log`, and that of the contact fit itself; the likeliest first.

    nominal_residual is that of the nominal rig on the validation record.
    """
    estimates, validation = difference.contact_estimates, prepared.validation
    record, validated = validation.record, list(ranked)
    fitted = _hypothesis_of_contact_fit(prepared, candidates, estimates, nominal_of(ranked).hypothesis)
    if fitted is not None and all(fitted.key != item.hypothesis.key for item in ranked):
        priors = log_priors([fitted], candidates)
        validated += validate_hypotheses(record, validation.nominal_variances, nominal_residual, [fitted], priors)
    updated = []
    for item in validated:
        costs = (contact_minus_two_log(e, record.rig, item.rig, record.tolerances) for e in estimates)
        updated.append(replace(item, contact_minus_two_log=float(sum(costs))))
    return sorted(updated, key=lambda item: -item.log_posterior)


def contact_minus_two_log(estimate: LawEstimate, nominal: Rig, rig: Rig, tolerances: Tolerances) -> float:
    """-2 ln p of one contact of the hypothesis `rig`: d' (C + S)^-1 d - n; zero for a law of another kind."""
    nominal_contact, contact = _contact(nominal, estimate), _contact(rig, estimate)
    if not numbers_alone_differ(contact.law, nominal_contact.law):
        return 0.0
    return law_distance(estimate, contact, nominal_contact, tolerances).chi_squared - estimate.values.size


def _contact(rig: Rig, estimate: LawEstimate) -> Contact:
    return next(contact for contact in rig.contacts if contact.name == estimate.contact)


def _hypothesis_of_contact_fit(
    prepared: Prepared, candidates: Sequence[Candidate], estimates: Sequence[LawEstimate], nominal: Hypothesis
) -> Hypothesis | None:
    """Effects on all parameters that the fit puts more than `CHANCE_PULL` standard deviations off; None without any."""
    record, names = prepared.searched.record, list[str]()
    for estimate in estimates:
        contact = _contact(record.rig, estimate)
        measured = law_distance(estimate, contact, contact, record.tolerances)
        is_off = np.abs(measured.distance) > CHANCE_PULL * np.sqrt(np.diag(measured.covariance))
        names += [f"{CONTACT_EFFECTS[k]}:{contact.name}" for k in np.flatnonzero(is_off[: len(CONTACT_EFFECTS)])]
    selected = tuple(candidate for candidate in candidates if candidate.name in names)
    if not selected:
        return None
    neutral = np.array([candidate.neutral for candidate in selected])
    initial = Hypothesis(selected, neutral, np.zeros((neutral.size, neutral.size)), nominal.misfit)
    recordings = [observation.recording for observation in prepared.fitted]
    fitted = with_contact_fit(initial, recordings, record.tolerances)
    if fitted is initial:
        return None
    residual = fit_nuisance(record, fitted.applied_to(record.rig))[1]
    return replace(fitted, misfit=misfit(record, prepared.searched.nominal_variances, residual))
