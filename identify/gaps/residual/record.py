"""Record: spectra of a recording that the diagnosis reads, and their transforms to time (see `spectra.record_of`)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft, rfft

from identify.gaps.residual.ringing import MeasuredMode
from identify.linear.sampled_motion import Sampling
from identify.signals.drift import Drift
from identify.signals.kinematics import integrated
from identify.signals.law_evaluation import product_multiple
from identify.signals.scores import COUNTED_HZ
from rig.model.description import Rig, Sensor
from rig.model.tolerances import Tolerances


@dataclass(frozen=True)
class Counted:
    """Counted part of a record: the recording's samples per time of the residuals, which sets the band, and the end."""

    factor: int
    until_s: float


@dataclass(frozen=True)
class Record:
    """Spectra of one recording on the lines from 0 to `highest_hz`, and the samples that count.

    length and factor: samples of the transform with padding, and the recording's samples per time of the residuals;
    counted_samples is the slice of these times that counts. window multiplied the recording's samples.
    delivered: signals as accelerations, by powers of i omega, with the nominal gain and delay still in them; displaced:
    as displacements, high-passed where integrated. For a free mass with measured displacement, delivered is the
    windowed acceleration, and faded its windowed velocity less the derivative of its windowed displacement; for other
    bodies, whose response is windowed, faded is zero.
    noise: variance of each line of delivered by sensor noise; power: its smoothed mean square; force_noise: variance of
    each force's lines by noise of its channel.
    corner_hz: corner of the high-pass under which sensors' signals are integrated.
    eta_beyond: measured relative displacements on the lines from `highest_hz` on; drifts: what is known of their slow
    parts (None where integration loses nothing).
    excited_s: start of the force; period_s: its period, None if it does not repeat; tolerances: those of the rig.
    windows_responses: without contacts, the response of held bodies is windowed instead of the force.
    counts_from_blow: a free motion whose initial state is estimated; first_states: displacement and velocity that each
    displacement sensor shows there; modes: its measured modes, without contacts or of
    held beams.
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
    corner_hz: float
    eta_beyond: Complex[np.ndarray, "contacts morelines"]
    drifts: tuple[Drift | None, ...]
    counts_from_blow: bool
    first_states: Float[np.ndarray, "sensors 2"]
    modes: tuple[MeasuredMode, ...]
    counted_samples: slice
    windows_responses: bool
    excited_s: float
    period_s: float | None
    tolerances: Tolerances

    @cached_property
    def sampling(self) -> Sampling:
        """Sampling of a free motion that counts from its first sample."""
        fading = int(np.count_nonzero(self.window[1:] < 1))
        return Sampling(self.sensors[0].measures.order, self.sample_rate_hz, self.samples, fading, self.omega)

    @property
    def highest_hz(self) -> float:
        """Frequency of the last line, Hz."""
        return float(self.omega[-1] / (2 * np.pi))

    @property
    def forced(self) -> bool:
        """True if a force was measured; the record is a free decay otherwise."""
        return bool(np.any(self.forces))

    @property
    def counted(self) -> Counted:
        """Band and end of the samples that count, for other records of the same test."""
        return Counted(self.factor, self.counted_samples.stop / self.rate_hz)

    @property
    def rate_hz(self) -> float:
        """Rate of the residuals over time, Hz."""
        return self.sample_rate_hz / self.factor

    @property
    def repeats(self) -> float:
        """Repetition frequency of the force, per sample of the residuals over time; 0 if it does not repeat."""
        return 1 / (self.period_s * self.rate_hz) if self.period_s else 0.0

    @property
    def time_s(self) -> Float[np.ndarray, " times"]:
        """Times of the residuals' samples, s."""
        return np.arange(self.counted_samples.start, self.counted_samples.stop) / self.rate_hz

    @property
    def sample_times_s(self) -> Float[np.ndarray, " samples"]:
        """Times of the recording's samples, s."""
        return np.arange(self.samples) / self.sample_rate_hz

    def spectrum(self, signal: Float[np.ndarray, " samples"]) -> Complex[np.ndarray, " lines"]:
        """Spectrum of a signal over the recording's samples under the record's window."""
        lines = np.round(self.omega * self.length / (2 * np.pi * self.sample_rate_hz)).astype(int)
        return np.asarray(rfft(signal * self.window, self.length)[lines])

    def sampled(
        self, eta: Complex[np.ndarray, "contacts lines"], derivative: int = 0, beyond: bool = True
    ) -> Float[np.ndarray, "contacts samples"]:
        """Relative displacements or velocities at the recording's rate, from the first to the last time that counts.

        `beyond` adds the measured lines above the band; changes of a model have none.
        """
        spectra = np.concatenate([eta[:, :-1], self.eta_beyond if beyond else np.zeros_like(self.eta_beyond)], axis=1)
        if derivative:
            spectra *= 2j * np.pi * self.sample_rate_hz / self.length * np.arange(spectra.shape[1])
        rows = irfft(spectra, self.length)
        if self.counts_from_blow and not derivative:
            rows[:, 0] *= 2  # the window halves the first sample
        return rows[
            :, self.counted_samples.start * self.factor : (self.counted_samples.stop - 1) * self.factor + 1
        ].copy()

    @cached_property
    def twice_integrated(self) -> Complex[np.ndarray, " lines"]:
        """Transfer from an acceleration to a displacement, high-passed."""
        return integrated(self.omega, -2, self.corner_hz)

    @property
    def sample_ratio(self) -> float:
        """Samples per independent sample, the weight of priors: model errors last longer than a sample."""
        return max(1.0, len(self.sensors) * self.rate_hz / COUNTED_HZ)

    @property
    def product_multiple(self) -> int:
        """Multiple of `rate_hz` at which laws' slopes are multiplied by displacements."""
        return product_multiple(self.sample_rate_hz, self.factor)

    def in_time(self, spectra: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows times"]:
        """Signals over the times that count, at `rate_hz`, from their spectra."""
        rows = irfft(spectra, self.length // self.factor) / self.factor
        return np.asarray(rows[..., self.counted_samples])

    def in_finer_time(self, spectra: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows finer"]:
        """Signals from the first to the last time that counts, at `product_multiple` times `rate_hz`."""
        multiple, counted = self.product_multiple, self.counted_samples
        rows = irfft(spectra[..., :-1], self.length // self.factor * multiple) * (multiple / self.factor)
        return np.asarray(rows[..., counted.start * multiple : (counted.stop - 1) * multiple + 1])
