"""Bounds of what matters: 97.5 % upper bounds of unexplained shares and contact parameters of the nominal rig.

Notes for maintainers
1. Shares: with x_s the mean square residual of second s beyond noise over the whole measured band (m^2/s^4), and P the
   mean square of the acceleration, the squared share is mean(x) / P. Its standard error is that of the mean over the
   seconds (Student), so that a band without signal decides nothing. Contact forces likewise.
2. Contact parameters: their distance d from rig.json by the contact fit of `identify contact` over all records, against
   three of their stated standard deviations. A parameter that no record determines has no bound. With C the covariance
   of the fit and S that of the tolerances, d' (C + S)^-1 d is chi-squared where nothing differs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2
from scipy.stats import t as student

from identify.contacts.law_form import parameters_of_law
from identify.contacts.refusals import Refusal
from identify.gaps.decision_table import Bounded
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import Matters
from identify.gaps.search.contact_laws import LawEstimate, LawOutcomes, law_outcomes, pooled_law_estimate
from identify.pages.wording import COVERED, record_length_words
from rig.model.description import Contact, Rig
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

HIDING_NOISE_SHARE = 0.25
"""Share of a contact force's mean square from which noise hides it: half of its size. Convention."""
PARAMETER_LIMIT_DEVIATIONS = 3.0
"""Threshold of a contact parameter's distance from rig.json, in stated standard deviations: convention."""
CONTACT_TOLERANCE_FIELDS = ("clearance", "stiffness", "contact_damping_s")
"""Tolerance fields of a contact."""
LOUDER_ADVICE = "excite the rig more strongly, or use sensors of less noise"
LAW_FAR_OFF_AND_REMEDY = (
    "rig.json's law of it fits worse than no force at all",
    "run identify contact, and give the rig.json that it writes with --rig",
)
"""Reason why a share above the whole bounds nothing, and the remedy."""
TOO_SHORT_AND_REMEDY = "the record held back leaves less than two seconds", f"record {record_length_words(2.0)}"
"""Reason why a share of a single second, without a scatter over seconds, has no bound, and the remedy."""


@dataclass(frozen=True)
class NominalDifference:
    """Difference of nominal rig and records: the p-value over all records, and the quantities that matter."""

    p_value: float
    motion_bound: Bounded
    contact_bounds: tuple[Bounded, ...]
    parameter_bounds: tuple[Bounded, ...] = ()
    contact_estimates: tuple[LawEstimate, ...] = ()

    @property
    def quantities(self) -> tuple[Bounded, ...]:
        return (self.motion_bound, *self.contact_bounds, *self.parameter_bounds)


@dataclass(frozen=True)
class ContactParameterDistances:
    """Distance of every contact's parameters from rig.json, and the p-value of each contact that records determine."""

    parameter_bounds: tuple[Bounded, ...]
    p_values: tuple[float, ...]
    law_estimates: tuple[LawEstimate, ...]


def share_bounds(misfit: Misfit, contact_names: Sequence[str], matters: Matters) -> tuple[Bounded, ...]:
    """Bounded unexplained shares: that of the motion, then that of each contact force."""
    squared_shares = misfit.squared_unexplained_share_by_second
    # noise that is estimated too high puts them below zero, which bounds nothing
    squared_shares = squared_shares + max(misfit.unexplained_share**2 - squared_shares.mean(), 0.0)
    bounds = [_bounded_share("motion", misfit.unexplained_share, squared_shares, matters.motion)]
    for contact_index, contact_name in enumerate(contact_names):
        force_weights = misfit.nominal_variances.observations[contact_index].force_weights
        noise_square_n2 = float(np.sum(force_weights[force_weights > 0] ** -2.0)) / force_weights.size
        force_square_n2 = max(float(np.mean(misfit.contact_force_n2[:, contact_index])), 1e-300)
        squared_shares = misfit.contact_beyond_noise_n2[:, contact_index] / force_square_n2
        bounds.append(
            contact_force_share_bound(contact_name, squared_shares, noise_square_n2 / force_square_n2, matters.contact)
        )
    return tuple(bounds)


def contact_force_share_bound(
    quantity_name: str, squared_shares: Float[np.ndarray, " seconds"], noise_share: float, threshold: float
) -> Bounded:
    """Bounded unexplained share of a contact force, from its squares second by second and the noise's share of the
    force's mean square."""
    share = float(np.sqrt(max(squared_shares.mean(), 0.0)))
    if noise_share > HIDING_NOISE_SHARE:
        return Bounded(quantity_name, "1", share, None, threshold, "noise hides it", LOUDER_ADVICE)
    if share > 1:
        return Bounded(quantity_name, "1", None, None, threshold, *LAW_FAR_OFF_AND_REMEDY)
    return _bounded_share(quantity_name, share, squared_shares, threshold)


def _bounded_share(name: str, share: float, squared_shares: Float[np.ndarray, " seconds"], threshold: float) -> Bounded:
    upper_share = _upper_share(squared_shares)
    if upper_share is not None:
        return Bounded(name, "1", share, max(share, upper_share), threshold)
    return Bounded(name, "1", share, None, threshold, *(TOO_SHORT_AND_REMEDY if share < threshold else ()))


