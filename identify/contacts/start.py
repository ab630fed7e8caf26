"""One contact as a record shows it, and a first guess of its law: by the samples at which it is clearly closed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import spsolve

from identify.signals.drift import Drift, Spline
from identify.signals.scores import COUNTED_HZ
from rig.errors import RigError
from rig.model.parameters import Parameter, ParameterSet

LAW = ParameterSet(
    (
        Parameter("m", 0.0, np.inf, name="lower_clearance_m"),
        Parameter("m", 0.0, np.inf, name="upper_clearance_m"),
        Parameter("N/m", 0.0, np.inf, name="stiffness_n_per_m"),
        Parameter("N s/m", -np.inf, np.inf, name="damping_n_s_per_m"),
    )
)
"""What is estimated of a `DeadZone`; its damping may have any sign."""
STIFFNESS = LAW.vector({"stiffness_n_per_m": 1.0})
"""The stiffness as a linear function of the parameters."""

Law = Float[np.ndarray, " laws"]
"""Values of its parameters; of several contacts one after the other."""
Start = tuple[Law, Float[np.ndarray, " knots"]]
"""A law, and the drift's knots."""
CLEAR_SHARE = 0.1
"""A contact counts as clearly closed where its force exceeds this share of the force's 99.5 % quantile."""
ABOVE_NOISE = 8.0
"""... and this many standard deviations of the force in the quiet seconds before the excitation."""
STAGES = ((0.5, 30.0), (0.2, 30.0), (0.1, 10.0), (0.03, 3.0), (0.01, 1.0))
"""Where a contact is clearly closed, its displacement is known to a share of its own standard deviation, and the
drift's curvature so many times better than measured: in turn, so that at first no drift can follow the closures."""
OUTSIDE = 3.0
"""So many of those shares off, a force of either sign that rings weighs little in the next turn (Geman, McClure)."""
BEYOND = 1.1
"""A stop that is never touched is put so many times the largest relative displacement away."""
LEAST_CLOSED = 1e-3
"""A stop that is clearly touched for a smaller share of the record is not told by it."""

ONE_SIDE = (
    "only one of its stops is ever touched, so its play cannot be told; excite the rig more strongly, or measure "
    "displacements"
)


@dataclass(frozen=True)
class ContactRecord:
    """One contact as seen: relative displacement and velocity (m, m/s) and the separated force (N).

    The force has been low-passed and is that of every `factor`-th sample; quiet_n is its standard deviation where there
    is no contact, unmodelled the share of it that no law explains. drift is None where nothing was lost. One standard
    deviation of each nuisance parameter adds its row of nuisance_n to the force; those that are `moving` add theirs of
    nuisance_m to the motion. Shares of the noise of the force and of the motion are in these rows (noise_in_n and
    noise_in_m). Those that are `initial` say how a record that does not begin at rest began.
    """

    eta_m: Float[np.ndarray, " samples"]
    velocity_m_per_s: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    force_n: Float[np.ndarray, " fewer"]
    factor: int
    quiet_n: float
    unmodelled: float
    drift: Drift | None
    nuisance_n: Float[np.ndarray, "nuisances fewer"]
    noise_in_n: Float[np.ndarray, " nuisances"]
    moving: Bool[np.ndarray, " nuisances"]
    noise_in_m: Float[np.ndarray, " some"]
    nuisance_m: Float[np.ndarray, "some samples"]
    initial: Bool[np.ndarray, " nuisances"]

    def rate_of(self, moved_m: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        """By differences, m/s."""
        return np.asarray(np.gradient(moved_m, 1 / self.sample_rate_hz))

    @property
    def sample_ratio(self) -> float:
        """How much more the tolerances weigh than samples do, as errors of a model last."""
        return max(1.0, self.sample_rate_hz / self.factor / COUNTED_HZ)

    @property
    def spring_n_per_m(self) -> float:
        return 0.0 if self.drift is None else self.drift.spring_n_per_m

    @property
    def damper_n_s_per_m(self) -> float:
        return 0.0 if self.drift is None else self.drift.damper_n_s_per_m

    @property
    def sides_known(self) -> bool:
        return self.drift is None or self.drift.spring_n_per_m > 0


def clearly_closed(seen: ContactRecord, share: float = CLEAR_SHARE) -> Bool[np.ndarray, " fewer"]:
    """Where the contact is clearly closed."""
    size = np.abs(seen.force_n)
    return size > max(share * float(np.quantile(size, 0.995)), ABOVE_NOISE * seen.quiet_n)


def touched_stops(seen: ContactRecord) -> tuple[bool, bool]:
    """Whether the lower stop is clearly touched, and the upper one.

    Raises RigError if the relative displacement stands still, if neither is, or one alone where nothing shows how far
    it stands from the rest position.
    """
    closed = clearly_closed(seen)
    lower, upper = (bool(np.mean(closed & side) >= LEAST_CLOSED) for side in (seen.force_n < 0, seen.force_n > 0))
    if not np.ptp(seen.eta_m):
        raise RigError("its relative displacement stands still; look for a dead displacement sensor")
    if not (lower or upper):
        raise RigError("it hardly ever closes in this record; excite the rig more strongly")
    if not ((lower and upper) or seen.sides_known):
        raise RigError(ONE_SIDE)
    return lower, upper


def regressed(seen: ContactRecord, curve: Spline) -> Start:
    """Where the contact is clearly closed, eta + b = +-clearance + force / k: linear in clearance, 1/k and b.

    A spring s on the drift adds s b to the measured force. Then b is left to Gauss-Newton at first; if that finds no
    law, as where a record begins in motion, (1 + s / k) b is solved for.

    Raises RigError as `touched_stops` does, and if no force grows with the relative displacement.
    """
    touched = touched_stops(seen)
    for with_drift in (False, True) if seen.spring_n_per_m else (True,):
        *knots, clearance, softness = closed_fit(seen, curve, with_drift)
        if np.isfinite(clearance) and softness > 0:
            far = BEYOND * float(np.max(np.abs(seen.eta_m)))
            lower, upper = (max(clearance, 0.0) if one else far for one in touched)
            shared = 1 + seen.spring_n_per_m * softness * with_drift
            return np.array([lower, upper, 1 / softness, 0.0]), np.array(knots) / shared
    raise RigError("no force grows with this relative displacement; excite the rig more strongly, or check rig.json")


def closed_fit(
    seen: ContactRecord,
    curve: Spline,
    with_drift: bool,
    clear_share: float = CLEAR_SHARE,
    beyond_n: Sequence[Float[np.ndarray, " fewer"]] = (),
) -> Float[np.ndarray, " unknowns"]:
    """The drift's knots, the clearance, one over the stiffness, and what less of it the forces beyond knees ask for."""
    size = np.abs(seen.force_n)
    at_force = curve.value[:: seen.factor][: size.size]
    force = seen.force_n
    closed = clearly_closed(seen, clear_share)
    if not with_drift:
        at_force = csr_matrix(at_force.shape)
    eta = seen.eta_m[:: seen.factor][: size.size][closed]
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
