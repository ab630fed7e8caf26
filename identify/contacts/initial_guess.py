"""First guesses of a contact's law, of the drift of its relative displacement, and of the motion at the record's start.

A single contact is taken from the samples at which it is clearly closed. The sum of several dead zones that share a
relative displacement has a knee at each stop: a soft bumper, and a hard stop behind it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import spsolve

from identify.contacts.contact_record import (
    CLEAR_SHARE,
    LAW,
    Believed,
    ContactRecord,
    Law,
    Touched,
    clearly_closed,
    touched_stops,
)
from identify.contacts.law_form import by_stiffness_and_damping
from identify.contacts.linearization import held_n
from identify.contacts.refusals import RefusalCode, refused
from identify.signals.drift import Spline, spline
from identify.signals.refit import refit_until_settled

Start = tuple[Law, Float[np.ndarray, " knots"]]
"""A law, and the drift's knots."""
Sides = tuple[bool, bool]
"""Whether the lower stop is touched, and the upper one."""
STAGES = ((0.5, 30.0), (0.2, 30.0), (0.1, 10.0), (0.03, 3.0), (0.01, 1.0))
"""Where a contact is clearly closed, its displacement is known to a share of its own standard deviation, and the
drift's curvature so many times better than measured: in turn, so that at first no drift can follow the closures."""
OUTSIDE = 3.0
"""So many of those shares off, a force of either sign that rings weighs little in the next turn (Geman, McClure)."""
BEYOND = 1.1
"""A stop that is never touched is put so many times the largest relative displacement away."""
KNEES = 12
"""So many forces, evenly spread over their logarithm, are tried for each knee."""
SMALL_SHARE = 0.01
"""A soft stop counts as closed where the force exceeds this share of its 99.5 % quantile."""
STARTS = 4
"""So many laws are fitted to the end."""
ROUNDS = 30
LEAST = 1e-3
"""Deviations below this share of the median one weigh no more."""


def regressed(record: ContactRecord, curve: Spline, sides: Sides | None = None) -> Start:
    """Regression where the contact is clearly closed, eta + b = +-clearance + force / k: linear in clearance, 1/k and
    b; by the stops on these sides, or those that are touched.

    A spring s on the drift adds s b to the measured force. Then b is left to Gauss-Newton at first; if that finds no
    law, as where a record begins in motion, (1 + s / k) b is solved for.

    Raises ContactRefusedError as `touched_stops` does, and if no force grows with the relative displacement.
    """
    touched = touched_stops(record) if sides is None else sides
    for with_drift in (False, True) if record.spring_n_per_m else (True,):
        *knots, clearance, softness = closed_fit(record, curve, with_drift, sides=touched)
        if np.isfinite(clearance) and softness > 0:
            far = BEYOND * float(np.max(np.abs(record.eta_m)))
            lower, upper = (max(clearance, 0.0) if one else far for one in touched)
            shared = 1 + record.spring_n_per_m * softness * with_drift
            return np.array([lower, upper, 1 / softness, 0.0]), np.array(knots) / shared
    raise refused(RefusalCode.NO_STIFFNESS)


def closed_fit(
    record: ContactRecord,
    curve: Spline,
    with_drift: bool,
    clear_share: float = CLEAR_SHARE,
    beyond_n: Sequence[Float[np.ndarray, " fewer"]] = (),
    sides: Sides = (True, True),
) -> Float[np.ndarray, " unknowns"]:
    """The drift's knots, the clearance, one over the stiffness, and what less of it the forces beyond knees ask for."""
    size = np.abs(record.force_n)
    at_force = curve.value[:: record.factor][: size.size]
    force = record.force_n
    closed = clearly_closed(record, clear_share) & np.where(force < 0, *sides)
    if not with_drift:
        at_force = csr_matrix(at_force.shape)
    eta = record.eta_m[:: record.factor][: size.size][closed]
    side = np.sign(force)
    of_law = np.stack([side, force, *(-side * beyond for beyond in beyond_n)], axis=1)[closed]
    columns = hstack([-at_force[closed], of_law]).tocsr()
    bent = hstack([curve.curvature, csr_matrix((curve.target.size, of_law.shape[1]))])
    weights = np.ones(eta.size)
    for share, stiffer in STAGES:
        fuzz_m = share * float(np.std(eta))
        rows = vstack([diags(weights / fuzz_m) @ columns, stiffer * bent]).tocsc()
        target = np.concatenate([weights * eta / fuzz_m, stiffer * curve.target])
        ridge = diags(np.r_[np.full(curve.knots, 1e-12 * (rows.T @ rows).diagonal().max()), np.zeros(of_law.shape[1])])
        found = spsolve((rows.T @ rows + ridge).tocsc(), rows.T @ target)
        weights = 1 / (1 + ((eta - columns @ found) / (OUTSIDE * fuzz_m)) ** 2)
    return np.asarray(found)


def reach_m(record: ContactRecord) -> Float[np.ndarray, "2"]:
    """Reach of the relative displacement to either side, m.

    Raises ContactRefusedError as `regressed` does.
    """
    curve = spline(record.eta_m.size, record.sample_rate_hz, record.drift)
    eta = record.eta_m + curve.value @ regressed(record, curve)[1]
    return np.array([-eta.min(), eta.max()])