def _upper_share(squared_shares: Float[np.ndarray, " seconds"]) -> float | None:
    """Upper 97.5 % bound of sqrt(mean(squares)) by Student's distribution; None for a single second."""
    second_count = squared_shares.size
    if second_count < 2:
        return None
    standard_error = float(squared_shares.std(ddof=1)) / np.sqrt(second_count)
    upper_square = squared_shares.mean() + student.ppf(0.975, second_count - 1) * standard_error
    return float(np.sqrt(max(upper_square, 0.0)))


def contact_parameter_distances(
    recordings: Sequence[Recording],
    rig: Rig,
    tolerances: Tolerances,
    outcomes_of: Callable[[Recording, Rig, Tolerances], LawOutcomes] = law_outcomes,
) -> ContactParameterDistances:
    """Distances of every contact's parameters from `rig`, by the contact fit pooled over all records."""
    outcomes = [outcomes_of(recording, rig, tolerances) for recording in recordings if rig.contacts]
    bounds, p_values, pooled_estimates = list[Bounded](), list[float](), list[LawEstimate]()
    for contact in rig.contacts:
        contact_name = contact.name
        estimates = [
            estimate for outcome in outcomes for estimate in outcome.estimates if estimate.contact_name == contact_name
        ]
        if not (estimates and contact.law.piecewise_linear):
            refusals = [outcome.refusals[contact_name] for outcome in outcomes if contact_name in outcome.refusals]
            bounds.append(_undetermined_parameters(contact, refusals))
            continue
        estimate = pooled_law_estimate(estimates)
        distance = law_distance(estimate, contact, contact, tolerances)
        bounds += _parameter_bounds(contact, estimate, distance, tolerances)
        p_values.append(float(chi2.sf(distance.chi_squared, distance.parameter_distances.size)))
        pooled_estimates.append(estimate)
    return ContactParameterDistances(tuple(bounds), tuple(p_values), tuple(pooled_estimates))


def _undetermined_parameters(contact: Contact, refusals: Sequence[Refusal]) -> Bounded:
    """Parameters of a contact that no record determines, without a bound, and the reason."""
    names = f"{'clearance, ' if contact.law.has_stops else ''}stiffness and damping of {contact.name}"
    reason, remedy = "its law is no dead zone", ""
    if contact.law.piecewise_linear:
        reason, remedy = (refusals[0].cause, refusals[0].advice) if refusals else ("the contact fit does not apply", "")
    return Bounded(names, "", None, None, 0.0, reason, remedy)


@dataclass(frozen=True)
class LawDistance:
    """Distance d of estimated parameters from those of a contact's law (m, N/m, N s/m, m), and its covariance C + S: of
    the estimate, plus the stated variances of the nominal law."""

    parameter_distances: Float[np.ndarray, " rows"]
    covariance: Float[np.ndarray, "rows rows"]

    @property
    def chi_squared(self) -> float:
        return float(self.parameter_distances @ np.linalg.solve(self.covariance, self.parameter_distances))


def law_distance(
    law_estimate: LawEstimate, contact: Contact, nominal_contact: Contact, tolerances: Tolerances
) -> LawDistance:
    parameter_distances = np.asarray(
        law_estimate.quantity_values - law_estimate.quantity_weights @ parameters_of_law(contact.law)
    )
    prior_deviations = np.array(law_tolerance_deviations(nominal_contact, tolerances))[
        _parameter_indices(nominal_contact)
    ]
    stated_variances = np.diag(np.square(prior_deviations[: parameter_distances.size]))
    return LawDistance(parameter_distances, law_estimate.covariance + stated_variances)


def _parameter_bounds(
    contact: Contact, estimate: LawEstimate, distance: LawDistance, tolerances: Tolerances
) -> list[Bounded]:
    names_and_units = ("clearance", "m"), ("stiffness", "N/m"), ("damping", "N s/m"), ("offset", "m")
    prior_deviations = law_tolerance_deviations(contact, tolerances)
    distance_sizes, half_widths = np.abs(distance.parameter_distances), COVERED * np.sqrt(np.diag(estimate.covariance))
    bounds = []
    for index, size, half_width in zip(_parameter_indices(contact), distance_sizes, half_widths, strict=False):
        (name, unit), threshold = names_and_units[index], PARAMETER_LIMIT_DEVIATIONS * prior_deviations[index]
        bounds.append(Bounded(f"{name} of {contact.name}", unit, float(size), float(size + half_width), threshold))
    return bounds


def _parameter_indices(contact: Contact) -> list[int]:
    """Indices of a contact's parameters among clearance, stiffness, damping and offset; a spring has the middle two."""
    return [0, 1, 2, 3] if contact.law.has_stops else [1, 2]


def law_tolerance_deviations(contact: Contact, tolerances: Tolerances) -> tuple[float, float, float, float]:
    """Stated standard deviations of clearance (m), stiffness (N/m), damping (N s/m) and offset (m) of a contact.

    Those of a laboratory where none are stated, as no record bounds a distance by zero.
    """
    clearance, stiffness, damping_s = (
        getattr(tolerances, name) or getattr(LABORATORY, name) for name in CONTACT_TOLERANCE_FIELDS
    )
    clearance_m, stiffness_n_per_m = clearance * contact.law.clearance_m, contact.law.stiffness_n_per_m
    return clearance_m, stiffness * stiffness_n_per_m, damping_s * stiffness_n_per_m, clearance_m
