"""Evidence of the contact fit of all records for and against hypotheses.

The statistic of a record hardly sees the damping of a contact, which the contact fit tells to a few per cent. With d
the distance of the n fitted quantities (clearances, stiffness, damping) of a contact from its law in a hypothesis, C
their covariance and S that of the tolerances,

    -2 ln p  +=  d' (C + S)^-1 d - n        of every contact whose law is the nominal one in other numbers

The expectation n is taken off, so that a law of another kind, of which the fit says nothing, is neither favoured nor
held back. Where the fit finds numbers beyond their tolerances, they are a hypothesis of their own.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identify.gaps.decision.bounds import Difference, law_distance
from identify.gaps.decision.comparison import Judged, judged, log_priors
from identify.gaps.decision.prepare import Prepared
from identify.gaps.decision.verdict import nominal_of
from identify.gaps.residual.likelihood import misfit
from identify.gaps.residual.residual import Residual
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.contact_laws import LawEstimate, numbers_alone_differ, with_contact_fit
from identify.gaps.search.hypothesis import PULLED, Hypothesis
from identify.gaps.search.nominal import fit_nuisance
from rig.model.description import Contact, Rig
from rig.model.tolerances import Tolerances

EFFECTS = ("contact_clearance", "contact_stiffness", "contact_damping")
"""Effects that move the quantities of a contact fit, in their order."""


def with_contact_evidence(
    prepared: Prepared,
    candidates: Sequence[Candidate],
    ranked: Sequence[Judged],
    difference: Difference,
    nominal_residual: Residual,
) -> list[Judged]:
    """Hypotheses with their `contact_fit`, and the hypothesis that the contact fit makes; the likeliest first.

    nominal_residual is that of the nominal rig on the validation record.
    """
    estimates, validation = difference.contact_estimates, prepared.validation
    record, hypotheses = validation.record, list(ranked)
    fitted = _hypothesis_of_contact_fit(prepared, candidates, estimates, nominal_of(ranked).hypothesis)
    if fitted is not None and all(fitted.key != judgement.hypothesis.key for judgement in ranked):
        priors = log_priors([fitted], candidates)
        hypotheses += judged(record, validation.reference, nominal_residual, [fitted], priors)
    weighed = []
    for hypothesis in hypotheses:
        costs = (contact_minus_two_log(e, record.rig, hypothesis.rig, record.tolerances) for e in estimates)
        weighed.append(replace(hypothesis, contact_fit=float(sum(costs))))
    return sorted(weighed, key=lambda judgement: -judgement.log_posterior)


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
    """Effects of all numbers that the fit finds off by more than `PULLED` standard deviations; None without any."""
    record, names = prepared.searched.record, list[str]()
    for estimate in estimates:
        contact = _contact(record.rig, estimate)
        measured = law_distance(estimate, contact, contact, record.tolerances)
        is_off = np.abs(measured.distance) > PULLED * np.sqrt(np.diag(measured.covariance))
        names += [f"{EFFECTS[k]}:{contact.name}" for k in np.flatnonzero(is_off[: len(EFFECTS)])]
    parts = tuple(candidate for candidate in candidates if candidate.name in names)
    if not parts:
        return None
    neutral = np.array([part.neutral for part in parts])
    unfitted = Hypothesis(parts, neutral, np.zeros((neutral.size, neutral.size)), nominal.misfit)
    recordings = [observation.recording for observation in prepared.fitted]
    fitted = with_contact_fit(unfitted, recordings, record.tolerances)
    if fitted is unfitted:
        return None
    residual = fit_nuisance(record, fitted.applied_to(record.rig), rounds=1)[1]
    return replace(fitted, misfit=misfit(record, prepared.searched.reference, residual))
