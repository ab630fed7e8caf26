"""Bounds of what matters: 97.5 % upper bounds of unexplained shares and contact parameters of the nominal rig.

Notes for maintainers
1. Shares: with x_s the mean square residual of second s beyond noise over the whole measured band (m^2/s^4), and P the
   mean square of the acceleration, the squared share is mean(x) / P. Its standard error is that of the mean over the
   seconds (Student), so that a band without signal decides nothing. Contact forces likewise.
2. Contact parameters: their distance d from rig.json by the contact fit of `identify contact` over all records, against
   three of their stated standard deviations. A parameter that no record determines has no bound. With C the covariance
   of the fit and S that of the tolerances, d' (C + S)^-1 d is chi-squared where nothing differs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2
from scipy.stats import t as student

from identify.contacts.law_form import law_numbers
from identify.contacts.refusals import Refusal
from identify.gaps.decision_table import Bounded
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import Matters
from identify.gaps.search.contact_laws import LawEstimate, law_outcomes, pooled_estimate
from identify.pages.wording import COVERED
from rig.model.description import Contact, Rig
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

HIDING_NOISE_SHARE = 0.25
"""Share of a contact force's mean square from which noise hides it: half of its size. Convention."""
PARAMETER_DEVIATIONS = 3.0
"""Threshold of a contact parameter's distance from rig.json, in stated standard deviations: convention."""
CONTACT_TOLERANCES = ("clearance", "stiffness", "contact_damping_s")
"""Tolerance fields of a contact."""
LOUDER_ADVICE = "excite the rig more strongly, or use sensors of less noise"
TOO_SHORT = "the record held back leaves less than two seconds", "record longer"
"""Reason why a share without a scatter over seconds has no bound, and the remedy."""


@dataclass(frozen=True)
class Difference:
    """Difference of nominal rig and records: the p-value over all records, and the quantities that matter."""

    p_value: float
    motion: Bounded
    contacts: tuple[Bounded, ...]
    contact_parameters: tuple[Bounded, ...] = ()
    contact_estimates: tuple[LawEstimate, ...] = ()

    @property
    def quantities(self) -> tuple[Bounded, ...]:
        return (self.motion, *self.contacts, *self.contact_parameters)


@dataclass(frozen=True)
class ContactDistances:
    """Distance of every contact's parameters from rig.json, and the p-value of each contact that records determine."""

    bounds: tuple[Bounded, ...]
    p_values: tuple[float, ...]
    estimates: tuple[LawEstimate, ...]


def share_bounds(misfit: Misfit, contacts: Sequence[str], matters: Matters) -> tuple[Bounded, ...]:
    """Bounded unexplained shares: that of the motion, then that of each contact force."""
    quantities = [_bounded_share("motion", misfit.share, misfit.share_by_second, matters.motion)]
    for j, name in enumerate(contacts):
        force_n2 = float(np.mean(misfit.force_n2[:, j]))
        weights, share = misfit.nominal_variances.observations[j].weights, float(misfit.contact_shares[j])
        noise_n2 = float(np.sum(weights[weights > 0] ** -2.0)) / weights.size
        if noise_n2 > HIDING_NOISE_SHARE * force_n2:
            quantities.append(Bounded(name, "1", share, None, matters.contact, "noise hides it", LOUDER_ADVICE))
        else:
            squares = misfit.contact_n2[:, j] / max(force_n2, 1e-300)
            quantities.append(_bounded_share(name, share, squares, matters.contact))
    return tuple(quantities)


def _bounded_share(name: str, share: float, squares: Float[np.ndarray, " seconds"], threshold: float) -> Bounded:
    upper = _upper_share(squares)
    if upper is not None:
        return Bounded(name, "1", share, max(share, upper), threshold)
    return Bounded(name, "1", share, None, threshold, *(TOO_SHORT if share < threshold else ()))


def _upper_share(squares: Float[np.ndarray, " seconds"]) -> float | None:
    """Upper 97.5 % bound of sqrt(mean(squares)) by Student's distribution; None for a single second."""
    if squares.size < 2:
        return None
    standard_error = float(squares.std(ddof=1)) / np.sqrt(squares.size)
    return float(np.sqrt(max(squares.mean() + student.ppf(0.975, squares.size - 1) * standard_error, 0.0)))


