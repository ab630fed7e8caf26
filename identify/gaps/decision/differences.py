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
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2

from identify.gaps.decision.comparison import TEMPERATURE, ValidatedHypothesis, record_specific_rig
from identify.gaps.decision.modal_changes import have_levels, level_dependence
from identify.gaps.decision_table import USUAL_P_VALUE
from identify.gaps.residual.fit import Values
from identify.gaps.residual.likelihood import NominalVariances
from identify.gaps.residual.record import Record
from identify.gaps.results import ParameterByRecord, RecordDifferences, Trend
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import applied, parameters_of, steps_of
from identify.gaps.search.pooled import Information, LinearizedRecord, PooledEstimate, linearized_record, pooled
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.unmeasured_force import Value

FITTED_EFFECTS, ROUNDS = 3, 2
"""Number of the likeliest differing effects that are fitted to every record; linearisations of each fit. Effort."""
TREND_DEVIATIONS = 2.0
"""Standard errors of a step from one record to the next above which a value grows or falls. Convention."""


@dataclass(frozen=True)
class EffectValues:
    """Effects with each record's own values, and the rigs to which they are applied."""

    rigs: tuple[Rig, ...]
    candidates: tuple[Candidate, ...]
    values: Float[np.ndarray, "records parameters"]

    def rig(self, record_index: int) -> Rig:
        return applied(self.rigs[record_index], self.candidates, self.values[record_index])

    @property
    def effect_names(self) -> list[str]:
        return [candidate.name for candidate in self.candidates]

    def columns(self, name: str) -> list[int]:
        """Columns of an effect's parameters."""
        return parameters_of(self.candidates).places_of(name)

    def strength_columns(self, name: str) -> list[int]:
        """Columns of an effect's strengths."""
        return [self.columns(name)[i] for i in self.candidates[self.effect_names.index(name)].parameters.strengths]

    def with_effect(self, candidate: Candidate, values: Float[np.ndarray, "records own"]) -> "EffectValues":
        """Effects with these values of one of them, which is replaced or added."""
        if candidate.name in self.effect_names:
            return self.with_values(slice(None), self.columns(candidate.name), values)
        return replace(
            self, candidates=(*self.candidates, candidate), values=np.concatenate([self.values, values], axis=1)
        )

    def varying_strengths(self, candidate: Candidate) -> "VaryingParameters":
        """Strengths of an effect, free in each record."""
        return VaryingParameters(self, self.strength_columns(candidate.name))

    def with_values(
        self, record_index: int | slice, columns: Sequence[int], values: Float[np.ndarray, "*records own"]
    ) -> "EffectValues":
        """Effects with these values in some columns of one record, or of all."""
        all_values = self.values.copy()
        all_values[record_index, columns] = values
        return replace(self, values=all_values)


@dataclass(frozen=True)
class VaryingParameters:
    """Parameters of effects, by their columns, with each record's own values."""

    effects: EffectValues
    columns: list[int]

    @property
    def record_values(self) -> Float[np.ndarray, "records varied"]:
        return self.effects.values[:, self.columns]

    @property
    def steps(self) -> Values:
        return steps_of(self.effects.candidates)[self.columns]

    @property
    def bounds(self) -> tuple[Values, Values]:
        low, high = parameters_of(self.effects.candidates).bounds
        return low[self.columns], high[self.columns]

    def information(self, record_index: int, linearised_record: LinearizedRecord) -> Information:
        def build(values: Values) -> Rig:
            return self.effects.with_values(record_index, self.columns, values).rig(record_index)

        return linearised_record.with_parameters(build, self.record_values[record_index], self.steps, self.bounds[1])

    def pooled(self, information: Sequence[Information]) -> PooledEstimate:
        return pooled(information, self.steps, self.bounds, self.record_values[0], per_record=True)

    def at_estimate(self, estimate: PooledEstimate) -> "VaryingParameters":
        """Parameters at the pooled estimate, within the bounds."""
        values = np.clip(estimate.values.reshape(self.record_values.shape), *self.bounds)
        return VaryingParameters(self.effects.with_values(slice(None), self.columns, values), self.columns)


