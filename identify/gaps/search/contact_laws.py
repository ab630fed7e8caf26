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
from identify.contacts.contact_record import DAMPING, LAW, OFFSET, STIFFNESS
from identify.contacts.determination import determine
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.refusals import ContactRefusedError, Refusal, RefusalCode, refused
from identify.contacts.separation import separate
from identify.gaps.search.hypothesis import Hypothesis, steps_of
from rig.errors import RigError
from rig.model.contact_laws import ContactLaw, DeadZone
from rig.model.description import ForceSensor, Rig
from rig.model.tolerances import Tolerances
from rig.recording import Recording

DERIVATIVE_STEP = 1e-3
"""Of a parameter's search step, for dy/dv, which is exact: every y is linear in every v."""

Values = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class LawEstimate:
    """Fitted quantities of one contact of one record: `values` = `quantities` @ law, with the covariance of `values`.

    of_tolerances is the part of the covariance that all records of the machine share.
    """

    contact: str
    quantities: Float[np.ndarray, "rows 4"]
    values: Float[np.ndarray, " rows"]
    covariance: Float[np.ndarray, "rows rows"]
    of_tolerances: Float[np.ndarray, "rows rows"]


@dataclass(frozen=True)
class LawOutcomes:
    """The contacts that one record determines, and why it does not determine the others, by their names."""

    estimates: tuple[LawEstimate, ...] = ()
    refusals: Mapping[str, Refusal] = field(default_factory=dict)


def law_outcomes(recording: Recording, rig: Rig, tolerances: Tolerances) -> LawOutcomes:
    """Estimates of contacts by a record whose machine has the linear model of `rig`.

    What acts unmeasured (a base motion, a tone) is left to the scatter.
    """
    if attached := _not_modelled(rig):
        refusal = refused(RefusalCode.NOT_MODELLED, rig=rig.name, what=attached).refusal
        return LawOutcomes((), dict.fromkeys((contact.name for contact in rig.contacts), refusal))
    force = recording.signals["force"]
    signals = {**recording.signals, "force": replace(force, values=force.values / rig.force_sensor.gain)}
    modelled = msgspec.structs.replace(rig, base_motion=None, tones=(), force_sensor=ForceSensor())
    try:
        separation = separate(replace(recording, rig=modelled, signals=signals), "auto", tolerances)
        outcomes = accept(separation, determine(separation)).outcomes
    except ContactRefusedError as error:
        return LawOutcomes((), {contact.name: error.refusal for contact in rig.contacts})
    except RigError:
        return LawOutcomes()
    return LawOutcomes(
        tuple(_estimate(contact, estimate) for contact, estimate in outcomes.estimates.items()), outcomes.refusals
    )


def _not_modelled(rig: Rig) -> str:
    """Reason why the contact fit does not know a rig; empty where it does."""
    if rig.loads:
        return "a constant force"
    if rig.dampers:
        return "a damper or friction to the ground"
    if any(spring.cubic_n_per_m3 for spring in rig.springs):
        return "a spring in the cube of the displacement"
    return "a lag of the force sensor" if rig.force_sensor.lag_s else ""


def pooled_estimate(estimates: Sequence[LawEstimate]) -> LawEstimate:
    """One contact's, of several records together: of those that tell most of its quantities."""
    most = max(len(one.values) for one in estimates)
    same = [one for one in estimates if len(one.values) == most]
    same = [one for one in same if np.array_equal(one.quantities, same[0].quantities)]
    values, covariance = _pooled([(one.values, one.covariance, one.of_tolerances) for one in same])
    shared = np.mean([one.of_tolerances for one in same], axis=0)
    return replace(same[0], values=values, covariance=covariance, of_tolerances=shared)


def _estimate(contact: str, fit: JointEstimate) -> LawEstimate:
    rows = [fit.clearance, STIFFNESS, DAMPING]
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
    """The hypothesis with the values and covariance that the contact fit gives of its contact laws.

    It stays as it is where its effects move no law, a law other than a dead zone, or what the records do not determine.
    """
    believed, values = recordings[0].rig, hypothesis.values
    change = _law_change(hypothesis, believed)
    if change is None:
        return hypothesis
    rig, free = hypothesis.applied_to(believed), change.free
    of_records = (
        _solved(believed, law_outcomes(recording, rig, tolerances).estimates, change, values[free])
        for recording in recordings
    )
    determined = [solution for solution in of_records if solution is not None]
    if not determined:
        return hypothesis
    fitted, covariance = values.copy(), hypothesis.covariance.copy()
    covariance[free] = covariance[:, free] = 0.0
    mean, covariance[np.ix_(free, free)] = _pooled(determined)
    low, high = hypothesis.parameters.bounds
    fitted[free] = np.clip(mean, low[free], high[free])
    return replace(hypothesis, values=fitted, covariance=covariance)


