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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

from identify.contacts.acceptance import accept
from identify.contacts.determination import determine
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import DAMPING, LAW, OFFSET, STIFFNESS, law_numbers
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
    """Estimated quantities of a contact from one record: `values` = `quantities` @ law, with their covariance.

    of_tolerances is the part of the covariance that all records of the machine share.
    """

    contact: str
    quantities: Float[np.ndarray, "rows 4"]
    values: Float[np.ndarray, " rows"]
    covariance: Float[np.ndarray, "rows rows"]
    of_tolerances: Float[np.ndarray, "rows rows"]


@dataclass(frozen=True)
class LawOutcomes:
    """Estimates of the contacts that one record determines, and refusals of the others by their names."""

    estimates: tuple[LawEstimate, ...] = ()
    refusals: Mapping[str, Refusal] = field(default_factory=dict)


def law_outcomes(recording: Recording, rig: Rig, tolerances: Tolerances) -> LawOutcomes:
    """Estimates of the contacts from a record, separated with the linear model of `rig`.

    Unmeasured excitation (a base motion, a tone) stays in the scatter.
    """
    if not_modelled := _unmodelled_part(rig):
        refusal = refused(RefusalCode.NOT_MODELLED, rig=rig.name, what=not_modelled).refusal
        return LawOutcomes((), dict.fromkeys((contact.name for contact in rig.contacts), refusal))
    force = recording.signals["force"]
    signals = {**recording.signals, "force": replace(force, values=force.values / rig.force_sensor.gain)}
    sensors = tuple(s for s in rig.sensors if s.measures.translates)  # the diagnosis uses no strain gauges
    fitted_rig = msgspec.structs.replace(rig, base_motion=None, tones=(), force_sensor=ForceSensor(), sensors=sensors)
    try:
        separation = separate(replace(recording, rig=fitted_rig, signals=signals), "auto", tolerances)
        outcomes = accept(separation, determine(separation)).outcomes
    except ContactRefusedError as error:
        return LawOutcomes((), {contact.name: error.refusal for contact in rig.contacts})
    except RigError:
        return LawOutcomes()
    return LawOutcomes(
        tuple(_estimate(contact, estimate) for contact, estimate in outcomes.estimates.items()), outcomes.refusals
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
    largest_count = max(len(estimate.values) for estimate in estimates)
    comparable = [estimate for estimate in estimates if len(estimate.values) == largest_count]
    comparable = [estimate for estimate in comparable if np.array_equal(estimate.quantities, comparable[0].quantities)]
    values, covariance = _pooled([(item.values, item.covariance, item.of_tolerances) for item in comparable])
    shared_covariance = np.mean([estimate.of_tolerances for estimate in comparable], axis=0)
    return replace(comparable[0], values=values, covariance=covariance, of_tolerances=shared_covariance)


def _estimate(contact: str, fit: JointEstimate) -> LawEstimate:
    rows = [STIFFNESS, DAMPING] if fit.is_spring else [fit.clearance, STIFFNESS, DAMPING]
    if fit.sides_known and all(fit.touched):
        rows.append(OFFSET)
    quantities = np.array(rows)
    return LawEstimate(
        contact,
        quantities,
        quantities @ fit.values,
        quantities @ fit.covariance @ quantities.T,
        quantities @ fit.of_tolerances @ quantities.T,
    )


def with_contact_fit(hypothesis: Hypothesis, recordings: Sequence[Recording], tolerances: Tolerances) -> Hypothesis:
    """Hypothesis whose contact laws have the values and the covariance of the joint contact fit.

    Unchanged where its effects change no law, a law other than a dead zone, or quantities that no record determines.
    """
    nominal_rig, values = recordings[0].rig, hypothesis.values
    change = _law_change(hypothesis, nominal_rig)
    if change is None:
        return hypothesis
    rig, free = hypothesis.applied_to(nominal_rig), change.free
    solutions = (
        _record_solution(nominal_rig, law_outcomes(recording, rig, tolerances).estimates, change, values[free])
        for recording in recordings
    )
    determined = [solution for solution in solutions if solution is not None]
    if not determined:
        return hypothesis
    fitted_values, covariance = values.copy(), hypothesis.covariance.copy()
    covariance[free] = covariance[:, free] = 0.0
    pooled_values, covariance[np.ix_(free, free)] = _pooled(determined)
    low, high = hypothesis.parameters.bounds
    fitted_values[free] = np.clip(pooled_values, low[free], high[free])
    return replace(hypothesis, values=fitted_values, covariance=covariance)


@dataclass(frozen=True)
class LawChange:
    """Numbers y of every contact's law under a hypothesis, and dy/dv for the parameters `free` that change them."""

    numbers: Float[np.ndarray, "contacts 4"]
    jacobian: Float[np.ndarray, "free contacts 4"]
    free: Int[np.ndarray, " free"]


def _law_change(hypothesis: Hypothesis, nominal_rig: Rig) -> LawChange | None:
    """Change of the laws by a hypothesis; None where it changes none, or other numbers than these four."""
    steps, values = steps_of(hypothesis.candidates), hypothesis.values
    steps = DERIVATIVE_STEP * np.where(values + steps > hypothesis.parameters.bounds[1], -steps, steps)
    laws = [_law_numbers(hypothesis, nominal_rig, values + change) for change in (0 * values, *np.diag(steps))]
    dead_zones = [law for law in laws if law is not None]
    if len(dead_zones) < len(laws) or not steps.size:
        return None
    jacobian = np.array([(law - dead_zones[0]) / step for law, step in zip(dead_zones[1:], steps, strict=True)])
    free = np.flatnonzero(np.any(jacobian, axis=(1, 2)))
    return LawChange(dead_zones[0], jacobian[free], free) if free.size else None


def _law_numbers(hypothesis: Hypothesis, nominal_rig: Rig, values: Values) -> Float[np.ndarray, "contacts 4"] | None:
    """Four numbers of every contact's law; None where any other number differs from the nominal law."""
    try:
        contacts = replace(hypothesis, values=values).applied_to(nominal_rig).contacts
    except RigError:
        return None
    pairs = zip(contacts, nominal_rig.contacts, strict=True)
    if not all(numbers_alone_differ(contact.law, nominal.law) for contact, nominal in pairs):
        return None
    return np.array([law_numbers(contact.law) for contact in contacts]).reshape(-1, len(LAW))


def numbers_alone_differ(law: ContactLaw, nominal: ContactLaw) -> bool:
    """True if both are dead zones or both springs that differ at most in clearances, stiffness and damping."""
    if type(law) is not type(nominal) or not law.piecewise_linear:
        return False
    return msgspec.structs.replace(law, **{name: getattr(nominal, name) for name in LAW.names}) == nominal


def _record_solution(
    nominal_rig: Rig, estimates: Sequence[LawEstimate], change: LawChange, values: Values
) -> tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]] | None:
    """Estimate v of one record, its covariance and the tolerances' part of it; None where v is not determined."""
    index = {contact.name: j for j, contact in enumerate(nominal_rig.contacts)}
    rows, differences, covariances, tolerances = [], [], [], []
    for estimate in estimates:
        j = index[estimate.contact]
        derivative = estimate.quantities @ change.jacobian[:, j].T
        involved = np.any(derivative, axis=1)
        rows.append(derivative[involved])
        differences.append((estimate.values - estimate.quantities @ change.numbers[j])[involved])
        covariances.append(estimate.covariance[np.ix_(involved, involved)])
        tolerances.append(estimate.of_tolerances[np.ix_(involved, involved)])
    matrix = np.concatenate(rows) if rows else np.zeros((0, values.size))
    if len(matrix) < values.size or np.linalg.matrix_rank(matrix / np.abs(matrix).max(axis=0)) < values.size:
        return None
    full_covariance, tolerance_covariance = block_diag(*covariances), block_diag(*tolerances)
    weighted = np.linalg.solve(full_covariance, matrix)
    covariance = np.linalg.inv(matrix.T @ weighted)
    kalman_gain = covariance @ weighted.T
    return (
        values + kalman_gain @ np.concatenate(differences),
        covariance,
        kalman_gain @ tolerance_covariance @ kalman_gain.T,
    )


def _pooled(
    by_record: Sequence[tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]]],
) -> tuple[Values, Float[np.ndarray, "free free"]]:
    """Pooled v of records and its covariance, from v, its covariance and the shared part of it of each."""
    information = [np.linalg.inv(covariance - shared) for _, covariance, shared in by_record]
    pooled_covariance = np.linalg.inv(sum(information))
    mean = pooled_covariance @ sum(
        weight @ values for weight, (values, _, _) in zip(information, by_record, strict=True)
    )
    return mean, pooled_covariance + np.mean([shared for _, _, shared in by_record], axis=0)
