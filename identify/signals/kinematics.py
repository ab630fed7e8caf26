"""Displacement, velocity and acceleration at each station from the signals of its sensors."""

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np
import scipy
from jaxtyping import Complex, Float

from identify.signals.beginning import QUIET_S, excitation_start, lead_in
from identify.signals.measured_base import MeasuredBase, excitations, forces_on_bodies
from rig.errors import RigError
from rig.model.description import ON_GROUND, Rig, Sensor, Station, contact_stations
from rig.model.quantities import QUANTITIES
from rig.model.sensing import PASSBAND
from rig.recording import Recording

TAPER_S = 0.5
"""Length of the taper at a record's end, s."""
PASSBAND_START = 0.05
"""Lowest frequency of a sensor that can be restored, over the corner of its high-pass."""
CORNER_HZ = 0.5
"""Integrated accelerations are drift below; they are cut off smoothly between half this frequency and itself."""

if TYPE_CHECKING:
    MotionQuantity = str
else:
    MotionQuantity = Literal["auto", *(name for name, quantity in QUANTITIES.items() if quantity.translates)]
"""Quantity of the sensors in use, or all of motion; strain gauges show none (`identify.contacts.gauges`)."""
SensorsByStation = dict[Station, dict[int, Sensor]]
"""Sensor of each measured derivative at each station; the last one of several alike."""