@dataclass(frozen=True)
class LawChange:
    """The numbers y of every contact's law under a hypothesis, and dy/dv by the parameters `free` that move them."""

    numbers: Float[np.ndarray, "contacts 4"]
    jacobian: Float[np.ndarray, "free contacts 4"]
    free: Int[np.ndarray, " free"]


def _law_change(hypothesis: Hypothesis, believed: Rig) -> LawChange | None:
    """None where the effects move no law, or another number of it than these four."""
    steps, values = steps_of(hypothesis.parts), hypothesis.values
    steps = DERIVATIVE_STEP * np.where(values + steps > hypothesis.parameters.bounds[1], -steps, steps)
    laws = [_law_numbers(hypothesis, believed, values + move) for move in (0 * values, *np.diag(steps))]
    known = [law for law in laws if law is not None]
    if len(known) < len(laws) or not steps.size:
        return None
    jacobian = np.array([(law - known[0]) / step for law, step in zip(known[1:], steps, strict=True)])
    free = np.flatnonzero(np.any(jacobian, axis=(1, 2)))
    return LawChange(known[0], jacobian[free], free) if free.size else None


def _law_numbers(hypothesis: Hypothesis, believed: Rig, values: Values) -> Float[np.ndarray, "contacts 4"] | None:
    """The four numbers of every contact's law; None where any other number of a law differs from the believed one."""
    try:
        contacts = replace(hypothesis, values=values).applied_to(believed).contacts
    except RigError:
        return None
    if not all(numbers_alone_differ(c.law, b.law) for c, b in zip(contacts, believed.contacts, strict=True)):
        return None
    return np.array([law_numbers(c.law) for c in contacts]).reshape(-1, len(LAW))


def numbers_alone_differ(law: ContactLaw, nominal: ContactLaw) -> bool:
    """True if two laws are dead zones that are alike but for clearances, stiffness and damping."""
    if not (isinstance(law, DeadZone) and isinstance(nominal, DeadZone)):
        return False
    return msgspec.structs.replace(law, **{name: getattr(nominal, name) for name in LAW.names}) == nominal


def law_numbers(law: ContactLaw) -> Float[np.ndarray, " 4"]:
    """Lower and upper clearance (m), stiffness (N/m) and damping (N s/m)."""
    return np.array([getattr(law, name) for name in LAW.names])


def _solved(
    believed: Rig, estimates: Sequence[LawEstimate], change: LawChange, values: Values
) -> tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]] | None:
    """v of one record, its covariance and the part of it by tolerances; None where the estimates do not determine v."""
    index = {contact.name: j for j, contact in enumerate(believed.contacts)}
    rows, differences, covariances, tolerances = [], [], [], []
    for estimate in estimates:
        j = index[estimate.contact]
        by_value = estimate.quantities @ change.jacobian[:, j].T
        used = np.any(by_value, axis=1)
        rows.append(by_value[used])
        differences.append((estimate.values - estimate.quantities @ change.numbers[j])[used])
        covariances.append(estimate.covariance[np.ix_(used, used)])
        tolerances.append(estimate.of_tolerances[np.ix_(used, used)])
    matrix = np.concatenate(rows) if rows else np.zeros((0, values.size))
    if len(matrix) < values.size or np.linalg.matrix_rank(matrix / np.abs(matrix).max(axis=0)) < values.size:
        return None
    whole, shared = block_diag(*covariances), block_diag(*tolerances)
    weighted = np.linalg.solve(whole, matrix)
    covariance = np.linalg.inv(matrix.T @ weighted)
    gain = covariance @ weighted.T
    return values + gain @ np.concatenate(differences), covariance, gain @ shared @ gain.T


def _pooled(
    by_record: Sequence[tuple[Values, Float[np.ndarray, "free free"], Float[np.ndarray, "free free"]]],
) -> tuple[Values, Float[np.ndarray, "free free"]]:
    own = [np.linalg.inv(covariance - shared) for _, covariance, shared in by_record]
    together = np.linalg.inv(sum(own))
    mean = together @ sum(weight @ values for weight, (values, _, _) in zip(own, by_record, strict=True))
    return mean, together + np.mean([shared for _, _, shared in by_record], axis=0)
