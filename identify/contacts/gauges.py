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
from identify.signals.noise import noise_density_and_certainty
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
        first_row, gauge_names = self.station_count, self.gauge_names
        changes = [
            Change(Nuisance(NuisanceKind.ZERO, name), [first_row + gauge], self.zero_error[[gauge]])
            for gauge, name in enumerate(gauge_names)
        ]
        for (force, gauge), signal_per_newton in self.truncation.items():
            parameter = Nuisance(NuisanceKind.TRUNCATION, f"{gauge_names[gauge]} by {self.force_names[force]}")
            changes.append(Change(parameter, [first_row + gauge], (signal_per_newton * input_spectra[force])[None]))
        return tuple(changes)


def truncation_of(
    gauges: Sequence[Sensor],
    rig: Rig,
    responses: Sequence[Response],
    gauge_response: Complex[np.ndarray, "gauges lines"],
) -> dict[tuple[int, int], Complex[np.ndarray, " lines"]]:
    """Share of the highest modes in the signal of each gauge per newton of each exciting or contact force that acts on
    its body, by the indices of force and gauge."""
    truncation_shares = {}
    for response in responses:
        highest = slice(int(CONVERGED_SHARE * response.mode_count), None)
        force_shapes = input_shapes(rig, response, rig.forces)[:, highest]
        gauge_shapes, accelerance = response.shapes(gauges)[:, highest], response.accelerance[highest]
        force_indices, gauge_indices = (np.flatnonzero(s.any(1)).tolist() for s in (force_shapes, gauge_shapes))
        for force_index, gauge_index in product(force_indices, gauge_indices):
            per_newton = real_product((force_shapes[force_index] * gauge_shapes[gauge_index])[None], accelerance)[0]
            truncation_shares[force_index, gauge_index] = gauge_response[gauge_index] * per_newton
    return truncation_shares


def gauges_of(recording: Recording, use: MotionQuantity, motion: Kinematics) -> tuple[Gauges, Kinematics]:
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
