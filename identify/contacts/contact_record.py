"""One contact as a record shows it: relative displacement, separated force, and what may be wrong with both."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from identify.contacts.refusals import RefusalCode, refused
from identify.signals.drift import Drift
from identify.signals.scores import COUNTED_HZ, quietest
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
DAMPING = LAW.vector({"damping_n_s_per_m": 1.0})
OFFSET = LAW.vector({"lower_clearance_m": -0.5, "upper_clearance_m": 0.5})
"""By how much the middle of the play lies off zero, m."""

Law = Float[np.ndarray, " laws"]
"""Values of its parameters; of several contacts one after the other."""
Believed = Float[np.ndarray, "contacts 4"]
"""Values of the parameters of `LAW` as rig.json has them."""
Touched = Bool[np.ndarray, "contacts 2"]
"""Of which contacts the record tells the lower and the upper stop."""

CLEAR_SHARE = 0.1
"""A contact counts as clearly closed where its force exceeds this share of the force's 99.5 % quantile."""
ABOVE_QUIET, ABOVE_NOISE = 8.0, 5.0
"""... and so many standard deviations of the force in the quiet seconds before the excitation, and of what the sensors'
noise makes of it, which is no more than its quietest parts."""
LEAST_CLOSED = 1e-3
"""A stop that is clearly touched for a smaller share of the record is not told by it."""


@dataclass(frozen=True)
class ContactRecord:
    """One contact as a record shows it: relative displacement and velocity (m, m/s) and the separated force (N).

    The force has been low-passed and is that of every `factor`-th sample; quiet_n is its standard deviation where
    there is no contact, noise_n that of what the sensors' noise makes of it, unmodelled the share of it that no law
    explains. drift is None where nothing was lost. One standard deviation of each nuisance parameter adds its row of
    nuisance_n to the force; those that are `moving` add theirs of nuisance_m to the motion. Shares of the noise of the
    force and of the motion are in these rows (noise_in_n and noise_in_m). Those that are `initial` say how a record
    that does not begin at rest began.
    """

    eta_m: Float[np.ndarray, " samples"]
    velocity_m_per_s: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    force_n: Float[np.ndarray, " fewer"]
    factor: int
    quiet_n: float
    noise_n: float
    unmodelled: float
    drift: Drift | None
    nuisance_n: Float[np.ndarray, "nuisances fewer"]
    noise_in_n: Float[np.ndarray, " nuisances"]
    moving: Bool[np.ndarray, " nuisances"]
    noise_in_m: Float[np.ndarray, " some"]
    nuisance_m: Float[np.ndarray, "some samples"]
    initial: Bool[np.ndarray, " nuisances"]

    def rate_of(self, moved_m: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        """Rate of the relative displacement by differences, m/s."""
        return np.asarray(np.gradient(moved_m, 1 / self.sample_rate_hz))

    @property
    def sample_ratio(self) -> float:
        """Weight of the tolerances over that of a sample, as errors of a model last."""
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


def clearly_closed(record: ContactRecord, share: float = CLEAR_SHARE) -> Bool[np.ndarray, " fewer"]:
    """Mask of the samples at which the contact is clearly closed."""
    size = np.abs(record.force_n)
    noise_n = min(record.noise_n, float(quietest(record.force_n)))
    return size > max(share * float(np.quantile(size, 0.995)), ABOVE_QUIET * record.quiet_n, ABOVE_NOISE * noise_n)


def touched_stops(record: ContactRecord) -> tuple[bool, bool]:
    """Flags: the lower stop is clearly touched; the upper one is.

    Raises ContactRefusedError if the relative displacement stands still, if neither is, or one alone where nothing
    shows how far it stands from the rest position.
    """
    closed = clearly_closed(record)
    lower, upper = (bool(np.mean(closed & side) >= LEAST_CLOSED) for side in (record.force_n < 0, record.force_n > 0))
    if not np.ptp(record.eta_m):
        raise refused(RefusalCode.STANDS_STILL)
    if not (lower or upper):
        raise refused(RefusalCode.HARDLY_CLOSES)
    if not ((lower and upper) or record.sides_known):
        raise refused(RefusalCode.ONE_STOP_TOUCHED)
    return lower, upper
