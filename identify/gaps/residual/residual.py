"""The residual of the diagnosis, a rig's model against a record, its nuisance parameters, and its derivative.

cost = |linear residual|^2 + sum over contacts |contact residual|^2 + oversampling |nuisance|^2 + log determinant
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace

from identify.gaps.residual.law import ContactResidual, contact_residual, force_and_drifted_eta, initial_unknowns
from identify.gaps.residual.linear import LinearModel, linear_model, sensor_response_of
from identify.gaps.residual.lines import outstanding_line_frequencies, without_lines
from identify.gaps.residual.nuisance import (
    NuisanceColumns,
    nuisance_columns_of,
    relative_displacements,
    residual_in_time,
    with_nonlinear_nuisance,
    with_nuisance,
)
from identify.gaps.residual.observation import (
    ContactObservation,
    ContactSignals,
    FinerMotions,
    contact_observations,
    contact_signals_of,
)
from identify.gaps.residual.record import Record
from identify.gaps.residual.scales import Scales, estimated_scales, prior_scales
from identify.gaps.residual.tuning import TunedModes, tuned_modes
from identify.gaps.residual.windowed import has_ground_forces
from identify.linear.joined import contact_groups, group_laws
from identify.linear.model import ResponseCache
from identify.linear.nuisance import Nuisance
from identify.signals.recent_values import RecentValues
from rig.model.description import Rig

ResidualColumn = tuple[Float[np.ndarray, "rows times"], list[Float[np.ndarray, " _"]]]
"""Decrease of the linear residual and of each contact's residual."""


class SearchCache:
    """Cache of a search on one record: responses, and the last contacts' motions and two sets of columns."""

    def __init__(self, record: Record) -> None:
        self.responses = ResponseCache(record.omega, 2 * len(record.rig.bodies))
        self._columns = RecentValues[NuisanceColumns](2)
        self.finer_motions = FinerMotions(len(record.rig.contacts))

    def columns(self, model: LinearModel) -> NuisanceColumns:
        return self._columns.get(model, lambda: nuisance_columns_of(model.record, model))


@dataclass(frozen=True)
class Linearization:
    """Record and rig about which it is linearised, shared by all residuals of the record.

    applied_nuisance are the nuisance parameters that the linearised model contains already; None: all zero.
    tuning has those of single modes that it contains, for a free decay.
    """

    record: Record
    rig: Rig
    scales: Scales
    model: LinearModel
    observations: tuple[ContactObservation, ...]
    applied_nuisance: Float[np.ndarray, " nuisances"] | None
    tuning: TunedModes
    cache: SearchCache

    def relinearized(
        self,
        rig: Rig,
        residual: "Residual | None" = None,
        scales: Scales | None = None,
        observations: tuple[ContactObservation, ...] | None = None,
    ) -> "Linearization":
        """Linearisation of the same record about another rig with the same cache; arguments of `linearized`."""
        return linearized(self.record, rig, residual, scales, observations, self.cache)

    @cached_property
    def expansion_pulls(self) -> Float[np.ndarray, " nuisances"]:
        """Nuisance parameters of the point of linearisation, which the model contains."""
        parameters = self.columns.parameters
        applied = np.zeros(len(parameters)) if self.applied_nuisance is None else self.applied_nuisance
        return applied + np.array([self.tuning.pulls.get(p, 0.0) for p in parameters]) if self.tuning.pulls else applied

    @cached_property
    def column_gram(self) -> Float[np.ndarray, "nuisances nuisances"]:
        """Gram matrix of the columns of the linear residual by the nuisance parameters."""
        return self.columns.products_with(self.columns.flat_residual)

    @cached_property
    def outstanding_frequencies_per_sample(self) -> tuple[float, ...]:
        """Frequencies, per sample, of outstanding lines in the linearised rig's residual; none for a free decay, whose
        modes ring as sharply."""
        if not self.record.has_force:
            return ()
        sensor_residual = residual_in_time(self.record, self.model.residual[: len(self.record.sensors)])
        return outstanding_line_frequencies(sensor_residual, self.record.repeats_per_sample)

    @property
    def columns(self) -> NuisanceColumns:
        """Columns of the nuisance parameters, recomputed if the cache has dropped them."""
        return self.cache.columns(self.model)