@dataclass(frozen=True)
class HomogeneityTest:
    """Fit of an effect with each record's own strength, and the log p-value of one strength for all records."""

    candidate: Candidate
    varying: VaryingParameters
    cost: float
    log_p: float

    @property
    def values(self) -> Float[np.ndarray, "records own"]:
        return self.varying.effects.values[:, self.varying.effects.columns(self.candidate.name)]


@dataclass(frozen=True)
class _RecordSet:
    """Records with their nominal variances, and the candidates whose values are compared between them."""

    records: Sequence[Record]
    variances_by_record: Sequence[NominalVariances]
    candidates: Sequence[Candidate]

    def linearized_record(self, effects: EffectValues, record_index: int) -> LinearizedRecord:
        record, variances = self.records[record_index], self.variances_by_record[record_index]
        return linearized_record(record, variances, effects.rig(record_index))

    def screened(self, effects: EffectValues, excluded: Sequence[str]) -> list[HomogeneityTest]:
        """Linearised tests of every effect not excluded, each at its best place; the likeliest first."""
        trials = [
            (candidate, effects.varying_strengths(candidate))
            for candidate in effects.candidates
            if candidate.name not in excluded
        ]
        for candidate in self.candidates:
            for start in candidate.starts() if candidate.name not in effects.effect_names else ():
                with_candidate = effects.with_effect(candidate, np.tile(start, (len(self.records), 1)))
                trials.append((candidate, with_candidate.varying_strengths(candidate)))
        information: list[list[Information]] = [[] for _ in trials]
        for record_index in range(len(self.records)):
            linearised_record = self.linearized_record(effects, record_index)
            for record_information, (_, varying) in zip(information, trials, strict=True):
                with suppress(RigError):
                    record_information.append(varying.information(record_index, linearised_record))
        best: dict[str, HomogeneityTest] = {}
        for record_information, (candidate, varying) in zip(information, trials, strict=True):
            if len(record_information) == len(self.records):
                estimate = varying.pooled(record_information)
                if candidate.name not in best or estimate.cost < best[candidate.name].cost:
                    best[candidate.name] = _homogeneity_test(candidate, varying.at_estimate(estimate), estimate)
        return sorted(best.values(), key=lambda test: test.cost)

    def fitted(self, initial: VaryingParameters) -> tuple[VaryingParameters, PooledEstimate]:
        """Fit of each record's own values, linearised about the estimate."""

        def refit(varying: VaryingParameters) -> tuple[VaryingParameters, PooledEstimate]:
            estimate = self.pooled(varying)
            return varying.at_estimate(estimate), estimate

        return refit_until_settled(refit(initial), lambda fit: refit(fit[0]), rounds=ROUNDS - 1)

    def pooled(self, varying: VaryingParameters) -> PooledEstimate:
        """Pooled estimate from all records, each linearised about its own values."""
        records = range(len(self.records))
        return varying.pooled([varying.information(k, self.linearized_record(varying.effects, k)) for k in records])

    def most_different(self, effects: EffectValues, excluded: Sequence[str]) -> tuple[HomogeneityTest | None, int]:
        """Likeliest effect of those that differ between the records beyond chance, and the number of effects tested."""
        tests = self.screened(effects, excluded)
        log_threshold = float(np.log(USUAL_P_VALUE / max(1, len(tests))))
        different = []
        for test in [item for item in tests if item.log_p < log_threshold][:FITTED_EFFECTS]:
            with suppress(RigError):
                varying, estimate = self.fitted(test.varying)
                different.append(_homogeneity_test(test.candidate, varying, estimate))
        significant_tests = (item for item in different if item.log_p < log_threshold)
        return min(significant_tests, key=lambda item: item.cost, default=None), len(tests)


