"""Channels from true motion: anti-aliasing, delay, high-pass, gain, noise, range, quantisation."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig, Sensor
from rig.model.quantities import QuantityName
from rig.model.sensing import quantities_of
from rig.simulation.decimation import Decimator, decimated, decimator
from rig.simulation.motion import Motion, Rows

HALF_WIDTH = 16
"""Half the anti-aliasing filter's length, in samples of the recording."""


@dataclass(frozen=True)
class Samples:
    """A segment of a recording: the forces and, per quantity, one row per sensor of that quantity; and the truth."""

    forces_n: Float[np.ndarray, "forces samples"]
    sensed: dict[QuantityName, Float[np.ndarray, "sensors samples"]]
    truth: dict[str, Float[np.ndarray, "rows samples"]]

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Force of a rig with one, N."""
        (only,) = self.forces_n
        return np.asarray(only)


def needed_duration_s(rig: Rig, duration_s: float) -> float:
    """Seconds that a plant must run so that the filter can deliver `duration_s` of samples."""
    return duration_s + (HALF_WIDTH + _longest_delay(rig) + 1) / rig.sample_rate_hz


def digitised(rig: Rig, blocks: Iterator[Motion], rng: np.random.Generator) -> Iterator[Samples]:
    """Samples every channel of the rig at its sampling rate, block by block.

    Each channel is filtered before sampling by a windowed sinc, symmetric about its own delay, so a channel without
    delay shows the motion of its own instant: linear phase, taken out. The truth is sampled as it is. Each sensor has
    its own stream of noise, drawn from `rng`.

    Raises RigError unless the plant's rate is a multiple of the sampling rate.
    """
    streams, forces = rng.spawn(len(rig.sensors)), len(rig.forces)
    filters: list[tuple[list[int], Decimator]] = []
    held, begun = np.zeros((0, 0)), 0
    truth: dict[str, Float[np.ndarray, "rows samples"]] = {}
    high_passes = [_HighPass.of(s, rig.sample_rate_hz) for s in rig.sensors]
    for block in blocks:
        factor, size = _factor(rig, block.step_s), block.forces_n.shape[1]
        reach = (HALF_WIDTH + _longest_delay(rig)) * factor
        if not filters:
            filters = _filters(rig, factor, reach)
            held = np.zeros((forces + len(rig.sensors), reach))  # at rest before the record
        instants = (slice(None), slice(-begun % factor, None, factor))
        begun += size
        fresh = {name: rows[instants] for name, rows in _truth_of(block).items()}
        truth = {name: np.concatenate([truth[name], rows], axis=1) if truth else rows for name, rows in fresh.items()}
        width = held.shape[1] + size
        ready = max(0, (width - 2 * reach - 1) // factor + 1)
        queue = np.empty((len(held), max(width, *(one.reach(ready) for _, one in filters))))
        queue[:, : held.shape[1]] = held
        queue[:forces, held.shape[1] : width] = block.forces_n
        queue[forces:, held.shape[1] : width] = block.sensed
        queue[:, width:] = 0.0
        held = queue[:, ready * factor : width]
        if ready:
            filtered = _filtered(filters, queue, ready)
            for row, high_pass in zip(filtered[forces:], high_passes, strict=True):
                if high_pass:
                    row[:] = high_pass.passed(row)
            sensed = {q: _delivered_all(rig, q, filtered[forces:], streams) for q in quantities_of(rig)}
            yield Samples(filtered[:forces], sensed, {name: rows[:, :ready] for name, rows in truth.items()})
            truth = {name: rows[:, ready:] for name, rows in truth.items()}


@dataclass
class _HighPass:
    """First-order, as an AC-coupled sensor has it; it goes on from block to block."""

    numerator: Float[np.ndarray, " 2"]
    denominator: Float[np.ndarray, " 2"]
    state: Float[np.ndarray, " 1"]

    @classmethod
    def of(cls, sensor: Sensor, sample_rate_hz: float) -> "_HighPass | None":
        if not sensor.high_pass_hz:
            return None
        numerator, denominator = scipy.signal.bilinear(
            [1.0, 0.0], [1.0, 2 * np.pi * sensor.high_pass_hz], sample_rate_hz
        )
        return cls(numerator, denominator, np.zeros(1))

    def passed(self, row: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        values, self.state = scipy.signal.lfilter(self.numerator, self.denominator, row, zi=self.state)
        return np.asarray(values)


def _filters(rig: Rig, factor: int, reach: int) -> list[tuple[list[int], Decimator]]:
    """The filter of every delay, with the rows that it is for: the forces, without delay, then the sensors."""
    delays = [*(0.0 for _ in rig.forces), *(s.delay_s for s in rig.sensors)]
    filters = []
    for delay in dict.fromkeys(delays):
        rows = [k for k, own in enumerate(delays) if own == delay]
        filters.append((rows, decimator(_taps(factor, reach, delay * rig.sample_rate_hz), factor)))
    return filters


def _filtered(
    filters: list[tuple[list[int], Decimator]], queue: Float[np.ndarray, "rows steps"], samples: int
) -> Float[np.ndarray, "rows samples"]:
    if len(filters) == 1:
        return decimated(filters[0][1], queue, samples)
    filtered = np.empty((len(queue), samples))
    for rows, one in filters:
        filtered[rows] = decimated(one, queue[rows], samples)
    return filtered


def _delivered_all(
    rig: Rig,
    quantity: QuantityName,
    filtered: Float[np.ndarray, "sensors samples"],
    streams: list[np.random.Generator],
) -> Float[np.ndarray, "some samples"]:
    return np.stack(
        [
            _delivered(sensor, row, rig.sample_rate_hz, stream)
            for sensor, row, stream in zip(rig.sensors, filtered, streams, strict=True)
            if sensor.quantity == quantity
        ]
    )


def _delivered(
    sensor: Sensor, motion: Float[np.ndarray, " samples"], sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    noise = sensor.noise_density * np.sqrt(sample_rate_hz / 2)
    values = sensor.gain * motion + (noise * rng.standard_normal(motion.size) if noise else 0.0)
    if sensor.measuring_range is not None:
        values = np.clip(values, -sensor.measuring_range, sensor.measuring_range)
        if sensor.bits is not None:
            step = 2 * sensor.measuring_range / 2**sensor.bits
            values = np.round(values / step) * step
    return values


def _taps(factor: int, reach: int, delay_samples: float) -> Float[np.ndarray, " taps"]:
    """Windowed sinc at the plant's rate, cut off at half the sampling rate, centred `delay_samples` late."""
    time = np.arange(-reach, reach + 1) / factor - delay_samples
    half = HALF_WIDTH + 0.5 / factor
    inside = np.abs(time) < half
    window = np.zeros(time.size)
    grid = np.linspace(-half, half, 4096)
    window[inside] = np.interp(time[inside], grid, scipy.signal.windows.kaiser(grid.size, 10.0))
    taps = window * np.sinc(time)
    if factor == 1 and delay_samples == 0:
        return (time == 0).astype(float)
    return taps / taps.sum()


def _factor(rig: Rig, step_s: float) -> int:
    factor = round(1 / (step_s * rig.sample_rate_hz))
    if factor < 1 or abs(factor * step_s * rig.sample_rate_hz - 1) > 1e-9:
        raise RigError(
            f"sample_rate_hz is {rig.sample_rate_hz} and the plant's step {step_s} s; "
            "1/step must be a whole multiple of the sampling rate"
        )
    return factor


def _longest_delay(rig: Rig) -> int:
    return int(np.ceil(max((abs(s.delay_s) for s in rig.sensors), default=0.0) * rig.sample_rate_hz))


def _truth_of(block: Motion) -> dict[str, Rows]:
    return {
        "displacement": block.displacement_m,
        "relative_displacement": block.eta_m,
        "contact_force": block.contact_force_n,
    }
