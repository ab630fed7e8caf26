"""Parameters of contact laws in a hypothesis, by the one contact fit that `identify contact` makes too.

The search names effects; where an effect moves clearance, stiffness or damping of a contact, its values and their
covariance are those of the joint contact fit on the hypothesis's rig, whose other effects are in the linear model that
separates the contact forces. With y the fitted quantities (clearances in m, stiffness in N/m, damping in N s/m), C
their covariance and J = dy/dv at the searched values v0, by generalised least squares

    v = v0 + cov(v) J' C^-1 (y - y(v0)),   cov(v) = (J' C^-1 J)^-1

so that an effect's value is the whole deviation of the law from rig.json, tolerances included. Records share what
rig.json may have wrong (C_tolerances) and differ by their own scatter (C_own):

    v = sum_r W_r v_r,  W_r = (sum_s C_own,s^-1)^-1 C_own,r^-1,   cov v = (sum_s C_own,s^-1)^-1 + mean C_tolerances
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

from identify.contacts.acceptance import accept
from identify.contacts.determination import determine
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import DAMPING_GRADIENT, LAW, OFFSET_GRADIENT, STIFFNESS_GRADIENT, parameters_of_law
from identify.contacts.refusals import ContactRefusedError, Refusal, RefusalCode, refused
from identify.contacts.separation import separate
from identify.gaps.search.hypothesis import Hypothesis, steps_of
from rig.errors import RigError
from rig.model.contact_laws import ContactLaw
from rig.model.description import ForceSensor, Rig
from rig.model.tolerances import Tolerances
from rig.recording import Recording

DERIVATIVE_STEP = 1e-3
"""Step for dy/dv, as a share of a parameter's search step; exact, as every y is linear in every v."""

Values = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class LawEstimate:
    """Estimated quantities of a contact from one record: quantity_values = quantity_weights @ law, with covariance.

    tolerance_covariance is the part of the covariance that all records of the machine share.
    """

    contact_name: str
    quantity_weights: Float[np.ndarray, "rows 4"]
    quantity_values: Float[np.ndarray, " rows"]
    covariance: Float[np.ndarray, "rows rows"]
    tolerance_covariance: Float[np.ndarray, "rows rows"]


@dataclass(frozen=True)
class LawOutcomes:
    """Estimates of the contacts that one record determines, and refusals of the others by their names."""

    estimates: tuple[LawEstimate, ...] = ()
    refusals: Mapping[str, Refusal] = field(default_factory=dict)


def law_outcomes(recording: Recording, rig: Rig, tolerances: Tolerances) -> LawOutcomes:
    """Estimates of the contacts from a record, separated with the linear model of `rig`.

    Unmeasured excitation (a base motion, a tone) stays in the scatter.
    """
    if unmodelled_part := _unmodelled_part(rig):
        refusal = refused(RefusalCode.NOT_MODELLED, rig=rig.name, what=unmodelled_part).refusal
        return LawOutcomes((), dict.fromkeys((contact.name for contact in rig.contacts), refusal))
    force_channels = recording.signals["force"]
    corrected_signals = {
        **recording.signals,
        "force": replace(force_channels, values=force_channels.values / rig.force_sensor.gain),
    }
    motion_sensors = tuple(
        sensor for sensor in rig.sensors if sensor.measures.translates
    )  # the diagnosis uses no strain gauges
    separated_rig = msgspec.structs.replace(
        rig, base_motion=None, tones=(), force_sensor=ForceSensor(), sensors=motion_sensors
    )
    try:
        separation = separate(replace(recording, rig=separated_rig, signals=corrected_signals), "auto", tolerances)
        outcomes = accept(separation, determine(separation)).outcomes
    except ContactRefusedError as error:
        return LawOutcomes((), {contact.name: error.refusal for contact in rig.contacts})
    except RigError:
        return LawOutcomes()
    return LawOutcomes(
        tuple(
            _law_estimate(contact_name, joint_estimate) for contact_name, joint_estimate in outcomes.estimates.items()
        ),
        outcomes.refusals,
    )


def _unmodelled_part(rig: Rig) -> str:
    """Part of a rig that the contact fit does not model; empty if it models all."""
    if rig.loads:
        return "a constant force"
    if rig.dampers:
        return "a damper or friction to the ground"
    if any(spring.cubic_n_per_m3 for spring in rig.springs):
        return "a spring in the cube of the displacement"
    return "a lag of the force sensor" if rig.force_sensor.lag_s else ""