@dataclass(frozen=True)
class Residual:
    """Residual of a rig against a record, over time and in standard deviations.

    linear_residual includes the nuisance parameters; linear_before_nuisance has those of the linearisation alone.
    linear_without_lines is the part that is fitted and that scales the unmodelled: without tones in the rig,
    outstanding lines are removed, as they are no model error and no other parameter should follow them.
    """

    rig: Rig
    model: LinearModel
    signals: tuple[ContactSignals, ...]
    linear_before_nuisance: Float[np.ndarray, "rows times"]
    linear_residual: Float[np.ndarray, "rows times"]
    linear_without_lines: Float[np.ndarray, "rows times"]
    contacts: tuple[ContactResidual, ...]
    nuisance_pulls: Float[np.ndarray, " nuisances"]
    parameters: tuple[Nuisance, ...]
    oversampling: float

    @property
    def residual_count(self) -> int:
        """Number of residuals, which is the expected cost of noise alone."""
        return int(self.linear_residual.size + sum(contact_fit.residual.size for contact_fit in self.contacts))

    @property
    def pulls(self) -> Float[np.ndarray, " pulls"]:
        """Pulls of nuisance parameters and contact laws: (estimate - prior mean) / prior standard deviation."""
        return np.concatenate([self.nuisance_pulls, *(contact_fit.pulls for contact_fit in self.contacts)])

    @property
    def corrected_rig(self) -> Rig:
        """Rig with the fitted nuisance parameters and contact tolerances applied."""
        rig = with_nuisance(self.rig, self.parameters, self.nuisance_pulls, self.model.record.tolerances)
        contacts = list(rig.contacts)
        for group, contact_fit in zip(contact_groups(rig), self.contacts, strict=True):
            for contact_index, law in zip(group.contact_indices, contact_fit.fitted_laws, strict=True):
                contacts[contact_index] = replace(contacts[contact_index], law=law)
        return replace(rig, contacts=tuple(contacts))

    @property
    def contact_mean_squares(self) -> tuple[float, ...]:
        """Mean square of each contact's weighted residual while the rig moves."""
        mean_squares = []
        for contact_fit in self.contacts:
            is_moving = contact_fit.observation.force_weights > 0
            moving_residual = contact_fit.residual[: is_moving.size][is_moving]
            mean_squares.append(float(np.mean(moving_residual**2)) if moving_residual.size else 0.0)
        return tuple(mean_squares)

    @property
    def cost(self) -> float:
        lines_per_sample = self.model.error_deviation.shape[1] / self.linear_residual.shape[1]
        pulls_cost = self.oversampling * self.nuisance_pulls @ self.nuisance_pulls
        contact_cost = sum(contact_fit.cost for contact_fit in self.contacts)
        linear_cost = float(np.sum(self.linear_without_lines**2) + pulls_cost)
        return linear_cost + contact_cost + self.model.prior_input_log_determinant / lines_per_sample


def linearized(
    record: Record,
    rig: Rig,
    residual: Residual | None = None,
    scales: Scales | None = None,
    observations: tuple[ContactObservation, ...] | None = None,
    cache: SearchCache | None = None,
) -> Linearization:
    """Linearisation of a record about a rig, with the nuisance parameters of a residual applied if one is given.

    `scales` and `observations` of another linearisation of the record keep their costs comparable.
    """
    scales, cache = scales or prior_scales(record), cache or SearchCache(record)
    if residual:
        parameters, pulls = residual.parameters, residual.nuisance_pulls
        expansion_rig, applied_pulls = with_nonlinear_nuisance(rig, parameters, pulls, record.tolerances)
        tuning = tuned_modes(record, expansion_rig, parameters, pulls)
    else:
        expansion_rig, applied_pulls, tuning = rig, None, tuned_modes(record, rig)
    model = linear_model(record, expansion_rig, scales.unmodelled_shares, cache.responses, tuning.factors)
    if not observations:
        observations = contact_observations(record, model, group_laws(expansion_rig), scales.contact_variances)
    return Linearization(record, rig, scales, model, observations, applied_pulls, tuning, cache)


def with_estimated_scales(linearization: Linearization, residual: Residual) -> Linearization:
    """Linearisation with the scales estimated from one of its residuals."""
    return linearization.relinearized(linearization.rig, residual, scales_from_residual(linearization, residual))


def scales_from_residual(linearization: Linearization, residual: Residual) -> Scales:
    """Scales of the unmodelled, estimated from a residual."""
    record, scales = linearization.record, linearization.scales
    return estimated_scales(record, scales, residual.linear_without_lines, residual.contact_mean_squares)


def model_of_rig(linearization: Linearization, rig: Rig) -> LinearModel:
    """Linear model of a rig with the nuisance parameters that the linearisation applies."""
    record, applied_pulls = linearization.record, linearization.applied_nuisance
    if applied_pulls is not None and applied_pulls.any():
        rig, _ = with_nonlinear_nuisance(rig, linearization.columns.parameters, applied_pulls, record.tolerances)
    scales, cache = linearization.scales, linearization.cache
    return linear_model(record, rig, scales.unmodelled_shares, cache.responses, linearization.tuning.factors)


