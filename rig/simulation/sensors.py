"""Channels from true motion: anti-aliasing and decimation, delay, high-pass, gain, noise, range, quantisation."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig, Sensor
from rig.model.quantities import QuantityName
from rig.model.sensing import quantities_of
from rig.simulation.motion import Motion, SignalRows

HALF_WIDTH = 16
"""Half the anti-aliasing filter's length, in samples of the recording."""
BLOCK_OUTPUTS = 16
"""Output samples per block: half the length of the sensors' filter, so that three products cover it."""


@dataclass(frozen=True)
class Decimator:
    """y[n] = sum_k h[k] x[n factor + start + k], in blocks of BLOCK_OUTPUTS: y_b = sum_i T_i' x_(b+i).

    x_b are the factor BLOCK_OUTPUTS samples of x from start + b factor BLOCK_OUTPUTS on; `pieces` are the T_i abreast,
    each a slice of the Toeplitz matrix of h.
    """

    start: int
    pieces: Float[np.ndarray, "long together_times_pieces"]

    @property
    def count(self) -> int:
        """Number of the T_i."""
        return self.pieces.shape[1] // BLOCK_OUTPUTS

    def reach(self, samples: int) -> int:
        """Samples of x spanned by the blocks of `samples` outputs; those behind the last tap are multiplied by 0."""
        return self.start + (-(-samples // BLOCK_OUTPUTS) + self.count - 1) * len(self.pieces)


def decimator(taps: Float[np.ndarray, " taps"], factor: int) -> Decimator:
    """Decimator of y[n] = sum_k taps[k] x[n factor + size - 1 - k], with full overlap of taps and x for every n.

    Zero taps at either end cost nothing.
    """
    nonzero = np.flatnonzero(taps[::-1])
    start = int(nonzero[0]) if nonzero.size else 0
    response = taps[::-1][start : int(nonzero[-1]) + 1] if nonzero.size else np.zeros(1)
    block_inputs = factor * BLOCK_OUTPUTS
    count = -(-(block_inputs - factor + response.size) // block_inputs)
    toeplitz = np.zeros((count * block_inputs, BLOCK_OUTPUTS))
    for n in range(BLOCK_OUTPUTS):
        toeplitz[n * factor : n * factor + response.size, n] = response
    return Decimator(start, np.concatenate(np.split(toeplitz, count), axis=1))


def decimated(
    filter_: Decimator, signals: Float[np.ndarray, "rows long"], samples: int
) -> Float[np.ndarray, "rows samples"]:
    """First `samples` filtered samples of every row; rows must hold at least `filter_.reach(samples)`."""
    row_count, count = len(signals), filter_.count
    blocks = signals[:, filter_.start : filter_.reach(samples)].reshape(row_count, -1, len(filter_.pieces))
    products = (blocks @ filter_.pieces).reshape(row_count, blocks.shape[1], count, BLOCK_OUTPUTS)
    blocks_out = blocks.shape[1] - count + 1
    filtered = products[:, :blocks_out, 0].copy()
    for i in range(1, count):
        filtered += products[:, i : blocks_out + i, i]
    return filtered.reshape(row_count, -1)[:, :samples]


@dataclass(frozen=True)
class Samples:
    """Samples of a segment: forces, signals by quantity with a row per sensor, and the truth."""

    forces_n: Float[np.ndarray, "forces samples"]
    sensed: dict[QuantityName, Float[np.ndarray, "sensors samples"]]
    truth: dict[str, Float[np.ndarray, "rows samples"]]

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Force of a rig with a single force, N."""
        (only,) = self.forces_n
        return np.asarray(only)


def needed_duration_s(rig: Rig, duration_s: float) -> float:
    """Duration that a plant must run for the filter to deliver `duration_s` of samples, s."""
    return duration_s + (HALF_WIDTH + _longest_delay(rig) + 1) / rig.sample_rate_hz


def digitised(rig: Rig, blocks: Iterator[Motion], rng: np.random.Generator) -> Iterator[Samples]:
    """Sample every channel of the rig at its sampling rate, block by block.

    Each channel is filtered before sampling by a windowed sinc, symmetric about its own delay, so a channel without
    delay shows the motion of its own instant: linear phase, taken out. The truth is sampled as it is. Each sensor has
    its own stream of noise, drawn from `rng`.

    Raises RigError unless the plant's rate is a multiple of the sampling rate.
    """
    streams, force_count = rng.spawn(len(rig.sensors)), len(rig.forces)
    filters: list[tuple[list[int], Decimator]] = []
    kept_steps, steps_done = np.zeros((0, 0)), 0
    truth: dict[str, Float[np.ndarray, "rows samples"]] = {}
    high_passes = [_HighPass.of(s, rig.sample_rate_hz) for s in rig.sensors]
    for block in blocks:
        factor, size = _factor(rig, block.step_s), block.forces_n.shape[1]
        reach = (HALF_WIDTH + _longest_delay(rig)) * factor
        if not filters:
            filters = _filters(rig, factor, reach)
            kept_steps = np.zeros((force_count + len(rig.sensors), reach))  # at rest before the record
        instants = (slice(None), slice(-steps_done % factor, None, factor))
        steps_done += size
        fresh = {name: rows[instants] for name, rows in _truth_of(block).items()}
        truth = {name: np.concatenate([truth[name], rows], axis=1) if truth else rows for name, rows in fresh.items()}
        width = kept_steps.shape[1] + size
        ready = max(0, (width - 2 * reach - 1) // factor + 1)
        queue = np.empty((len(kept_steps), max(width, *(filter_.reach(ready) for _, filter_ in filters))))
        queue[:, : kept_steps.shape[1]] = kept_steps
        queue[:force_count, kept_steps.shape[1] : width] = block.forces_n
        queue[force_count:, kept_steps.shape[1] : width] = block.sensed
        queue[:, width:] = 0.0
        kept_steps = queue[:, ready * factor : width]
        if ready:
            filtered = _filtered(filters, queue, ready)
            for row, high_pass in zip(filtered[force_count:], high_passes, strict=True):
                if high_pass:
                    row[:] = high_pass.passed(row)
            sensed = {q: _delivered_all(rig, q, filtered[force_count:], streams) for q in quantities_of(rig)}
            yield Samples(filtered[:force_count], sensed, {name: rows[:, :ready] for name, rows in truth.items()})
            truth = {name: rows[:, ready:] for name, rows in truth.items()}


@dataclass
class _HighPass:
    """First-order high-pass of an AC-coupled sensor, with its state from block to block."""

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
    """Filter of every delay with the rows that it applies to: the forces, without delay, then the sensors."""
    delays = [*(0.0 for _ in rig.forces), *(s.delay_s for s in rig.sensors)]
    filters = []
    for delay in dict.fromkeys(delays):
        rows = [k for k, row_delay in enumerate(delays) if row_delay == delay]
        filters.append((rows, decimator(_taps(factor, reach, delay * rig.sample_rate_hz), factor)))
    return filters


def _filtered(
    filters: list[tuple[list[int], Decimator]], queue: Float[np.ndarray, "rows steps"], samples: int
) -> Float[np.ndarray, "rows samples"]:
    if len(filters) == 1:
        return decimated(filters[0][1], queue, samples)
    filtered = np.empty((len(queue), samples))
    for rows, filter_ in filters:
        filtered[rows] = decimated(filter_, queue[rows], samples)
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


def _truth_of(block: Motion) -> dict[str, SignalRows]:
    return {
        "displacement": block.displacement_m,
        "relative_displacement": block.eta_m,
        "contact_force": block.contact_force_n,
    }
