"""From the true motion to what the channels of a recording hold."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from tests.campaigns.worlds.forces import LEAD_S, Excitation, Release, inputs_of, rise
from tests.campaigns.worlds.machine import Machine, MotionSensor
from tests.campaigns.worlds.sampling import Mounting, Sampler
from tests.campaigns.worlds.simulator import STEP_S, SimulatedBlock, at_rest, model_of, simulate

ORDERS = ("displacement", "velocity")
TAIL_S, TAIL_SAMPLES = 0.02, 20
"""The longer of both is simulated beyond the record's end, for the filter and early channels."""


@dataclass(frozen=True)
class Measured:
    """A record: the measured force, what the sensors deliver in their order, and what share of time contacts press.

    Of a force that is not measured the channel shows zeros.
    """

    force_n: Float[np.ndarray, " samples"]
    delivered: Float[np.ndarray, "sensors samples"]
    closed_fraction: dict[str, float]


def measured(machine: Machine, excitation: Excitation, samples: int, sample_rate_hz: float, seed: int) -> Measured:
    """One record of the machine; the same seed gives the same force and noise.

    Raises RigError where the machine cannot be simulated.
    """
    factor = round(1 / (STEP_S * sample_rate_hz))
    model = model_of(machine)
    of_force, of_noise = np.random.default_rng(seed).spawn(2)
    delays_s = [machine.cell.delay_s, *(s.delay_s for s in machine.sensors)]
    sampler = Sampler(factor, np.array(delays_s) / STEP_S)
    tail_s = max(TAIL_S, TAIL_SAMPLES / sample_rate_hz)
    steps = round((LEAD_S + tail_s) / STEP_S) + samples * factor  # the same whatever the delays: so is the force
    duration_s = samples / sample_rate_hz
    inputs = inputs_of(machine, excitation, duration_s, steps, STEP_S, of_force)
    force_n = inputs[:, :1].T.copy()
    ground = _ground(inputs[:, -1])
    if machine.cell.base_kg:
        inputs[:, -1] -= inputs[:, 0] / machine.cell.base_kg
        inputs[:, 0] = 0.0
    initial = None
    if isinstance(excitation, Release):
        initial = np.stack([at_rest(model, excitation.held_n), np.zeros(len(model.omega))])
    skipped = round(LEAD_S / STEP_S) - sampler.reach
    mountings = {k: Mounting(s.mount_hz, s.mount_damping, STEP_S) for k, s in enumerate(machine.sensors) if s.mount_hz}
    done, closed = 0, np.zeros(len(model.links))
    for block in simulate(model, inputs, -LEAD_S, initial=initial):
        now = slice(done, done + block.states.shape[0])
        moved = _moved(machine.sensors, model.sensed, block, ground[:, now])
        for k, mounting in mountings.items():
            moved[k] = mounting.follow(moved[k])
        sampler.add(np.concatenate([force_n[:, now], moved])[:, max(0, skipped - done) :])
        done = now.stop
        closed += block.closed * (block.start_s >= 0)
    force, *motion = sampler.samples()[:, :samples]
    cell = machine.cell
    force = cell.gain * force + _noise(cell.noise_density, samples, sample_rate_hz, of_noise)
    time_s = np.arange(samples) / sample_rate_hz
    sideways = lateral(np.array(motion), machine.sensors, rise(time_s - excitation.begins_s, 0.1), of_noise)
    signals = np.array(
        [_signal(s, row, side, sample_rate_hz) for s, row, side in zip(machine.sensors, motion, sideways, strict=True)]
    )
    noise = [_noise(s.noise_density, samples, sample_rate_hz, of_noise) for s in machine.sensors]
    shares = {c.name: float(closed[k] / (duration_s / STEP_S)) for k, c in enumerate(machine.contacts)}
    shown = force if excitation.measured else np.zeros(samples)
    return Measured(shown, _with_crosstalk(signals, machine.sensors) + np.array(noise), shares)


def _ground(acceleration_m_per_s2: Float[np.ndarray, " steps"]) -> Float[np.ndarray, "2 steps"]:
    """Displacement and velocity of the ground in the frame of its mean motion."""
    velocity = STEP_S * cumulative_trapezoid(acceleration_m_per_s2, initial=0.0)
    velocity -= velocity.mean()
    displacement = STEP_S * cumulative_trapezoid(velocity, initial=0.0)
    return np.array([displacement - displacement.mean(), velocity])


def _moved(
    sensors: tuple[MotionSensor, ...],
    sensed: Float[np.ndarray, "sensors coordinates"],
    block: SimulatedBlock,
    ground: Float[np.ndarray, "2 steps"],
) -> Float[np.ndarray, "sensors steps"]:
    """What each sensor is there to measure of a block's motion."""
    moved = block.acceleration_m_per_s2
    for k, sensor in enumerate(sensors):
        if sensor.quantity != "acceleration":
            order = ORDERS.index(sensor.quantity)
            moved[k] = block.states[:, order] @ sensed[k] + ground[order]
    return moved


def lateral(
    motion: Float[np.ndarray, "sensors samples"],
    sensors: tuple[MotionSensor, ...],
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


def _signal(
    sensor: MotionSensor,
    motion: Float[np.ndarray, " samples"],
    sideways: Float[np.ndarray, " samples"],
    sample_rate_hz: float,
) -> Float[np.ndarray, " samples"]:
    """Gain times the motion and a share of the lateral one, through the high-pass of an IEPE amplifier."""
    values = motion + sensor.lateral_share * sideways
    if sensor.highpass_hz:
        corner = np.tan(np.pi * sensor.highpass_hz / sample_rate_hz)  # H(s) = s / (s + w_c) by the bilinear transform
        values = lfilter(np.array([1.0, -1.0]) / (1 + corner), [1.0, (corner - 1) / (corner + 1)], values)
    return np.asarray(sensor.gain * values)


def _with_crosstalk(
    signals: Float[np.ndarray, "sensors samples"], sensors: tuple[MotionSensor, ...]
) -> Float[np.ndarray, "sensors samples"]:
    """Every signal with what leaks into it from the channels before and after it."""
    mixed = signals.copy()
    for k, sensor in enumerate(sensors):
        for share, beside in zip(sensor.crosstalk, (k - 1, k + 1), strict=True):
            if share and 0 <= beside < len(sensors):
                mixed[k] += share * signals[beside]
    return mixed


def _noise(
    density: float, samples: int, sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    return density * np.sqrt(sample_rate_hz / 2) * rng.standard_normal(samples)
