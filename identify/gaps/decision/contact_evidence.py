"""What the contact fit of all records says for and against hypotheses.

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

from identify.gaps.decision.bounds import Difference, distance_of, variances_of
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
"""Of the quantities of a contact fit, in their order."""


def with_contact_evidence(
    prepared: Prepared,
    known: Sequence[Candidate],
    ranked: Sequence[Judged],
    difference: Difference,
    residual: Residual,
) -> list[Judged]:
    """The hypotheses with what the contact fit says of them, and one of what it finds beyond the tolerances.

    residual is that of the nominal rig on the record that validates.
    """
    estimates, validation = difference.contact_estimates, prepared.validation
    record, tolerances, every = validation.record, validation.record.tolerances, list(ranked)
    own = _of_contact_fit(prepared, known, estimates, nominal_of(ranked).hypothesis)
    if own is not None and all(own.key != one.hypothesis.key for one in ranked):
        every += judged(record, validation.reference, residual, [own], log_priors([own], known))
    told = [
        replace(
            one, contact_fit=float(sum(contact_minus_two_log(e, record.rig, one.rig, tolerances) for e in estimates))
        )
        for one in every
    ]
    return sorted(told, key=lambda one: -one.log_posterior)


def contact_minus_two_log(estimate: LawEstimate, nominal: Rig, rig: Rig, tolerances: Tolerances) -> float:
    """Of one contact of `rig`, a hypothesis: d' (C + S)^-1 d - n; zero for a law of another kind."""
    believed, contact = _contact(nominal, estimate), _contact(rig, estimate)
    if not numbers_alone_differ(contact.law, believed.law):
        return 0.0
    distance = distance_of(contact, estimate)
    variances = estimate.covariance + variances_of(believed, tolerances, distance.size)
    return float(distance @ np.linalg.solve(variances, distance)) - distance.size


def _contact(rig: Rig, estimate: LawEstimate) -> Contact:
    return next(contact for contact in rig.contacts if contact.name == estimate.contact)


def _of_contact_fit(
    prepared: Prepared, known: Sequence[Candidate], estimates: Sequence[LawEstimate], nominal: Hypothesis
) -> Hypothesis | None:
    """Effects of all that the fit finds off by more than `PULLED` standard deviations; None where that is nothing."""
    record, names = prepared.searched.record, list[str]()
    for estimate in estimates:
        contact = _contact(record.rig, estimate)
        distance = distance_of(contact, estimate)
        variances = np.diag(estimate.covariance + variances_of(contact, record.tolerances, distance.size))
        off = np.abs(distance) > PULLED * np.sqrt(variances)
        names += [f"{effect}:{contact.name}" for effect, is_off in zip(EFFECTS, off, strict=False) if is_off]
    parts = tuple(candidate for candidate in known if candidate.name in names)
    if not parts:
        return None
    neutral = np.array([part.neutral for part in parts])
    unfitted = Hypothesis(parts, neutral, np.zeros((neutral.size, neutral.size)), nominal.misfit)
    fitted = with_contact_fit(unfitted, [one.recording for one in prepared.fitted], record.tolerances)
    if fitted is unfitted:
        return None
    at = fit_nuisance(record, fitted.applied_to(record.rig), rounds=1)[1]
    return replace(fitted, misfit=misfit(record, prepared.searched.reference, at))