def residual_of(
    linearization: Linearization,
    rig: Rig,
    nuisance_pulls: Float[np.ndarray, " nuisances"] | None = None,
    unknowns: tuple[Float[np.ndarray, " _"], ...] | None = None,
    reusable: Residual | None = None,
) -> Residual:
    """Residual of a rig at given nuisance parameters and contact unknowns, without any fit.

    Defaults: those of the linearisation, and `initial_unknowns`. Unchanged parts of `reusable`, one of it, are reused.
    """
    record, columns, laws = linearization.record, linearization.columns, group_laws(rig)
    nuisance_pulls = linearization.expansion_pulls if nuisance_pulls is None else nuisance_pulls
    if reusable is not None and same_except_laws(reusable.rig, rig):
        model, contact_signals, linear_at_expansion = reusable.model, reusable.signals, reusable.linear_before_nuisance
    else:
        model = linearization.model if same_except_laws(linearization.rig, rig) else model_of_rig(linearization, rig)
        contact_signals = contact_signals_of(record, model, linearization.cache.finer_motions)
        linear_at_expansion = residual_in_time(record, model.residual)
    observations = linearization.observations
    contacts = list(zip(contact_signals, observations, laws, strict=True))
    unknown_counts = [observation.unknown_count(law) for _, observation, law in contacts]
    if unknowns is None or [u.size for u in unknowns] != unknown_counts:
        unknowns = tuple(initial_unknowns(*contact, record.residual_rate_hz) for contact in contacts)
    pull_change = nuisance_pulls - linearization.expansion_pulls
    if reusable is not None and model is reusable.model and nuisance_pulls is reusable.nuisance_pulls:
        linear_residual, linear_without_lines = reusable.linear_residual, reusable.linear_without_lines
        previous = reusable.contacts
    else:
        linear_residual, previous = linear_at_expansion, ()
        if pull_change.any():
            linear_residual = linear_at_expansion - columns.residual_decrease(pull_change)
        line_frequencies = () if rig.tones else linearization.outstanding_frequencies_per_sample
        linear_without_lines = without_lines(linear_residual, line_frequencies)
    same_motion = bool(previous) and all(c.unknowns is unknown for c, unknown in zip(previous, unknowns, strict=True))
    added_eta_m: list[float] | Float[np.ndarray, "contacts samples"] = [0.0] * len(laws)
    if laws and pull_change.any() and not same_motion:
        eta_decrease_m = np.tensordot(pull_change[columns.eta_parameter_indices], columns.eta_m, 1)
        added_eta_m = record.eta_at_sample_rate(-eta_decrease_m, upper_band=False)
    drifts_m = [observation.drift_m(u) for observation, u in zip(observations, unknowns, strict=True)]
    coupling_n_per_m = model.slow_stiffness_n_per_m - np.diag(np.diag(model.slow_stiffness_n_per_m))

    def residual_of_contact(j: int) -> ContactResidual:
        law, coupled_contacts = laws[j], {j, *np.flatnonzero(coupling_n_per_m[j])}
        if previous and previous[j].law == law and all(previous[i].unknowns is unknowns[i] for i in coupled_contacts):
            return previous[j]
        if same_motion:
            return contact_residual(contact_signals[j], observations[j], law, unknowns[j], previous[j].motion)
        added_force_n = -pull_change @ columns.contact_force_n[:, j]
        added_force_n -= sum(coupling_n_per_m[j, i] * drifts_m[i] for i in coupled_contacts)
        motion = force_and_drifted_eta(contact_signals[j], observations[j], unknowns[j], added_force_n, added_eta_m[j])
        return contact_residual(contact_signals[j], observations[j], law, unknowns[j], motion)

    return Residual(
        rig=rig,
        model=model,
        signals=contact_signals,
        linear_before_nuisance=linear_at_expansion,
        linear_residual=linear_residual,
        linear_without_lines=linear_without_lines,
        contacts=tuple(residual_of_contact(j) for j in range(len(laws))),
        nuisance_pulls=nuisance_pulls,
        parameters=columns.parameters,
        oversampling=record.oversampling,
    )


