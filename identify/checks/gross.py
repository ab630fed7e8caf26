"""Gross faults of channels, forces or rig.json: the one change after which the linear model fits the record."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from identify.checks.channels import (
    MAX_REMAINING_SHARE,
    MIN_ERROR_IN_TOLERANCES,
    DelaysOnDemand,
    DelaysOverTime,
    delays_over_time,
    force_finding,
    gain_finding,
    likeliest_channel_finding,
    turned_finding,
)
from identify.checks.findings import Finding, merge_by_cause
from identify.checks.prediction import LinearCheck, Prediction, linear_check
from identify.checks.pulls import required_distance_in_tolerances, required_pull
from identify.checks.relations import PerLine
from identify.checks.rigs import Trial, rig_trials
from identify.checks.spectra import Spectra
from rig.model.description import Rig
from rig.model.tolerances import Tolerances

SOUND_MISFIT = 0.3
"""Largest misfit that is taken for one of tolerances, if they explain no larger one."""
MAX_REMAINING_SHARE_IF_DOUBTED = 0.6
"""The same for a record with a sound fit that is doubted."""
MIN_GAIN_ERROR = 0.1
"""Gains that are fitted all at once are reported if they are off by more."""
FREED_CHANNEL_MISFIT_FACTOR = 1.5
"""Factor on the misfit of a change that frees a channel."""

SpectraOnDemand = Callable[[], Spectra]
"""Spectra on all lines, computed on demand."""


@dataclass(frozen=True)
class GrossFaults:
    """Gross findings, the channels that can be trusted, and whether these fit the model."""

    findings: tuple[Finding, ...]
    trusted_indices: list[int]
    is_sound: bool


@dataclass(frozen=True)
class ToleranceQuestions:
    """Questions to the joint fit of all tolerances, answered on demand: do errors within them explain the record, and
    by how many standard deviations does a change of rig.json explain it better, of how many tolerances?"""

    tolerances: Tolerances
    tolerances_explain: Callable[[], bool]
    pull_and_distance_of: Callable[[Trial], tuple[float, float]]


def gross_faults(
    rig: Rig,
    spectra: Spectra,
    usable_indices: list[int],
    all_line_spectra: SpectraOnDemand,
    tolerance_questions: ToleranceQuestions,
    is_doubted: bool = False,
) -> GrossFaults:
    """Findings by the change with the smallest misfit.

    A change of one channel, a force, two swapped channels, all gains or rig.json; or several channels excluded. Where
    errors within all tolerances explain the record, only a change of rig.json that these errors do not replace.
    `all_line_spectra` gives the spectra on all lines. In a record with a sound fit that is doubted, only a change that
    fits much better is reported.
    """
    check = linear_check(rig, spectra, usable_indices)
    misfit = check.prediction(usable_indices).misfit
    tolerances = tolerance_questions.tolerances
    force_trials = list(_doubted_force_trials(rig, check, usable_indices, all_line_spectra))
    # with several forces, the estimate of a weak one follows the errors of the model
    force_findings = force_trials[0].findings() if len(force_trials) == 1 else ()
    force_faults = [f for f in force_findings if f.cause in ("force", "filtered")]
    if misfit < SOUND_MISFIT and force_faults and tolerance_questions.tolerances_explain():
        force_faults = []  # where the force hardly moves the rig, errors of the model are taken for its filter
    if misfit < SOUND_MISFIT and (force_faults or not is_doubted):
        return GrossFaults(tuple(force_faults), usable_indices, not force_faults)
    if misfit >= SOUND_MISFIT and tolerance_questions.tolerances_explain():
        best_trial = min(rig_trials(rig, spectra, usable_indices), key=lambda trial: trial.misfit)
        (finding,) = best_trial.findings()
        pull, distance_in_tolerances = tolerance_questions.pull_and_distance_of(best_trial)
        is_rig_wrong = pull > required_pull(finding.cause) and distance_in_tolerances > required_distance_in_tolerances(
            finding.cause
        )
        return GrossFaults((finding,) if is_rig_wrong else (), usable_indices, not is_rig_wrong)
    trials = [
        *force_trials,
        *_doubted_channel_trials(rig, check, usable_indices, all_line_spectra, tolerances),
        *_swap_trials(check, usable_indices),
        *_all_channel_gain_trials(rig, check, usable_indices),
        *_turned_trials(rig, check, usable_indices, tolerances),
        *rig_trials(rig, spectra, usable_indices),
    ]
    best_trial = _likeliest_trial(trials, misfit)
    if misfit < SOUND_MISFIT and best_trial.misfit * best_trial.misfit_factor > MAX_REMAINING_SHARE_IF_DOUBTED * misfit:
        return GrossFaults((), usable_indices, True)
    if best_trial.misfit >= SOUND_MISFIT:
        multiple_faults = _multiple_channel_faults(rig, check, usable_indices, all_line_spectra, tolerances)
        if multiple_faults is not None:
            return multiple_faults
        if best_trial.misfit >= MAX_REMAINING_SHARE * misfit:
            return GrossFaults((_unexplained_misfit_finding(misfit),), usable_indices, False)
    is_sound = best_trial.is_rest_right and best_trial.misfit < SOUND_MISFIT
    return GrossFaults(best_trial.findings(), best_trial.trusted_indices, is_sound)


def _likeliest_trial(trials: list[Trial], misfit: float) -> Trial:
    """Trial that leaves least; one whose finding names no cause only if no other leaves little."""
    ranked = sorted(trials, key=lambda trial: trial.misfit * trial.misfit_factor)
    for trial in ranked:
        if trial.misfit * trial.misfit_factor >= MAX_REMAINING_SHARE * misfit:
            break
        if any(finding.cause != "unexplained" for finding in trial.findings()):
            return trial
    return ranked[0]


def _unexplained_misfit_finding(misfit: float) -> Finding:
    """Finding: no single change makes the model fit."""
    return Finding(
        cause="model",
        evidence="the sensors do not move as the linear bodies of rig.json do under the force and any contact forces "
        f"(off by {min(3 * np.sqrt(misfit), 100):.2g} % of the motion)",
        mend="check geometry, ends, stations and units in rig.json, and that the record is of this rig",
    )


def _doubted_channel_trials(
    rig: Rig,
    check: LinearCheck,
    usable_indices: list[int],
    all_line_spectra: SpectraOnDemand,
    tolerances: Tolerances,
) -> Iterator[Trial]:
    """Trials that predict one channel by the others."""
    for channel_index in usable_indices:
        others = [i for i in usable_indices if i != channel_index]
        check_without = check.with_spectra(check.spectra, others)
        prediction = check_without.prediction(others)
        if np.isfinite(prediction.misfit):
            find = partial(
                _channel_findings, rig, check_without, prediction, channel_index, others, all_line_spectra, tolerances
            )
            yield Trial(prediction.misfit, others, find, misfit_factor=FREED_CHANNEL_MISFIT_FACTOR)


def _channel_findings(
    rig: Rig,
    check: LinearCheck,
    prediction: Prediction,
    channel_index: int,
    predicting_indices: list[int],
    all_line_spectra: SpectraOnDemand,
    tolerances: Tolerances,
) -> tuple[Finding, ...]:
    """Finding on a channel by its prediction."""
    delays = partial(channel_delays, rig, all_line_spectra, channel_index, predicting_indices)
    return (likeliest_channel_finding(rig, check, channel_index, prediction, delays, tolerances),)


def channel_delays(
    rig: Rig, all_line_spectra: SpectraOnDemand, channel_index: int, predicting_indices: list[int]
) -> DelaysOverTime:
    """Delays of a channel against its prediction by others."""
    spectra = all_line_spectra()
    check = linear_check(rig, spectra, predicting_indices)
    predicted = check.prediction(predicting_indices).accelerations[channel_index]
    return delays_over_time(spectra, spectra.acceleration[channel_index], predicted, check.error_scale[channel_index])


def force_delays(
    rig: Rig, all_line_spectra: SpectraOnDemand, force_index: int, channel_indices: list[int]
) -> DelaysOverTime:
    """Delays of a force against the one that the sensors imply."""
    spectra = all_line_spectra()
    check = linear_check(rig, spectra, channel_indices)
    implied = check.prediction(channel_indices, doubted_force_index=force_index).force_spectra[force_index]
    weights = _force_line_weights(check, channel_indices, force_index)
    return delays_over_time(
        spectra, spectra.forces[force_index], implied, 1 / np.maximum(weights, 1e-12 * weights.max())
    )


def _doubted_force_trials(
    rig: Rig, check: LinearCheck, usable_indices: list[int], all_line_spectra: SpectraOnDemand
) -> Iterator[Trial]:
    """Trials that estimate one force from the sensors."""
    for force_index in range(len(check.spectra.forces)):
        prediction = check.prediction(usable_indices, doubted_force_index=force_index)
        if np.isfinite(prediction.misfit):
            delays = partial(force_delays, rig, all_line_spectra, force_index, usable_indices)
            find = partial(_force_findings, check, usable_indices, force_index, prediction, delays)
            yield Trial(prediction.misfit, usable_indices, find, False, FREED_CHANNEL_MISFIT_FACTOR)


def _force_findings(
    check: LinearCheck, usable_indices: list[int], force_index: int, prediction: Prediction, delays: DelaysOnDemand
) -> tuple[Finding, ...]:
    """Finding on a force by its estimate."""
    line_weights = _force_line_weights(check, usable_indices, force_index)
    return (force_finding(check.spectra, force_index, prediction.force_spectra[force_index], line_weights, delays),)


def _force_line_weights(check: LinearCheck, channel_indices: list[int], force_index: int) -> PerLine:
    """Weights of the lines by what the sensors show of a force."""
    force_accelerance = check.accelerance[force_index][channel_indices]
    scaled_accelerance = force_accelerance / check.error_scale[channel_indices]
    if len(check.spectra.forces) > 1:  # what no contact force does too
        scaled_accelerance = check.unknown_input_projection(channel_indices).applied_to(force_accelerance)[0]
    return np.sqrt(np.mean(np.abs(scaled_accelerance) ** 2, axis=0))


def _swap_trials(check: LinearCheck, usable_indices: list[int]) -> Iterator[Trial]:
    """Trials that exchange two sensors or two forces."""
    spectra = check.spectra
    for i, k in combinations(usable_indices, 2):
        swapped_acceleration = spectra.acceleration.copy()
        swapped_acceleration[[i, k]] = swapped_acceleration[[k, i]]
        misfit = check.misfit(spectra.with_acceleration(swapped_acceleration), usable_indices)
        trusted_indices = [index for index in usable_indices if index not in (i, k)]
        find = partial(_swap_findings, (spectra.sensors[i].name, spectra.sensors[k].name))
        yield Trial(misfit, trusted_indices, find)
    for i, k in combinations(range(len(spectra.forces)), 2):
        swapped_forces = spectra.forces.copy()
        swapped_forces[[i, k]] = swapped_forces[[k, i]]
        misfit = check.misfit(replace(spectra, forces=swapped_forces), usable_indices)
        find = partial(_swap_findings, (spectra.force_names[i], spectra.force_names[k]))
        yield Trial(misfit, usable_indices, find, False)


def _swap_findings(names: tuple[str, str]) -> tuple[Finding, ...]:
    """Finding: two channels are swapped."""
    return (
        Finding(
            cause="swapped",
            channels=names,
            evidence=f"{names[0]} and {names[1]} fit the model if they change places",
            mend="swap their cables, or their columns in the import map",
        ),
    )


def _all_channel_gain_trials(rig: Rig, check: LinearCheck, usable_indices: list[int]) -> Iterator[Trial]:
    """Trial: all channels' gains by linear least squares: the factors that minimise the projected residual.

    Finds polarities, units and gains of several channels at once, in three rounds, each in the scale of the one before.
    """
    spectra, sensor_gains = check.spectra, np.ones(len(check.spectra.sensors))
    scaled = spectra.acceleration
    for _ in range(3):
        check = check.with_spectra(spectra.with_acceleration(scaled), usable_indices)
        projection = check.unknown_input_projection(usable_indices)
        columns = np.array([projection.applied_to(scaled[[i]], [k])[0].ravel() for k, i in enumerate(usable_indices)])
        force_column = projection.applied_to(check.acceleration_by_all_forces[usable_indices])[0].ravel()
        normal_matrix = (columns.conj() @ columns.T).real
        normal_matrix += 1e-9 * np.trace(normal_matrix) * np.eye(len(usable_indices))
        correction_factors = np.linalg.solve(normal_matrix, (columns.conj() @ force_column).real)
        if not np.all(np.isfinite(correction_factors)) or np.any(np.abs(correction_factors) < 1e-9):
            return
        scaled = scaled.copy()
        scaled[usable_indices] *= correction_factors[:, None]
        sensor_gains[usable_indices] /= correction_factors
    misfit = check.misfit(spectra.with_acceleration(scaled), usable_indices)
    miscalibrated_indices = [i for i in usable_indices if abs(sensor_gains[i] - 1) > MIN_GAIN_ERROR]
    if miscalibrated_indices:
        findings = [gain_finding(spectra.sensors[i].name, float(sensor_gains[i])) for i in miscalibrated_indices]
        trusted_indices = [i for i in usable_indices if i not in miscalibrated_indices]
        find = partial(merge_by_cause, findings, rig)
        yield Trial(misfit, trusted_indices, find, misfit_factor=FREED_CHANNEL_MISFIT_FACTOR**2)


def _turned_trials(rig: Rig, check: LinearCheck, usable_indices: list[int], tolerances: Tolerances) -> Iterator[Trial]:
    """Trial: all sensors are turned, and show shares of the motion across that minimise the projected residual."""
    spectra = check.spectra
    turnable = [k for k, i in enumerate(usable_indices) if np.any(spectra.across[i])]
    if not turnable:
        return
    projection = check.unknown_input_projection(usable_indices)
    columns = np.array([projection.applied_to(spectra.across[[usable_indices[k]]], [k])[0].ravel() for k in turnable])
    unforced = (spectra.acceleration - check.acceleration_by_all_forces)[usable_indices]
    residual = projection.applied_to(unforced)[0].ravel()
    normal_matrix = (columns.conj() @ columns.T).real
    normal_matrix += 1e-9 * np.trace(normal_matrix) * np.eye(len(turnable))
    shares = np.linalg.solve(normal_matrix, (columns.conj() @ residual).real)
    aligned = spectra.acceleration.copy()
    findings, turned_indices = list[Finding](), list[int]()
    for k, share in zip(turnable, shares.tolist(), strict=True):
        index = usable_indices[k]
        aligned[index] -= share * spectra.across[index]
        name = spectra.sensors[index].name
        if abs(share) > MIN_ERROR_IN_TOLERANCES * tolerances.of_sensor(name).cross_axis:
            findings.append(turned_finding(name, share))
            turned_indices.append(index)
    if findings:
        misfit = check.misfit(spectra.with_acceleration(aligned), usable_indices)
        trusted_indices = [i for i in usable_indices if i not in turned_indices]
        find = partial(merge_by_cause, findings, rig)
        yield Trial(misfit, trusted_indices, find, misfit_factor=FREED_CHANNEL_MISFIT_FACTOR)


def _multiple_channel_faults(
    rig: Rig,
    check: LinearCheck,
    usable_indices: list[int],
    all_line_spectra: SpectraOnDemand,
    tolerances: Tolerances,
) -> GrossFaults | None:
    """Faults of several channels, excluded one by one, the worst first, while three more than the contacts remain."""
    trusted_indices, excluded_indices = list(usable_indices), list[int]()
    while len(trusted_indices) > len(rig.contacts) + 3 and len(excluded_indices) < len(usable_indices) / 2:
        misfit, worst_index = min(
            (check.misfit(check.spectra, [k for k in trusted_indices if k != i]), i) for i in trusted_indices
        )
        trusted_indices.remove(worst_index)
        excluded_indices.append(worst_index)
        if misfit < SOUND_MISFIT:
            check = check.with_spectra(check.spectra, trusted_indices)
            prediction = check.prediction(trusted_indices)
            findings = list[Finding]()
            for channel_index in sorted(excluded_indices):
                findings += _channel_findings(
                    rig, check, prediction, channel_index, trusted_indices, all_line_spectra, tolerances
                )
            return GrossFaults(merge_by_cause(findings, rig), trusted_indices, True)
    return None