def pooled_estimate(estimates: Sequence[LawEstimate]) -> LawEstimate:
    """Pooled estimate of a contact from those records that determine most of its quantities."""
    largest_quantity_count = max(len(estimate.quantity_values) for estimate in estimates)
    comparable_estimates = [
        estimate for estimate in estimates if len(estimate.quantity_values) == largest_quantity_count
    ]
    comparable_estimates = [
        estimate
        for estimate in comparable_estimates
        if np.array_equal(estimate.quantity_weights, comparable_estimates[0].quantity_weights)
    ]
    pooled_values, pooled_covariance = _pooled_values(
        [
            (
                estimate.quantity_values,
                estimate.covariance,
                estimate.tolerance_covariance,
            )
            for estimate in comparable_estimates
        ]
    )
    shared_covariance = np.mean([estimate.tolerance_covariance for estimate in comparable_estimates], axis=0)
    return replace(
        comparable_estimates[0],
        quantity_values=pooled_values,
        covariance=pooled_covariance,
        tolerance_covariance=shared_covariance,
    )


def _law_estimate(contact_name: str, joint_estimate: JointEstimate) -> LawEstimate:
    quantity_rows = [] if joint_estimate.is_spring else [joint_estimate.clearance_gradient]
    quantity_rows += [STIFFNESS_GRADIENT, DAMPING_GRADIENT]
    if joint_estimate.sides_known and all(joint_estimate.touched):
        quantity_rows.append(OFFSET_GRADIENT)
    quantity_weights = np.array(quantity_rows)
    return LawEstimate(
        contact_name,
        quantity_weights,
        quantity_weights @ joint_estimate.values,
        quantity_weights @ joint_estimate.covariance @ quantity_weights.T,
        quantity_weights @ joint_estimate.covariances["tolerances"] @ quantity_weights.T,
    )


def with_contact_fit(
    hypothesis: Hypothesis,
    recordings: Sequence[Recording],
    tolerances: Tolerances,
    outcomes_of: Callable[[Recording, Rig, Tolerances], LawOutcomes] = law_outcomes,
) -> Hypothesis:
    """Hypothesis whose contact laws have the values and the covariance of the joint contact fit.

    Unchanged where its effects change no law, a law other than a dead zone, or quantities that no record determines.
    """
    nominal_rig, hypothesis_values = recordings[0].rig, hypothesis.values
    law_change = _law_change(hypothesis, nominal_rig)
    if law_change is None:
        return hypothesis
    hypothesis_rig, free_parameters = hypothesis.applied_to(nominal_rig), law_change.free_parameters
    record_solutions = (
        _solution_of_record(
            nominal_rig,
            outcomes_of(recording, hypothesis_rig, tolerances).estimates,
            law_change,
            hypothesis_values[free_parameters],
        )
        for recording in recordings
    )
    determined_solutions = [solution for solution in record_solutions if solution is not None]
    if not determined_solutions:
        return hypothesis
    fitted_values, covariance = hypothesis_values.copy(), hypothesis.covariance.copy()
    covariance[free_parameters] = covariance[:, free_parameters] = 0.0
    pooled_values, covariance[np.ix_(free_parameters, free_parameters)] = _pooled_values(determined_solutions)
    lower_bounds, upper_bounds = hypothesis.parameters.bounds
    fitted_values[free_parameters] = np.clip(
        pooled_values, lower_bounds[free_parameters], upper_bounds[free_parameters]
    )
    return replace(hypothesis, values=fitted_values, covariance=covariance)


@dataclass(frozen=True)
class LawChange:
    """Numbers y of every contact's law under a hypothesis, and dy/dv for the `free_parameters` that change them."""

    law_numbers: Float[np.ndarray, "contacts 4"]
    number_derivatives: Float[np.ndarray, "free contacts 4"]
    free_parameters: Int[np.ndarray, " free"]


def _law_change(hypothesis: Hypothesis, nominal_rig: Rig) -> LawChange | None:
    """Change of the laws by a hypothesis; None where it changes none, or other numbers than these four."""
    step_sizes, hypothesis_values = steps_of(hypothesis.candidates), hypothesis.values
    step_sizes = DERIVATIVE_STEP * np.where(
        hypothesis_values + step_sizes > hypothesis.parameters.bounds[1], -step_sizes, step_sizes
    )
    law_numbers_by_step = [
        _law_numbers(hypothesis, nominal_rig, hypothesis_values + value_change)
        for value_change in (0 * hypothesis_values, *np.diag(step_sizes))
    ]
    dead_zone_numbers = [numbers for numbers in law_numbers_by_step if numbers is not None]
    if len(dead_zone_numbers) < len(law_numbers_by_step) or not step_sizes.size:
        return None
    derivatives = np.array(
        [
            (numbers - dead_zone_numbers[0]) / step
            for numbers, step in zip(dead_zone_numbers[1:], step_sizes, strict=True)
        ]
    )
    free_parameters = np.flatnonzero(np.any(derivatives, axis=(1, 2)))
    return (
        LawChange(dead_zone_numbers[0], derivatives[free_parameters], free_parameters) if free_parameters.size else None
    )


