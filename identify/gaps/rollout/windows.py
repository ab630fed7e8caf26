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
SHORTEST_HORIZON, WINDOW_GROWTH = 16, 4
"""Samples of the shortest horizon (each next one is longer by sqrt(2)), and the growth of the windows of null
simulations, which first hold 16 of it. Effort."""
NULL_WINDOWS = 24
"""Largest number of windows of a null simulation. Effort."""
LOST_ERROR = 1e3
"""Error assigned to a diverged prediction, and bound of all errors."""
Windows = Float[np.ndarray, "windows stations times"]


def measured_and_predicted(
    motion: MeasuredMotion, predict: Predict, starts: Int[np.ndarray, " windows"], samples: int
) -> tuple[Windows, Windows]:
    """Measured and predicted signals in each window: velocities, or displacements of displacement sensors."""
    states = motion.states[:, :, starts].transpose(2, 0, 1)
    prediction = predict(motion.rig, motion.forces_n, starts, samples, motion.stations, states)
    derivatives = [min(order, 1) for order in motion.orders]
    rows = [(motion.displacement_m, motion.velocity_m_per_s)[d][i] for i, d in enumerate(derivatives)]
    measured = np.stack([sliding_window_view(row, samples)[starts] for row in rows], axis=1)
    return measured, prediction[:, derivatives, np.arange(len(rows))]


def prediction_errors(
    motion: MeasuredMotion, predict: Predict, starts: Int[np.ndarray, " windows"], samples: int
) -> Windows:
    """Predicted less measured motion in each window, over each sensor's standard deviation."""
    measured, predicted = measured_and_predicted(motion, predict, starts, samples)
    rms = [
        np.std((motion.displacement_m, motion.velocity_m_per_s)[min(order, 1)][i, motion.valid_samples])
        for i, order in enumerate(motion.orders)
    ]
    errors = (predicted - measured) / np.maximum(rms, 1e-300)[:, None]
    return np.clip(np.nan_to_num(errors, nan=LOST_ERROR), -LOST_ERROR, LOST_ERROR)


def rms_by_window(errors: Windows) -> Float[np.ndarray, " windows"]:
    """Root mean square of the errors in each window."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=(1, 2))))


def median_errors(errors: Windows) -> list[float]:
    """Median over windows of the root-mean-square error: of all sensors together, then of each."""
    by_sensor = np.median(np.sqrt(np.mean(errors**2, axis=2)), axis=0)
    return [float(np.median(rms_by_window(errors))), *by_sensor.tolist()]


def null_errors(recording: Recording, residual: Residual, predict: Predict) -> NullErrors:
    """Prediction errors by horizon of a null recording, to which the nominal rig was fitted with `residual`.

    Raises RigError if the rig cannot be predicted.
    """
    motions = [measured_motion(recording, rig, residual) for rig in (residual.rig, residual.corrected_rig)]
    start, available = motions[0].first_sample, motions[0].stop_sample - motions[0].first_sample
    horizons, window = horizon_ladder(available), 16 * SHORTEST_HORIZON
    nominal: list[tuple[float, ...]] = []
    fitted: list[tuple[float, ...]] = []
    while len(fitted) < len(horizons) and (not fitted or fitted[-1][0] < LADDER_END_ERROR):
        window = min(window, horizons[-1])
        starts = disjoint_starts(start, available, window, NULL_WINDOWS)
        evaluated = [n for n in horizons[len(fitted) :] if n <= window]
        for rows, motion in zip((nominal, fitted), motions, strict=True):
            errors = prediction_errors(motion, predict, starts, window)
            rows += [tuple(median_errors(errors[:, :, :n])) for n in evaluated]
        window *= WINDOW_GROWTH
    return NullErrors(samples=tuple(horizons[: len(fitted)]), nominal=tuple(nominal), within=tuple(fitted))


def horizon_ladder(available_samples: int) -> list[int]:
    """Horizons in samples, growing by sqrt(2), up to the available number."""
    ladder: list[int] = []
    while (n := round(SHORTEST_HORIZON * 2 ** (len(ladder) / 2))) <= available_samples:
        ladder.append(n)
    return ladder


def disjoint_starts(
    first_sample: int, available_samples: int, window_samples: int, max_windows: int
) -> Int[np.ndarray, " windows"]:
    """First samples of evenly spread disjoint windows, as many as fit and at most `max_windows`."""
    count = min(max_windows, available_samples // window_samples)
    return np.asarray(first_sample + np.round(np.linspace(0, available_samples - window_samples, count)).astype(int))


def horizon_of(nulls: Sequence[NullErrors]) -> int | None:
    """Longest horizon, samples, at which the median null simulation is predicted; None if there is none."""
    rows = [dict(zip(null.samples, (all_sensors for all_sensors, *_ in null.within), strict=True)) for null in nulls]
    horizons = sorted({n for row in rows for n in row})
    reached = [n for n in horizons if np.median([row.get(n, np.inf) for row in rows]) < HORIZON_ERROR]
    return reached[-1] if reached else None
