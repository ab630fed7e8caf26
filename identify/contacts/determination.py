"""Second stage, determination: the joint estimate of every contact, or why the record does not determine it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress, permutations
from operator import itemgetter

import numpy as np
from jaxtyping import Bool, Float

from identify.contacts.contact_record import ContactRecord, touched_stops
from identify.contacts.initial_guess import (
    initial_state_pulls,
    reach_m,
    spring_guess,
    without_nuisances,
    without_spring,
)
from identify.contacts.joint_fit import JointEstimate, fit_joint
from identify.contacts.law_form import ABSENT_STOP_M, STIFFNESS_GRADIENT, FormName, NominalLaws, parameters_of_law
from identify.contacts.outcomes import NO_OUTCOMES, Outcomes, check_certain
from identify.contacts.refusals import ContactRefusedError, Refusal, RefusalCode, refused
from identify.contacts.separation import Separation
from identify.linear.joined import ContactGroup
from identify.signals.refit import refit_until_settled
from rig.model.description import Rig

MOST_CONTACTS = 3
"""Contacts between the same places that have fewer parameters than a record has parts for their scatter."""
UNTOUCHED_STOP_RATIO = 2.0
"""A stop whose nominal clearance is so many times the reach of the motion is not touched, whatever its error."""
ABSENT_STOP_RATIO = 10.0
"""A stop whose nominal clearance is so many times the largest relative displacement does not exist."""
SPRING_ADVICE_CODES = (RefusalCode.NO_STIFFNESS, RefusalCode.NO_LAW, RefusalCode.UNCERTAIN, RefusalCode.NOT_SEPARABLE)
"""Refusals that a spring which is described as a stop without clearance leads to."""
SPRING_UNEXPLAINED_SHARE = 0.05
"""Share of the force that a spring may leave where the stops beside it are taken not to be reached."""
NOMINAL_SPREAD, EXCHANGE_DISTANCE, LEAST_COMPARED_VALUE = np.array([0.2, 1.0]), 2.0, 1e-12
"""Standard deviations of clearance and stiffness in rig.json, as shares; the distance in them that rules out that two
contacts are exchanged."""
COUPLING_ROUNDS = 3
"""Rounds of fits where slow motions are coupled: a coupling is a small share of the forces."""


def determine(separation: Separation, forms: Sequence[FormName] = ()) -> Outcomes:
    """Outcomes of all contacts. Each force is fitted by itself; where springs couple the slow motions of contacts,
    again without the forces of that coupling. The forms of a law are tried against the dead zone.
    """
    rig, records, groups = separation.rig, separation.records, separation.contact_groups
    slow_stiffness_n_per_m = separation.forces.slow_n_per_m
    coupling_n_per_m = slow_stiffness_n_per_m - np.diag(np.diag(slow_stiffness_n_per_m))

    def refit(outcomes: Outcomes, forms: Sequence[FormName] = ()) -> Outcomes:
        group_records = zip(groups, records, strict=True)
        slow_eta_m = np.array([_slow_displacement_m(rig, group, record, outcomes) for group, record in group_records])
        coupled = zip(records, coupling_n_per_m @ slow_eta_m, strict=True)
        return determine_all([replace(record, force_n=record.force_n - force_n) for record, force_n in coupled], forms)

    def determine_all(records: Sequence[ContactRecord], forms: Sequence[FormName]) -> Outcomes:
        outcomes = NO_OUTCOMES
        for group, record in zip(groups, records, strict=True):
            outcomes |= determine_group(rig, group, record, forms)
        return outcomes

    if not np.any(coupling_n_per_m):
        return determine_all(records, forms)
    settled_outcomes = refit_until_settled(determine_all(records, ()), refit, max_rounds=COUPLING_ROUNDS)
    return refit(settled_outcomes, forms) if forms else settled_outcomes


def _slow_displacement_m(
    rig: Rig, group: ContactGroup, record: ContactRecord, outcomes: Outcomes
) -> Float[np.ndarray, " fewer"]:
    """Slow relative displacement of a pair of places by the estimate there, m; zero without an estimate."""
    slow_eta_m = np.zeros(len(record.force_n))
    for contact_index, sign in zip(group.contact_indices, group.signs, strict=True):
        estimate = outcomes.estimates.get(rig.contacts[contact_index].name)
        if estimate is not None:
            drift_m = sign * estimate.drift_m + estimate.pulls[record.shifts_eta] @ record.nuisance_m
            slow_eta_m = record.at_force_samples(drift_m)
    return slow_eta_m


def determine_group(rig: Rig, group: ContactGroup, record: ContactRecord, forms: Sequence[FormName] = ()) -> Outcomes:
    """Outcomes of the contacts between two places."""
    contacts, nominal_laws = [rig.contacts[index] for index in group.contact_indices], _nominal_laws(rig, group)
    names, are_springs = [contact.name for contact in contacts], [not contact.law.has_stops for contact in contacts]
    try:
        if not any(are_springs):
            outcomes = _stop_outcomes(names, nominal_laws, record, forms)
        elif len(names) == 1:
            outcomes = _spring_outcome(names[0], nominal_laws, record)
        else:
            outcomes = _spring_and_stops_outcomes(names, nominal_laws, record, np.array(are_springs))
    except ContactRefusedError as error:
        outcomes = Outcomes.refused(names, error.refusal)
    sign_by_name = dict(zip(names, group.signs, strict=True))
    estimates = {
        name: estimate if sign_by_name[name] > 0 else estimate.reversed for name, estimate in outcomes.estimates.items()
    }
    return Outcomes(estimates, _with_spring_advice(rig, outcomes.refusals))


def _with_spring_advice(rig: Rig, refusals: Mapping[str, Refusal]) -> dict[str, Refusal]:
    """Refusals, with the advice to describe a spring where stops without clearances show no law with a gap."""
    gapless_names = {
        contact.name
        for contact in rig.contacts
        if contact.law.has_stops and not (contact.law.lower_clearance_m or contact.law.upper_clearance_m)
    }
    no_gap_refusal = refused(RefusalCode.NO_GAP).refusal
    return {
        name: no_gap_refusal if name in gapless_names and refusal.code in SPRING_ADVICE_CODES else refusal
        for name, refusal in refusals.items()
    }


def _nominal_laws(rig: Rig, group: ContactGroup) -> NominalLaws:
    """Nominal laws of the contacts between two places, in the direction of the first contact."""
    laws = [parameters_of_law(rig.contacts[index].law) for index in group.contact_indices]
    return np.array([law if sign > 0 else law[[1, 0, 2, 3]] for law, sign in zip(laws, group.signs, strict=True)])


def _stop_outcomes(
    names: Sequence[str], nominal_laws: NominalLaws, record: ContactRecord, forms: Sequence[FormName]
) -> Outcomes:
    """Outcomes of one contact, or of several that share a relative displacement, in the direction of the first.

    Raises ContactRefusedError if none is determined, for one reason.
    """
    is_touched = np.array(touched_stops(without_nuisances(record, initial_state_pulls(record))))
    if len(names) == 1:
        (estimate,) = fit_joint(record, nominal_laws, _present_stops(nominal_laws[0], record, is_touched)[None], forms)
        check_certain(estimate, record.drift is not None)
        return Outcomes({names[0]: estimate}, {})
    if len(names) > MOST_CONTACTS:
        raise refused(RefusalCode.TOO_MANY_CONTACTS, contacts=f"{len(names)} contacts", at_most=MOST_CONTACTS)
    nearest_clearances_m = nominal_laws[:, :2].min(axis=0)  # which is always touched
    eta_reach_m = np.maximum(reach_m(record), np.where(nearest_clearances_m < ABSENT_STOP_M, nearest_clearances_m, 0.0))
    return _outcomes_in_reach(names, nominal_laws, record, is_touched, eta_reach_m, np.zeros(len(names), dtype=bool))


def _spring_and_stops_outcomes(
    names: Sequence[str], nominal_laws: NominalLaws, record: ContactRecord, are_springs: Bool[np.ndarray, " contacts"]
) -> Outcomes:
    """Outcomes of a spring and of stops that share a relative displacement, in the direction of the first contact. The
    spring alone where no stop is determined and it leaves no more than `SPRING_UNEXPLAINED_SHARE` of the force: then
    the stops are not reached.

    Raises ContactRefusedError of too many contacts, or if they stand still.
    """
    if np.sum(are_springs) > 1:
        raise refused(RefusalCode.TOO_MANY_CONTACTS, contacts=f"{np.sum(are_springs)} springs", at_most=1)
    if len(names) > MOST_CONTACTS:
        raise refused(RefusalCode.TOO_MANY_CONTACTS, contacts=f"{len(names)} contacts", at_most=MOST_CONTACTS)
    if not np.ptp(record.eta_m):
        raise refused(RefusalCode.STANDS_STILL)
    outcomes = NO_OUTCOMES
    try:
        spring_law, eta_m = spring_guess(without_nuisances(record, initial_state_pulls(record)))
        laws_with_spring = np.where(are_springs[:, None], spring_law, nominal_laws)
        outcomes = _stops_beside_spring(names, laws_with_spring, record, eta_m, are_springs)
    except ContactRefusedError as error:
        outcomes = Outcomes.refused(names, error.refusal)
    if outcomes.estimates.keys() & set(compress(names, ~are_springs)):
        return outcomes
    return _spring_alone_if_sufficient(names, nominal_laws, record, are_springs) or outcomes


def _stops_beside_spring(
    names: Sequence[str],
    laws: NominalLaws,
    record: ContactRecord,
    eta_m: Float[np.ndarray, " samples"],
    are_springs: Bool[np.ndarray, " contacts"],
) -> Outcomes:
    """Outcomes of stops with a spring of that law beside them; eta_m is the relative displacement with its drift."""
    (spring_law,) = laws[are_springs]
    stop_record = without_spring(without_nuisances(record, initial_state_pulls(record)), spring_law)
    is_touched = np.array(touched_stops(stop_record))
    if len(names) > 2:
        return _outcomes_in_reach(names, laws, record, is_touched, np.array([-eta_m.min(), eta_m.max()]), are_springs)
    touched = np.zeros((len(names), 2), dtype=bool)
    touched[~are_springs] = _present_stops(laws[~are_springs][0], stop_record, is_touched)
    return _outcomes_refused_individually(names, laws, touched, record)


def _outcomes_refused_individually(
    names: Sequence[str], laws: NominalLaws, touched: Bool[np.ndarray, "contacts 2"], record: ContactRecord
) -> Outcomes:
    """Outcomes of one stop and a spring, each refused by itself if it is uncertain."""
    outcomes = NO_OUTCOMES
    for name, estimate in zip(names, fit_joint(record, laws, touched), strict=True):
        try:
            check_certain(estimate, record.drift is not None)
        except ContactRefusedError as error:
            outcomes |= Outcomes({}, {name: error.refusal})
        else:
            outcomes |= Outcomes({name: estimate}, {})
    return outcomes


def _spring_alone_if_sufficient(
    names: Sequence[str], nominal_laws: NominalLaws, record: ContactRecord, are_springs: Bool[np.ndarray, " contacts"]
) -> Outcomes | None:
    """Outcomes of a spring that explains the force without the stops beside it; None if it does not."""
    name = names[int(np.argmax(are_springs))]
    try:
        outcomes = _spring_outcome(name, nominal_laws[are_springs], record)
    except ContactRefusedError:
        return None
    spring_estimate = outcomes.estimates[name]
    if spring_estimate.unexplained_share > SPRING_UNEXPLAINED_SHARE:
        return None
    eta_m = record.eta_m + spring_estimate.drift_m
    eta_reach_m, hardly_closed = np.array([-eta_m.min(), eta_m.max()]), refused(RefusalCode.HARDLY_CLOSES).refusal
    names_and_laws = zip(compress(names, ~are_springs), nominal_laws[~are_springs], strict=True)
    refusals = {
        stop_name: _not_reached_refusal(law, eta_reach_m) if np.all(law[:2] > eta_reach_m) else hardly_closed
        for stop_name, law in names_and_laws
    }
    return outcomes | Outcomes({}, refusals)


def _spring_outcome(name: str, nominal_laws: NominalLaws, record: ContactRecord) -> Outcomes:
    """Outcome of a spring alone between two places.

    Raises ContactRefusedError if it stands still, or if its stiffness is uncertain.
    """
    if not np.ptp(record.eta_m):
        raise refused(RefusalCode.STANDS_STILL)
    (estimate,) = fit_joint(record, nominal_laws, np.zeros((1, 2), dtype=bool))
    check_certain(estimate, record.drift is not None)
    return Outcomes({name: estimate}, {})


def _present_stops(
    nominal_law: Float[np.ndarray, "4"], record: ContactRecord, is_touched: Bool[np.ndarray, "2"]
) -> Bool[np.ndarray, "2"]:
    """Sides with a stop. A nominal clearance far beyond the motion says that there is none, and that the force there is
    ringing.

    Raises ContactRefusedError if one side certainly has none (null in rig.json) and the zero of the relative
    displacement is unknown: half the total play would be no clearance.
    """
    if not record.sides_known and np.any(nominal_law[:2] >= ABSENT_STOP_M):
        raise refused(RefusalCode.ONE_STOP_TOUCHED)
    is_present = is_touched & (nominal_law[:2] < ABSENT_STOP_RATIO * np.max(np.abs(record.eta_m)))
    return is_present if is_present.any() and (is_present.all() or record.sides_known) else is_touched


def _outcomes_in_reach(
    names: Sequence[str],
    nominal_laws: NominalLaws,
    record: ContactRecord,
    is_touched: Bool[np.ndarray, "2"],
    eta_reach_m: Float[np.ndarray, "2"],
    are_springs: Bool[np.ndarray, " contacts"],
) -> Outcomes:
    """Outcomes of several contacts by one fit, or one refusal for all. A contact with a nominal clearance beyond the
    reach of the motion is left out as not reached if the record does not determine it."""
    may_touch = (nominal_laws[:, :2] <= UNTOUCHED_STOP_RATIO * eta_reach_m) & is_touched & ~are_springs[:, None]
    first_refusal: Refusal | None = None
    for reach_ratio in (UNTOUCHED_STOP_RATIO, 1.0):
        is_reached = np.any((nominal_laws[:, :2] <= reach_ratio * eta_reach_m) & is_touched, axis=1) | are_springs
        reached_names = list(compress(names, is_reached))
        names_and_laws = zip(compress(names, ~is_reached), nominal_laws[~is_reached], strict=True)
        unreached_outcomes = Outcomes(
            {}, {name: _not_reached_refusal(law, eta_reach_m) for name, law in names_and_laws}
        )
        try:
            estimates = _checked_joint_estimates(nominal_laws[is_reached], may_touch[is_reached], record)
        except ContactRefusedError as error:
            first_refusal = first_refusal or _not_separable_if_no_law(error.refusal)
            outcomes = unreached_outcomes | Outcomes.refused(reached_names, first_refusal)
        else:
            return unreached_outcomes | Outcomes(dict(zip(reached_names, estimates, strict=True)), {})
    return outcomes


def _not_separable_if_no_law(refusal: Refusal) -> Refusal:
    """Refusal of several contacts: if their closures determine no law, they are not separable."""
    return refused(RefusalCode.NOT_SEPARABLE).refusal if refusal.code == RefusalCode.NO_LAW else refusal


def _checked_joint_estimates(
    nominal_laws: NominalLaws, touched: Bool[np.ndarray, "contacts 2"], record: ContactRecord
) -> tuple[JointEstimate, ...]:
    """Estimates by one fit; raises ContactRefusedError unless it determines all contacts."""
    if not (np.all(touched) or record.sides_known or not np.all(touched.any(axis=1))):
        raise refused(RefusalCode.ONE_STOP_TOUCHED)
    estimates = fit_joint(record, nominal_laws, touched)
    try:
        for estimate in estimates:
            check_certain(estimate, record.drift is not None)
    except ContactRefusedError:
        if len(estimates) == 1:
            raise
        raise refused(RefusalCode.NOT_SEPARABLE) from None
    return _estimates_matched_to_nominal(estimates, nominal_laws)


def _estimates_matched_to_nominal(
    estimates: tuple[JointEstimate, ...], nominal_laws: NominalLaws
) -> tuple[JointEstimate, ...]:
    """Estimates in the order of the contacts: the assignment nearest to their nominal clearances and stiffnesses.

    Raises ContactRefusedError if another assignment is nearly as likely.
    """

    def square_distance(estimate: JointEstimate, law: Float[np.ndarray, "4"]) -> float:
        estimated_values = [estimate.clearance_m, estimate.stiffness_n_per_m]
        nominal_values = [estimate.clearance_gradient @ law, STIFFNESS_GRADIENT @ law]
        log_values = np.log(np.maximum([estimated_values, nominal_values], LEAST_COMPARED_VALUE))
        deviations = (log_values[0] - log_values[1]) / np.log1p(NOMINAL_SPREAD)
        return float(deviations @ deviations)

    touched_sides = [estimate.touched for estimate in estimates]
    assignments = [
        (sum(map(square_distance, assignment, nominal_laws)), assignment)
        for assignment in permutations(estimates)
        if [estimate.touched for estimate in assignment] == touched_sides
    ]
    (least_distance, nearest_estimates), *other_assignments = sorted(assignments, key=itemgetter(0))
    if other_assignments and other_assignments[0][0] - least_distance < EXCHANGE_DISTANCE**2:
        raise refused(RefusalCode.INTERCHANGEABLE)
    return nearest_estimates


def _not_reached_refusal(nominal_law: Float[np.ndarray, "4"], eta_reach_m: Float[np.ndarray, "2"]) -> Refusal:
    stop_mm, reach_mm = 1e3 * float(min(nominal_law[:2])), 1e3 * float(eta_reach_m.max())
    return refused(RefusalCode.NOT_REACHED, stop_mm=stop_mm, reach_mm=reach_mm).refusal
