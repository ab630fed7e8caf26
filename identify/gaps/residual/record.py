"""Record: spectra of a recording that the diagnosis reads, and their transforms to time (see `spectra.record_of`)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace
from scipy.fft import irfft, rfft

from identify.gaps.residual.ringing import MeasuredMode
from identify.gaps.residual.shaken_base import BaseSpectra
from identify.linear.model import Place
from identify.linear.sampled_motion import Sampling
from identify.signals.drift import DriftPrior
from identify.signals.kinematics import omega_power
from identify.signals.law_evaluation import product_rate_multiple
from identify.signals.scores import INDEPENDENT_RATE_HZ
from rig.model.description import Rig, Sensor, Station
from rig.model.tolerances import Tolerances


@dataclass(frozen=True)
class CountedBandAndEnd:
    """Counted part of a record: the recording's samples per time of the residuals, which sets the band, and the end."""

    decimation: int
    end_s: float


def place_of(sensor: Sensor, station: Station) -> Place:
    """Place of a sensor at a station: that station, or the gauge there."""
    return station if sensor.measures.translates else replace(sensor, station=station)


@dataclass(frozen=True)
class Record:
    """Spectra of one recording on the lines from 0 to `highest_hz`, and the samples that count.

    sensors: those of motion, then strain gauges, whose strain takes the place of the displacement (`gauges`).
    signal_factors: factor on each sensor's signals; of gauges one in common, in m, with which their accelerations have
    the mean power of the others. zero_errors: standard deviations of the gauges' zeros, times that factor.
    transform_length and decimation: samples of the transform with padding, and the recording's samples per time of the
    residuals; counted_slice: the times that count. window multiplied the recording's samples, sample_count in number.
    acceleration_signals: signals as accelerations, by powers of i omega, with the nominal gain and delay still in them;
    displacement_signals: as displacements, high-passed where integrated. For a free mass with measured displacement,
    the former are the windowed acceleration, and velocity_correction its windowed velocity less the derivative of its
    windowed displacement; for other bodies, whose response is windowed, that is zero.
    noise_variance: variance of each line of acceleration_signals by sensor noise; smoothed_power: their smoothed mean
    square; force_noise_variance: variance of each force's lines by noise of its channel.
    base: what the sensor on a shaken base delivers; the force is then the inertial force on each kilogram (N/kg), and
    velocity_correction, drifts and eta_above_band are those of motion against the base.
    corner_hz: corner of the high-pass under which sensors' signals are integrated.
    eta_above_band: measured relative displacements on the lines from `highest_hz` on; drifts: what is known of their
    slow parts (None where integration loses nothing).
    excitation_start_s: start of the force; period_s: its period, None if it does not repeat; tolerances: those of the
    rig. responses_windowed: without contacts, the response of held bodies is windowed instead of the force.
    fits_initial_state: a free motion whose initial state is estimated; initial_sensor_states: displacement and velocity
    that each displacement sensor shows there; measured_modes: its modes, without contacts or of held beams.
    """

    rig: Rig
    sensors: tuple[Sensor, ...]
    signal_factors: Float[np.ndarray, " sensors"]
    zero_errors: Float[np.ndarray, " sensors"]
    zero_known: bool
    sample_rate_hz: float
    transform_length: int
    sample_count: int
    decimation: int
    window: Float[np.ndarray, " samples"]
    omega: Float[np.ndarray, " lines"]
    force_spectra: Complex[np.ndarray, "forces lines"]
    base: BaseSpectra | None
    acceleration_signals: Complex[np.ndarray, "sensors lines"]
    displacement_signals: Complex[np.ndarray, "sensors lines"]
    velocity_correction: Complex[np.ndarray, "sensors lines"]
    noise_variance: Float[np.ndarray, "sensors lines"]
    force_noise_variance: Float[np.ndarray, " forces"]
    smoothed_power: Float[np.ndarray, "sensors lines"]
    corner_hz: float
    eta_above_band: Complex[np.ndarray, "contacts morelines"]
    drifts: tuple[DriftPrior | None, ...]
    fits_initial_state: bool
    initial_sensor_states: Float[np.ndarray, "sensors 2"]
    measured_modes: tuple[MeasuredMode, ...]
    counted_slice: slice
    responses_windowed: bool
    excitation_start_s: float
    period_s: float | None
    tolerances: Tolerances

    @cached_property
    def sampling(self) -> Sampling:
        """Sampling of a free motion that counts from its first sample."""
        fade_samples = int(np.count_nonzero(self.window[1:] < 1))
        return Sampling(
            self.sensors[0].measures.order, self.sample_rate_hz, self.sample_count, fade_samples, self.omega
        )

    @cached_property
    def motion_sensors(self) -> tuple[Sensor, ...]:
        """Sensors of motion, without strain gauges."""
        return tuple(sensor for sensor in self.sensors if sensor.measures.translates)

    @cached_property
    def sensor_places(self) -> tuple[Place, ...]:
        """Places of the sensors: stations, and gauges themselves."""
        return tuple(place_of(sensor, sensor.station) for sensor in self.sensors)

    def motion_sensor_indices_on(self, body_name: str) -> list[int]:
        """Indices of the sensors of motion on a body."""
        return [k for k, sensor in enumerate(self.motion_sensors) if sensor.station.body == body_name]

    @property
    def highest_hz(self) -> float:
        """Frequency of the last line, Hz."""
        return float(self.omega[-1] / (2 * np.pi))

    @property
    def has_force(self) -> bool:
        """True if a force was measured; the record is a free decay otherwise."""
        return bool(np.any(self.force_spectra))

    @property
    def channel_names(self) -> list[str]:
        """Names of the sensors that are read, that on a shaken base last."""
        return [sensor.name for sensor in (*self.sensors, *([self.base.sensor] if self.base else []))]

    @property
    def counted_part(self) -> CountedBandAndEnd:
        """Band and end of the samples that count, for other records of the same test."""
        return CountedBandAndEnd(self.decimation, self.counted_slice.stop / self.residual_rate_hz)

    @property
    def residual_rate_hz(self) -> float:
        """Rate of the residuals over time, Hz."""
        return self.sample_rate_hz / self.decimation

    @property
    def repeats_per_sample(self) -> float:
        """Repetition frequency of the force, per sample of the residuals over time; 0 if it does not repeat."""
        return 1 / (self.period_s * self.residual_rate_hz) if self.period_s else 0.0

    @property
    def residual_times_s(self) -> Float[np.ndarray, " times"]:
        """Times of the residuals' samples, s."""
        return np.arange(self.counted_slice.start, self.counted_slice.stop) / self.residual_rate_hz

    @property
    def sample_times_s(self) -> Float[np.ndarray, " samples"]:
        """Times of the recording's samples, s."""
        return np.arange(self.sample_count) / self.sample_rate_hz

    def spectrum(self, signal: Float[np.ndarray, " samples"]) -> Complex[np.ndarray, " lines"]:
        """Spectrum of a signal over the recording's samples under the record's window."""
        line_indices = np.round(self.omega * self.transform_length / (2 * np.pi * self.sample_rate_hz)).astype(int)
        return np.asarray(rfft(signal * self.window, self.transform_length)[line_indices])

    def eta_at_sample_rate(
        self, eta_spectra: Complex[np.ndarray, "contacts lines"], derivative_order: int = 0, upper_band: bool = True
    ) -> Float[np.ndarray, "contacts samples"]:
        """Relative displacements or velocities at the recording's rate, from the first to the last time that counts.

        `upper_band` adds the measured lines above the band; changes of a model have none.
        """
        above_band = self.eta_above_band if upper_band else np.zeros_like(self.eta_above_band)
        spectra = np.concatenate([eta_spectra[:, :-1], above_band], axis=1)
        if derivative_order:
            spectra *= 2j * np.pi * self.sample_rate_hz / self.transform_length * np.arange(spectra.shape[1])
        signals = irfft(spectra, self.transform_length)
        if self.fits_initial_state and not derivative_order:
            signals[:, 0] *= 2  # the window halves the first sample
        first, last = self.counted_slice.start * self.decimation, (self.counted_slice.stop - 1) * self.decimation
        return signals[:, first : last + 1].copy()

    @cached_property
    def displacement_per_acceleration(self) -> Complex[np.ndarray, " lines"]:
        """Transfer from an acceleration to a displacement, high-passed."""
        return omega_power(self.omega, -2, self.corner_hz)

    @property
    def oversampling(self) -> float:
        """Samples per independent sample, the weight of priors: model errors last longer than a sample, and are shared
        by the sensors of motion; strain gauges beside them do not lower the weight of the contact forces."""
        return max(1.0, len(self.motion_sensors) * self.residual_rate_hz / INDEPENDENT_RATE_HZ)

    @property
    def slope_rate_multiple(self) -> int:
        """Multiple of `rate_hz` at which laws' slopes are multiplied by displacements."""
        return product_rate_multiple(self.sample_rate_hz, self.decimation)

    def in_time(self, spectra: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows times"]:
        """Signals over the times that count, at `rate_hz`, from their spectra."""
        signals = irfft(spectra, self.transform_length // self.decimation) / self.decimation
        return np.asarray(signals[..., self.counted_slice])

    def at_finer_rate(self, spectra: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows finer"]:
        """Signals from the first to the last time that counts, at `slope_rate_multiple` times `rate_hz`."""
        rate_multiple, counted = self.slope_rate_multiple, self.counted_slice
        signals = irfft(spectra[..., :-1], self.transform_length // self.decimation * rate_multiple)
        signals = signals * (rate_multiple / self.decimation)
        return np.asarray(signals[..., counted.start * rate_multiple : (counted.stop - 1) * rate_multiple + 1])
