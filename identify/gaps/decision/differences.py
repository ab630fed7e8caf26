"""Differences between the records of one rig, and the parameters that they share.

All records share one draw of the tolerances; the parameters of a cause, and of every effect of the library at every
place, are in turn free in each record. With their values v, covariance C and contrasts A between the records,

    chi2 = (Av)' (A C A')^-1 (Av) / TEMPERATURE

(Wald's test of homogeneity, tempered as hypotheses are). The smallest p-value, times the number of effects tested
(Bonferroni), must be below `USUAL_P_VALUE`; that effect is then in the rig with each record's value, and the library is
tested once more, and again with the second effect taken first.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2

from identify.gaps.decision.comparison import TEMPERATURE, ValidatedHypothesis, record_specific_rig
from identify.gaps.decision.modal_changes import driven_band_hz, has_several_force_levels, level_dependence
from identify.gaps.decision.record_values import EffectValues, RecordSet, VaryingParameters
from identify.gaps.decision_table import USUAL_P_VALUE
from identify.gaps.residual.likelihood import NominalVariances
from identify.gaps.residual.record import Record
from identify.gaps.results import ParameterByRecord, RecordDifferences, Trend
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.pooled import PooledEstimate, RecordInformation
from rig.errors import RigError
from rig.model.unmeasured_force import Value

FITTED_EFFECTS = 3
"""Number of the likeliest differing effects that are fitted to every record. Effort."""
TREND_STANDARD_ERRORS = 2.0
"""Standard errors of a step from one record to the next above which a value grows or falls. Convention."""


@dataclass(frozen=True)
class HomogeneityTest:
    """Fit of an effect with each record's own strength, and the log p-value of one strength for all records."""

    candidate: Candidate
    varying: VaryingParameters
    cost: float
    log_p_value: float

    @property
    def effect_values(self) -> Float[np.ndarray, "records own"]:
        return self.varying.effects.values_by_record[:, self.varying.effects.columns_of(self.candidate.name)]


@dataclass(frozen=True)
class _ComparedRecords(RecordSet):
    """Records, and the candidates whose values are compared between them."""

    candidates: Sequence[Candidate]

    def screened_tests(self, effects: EffectValues, excluded_names: Sequence[str]) -> list[HomogeneityTest]:
        """Linearised tests of every effect not excluded, each at its best place; the likeliest first."""
        trials = [
            (candidate, effects.varying_strengths(candidate))
            for candidate in effects.candidates
            if candidate.name not in excluded_names
        ]
        for candidate in self.candidates:
            for start_values in candidate.start_values() if candidate.name not in effects.effect_names else ():
                with_candidate = effects.with_effect(candidate, np.tile(start_values, (len(self.records), 1)))
                trials.append((candidate, with_candidate.varying_strengths(candidate)))
        trial_information: list[list[RecordInformation]] = [[] for _ in trials]
        for record_index in range(len(self.records)):
            record_fit = self.linearized_record(effects, record_index)
            for information, (_, varying) in zip(trial_information, trials, strict=True):
                with suppress(RigError):
                    information.append(varying.information(record_index, record_fit))
        best_tests: dict[str, HomogeneityTest] = {}
        for information, (candidate, varying) in zip(trial_information, trials, strict=True):
            if len(information) == len(self.records):
                estimate = varying.pooled(information)
                if candidate.name not in best_tests or estimate.cost < best_tests[candidate.name].cost:
                    best_tests[candidate.name] = _homogeneity_test(candidate, varying.at_estimate(estimate), estimate)
        return sorted(best_tests.values(), key=lambda test: test.cost)

    def likeliest_differing_effect(
        self, effects: EffectValues, excluded: Sequence[str]
    ) -> tuple[HomogeneityTest | None, int]:
        """Likeliest effect of those that differ between the records beyond chance, and the number of effects tested."""
        screened_tests = self.screened_tests(effects, excluded)
        log_threshold = float(np.log(USUAL_P_VALUE / max(1, len(screened_tests))))
        fitted_tests = []
        for test in [test for test in screened_tests if test.log_p_value < log_threshold][:FITTED_EFFECTS]:
            with suppress(RigError):
                fitted_tests.append(_homogeneity_test(test.candidate, *self.joint_fit(test.varying)))
        significant = (test for test in fitted_tests if test.log_p_value < log_threshold)
        return min(significant, key=lambda test: test.cost, default=None), len(screened_tests)


