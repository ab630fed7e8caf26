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
from identify.gaps.search.hypothesis import Hypothesis, step_sizes_of
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
    contact_names = [contact.name for contact in rig.contacts]
    if unmodelled_part := _feature_beyond_contact_fit(rig):
        refusal = refused(RefusalCode.NOT_MODELLED, rig=rig.name, what=unmodelled_part).refusal
        return LawOutcomes((), dict.fromkeys(contact_names, refusal))
    force_data = recording.signals["force"]
    signals = {**recording.signals, "force": replace(force_data, values=force_data.values / rig.force_sensor.gain)}
    separated_rig = msgspec.structs.replace(rig, base_motion=None, tones=(), force_sensor=ForceSensor())
    try:
        separation = separate(replace(recording, rig=separated_rig, signals=signals), "auto", tolerances)
        outcomes = accept(separation, determine(separation)).outcomes
    except ContactRefusedError as error:
        return LawOutcomes((), dict.fromkeys(contact_names, error.refusal))
    except RigError:
        return LawOutcomes()
    estimates = tuple(_law_estimate(name, estimate) for name, estimate in outcomes.estimates.items())
    return LawOutcomes(estimates, outcomes.refusals)


def _feature_beyond_contact_fit(rig: Rig) -> str:
    """Part of a rig that the contact fit does not model; empty if it models all."""
    if rig.loads:
        return "a constant force"
    if rig.dampers:
        return "a damper or friction to the ground"
    if any(spring.cubic_n_per_m3 for spring in rig.springs):
        return "a spring in the cube of the displacement"
    return "a lag of the force sensor" if rig.force_sensor.lag_s else ""


def pooled_law_estimate(estimates: Sequence[LawEstimate]) -> LawEstimate:
    """Pooled estimate of a contact from those records that determine most of its quantities."""
    max_quantity_count = max(len(estimate.quantity_values) for estimate in estimates)
    comparable = [estimate for estimate in estimates if len(estimate.quantity_values) == max_quantity_count]
    quantity_weights = comparable[0].quantity_weights
    comparable = [estimate for estimate in comparable if np.array_equal(estimate.quantity_weights, quantity_weights)]
    values, covariance = _pooled_values_and_covariance(
        [(estimate.quantity_values, estimate.covariance, estimate.tolerance_covariance) for estimate in comparable]
    )
    shared_covariance = np.mean([estimate.tolerance_covariance for estimate in comparable], axis=0)
    return replace(comparable[0], quantity_values=values, covariance=covariance, tolerance_covariance=shared_covariance)