def contact_distances(recordings: Sequence[Recording], rig: Rig, tolerances: Tolerances) -> ContactDistances:
    """Distances of every contact's parameters from `rig`, by the contact fit pooled over all records."""
    record_outcomes = [law_outcomes(recording, rig, tolerances) for recording in recordings if rig.contacts]
    bounds: list[Bounded] = []
    p_values: list[float] = []
    pooled: list[LawEstimate] = []
    for contact in rig.contacts:
        estimates = [
            estimate
            for record_outcome in record_outcomes
            for estimate in record_outcome.estimates
            if estimate.contact == contact.name
        ]
        if estimates and contact.law.piecewise_linear:
            estimate = pooled_estimate(estimates)
            bounds += _parameter_bounds(contact, estimate, tolerances)
            p_values.append(_p_value(contact, estimate, tolerances))
            pooled.append(estimate)
        else:
            bounds.append(
                _undetermined_parameters(
                    contact,
                    [
                        record_outcome.refusals[contact.name]
                        for record_outcome in record_outcomes
                        if contact.name in record_outcome.refusals
                    ],
                )
            )
    return ContactDistances(tuple(bounds), tuple(p_values), tuple(pooled))


def _undetermined_parameters(contact: Contact, refusals: Sequence[Refusal]) -> Bounded:
    """Parameters of a contact that no record determines, without a bound, and the reason."""
    clearance = "clearance, " if contact.law.has_stops else ""
    names = f"{clearance}stiffness and damping of {contact.name}"
    if not contact.law.piecewise_linear:
        return Bounded(names, "", None, None, 0.0, "its law is no dead zone")
    reason, remedy = (refusals[0].cause, refusals[0].advice) if refusals else ("the contact fit does not apply", "")
    return Bounded(names, "", None, None, 0.0, reason, remedy)


@dataclass(frozen=True)
class LawDistance:
    """Distance d of estimated parameters from those of a contact's law (m, N/m, N s/m, m), and its covariance C + S: of
    the estimate, plus the stated variances of the nominal law."""

    distance: Float[np.ndarray, " rows"]
    covariance: Float[np.ndarray, "rows rows"]

    @property
    def chi_squared(self) -> float:
        return float(self.distance @ np.linalg.solve(self.covariance, self.distance))


def law_distance(estimate: LawEstimate, contact: Contact, nominal: Contact, tolerances: Tolerances) -> LawDistance:
    distance = np.asarray(estimate.values - estimate.quantities @ law_numbers(contact.law))
    deviations = np.array(stated_deviations(nominal, tolerances))[_parameter_indices(nominal)]
    stated = np.diag(np.square(deviations[: distance.size]))
    return LawDistance(distance, estimate.covariance + stated)


def _p_value(contact: Contact, estimate: LawEstimate, tolerances: Tolerances) -> float:
    measured = law_distance(estimate, contact, contact, tolerances)
    return float(chi2.sf(measured.chi_squared, measured.distance.size))


def _parameter_bounds(contact: Contact, estimate: LawEstimate, tolerances: Tolerances) -> list[Bounded]:
    distances = np.abs(law_distance(estimate, contact, contact, tolerances).distance)
    half_widths = COVERED * np.sqrt(np.diag(estimate.covariance))
    names, units = ("clearance", "stiffness", "damping", "offset"), ("m", "N/m", "N s/m", "m")
    deviations = stated_deviations(contact, tolerances)
    described = [(names[k], units[k], deviations[k]) for k in _parameter_indices(contact)]
    rows = zip(described, distances, half_widths, strict=False)
    return [
        Bounded(
            f"{name} of {contact.name}", unit, float(value), float(value + half_width), PARAMETER_DEVIATIONS * deviation
        )
        for (name, unit, deviation), value, half_width in rows
    ]


def _parameter_indices(contact: Contact) -> list[int]:
    """Indices of a contact's parameters among clearance, stiffness, damping and offset; a spring has the middle two."""
    return [0, 1, 2, 3] if contact.law.has_stops else [1, 2]


def stated_deviations(contact: Contact, tolerances: Tolerances) -> tuple[float, float, float, float]:
    """Stated standard deviations of clearance (m), stiffness (N/m), damping (N s/m) and offset (m) of a contact.

    Those of a laboratory where none are stated, as no record bounds a distance by zero.
    """
    law = contact.law
    clearance, stiffness, damping_s = (
        getattr(tolerances, name) or getattr(LABORATORY, name) for name in CONTACT_TOLERANCES
    )
    clearance_m, stiffness_n_per_m = clearance * law.clearance_m, law.stiffness_n_per_m
    return clearance_m, stiffness * stiffness_n_per_m, damping_s * stiffness_n_per_m, clearance_m
