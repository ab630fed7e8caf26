"""Strain gauges in the separation of contact forces: further measured rows of its least squares, beside the stations.

A gauge at the distance h from the neutral fibre shows

    epsilon = -h w''(x) = sum_m -h phi_m''(x) q_m,   q_m = a_m / -omega^2

the same modal sums as a displacement, down to 0 Hz: the slow bending that accelerometers lose. Rigid-body motion bends
nothing. Two errors of a gauge are in no tolerance, and are nuisance parameters beside them:

- A bridge has no zero of its own: the mean before the force is subtracted, with the error of a mean.
- The sum converges slowly where a force acts nearby. The share of the highest modes in a gauge's signal, force by
  force, is taken as the standard deviation of what the modes beyond them would add.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Complex, Float
from msgspec.structs import replace as with_fields

from identify.contacts.station_spectra import SpectralLines
from identify.linear.model import Response, input_shapes, real_product
from identify.linear.nuisance import CONVERGED_SHARE, Change, Nuisance, NuisanceKind
from identify.signals.beginning import excitation_start
from identify.signals.kinematics import TAPER_S, Kinematics, MotionQuantity, taper
from identify.signals.noise import spectrogram_noise_density
from rig.model.description import Rig, Sensor
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
        for sensor_index, sensor in enumerate(self.sensors):
            sensor_response = sensor.response(lines.omega)
            spectra[sensor_index] = np.divide(
                spectra[sensor_index],
                sensor_response,
                out=np.zeros_like(sensor_response),
                where=is_usable[sensor_index],
            )
        signal_power = np.mean(np.abs(spectra) ** 2, axis=1)
        row_scale = np.sqrt(np.divide(mean_power, signal_power, out=np.ones_like(signal_power), where=signal_power > 0))
        sample_count = self.strain.shape[1]
        zero_error = lines.spectra(np.ones(sample_count)) * (row_scale * self.zero_error_strain)[:, None]
        return GaugeRows(
            measured=row_scale[:, None] * spectra,
            response=np.where(is_usable, -row_scale[:, None] / lines.omega**2, 0.0).astype(complex),
            noise_power=np.broadcast_to((sample_count * (row_scale * self.noise_strain) ** 2)[:, None], spectra.shape),
            zero_error=np.where(is_usable, zero_error, 0.0),
        )

    def truncation(
        self, rig: Rig, responses: Sequence[Response], response: Complex[np.ndarray, "gauges lines"]
    ) -> dict[tuple[int, int], Complex[np.ndarray, " lines"]]:
        """Share of the highest modes in the signal of each gauge per newton of each exciting or contact force that acts
        on its body, by the indices of force and gauge."""
        share_by_force_and_gauge = {}
        for body_response in responses:
            highest_modes = slice(int(CONVERGED_SHARE * body_response.mode_count), None)
            force_shapes = input_shapes(rig, body_response, rig.forces)[:, highest_modes]
            gauge_shapes, accelerance = (
                body_response.shapes(self.sensors)[:, highest_modes],
                body_response.accelerance[highest_modes],
            )
            for force_index, gauge_index in product(
                *(np.flatnonzero(shape_rows.any(axis=1)).tolist() for shape_rows in (force_shapes, gauge_shapes))
            ):
                share_by_force_and_gauge[force_index, gauge_index] = (
                    response[gauge_index]
                    * real_product((force_shapes[force_index] * gauge_shapes[gauge_index])[None], accelerance)[0]
                )
        return share_by_force_and_gauge


@dataclass(frozen=True)
class GaugeRows:
    """Rows of gauges in the separation: spectra, their response to the second derivative of the strain, the power of
    their noise, and one standard deviation of their zeros."""

    measured: Complex[np.ndarray, "gauges lines"]
    response: Complex[np.ndarray, "gauges lines"]
    noise_power: Float[np.ndarray, "gauges lines"]
    zero_error: Complex[np.ndarray, "gauges lines"]


@dataclass(frozen=True)
class GaugeErrors:
    """Errors of gauges that no tolerance states, as rows behind `station_count` others; truncation is per newton."""

    station_count: int
    gauge_names: tuple[str, ...]
    force_names: tuple[str, ...]
    zero_error: Complex[np.ndarray, "gauges lines"]
    truncation: dict[tuple[int, int], Complex[np.ndarray, " lines"]]

    def changes(self, input_spectra: Complex[np.ndarray, "inputs lines"]) -> tuple[Change, ...]:
        """Changes by one standard deviation of every error, given the exciting and the contact forces."""
        zero_changes = [
            Change(
                Nuisance(NuisanceKind.ZERO, name), [self.station_count + gauge_index], self.zero_error[[gauge_index]]
            )
            for gauge_index, name in enumerate(self.gauge_names)
        ]
        truncation_changes = [
            Change(
                Nuisance(
                    NuisanceKind.TRUNCATION, f"{self.gauge_names[truncated_gauge]} by {self.force_names[force_index]}"
                ),
                [self.station_count + truncated_gauge],
                (signal_per_newton * input_spectra[force_index])[None],
            )
            for (force_index, truncated_gauge), signal_per_newton in self.truncation.items()
        ]
        return (*zero_changes, *truncation_changes)


def gauges_of(recording: Recording, use: MotionQuantity, motion: Kinematics) -> tuple[Gauges, Kinematics]:
    """Gauges that the separation uses, and the motion with their channels and their start of the excitation.

    None are used beside sensors of one quantity alone (`use`), on a base whose motion is measured, or in a record that
    does not begin at rest, unless it is a segment of a longer one. Slow motion may be lost in the noise of the
    accelerometers and yet bend the gauges: where accelerometers tell no quiet start, the force and the gauges do.
    """
    rig, sample_count = recording.rig, motion.samples
    gauges = [
        sensor for sensor in rig.sensors if not sensor.measures.translates and np.ptp(recording.values_of(sensor)) > 0
    ]
    if use != "auto" or rig.base_sensors:
        gauges = []
    excited_from = motion.excited_from
    if (
        gauges
        and not (excited_from or recording.start_s)
        and all(sensor.measures.order == 2 for sensor in motion.sensors)
    ):
        excited_from = excitation_start(
            recording.forces_n, (recording.values_of(gauge) for gauge in gauges), rig.sample_rate_hz
        )
    quiet_samples, is_segment = replace(motion, excited_from=excited_from).quiet_samples, recording.start_s > 0
    if not (gauges and (quiet_samples or is_segment)):
        return Gauges((), np.empty((0, motion.samples)), np.empty(0), np.empty(0)), motion
    gauge_signals = np.stack([recording.values_of(gauge)[:sample_count] for gauge in gauges])
    if is_segment:  # the segment of a longer record tells the zero by its open contacts alone
        noise_densities = [
            gauge.noise_density or spectrogram_noise_density(gauge_signal, rig.sample_rate_hz)[0]
            for gauge, gauge_signal in zip(gauges, gauge_signals, strict=True)
        ]
        noise_deviation = np.sqrt(rig.sample_rate_hz / 2) * np.array(noise_densities)
        zero_offset, zero_error = gauge_signals.mean(axis=1), gauge_signals.std(axis=1)
        strain = (gauge_signals - zero_offset[:, None]) * taper(sample_count, round(TAPER_S * rig.sample_rate_hz))[::-1]
    else:
        noise_deviation, zero_offset = (
            gauge_signals[:, :quiet_samples].std(axis=1),
            gauge_signals[:, :quiet_samples].mean(axis=1),
        )
        strain, zero_error = gauge_signals - zero_offset[:, None], noise_deviation / np.sqrt(quiet_samples)
    gains = np.abs([gauge.gain for gauge in gauges])
    sensors = tuple(with_fields(gauge, fibre_m=rig.fibre_m(gauge)) for gauge in gauges)
    channels = (*motion.channels, *(gauge.name for gauge in gauges))
    scaled_gauges = Gauges(sensors, strain, noise_deviation / gains, zero_error / gains)
    return scaled_gauges, replace(motion, excited_from=excited_from, channels=channels)
