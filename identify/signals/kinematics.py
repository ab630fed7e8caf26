"""From what was measured at a station to its displacement, velocity and acceleration."""

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft, next_fast_len, rfft

from identify.signals.beginning import QUIET_S, at_rest_until, led_in
from rig.errors import RigError
from rig.model.description import Sensor, Station, contact_stations
from rig.model.quantities import QUANTITIES
from rig.model.sensing import PASSBAND
from rig.recording import Recording

TAPER_S = 0.5
PASSED = 0.05
"""Of the corner of a sensor's high-pass: what is lower is lost."""
CORNER_HZ = 0.5
"""Below this an integrated acceleration is drift; it is cut off smoothly between half of it and itself."""

if TYPE_CHECKING:
    Use = str
else:
    Use = Literal["auto", *(name for name, quantity in QUANTITIES.items() if quantity.translates)]
"""Sensors of the motion; the bending that strain gauges show is not used."""


@dataclass(frozen=True)
class Kinematics:
    """Motion of every station on one clock, from the first sample on; the record's end is left out.

    sensors tells which sensor gave the acceleration of each station, and displaced_by which gave its displacement.
    trusted_hz is the band in which every row is right. zero_known says whether a constant displacement is seen.
    lost is the slow part of the acceleration that an integrated displacement at a contact lacks; zero elsewhere.
    excited_from is the first sample at which the force has begun; 0 of a record without a quiet start. start_s is the
    time of the first sample in the record.
    """

    stations: tuple[Station, ...]
    channels: tuple[str, ...]
    sensors: tuple[Sensor, ...]
    displaced_by: tuple[Sensor, ...]
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

    def time_s(self, samples: int, factor: int = 1) -> Float[np.ndarray, " samples"]:
        """When every `factor`-th of the first samples was taken."""
        return self.start_s + np.arange(samples) * factor / self.sample_rate_hz

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Of a rig with one."""
        (only,) = self.forces_n
        return np.asarray(only)

    @property
    def samples(self) -> int:
        return self.forces_n.shape[1]

    @property
    def quiet_samples(self) -> int:
        """So many at the start tell the noise; 0 where they are too few."""
        before = self.excited_from - round(0.05 * self.sample_rate_hz)
        return before if before > QUIET_S * self.sample_rate_hz else 0

    def row(self, station: Station) -> int | None:
        return self.stations.index(station) if station in self.stations else None

    def part(self, now: slice) -> "Kinematics":
        """Some of the samples."""
        return replace(
            self,
            forces_n=self.forces_n[:, now],
            displacement_m=self.displacement_m[:, now],
            velocity_m_per_s=self.velocity_m_per_s[:, now],
            acceleration_m_per_s2=self.acceleration_m_per_s2[:, now],
            lost_m_per_s2=self.lost_m_per_s2[:, now],
            excited_from=max(0, self.excited_from - (now.start or 0)),
            start_s=self.start_s + (now.start or 0) / self.sample_rate_hz,
        )

    @property
    def without_rows(self) -> "Kinematics":
        """With no station's motion, which takes much memory."""
        none = np.empty((0, self.samples))
        return replace(self, displacement_m=none, velocity_m_per_s=none, acceleration_m_per_s2=none, lost_m_per_s2=none)


