"""From the true motion to what the channels of a recording hold."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from scenarios.worlds.forces import BAND_HZ, LEAD_S, inputs_of, rise
from scenarios.worlds.machine import Accelerometer, Machine
from scenarios.worlds.sampling import Mounting, Sampler
from scenarios.worlds.simulator import STEP_S, model_of, simulate

TAIL_S = 0.02
"""Simulated beyond the record's end, for the filter and early channels."""


@dataclass(frozen=True)
class Measured:
    """A record: the measured force, what the sensors deliver in their order, and what share of time contacts press.

    The sensors deliver accelerations, or displacements in m if they were measured in their place.
    """

    force_n: Float[np.ndarray, " samples"]
    acceleration_m_per_s2: Float[np.ndarray, "sensors samples"]
    closed_fraction: dict[str, float]


def measured(
    machine: Machine,
    rms_n: float,
    quiet_s: float,
    samples: int,
    sample_rate_hz: float,
    seed: int,
    band_hz: tuple[float, float] = BAND_HZ,
    displacements: bool = False,
) -> Measured:
    """One record of the machine under a Gaussian force of this level and band that begins at quiet_s.

    The same seed gives the same force and noise. With `displacements` the sensors give
    those, against the ground. Raises RigError where the machine cannot be simulated.
    """
    factor = round(1 / (STEP_S * sample_rate_hz))
    model = model_of(machine)
    of_force, of_noise = np.random.default_rng(seed).spawn(2)
    delays_s = [machine.cell.delay_s, *(s.delay_s for s in machine.sensors)]
    sampler = Sampler(factor, np.array(delays_s) / STEP_S)
    steps = round((LEAD_S + TAIL_S) / STEP_S) + samples * factor  # the same whatever the delays: so is the force
    duration_s = samples / sample_rate_hz
    inputs = inputs_of(machine, rms_n, quiet_s, duration_s, steps, STEP_S, of_force, band_hz)
    skipped = round(LEAD_S / STEP_S) - sampler.reach
    mountings = {k: Mounting(s.mount_hz, s.mount_damping, STEP_S) for k, s in enumerate(machine.sensors) if s.mount_hz}
    done, closed = 0, np.zeros(len(model.links))
    for block in simulate(model, inputs, -LEAD_S):
        moved = model.sensed @ block.states[:, 0].T if displacements else block.acceleration_m_per_s2
        for k, mounting in mountings.items():
            moved[k] = mounting.follow(moved[k])
        now = slice(done, done + moved.shape[1])
        sampler.add(np.concatenate([inputs[now, :1].T, moved])[:, max(0, skipped - done) :])
        done = now.stop
        closed += block.closed
    force, *motion = sampler.samples()[:, :samples]
    cell = machine.cell
    force = cell.gain * force + _noise(cell.noise_density, samples, sample_rate_hz, of_noise)
    time_s = np.arange(samples) / sample_rate_hz
    sideways = lateral(np.array(motion), machine.sensors, rise(time_s - quiet_s, 0.1), of_noise)
    delivered = [
        _delivered(sensor, row, side, sample_rate_hz, of_noise)
        for sensor, row, side in zip(machine.sensors, motion, sideways, strict=True)
    ]
    shares = {c.name: float(closed[k] / (duration_s / STEP_S)) for k, c in enumerate(machine.contacts)}
    return Measured(force, np.array(delivered), shares)


def lateral(
    motion: Float[np.ndarray, "sensors samples"],
    sensors: tuple[Accelerometer, ...],
    envelope: Float[np.ndarray, " samples"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "sensors samples"]:
    """A lateral motion at every sensor: the spectrum is that of its own, the phases are random, one draw a body."""
    phases = {}
    for body in dict.fromkeys(s.at.body for s in sensors):
        phases[body] = np.exp(2j * np.pi * rng.uniform(size=motion.shape[1] // 2 + 1))
    rows = [
        np.fft.irfft(np.fft.rfft(row) * phases[s.at.body], row.size) * envelope if s.lateral_share else 0.0 * row
        for row, s in zip(motion, sensors, strict=True)
    ]
    return np.array(rows)


def _delivered(
    sensor: Accelerometer,
    motion: Float[np.ndarray, " samples"],
    sideways: Float[np.ndarray, " samples"],
    sample_rate_hz: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, " samples"]:
    """Gain times the motion and a share of the lateral one, through the high-pass of an IEPE amplifier; noise."""
    values = motion + sensor.lateral_share * sideways
    if sensor.highpass_hz:
        corner = np.tan(np.pi * sensor.highpass_hz / sample_rate_hz)  # H(s) = s / (s + w_c) by the bilinear transform
        values = lfilter(np.array([1.0, -1.0]) / (1 + corner), [1.0, (corner - 1) / (corner + 1)], values)
    return sensor.gain * values + _noise(sensor.noise_density, values.size, sample_rate_hz, rng)


def _noise(
    density: float, samples: int, sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    return density * np.sqrt(sample_rate_hz / 2) * rng.standard_normal(samples)