def _law_numbers(
    hypothesis: Hypothesis, nominal_rig: Rig, hypothesis_values: Values
) -> Float[np.ndarray, "contacts 4"] | None:
    """Four numbers of every contact's law; None where any other number differs from the nominal law."""
    try:
        changed_contacts = replace(hypothesis, values=hypothesis_values).applied_to(nominal_rig).contacts
    except RigError:
        return None
    contact_pairs = zip(changed_contacts, nominal_rig.contacts, strict=True)
    if not all(numbers_alone_differ(contact.law, nominal.law) for contact, nominal in contact_pairs):
        return None
    return np.array([parameters_of_law(contact.law) for contact in changed_contacts]).reshape(-1, len(LAW))


def numbers_alone_differ(changed_law: ContactLaw, nominal_law: ContactLaw) -> bool:
    """True if both are dead zones or both springs that differ at most in clearances, stiffness and damping."""
    if type(changed_law) is not type(nominal_law) or not changed_law.piecewise_linear:
        return False
    return (
        msgspec.structs.replace(
            changed_law, **{number_name: getattr(nominal_law, number_name) for number_name in LAW.names}
        )
        == nominal_law
    )


def _solution_of_record(
    nominal_rig: Rig, estimates: Sequence[LawEstimate], law_change: LawChange, free_values: Values
) -> tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]] | None:
    """Estimate v of one record, its covariance and the tolerances' part of it; None where v is not determined."""
    index_by_contact = {contact.name: contact_index for contact_index, contact in enumerate(nominal_rig.contacts)}
    derivatives, quantity_differences, covariances, tolerance_covariances = [], [], [], []
    for estimate in estimates:
        contact_index = index_by_contact[estimate.contact_name]
        quantity_derivative = estimate.quantity_weights @ law_change.number_derivatives[:, contact_index].T
        is_involved = np.any(quantity_derivative, axis=1)
        derivatives.append(quantity_derivative[is_involved])
        quantity_differences.append(
            (estimate.quantity_values - estimate.quantity_weights @ law_change.law_numbers[contact_index])[is_involved]
        )
        covariances.append(estimate.covariance[np.ix_(is_involved, is_involved)])
        tolerance_covariances.append(estimate.tolerance_covariance[np.ix_(is_involved, is_involved)])
    stacked_derivatives = np.concatenate(derivatives) if derivatives else np.zeros((0, free_values.size))
    if (
        len(stacked_derivatives) < free_values.size
        or np.linalg.matrix_rank(stacked_derivatives / np.abs(stacked_derivatives).max(axis=0)) < free_values.size
    ):
        return None
    full_covariance, tolerance_covariance = block_diag(*covariances), block_diag(*tolerance_covariances)
    weighted_derivatives = np.linalg.solve(full_covariance, stacked_derivatives)
    covariance = np.linalg.inv(stacked_derivatives.T @ weighted_derivatives)
    kalman_gain = covariance @ weighted_derivatives.T
    return (
        free_values + kalman_gain @ np.concatenate(quantity_differences),
        covariance,
        kalman_gain @ tolerance_covariance @ kalman_gain.T,
    )


def _pooled_values(
    record_solutions: Sequence[tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]]],
) -> tuple[Values, Float[np.ndarray, "free free"]]:
    """Pooled v of records and its covariance, from v, its covariance and the shared part of it of each."""
    information_by_record = [
        np.linalg.inv(covariance - shared_covariance) for _, covariance, shared_covariance in record_solutions
    ]
    pooled_covariance = np.linalg.inv(sum(information_by_record))
    pooled_values = pooled_covariance @ sum(
        record_information @ values
        for record_information, (values, _, _) in zip(information_by_record, record_solutions, strict=True)
    )
    return pooled_values, pooled_covariance + np.mean(
        [shared_covariance for _, _, shared_covariance in record_solutions], axis=0
    )
