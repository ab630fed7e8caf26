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
NULL_WINDOWS = 24
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
    shown_derivatives = [min(order, 1) for order in motion.derivative_orders]
    sensor_signals = [
        (motion.displacement_m, motion.velocity_m_per_s)[derivative][sensor_index]
        for sensor_index, derivative in enumerate(shown_derivatives)
    ]
    measured_windows = np.stack(
        [sliding_window_view(sensor_signal, window_samples)[window_starts] for sensor_signal in sensor_signals], axis=1
    )
    return measured_windows, prediction[:, shown_derivatives, np.arange(len(sensor_signals))]


def prediction_errors(
    motion: MeasuredMotion, predict: Predict, window_starts: Int[np.ndarray, " windows"], window_samples: int
) -> Windows:
    """Predicted less measured motion in each window, over each sensor's standard deviation."""
    measured_windows, predicted_windows = measured_and_predicted(motion, predict, window_starts, window_samples)
    sensor_deviations = [
        np.std(
            (motion.displacement_m, motion.velocity_m_per_s)[min(derivative_order, 1)][
                sensor_index, motion.valid_samples
            ]
        )
        for sensor_index, derivative_order in enumerate(motion.derivative_orders)
    ]
    relative_errors = (predicted_windows - measured_windows) / np.maximum(sensor_deviations, 1e-300)[:, None]
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
    nominal_medians: list[tuple[float, ...]] = []
    fitted_medians: list[tuple[float, ...]] = []
    while len(fitted_medians) < len(horizons) and (not fitted_medians or fitted_medians[-1][0] < LADDER_END_ERROR):
        window_samples = min(window_samples, horizons[-1])
        window_starts = disjoint_starts(first_sample, available_samples, window_samples, NULL_WINDOWS)
        new_horizons = [
            horizon_samples for horizon_samples in horizons[len(fitted_medians) :] if horizon_samples <= window_samples
        ]
        for medians_by_horizon, motion in zip((nominal_medians, fitted_medians), motions, strict=True):
            window_errors = prediction_errors(motion, predict, window_starts, window_samples)
            medians_by_horizon += [
                tuple(median_errors(window_errors[:, :, :horizon_samples])) for horizon_samples in new_horizons
            ]
        window_samples *= WINDOW_GROWTH
    return NullErrors(
        samples=tuple(horizons[: len(fitted_medians)]), nominal=tuple(nominal_medians), within=tuple(fitted_medians)
    )


def horizon_ladder(available_samples: int) -> list[int]:
    """Horizons in samples, growing by sqrt(2), up to the available number."""
    horizons: list[int] = []
    while (horizon_samples := round(SHORTEST_HORIZON_SAMPLES * 2 ** (len(horizons) / 2))) <= available_samples:
        horizons.append(horizon_samples)
    return horizons


def disjoint_starts(
    first_sample: int, available_samples: int, window_samples: int, max_windows: int
) -> Int[np.ndarray, " windows"]:
    """First samples of evenly spread disjoint windows, as many as fit and at most `max_windows`."""
    window_count = min(max_windows, available_samples // window_samples)
    return np.asarray(
        first_sample + np.round(np.linspace(0, available_samples - window_samples, window_count)).astype(int)
    )


def horizon_of(null_records: Sequence[NullErrors]) -> int | None:
    """Longest horizon, samples, at which the median null simulation is predicted; None if there is none."""
    error_by_horizon = [
        dict(zip(null_record.samples, (all_sensors for all_sensors, *_ in null_record.within), strict=True))
        for null_record in null_records
    ]
    tried_horizons = sorted(
        {horizon_samples for record_errors in error_by_horizon for horizon_samples in record_errors}
    )
    reached_horizons = [
        horizon_samples
        for horizon_samples in tried_horizons
        if np.median([record_errors.get(horizon_samples, np.inf) for record_errors in error_by_horizon]) < HORIZON_ERROR
    ]
    return reached_horizons[-1] if reached_horizons else None