def residual_decrease(linearization: Linearization, changed_rig: Rig, residual: Residual) -> ResidualColumn:
    """Decrease of the linear and the contact residuals from a residual's rig to a slightly changed one.

    A changed law is evaluated. A changed linear model changes contact forces and relative displacements, through the
    slope of the present law. Contact forces are projected out with the weights of the present rig (Kaufman, BIT 15,
    1975), as they are for nuisance parameters, so that a parameter equal to one of those has the same column.
    """
    record, model = linearization.record, residual.model
    if same_except_laws(residual.rig, changed_rig):
        unknowns = tuple(contact_fit.unknowns for contact_fit in residual.contacts)
        changed = residual_of(linearization, changed_rig, residual.nuisance_pulls, unknowns, reusable=residual)
        contact_decreases = [a.residual - b.residual for a, b in zip(residual.contacts, changed.contacts, strict=True)]
        return residual.linear_residual - changed.linear_residual, contact_decreases
    if same_except_sensors(residual.rig, changed_rig):
        return _decrease_by_sensor_responses(linearization, changed_rig, residual)
    changed_model = model_of_rig(linearization, changed_rig)
    sensor_count = len(record.sensors)
    spectral_decrease = model.residual - changed_model.residual
    separated_decrease_n = model.contact_force_n - changed_model.contact_force_n
    input_decrease = np.concatenate([separated_decrease_n, spectral_decrease[sensor_count:]])
    sensor_decrease = spectral_decrease[:sensor_count] + np.einsum("isl,il->sl", model.signal_per_input, input_decrease)
    linear_decrease, contact_force_spectra = model.projection.applied_to(sensor_decrease * model.error_deviation)
    static_decrease_n = model.static_contact_n - changed_model.static_contact_n
    contact_force_decrease_n = record.in_time(contact_force_spectra) + static_decrease_n[:, None]
    stiffness_increase_n_per_m = changed_model.slow_stiffness_n_per_m - model.slow_stiffness_n_per_m
    for increase_n_per_m, contact_fit in zip(stiffness_increase_n_per_m.T, residual.contacts, strict=True):
        contact_force_decrease_n += np.outer(increase_n_per_m, contact_fit.drift_m)
    contact_decreases = contact_columns(record, residual, contact_force_decrease_n, model.eta_m - changed_model.eta_m)
    return residual_in_time(record, linear_decrease), contact_decreases


def _decrease_by_sensor_responses(linearization: Linearization, changed_rig: Rig, residual: Residual) -> ResidualColumn:
    """Decrease of the residuals by other gains and delays of the sensors under the same motion."""
    record, model = linearization.record, residual.model
    change = sensor_response_of(record, changed_rig) / sensor_response_of(record, residual.rig) - 1
    explained_signals = record.acceleration_signals - model.residual[: len(record.sensors)] * model.error_deviation
    linear_decrease, contact_force_spectra = model.projection.applied_to(change * explained_signals)
    eta_decrease_m = relative_displacements(record, model, change * record.displacement_signals / model.sensor_response)
    contact_decreases = contact_columns(record, residual, record.in_time(contact_force_spectra), eta_decrease_m)
    return residual_in_time(record, linear_decrease), contact_decreases


def contact_columns(
    record: Record,
    residual: Residual,
    contact_force_decrease_n: Float[np.ndarray, "contacts times"],
    eta_decrease_m: Complex[np.ndarray, "contacts lines"],
) -> list[Float[np.ndarray, " _"]]:
    """Decrease of the contact residuals as contact forces and relative displacements decrease, by the laws' slopes."""
    if np.any(eta_decrease_m):
        contacts_and_motions = zip(residual.contacts, record.at_finer_rate(eta_decrease_m), strict=True)
        law_decrease_n = [contact.tangent.force_change_n(decrease) for contact, decrease in contacts_and_motions]
        contact_force_decrease_n = contact_force_decrease_n - np.array(law_decrease_n)
    return [
        np.append(contact.observation.force_weights * decrease, np.zeros(contact.residual.size - decrease.size))
        for contact, decrease in zip(residual.contacts, contact_force_decrease_n, strict=True)
    ]


def same_except_sensors(rig: Rig, compared: Rig) -> bool:
    """True if two rigs differ in their sensors on bodies alone, and no force depends on the measured motion."""
    same_base = rig.base_sensors == compared.base_sensors
    return same_base and replace(rig, sensors=compared.sensors) == compared and not has_ground_forces(rig)


def same_except_laws(rig: Rig, compared: Rig) -> bool:
    """True if two rigs differ in their contact laws alone, if at all."""
    same_laws = (replace(c, law=target.law) for c, target in zip(rig.contacts, compared.contacts, strict=True))
    return rig is compared or replace(rig, contacts=tuple(same_laws)) == compared