def kinematics(
    recording: Recording, use: Use = "auto", corner_hz: float = CORNER_HZ, least_order: int = 0
) -> Kinematics:
    """Displacement, velocity and acceleration at every station with a sensor.

    In the frequency domain, with the end of the record tapered off: each sensor's gain and delay are divided out, and
    what was not measured is had by multiplication with powers of i omega. Integration is cut off smoothly below the
    corner. Each motion comes from the sensor that measured it, else from the nearest one that needs no integration.
    `use` takes the sensors of one quantity only. A segment of a longer record is tapered off at its start too, and is
    wrong there. Where a record does not begin at rest, its point reflection leads it in before it is differentiated.
    Derivatives below the least order are left out: they take memory.

    Raises RigError if no such sensor is there, or the record is too short for its ends to be left out.
    """
    rig, rate = recording.rig, recording.rig.sample_rate_hz
    sensors = [s for s in rig.sensors if use in ("auto", s.quantity) and s.measures.translates]
    if not sensors:
        wanted = "sensors of motion" if use == "auto" else f"{use} sensors"
        instead = "; measure accelerations, velocities or displacements" if use == "auto" else ""
        raise RigError(f"the recording has no {wanted}; it has {', '.join(sorted(recording.signals))}{instead}")
    stations = tuple(dict.fromkeys(s.station for s in sensors))
    chosen = {s: {sensor.measures.order: sensor for sensor in sensors if sensor.station == s} for s in stations}
    integrates = any(0 not in have for have in chosen.values())
    left_out = TAPER_S + (2 / corner_hz if integrates else 0.1)
    usable = recording.samples - round(left_out * rate)
    if usable < recording.samples / 2:
        raise RigError(
            f"the record lasts {recording.duration_s:.3g} s, of which {left_out:.3g} s at its end cannot be used; "
            "record longer or raise the corner frequency"
        )
    ending = taper(recording.samples, round(TAPER_S * rate))
    if recording.start_s > 0:
        ending = ending * ending[::-1]
    # silence behind the record, as the Fourier transform wraps its end, which integration falsifies, round to its start
    length = next_fast_len(recording.samples + round(2 * left_out * rate), real=True)
    omega = 2 * np.pi * np.fft.rfftfreq(length, 1 / rate)
    moved_by = [np.empty((len(stations) if order >= least_order else 0, usable)) for order in range(3)]
    lost = np.zeros((len(stations), usable))
    channels: dict[str, None] = {}
    at_contacts = {s for c in rig.contacts for s in contact_stations(c)}
    excited_from = at_rest_until(recording.forces_n, (_channel(recording, s) for s in sensors), rate)
    lead = 0 if excited_from or recording.start_s > 0 else round(TAPER_S * rate)
    below = 1 - _high_pass(omega, corner_hz)
    powers = cache(lambda power: integrated(omega, power, corner_hz))
    for row, station in enumerate(stations):
        spectra: dict[tuple[str, int], Complex[np.ndarray, " lines"]] = {}
        for order, motion in list(enumerate(moved_by))[least_order:]:
            sensor = _nearest(chosen[station], order)
            own = lead if order > sensor.measures.order else 0  # of an integral nothing may come before the record
            if (sensor.name, own) not in spectra:
                delivered = _channel(recording, sensor) * ending
                spectra[sensor.name, own] = _undone(sensor, delivered, omega, length, own)
            moved = spectra[sensor.name, own] * powers(order - sensor.measures.order)
            motion[row] = irfft(moved, length)[:usable]
        channels |= dict.fromkeys(name for name, _ in spectra)
        if station in at_contacts and 0 not in chosen[station]:  # the last sensor gave the acceleration
            lost[row] = irfft(moved * below, length)[:usable]
    return Kinematics(
        stations=stations,
        channels=tuple(channels),
        sensors=tuple(_nearest(chosen[s], 2) for s in stations),
        displaced_by=tuple(_nearest(chosen[s], 0) for s in stations),
        sample_rate_hz=rate,
        trusted_hz=(corner_hz if integrates else 0.0, PASSBAND * rate),
        zero_known=not integrates,
        forces_n=recording.forces_n[:, :usable],
        displacement_m=moved_by[0],
        velocity_m_per_s=moved_by[1],
        acceleration_m_per_s2=moved_by[2],
        lost_m_per_s2=lost,
        excited_from=excited_from,
        start_s=recording.start_s,
    )


def _nearest(have: dict[int, Sensor], order: int) -> Sensor:
    """The sensor of this derivative, else one that needs differentiating, else one that needs integrating."""

    def cost(sensor: Sensor) -> int:
        lacking = order - sensor.measures.order
        return lacking if lacking >= 0 else 10 - lacking

    return min(have.values(), key=cost)


def _channel(recording: Recording, sensor: Sensor) -> Float[np.ndarray, " samples"]:
    signals = recording.signals[sensor.quantity]
    return signals.values[signals.channels.names.index(sensor.name)]


def _undone(
    sensor: Sensor, delivered: Float[np.ndarray, " samples"], omega: Float[np.ndarray, " lines"], length: int, lead: int
) -> Complex[np.ndarray, " lines"]:
    """The spectrum of the motion that made the sensor deliver this: its chain taken out, where it lets anything pass.

    Before the first sample, at the end of what the transform sees, so many samples of a lead-in.
    """
    padded = np.zeros(length)
    padded[: delivered.size] = delivered
    if lead:
        padded[-lead:] = led_in(delivered, lead)
    passes = omega >= PASSED * 2 * np.pi * sensor.high_pass_hz
    return np.divide(rfft(padded), sensor.response(omega), out=np.zeros(omega.size, dtype=complex), where=passes)


def integrated(omega: Float[np.ndarray, " lines"], power: int, corner_hz: float) -> Complex[np.ndarray, " lines"]:
    """(i omega)^power; a negative power integrates: zero below half the corner and whole from the corner on."""
    if power >= 0:
        return np.asarray((1j * omega) ** power)
    safe = np.where(omega > 0, omega, 1.0)
    return np.asarray(_high_pass(omega, corner_hz) * (1j * safe) ** power)


def _high_pass(omega: Float[np.ndarray, " lines"], corner_hz: float) -> Float[np.ndarray, " lines"]:
    return np.sin(np.pi / 2 * np.clip(2 * omega / (2 * np.pi * corner_hz) - 1, 0, 1)) ** 2


def taper(samples: int, fall: int) -> Float[np.ndarray, " samples"]:
    """One, falling smoothly to zero over the last `fall` samples."""
    weights = np.ones(samples)
    weights[samples - fall :] = 0.5 * (1 + np.cos(np.pi * (np.arange(fall) + 1) / fall))
    return weights
