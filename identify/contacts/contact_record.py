"""Record of one contact: relative displacement, separated force, and the nuisance signals of both; closed samples."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_matrix

from identify.contacts.refusals import RefusalCode, refused
from identify.signals.drift import DriftPrior, DriftSpline
from identify.signals.scores import INDEPENDENT_RATE_HZ, quiet_interval_std

CLOSED_FORCE_SHARE = 0.1
"""A contact is clearly closed where its force exceeds this share of the force's 99.5 % quantile, ..."""
QUIET_DEVIATIONS, NOISE_DEVIATIONS = 8.0, 5.0
"""... so many standard deviations of the force in the quiet seconds before the excitation, and of the force that the
sensors' noise makes, which is at most that of the quietest parts."""
LEAST_CLOSED_SHARE = 1e-3
"""Share of the record for which a stop has to be clearly touched to be determined."""

Rows = TypeVar("Rows", np.ndarray, csr_matrix)


@dataclass(frozen=True)
class ContactRecord:
    """One contact in a record: relative displacement and velocity (m, m/s) and the separated force (N).

    The force is low-passed and sampled at every `decimation`-th sample. quiet_deviation_n is its standard deviation
    before the excitation, noise_n that of the sensors' noise in it, unmodelled_share the share of it that no law
    explains. drift is None where no slow motion was lost, and drift_spline then has no knots; eta_noise_m is the noise
    of the displacement where strain gauges gave its slow part, else zero. One standard deviation of each nuisance
    parameter adds its row of nuisance_n to the force; those with `shifts_eta` also add their row of nuisance_m to the
    displacement. force_noise_multiple and eta_noise_multiple are the multiples of the sensors' noise in these rows.
    `is_initial_state` marks the modes' initial states of a record that does not begin at rest.
    """

    eta_m: Float[np.ndarray, " samples"]
    velocity_m_per_s: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    force_n: Float[np.ndarray, " fewer"]
    decimation: int
    quiet_deviation_n: float
    noise_n: float
    unmodelled_share: float
    drift: DriftPrior | None
    drift_spline: DriftSpline
    nuisance_n: Float[np.ndarray, "nuisances fewer"]
    force_noise_multiple: Float[np.ndarray, " nuisances"]
    shifts_eta: Bool[np.ndarray, " nuisances"]
    eta_noise_multiple: Float[np.ndarray, " shifts_eta"]
    nuisance_m: Float[np.ndarray, "moving samples"]
    is_initial_state: Bool[np.ndarray, " nuisances"]
    eta_noise_m: float = 0.0

    def at_force_samples(self, signal: Rows) -> Rows:
        """Signal, or rows of a matrix, at the samples of the force."""
        return signal[:: self.decimation][: self.force_n.size]

    def velocity_of(self, displacement_m: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        """Time derivative by central differences, m/s."""
        return np.asarray(np.gradient(displacement_m, 1 / self.sample_rate_hz))

    @property
    def samples_per_error(self) -> float:
        """Weight of a tolerance over that of a sample: the samples per independent error of the model."""
        return max(1.0, self.sample_rate_hz / self.decimation / INDEPENDENT_RATE_HZ)

    @property
    def spring_n_per_m(self) -> float:
        return 0.0 if self.drift is None else self.drift.spring_n_per_m

    @property
    def damper_n_s_per_m(self) -> float:
        return 0.0 if self.drift is None else self.drift.damper_n_s_per_m

    @property
    def sides_known(self) -> bool:
        """True if the zero of the relative displacement is known, so that lower and upper clearance are told apart."""
        return self.drift is None or self.drift.spring_n_per_m > 0


def clearly_closed(record: ContactRecord, force_share: float = CLOSED_FORCE_SHARE) -> Bool[np.ndarray, " fewer"]:
    """Mask of the samples at which the contact is clearly closed."""
    force_size_n, noise_n = (
        np.abs(record.force_n),
        min(record.noise_n, float(quiet_interval_std(record.force_n))),
    )
    least_force_n = closed_threshold_n(force_size_n, force_share)
    return force_size_n > max(least_force_n, QUIET_DEVIATIONS * record.quiet_deviation_n, NOISE_DEVIATIONS * noise_n)


def closed_threshold_n(force_size_n: Float[np.ndarray, " fewer"], force_share: float = CLOSED_FORCE_SHARE) -> float:
    """Share of the large forces, N, that the force of a contact exceeds where it is clearly closed."""
    return force_share * float(np.quantile(force_size_n, 0.995))


def touched_stops(record: ContactRecord) -> tuple[bool, bool]:
    """(lower, upper): True where that stop is clearly touched.

    Raises ContactRefusedError if the relative displacement is constant, if neither stop is touched, or only one where
    the zero of the relative displacement is unknown.
    """
    is_closed = clearly_closed(record)
    is_lower_touched, is_upper_touched = (
        bool(np.mean(is_closed & is_on_side) >= LEAST_CLOSED_SHARE)
        for is_on_side in (record.force_n < 0, record.force_n > 0)
    )
    if not np.ptp(record.eta_m):
        raise refused(RefusalCode.STANDS_STILL)
    if not (is_lower_touched or is_upper_touched):
        raise refused(RefusalCode.HARDLY_CLOSES)
    if not ((is_lower_touched and is_upper_touched) or record.sides_known):
        raise refused(RefusalCode.ONE_STOP_TOUCHED)
    return is_lower_touched, is_upper_touched