def _law_estimate(contact_name: str, estimate: JointEstimate) -> LawEstimate:
    gradients = [] if estimate.is_spring else [estimate.clearance_gradient]
    gradients += [STIFFNESS_GRADIENT, DAMPING_GRADIENT]
    if estimate.sides_known and all(estimate.touched):
        gradients.append(OFFSET_GRADIENT)
    quantity_weights = np.array(gradients)
    return LawEstimate(
        contact_name,
        quantity_weights,
        quantity_weights @ estimate.values,
        quantity_weights @ estimate.covariance @ quantity_weights.T,
        quantity_weights @ estimate.covariances["tolerances"] @ quantity_weights.T,
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
    nominal_rig, values = recordings[0].rig, hypothesis.values.copy()
    law_change = _law_parameter_derivatives(hypothesis, nominal_rig)
    if law_change is None:
        return hypothesis
    rig, free = hypothesis.applied_to(nominal_rig), law_change.free_indices
    solutions = (
        _solution_of_record(nominal_rig, outcomes_of(recording, rig, tolerances).estimates, law_change, values[free])
        for recording in recordings
    )
    determined_solutions = [solution for solution in solutions if solution is not None]
    if not determined_solutions:
        return hypothesis
    covariance = hypothesis.covariance.copy()
    covariance[free] = covariance[:, free] = 0.0
    pooled_values, covariance[np.ix_(free, free)] = _pooled_values_and_covariance(determined_solutions)
    lower_bounds, upper_bounds = hypothesis.parameters.bounds
    values[free] = np.clip(pooled_values, lower_bounds[free], upper_bounds[free])
    return replace(hypothesis, values=values, covariance=covariance)


@dataclass(frozen=True)
class LawParameterDerivatives:
    """Numbers y of every contact's law under a hypothesis, and dy/dv for the `free_indices` that change them."""

    law_parameters: Float[np.ndarray, "contacts 4"]
    parameter_derivatives: Float[np.ndarray, "free contacts 4"]
    free_indices: Int[np.ndarray, " free"]


def _law_parameter_derivatives(hypothesis: Hypothesis, nominal_rig: Rig) -> LawParameterDerivatives | None:
    """Change of the laws by a hypothesis; None where it changes none, or other numbers than these four."""
    values, steps = hypothesis.values, step_sizes_of(hypothesis.candidates)
    steps = DERIVATIVE_STEP * np.where(values + steps > hypothesis.parameters.bounds[1], -steps, steps)
    if not steps.size:
        return None
    law_parameters = []
    for value_change in (0 * values, *np.diag(steps)):
        parameters = _law_parameters(hypothesis, nominal_rig, values + value_change)
        if parameters is None:
            return None
        law_parameters.append(parameters)
    nominal_parameters, *stepped_parameters = law_parameters
    derivatives = np.array(
        [(parameters - nominal_parameters) / step for parameters, step in zip(stepped_parameters, steps, strict=True)]
    )
    free_indices = np.flatnonzero(np.any(derivatives, axis=(1, 2)))
    return (
        LawParameterDerivatives(nominal_parameters, derivatives[free_indices], free_indices)
        if free_indices.size
        else None
    )


def _law_parameters(
    hypothesis: Hypothesis, nominal_rig: Rig, hypothesis_values: Values
) -> Float[np.ndarray, "contacts 4"] | None:
    """Four numbers of every contact's law; None where any other number differs from the nominal law."""
    try:
        contacts = replace(hypothesis, values=hypothesis_values).applied_to(nominal_rig).contacts
    except RigError:
        return None
    pairs = zip(contacts, nominal_rig.contacts, strict=True)
    if not all(parameters_alone_differ(contact.law, nominal.law) for contact, nominal in pairs):
        return None
    return np.array([parameters_of_law(contact.law) for contact in contacts]).reshape(-1, len(LAW))


def parameters_alone_differ(changed_law: ContactLaw, nominal_law: ContactLaw) -> bool:
    """True if both are dead zones or both springs that differ at most in clearances, stiffness and damping."""
    if type(changed_law) is not type(nominal_law) or not changed_law.piecewise_linear:
        return False
    nominal_parameters = {name: getattr(nominal_law, name) for name in LAW.names}
    return msgspec.structs.replace(changed_law, **nominal_parameters) == nominal_law


def _solution_of_record(
    nominal_rig: Rig, estimates: Sequence[LawEstimate], law_change: LawParameterDerivatives, free_values: Values
) -> tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]] | None:
    """Estimate v of one record, its covariance and the tolerances' part of it; None where v is not determined."""
    contact_names = [contact.name for contact in nominal_rig.contacts]
    derivatives, differences, covariances, tolerance_covariances = [], [], [], []
    for estimate in estimates:
        contact_index, weights = contact_names.index(estimate.contact_name), estimate.quantity_weights
        quantity_derivative = weights @ law_change.parameter_derivatives[:, contact_index].T
        is_involved = np.any(quantity_derivative, axis=1)
        derivatives.append(quantity_derivative[is_involved])
        differences.append((estimate.quantity_values - weights @ law_change.law_parameters[contact_index])[is_involved])
        covariances.append(estimate.covariance[np.ix_(is_involved, is_involved)])
        tolerance_covariances.append(estimate.tolerance_covariance[np.ix_(is_involved, is_involved)])
    stacked_derivatives = np.concatenate(derivatives) if derivatives else np.zeros((0, free_values.size))
    if (
        len(stacked_derivatives) < free_values.size
        or np.linalg.matrix_rank(stacked_derivatives / np.abs(stacked_derivatives).max(axis=0)) < free_values.size
    ):
        return None
    weighted_derivatives = np.linalg.solve(block_diag(*covariances), stacked_derivatives)
    covariance = np.linalg.inv(stacked_derivatives.T @ weighted_derivatives)
    quantity_gain = covariance @ weighted_derivatives.T
    values = free_values + quantity_gain @ np.concatenate(differences)
    return values, covariance, quantity_gain @ block_diag(*tolerance_covariances) @ quantity_gain.T


def _pooled_values_and_covariance(
    solutions: Sequence[tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]]],
) -> tuple[Values, Float[np.ndarray, "free free"]]:
    """Pooled v of records and its covariance, from v, its covariance and the shared part of it of each."""
    precisions = [np.linalg.inv(covariance - shared) for _, covariance, shared in solutions]
    covariance = np.linalg.inv(sum(precisions))
    values = covariance @ sum(
        precision @ values for precision, (values, _, _) in zip(precisions, solutions, strict=True)
    )
    return values, covariance + np.mean([shared for _, _, shared in solutions], axis=0)