def _homogeneity_test(candidate: Candidate, varying: VaryingParameters, estimate: PooledEstimate) -> HomogeneityTest:
    log_p = _homogeneity_log_p(estimate, varying.record_values.shape)
    return HomogeneityTest(candidate, varying, estimate.cost, log_p)


def differences(
    records: Sequence[Record],
    variances_by_record: Sequence[NominalVariances],
    cause: ValidatedHypothesis | None,
    candidates: Sequence[Candidate],
    titles: Sequence[str],
    levels_n: Sequence[float],
    progress: Callable[[float], None] = lambda _: None,
) -> RecordDifferences:
    """Differences between the records of a rig with a cause, or of the nominal rig.

    candidates are the effects at all places; titles and levels_n (root mean squares of the force, N) belong to the
    records. Effects known by their spectrum alone, or with parameters of every record's own (the phase of a tone), are
    not compared.
    """
    comparable = [c for c in candidates if not (c.kind.stochastic or c.kind.of_a_record)]
    record_set = _RecordSet(records, variances_by_record, comparable)
    initial = _initial_effects(records, cause)
    tests, tested_effect_count = _differing_effects(record_set, initial, progress)
    records_by_level = np.argsort(levels_n) if have_levels(levels_n) else None
    varying, differing = _fit_differing_values(record_set, initial, tests, tested_effect_count, records_by_level)
    different = [test.candidate.name for test in tests]
    shared = _pool_shared_values(record_set, varying.effects, initial.effect_names, different)
    progress(1.0)
    rigs = [varying.effects.rig(record) for record in range(len(records))]
    highest_hz = max(record.highest_hz for record in records)
    return RecordDifferences(
        records=tuple(titles),
        cause=tuple(_parameter_rows(shared[0], shared[1], 0)) if shared else (),
        cause_p_value=float(np.exp(_homogeneity_log_p(shared[1], shared[0].record_values.shape))) if shared else None,
        differing=tuple(differing),
        looked_at=tested_effect_count,
        level_dependence=level_dependence(rigs, levels_n, differing, highest_hz),
    )


def _differing_effects(
    record_set: _RecordSet, initial: EffectValues, progress: Callable[[float], None]
) -> tuple[tuple[HomogeneityTest, ...], int]:
    """Differing effects, two at most, and the number of effects tested.

    Beside the second effect the first may be another one: the library is tested again with the second in the rig.
    """
    first, tested_effect_count = record_set.most_different(initial, ())
    progress(0.3)
    if first is None:
        return (), tested_effect_count
    second, _ = record_set.most_different(first.varying.effects, [first.candidate.name])
    progress(0.6)
    if second is None:
        return (first,), tested_effect_count
    second_only = initial.with_effect(second.candidate, second.values)
    first_refitted, _ = record_set.most_different(second_only, [second.candidate.name])
    return (second, first_refitted) if first_refitted and first_refitted.cost < second.cost else (
        first,
        second,
    ), tested_effect_count


def _fit_differing_values(
    record_set: _RecordSet,
    initial: EffectValues,
    tests: Sequence[HomogeneityTest],
    tested_effect_count: int,
    records_by_level: Int[np.ndarray, " records"] | None,
) -> tuple[VaryingParameters, list[ParameterByRecord]]:
    """Joint fit of each record's strengths of the effects that differ, and their rows."""
    effects = initial
    for test in tests:
        effects = effects.with_effect(test.candidate, test.values)
    columns = [column for test in tests for column in effects.strength_columns(test.candidate.name)]
    varying = VaryingParameters(effects, columns)
    if not tests:
        return varying, []
    varying, estimate = record_set.fitted(varying)
    return varying, _parameter_rows(varying, estimate, tested_effect_count, records_by_level)


