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
    horizon_of,
    measured_and_predicted,
    median_errors,
    prediction_errors,
    rms_by_window,
)
from identify.signals.ringing import RingingMode, modes_of_decay
from rig.errors import RigError
from rig.model.modes import modes_of
from rig.recording import Recording
from rig.recording.interfaces import Predict

MAX_WINDOWS = 240
"""Largest number of windows of a record. Effort."""
BLOCK_S, LEAST_BLOCKS = 1.0, 5
"""Length of the blocks over which windows are averaged, and their least number in a test. Set by hand."""
VETO_P_VALUE = 0.01
"""One-sided p-value of a veto. Convention."""
WORSE, BETTER = 0.05, 0.05
"""Least mean log ratios of errors for a veto: by which the corrected rig is worse, or would be better if right. Set by
hand."""
SHOWN_SAMPLES = 1000
"""Samples of the example at most. Display."""
BOOTSTRAP_DRAWS = 400
"""Bootstrap draws. Effort."""
FREQUENCY_MATCH = 0.2
"""Relative difference of frequencies below which a predicted mode is the measured one. Set by hand."""


def judge_correction(
    recording: Recording, nominal_fit: Residual, corrected_fit: Residual, nulls: Sequence[NullErrors], predict: Predict
) -> Rollout:
    """Rollout of a correction over the recording to which both rigs were fitted.

    Three rigs are predicted: the nominal one, the nominal one fitted within its tolerances, and the corrected one
    fitted likewise, which must not be worse than the second.
    """
    samples = horizon_of(nulls)
    if samples is None:
        return Rollout(code="no_horizon")
    fits = (
        (nominal_fit.rig, nominal_fit),
        (nominal_fit.corrected_rig, nominal_fit),
        (corrected_fit.corrected_rig, corrected_fit),
    )
    motions = [measured_motion(recording, rig, residual) for rig, residual in fits]
    start, stop = max(m.first_sample for m in motions), min(m.stop_sample for m in motions)
    rate = recording.rig.sample_rate_hz
    if stop - start < max(LEAST_BLOCKS * BLOCK_S * rate, samples):
        return Rollout(code="too_short")
    starts = disjoint_starts(start, stop - start, samples, MAX_WINDOWS)
    try:
        nominal_errors, fitted_errors, corrected_errors = (
            prediction_errors(motion, predict, starts, samples) for motion in motions
        )
        record = nominal_fit.model.record
        decay = () if record.forced else _decay_modes(motions[0], motions[2], record, predict, start, stop)
    except RigError:
        return Rollout(code="not_simulated")
    ratios = block_ratios(fitted_errors, corrected_errors, starts, rate)
    all_sensors, *by_sensor = _errors_by_sensor(nominal_errors, corrected_errors, null_bounds(nulls, samples))
    blocks = np.floor((starts + samples / 2) / rate / BLOCK_S)
    rms = rms_by_window(nominal_errors), rms_by_window(corrected_errors)
    return Rollout(
        code=veto(ratios),
        horizon_s=samples / rate,
        windows=starts.size,
        whole=all_sensors,
        shrunk_95=None if all_sensors.shrunk is None else _shrinkage_interval(*rms, all_sensors.null_median, blocks),
        within=float(np.median(rms_by_window(fitted_errors))),
        log_ratio=float(ratios.log_ratios.mean()),
        log_ratio_error=standard_error(ratios.log_ratios),
        expected_log_ratio=float(ratios.expected.mean()),
        falls_short=falls_short(ratios),
        by_sensor=dict(zip(motions[0].names, by_sensor, strict=True)),
        decay=decay,
        example=_example(motions[0], motions[2], predict, starts, nominal_errors),
    )