def _homogeneity_test(candidate: Candidate, own_values: VaryingParameters, estimate: PooledEstimate) -> HomogeneityTest:
    log_p_value = _homogeneity_log_p(estimate, own_values.record_values.shape)
    return HomogeneityTest(candidate, own_values, estimate.cost, log_p_value)


def differences(
    records: Sequence[Record],
    variances_by_record: Sequence[NominalVariances],
    cause: ValidatedHypothesis | None,
    candidates: Sequence[Candidate],
    record_titles: Sequence[str],
    force_levels_n: Sequence[float],
    progress: Callable[[float], None] = lambda _: None,
) -> RecordDifferences:
    """Differences between the records of a rig with a cause, or of the nominal rig.

    candidates are the effects at all places; record_titles and force_levels_n (root mean squares, N) belong to the
    records.
    """
    levels_differ = has_several_force_levels(force_levels_n)
    record_set = _ComparedRecords(records, variances_by_record, comparable_candidates(candidates, levels_differ))
    initial_effects = _initial_effects(records, cause)
    records_by_level = np.argsort(force_levels_n) if levels_differ else None
    tests, tested_effect_count = _differing_effects(record_set, initial_effects, progress)
    varied, varied_estimate = _fit_differing_values(record_set, initial_effects, tests)
    differing, level_change = [], None
    if varied_estimate:
        differing = _parameters_by_record(varied, varied_estimate, tested_effect_count, records_by_level)
        covariance, band_hz = TEMPERATURE * varied_estimate.covariance, driven_band_hz(records)
        level_change = level_dependence(
            varied.rigs_at, varied.record_values.ravel(), covariance, force_levels_n, differing, band_hz
        )
    shared_names = [name for name in initial_effects.effect_names if name not in {t.candidate.name for t in tests}]
    shared_columns = [column for name in shared_names for column in varied.effects.columns_of(name)]
    shared = VaryingParameters(varied.effects, shared_columns)
    estimate = record_set.pooled_estimate(shared) if shared_columns else None
    progress(1.0)
    return RecordDifferences(
        records=tuple(record_titles),
        cause=tuple(_parameters_by_record(shared, estimate, 0)) if estimate else (),
        cause_p_value=float(np.exp(_homogeneity_log_p(estimate, shared.record_values.shape))) if estimate else None,
        differing=tuple(differing),
        looked_at=tested_effect_count,
        level_dependence=level_change,
    )


def comparable_candidates(candidates: Sequence[Candidate], levels_differ: bool) -> list[Candidate]:
    """Candidates whose values can be compared between records.

    Left out are effects known by spectrum alone, those with parameters of each record's own (a tone's phase), and at
    several levels those that follow the level.
    """
    return [
        candidate
        for candidate in candidates
        if not (candidate.kind.stochastic or candidate.kind.of_a_record)
        and not (levels_differ and candidate.kind.follows_level)
    ]


def _differing_effects(
    record_set: _ComparedRecords, initial_effects: EffectValues, progress: Callable[[float], None]
) -> tuple[tuple[HomogeneityTest, ...], int]:
    """Differing effects, two at most, and the number of effects tested.

    Beside the second effect the first may be another one: the library is tested again with the second in the rig.
    """
    first_test, tested_count = record_set.likeliest_differing_effect(initial_effects, ())
    progress(0.3)
    if first_test is None:
        return (), tested_count
    second_test, _ = record_set.likeliest_differing_effect(first_test.varying.effects, [first_test.candidate.name])
    progress(0.6)
    if second_test is None:
        return (first_test,), tested_count
    effects_with_second = initial_effects.with_effect(second_test.candidate, second_test.effect_values)
    other_first_test, _ = record_set.likeliest_differing_effect(effects_with_second, [second_test.candidate.name])
    if other_first_test and other_first_test.cost < second_test.cost:
        return (second_test, other_first_test), tested_count
    return (first_test, second_test), tested_count


