"""A rig run from measured states over windows of a record, against what the sensors show; and how far that is possible.

Each window begins with the state that its sensors show, and goes on under the measured force. The error is predicted
less measured motion, as a share of the sensor's root mean square. With contacts the motion is chaotic: the horizon is
the longest at which null simulations, recordings of the believed rig within its tolerances, are predicted. Where the
motion is not chaotic it is the record.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from identify.gaps.residual.residual import Residual
from identify.gaps.rollout.results import NullErrors
from identify.gaps.rollout.states import MeasuredMotion, motion_of
from rig.model.description import Rig, Station
from rig.recording import Recording

PREDICTED = 0.1
"""The horizon is the longest at which the median error of null simulations stays below this share; ..."""
FURTHER = 0.15
"""... no longer one is looked at once a null simulation's error exceeds this."""
SHORTEST, LONGER = 16, 4
"""Samples of the shortest horizon; each is longer by sqrt(2). Windows of null simulations hold 16 of it at first, then
each time so many times more."""
NULL_WINDOWS = 24
"""Windows of a null simulation, at most."""
LOST = 1e3
"""The error of a motion that is lost."""
Predict = Callable[
    [
        Rig,
        Float[np.ndarray, "forces samples"],
        Int[np.ndarray, " windows"],
        int,
        tuple[Station, ...],
        Float[np.ndarray, "windows 2 stations"],
    ],
    Float[np.ndarray, "windows 2 stations times"],
]
"""Displacement and velocity at some stations from their states at the first sample of each window on, under the
measured forces of the whole record, over so many samples: the predictor that the diagnosis is handed."""

Windows = Float[np.ndarray, "windows stations times"]


def predicted(
    motion: MeasuredMotion, predict: Predict, first: Int[np.ndarray, " windows"], samples: int
) -> tuple[Windows, Windows]:
    """Measured and predicted signals in each window.

    Velocities of accelerometers and velocity sensors, displacements of displacement sensors.
    """
    states = motion.states[:, :, first].transpose(2, 0, 1)
    moved = predict(motion.rig, motion.forces_n, first, samples, motion.stations, states)
    derivatives = [min(order, 1) for order in motion.orders]
    rows = [(motion.displacement_m, motion.velocity_m_per_s)[d][i] for i, d in enumerate(derivatives)]
    shown = np.stack([sliding_window_view(row, samples)[first] for row in rows], axis=1)
    return shown, moved[:, derivatives, np.arange(len(rows))]


def errors_of(motion: MeasuredMotion, predict: Predict, first: Int[np.ndarray, " windows"], samples: int) -> Windows:
    """Predicted less measured motion, as shares of each sensor's root mean square about its mean."""
    shown, moved = predicted(motion, predict, first, samples)
    sizes = [
        np.std((motion.displacement_m, motion.velocity_m_per_s)[min(order, 1)][i, motion.now])
        for i, order in enumerate(motion.orders)
    ]
    errors = (moved - shown) / np.maximum(sizes, 1e-300)[:, None]
    return np.clip(np.nan_to_num(errors, nan=LOST), -LOST, LOST)


def size_of(errors: Windows) -> Float[np.ndarray, " windows"]:
    """Root mean squares of the errors in each window."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=(1, 2))))


def medians(errors: Windows) -> list[float]:
    """Median errors over the windows, as root mean squares: of all sensors together, then of each."""
    at_sensors = np.median(np.sqrt(np.mean(errors**2, axis=2)), axis=0)
    return [float(np.median(size_of(errors))), *at_sensors.tolist()]


def null_errors(recording: Recording, at: Residual, predict: Predict) -> NullErrors:
    """Prediction errors of a null simulation's recording, to which the nominal rig was fitted as `at`.

    Raises RigError if the rig cannot be predicted.
    """
    motions = [motion_of(recording, rig, at) for rig in (at.rig, at.corrected_rig)]
    begin, available = motions[0].first, motions[0].stop - motions[0].first
    ladder, window = horizons(available), 16 * SHORTEST
    told: tuple[list[tuple[float, ...]], list[tuple[float, ...]]] = ([], [])
    while len(told[1]) < len(ladder) and (not told[1] or told[1][-1][0] < FURTHER):
        window = min(window, ladder[-1])
        first = spread(begin, available, window, NULL_WINDOWS)
        reached = [n for n in ladder[len(told[1]) :] if n <= window]
        for rows, motion in zip(told, motions, strict=True):
            errors = errors_of(motion, predict, first, window)
            rows += [tuple(medians(errors[:, :, :n])) for n in reached]
        window *= LONGER
    return NullErrors(samples=tuple(ladder[: len(told[1])]), nominal=tuple(told[0]), within=tuple(told[1]))


def horizons(available: int) -> list[int]:
    """Horizons that are looked at, samples, up to as many as there are."""
    found: list[int] = []
    while (n := round(SHORTEST * 2 ** (len(found) / 2))) <= available:
        found.append(n)
    return found


def spread(first: int, available: int, window: int, most: int) -> Int[np.ndarray, " windows"]:
    """The first samples of disjoint windows, spread evenly: as many as there is room for, or wanted."""
    count = min(most, available // window)
    return np.asarray(first + np.round(np.linspace(0, available - window, count)).astype(int))


def horizon_of(nulls: Sequence[NullErrors]) -> int | None:
    """The longest horizon, samples, at which the median null simulation is predicted; None if there is none."""
    rows = [dict(zip(null.samples, (whole for whole, *_ in null.within), strict=True)) for null in nulls]
    known = sorted({n for row in rows for n in row})
    reached = [n for n in known if np.median([row.get(n, np.inf) for row in rows]) < PREDICTED]
    return reached[-1] if reached else None
