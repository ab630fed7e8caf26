"""Effects with values of each record's own: their rigs, and their fit to all records together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.fit import Values
from identify.gaps.residual.likelihood import NominalVariances
from identify.gaps.residual.record import Record
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import parameters_of, step_sizes_of, with_effects
from identify.gaps.search.pooled import LinearizedRecord, PooledEstimate, RecordInformation, linearized_record, pooled
from rig.model.description import Rig

LINEARIZATIONS = 8
"""Linearisations of a joint fit at most. Effort."""
SETTLED_ERRORS = 0.3
"""Largest step of a value, in standard errors, that ends a joint fit."""


@dataclass(frozen=True)
class EffectValues:
    """Effects with each record's own values, and the rigs to which they are applied."""

    rig_by_record: tuple[Rig, ...]
    candidates: tuple[Candidate, ...]
    values_by_record: Float[np.ndarray, "records parameters"]

    def rig(self, record_index: int) -> Rig:
        return with_effects(self.rig_by_record[record_index], self.candidates, self.values_by_record[record_index])

    @property
    def effect_names(self) -> list[str]:
        return [candidate.name for candidate in self.candidates]

    def columns_of(self, name: str) -> list[int]:
        """Column indices of an effect's parameters among the values."""
        return parameters_of(self.candidates).indices_of(name)

    def strength_columns(self, name: str) -> list[int]:
        """Column indices of an effect's strengths among the values."""
        return [self.columns_of(name)[i] for i in self.candidates[self.effect_names.index(name)].parameters.strengths]

    def with_effect(self, candidate: Candidate, values: Float[np.ndarray, "records own"]) -> "EffectValues":
        """Effects with these values of one of them, which is replaced or added."""
        if candidate.name in self.effect_names:
            return self.with_values(slice(None), self.columns_of(candidate.name), values)
        by_record = np.concatenate([self.values_by_record, values], axis=1)
        return replace(self, candidates=(*self.candidates, candidate), values_by_record=by_record)

    def varying_strengths(self, candidate: Candidate) -> "VaryingParameters":
        """Strengths of an effect, free in each record."""
        return VaryingParameters(self, self.strength_columns(candidate.name))

    def with_values(
        self, record_index: int | slice, column_indices: Sequence[int], column_values: Float[np.ndarray, "*records own"]
    ) -> "EffectValues":
        """Effects with these values in some columns of one record, or of all."""
        all_values = self.values_by_record.copy()
        all_values[record_index, column_indices] = column_values
        return replace(self, values_by_record=all_values)


@dataclass(frozen=True)
class VaryingParameters:
    """Parameters of effects, by their columns, with each record's own values."""

    effects: EffectValues
    columns: list[int]

    @property
    def record_values(self) -> Float[np.ndarray, "records varied"]:
        return self.effects.values_by_record[:, self.columns]

    @property
    def step_sizes(self) -> Values:
        return step_sizes_of(self.effects.candidates)[self.columns]

    @property
    def bounds(self) -> tuple[Values, Values]:
        lower_bounds, upper_bounds = parameters_of(self.effects.candidates).bounds
        return lower_bounds[self.columns], upper_bounds[self.columns]

    def information(self, record_index: int, record_fit: LinearizedRecord) -> RecordInformation:
        def build_rig(values: Values) -> Rig:
            return self.effects.with_values(record_index, self.columns, values).rig(record_index)

        return record_fit.information_with(build_rig, self.record_values[record_index], self.step_sizes, self.bounds[1])

    def pooled(self, information: Sequence[RecordInformation]) -> PooledEstimate:
        return pooled(information, self.step_sizes, self.bounds, self.record_values[0], differs_by_record=True)

    def rigs_at(self, flat_values: Values) -> list[Rig]:
        """Rig of every record at these values, record after record."""
        effects = self.with_record_values(flat_values.reshape(self.record_values.shape)).effects
        return [effects.rig(index) for index in range(len(self.record_values))]

    def at_estimate(self, estimate: PooledEstimate) -> "VaryingParameters":
        """Parameters at the pooled estimate, within the bounds."""
        return self.with_record_values(np.clip(estimate.values.reshape(self.record_values.shape), *self.bounds))

    def with_record_values(self, values: Float[np.ndarray, "records varied"]) -> "VaryingParameters":
        return VaryingParameters(self.effects.with_values(slice(None), self.columns, values), self.columns)


@dataclass(frozen=True)
class RecordSet:
    """Records with their nominal variances."""

    records: Sequence[Record]
    variances_by_record: Sequence[NominalVariances]

    def linearized_record(self, effects: EffectValues, index: int) -> LinearizedRecord:
        return linearized_record(self.records[index], self.variances_by_record[index], effects.rig(index))

    def joint_fit(self, initial_values: VaryingParameters) -> tuple[VaryingParameters, PooledEstimate]:
        """Fit of each record's own values by Gauss-Newton steps, which are halved where they raise -2 ln p."""
        fitted, (cost, estimate) = initial_values, self._cost_and_estimate(initial_values)
        trial, expected_cost = fitted.at_estimate(estimate), estimate.cost
        for _ in range(LINEARIZATIONS - 1):
            largest_steps = SETTLED_ERRORS * np.sqrt(np.maximum(np.diag(estimate.covariance), 0.0))
            if np.all(np.abs(trial.record_values - fitted.record_values).ravel() <= largest_steps):
                fitted, cost = trial, expected_cost
                break
            trial_cost, trial_estimate = self._cost_and_estimate(trial)
            if trial_cost < cost:
                fitted, cost, estimate = trial, trial_cost, trial_estimate
                trial, expected_cost = fitted.at_estimate(estimate), estimate.cost
            else:
                trial, expected_cost = fitted.with_record_values((fitted.record_values + trial.record_values) / 2), cost
        return fitted, replace(estimate, values=fitted.record_values.ravel(), cost=cost)

    def pooled_estimate(self, varied: VaryingParameters) -> PooledEstimate:
        """Pooled estimate from all records, each linearised about its own values."""
        return self._cost_and_estimate(varied)[1]

    def _cost_and_estimate(self, varied: VaryingParameters) -> tuple[float, PooledEstimate]:
        """Value of -2 ln p at the values, and the pooled estimate from all records, linearised there."""
        cost, information = 0.0, []
        for index in range(len(self.records)):
            record_fit = self.linearized_record(varied.effects, index)
            cost += record_fit.cost
            information.append(varied.information(index, record_fit))
        return cost, varied.pooled(information)