@dataclass(frozen=True)
class Kinematics:
    """Motion of every station on one clock, from the first sample on, without the record's end.

    sensors are those of each station's acceleration, displacement_sensors those of its displacement. Every row is right
    within trusted_hz. zero_known is True if displacement sensors show the zero of all stations or, in a record that
    begins at rest, of those at contacts. lost_m_per_s2 is the slow part of the acceleration that an integrated
    displacement at a contact lacks, zero elsewhere. excited_from is the first sample with a force, 0 without a quiet
    start. start_s is the time of the first sample in the record. slow_by_gauges is True if strain gauges gave the slow
    displacements.
    transverse is the motion in the other direction of a rig in space.

    Where a sensor measures how the base shakes, all motion is relative to the base, and the last of the forces is the
    inertial force on each kilogram, minus the base's acceleration (N/kg).
    """

    stations: tuple[Station, ...]
    channels: tuple[str, ...]
    sensors: tuple[Sensor, ...]
    displacement_sensors: tuple[Sensor, ...]
    sample_rate_hz: float
    trusted_hz: tuple[float, float]
    zero_known: bool
    forces_n: Float[np.ndarray, "forces samples"]
    displacement_m: Float[np.ndarray, "_ samples"]
    velocity_m_per_s: Float[np.ndarray, "_ samples"]
    acceleration_m_per_s2: Float[np.ndarray, "stations samples"]
    lost_m_per_s2: Float[np.ndarray, "stations samples"]
    excited_from: int
    start_s: float = 0.0
    slow_by_gauges: bool = False
    base: MeasuredBase | None = None
    transverse: "Kinematics | None" = None

    def time_s(self, sample_count: int, decimation: int = 1) -> Float[np.ndarray, " samples"]:
        """Times of every `decimation`-th of the first samples, s."""
        return self.start_s + np.arange(sample_count) * decimation / self.sample_rate_hz

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Exciting force of a rig that has one, N."""
        (force_n,) = self.forces_n
        return np.asarray(force_n)

    @property
    def sample_count(self) -> int:
        return self.forces_n.shape[1]

    @property
    def quiet_sample_count(self) -> int:
        """Number of samples at the start that show the noise; 0 if they are too few."""
        quiet_count = self.excited_from - round(0.05 * self.sample_rate_hz)
        return quiet_count if quiet_count > QUIET_S * self.sample_rate_hz else 0

    def row(self, station: Station) -> int | None:
        return self.stations.index(station) if station in self.stations else None

    def segment(self, sample_slice: slice) -> "Kinematics":
        """Kinematics of a slice of the samples."""
        return replace(
            self,
            forces_n=self.forces_n[:, sample_slice],
            displacement_m=self.displacement_m[:, sample_slice],
            velocity_m_per_s=self.velocity_m_per_s[:, sample_slice],
            acceleration_m_per_s2=self.acceleration_m_per_s2[:, sample_slice],
            lost_m_per_s2=self.lost_m_per_s2[:, sample_slice],
            excited_from=max(0, self.excited_from - (sample_slice.start or 0)),
            start_s=self.start_s + (sample_slice.start or 0) / self.sample_rate_hz,
            base=self.base and self.base.segment(sample_slice),
            transverse=self.transverse and self.transverse.segment(sample_slice),
        )

    @property
    def without_motion(self) -> "Kinematics":
        """Kinematics without the motion of any station, which takes much memory."""
        no_rows = np.empty((0, self.sample_count))
        return replace(
            self, displacement_m=no_rows, velocity_m_per_s=no_rows, acceleration_m_per_s2=no_rows, lost_m_per_s2=no_rows
        )


@dataclass(frozen=True)
class _PaddedTransform:
    """Fourier transform of a record: its samples times `end_taper`, zeros after them, `padded_count` samples in all.

    The zeros keep the record's end, which integration falsifies, from wrapping round to its start. usable_count is the
    number of right samples of the motion, lead_samples that of made-up samples before the first for differentiation.
    """

    corner_hz: float
    end_taper: Float[np.ndarray, " samples"]
    padded_count: int
    omega: Float[np.ndarray, " lines"]
    usable_count: int
    excited_from: int
    lead_samples: int

    def spectrum(
        self, sensor: Sensor, signal: Float[np.ndarray, " samples"], lead_samples: int
    ) -> Complex[np.ndarray, " lines"]:
        """Spectrum of the motion behind a sensor's signal: its chain divided out, where it lets anything pass.

        `lead_samples` of a lead-in stand before the first sample, at the end of the transform's input.
        """
        padded_signal = np.zeros(self.padded_count)
        padded_signal[: signal.size] = signal * self.end_taper
        if lead_samples:
            padded_signal[-lead_samples:] = lead_in(padded_signal[: signal.size], lead_samples)
        in_passband = self.omega >= PASSBAND_START * 2 * np.pi * sensor.high_pass_hz
        response, motion_spectrum = sensor.response(self.omega), np.zeros(self.omega.size, dtype=complex)
        return np.divide(scipy.fft.rfft(padded_signal), response, out=motion_spectrum, where=in_passband)

    def usable_samples(self, spectrum: Complex[np.ndarray, " lines"]) -> Float[np.ndarray, " usable"]:
        return np.asarray(scipy.fft.irfft(spectrum, self.padded_count)[: self.usable_count])


@dataclass(frozen=True)
class _Motion:
    """Displacement, velocity and acceleration of every station, those on the ground first; the part lost by
    integration; the channels in use."""

    derivatives: tuple[Float[np.ndarray, "_ usable"], ...]
    lost_m_per_s2: Float[np.ndarray, "stations usable"]
    channels: tuple[str, ...]

    @property
    def relative_to_base(self) -> "_Motion":
        """Motion of the stations on bodies relative to the first, which is on the ground."""
        derivatives = tuple(rows[1:] - rows[:1] for rows in self.derivatives)
        return _Motion(derivatives, self.lost_m_per_s2[1:] - self.lost_m_per_s2[:1], self.channels)


def kinematics(
    recording: Recording, use: MotionQuantity = "auto", corner_hz: float = CORNER_HZ, least_order: int = 0
) -> Kinematics:
    """Displacement, velocity and acceleration at every station with a sensor.

    In the frequency domain, with the record's end tapered: each sensor's gain and delay are divided out, and missing
    derivatives follow by powers of i omega. Integration is cut off smoothly below the corner. Each derivative comes
    from the sensor that measured it, else from the nearest one that needs no integration. `use` restricts the sensors
    to one quantity. A segment of a longer record is tapered at its start too, and is wrong there. A record that does
    not begin at rest is led in by its point reflection before it is differentiated. Derivatives below `least_order` are
    left out, as they take memory.

    Raises RigError if there is no such sensor, or the record is too short for its ends to be left out.
    """
    sensors = _motion_sensors(recording, use)
    station_sensors = _sensors_by_station(sensors)
    integrates = any(0 not in by_order for by_order in station_sensors.values())
    transform = _transform(recording, sensors, corner_hz, integrates)
    motion = _motion(recording, station_sensors, transform, least_order)
    rate_hz, body_stations = recording.rig.sample_rate_hz, tuple(station_sensors)
    forces_n, base = forces_on_bodies(recording)[:, : transform.usable_count], None
    if recording.rig.base_sensors:
        base, body_stations = _measured_base(motion, station_sensors[ON_GROUND], least_order), body_stations[1:]
        motion = motion.relative_to_base
        forces_n = np.concatenate([forces_n, -base.acceleration_m_per_s2[None]])
    displacement, velocity, acceleration = motion.derivatives
    return Kinematics(
        stations=body_stations,
        channels=motion.channels,
        sensors=tuple(_nearest_sensor(station_sensors[station], 2) for station in body_stations),
        displacement_sensors=tuple(_nearest_sensor(station_sensors[station], 0) for station in body_stations),
        sample_rate_hz=rate_hz,
        trusted_hz=(corner_hz if integrates else 0.0, PASSBAND * rate_hz),
        zero_known=not integrates
        or _is_displacement_zero_known(recording.rig, station_sensors, transform.excited_from),
        forces_n=forces_n,
        displacement_m=displacement,
        velocity_m_per_s=velocity,
        acceleration_m_per_s2=acceleration,
        lost_m_per_s2=motion.lost_m_per_s2,
        excited_from=transform.excited_from,
        start_s=recording.start_s,
        base=base,
    )


def _motion_sensors(recording: Recording, use: MotionQuantity) -> list[Sensor]:
    """Sensors of motion of the quantity in use, those on a shaken base first and of any quantity.

    Raises RigError if there are none.
    """
    base_sensors = recording.rig.base_sensors
    sensors = [s for s in recording.rig.sensors if use in ("auto", s.quantity) and s.measures.translates]
    sensors = [sensor for sensor in sensors if sensor not in base_sensors]
    if not sensors:
        required_text = "sensors of motion" if use == "auto" else f"{use} sensors"
        advice = "; measure accelerations, velocities or displacements" if use == "auto" else ""
        raise RigError(f"the recording has no {required_text}; it has {', '.join(sorted(recording.signals))}{advice}")
    return [*base_sensors, *sensors]


def _sensors_by_station(sensors: list[Sensor]) -> SensorsByStation:
    """Sensors by station and order of the derivative."""
    by_station: SensorsByStation = {}
    for sensor in sensors:
        by_station.setdefault(sensor.station, {})[sensor.measures.order] = sensor
    return by_station


def _transform(recording: Recording, sensors: list[Sensor], corner_hz: float, integrates: bool) -> _PaddedTransform:
    """Padded transform of the record.

    Raises RigError if the record is too short.
    """
    rate_hz, sample_count = recording.rig.sample_rate_hz, recording.samples
    unusable_s = TAPER_S + (2 / corner_hz if integrates else 0.1)
    usable_count = sample_count - round(unusable_s * rate_hz)
    if usable_count < sample_count / 2:
        raise RigError(
            f"the record lasts {recording.duration_s:.3g} s, of which {unusable_s:.3g} s at its end cannot be used; "
            "record longer or raise the corner frequency"
        )
    end_taper = taper(sample_count, round(TAPER_S * rate_hz))
    if recording.start_s > 0:
        end_taper = end_taper * end_taper[::-1]
    padded_count = scipy.fft.next_fast_len(sample_count + round(2 * unusable_s * rate_hz), real=True)
    channel_signals = (recording.values_of(sensor) for sensor in sensors)
    excited_from = excitation_start(excitations(recording), channel_signals, rate_hz)
    return _PaddedTransform(
        corner_hz=corner_hz,
        end_taper=end_taper,
        padded_count=padded_count,
        omega=2 * np.pi * np.fft.rfftfreq(padded_count, 1 / rate_hz),
        usable_count=usable_count,
        excited_from=excited_from,
        lead_samples=0 if excited_from or recording.start_s > 0 else round(TAPER_S * rate_hz),
    )


def _motion(recording: Recording, sensors: SensorsByStation, transform: _PaddedTransform, least_order: int) -> _Motion:
    """Motion of every station in time, from the orders `least_order` to 2."""
    omega, corner_hz = transform.omega, transform.corner_hz
    factor_of_power = cache(lambda power: omega_power(omega, power, corner_hz))
    low_pass = 1 - _high_pass(omega, corner_hz)
    contact_places = {ON_GROUND, *(s for contact in recording.rig.contacts for s in contact_stations(contact))}
    derivatives = tuple(
        np.empty((len(sensors) if order >= least_order else 0, transform.usable_count)) for order in range(3)
    )
    lost_m_per_s2 = np.zeros((len(sensors), transform.usable_count))
    channels: dict[str, None] = {}
    for row, (station, sensor_by_order) in enumerate(sensors.items()):
        spectra: dict[tuple[str, int], Complex[np.ndarray, " lines"]] = {}
        for order in range(least_order, 3):
            sensor = _nearest_sensor(sensor_by_order, order)
            differentiations = order - sensor.measures.order
            # nothing may precede the record in an integral
            lead_samples = transform.lead_samples if differentiations > 0 else 0
            if (key := (sensor.name, lead_samples)) not in spectra:
                spectra[key] = transform.spectrum(sensor, recording.values_of(sensor), lead_samples)
            spectrum = spectra[key] * factor_of_power(differentiations)
            derivatives[order][row] = transform.usable_samples(spectrum)
            channels[sensor.name] = None
        if station in contact_places and 0 not in sensor_by_order:  # the spectrum is the acceleration's
            lost_m_per_s2[row] = transform.usable_samples(spectrum * low_pass)
    return _Motion(derivatives, lost_m_per_s2, tuple(channels))


def _is_displacement_zero_known(rig: Rig, station_sensors: SensorsByStation, excited_from: int) -> bool:
    """True if displacements are measured at both sides of every contact, in a record that begins at rest."""
    contact_sides = {side for contact in rig.contacts for side in contact_stations(contact)}
    contact_sides |= {ON_GROUND} if rig.base_sensors else set()
    return bool(rig.contacts) and excited_from > 0 and all(0 in station_sensors.get(side, {}) for side in contact_sides)


def _measured_base(motion: _Motion, by_order: dict[int, Sensor], least_order: int) -> MeasuredBase:
    """Motion of the base, the first of the stations; no displacement where it is left out."""
    station_displacements, _, station_accelerations = motion.derivatives
    return MeasuredBase(
        sensor=_nearest_sensor(by_order, 2),
        displacement_sensor=_nearest_sensor(by_order, 0),
        displacement_m=np.empty(0) if least_order else station_displacements[0],
        acceleration_m_per_s2=station_accelerations[0],
        lost_m_per_s2=motion.lost_m_per_s2[0],
    )


def _nearest_sensor(by_order: dict[int, Sensor], derivative_order: int) -> Sensor:
    """Sensor of this derivative, else one that needs differentiation, else one that needs integration."""

    def distance(sensor: Sensor) -> int:
        missing_orders = derivative_order - sensor.measures.order
        return missing_orders if missing_orders >= 0 else 10 - missing_orders

    return min(by_order.values(), key=distance)


def omega_power(omega: Float[np.ndarray, " lines"], exponent: int, corner_hz: float) -> Complex[np.ndarray, " lines"]:
    """(i omega)^exponent; a negative exponent integrates, with a high-pass from half the corner to the corner."""
    if exponent >= 0:
        return np.asarray((1j * omega) ** exponent)
    nonzero_omega = np.where(omega > 0, omega, 1.0)
    return np.asarray(_high_pass(omega, corner_hz) * (1j * nonzero_omega) ** exponent)


def _high_pass(omega: Float[np.ndarray, " lines"], corner_hz: float) -> Float[np.ndarray, " lines"]:
    """Smooth high-pass: zero below half the corner, one above it."""
    return np.sin(np.pi / 2 * np.clip(2 * omega / (2 * np.pi * corner_hz) - 1, 0, 1)) ** 2


def taper(sample_count: int, fading_samples: int) -> Float[np.ndarray, " samples"]:
    """Weights of one that fall smoothly to zero over the last `fading_samples`."""
    weights, fading_steps = np.ones(sample_count), np.arange(fading_samples) + 1
    weights[sample_count - fading_samples :] = 0.5 * (1 + np.cos(np.pi * fading_steps / fading_samples))
    return weights
