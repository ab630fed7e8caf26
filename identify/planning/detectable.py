"""Smallest effects that a diagnosis of the planned record would name, and those that it could not tell apart.

A machine drawn within the tolerances is simulated under a drawn force, and the nominal rig fitted to its record. In the
quadratic form of -2 ln p about this fit (`gaps.search.local_model`), with A its matrix, b the columns that every fit
has and c those of an effect at a place,

    C = A_cc - A_cb A_bb^-1 A_bc

is what a unit of the effect's strength changes -2 ln p by, with all tolerances free. An effect of size x lowers -2 ln
p of a record by (x sqrt(C) + z)^2, z normal. The joint contact fit adds F = d' V^-1 d where the effect changes
clearances, stiffness or damping by d per unit, with V the covariance of their distances from rig.json. With T the
temperature of the posterior and L the logarithm of its odds over the prior ones, the effect is named with 95 % power
where

    x sqrt(C / T + F) = sqrt(2 L) + 1.645 s,    s = 1 by the contact fit, else 1 / sqrt(T)

and where x sqrt(C) = sqrt(G) + 1.645 at least, with G what the search asks for, if the contact fit adds nothing. At
that size a second effect looks alike if it explains the first so well that the odds stay below 19, with r the
correlation of the two in the matrix C / T + F:

    (1 - r^2) x^2 (C_11 / T + F_11) < 2 ln 19
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from identify.contacts.law_form import parameters_of_law
from identify.gaps.decision.bounds import law_distance
from identify.gaps.decision.comparison import TEMPERATURE, log_prior
from identify.gaps.decision.null_simulations import draw_rig, standard_normals
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.shaken_base import check_base, with_inertial_force
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import Candidate, candidates, effect_range_scale
from identify.gaps.search.contact_laws import LawEstimate, law_outcomes, parameters_alone_differ
from identify.gaps.search.hypothesis import MIN_GAIN, Search
from identify.gaps.search.local_model import MIN_REMAINING_SHARE, CandidateTerm, LocalModel, local_model
from identify.gaps.search.nominal import fit_nuisance
from identify.planning.planned_test import PlannedTest, simulated_recording
from rig.model.description import Rig
from rig.model.tolerances import Tolerances
from rig.recording.interfaces import Simulate

NAMED_ODDS, POWER_QUANTILE = 19.0, 1.645
"""Posterior odds of an effect that is named, and the normal quantile of 95 % power. Convention."""
DRAWN_MACHINE_COUNT = 12
"""Machines of the Latin hypercube of which the first is simulated."""


class DetectableEffect(msgspec.Struct, frozen=True, kw_only=True):
    """Smallest sizes of an effect at a body, contact or sensor that are named with 95 % power, in `unit`.

    size is the difference of its strength from none, the median over the places along its body; least and greatest are
    those at the best and at the worst place. They are None where no size within the effect's range is named. alike are
    the effects that the record does not tell from it.
    """

    effect: str
    place: str
    unit: str
    size: float | None
    least: float | None
    greatest: float | None
    alike: tuple[str, ...] = ()


def detectable_effects(
    test: PlannedTest, simulate: Simulate, seed: int, max_simulated_s: float
) -> tuple[DetectableEffect, ...]:
    """Smallest named sizes of every effect of the library, of a record of the planned length.

    Effects known by their spectrum, and tones, are left out. Raises RigError where the rig cannot be simulated or its
    record not diagnosed.
    """
    simulated_s = min(test.duration_s, max_simulated_s)
    check_base(test.rig)
    drawn_rig = draw_rig(test.rig, test.tolerances, standard_normals(test.rig, DRAWN_MACHINE_COUNT)[0])
    with threadpool_limits(1):
        recording = simulated_recording(test.with_duration(simulated_s), drawn_rig, simulate, seed)
        recording = with_inertial_force(recording)
        record = record_of(recording, tolerances=test.tolerances)
        variances = nominal_variances_of(linearized(record, record.rig))
        linearization, residual = fit_nuisance(record, record.rig)
        range_scale = effect_range_scale(record, record.rig)
        estimates = {fit.contact_name: fit for fit in law_outcomes(recording, record.rig, test.tolerances).estimates}
        library = candidates(range_scale, record.channel_names, record.zero_known, record.has_force)
        searched = [c for c in library if not (c.kind.stochastic or c.kind.grid_screened)]
        hypothesis = Search(variances, linearization, residual, tuple(searched)).nominal_fit().hypothesis
        quadratic_model = local_model(linearization, residual, variances, record.rig, hypothesis, searched)
    fit_columns = {c.name: _contact_fit_column(c, record.rig, estimates, test.tolerances) for c in searched}
    return _smallest_effects(quadratic_model, library, fit_columns, test.duration_s / simulated_s)


def _contact_fit_column(
    candidate: Candidate, rig: Rig, estimates: Mapping[str, LawEstimate], tolerances: Tolerances
) -> Float[np.ndarray, " quantities"]:
    """Change L^-1 d of the contact fit's quantities by a step of an effect, L L' = V, of all estimated contacts.

    Zero of an effect that changes more than the numbers of dead zones and springs.
    """
    parameter_values = candidate.typical_values.copy()
    parameter_values[0] = candidate.neutral_strength + candidate.step_sizes[0]
    changed_rig = candidate.applied(rig, parameter_values)
    compared = list(zip(rig.contacts, changed_rig.contacts, strict=True))
    is_seen_by_fit = replace(changed_rig, contacts=rig.contacts) == rig and all(
        contact.name in estimates and parameters_alone_differ(changed.law, contact.law)
        for contact, changed in compared
        if changed != contact
    )
    whitened_changes = [np.zeros(0)]
    for contact, changed_contact in compared:
        estimate = estimates.get(contact.name)
        if estimate is None:
            continue
        quantity_difference = estimate.quantity_weights @ (
            parameters_of_law(changed_contact.law) - parameters_of_law(contact.law)
        )
        distance_covariance = law_distance(estimate, contact, contact, tolerances).covariance
        whitened_changes.append(np.linalg.solve(np.linalg.cholesky(distance_covariance), quantity_difference))
    return np.concatenate(whitened_changes) * is_seen_by_fit


def _smallest_effects(
    model: LocalModel,
    library: Sequence[Candidate],
    fit_columns: Mapping[str, Float[np.ndarray, " quantities"]],
    length_ratio: float,
) -> tuple[DetectableEffect, ...]:
    """Sizes by candidate, from the information of each of its terms, which grows with the record's length, and of the
    contact fit."""
    terms = [term for term in model.candidate_terms if len(term.column_indices) == 1]
    column_indices = np.array([term.column_indices[0] for term in terms], dtype=int)
    record_information, is_hidden = _information_and_hidden_mask(model, column_indices)
    record_information = np.where(is_hidden | is_hidden[:, None], 0.0, record_information) * length_ratio
    fit_matrix = np.stack([fit_columns[term.candidate.name] for term in terms])
    kind_count = Counter(candidate.kind.name for candidate in library)
    log_odds_by_kind = {
        kind: float(np.log(NAMED_ODDS) + log_prior((), kind_count) - log_prior((kind,), kind_count))
        for kind in {term.candidate.kind.name for term in terms}
    }
    steps = np.array(
        [
            _smallest_detectable_step(
                record_information[k, k],
                float(fit_matrix[k] @ fit_matrix[k]),
                log_odds_by_kind[term.candidate.kind.name],
            )
            for k, term in enumerate(terms)
        ]
    )
    looks_alike = look_alike_mask(record_information / TEMPERATURE + fit_matrix @ fit_matrix.T, steps)
    indices_by_candidate: dict[str, list[int]] = {}
    for k, term in enumerate(terms):
        indices_by_candidate.setdefault(term.candidate.name, []).append(k)
    effects = []
    for name, term_indices in indices_by_candidate.items():
        candidate = terms[term_indices[0]].candidate
        effect_sizes = sorted(_effect_size(terms[k], float(steps[k])) for k in term_indices)
        alike = {terms[k].candidate.name for k in np.flatnonzero(looks_alike[term_indices].any(axis=0))} - {name}
        strength_parameter = next(p for p in candidate.parameters if p.neutral is not None)
        effects.append(
            DetectableEffect(
                effect=candidate.kind.name,
                place=", ".join(target or "all" for target in candidate.place.values()),
                unit=strength_parameter.unit,
                size=_finite_or_none(effect_sizes[len(effect_sizes) // 2]),
                least=_finite_or_none(effect_sizes[0]),
                greatest=_finite_or_none(effect_sizes[-1]),
                alike=tuple(sorted(alike)),
            )
        )
    return tuple(effects)


def look_alike_mask(
    information: Float[np.ndarray, "terms terms"], steps: Float[np.ndarray, " terms"]
) -> Bool[np.ndarray, "terms terms"]:
    """Mask [i, j]: term j explains a step s_i of term i so well that the odds stay below `NAMED_ODDS`."""
    own_information = np.diag(information)
    is_named = np.isfinite(steps)
    inverse_roots = np.where(own_information > 0, 1 / np.sqrt(np.where(own_information > 0, own_information, 1.0)), 0.0)
    squared_correlation = (information * np.outer(inverse_roots, inverse_roots)) ** 2
    gains = own_information * np.where(is_named, steps, 0.0) ** 2
    return is_named[:, None] & ((1 - squared_correlation) * gains[:, None] < 2 * np.log(NAMED_ODDS))


def _information_and_hidden_mask(
    model: LocalModel, column_indices: Int[np.ndarray, " terms"]
) -> tuple[Float[np.ndarray, "terms terms"], Bool[np.ndarray, " terms"]]:
    """Matrix C of the terms' columns, and a mask of those that the tolerances hide."""
    normal_matrix, _ = model.normal_equations(np.zeros(len(model.column_spectra)), np.arange(len(model.column_spectra)))
    basis = model.present_columns
    basis_response = np.linalg.solve(
        normal_matrix[np.ix_(basis, basis)] + 1e-12 * np.eye(basis.size), normal_matrix[np.ix_(basis, column_indices)]
    )
    term_products = normal_matrix[np.ix_(column_indices, column_indices)]
    information = term_products - normal_matrix[np.ix_(column_indices, basis)] @ basis_response
    return information, np.diag(information) <= MIN_REMAINING_SHARE * np.diag(term_products)


def _smallest_detectable_step(information: float, contact_info: float, required_log_odds: float) -> float:
    """Strength, in steps, that is named with 95 % power; infinite without information."""
    total_information = information / TEMPERATURE + contact_info
    if not total_information > 0:
        return np.inf
    power_margin = POWER_QUANTILE * (1.0 if contact_info else 1 / np.sqrt(TEMPERATURE))
    steps = (np.sqrt(2 * required_log_odds) + power_margin) / np.sqrt(total_information)
    return float(steps if contact_info else max(steps, (np.sqrt(MIN_GAIN) + POWER_QUANTILE) / np.sqrt(information)))


def _effect_size(term: CandidateTerm, step: float) -> float:
    """Size of a strength; infinite beyond the effect's range."""
    if step > max(-float(term.theta_min[0]), float(term.theta_max[0])):
        return np.inf
    return step * abs(float(term.candidate.step_sizes[term.strength_indices[0]]))


def _finite_or_none(size: float) -> float | None:
    return float(size) if np.isfinite(size) else None
