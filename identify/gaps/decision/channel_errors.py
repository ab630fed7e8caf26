"""Errors of channels that no rig has, in simulated recordings: force noise, motion across the axes, crosstalk."""

from dataclasses import dataclass
from dataclasses import replace as with_fields

import numpy as np
from jaxtyping import Float
from scipy.signal.windows import hann

from identify.gaps.residual.record import Record
from rig.model.tolerances import Tolerances
from rig.recording import Recording

LATERAL_SEGMENT_S = 1.0
"""Length of the segments in which lateral motion has the spectrum of the measured one, s. Set by hand: it rises and
decays with that motion."""


@dataclass(frozen=True)
class ChannelErrors:
    """Errors of a recording's channels: noise of each force (standard deviation of a sample, N), samples before the
    force begins, and tolerances."""

    force_noise_n: Float[np.ndarray, " forces"]
    silent_sample_count: int
    tolerances: Tolerances


def channel_errors_of(record: Record) -> ChannelErrors:
    """Errors of the channels of a measured record."""
    force_noise_n = np.sqrt(record.force_noise_variance / record.sample_count)
    return ChannelErrors(force_noise_n, round(record.excitation_start_s * record.sample_rate_hz), record.tolerances)


def with_channel_errors(recording: Recording, channel_errors: ChannelErrors, seed: int) -> Recording:
    """Simulated recording with errors of its channels that no rig has, the same for the same seed."""
    rng, tolerances = np.random.default_rng([seed, 79]), channel_errors.tolerances
    force_noise_n = channel_errors.force_noise_n
    gain_tolerance = tolerances.force_gain if force_noise_n.size > 1 else 0.0  # of one force the drawn rig has it
    recording = with_force_noise(recording, force_noise_n, gain_tolerance, rng)
    recording = with_lateral_motion(recording, tolerances.lateral_motion, channel_errors.silent_sample_count, rng)
    return with_crosstalk(recording, tolerances.crosstalk, rng)


def with_force_noise(
    recording: Recording, force_noise_n: Float[np.ndarray, " forces"], gain_tolerance: float, rng: np.random.Generator
) -> Recording:
    """Recording with noise and gain errors of the force channels, which the simulator does not know."""
    signals = recording.signals["force"]
    forces_n = signals.values + force_noise_n[:, None] * rng.standard_normal(signals.values.shape)
    forces_n = forces_n * (1 + gain_tolerance * rng.standard_normal((len(forces_n), 1)))
    return with_fields(recording, signals={**recording.signals, "force": with_fields(signals, values=forces_n)})


def with_lateral_motion(
    recording: Recording, lateral_share: float, silent_sample_count: int, rng: np.random.Generator
) -> Recording:
    """Recording with lateral motion in the accelerometers, after `silent_sample_count`: random shares, of this standard
    deviation, of a motion with the spectrum of the measured one in every second (`LATERAL_SEGMENT_S`), but other
    phases, common to a body.

    Its segments overlap under the square root w of a Hann window, whose square has the mean 1/2:

        sqrt(2) sum over segments of w irfft(e^(i phase) rfft(w x))
    """
    if "acceleration" not in recording.signals or not lateral_share:
        return recording
    signals = recording.signals["acceleration"]
    half_segment_samples = round(LATERAL_SEGMENT_S * recording.rig.sample_rate_hz / 2)
    segment_window = np.sqrt(hann(2 * half_segment_samples, sym=False))
    padded_values = np.pad(signals.values, ((0, 0), (half_segment_samples, 2 * half_segment_samples)))
    sensors = [sensor for sensor in recording.rig.sensors if sensor.quantity == "acceleration"]
    body_names = list(dict.fromkeys(sensor.station.body for sensor in sensors))
    body_indices = [body_names.index(sensor.station.body) for sensor in sensors]
    lateral_motion = np.zeros_like(padded_values)
    for segment_start in range(0, padded_values.shape[1] - 2 * half_segment_samples + 1, half_segment_samples):
        segment_slice = slice(segment_start, segment_start + 2 * half_segment_samples)
        phase_factors = np.exp(2j * np.pi * rng.uniform(size=(len(body_names), half_segment_samples + 1)))
        spectrum = np.fft.rfft(segment_window * padded_values[:, segment_slice]) * phase_factors[body_indices]
        lateral_motion[:, segment_slice] += segment_window * np.fft.irfft(spectrum, 2 * half_segment_samples)
    lateral_motion = lateral_motion[:, half_segment_samples : half_segment_samples + signals.values.shape[1]]
    lateral_motion[:, :silent_sample_count] = 0.0
    lateral_shares = np.sqrt(2) * lateral_share * rng.standard_normal((len(sensors), 1))
    lateral_signals = with_fields(signals, values=signals.values + lateral_shares * lateral_motion)
    return with_fields(recording, signals={**recording.signals, "acceleration": lateral_signals})


def with_crosstalk(recording: Recording, crosstalk_share: float, rng: np.random.Generator) -> Recording:
    """Recording with crosstalk: random shares, of this standard deviation, of the adjacent channels of the same
    quantity."""
    signals = dict(recording.signals)
    for quantity in dict.fromkeys(sensor.quantity for sensor in recording.rig.sensors) if crosstalk_share else ():
        values = signals[quantity].values
        neighbours = np.eye(len(values), k=1) + np.eye(len(values), k=-1)
        mixing = np.eye(len(values)) + crosstalk_share * neighbours * rng.standard_normal(neighbours.shape)
        signals[quantity] = with_fields(signals[quantity], values=mixing @ values)
    return with_fields(recording, signals=signals)
