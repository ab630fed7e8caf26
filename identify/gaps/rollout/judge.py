"""Prediction as the judge of a correction: it vetoes, and never licenses.

The believed and the corrected rig are predicted over the same windows, from states by the same estimator. With the
difference D of their predictions' errors, and a correction that is right,

    E_believed^2 = E_corrected^2 + D^2        ln(E_corrected / E_believed) = -ln(1 + D^2 / E_corrected^2) / 2

as what remains has nothing to do with what was corrected. Within a horizon of two contacts many a wrong rig predicts as
well as the right one, so that a correction which predicts no worse is not therefore right.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from msgspec.structs import replace
from scipy.stats import t as student

from identify.gaps.residual.residual import Residual
from identify.gaps.rollout.decay import compared_modes
from identify.gaps.rollout.results import Code, DecayMode, NullErrors, PredictionErrors, Rollout
from identify.gaps.rollout.states import MeasuredMotion, motion_of
from identify.gaps.rollout.windows import Predict, Windows, errors_of, horizon_of, medians, predicted, size_of, spread
from identify.signals.ringing import modes_of_decay
from rig.errors import RigError
from rig.model.modes import modes_of
from rig.recording import Recording

WINDOWS = 240
"""Of a record, at most."""
BLOCK_S, BLOCKS = 1.0, 5
"""Windows are averaged over blocks of so long, and a test has so many at least."""
SURE = 0.01
"""One-sided p-value of a veto."""
WORSE, BETTER = 0.05, 0.05
"""Mean logarithms of ratios of errors below which nothing is vetoed: by which the corrected rig is worse, or would be
better if it were right."""
DRAWS = 400


def judged(
    recording: Recording, believed: Residual, corrected: Residual, nulls: Sequence[NullErrors], predict: Predict
) -> Rollout:
    """Judgement of a correction by prediction, on the recording of the record to which both rigs were fitted.

    The believed rig is predicted as it stands, and with what was fitted within its tolerances; the latter is what the
    corrected one, likewise fitted, must not be worse than.
    """
    samples = horizon_of(nulls)
    if samples is None:
        return Rollout(code="no_horizon")
    fits = ((believed.rig, believed), (believed.corrected_rig, believed), (corrected.corrected_rig, corrected))
    motions = [motion_of(recording, rig, at) for rig, at in fits]
    begin, end = max(m.first for m in motions), min(m.stop for m in motions)
    rate = recording.rig.sample_rate_hz
    if end - begin < max(BLOCKS * BLOCK_S * rate, samples):
        return Rollout(code="too_short")
    first = spread(begin, end - begin, samples, WINDOWS)
    try:
        nominal, within, after = (errors_of(motion, predict, first, samples) for motion in motions)
        decay = () if believed.model.record.forced else _decay(motions[0], motions[2], believed, predict, begin, end)
    except RigError:
        return Rollout(code="not_simulated")
    paired = paired_blocks(within, after, first, rate)
    whole, *at_sensors = _told(nominal, after, bounds(nulls, samples))
    blocks = np.floor((first + samples / 2) / rate / BLOCK_S)
    sizes = size_of(nominal), size_of(after)
    return Rollout(
        code=veto(paired),
        horizon_s=samples / rate,
        windows=first.size,
        whole=whole,
        shrunk_95=None if whole.shrunk is None else _interval(*sizes, whole.null_median, blocks),
        within=float(np.median(size_of(within))),
        log_ratio=float(paired.log_ratios.mean()),
        log_ratio_error=standard_error(paired.log_ratios),
        expected_log_ratio=float(paired.expected.mean()),
        falls_short=falls_short(paired),
        by_sensor=dict(zip(motions[0].names, at_sensors, strict=True)),
        decay=decay,
    )


def _decay(
    nominal: MeasuredMotion, corrected: MeasuredMotion, believed: Residual, predict: Predict, begin: int, end: int
) -> tuple[DecayMode, ...]:
    """The modes of the whole decay and of its predictions."""
    rig, highest_hz = nominal.rig, believed.model.record.highest_hz
    naturals = [modes_of(rig, body).frequencies_hz(body.max_modes) for body in rig.bodies]
    most = 2 + sum(int(np.count_nonzero(hz < highest_hz)) for hz in naturals)
    rows = [predicted(motion, predict, np.array([begin]), end - begin) for motion in (nominal, corrected)]
    signals = [rows[0][0], rows[0][1], rows[1][1]]
    return compared_modes(
        *(modes_of_decay(np.nan_to_num(one[0]), nominal.sample_rate_hz, highest_hz, most) for one in signals)
    )


@dataclass(frozen=True)
class Paired:
    """Log ratios by blocks of 1 s: ln(error of corrected rig / error of nominal one), and those if it were right."""

    log_ratios: Float[np.ndarray, " blocks"]
    expected: Float[np.ndarray, " blocks"]


def paired_blocks(before: Windows, after: Windows, first: Int[np.ndarray, " windows"], rate_hz: float) -> Paired:
    """Paired blocks of the errors of both; windows that are longer than a block are cut into such."""
    length = min(before.shape[2], round(BLOCK_S * rate_hz))
    cuts = range(0, before.shape[2] - length // 2, length)
    squares = np.stack(
        [
            [np.mean(e[:, :, cut : cut + length] ** 2, axis=(1, 2)) for cut in cuts]
            for e in (before, after, before - after)
        ]
    )
    middle = (first + np.array(cuts)[:, None] + length / 2) / rate_hz
    least = 1e-12 * max(float(np.max(squares[:2])), 1e-300)
    old, new = np.maximum(squares[:2], least)
    ratios = np.log(new / old) / 2, -np.log1p(squares[2] / new) / 2
    blocks = np.floor(middle / BLOCK_S).ravel()
    return Paired(*(_means(row.ravel(), blocks) for row in ratios))


def _means(values: Float[np.ndarray, " all"], blocks: Float[np.ndarray, " all"]) -> Float[np.ndarray, " blocks"]:
    return np.array([values[blocks == block].mean() for block in np.unique(blocks)])


def veto(paired: Paired) -> Code:
    """True if the corrected rig predicts significantly worse: Student's test over the blocks."""
    ratios = paired.log_ratios
    beyond = float(student.ppf(1 - SURE, ratios.size - 1))
    return "worse" if ratios.mean() > max(WORSE, beyond * standard_error(ratios)) else "not_vetoed"


