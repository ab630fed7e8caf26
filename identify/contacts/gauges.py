"""Strain gauges in the separation of contact forces: further measured rows of its least squares, beside the stations.

A gauge at the distance h from the neutral fibre shows

    epsilon = -h w''(x) = sum_m -h phi_m''(x) q_m,   q_m = a_m / -omega^2

the same modal sums as a displacement, down to 0 Hz: the slow bending that accelerometers lose. Rigid-body motion bends
nothing. Two errors of a gauge are in no tolerance, and are nuisance parameters beside them: a bridge has no zero of its
own, so that the mean before the force is subtracted, with the error of a mean; and the sum converges slowly where a
force acts nearby (`identify.linear.truncation`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float
from msgspec.structs import replace as with_fields

from identify.contacts.station_spectra import SpectralLines
from identify.linear.nuisance import Change, Nuisance, NuisanceKind
from identify.signals.beginning import excitation_start
from identify.signals.kinematics import TAPER_S, Kinematics, MotionQuantity, taper
from identify.signals.noise import noise_density_and_certainty
from rig.model.description import Sensor
from rig.recording import Recording


@dataclass(frozen=True)
class Gauges:
    """Strain gauges of a record that begins at rest, each with its fibre_m.

    strain is their signal less its mean before the force; noise_strain the standard deviation of its noise per sample,
    zero_error_strain that of the subtracted mean.
    """

    sensors: tuple[Sensor, ...]
    strain: Float[np.ndarray, "gauges samples"]
    noise_strain: Float[np.ndarray, " gauges"]
    zero_error_strain: Float[np.ndarray, " gauges"]

    def rows(self, lines: SpectralLines, mean_power: float, is_usable: Bool[np.ndarray, "gauges lines"]) -> "GaugeRows":
        """Rows of the separation, in a unit in which each gauge has the mean power of the stations' accelerations: all
        errors then have a common floor. Lines that are not usable are zero in the signal and in its response."""
        spectra = lines.spectra(self.strain)
        for spectrum, sensor, is_line_usable in zip(spectra, self.sensors, is_usable, strict=True):
            sensor_response = sensor.response(lines.omega)
            spectrum[:] = np.divide(spectrum, sensor_response, out=np.zeros_like(sensor_response), where=is_line_usable)
        gauge_power, sample_count = np.mean(np.abs(spectra) ** 2, axis=1), self.strain.shape[1]
        scales = np.sqrt(np.divide(mean_power, gauge_power, out=np.ones_like(gauge_power), where=gauge_power > 0))
        zero_error = lines.spectra(np.ones(sample_count)) * (scales * self.zero_error_strain)[:, None]
        return GaugeRows(
            spectra=scales[:, None] * spectra,
            response=np.where(is_usable, -scales[:, None] / lines.omega**2, 0.0).astype(complex),
            noise_power=np.broadcast_to((sample_count * (scales * self.noise_strain) ** 2)[:, None], spectra.shape),
            zero_error=np.where(is_usable, zero_error, 0.0),
        )


@dataclass(frozen=True)
class GaugeRows:
    """Rows of gauges in the separation: spectra, their response to the second derivative of the strain, the power of
    their noise, and one standard deviation of their zeros."""

    spectra: Complex[np.ndarray, "gauges lines"]
    response: Complex[np.ndarray, "gauges lines"]
    noise_power: Float[np.ndarray, "gauges lines"]
    zero_error: Complex[np.ndarray, "gauges lines"]


def gauge_zero_changes(
    gauges: Sequence[Sensor], first_row: int, zero_errors: Complex[np.ndarray, "gauges lines"]
) -> tuple[Change, ...]:
    """Changes by one standard deviation of each gauge's zero, in rows behind `first_row` others."""
    return tuple(
        Change(Nuisance(NuisanceKind.ZERO, gauge.name), [first_row + index], zero_errors[[index]])
        for index, gauge in enumerate(gauges)
    )


def gauges_and_motion_of(recording: Recording, use: MotionQuantity, motion: Kinematics) -> tuple[Gauges, Kinematics]:
    """Gauges that the separation uses, and the motion with their channels and their start of the excitation.

    None are used beside sensors of one quantity alone (`use`), on a base whose motion is measured, or in a record that
    does not begin at rest, unless it is a segment of a longer one. Slow motion may be lost in the noise of the
    accelerometers and yet bend the gauges: where accelerometers tell no quiet start, the force and the gauges do.
    """
    rig, sample_count, rate_hz = recording.rig, motion.sample_count, recording.rig.sample_rate_hz
    gauge_sensors = [
        sensor for sensor in rig.sensors if not sensor.measures.translates and np.ptp(recording.values_of(sensor)) > 0
    ]
    if use != "auto" or rig.base_sensors:
        gauge_sensors = []
    excited_from, is_segment = motion.excited_from, recording.start_s > 0
    lacks_quiet_start = not (excited_from or recording.start_s)
    if gauge_sensors and lacks_quiet_start and all(sensor.measures.order == 2 for sensor in motion.sensors):
        gauge_signals = (recording.values_of(gauge) for gauge in gauge_sensors)
        excited_from = excitation_start(recording.forces_n, gauge_signals, rate_hz)
    quiet_count = replace(motion, excited_from=excited_from).quiet_sample_count
    if not (gauge_sensors and (quiet_count or is_segment)):
        return Gauges((), np.empty((0, motion.sample_count)), np.empty(0), np.empty(0)), motion
    signals = np.stack([recording.values_of(gauge)[:sample_count] for gauge in gauge_sensors])
    if is_segment:  # the segment of a longer record tells the zero by its open contacts alone
        noise_densities = [
            gauge.noise_density or noise_density_and_certainty(signal, rate_hz)[0]
            for gauge, signal in zip(gauge_sensors, signals, strict=True)
        ]
        signal_noise = np.sqrt(rate_hz / 2) * np.array(noise_densities)
        zero_offset, zero_error = signals.mean(axis=1), signals.std(axis=1)
        strain = (signals - zero_offset[:, None]) * taper(sample_count, round(TAPER_S * rate_hz))[::-1]
    else:
        signal_noise, zero_offset = signals[:, :quiet_count].std(axis=1), signals[:, :quiet_count].mean(axis=1)
        strain, zero_error = signals - zero_offset[:, None], signal_noise / np.sqrt(quiet_count)
    gain_sizes = np.abs([gauge.gain for gauge in gauge_sensors])
    sensors = tuple(with_fields(gauge, fibre_m=rig.fibre_m(gauge)) for gauge in gauge_sensors)
    channel_names = (*motion.channels, *(gauge.name for gauge in gauge_sensors))
    scaled_gauges = Gauges(sensors, strain, signal_noise / gain_sizes, zero_error / gain_sizes)
    return scaled_gauges, replace(motion, excited_from=excited_from, channels=channel_names)
