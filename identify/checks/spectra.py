"""Spectra of sensors and forces on some lines of the record."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from identify.signals.beginning import QUIET_S, force_begins
from identify.signals.kinematics import TAPER_S, taper
from identify.signals.spectra import force_band
from rig.errors import RigError
from rig.model.description import Sensor, force_names
from rig.model.sensing import PASSBAND
from rig.recording import Recording

LOWEST_HZ = 2.0
"""Below, accelerometers are drift and AC coupling."""
TO_FORCE = 2.0
"""Lines up to this multiple of the force's highest frequency are compared."""
RING_S, CUT_S = 4.0, 2.5
"""Silence behind the record; what of its end is not compared, as the ringing is cut off there."""
LINES = 1600
SMOOTHED = 41
"""Levels are means over so many lines."""


@dataclass(frozen=True)
class Spectra:
    """Sensors' spectra as accelerations: gain, delay and derivative of each chain are divided out.

    noise is the standard deviation of a line of each sensor's noise, in the same unit. lines are their numbers in the
    transform of `length` samples; taken_s is the time from the force's begin until the beams' ringing is cut off.
    """

    sensors: tuple[Sensor, ...]
    omega: Float[np.ndarray, " lines"]
    acceleration: Complex[np.ndarray, "sensors lines"]
    forces: Complex[np.ndarray, "forces lines"]
    noise: Float[np.ndarray, "sensors lines"]
    lines: Int[np.ndarray, " lines"]
    length: int
    taken_s: tuple[float, float]
    sample_rate_hz: float

    @cached_property
    def level(self) -> Float[np.ndarray, "sensors lines"]:
        """Each sensor's root mean square over neighbouring lines."""
        return np.sqrt(uniform_filter1d(np.abs(self.acceleration) ** 2, SMOOTHED, axis=1))

    @property
    def per_s(self) -> float:
        """Samples a second of `in_time`."""
        return 2 * (int(self.lines[-1]) + 1) * self.sample_rate_hz / self.length

    def in_time(self, rows: Complex[np.ndarray, "*some lines"]) -> Float[np.ndarray, "*some times"]:
        """Over the time that is taken, where the lines follow one another; mean squares are those of the lines."""
        high = int(self.lines[-1]) + 1
        whole = np.zeros((*rows.shape[:-1], high + 1), np.complex64)
        whole[..., self.lines] = rows
        found = irfft(whole, 2 * high) * np.sqrt(2 * high**2 / self.lines.size)
        begin, end = (round(at * self.per_s) for at in self.taken_s)
        return np.asarray(found[..., begin:end])

    @property
    def force_names(self) -> tuple[str, ...]:
        return force_names(len(self.forces))

    def with_rows(self, acceleration: Complex[np.ndarray, "sensors lines"]) -> "Spectra":
        return replace(self, acceleration=acceleration)


def spectra_of(recording: Recording, sensors: tuple[Sensor, ...], most: int | None = LINES) -> Spectra:
    """Spectra on at most this many lines (None: all) from 2 Hz to twice the force's highest frequency.

    Raises RigError if the force is zero or its band lies below.
    """
    rate = recording.rig.sample_rate_hz
    forces_n, samples = recording.forces_n, recording.samples
    ending = taper(samples, min(round(TAPER_S * rate), samples // 4))
    length = next_fast_len(samples + round(RING_S * rate), real=True)
    high_hz = min(TO_FORCE * force_band(forces_n, rate)[1], PASSBAND * rate)
    first, last = int(np.ceil(LOWEST_HZ * length / rate)), int(high_hz * length / rate)
    if last - first < SMOOTHED:
        raise RigError("the force's band is too low or too narrow")
    lines = np.arange(first, last, 1 if most is None else max(1, (last - first) // most))
    omega = 2 * np.pi * lines * rate / length
    rows = np.stack([recording.values_of(s) for s in sensors])
    found = rfft(rows * ending, length)[:, lines]
    begun = quiet_samples(forces_n, rate)
    quiet = rows[:, :begun]
    chains = np.stack([chain(s, omega) for s in sensors])
    found *= chains
    if quiet.shape[1]:
        deviation = quiet.std(axis=1)
    else:
        deviation = np.array([s.noise_density * np.sqrt(rate / 2) for s in sensors])
    per_line = np.sqrt(samples) * deviation[:, None] * np.abs(chains)
    taken_s = (begun / rate, max(samples / rate - CUT_S, 0.5 * samples / rate))
    forces = rfft(forces_n * ending, length)[:, lines]
    return Spectra(sensors, omega, found, forces, per_line, lines, length, taken_s, rate)


def chain(sensor: Sensor, omega: Float[np.ndarray, " lines"]) -> Complex[np.ndarray, " lines"]:
    """Chain from what a sensor delivers to the acceleration: (i omega)^(2 - order) over its response."""
    return np.asarray((1j * omega) ** (2 - sensor.measures.order) / sensor.response(omega))


def quiet_samples(force: Float[np.ndarray, "*forces samples"], rate_hz: float) -> int:
    """Count of samples before the force, at least a quarter second; else zero."""
    before = force_begins(force, rate_hz) - round(0.05 * rate_hz)
    return before if before > QUIET_S * rate_hz else 0