def falls_short(paired: Paired) -> bool:
    """True if the corrected rig predicts otherwise and not better, though it would if it were right.

    Where both rigs err alike, as two within the tolerances may, that is so too: simulations decide (`confirmed`).
    """
    ratios, missed = paired.log_ratios, paired.log_ratios - paired.expected
    beyond = float(student.ppf(1 - SURE, ratios.size - 1))
    differs = paired.expected.mean() < -BETTER and missed.mean() > beyond * standard_error(missed)
    return bool(differs and ratios.mean() > -beyond * standard_error(ratios))


def log_ratio_of(
    recording: Recording, believed: Residual, corrected: Residual, samples: int, predict: Predict
) -> float:
    """The mean logarithm of the errors' ratio on a recording to which both rigs were fitted."""
    motions = [motion_of(recording, at.corrected_rig, at) for at in (believed, corrected)]
    begin, end = max(m.first for m in motions), min(m.stop for m in motions)
    first = spread(begin, end - begin, samples, WINDOWS)
    before, after = (errors_of(motion, predict, first, samples) for motion in motions)
    return float(paired_blocks(before, after, first, recording.rig.sample_rate_hz).log_ratios.mean())


def confirmed(told: Rollout, simulated: Sequence[float]) -> Rollout:
    """A rollout that falls short, vetoed if simulations of machines with the named effects, fitted and predicted
    likewise, all say that the prediction would have improved as this one does not.

    simulated are their mean logarithms (`log_ratio_of`), three or more; Student's prediction is made from them.
    """
    if not told.falls_short or len(simulated) < 3 or told.log_ratio is None:
        return told
    mean, count = float(np.mean(simulated)), len(simulated)
    beyond = float(student.ppf(1 - SURE, count - 1))
    margin = beyond * float(np.hypot(np.std(simulated, ddof=1) * np.sqrt(1 + 1 / count), told.log_ratio_error or 0.0))
    improves = mean + margin < -BETTER / 2
    return replace(told, code="no_improvement") if improves and told.log_ratio > mean + margin else told


def standard_error(blocks: Float[np.ndarray, " blocks"]) -> float:
    """Standard error of the mean of a series: neighbours that resemble each other count for fewer."""
    off = blocks - blocks.mean()
    power = float(off @ off)
    alike = float(np.clip(off[1:] @ off[:-1] / power, 0.0, 0.9)) if power > 0 else 0.0
    return float(np.sqrt(power / max(blocks.size - 1, 1) / blocks.size * (1 + alike) / (1 - alike)))


def bounds(nulls: Sequence[NullErrors], samples: int) -> list[tuple[float, float]]:
    """Bounds of null simulations over a horizon: the median of the fitted rig's errors, and what those of the rig as it
    stands stay below in 95 % (Student's prediction of their logarithm); of all sensors together, then of each.
    """
    known = [(null, null.samples.index(samples)) for null in nulls if samples in null.samples]
    middle = np.median([null.within[k] for null, k in known], axis=0)
    logs, count = np.log(np.maximum([null.nominal[k] for null, k in known], 1e-300)), len(known)
    beyond = student.ppf(0.95, count - 1) * np.sqrt(1 + 1 / count) if count > 1 else 0.0
    high = np.exp(logs.mean(axis=0) + beyond * logs.std(axis=0, ddof=min(1, count - 1)))
    return list(zip(middle.tolist(), high.tolist(), strict=True))


def _told(nominal: Windows, corrected: Windows, nulls: list[tuple[float, float]]) -> list[PredictionErrors]:
    """Errors of all sensors together, then of each, with the median and the bound of null simulations."""
    return [
        PredictionErrors(
            nominal=before,
            corrected=after,
            null_median=median,
            null_95=bound,
            shrunk=None if before <= bound else shrunk(before, after, median),
        )
        for before, after, (median, bound) in zip(medians(nominal), medians(corrected), nulls, strict=True)
    ]


def shrunk(nominal: float, corrected: float, null: float) -> float:
    """The share of a gap that a correction closes, of what null simulations do not have; at most one."""
    return min(1.0, (nominal**2 - corrected**2) / max(nominal**2 - null**2, 1e-300))


def _interval(
    nominal: Float[np.ndarray, " windows"],
    corrected: Float[np.ndarray, " windows"],
    null: float,
    blocks: Float[np.ndarray, " windows"],
) -> tuple[float, float]:
    """The 95 % interval of what is closed: a bootstrap over blocks."""
    rng, own = np.random.default_rng(0), [np.flatnonzero(blocks == b) for b in np.unique(blocks)]
    drawn = [np.concatenate([own[k] for k in rng.integers(0, len(own), len(own))]) for _ in range(DRAWS)]
    values = [shrunk(float(np.median(nominal[d])), float(np.median(corrected[d])), null) for d in drawn]
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)
