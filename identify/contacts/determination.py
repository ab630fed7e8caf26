"""Second stage: what a record determines of each contact, or why it does not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float

from identify.contacts.contact_record import LAW, STIFFNESS, Believed, ContactRecord, touched_stops
from identify.contacts.initial_guess import contact_alone, first_pulls, reach_m
from identify.contacts.joint_fit import JointEstimate, fit_joint
from identify.contacts.law_form import FormName
from identify.contacts.refusals import ContactRefusedError, Refusal, RefusalCode, refused
from identify.contacts.separation import Separation
from identify.linear.joined import Joined
from identify.signals.refit import refit_until_settled
from rig.model.description import Rig

UNCERTAIN_SHARE = 0.1
"""An estimate whose standard error is a larger share of it is no answer."""
MOST_CONTACTS = 3
"""So many contacts between the same places have fewer parameters than a record has parts for their scatter."""
OUT_OF_REACH = 2.0
"""A stop that is believed so many times as far away as the motion reaches is not touched, however wrong that is."""
NOT_THERE = 10.0
"""A stop that is believed so many times as far away as the motion goes is not there."""
OFF_BY, SURE, SMALLEST = np.array([0.2, 1.0]), 2.0, 1e-12
"""Shares by which clearance and stiffness in rig.json are off, as standard deviations; so many of them are sure."""
ROUNDS = 3
"""Of the fits of contacts whose slow motions are coupled: a coupling is a small share of the forces."""


@dataclass(frozen=True)
class Outcomes:
    """Every contact by its name: the joint estimate where the record determines it, else the refusal."""

    estimates: Mapping[str, JointEstimate]
    refusals: Mapping[str, Refusal]

    @staticmethod
    def refused(names: Sequence[str], refusal: Refusal) -> "Outcomes":
        """All of them, for one reason."""
        return Outcomes({}, dict.fromkeys(names, refusal))

    def beside(self, others: "Outcomes") -> "Outcomes":
        """Determination with those of further contacts."""
        return Outcomes({**self.estimates, **others.estimates}, {**self.refusals, **others.refusals})


NOTHING = Outcomes({}, {})


def determine(separation: Separation, forms: Sequence[FormName] = ()) -> Outcomes:
    """Determination of every contact, each force by itself; where springs couple slow motions, again with the others.

    Beside the dead zone these forms of a law are tried.
    """
    rig, records, places = separation.rig, separation.records, separation.same_place
    slow_n_per_m = separation.forces.slow_n_per_m
    others = slow_n_per_m - np.diag(np.diag(slow_n_per_m))

    def refit(outcomes: Outcomes, forms: Sequence[FormName] = ()) -> Outcomes:
        slow_m = np.array(
            [_slow_m(rig, place, record, outcomes) for place, record in zip(places, records, strict=True)]
        )
        return together(
            [replace(r, force_n=r.force_n - more) for r, more in zip(records, others @ slow_m, strict=True)], forms
        )

    def together(records: Sequence[ContactRecord], forms: Sequence[FormName]) -> Outcomes:
        found = NOTHING
        for place, record in zip(places, records, strict=True):
            found = found.beside(determine_place(rig, place, record, forms))
        return found

    if not np.any(others):
        return together(records, forms)
    settled = refit_until_settled(together(records, ()), refit, rounds=ROUNDS)
    return refit(settled, forms) if forms else settled


def _slow_m(rig: Rig, place: Joined, record: ContactRecord, outcomes: Outcomes) -> Float[np.ndarray, " fewer"]:
    """The slow relative displacement of a pair of places by the estimate there; zero if there is none."""
    slow_m = np.zeros(len(record.force_n))
    for j, sign in zip(place.members, place.signs, strict=True):
        estimate = outcomes.estimates.get(rig.contacts[j].name)
        if estimate is not None:
            whole = sign * estimate.drift_m + estimate.pulls[record.moving] @ record.nuisance_m
            slow_m[:] = whole[:: record.factor][: slow_m.size]
    return slow_m


def determine_place(rig: Rig, place: Joined, record: ContactRecord, forms: Sequence[FormName] = ()) -> Outcomes:
    """Determination of the contacts between two places."""
    names = [rig.contacts[j].name for j in place.members]
    try:
        outcomes = _determined(names, _believed(rig, place), record, forms)
    except ContactRefusedError as error:
        return Outcomes.refused(names, error.refusal)
    signs = dict(zip(names, place.signs, strict=True))
    turned = {name: one if signs[name] > 0 else one.reversed for name, one in outcomes.estimates.items()}
    return replace(outcomes, estimates=turned)


def _believed(rig: Rig, place: Joined) -> Believed:
    """Nominal contacts in the direction of the first."""
    laws = [rig.contacts[j].law for j in place.members]
    rows = np.array([LAW.vector({name: getattr(law, name) for name in LAW.names}) for law in laws])
    return np.array([row if sign > 0 else row[[1, 0, 2, 3]] for row, sign in zip(rows, place.signs, strict=True)])


def _determined(names: Sequence[str], believed: Believed, record: ContactRecord, forms: Sequence[FormName]) -> Outcomes:
    """Estimates of one contact, or of several that share a relative displacement, in the direction of the first.

    Raises ContactRefusedError if none is determined, for one reason.
    """
    sides = np.array(touched_stops(contact_alone(record, first_pulls(record))))
    if len(names) == 1:
        (estimate,) = fit_joint(record, believed, _there(believed[0], record, sides)[None], forms)
        _check_certain(estimate)
        return Outcomes({names[0]: estimate}, {})
    if len(names) > MOST_CONTACTS:
        raise refused(RefusalCode.TOO_MANY_CONTACTS, contacts=len(names), at_most=MOST_CONTACTS)
    reach = np.maximum(reach_m(record), believed[:, :2].min(axis=0))  # the nearest is touched, whatever is believed
    return _those_in_reach(names, believed, record, sides, reach)


def _there(
    believed: Float[np.ndarray, "4"], record: ContactRecord, sides: Bool[np.ndarray, "2"]
) -> Bool[np.ndarray, "2"]:
    """The sides on which the motion may touch: not a stop that is described far away to say that there is none, whose
    force is ringing."""
    there = sides & (believed[:2] < NOT_THERE * np.max(np.abs(record.eta_m)))
    return there if there.any() and (there.all() or record.sides_known) else sides


def _those_in_reach(
    names: Sequence[str],
    believed: Believed,
    record: ContactRecord,
    sides: Bool[np.ndarray, "2"],
    reach: Float[np.ndarray, "2"],
) -> Outcomes:
    """One that is believed beyond the reach of the motion counts as not reached where the record does not determine it;
    the others are determined together, or none."""
    touched = (believed[:, :2] <= OUT_OF_REACH * reach) & sides
    first: Refusal | None = None
    for far in (OUT_OF_REACH, 1.0):
        inside = np.any((believed[:, :2] <= far * reach) & sides, axis=1)
        near = [name for name, within in zip(names, inside, strict=True) if within]
        outside = Outcomes(
            {},
            {
                name: _not_reached(law, reach)
                for name, within, law in zip(names, inside, believed, strict=True)
                if not within
            },
        )
        try:
            estimates = _together(believed[inside], touched[inside], record)
        except ContactRefusedError as error:
            first = first or _of_several(error.refusal)
            refusals = outside.beside(Outcomes.refused(near, first))
            continue
        return outside.beside(Outcomes(dict(zip(near, estimates, strict=True)), {}))
    return refusals


def _of_several(refusal: Refusal) -> Refusal:
    """Refusal of several contacts: closures that tell no law of them mean that they cannot be told apart."""
    return refused(RefusalCode.NOT_SEPARABLE).refusal if refusal.code == RefusalCode.NO_LAW else refusal


def _together(
    believed: Believed, touched: Bool[np.ndarray, "contacts 2"], record: ContactRecord
) -> tuple[JointEstimate, ...]:
    """Raises ContactRefusedError if the fit does not determine all contacts."""
    if not (np.all(touched) or record.sides_known):
        raise refused(RefusalCode.ONE_STOP_TOUCHED)
    estimates = fit_joint(record, believed, touched)
    try:
        for estimate in estimates:
            _check_certain(estimate)
    except ContactRefusedError:
        if len(estimates) == 1:
            raise
        raise refused(RefusalCode.NOT_SEPARABLE) from None
    return _assigned(estimates, believed)


def _assigned(estimates: tuple[JointEstimate, ...], believed: Believed) -> tuple[JointEstimate, ...]:
    """Knee of each contact: the nearest to its nominal clearance among those on the sides that it touches.

    Raises ContactRefusedError if they may as well be exchanged.
    """

    def off(estimate: JointEstimate, law: Float[np.ndarray, "4"]) -> float:
        pairs = np.array(
            [(estimate.clearance_m, estimate.clearance @ law), (estimate.stiffness_n_per_m, STIFFNESS @ law)]
        )
        shares = np.log(np.maximum(pairs, SMALLEST)) @ [1, -1] / np.log1p(OFF_BY)
        return float(shares @ shares)

    ways = [
        (sum(off(estimate, law) for estimate, law in zip(way, believed, strict=True)), way)
        for way in permutations(estimates)
        if all(one.touched == other.touched for one, other in zip(way, estimates, strict=True))
    ]
    (least, best), *others = sorted(ways, key=lambda one: one[0])
    if others and others[0][0] - least < SURE**2:
        raise refused(RefusalCode.INTERCHANGEABLE)
    return best


def _check_certain(estimate: JointEstimate) -> None:
    """Raises ContactRefusedError if, were its law right, its clearance or its stiffness were too uncertain."""
    if_right = replace(estimate, covariance=estimate.covariance - estimate.of_misfit)
    for quantity, value, error_of in (
        ("clearance", estimate.clearance_m, if_right.clearance_error_m),
        ("stiffness", estimate.stiffness_n_per_m, if_right.error(STIFFNESS)),
    ):
        if not error_of < UNCERTAIN_SHARE * value:
            percent = min(100 * error_of / max(value, 1e-12), 100)
            raise refused(RefusalCode.UNCERTAIN, quantity=quantity, uncertain_percent=percent)


def _not_reached(law: Float[np.ndarray, "4"], reach: Float[np.ndarray, "2"]) -> Refusal:
    stop_mm, reach_mm = 1e3 * float(min(law[:2])), 1e3 * float(reach.max())
    return refused(RefusalCode.NOT_REACHED, stop_mm=stop_mm, reach_mm=reach_mm).refusal