def _fit_differing_values(
    record_set: _ComparedRecords, initial_effects: EffectValues, differing_tests: Sequence[HomogeneityTest]
) -> tuple[VaryingParameters, PooledEstimate | None]:
    """Joint fit of each record's strengths of the effects that differ; no estimate where none does."""
    effects = initial_effects
    for test in differing_tests:
        effects = effects.with_effect(test.candidate, test.effect_values)
    strength_columns = [column for test in differing_tests for column in effects.strength_columns(test.candidate.name)]
    own_values = VaryingParameters(effects, strength_columns)
    return record_set.joint_fit(own_values) if differing_tests else (own_values, None)


def _initial_effects(records: Sequence[Record], cause: ValidatedHypothesis | None) -> EffectValues:
    """Effects of the cause, if every record can have values of its own; else rigs that hold them."""
    candidates = cause.hypothesis.candidates if cause else ()
    if cause and not any(candidate.kind.stochastic or candidate.kind.of_a_record for candidate in candidates):
        by_record = np.tile(cause.hypothesis.values, (len(records), 1))
        return EffectValues(tuple(record.rig for record in records), candidates, by_record)
    rig_by_record = tuple(record_specific_rig(record, cause.hypothesis) if cause else record.rig for record in records)
    return EffectValues(rig_by_record, (), np.zeros((len(records), 0)))


def _homogeneity_log_p(estimate: PooledEstimate, shape: tuple[int, ...], parameter_index: int | None = None) -> float:
    """Log p-value of one value for all records (tempered Wald test): of all varying parameters, or of one."""
    record_count, parameter_count = shape
    parameter_rows = np.eye(parameter_count) if parameter_index is None else np.eye(parameter_count)[[parameter_index]]
    contrasts = np.kron(np.diff(np.eye(record_count), axis=0), parameter_rows)
    value_steps = contrasts @ estimate.values
    chi_squared = value_steps @ np.linalg.solve(contrasts @ estimate.covariance @ contrasts.T, value_steps)
    return float(chi2.logsf(chi_squared / TEMPERATURE, len(contrasts)))


def _parameters_by_record(
    own_values: VaryingParameters,
    estimate: PooledEstimate,
    comparison_count: int,
    records_by_level: Int[np.ndarray, " records"] | None = None,
) -> list[ParameterByRecord]:
    """Result rows of the parameters; comparison_count is that of effects tested (Bonferroni), 0 for the cause."""
    record_count, parameter_count = own_values.record_values.shape
    labelled = [(effect, parameter) for effect in own_values.effects.candidates for parameter in effect.parameters]
    centring_matrix = np.eye(record_count) - 1 / record_count
    parameter_rows = []
    for index, (candidate, parameter) in enumerate(labelled[column] for column in own_values.columns):
        places = np.arange(record_count) * parameter_count + index
        values, covariance = estimate.values[places], TEMPERATURE * estimate.covariance[np.ix_(places, places)]
        value_errors = np.sqrt(np.maximum(np.diag(centring_matrix @ covariance @ centring_matrix), 0.0))
        p_value = float(np.exp(_homogeneity_log_p(estimate, own_values.record_values.shape, index)))
        by_level: Trend = "none"
        if records_by_level is not None:
            by_level = _trend_of(values[records_by_level], covariance[np.ix_(records_by_level, records_by_level)])
        parameter_rows.append(
            ParameterByRecord(
                parameter=f"{candidate.kind.name}.{parameter.name}",
                place=", ".join(target or "all" for target in candidate.place.values()),
                values=tuple(
                    Value(float(value), float(error), parameter.unit)
                    for value, error in zip(values, value_errors, strict=True)
                ),
                p_value=min(1.0, max(1, comparison_count) * p_value),
                trend=_trend_of(values, covariance) if comparison_count else "none",
                by_level=by_level,
            )
        )
    return parameter_rows


def _trend_of(values: Float[np.ndarray, " records"], covariance: Float[np.ndarray, "records records"]) -> Trend:
    """Trend over the records in their order, by steps of more than `TREND_STANDARD_ERRORS` standard errors."""
    value_steps = np.diff(values)
    step_errors = np.sqrt(np.diag(np.diff(np.diff(covariance, axis=0), axis=1)))
    significant_steps = value_steps[np.abs(value_steps) > TREND_STANDARD_ERRORS * step_errors]
    if significant_steps.size and np.all(significant_steps > 0):
        return "grows"
    return "falls" if significant_steps.size and np.all(significant_steps < 0) else "differs"
