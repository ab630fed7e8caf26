"""Veto of corrections by prediction: a correction that predicts worse is rejected, none is confirmed.

The nominal and the corrected rig are predicted over the same windows, from states by the same estimator. If the
correction is right, with the difference D of the two prediction errors,

    E_nominal^2 = E_corrected^2 + D^2        ln(E_corrected / E_nominal) = -ln(1 + D^2 / E_corrected^2) / 2

as the remaining error is independent of the correction. Within a horizon of two contacts many wrong rigs predict as
well as the right one, so that a correction that predicts no worse is not thereby right.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from msgspec.structs import replace
from scipy.stats import t as student

from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Residual
from identify.gaps.rollout.results import Code, DecayMode, NullErrors, PredictionErrors, PredictionExample, Rollout
from identify.gaps.rollout.states import MeasuredMotion, measured_motion
from identify.gaps.rollout.windows import (
    Windows,
    disjoint_starts,
    measured_and_predicted,
    median_errors,
    predictable_horizon_samples,
    prediction_errors,
    rms_by_window,
)
from identify.signals.ringing import RingingMode, modes_of_decay
from rig.errors import RigError
from rig.model.modes import modes_of
from rig.recording import Recording
from rig.recording.interfaces import Predict

MAX_WINDOW_COUNT = 240
"""Largest number of windows of a record. Effort."""
BLOCK_S, LEAST_BLOCKS = 1.0, 5
"""Length of the blocks over which windows are averaged, and their least number in a test. Set by hand."""
VETO_P_VALUE = 0.01
"""One-sided p-value of a veto. Convention."""
WORSE_LOG_RATIO, BETTER_LOG_RATIO = 0.05, 0.05
"""Least mean log ratios of errors for a veto: by which the corrected rig is worse, or would be better if right. Set by
hand."""
MAX_SHOWN_SAMPLES = 1000
"""Samples of the example at most. Display."""
BOOTSTRAP_DRAW_COUNT = 400
"""Bootstrap draws. Effort."""
MATCHED_FREQUENCY_DIFFERENCE = 0.2
"""Relative difference of frequencies below which a predicted mode is the measured one. Set by hand."""


def judge_correction(
    recording: Recording, nominal_fit: Residual, corrected_fit: Residual, nulls: Sequence[NullErrors], predict: Predict
) -> Rollout:
    """Rollout of a correction over the recording to which both rigs were fitted.

    Three rigs are predicted: the nominal one, the nominal one fitted within its tolerances, and the corrected one
    fitted likewise, which must not be worse than the second.
    """
    horizon_samples = predictable_horizon_samples(nulls)
    if horizon_samples is None:
        return Rollout(code="no_horizon")
    motions = [
        measured_motion(recording, nominal_fit.rig, nominal_fit),
        measured_motion(recording, nominal_fit.corrected_rig, nominal_fit),
        measured_motion(recording, corrected_fit.corrected_rig, corrected_fit),
    ]
    nominal, _, corrected = motions
    first_sample, stop = _common_samples(motions)
    rate_hz = recording.rig.sample_rate_hz
    if stop - first_sample < max(LEAST_BLOCKS * BLOCK_S * rate_hz, horizon_samples):
        return Rollout(code="too_short")
    window_starts = disjoint_starts(first_sample, stop - first_sample, horizon_samples, MAX_WINDOW_COUNT)
    record = nominal_fit.model.record
    try:
        nominal_errors, fitted_errors, corrected_errors = (
            prediction_errors(motion, predict, window_starts, horizon_samples) for motion in motions
        )
        decay_modes = () if record.has_force else _decay_modes(nominal, corrected, record, predict, first_sample, stop)
    except RigError:
        return Rollout(code="not_simulated")
    ratios_by_block = error_log_ratios_by_block(fitted_errors, corrected_errors, window_starts, rate_hz)
    errors_of_all, *by_sensor = _errors_by_sensor(
        nominal_errors, corrected_errors, null_error_medians_and_limits(nulls, horizon_samples)
    )
    shrunk_95 = None
    if errors_of_all.shrunk is not None:
        block_of_window = np.floor((window_starts + horizon_samples / 2) / rate_hz / BLOCK_S)
        nominal_rms, corrected_rms = rms_by_window(nominal_errors), rms_by_window(corrected_errors)
        shrunk_95 = _removed_share_interval_95(nominal_rms, corrected_rms, errors_of_all.null_median, block_of_window)
    return Rollout(
        code=veto_code(ratios_by_block),
        horizon_s=horizon_samples / rate_hz,
        windows=window_starts.size,
        whole=errors_of_all,
        shrunk_95=shrunk_95,
        within=float(np.median(rms_by_window(fitted_errors))),
        log_ratio=float(ratios_by_block.log_ratios.mean()),
        log_ratio_error=standard_error_of_mean(ratios_by_block.log_ratios),
        expected_log_ratio=float(ratios_by_block.expected_log_ratios.mean()),
        falls_short=falls_short(ratios_by_block),
        by_sensor=dict(zip(nominal.sensor_names, by_sensor, strict=True)),
        decay=decay_modes,
        example=_example(nominal, corrected, predict, window_starts, nominal_errors),
    )


def _common_samples(motions: Sequence[MeasuredMotion]) -> tuple[int, int]:
    """First sample at which all motions are valid, and the one after the last."""
    return max(motion.first_sample for motion in motions), min(motion.stop_sample for motion in motions)


def _measured_and_both_predicted(
    nominal: MeasuredMotion,
    corrected: MeasuredMotion,
    predict: Predict,
    starts: Int[np.ndarray, " windows"],
    window_samples: int,
) -> tuple[Windows, Windows, Windows]:
    """Measured signals in each window, and those predicted by the nominal and by the corrected rig."""
    measured_windows, nominal_windows = measured_and_predicted(nominal, predict, starts, window_samples)
    return measured_windows, nominal_windows, measured_and_predicted(corrected, predict, starts, window_samples)[1]


def _example(
    nominal: MeasuredMotion,
    corrected: MeasuredMotion,
    predict: Predict,
    window_starts: Int[np.ndarray, " windows"],
    nominal_errors: Windows,
) -> PredictionExample:
    """End of the window in which the nominal rig's error is the median, of the sensor that it predicts worst."""
    rms_errors, window_samples = rms_by_window(nominal_errors), nominal_errors.shape[2]
    window_index = int(np.argsort(rms_errors)[rms_errors.size // 2])
    sensor_index = int(np.argmax(np.mean(nominal_errors[window_index] ** 2, axis=1)))
    start, shown_slice = window_starts[[window_index]], slice(-min(window_samples, MAX_SHOWN_SAMPLES), None)
    time_s = (start + np.arange(window_samples)) / nominal.sample_rate_hz
    measured_values, nominal_values, corrected_values = (
        tuple(np.nan_to_num(signals[0, sensor_index, shown_slice]).tolist())
        for signals in _measured_and_both_predicted(nominal, corrected, predict, start, window_samples)
    )
    return PredictionExample(
        sensor=nominal.sensor_names[sensor_index],
        unit=("m", "m/s")[nominal.compared_derivatives[sensor_index]],
        time_s=tuple(time_s[shown_slice].tolist()),
        measured=measured_values,
        nominal=nominal_values,
        corrected=corrected_values,
    )


def _decay_modes(
    nominal: MeasuredMotion, corrected: MeasuredMotion, record: Record, predict: Predict, first_sample: int, stop: int
) -> tuple[DecayMode, ...]:
    """Modes of a decay and of its predictions from the first to the last sample."""
    rig, rate_hz, highest_hz = nominal.rig, nominal.sample_rate_hz, record.highest_hz
    natural_hz = [modes_of(rig, body).frequencies_hz(body.max_modes) for body in rig.bodies]
    max_mode_count = 2 + sum(int(np.count_nonzero(body_hz < highest_hz)) for body_hz in natural_hz)
    decays = _measured_and_both_predicted(nominal, corrected, predict, np.array([first_sample]), stop - first_sample)
    return compared_modes(
        *(modes_of_decay(np.nan_to_num(decay[0]), rate_hz, highest_hz, max_mode_count) for decay in decays)
    )


def compared_modes(
    measured_modes: Sequence[RingingMode], nominal_modes: Sequence[RingingMode], corrected_modes: Sequence[RingingMode]
) -> tuple[DecayMode, ...]:
    """Measured modes, each with the nearest mode of both predictions."""

    def nearest_mode(mode: RingingMode, predicted_modes: Sequence[RingingMode]) -> tuple[float, float] | None:
        def distance(predicted: RingingMode) -> float:
            return float(abs(np.log(predicted.frequency_hz / mode.frequency_hz)))

        predicted = min(predicted_modes, key=distance, default=None)
        if predicted is None or abs(predicted.frequency_hz / mode.frequency_hz - 1) > MATCHED_FREQUENCY_DIFFERENCE:
            return None
        return predicted.frequency_hz, predicted.damping_ratio

    return tuple(
        DecayMode(
            measured=(mode.frequency_hz, mode.damping_ratio),
            nominal=nearest_mode(mode, nominal_modes),
            corrected=nearest_mode(mode, corrected_modes),
        )
        for mode in measured_modes
    )


@dataclass(frozen=True)
class BlockLogRatios:
    """Log ratios ln(E_corrected / E_nominal) by blocks of 1 s, and those expected of a right correction."""

    log_ratios: Float[np.ndarray, " blocks"]
    expected_log_ratios: Float[np.ndarray, " blocks"]


def error_log_ratios_by_block(
    nominal_errors: Windows, corrected_errors: Windows, window_starts: Int[np.ndarray, " windows"], rate_hz: float
) -> BlockLogRatios:
    """Log ratios of two rigs' errors by block; windows longer than a block are cut into blocks."""
    block_samples = min(nominal_errors.shape[2], round(BLOCK_S * rate_hz))
    block_starts = range(0, nominal_errors.shape[2] - block_samples // 2, block_samples)
    mean_squares = np.stack(
        [
            [np.mean(errors[:, :, start : start + block_samples] ** 2, axis=(1, 2)) for start in block_starts]
            for errors in (nominal_errors, corrected_errors, nominal_errors - corrected_errors)
        ]
    )
    middle_s = (window_starts + np.array(block_starts)[:, None] + block_samples / 2) / rate_hz
    least_square = 1e-12 * max(float(np.max(mean_squares[:2])), 1e-300)
    nominal_squares, corrected_squares = np.maximum(mean_squares[:2], least_square)
    log_ratios = np.log(corrected_squares / nominal_squares) / 2, -np.log1p(mean_squares[2] / corrected_squares) / 2
    block_numbers = np.floor(middle_s / BLOCK_S).ravel()
    return BlockLogRatios(*(_means_by_block(ratios.ravel(), block_numbers) for ratios in log_ratios))


def _means_by_block(
    values: Float[np.ndarray, " all"], block_numbers: Float[np.ndarray, " all"]
) -> Float[np.ndarray, " blocks"]:
    """Mean in each block of values whose blocks are numbered."""
    return np.array([values[block_numbers == block_number].mean() for block_number in np.unique(block_numbers)])


def veto_code(ratios_by_block: BlockLogRatios) -> Code:
    """Code `worse` if the corrected rig predicts significantly worse by Student's test over blocks, or `not_vetoed`."""
    log_ratios = ratios_by_block.log_ratios
    veto_limit = max(WORSE_LOG_RATIO, _veto_quantile(log_ratios.size) * standard_error_of_mean(log_ratios))
    return "worse" if log_ratios.mean() > veto_limit else "not_vetoed"


def _veto_quantile(value_count: int) -> float:
    """Quantile of Student's distribution beyond which the mean of so many values vetoes."""
    return float(student.ppf(1 - VETO_P_VALUE, value_count - 1))


def falls_short(ratios: BlockLogRatios) -> bool:
    """True if the predictions differ but do not improve as those of a right correction would.

    This holds as well for two rigs within the tolerances that err alike: simulations decide (`with_simulation_veto`).
    """
    log_ratios, shortfalls = ratios.log_ratios, ratios.log_ratios - ratios.expected_log_ratios
    quantile = _veto_quantile(log_ratios.size)
    is_behind = shortfalls.mean() > quantile * standard_error_of_mean(shortfalls)
    is_different = ratios.expected_log_ratios.mean() < -BETTER_LOG_RATIO and is_behind
    return bool(is_different and log_ratios.mean() > -quantile * standard_error_of_mean(log_ratios))


def mean_error_log_ratio(
    recording: Recording, nominal_residual: Residual, corrected_residual: Residual, horizon: int, predict: Predict
) -> float:
    """Mean log ratio of the errors of two rigs, both fitted to a recording, at a horizon in samples."""
    motions = [measured_motion(recording, fit.corrected_rig, fit) for fit in (nominal_residual, corrected_residual)]
    first_sample, stop_sample = _common_samples(motions)
    starts = disjoint_starts(first_sample, stop_sample - first_sample, horizon, MAX_WINDOW_COUNT)
    nominal_errors, corrected_errors = (prediction_errors(motion, predict, starts, horizon) for motion in motions)
    return float(
        error_log_ratios_by_block(
            nominal_errors, corrected_errors, starts, recording.rig.sample_rate_hz
        ).log_ratios.mean()
    )


def with_simulation_veto(rollout: Rollout, simulated_log_ratios: Sequence[float]) -> Rollout:
    """Rollout with the veto `no_improvement` if it falls short of simulated machines that have the named effects.

    `simulated_log_ratios` are the means of three or more such machines (`mean_error_log_ratio`), fitted and predicted
    likewise. The veto needs a log ratio above Student's prediction limit of theirs, and a limit below -BETTER_LOG_RATIO
    / 2.
    """
    if not rollout.falls_short or len(simulated_log_ratios) < 3 or rollout.log_ratio is None:
        return rollout
    mean_log_ratio, simulation_count = float(np.mean(simulated_log_ratios)), len(simulated_log_ratios)
    scatter = np.std(simulated_log_ratios, ddof=1) * np.sqrt(1 + 1 / simulation_count)
    limit_margin = _veto_quantile(simulation_count) * float(np.hypot(scatter, rollout.log_ratio_error or 0.0))
    log_ratio_limit = mean_log_ratio + limit_margin
    is_no_better = log_ratio_limit < -BETTER_LOG_RATIO / 2 and rollout.log_ratio > log_ratio_limit
    return replace(rollout, code="no_improvement") if is_no_better else rollout


def standard_error_of_mean(blocks: Float[np.ndarray, " blocks"]) -> float:
    """Standard error of the mean of a series, increased by the correlation of neighbours."""
    deviations = blocks - blocks.mean()
    squares = float(deviations @ deviations)
    correlation = float(np.clip(deviations[1:] @ deviations[:-1] / squares, 0.0, 0.9)) if squares > 0 else 0.0
    return float(np.sqrt(squares / max(blocks.size - 1, 1) / blocks.size * (1 + correlation) / (1 - correlation)))


def null_error_medians_and_limits(nulls: Sequence[NullErrors], horizon_samples: int) -> list[tuple[float, float]]:
    """Median error of the fitted rig in null simulations, and the upper 95 % prediction limit of that of the nominal
    rig (Student, of the logarithm) at a horizon: of all sensors together, then of each."""
    rows = [(null, null.samples.index(horizon_samples)) for null in nulls if horizon_samples in null.samples]
    medians, null_count = np.median([null.within[k] for null, k in rows], axis=0), len(rows)
    log_errors = np.log(np.maximum([null.nominal[k] for null, k in rows], 1e-300))
    limit_deviations = student.ppf(0.95, null_count - 1) * np.sqrt(1 + 1 / null_count) if null_count > 1 else 0.0
    limits = np.exp(log_errors.mean(axis=0) + limit_deviations * log_errors.std(axis=0, ddof=min(1, null_count - 1)))
    return list(zip(medians.tolist(), limits.tolist(), strict=True))


def _errors_by_sensor(
    nominal_errors: Windows, corrected_errors: Windows, null_limits: list[tuple[float, float]]
) -> list[PredictionErrors]:
    """Median errors of all sensors together, then of each, beside the median and limit of null simulations."""
    return [
        PredictionErrors(
            nominal=nominal,
            corrected=corrected,
            null_median=null_median,
            null_95=null_95,
            shrunk=None if nominal <= null_95 else removed_mismatch_share(nominal, corrected, null_median),
        )
        for nominal, corrected, (null_median, null_95) in zip(
            median_errors(nominal_errors), median_errors(corrected_errors), null_limits, strict=True
        )
    ]


def removed_mismatch_share(nominal_error: float, corrected_error: float, null_error: float) -> float:
    """Share of the mismatch beyond null simulations that a correction removes, at most 1."""
    return min(1.0, (nominal_error**2 - corrected_error**2) / max(nominal_error**2 - null_error**2, 1e-300))


def _removed_share_interval_95(
    nominal: Float[np.ndarray, " windows"],
    corrected: Float[np.ndarray, " windows"],
    null_error: float,
    blocks: Float[np.ndarray, " windows"],
) -> tuple[float, float]:
    """95 % interval of `removed_mismatch_share` by a bootstrap over blocks."""
    rng, block_windows = np.random.default_rng(0), [np.flatnonzero(blocks == block) for block in np.unique(blocks)]
    shares = []
    for _ in range(BOOTSTRAP_DRAW_COUNT):
        drawn = np.concatenate([block_windows[k] for k in rng.integers(0, len(block_windows), len(block_windows))])
        shares.append(
            removed_mismatch_share(float(np.median(nominal[drawn])), float(np.median(corrected[drawn])), null_error)
        )
    lower, upper = np.quantile(shares, [0.025, 0.975])
    return float(lower), float(upper)
