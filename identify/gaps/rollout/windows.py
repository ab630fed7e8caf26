"""Prediction errors of a rig over windows of a record, and the horizon up to which prediction is possible.

Each window starts from the measured state and continues under the measured force. The error is predicted less measured
motion, as a share of the sensor's root mean square. Motion with contacts is chaotic: the horizon is the longest at
which null simulations (of the nominal rig within its tolerances) are predicted, or the record if motion is regular.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from identify.gaps.residual.residual import Residual
from identify.gaps.rollout.results import NullErrors
from identify.gaps.rollout.states import MeasuredMotion, measured_motion
from rig.recording import Recording
from rig.recording.interfaces import Predict

HORIZON_ERROR = 0.1
"""Median error of null simulations that defines the horizon; ... Convention."""
LADDER_END_ERROR = 0.15
"""... and the error of a null simulation beyond which longer horizons are not tried. Effort."""
SHORTEST_HORIZON_SAMPLES, WINDOW_GROWTH = 16, 4
"""Samples of the shortest horizon (each next one is longer by sqrt(2)), and the growth of the windows of null
simulations, which first hold 16 of it. Effort."""
MAX_NULL_WINDOWS = 24
"""Largest number of windows of a null simulation. Effort."""
DIVERGED_ERROR = 1e3
"""Error assigned to a diverged prediction, and bound of all errors."""
Windows = Float[np.ndarray, "windows stations times"]


def measured_and_predicted(
    motion: MeasuredMotion, predict: Predict, window_starts: Int[np.ndarray, " windows"], window_samples: int
) -> tuple[Windows, Windows]:
    """Measured and predicted signals in each window: velocities, or displacements of displacement sensors."""
    start_states = motion.modal_states[:, :, window_starts].transpose(2, 0, 1)
    prediction = predict(motion.rig, motion.forces_n, window_starts, window_samples, motion.stations, start_states)
    signals = motion.compared_signals
    measured = np.stack([sliding_window_view(signal, window_samples)[window_starts] for signal in signals], axis=1)
    return measured, prediction[:, motion.compared_derivatives, np.arange(len(signals))]


def prediction_errors(
    motion: MeasuredMotion, predict: Predict, window_starts: Int[np.ndarray, " windows"], window_samples: int
) -> Windows:
    """Predicted less measured motion in each window, over each sensor's standard deviation."""
    measured_windows, predicted_windows = measured_and_predicted(motion, predict, window_starts, window_samples)
    signal_deviations = [np.std(signal[motion.valid_slice]) for signal in motion.compared_signals]
    relative_errors = (predicted_windows - measured_windows) / np.maximum(signal_deviations, 1e-300)[:, None]
    return np.clip(np.nan_to_num(relative_errors, nan=DIVERGED_ERROR), -DIVERGED_ERROR, DIVERGED_ERROR)


def rms_by_window(window_errors: Windows) -> Float[np.ndarray, " windows"]:
    """Root mean square of the errors in each window."""
    return np.asarray(np.sqrt(np.mean(window_errors**2, axis=(1, 2))))


def median_errors(window_errors: Windows) -> list[float]:
    """Median over windows of the root-mean-square error: of all sensors together, then of each."""
    median_by_sensor = np.median(np.sqrt(np.mean(window_errors**2, axis=2)), axis=0)
    return [float(np.median(rms_by_window(window_errors))), *median_by_sensor.tolist()]


def null_errors(recording: Recording, residual: Residual, predict: Predict) -> NullErrors:
    """Prediction errors by horizon of a null recording, to which the nominal rig was fitted with `residual`.

    Raises RigError if the rig cannot be predicted.
    """
    motions = [measured_motion(recording, rig, residual) for rig in (residual.rig, residual.corrected_rig)]
    first_sample, available_samples = motions[0].first_sample, motions[0].stop_sample - motions[0].first_sample
    horizons, window_samples = horizon_ladder(available_samples), 16 * SHORTEST_HORIZON_SAMPLES
    nominal: list[tuple[float, ...]] = []
    fitted: list[tuple[float, ...]] = []
    while len(fitted) < len(horizons) and (not fitted or fitted[-1][0] < LADDER_END_ERROR):
        window_samples = min(window_samples, horizons[-1])
        window_starts = disjoint_starts(first_sample, available_samples, window_samples, MAX_NULL_WINDOWS)
        new_horizons = [horizon for horizon in horizons[len(fitted) :] if horizon <= window_samples]
        for medians, motion in zip((nominal, fitted), motions, strict=True):
            errors = prediction_errors(motion, predict, window_starts, window_samples)
            medians += [tuple(median_errors(errors[:, :, :horizon])) for horizon in new_horizons]
        window_samples *= WINDOW_GROWTH
    return NullErrors(samples=tuple(horizons[: len(fitted)]), nominal=tuple(nominal), within=tuple(fitted))


def horizon_ladder(available_samples: int) -> list[int]:
    """Horizons in samples, growing by sqrt(2), up to the available number."""
    horizons: list[int] = []
    while (horizon := round(SHORTEST_HORIZON_SAMPLES * 2 ** (len(horizons) / 2))) <= available_samples:
        horizons.append(horizon)
    return horizons


def disjoint_starts(
    first_sample: int, available_samples: int, window_samples: int, max_windows: int
) -> Int[np.ndarray, " windows"]:
    """First samples of evenly spread disjoint windows, as many as fit and at most `max_windows`."""
    window_count = min(max_windows, available_samples // window_samples)
    offsets = np.linspace(0, available_samples - window_samples, window_count)
    return np.asarray(first_sample + np.round(offsets).astype(int))


def predictable_horizon_samples(nulls: Sequence[NullErrors]) -> int | None:
    """Longest horizon, samples, at which the median null simulation is predicted; None if there is none."""
    errors_by_horizon = [
        dict(zip(null.samples, (all_sensors for all_sensors, *_ in null.within), strict=True)) for null in nulls
    ]
    predicted_horizons = [
        horizon
        for horizon in set[int]().union(*errors_by_horizon)
        if np.median([errors.get(horizon, np.inf) for errors in errors_by_horizon]) < HORIZON_ERROR
    ]
    return max(predicted_horizons, default=None)
