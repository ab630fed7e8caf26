"""What a record tells of the contacts between the same two places, or why it does not."""

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float

from identify.contacts.first_pulls import contact_alone, first_pulls
from identify.contacts.joint import Joint, fit_joint
from identify.contacts.normal_equations import NO_LAW
from identify.contacts.progressive import NOT_TOLD, Believed, reach_m
from identify.contacts.start import LAW, ONE_SIDE, STIFFNESS, ContactRecord, touched_stops
from identify.linear.joined import Joined
from rig.errors import RigError
from rig.model.description import Rig

LOOSE = 0.1
"""An estimate whose standard error is a larger share of it is no answer."""
MOST = 3
"""So many contacts between the same places have fewer parameters than a record has parts for their scatter."""
OUT_OF_REACH = 2.0
"""A stop that is believed so many times as far away as the motion reaches is not touched, however wrong that is."""
OFF_BY, SURE, SMALLEST = np.array([0.2, 1.0]), 2.0, 1e-12
"""Shares by which clearance and stiffness in rig.json are off, as standard deviations; so many of them are sure."""
WHOSE = (
    "the record does not tell which of the knees is its own and which that of another contact between the same places: "
    "by rig.json, of which clearances are taken to be sure to 20 % and stiffnesses to a factor of two, they may as "
    "well be exchanged; use stops that differ more, or measure the force at one of them"
)

ContactFit = Joint | str
"""What is known of a contact, or why nothing is."""


def told_contacts(rig: Rig, same_place: Joined, seen: ContactRecord) -> tuple[ContactFit, ...]:
    """The joint estimate of each contact between two places, or the reason why there is none."""
    believed = _believed(rig, same_place)
    try:
        found = _told(believed, seen)
    except RigError as error:
        found = [str(error)] * len(believed)
    return tuple(
        fit if isinstance(fit, str) or sign > 0 else fit.reversed
        for fit, sign in zip(found, same_place.signs, strict=True)
    )


def _believed(rig: Rig, same_place: Joined) -> Believed:
    """In the direction of the first."""
    laws = [rig.contacts[j].law for j in same_place.members]
    rows = np.array([LAW.vector({name: getattr(law, name) for name in LAW.names}) for law in laws])
    return np.array([row if sign > 0 else row[[1, 0, 2, 3]] for row, sign in zip(rows, same_place.signs, strict=True)])


def _told(believed: Believed, seen: ContactRecord) -> Sequence[ContactFit]:
    """Of several contacts, one that is believed beyond the reach of the motion counts as not reached where the record
    does not tell it; the others are told together, or none."""
    sides = np.array(touched_stops(contact_alone(seen, first_pulls(seen))))
    if len(believed) == 1:
        (fit,) = fit_joint(seen, believed, sides[None])
        return [_loose(fit) or fit]
    if len(believed) > MOST:
        raise RigError(
            f"{len(believed)} contacts stand between the same places, of which a record tells {MOST} at most; describe "
            "them as fewer"
        )
    reach = np.maximum(reach_m(seen), believed[:, :2].min(axis=0))  # the nearest is touched, whatever is believed
    why = ""
    for far in (OUT_OF_REACH, 1.0):
        inside = np.any((believed[:, :2] <= far * reach) & sides, axis=1)
        try:
            fits = _together(believed[inside], (believed[:, :2] <= OUT_OF_REACH * reach)[inside] & sides, seen)
        except RigError as error:
            why = why or (NOT_TOLD if str(error) == NO_LAW else str(error))
            continue
        told = iter(fits)
        return [next(told) if one else _not_reached(law, reach) for one, law in zip(inside, believed, strict=True)]
    return [why if one else _not_reached(law, reach) for one, law in zip(inside, believed, strict=True)]


def _together(believed: Believed, touched: Bool[np.ndarray, "contacts 2"], seen: ContactRecord) -> tuple[Joint, ...]:
    """Raises RigError if the fit does not tell all contacts."""
    if not (np.all(touched) or seen.sides_known):
        raise RigError(ONE_SIDE)
    fits = fit_joint(seen, believed, touched)
    for why in map(_loose, fits):
        if why:
            raise RigError(why if len(fits) == 1 else NOT_TOLD)
    return _assigned(fits, believed)


def _assigned(fits: tuple[Joint, ...], believed: Believed) -> tuple[Joint, ...]:
    """To each contact the knee that comes nearest to what is believed of it, among those that touch on its sides.

    Raises RigError if they may as well be exchanged.
    """

    def off(fit: Joint, law: Float[np.ndarray, "4"]) -> float:
        pairs = np.array([(fit.clearance_m, fit.clearance @ law), (fit.stiffness_n_per_m, STIFFNESS @ law)])
        shares = np.log(np.maximum(pairs, SMALLEST)) @ [1, -1] / np.log1p(OFF_BY)
        return float(shares @ shares)

    ways = [
        (sum(off(fit, law) for fit, law in zip(way, believed, strict=True)), way)
        for way in permutations(fits)
        if all(one.touched == other.touched for one, other in zip(way, fits, strict=True))
    ]
    (least, best), *others = sorted(ways, key=lambda one: one[0])
    if others and others[0][0] - least < SURE**2:
        raise RigError(WHOSE)
    return best


def _loose(found: Joint) -> str:
    """Why it is no answer, if it is none."""
    for what, value, error_of in (
        ("clearance", found.clearance_m, found.clearance_error_m),
        ("stiffness", found.stiffness_n_per_m, found.error(STIFFNESS)),
    ):
        if not error_of < LOOSE * value:
            share = 100 * error_of / max(value, 1e-12)
            return f"its {what} is uncertain by {min(share, 100):.0f} % or more; record longer or change the force"
    return ""


def _not_reached(law: Float[np.ndarray, "4"], reach: Float[np.ndarray, "2"]) -> str:
    return (
        f"its stops, by rig.json {1e3 * min(law[:2]):.3g} mm away, are not reached: the relative displacement goes to "
        f"{1e3 * reach.max():.3g} mm; excite the rig more strongly"
    )
