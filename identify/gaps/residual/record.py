"""A recording as the diagnosis reads it: what its lines hold, and the same over time; `spectra.record_of` makes it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft, rfft

from identify.gaps.residual.ringing import MeasuredMode
from identify.linear.free_motion import Sampling
from identify.signals.drift import Drift
from identify.signals.kinematics import CORNER_HZ, integrated
from identify.signals.scores import COUNTED_HZ
from rig.model.description import Rig, Sensor
from rig.model.tolerances import Tolerances


@dataclass(frozen=True)
class Record:
    """Spectra of one recording, on the lines 0 to `high_hz`; `taken` are the samples in time that count.

    delivered is what each sensor gave, turned into an acceleration by powers of i omega, its believed gain and
    delay still in it; displaced the same as a displacement, high-passed where it had to be integrated. Where a free
    mass is displaced, delivered is the windowed acceleration, and faded what its windowed velocity is more than
    that of the windowed displacement; elsewhere both are those of what was windowed, as bodies answer it. noise is
    the variance of each of its lines by the sensor's noise alone, power its smoothed size; force_noise the variance
    of each force's lines by its channel's noise. eta_beyond is each relative displacement as measured on the lines
    from `high_hz` on, drifts what is known of its slow part (None where nothing is lost; the linear model has the
    springs). window is what samples were multiplied by, excited_s when the force begins, period_s after what it
    repeats (None: it does not), tolerances how exactly the rig is believed. windows_responses: without contacts it
    is the response of what is held, not the force, that is windowed. from_the_blow: a free motion that counts from
    the first sample on; modes are those that it tells of a rig without contacts.
    """

    rig: Rig
    sensors: tuple[Sensor, ...]
    zero_known: bool
    sample_rate_hz: float
    length: int
    samples: int
    factor: int
    window: Float[np.ndarray, " samples"]
    omega: Float[np.ndarray, " lines"]
    forces: Complex[np.ndarray, "forces lines"]
    delivered: Complex[np.ndarray, "sensors lines"]
    displaced: Complex[np.ndarray, "sensors lines"]
    faded: Complex[np.ndarray, "sensors lines"]
    noise: Float[np.ndarray, "sensors lines"]
    force_noise: Float[np.ndarray, " forces"]
    power: Float[np.ndarray, "sensors lines"]
    eta_beyond: Complex[np.ndarray, "contacts morelines"]
    drifts: tuple[Drift | None, ...]
    from_the_blow: bool
    modes: tuple[MeasuredMode, ...]
    taken: slice
    windows_responses: bool
    excited_s: float
    period_s: float | None
    tolerances: Tolerances

    @property
    def sampling(self) -> Sampling:
        """Sampling of a free motion that counts from the blow on."""
        fading = int(np.count_nonzero(self.window[1:] < 1))
        return Sampling(self.sensors[0].measures.order, self.sample_rate_hz, self.samples, fading)

    @property
    def highest_hz(self) -> float:
        return float(self.omega[-1] / (2 * np.pi))

    @property
    def forced(self) -> bool:
        """True if a force was measured; else the record is a free decay."""
        return bool(np.any(self.forces))

    @property
    def counted_until_s(self) -> float:
        return self.taken.stop / self.rate_hz

    @property
    def rate_hz(self) -> float:
        """Rate of the residuals over time, Hz."""
        return self.sample_rate_hz / self.factor

    @property
    def repeats(self) -> float:
        """The frequency at which the force repeats, per sample of the residuals over time; 0 if it does not."""
        return 1 / (self.period_s * self.rate_hz) if self.period_s else 0.0

    @property
    def time_s(self) -> Float[np.ndarray, " times"]:
        """Times of the residuals' samples, s."""
        return np.arange(self.taken.start, self.taken.stop) / self.rate_hz

    @property
    def sample_times_s(self) -> Float[np.ndarray, " samples"]:
        """Times of the recording's samples from its beginning, s."""
        return np.arange(self.samples) / self.sample_rate_hz

    def spectrum(self, signal: Float[np.ndarray, " samples"]) -> Complex[np.ndarray, " lines"]:
        """Spectrum of a signal over the recording's samples, windowed as they were."""
        lines = np.round(self.omega * self.length / (2 * np.pi * self.sample_rate_hz)).astype(int)
        return np.asarray(rfft(signal * self.window, self.length)[lines])

    def sampled(
        self, eta: Complex[np.ndarray, "contacts lines"], derivative: int = 0, beyond: bool = True
    ) -> Float[np.ndarray, "contacts samples"]:
        """Relative displacements, or velocities, at the recording's rate, between the first and last that counts.

        With what was measured beyond the lines; a change of a model has nothing there.
        """
        whole = np.concatenate([eta[:, :-1], self.eta_beyond if beyond else np.zeros_like(self.eta_beyond)], axis=1)
        if derivative:
            whole *= 2j * np.pi * self.sample_rate_hz / self.length * np.arange(whole.shape[1])
        moved = irfft(whole, self.length)
        return moved[:, self.taken.start * self.factor : (self.taken.stop - 1) * self.factor + 1].copy()

    @cached_property
    def twice_integrated(self) -> Complex[np.ndarray, " lines"]:
        """Transfer from an acceleration to a displacement, high-passed."""
        return integrated(self.omega, -2, CORNER_HZ)

    @property
    def sample_ratio(self) -> float:
        """Weight of the tolerances over that of a sample, as model errors last: samples for each that counts."""
        return max(1.0, len(self.sensors) * self.rate_hz / COUNTED_HZ)

    def in_time(self, spectra: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows times"]:
        """Back to time, at `rate_hz`, the samples that count."""
        whole = irfft(spectra, self.length // self.factor) / self.factor
        return np.asarray(whole[..., self.taken])