def _example(
    nominal: MeasuredMotion,
    corrected: MeasuredMotion,
    predict: Predict,
    starts: Int[np.ndarray, " windows"],
    errors: Windows,
) -> PredictionExample:
    """End of the window in which the nominal rig's error is the median, of the sensor that it predicts worst."""
    rms = rms_by_window(errors)
    window = int(np.argsort(rms)[rms.size // 2])
    sensor = int(np.argmax(np.mean(errors[window] ** 2, axis=1)))
    start, samples = starts[[window]], errors.shape[2]
    rows = [measured_and_predicted(motion, predict, start, samples) for motion in (nominal, corrected)]
    end = slice(-min(samples, SHOWN_SAMPLES), None)
    time_s = (start + np.arange(samples)) / nominal.sample_rate_hz
    measured, *predicted = (row[0, sensor, end] for row in (rows[0][0], rows[0][1], rows[1][1]))
    return PredictionExample(
        sensor=nominal.names[sensor],
        unit=("m", "m/s")[min(nominal.orders[sensor], 1)],
        time_s=tuple(time_s[end].tolist()),
        measured=tuple(measured.tolist()),
        nominal=tuple(np.nan_to_num(predicted[0]).tolist()),
        corrected=tuple(np.nan_to_num(predicted[1]).tolist()),
    )


def _decay_modes(
    nominal: MeasuredMotion,
    corrected: MeasuredMotion,
    record: Record,
    predict: Predict,
    start_sample: int,
    stop_sample: int,
) -> tuple[DecayMode, ...]:
    """Modes of a decay and of its predictions from the first to the last sample."""
    rig, rate_hz, highest_hz = nominal.rig, nominal.sample_rate_hz, record.highest_hz
    natural_hz = [modes_of(rig, body).frequencies_hz(body.max_modes) for body in rig.bodies]
    max_modes = 2 + sum(int(np.count_nonzero(hz < highest_hz)) for hz in natural_hz)
    starts = np.array([start_sample])
    signals = [
        measured_and_predicted(motion, predict, starts, stop_sample - start_sample) for motion in (nominal, corrected)
    ]
    decays = (signals[0][0], signals[0][1], signals[1][1])
    return compared_modes(*(modes_of_decay(np.nan_to_num(d[0]), rate_hz, highest_hz, max_modes) for d in decays))


def compared_modes(
    measured: Sequence[RingingMode], nominal: Sequence[RingingMode], corrected: Sequence[RingingMode]
) -> tuple[DecayMode, ...]:
    """Measured modes, each with the nearest mode of both predictions."""

    def nearest(mode: RingingMode, candidates: Sequence[RingingMode]) -> tuple[float, float] | None:
        best = min(
            candidates, key=lambda predicted: abs(np.log(predicted.frequency_hz / mode.frequency_hz)), default=None
        )
        if best is None or abs(best.frequency_hz / mode.frequency_hz - 1) > FREQUENCY_MATCH:
            return None
        return best.frequency_hz, best.damping_ratio

    return tuple(
        DecayMode(
            measured=(mode.frequency_hz, mode.damping_ratio),
            nominal=nearest(mode, nominal),
            corrected=nearest(mode, corrected),
        )
        for mode in measured
    )


@dataclass(frozen=True)
class BlockRatios:
    """Log ratios ln(E_corrected / E_nominal) by blocks of 1 s, and those expected of a right correction."""

    log_ratios: Float[np.ndarray, " blocks"]
    expected: Float[np.ndarray, " blocks"]


def block_ratios(before: Windows, after: Windows, starts: Int[np.ndarray, " windows"], rate_hz: float) -> BlockRatios:
    """Log ratios of two rigs' errors by block; windows longer than a block are cut into blocks."""
    length = min(before.shape[2], round(BLOCK_S * rate_hz))
    cuts = range(0, before.shape[2] - length // 2, length)
    squares = np.stack(
        [
            [np.mean(e[:, :, cut : cut + length] ** 2, axis=(1, 2)) for cut in cuts]
            for e in (before, after, before - after)
        ]
    )
    middle_s = (starts + np.array(cuts)[:, None] + length / 2) / rate_hz
    least = 1e-12 * max(float(np.max(squares[:2])), 1e-300)
    before_squares, after_squares = np.maximum(squares[:2], least)
    ratios = np.log(after_squares / before_squares) / 2, -np.log1p(squares[2] / after_squares) / 2
    blocks = np.floor(middle_s / BLOCK_S).ravel()
    return BlockRatios(*(_means(row.ravel(), blocks) for row in ratios))


def _means(values: Float[np.ndarray, " all"], blocks: Float[np.ndarray, " all"]) -> Float[np.ndarray, " blocks"]:
    """Mean of the values in each block."""
    return np.array([values[blocks == block].mean() for block in np.unique(blocks)])


def veto(blocks: BlockRatios) -> Code:
    """Code `worse` if the corrected rig predicts significantly worse by Student's test over blocks, or `not_vetoed`."""
    ratios = blocks.log_ratios
    quantile = float(student.ppf(1 - VETO_P_VALUE, ratios.size - 1))
    return "worse" if ratios.mean() > max(WORSE, quantile * standard_error(ratios)) else "not_vetoed"


def falls_short(blocks: BlockRatios) -> bool:
    """True if the predictions differ but do not improve as those of a right correction would.

    This holds as well for two rigs within the tolerances that err alike: simulations decide (`confirm_by_simulations`).
    """
    ratios, shortfalls = blocks.log_ratios, blocks.log_ratios - blocks.expected
    quantile = float(student.ppf(1 - VETO_P_VALUE, ratios.size - 1))
    differs = blocks.expected.mean() < -BETTER and shortfalls.mean() > quantile * standard_error(shortfalls)
    return bool(differs and ratios.mean() > -quantile * standard_error(ratios))


def log_ratio_of(
    recording: Recording, nominal_fit: Residual, corrected_fit: Residual, samples: int, predict: Predict
) -> float:
    """Mean log ratio of the errors of two rigs, both fitted to a recording, at a horizon of `samples`."""
    motions = [
        measured_motion(recording, residual.corrected_rig, residual) for residual in (nominal_fit, corrected_fit)
    ]
    start, stop = max(m.first_sample for m in motions), min(m.stop_sample for m in motions)
    starts = disjoint_starts(start, stop - start, samples, MAX_WINDOWS)
    before, after = (prediction_errors(motion, predict, starts, samples) for motion in motions)
    return float(block_ratios(before, after, starts, recording.rig.sample_rate_hz).log_ratios.mean())


def confirm_by_simulations(rollout: Rollout, simulated: Sequence[float]) -> Rollout:
    """Rollout with the veto `no_improvement` if it falls short of simulated machines that have the named effects.

    `simulated` are the mean log ratios of three or more such machines (`log_ratio_of`), fitted and predicted likewise.
    The veto needs a log ratio above Student's prediction limit of theirs, and a limit that lies below -BETTER / 2.
    """
    if not rollout.falls_short or len(simulated) < 3 or rollout.log_ratio is None:
        return rollout
    mean, count = float(np.mean(simulated)), len(simulated)
    quantile = float(student.ppf(1 - VETO_P_VALUE, count - 1))
    margin = quantile * float(
        np.hypot(np.std(simulated, ddof=1) * np.sqrt(1 + 1 / count), rollout.log_ratio_error or 0.0)
    )
    improves = mean + margin < -BETTER / 2
    return replace(rollout, code="no_improvement") if improves and rollout.log_ratio > mean + margin else rollout


def standard_error(blocks: Float[np.ndarray, " blocks"]) -> float:
    """Standard error of the mean of a series, increased by the correlation of neighbours."""
    deviations = blocks - blocks.mean()
    power = float(deviations @ deviations)
    correlation = float(np.clip(deviations[1:] @ deviations[:-1] / power, 0.0, 0.9)) if power > 0 else 0.0
    return float(np.sqrt(power / max(blocks.size - 1, 1) / blocks.size * (1 + correlation) / (1 - correlation)))


def null_bounds(nulls: Sequence[NullErrors], samples: int) -> list[tuple[float, float]]:
    """Median error of the fitted rig in null simulations, and the upper 95 % prediction limit of that of the nominal
    rig (Student, of the logarithm) at a horizon: of all sensors together, then of each."""
    rows = [(null, null.samples.index(samples)) for null in nulls if samples in null.samples]
    medians = np.median([null.within[k] for null, k in rows], axis=0)
    logs, count = np.log(np.maximum([null.nominal[k] for null, k in rows], 1e-300)), len(rows)
    factor = student.ppf(0.95, count - 1) * np.sqrt(1 + 1 / count) if count > 1 else 0.0
    limits = np.exp(logs.mean(axis=0) + factor * logs.std(axis=0, ddof=min(1, count - 1)))
    return list(zip(medians.tolist(), limits.tolist(), strict=True))


def _errors_by_sensor(
    nominal: Windows, corrected: Windows, null_errors: list[tuple[float, float]]
) -> list[PredictionErrors]:
    """Median errors of all sensors together, then of each, beside the median and limit of null simulations."""
    return [
        PredictionErrors(
            nominal=before,
            corrected=after,
            null_median=median,
            null_95=bound,
            shrunk=None if before <= bound else shrunk_share(before, after, median),
        )
        for before, after, (median, bound) in zip(
            median_errors(nominal), median_errors(corrected), null_errors, strict=True
        )
    ]


def shrunk_share(nominal: float, corrected: float, null: float) -> float:
    """Share of the mismatch beyond null simulations that a correction removes, at most 1."""
    return min(1.0, (nominal**2 - corrected**2) / max(nominal**2 - null**2, 1e-300))


def _shrinkage_interval(
    nominal: Float[np.ndarray, " windows"],
    corrected: Float[np.ndarray, " windows"],
    null: float,
    blocks: Float[np.ndarray, " windows"],
) -> tuple[float, float]:
    """95 % interval of `shrunk_share` by a bootstrap over blocks."""
    rng, members = np.random.default_rng(0), [np.flatnonzero(blocks == b) for b in np.unique(blocks)]
    resamples = [
        np.concatenate([members[k] for k in rng.integers(0, len(members), len(members))])
        for _ in range(BOOTSTRAP_DRAWS)
    ]
    values = [
        shrunk_share(float(np.median(nominal[resample])), float(np.median(corrected[resample])), null)
        for resample in resamples
    ]
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)