def starts(record: ContactRecord, curve: Spline, believed: Believed, touched: Touched) -> list[Start]:
    """Laws, each with and without the drift that its regression finds.

    Of several contacts those that leave least of the clearances that are believed, and of those by which, for some
    forces F_m at the knees, where the contact is closed

        eta + b = +-(c_1 + |f| / k_1 - sum_m (1 / K_m - 1 / K_m+1) max(|f| - F_m, 0)),    K_m = k_1 + ... + k_m
    """
    sides = np.any(touched, axis=0)
    law, knots = regressed(record, curve, (bool(sides[0]), bool(sides[1])))
    found = [(law, knots)]
    if len(believed) > 1:
        far = BEYOND * float(np.max(np.abs(record.eta_m)))
        believed = np.column_stack([np.where(touched, believed[:, :2], far), believed[:, 2:]])
        found = [(believed.ravel(), knots), *_by_knees(record, curve, believed, touched)]
    found += [(law, np.zeros_like(knots)) for law, knots in found if curve.knots]
    if len(believed) == 1:
        return found
    ranked = sorted((_by_least_squares(record, curve, *start) for start in found), key=lambda one: one[0])
    return [start for left, start in ranked[:STARTS] if np.isfinite(left)]


def _by_least_squares(
    record: ContactRecord, curve: Spline, law: Law, knots: Float[np.ndarray, " knots"]
) -> tuple[float, Start]:
    """Law with the stiffnesses and dampings that leave least of the force, and what they leave: infinite where one is
    not told, or a stiffness is negative.
    """
    few, laws = slice(None, record.force_n.size * record.factor, record.factor), law.reshape(-1, len(LAW)).copy()
    eta, rate = (record.eta_m + curve.value @ knots)[few], (record.velocity_m_per_s + curve.rate @ knots)[few]
    columns = np.stack([row for one in laws for row in by_stiffness_and_damping(one, eta, rate)], axis=1)
    force = record.force_n - held_n(record, curve) @ knots
    found, _, rank, _ = np.linalg.lstsq(columns, force, rcond=None)
    laws[:, 2:] = found.reshape(-1, 2)
    told = rank == columns.shape[1] and np.all(laws[:, 2] > 0)
    return float(np.sum((force - columns @ found) ** 2)) if told else np.inf, (laws.ravel(), knots)


def _by_knees(record: ContactRecord, curve: Spline, believed: Believed, touched: Touched) -> Iterator[Start]:
    size = np.abs(record.force_n)
    sides, most = touched.sum(axis=0), float(np.quantile(size, 0.9995))
    tried = np.geomspace(size[clearly_closed(record, SMALL_SHARE)].min(), most, KNEES + 2)[1:-1]
    for forces in combinations(tried, int(sides.max()) - 1):
        beyond = [
            np.maximum(size - force, 0.0) * (np.where(record.force_n < 0, *sides) > m)
            for m, force in enumerate(forces, 1)
        ]
        for with_drift in (False, True) if record.spring_n_per_m else (True,):
            found = closed_fit(record, curve, with_drift, SMALL_SHARE, beyond)
            knots, (clearance, softness, *softer) = found[: curve.knots], found[curve.knots :].tolist()
            sums = 1 / (softness - np.cumsum([0.0, *softer]))
            if not (np.isfinite(clearance) and np.all(sums > 0) and np.all(np.diff(sums) > 0)):
                continue
            clearances = max(clearance, 0.0) + np.cumsum([0.0, *(np.diff([0.0, *forces]) / sums[:-1])])
            stiffnesses = np.diff([0.0, *sums])
            law = believed.copy()
            for side in range(2):
                mine = np.flatnonzero(touched[:, side])
                mine = mine[np.argsort(believed[mine, side], kind="stable")]
                law[mine, side], law[mine, 2] = clearances[: mine.size], stiffnesses[: mine.size]
            shared = 1 + record.spring_n_per_m * softness * with_drift
            yield law.ravel(), knots / shared


def first_pulls(record: ContactRecord) -> Float[np.ndarray, " nuisances"]:
    """Beginning of a record in motion: what the modes' free motion from there adds to a contact's force may be
    many times the force.

    A contact is open for much of the time. So theta of

        force(t) = theta' nuisance_n(t) + contact force(t)

    is found by least absolute deviations, with the prior of one on each theta, by iteratively reweighted least squares;
    zero of all nuisance parameters that are not initial.
    """
    pulls = np.zeros(len(record.nuisance_n))
    if not np.any(record.initial):
        return pulls
    columns = record.nuisance_n[record.initial].astype(float)

    def reweighted(theta: Float[np.ndarray, " initial"]) -> Float[np.ndarray, " initial"]:
        size = np.abs(record.force_n - theta @ columns)
        middle = max(float(np.median(size)), 1e-300)
        weighed = columns / np.maximum(size, LEAST * middle)
        prior = np.eye(len(columns)) / middle
        return np.linalg.solve(weighed @ columns.T + prior, weighed @ record.force_n)

    pulls[record.initial] = refit_until_settled(pulls[record.initial], reweighted, rounds=ROUNDS)
    return pulls


def contact_alone(record: ContactRecord, pulls: Float[np.ndarray, " nuisances"]) -> ContactRecord:
    """Contact without what a first guess adds to its force."""
    return replace(record, force_n=record.force_n - pulls @ record.nuisance_n) if pulls.any() else record
