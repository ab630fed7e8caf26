"""First guesses of laws for one separated force: of a single contact, or of several that share a relative displacement.

The sum of several dead zones has a knee at each stop: a soft bumper, and a hard stop behind it.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from identify.contacts.linearised import by_stiffness_and_damping, held_n
from identify.contacts.start import (
    BEYOND,
    LAW,
    LEAST_CLOSED,
    ContactRecord,
    Law,
    Start,
    clearly_closed,
    closed_fit,
    regressed,
)
from identify.pages.wording import COVERED
from identify.signals.drift import Spline, spline
from rig.errors import RigError

KNEES = 12
"""So many forces, evenly spread over their logarithm, are tried for each knee."""
SMALL_SHARE = 0.01
"""A soft stop counts as closed where the force exceeds this share of its 99.5 % quantile."""
STARTS = 4
"""So many laws are fitted to the end."""
NOT_TOLD = (
    "its force and that of another contact between the same places cannot be told apart: their knees coincide, or not "
    "all of their stops are reached; excite the rig more strongly, use stops that differ more, or measure the force at "
    "one of them"
)

Believed = Float[np.ndarray, "contacts 4"]
"""Values of the parameters of `LAW` as rig.json has them."""
Touched = Bool[np.ndarray, "contacts 2"]
"""Of which contacts the record tells the lower and the upper stop."""


def reach_m(seen: ContactRecord) -> Float[np.ndarray, "2"]:
    """How far the relative displacement goes to either side.

    Raises RigError as `regressed` does.
    """
    curve = spline(seen.eta_m.size, seen.sample_rate_hz, seen.drift)
    eta = seen.eta_m + curve.value @ regressed(seen, curve)[1]
    return np.array([-eta.min(), eta.max()])


def starts(seen: ContactRecord, curve: Spline, believed: Believed, touched: Touched) -> list[Start]:
    """Laws, each with and without the drift that its regression finds.

    Of several contacts those that leave least of the clearances that are believed, and of those by which, for some
    forces F_m at the knees, where the contact is closed

        eta + b = +-(c_1 + |f| / k_1 - sum_m (1 / K_m - 1 / K_m+1) max(|f| - F_m, 0)),    K_m = k_1 + ... + k_m
    """
    law, knots = regressed(seen, curve)
    found = [(law, knots)]
    if len(believed) > 1:
        far = BEYOND * float(np.max(np.abs(seen.eta_m)))
        believed = np.column_stack([np.where(touched, believed[:, :2], far), believed[:, 2:]])
        found = [(believed.ravel(), knots), *_by_knees(seen, curve, believed, touched)]
    found += [(law, np.zeros_like(knots)) for law, knots in found if curve.knots]
    if len(believed) == 1:
        return found
    ranked = sorted((_by_least_squares(seen, curve, *start) for start in found), key=lambda one: one[0])
    return [start for left, start in ranked[:STARTS] if np.isfinite(left)]


def _by_least_squares(
    seen: ContactRecord, curve: Spline, law: Law, knots: Float[np.ndarray, " knots"]
) -> tuple[float, Start]:
    """With the stiffnesses and dampings that leave least of the force, and what they leave: infinite where one is not
    told, or a stiffness is negative."""
    few, laws = slice(None, seen.force_n.size * seen.factor, seen.factor), law.reshape(-1, len(LAW)).copy()
    eta, rate = (seen.eta_m + curve.value @ knots)[few], (seen.velocity_m_per_s + curve.rate @ knots)[few]
    columns = np.stack([row for one in laws for row in by_stiffness_and_damping(one, eta, rate)], axis=1)
    force = seen.force_n - held_n(seen, curve) @ knots
    found, _, rank, _ = np.linalg.lstsq(columns, force, rcond=None)
    laws[:, 2:] = found.reshape(-1, 2)
    told = rank == columns.shape[1] and np.all(laws[:, 2] > 0)
    return float(np.sum((force - columns @ found) ** 2)) if told else np.inf, (laws.ravel(), knots)


def _by_knees(seen: ContactRecord, curve: Spline, believed: Believed, touched: Touched) -> Iterator[Start]:
    size = np.abs(seen.force_n)
    sides, most = touched.sum(axis=0), float(np.quantile(size, 0.9995))
    tried = np.geomspace(size[clearly_closed(seen, SMALL_SHARE)].min(), most, KNEES + 2)[1:-1]
    for forces in combinations(tried, int(sides.max()) - 1):
        beyond = [
            np.maximum(size - force, 0.0) * (np.where(seen.force_n < 0, *sides) > m)
            for m, force in enumerate(forces, 1)
        ]
        for with_drift in (False, True) if seen.spring_n_per_m else (True,):
            found = closed_fit(seen, curve, with_drift, SMALL_SHARE, beyond)
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
            shared = 1 + seen.spring_n_per_m * softness * with_drift
            yield law.ravel(), knots / shared


def check_told(
    law: Law, covariance: Float[np.ndarray, "laws laws"], touched: Touched, eta_m: Float[np.ndarray, " samples"]
) -> None:
    """Raises RigError if a stop is hardly ever reached, or two knees are not apart by more than their 95 % interval."""
    laws = law.reshape(-1, len(LAW))
    for side, sign in enumerate((-1, 1)):
        mine = np.flatnonzero(touched[:, side])
        if any(np.mean(sign * eta_m > laws[i, side]) < LEAST_CLOSED for i in mine):
            raise RigError(NOT_TOLD)
        for i, j in combinations(mine, 2):
            apart = np.zeros_like(law)
            apart[[len(LAW) * i + side, len(LAW) * j + side]] = 1, -1
            if abs(apart @ law) < COVERED * np.sqrt(apart @ covariance @ apart):
                raise RigError(NOT_TOLD)
