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

FILTER_HALF_WIDTH_SAMPLES = 16
"""Half the anti-aliasing filter's length, in samples of the recording."""
BLOCK_OUTPUTS = 16
"""Output samples per block: half the length of the sensors' filter, so that three products cover it."""


@dataclass(frozen=True)
class Decimator:
    """y[n] = sum_k h[k] x[n factor + start + k], in blocks of BLOCK_OUTPUTS: y_b = sum_i T_i' x_(b+i).

    x_b are the factor BLOCK_OUTPUTS samples of x from start + b factor BLOCK_OUTPUTS on, start is `first_tap`;
    `toeplitz_pieces` are the T_i abreast, each a slice of the Toeplitz matrix of h.
    """

    first_tap: int
    toeplitz_pieces: Float[np.ndarray, "long together_times_pieces"]

    @property
    def piece_count(self) -> int:
        """Number of the T_i."""
        return self.toeplitz_pieces.shape[1] // BLOCK_OUTPUTS

    def reach(self, output_count: int) -> int:
        """Samples of x spanned by the blocks of `output_count` outputs; those behind the last tap count as 0."""
        return self.first_tap + (-(-output_count // BLOCK_OUTPUTS) + self.piece_count - 1) * len(self.toeplitz_pieces)


def decimator(taps: Float[np.ndarray, " taps"], factor: int) -> Decimator:
    """Decimator of y[n] = sum_k taps[k] x[n factor + size - 1 - k], with full overlap of taps and x for every n.

    Zero taps at either end cost nothing.
    """
    nonzero_taps = np.flatnonzero(taps[::-1])
    first_tap = int(nonzero_taps[0]) if nonzero_taps.size else 0
    trimmed_response = taps[::-1][first_tap : int(nonzero_taps[-1]) + 1] if nonzero_taps.size else np.zeros(1)
    block_input_count = factor * BLOCK_OUTPUTS
    piece_count = -(-(block_input_count - factor + trimmed_response.size) // block_input_count)
    toeplitz = np.zeros((piece_count * block_input_count, BLOCK_OUTPUTS))
    for output_index in range(BLOCK_OUTPUTS):
        toeplitz[output_index * factor : output_index * factor + trimmed_response.size, output_index] = trimmed_response
    return Decimator(first_tap, np.concatenate(np.split(toeplitz, piece_count), axis=1))


def decimate(
    delay_filter: Decimator, rows: Float[np.ndarray, "rows long"], output_count: int
) -> Float[np.ndarray, "rows samples"]:
    """First `output_count` filtered samples of every row; rows hold at least `delay_filter.reach(output_count)`."""
    row_count, piece_count, pieces = len(rows), delay_filter.piece_count, delay_filter.toeplitz_pieces
    inputs = rows[:, delay_filter.first_tap : delay_filter.reach(output_count)].reshape(row_count, -1, len(pieces))
    block_products = (inputs @ pieces).reshape(row_count, inputs.shape[1], piece_count, BLOCK_OUTPUTS)
    block_count = inputs.shape[1] - piece_count + 1
    output_blocks = block_products[:, :block_count, 0].copy()
    for piece_index in range(1, piece_count):
        output_blocks += block_products[:, piece_index : block_count + piece_index, piece_index]
    return output_blocks.reshape(row_count, -1)[:, :output_count]


@dataclass(frozen=True)
class Samples:
    """Samples of a segment: forces, signals by quantity with a row per sensor, and the truth."""

    forces_n: Float[np.ndarray, "forces samples"]
    sensed: dict[QuantityName, Float[np.ndarray, "sensors samples"]]
    truth: dict[str, Float[np.ndarray, "rows samples"]]

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Force of a rig with a single force, N."""
        (single_force_n,) = self.forces_n
        return np.asarray(single_force_n)


def plant_run_duration_s(rig: Rig, duration_s: float) -> float:
    """Duration that a plant must run for the filter to deliver `duration_s` of samples, s."""
    return duration_s + (FILTER_HALF_WIDTH_SAMPLES + _longest_delay_samples(rig) + 1) / rig.sample_rate_hz


def digitise(rig: Rig, blocks: Iterator[Motion], rng: np.random.Generator) -> Iterator[Samples]:
    """Sample every channel of the rig at its sampling rate, block by block.

    Each channel is filtered before sampling by a windowed sinc, symmetric about its own delay, so a channel without
    delay shows the motion of its own instant: linear phase, taken out. The truth is sampled as it is. Each sensor has
    its own stream of noise, drawn from `rng`.

    Raises RigError unless the plant's rate is a multiple of the sampling rate.
    """
    noise_streams, force_count = rng.spawn(len(rig.sensors)), len(rig.forces)
    delay_filters: list[tuple[list[int], Decimator]] = []
    waiting_steps, earlier_step_count = np.zeros((0, 0)), 0
    truth_values: dict[str, Float[np.ndarray, "rows samples"]] = {}
    high_passes = [_HighPass.of(sensor, rig.sample_rate_hz) for sensor in rig.sensors]
    for block in blocks:
        steps_per_sample, block_step_count = _steps_per_sample(rig, block.step_s), block.forces_n.shape[1]
        reach_steps = (FILTER_HALF_WIDTH_SAMPLES + _longest_delay_samples(rig)) * steps_per_sample
        if not delay_filters:
            delay_filters = _delay_filters(rig, steps_per_sample, reach_steps)
            waiting_steps = np.zeros((force_count + len(rig.sensors), reach_steps))  # at rest before the record
            if rig.gravity_m_per_s2:  # where its weight bends it
                waiting_steps[force_count:] = block.sensed[:, :1]
        sample_columns = (slice(None), slice(-earlier_step_count % steps_per_sample, None, steps_per_sample))
        earlier_step_count += block_step_count
        new_truth = {name: rows[sample_columns] for name, rows in _truth_of(block).items()}
        truth_values = {
            name: np.concatenate([truth_values[name], rows], axis=1) if truth_values else rows
            for name, rows in new_truth.items()
        }
        queued_step_count = waiting_steps.shape[1] + block_step_count
        new_sample_count = max(0, (queued_step_count - 2 * reach_steps - 1) // steps_per_sample + 1)
        input_span_count = max(delay_filter.reach(new_sample_count) for _, delay_filter in delay_filters)
        step_queue = np.empty((len(waiting_steps), max(queued_step_count, input_span_count)))
        step_queue[:, : waiting_steps.shape[1]] = waiting_steps
        step_queue[:force_count, waiting_steps.shape[1] : queued_step_count] = block.forces_n
        step_queue[force_count:, waiting_steps.shape[1] : queued_step_count] = block.sensed
        step_queue[:, queued_step_count:] = 0.0
        waiting_steps = step_queue[:, new_sample_count * steps_per_sample : queued_step_count]
        if new_sample_count:
            filtered_rows = _apply_filters(delay_filters, step_queue, new_sample_count)
            for sensor_row, high_pass in zip(filtered_rows[force_count:], high_passes, strict=True):
                if high_pass:
                    sensor_row[:] = high_pass.high_passed(sensor_row)
            sensor_values = {
                quantity: _sensor_outputs(rig, quantity, filtered_rows[force_count:], noise_streams)
                for quantity in quantities_of(rig)
            }
            truth_block = {name: rows[:, :new_sample_count] for name, rows in truth_values.items()}
            yield Samples(filtered_rows[:force_count], sensor_values, truth_block)
            truth_values = {name: rows[:, new_sample_count:] for name, rows in truth_values.items()}


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
        corner_rad_per_s = 2 * np.pi * sensor.high_pass_hz
        numerator, denominator = scipy.signal.bilinear([1.0, 0.0], [1.0, corner_rad_per_s], sample_rate_hz)
        return cls(numerator, denominator, np.zeros(1))

    def high_passed(self, samples: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        filtered_samples, self.state = scipy.signal.lfilter(self.numerator, self.denominator, samples, zi=self.state)
        return np.asarray(filtered_samples)


def _delay_filters(rig: Rig, steps_per_sample: int, reach_steps: int) -> list[tuple[list[int], Decimator]]:
    """Filters by delay, each with the rows that have this delay: forces (none), then sensors."""
    delays_s = [*(0.0 for station in rig.forces), *(sensor.delay_s for sensor in rig.sensors)]
    rows_and_filters = []
    for delay_s in dict.fromkeys(delays_s):
        channel_rows = [channel_row for channel_row, row_delay_s in enumerate(delays_s) if row_delay_s == delay_s]
        taps = _sinc_taps(steps_per_sample, reach_steps, delay_s * rig.sample_rate_hz)
        rows_and_filters.append((channel_rows, decimator(taps, steps_per_sample)))
    return rows_and_filters


def _apply_filters(
    delay_filters: list[tuple[list[int], Decimator]], step_queue: Float[np.ndarray, "rows steps"], sample_count: int
) -> Float[np.ndarray, "rows samples"]:
    if len(delay_filters) == 1:
        return decimate(delay_filters[0][1], step_queue, sample_count)
    filtered_rows = np.empty((len(step_queue), sample_count))
    for channel_rows, delay_filter in delay_filters:
        filtered_rows[channel_rows] = decimate(delay_filter, step_queue[channel_rows], sample_count)
    return filtered_rows


def _sensor_outputs(
    rig: Rig, quantity: QuantityName, sensed: Float[np.ndarray, "sensors samples"], streams: list[np.random.Generator]
) -> Float[np.ndarray, "some samples"]:
    sensor_outputs = [
        _sensor_output(sensor, true_values, rig.sample_rate_hz, stream)
        for sensor, true_values, stream in zip(rig.sensors, sensed, streams, strict=True)
        if sensor.quantity == quantity
    ]
    return np.stack(sensor_outputs)


def _sensor_output(
    sensor: Sensor, true_values: Float[np.ndarray, " samples"], sample_rate_hz: float, noise_stream: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    noise_rms = sensor.noise_density * np.sqrt(sample_rate_hz / 2)
    noise = noise_rms * noise_stream.standard_normal(true_values.size) if noise_rms else 0.0
    sensor_values = sensor.gain * true_values + noise
    if sensor.measuring_range is not None:
        sensor_values = np.clip(sensor_values, -sensor.measuring_range, sensor.measuring_range)
        if sensor.bits is not None:
            level_step = 2 * sensor.measuring_range / 2**sensor.bits
            sensor_values = np.round(sensor_values / level_step) * level_step
    return sensor_values


def _sinc_taps(steps_per_sample: int, reach_steps: int, delay_samples: float) -> Float[np.ndarray, " taps"]:
    """Windowed sinc at the plant's rate, cut off at half the sampling rate, centred `delay_samples` late."""
    time_samples = np.arange(-reach_steps, reach_steps + 1) / steps_per_sample - delay_samples
    if steps_per_sample == 1 and delay_samples == 0:
        return (time_samples == 0).astype(float)
    half_width = FILTER_HALF_WIDTH_SAMPLES + 0.5 / steps_per_sample
    in_window, window_weights = np.abs(time_samples) < half_width, np.zeros(time_samples.size)
    window_time_samples = np.linspace(-half_width, half_width, 4096)
    kaiser = scipy.signal.windows.kaiser(window_time_samples.size, 10.0)
    window_weights[in_window] = np.interp(time_samples[in_window], window_time_samples, kaiser)
    taps = window_weights * np.sinc(time_samples)
    return taps / taps.sum()


def _steps_per_sample(rig: Rig, step_s: float) -> int:
    steps_per_sample = round(1 / (step_s * rig.sample_rate_hz))
    if steps_per_sample < 1 or abs(steps_per_sample * step_s * rig.sample_rate_hz - 1) > 1e-9:
        raise RigError(
            f"sample_rate_hz is {rig.sample_rate_hz} and the plant's step {step_s} s; "
            "1/step must be a whole multiple of the sampling rate"
        )
    return steps_per_sample


def _longest_delay_samples(rig: Rig) -> int:
    return int(np.ceil(max((abs(sensor.delay_s) for sensor in rig.sensors), default=0.0) * rig.sample_rate_hz))


def _truth_of(block: Motion) -> dict[str, SignalRows]:
    return {
        "displacement": block.displacement_m,
        "relative_displacement": block.eta_m,
        "contact_force": block.contact_force_n,
    }