def _pool_shared_values(
    record_set: _RecordSet, effects: EffectValues, cause_effects: Sequence[str], differing: Sequence[str]
) -> tuple[VaryingParameters, PooledEstimate] | None:
    """Pooled estimate of each record's values of the cause's effects that do not differ; None if there are none."""
    names = [name for name in cause_effects if name not in differing]
    varying = VaryingParameters(effects, [column for name in names for column in effects.columns(name)])
    return (varying, record_set.pooled(varying)) if varying.columns else None


def _initial_effects(records: Sequence[Record], cause: ValidatedHypothesis | None) -> EffectValues:
    """Effects of the cause, if every record can have values of its own; else rigs that hold them."""
    candidates = cause.hypothesis.candidates if cause else ()
    if cause and not any(candidate.kind.stochastic or candidate.kind.of_a_record for candidate in candidates):
        values = np.tile(cause.hypothesis.values, (len(records), 1))
        return EffectValues(tuple(r.rig for r in records), candidates, values)
    rigs = tuple(record_specific_rig(r, cause.hypothesis) if cause else r.rig for r in records)
    return EffectValues(rigs, (), np.zeros((len(records), 0)))


def _homogeneity_log_p(estimate: PooledEstimate, shape: tuple[int, ...], parameter_index: int | None = None) -> float:
    """Log p-value of one value for all records (tempered Wald test): of all varying parameters, or of one."""
    record_count, parameter_count = shape
    selection = np.eye(parameter_count) if parameter_index is None else np.eye(parameter_count)[[parameter_index]]
    contrast = np.kron(np.diff(np.eye(record_count), axis=0), selection)
    difference = contrast @ estimate.values
    chi_squared = difference @ np.linalg.solve(contrast @ estimate.covariance @ contrast.T, difference)
    return float(chi2.logsf(chi_squared / TEMPERATURE, len(contrast)))


def _parameter_rows(
    varying: VaryingParameters,
    estimate: PooledEstimate,
    comparison_count: int,
    records_by_level: Int[np.ndarray, " records"] | None = None,
) -> list[ParameterByRecord]:
    """Result rows of the parameters; comparisons is the number of effects tested (Bonferroni), 0 for the cause."""
    record_count, parameter_count = varying.record_values.shape
    labelled = [(effect, parameter) for effect in varying.effects.candidates for parameter in effect.parameters]
    rows = []
    for i, column in enumerate(varying.columns):
        candidate, parameter = labelled[column]
        indices = np.arange(record_count) * parameter_count + i
        covariance = TEMPERATURE * estimate.covariance[np.ix_(indices, indices)]
        values = estimate.values[indices]
        centring = np.eye(record_count) - 1 / record_count
        errors = np.sqrt(np.maximum(np.diag(centring @ covariance @ centring), 0.0))
        p_value = float(np.exp(_homogeneity_log_p(estimate, varying.record_values.shape, i)))
        rows.append(
            ParameterByRecord(
                parameter=f"{candidate.kind.name}.{parameter.name}",
                place=", ".join(target or "all" for target in candidate.place.values()),
                values=tuple(Value(float(v), float(e), parameter.unit) for v, e in zip(values, errors, strict=True)),
                p_value=min(1.0, max(1, comparison_count) * p_value),
                trend=_trend(values, covariance) if comparison_count else "none",
                by_level="none"
                if records_by_level is None
                else _trend(values[records_by_level], covariance[np.ix_(records_by_level, records_by_level)]),
            )
        )
    return rows


def _trend(values: Float[np.ndarray, " records"], covariance: Float[np.ndarray, "records records"]) -> Trend:
    """Trend over the records in their order, by steps of more than `TREND_DEVIATIONS` standard errors."""
    steps = np.diff(values)
    errors = np.sqrt(np.diag(np.diff(np.diff(covariance, axis=0), axis=1)))
    significant_steps = steps[np.abs(steps) > TREND_DEVIATIONS * errors]
    if significant_steps.size and np.all(significant_steps > 0):
        return "grows"
    return "falls" if significant_steps.size and np.all(significant_steps < 0) else "differs"
