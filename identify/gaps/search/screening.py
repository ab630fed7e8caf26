"""Screening of effects: by the slope of the cost, over a grid of large values, and by the modes of a free decay.

Notes for maintainers
1. A resonance that lies off by more than its width has no slope towards the measured one, so no fit over time or over
   frequencies leads there; the logarithms of the frequencies and damping ratios do. With z those of measured over
   nominal,

       cost = z' C^-1 z,   C = diag(error^2 + tolerance of the mode^2) + (common tolerance)^2 of the modes of a body
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from identify.gaps.residual.fit import ReducedEquations, reduced_equations
from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.lines import sharpest_frequencies
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, ResidualColumn, residual_of, same_but_laws
from identify.gaps.residual.tuning import matched_modes
from identify.gaps.residual.windowed import needs_every_line
from identify.gaps.search.candidates import Candidate, strength_columns
from identify.linear.model import ResponseCache
from rig.errors import RigError
from rig.model.description import Rig

STRENGTH_MULTIPLES = (0.3, 0.6, 1.2, 2.4, 4.8)
"""Trial strengths as multiples of what a typical effect adds, dense enough for every minimum of the linear residual.
Set by hand."""
LINE_STRIDE = 16
"""Step between the lines used: these suffice to locate a minimum. Effort."""
PEAK_COUNT, PEAK_BAND_HZ = 1, 2.0
"""Number of followed lines, and bandwidth (Hz) above whose other lines they must stand out. Set by hand."""
FOLLOWED_PLACES, DISTINCT_SHARE = 3, 0.01
"""Number of an effect's places from which minima are sought; share of the range below which two minima are one."""
MAX_EVALUATIONS, RELATIVE_STEP = 40, 1e-4
"""Evaluations per minimum at most; relative step of derivatives, above the accuracy of computed modes."""


@dataclass(frozen=True)
class ScreenedCandidate:
    """Screened candidate: the decrease of the cost that it promises, and the parameter values from which to fit it."""

    candidate: Candidate
    cost_decrease: float
    start_values: Float[np.ndarray, " parameters"]


def score_screening(
    linearization: Linearization, residual: Residual, candidates: Sequence[Candidate]
) -> list[ScreenedCandidate]:
    """Screening by the gain of the linearised cost, with nuisance parameters and drifts free; the best first.

    This is Rao's score test of each effect at every trial place.
    """
    equations = reduced_equations(linearization, residual)
    peaks_hz, equations_with_lines = [], equations
    if any(candidate.kind.grid_screened for candidate in candidates):
        peaks_hz = peak_frequencies_hz(linearization, residual, PEAK_COUNT).tolist()
        equations_with_lines = equations.with_lines()
    screened_candidates = []
    for candidate in candidates:
        candidate_equations = equations_with_lines if candidate.kind.grid_screened else equations
        screened_starts = _strength_gains(linearization, candidate_equations, candidate, peaks_hz)
        screened_candidates.append(max(screened_starts, key=lambda item: item.cost_decrease))
    return sorted(screened_candidates, key=lambda item: -item.cost_decrease)


def peak_frequencies_hz(
    linearization: Linearization, residual: Residual, peak_count: int
) -> Float[np.ndarray, " lines"]:
    """Frequencies of the lines that stand out most in the linear and the contact residuals."""
    residual_rows = np.concatenate(
        [
            residual.linear_residual,
            *(contact.residual[None, : residual.linear_residual.shape[1]] for contact in residual.contacts),
        ]
    )
    rate_hz = linearization.record.rate_hz
    return rate_hz * sharpest_frequencies(
        residual_rows, peak_count, PEAK_BAND_HZ / rate_hz, linearization.record.repeats_per_sample
    )


def _strength_gains(
    linearization: Linearization, equations: ReducedEquations, candidate: Candidate, peaks_hz: Sequence[float]
) -> list[ScreenedCandidate]:
    """Gains of the strengths at every start, within their bounds; none where the record shows no change."""
    strength_indices, residual = candidate.parameters.strengths, equations.residual
    screened_starts = [ScreenedCandidate(candidate, 0.0, candidate.typical_values)]
    possible_starts: list[Float[np.ndarray, " parameters"]] = []
    strength_decreases: list[ResidualColumn] = []
    for start_values in candidate.start_values(peaks_hz):
        with suppress(RigError):  # no such rig
            strength_decreases += strength_columns(linearization, residual, candidate, start_values)
            possible_starts.append(start_values)
    normal_equations = equations.with_columns(strength_decreases)
    nuisance_count = len(equations.gradient)
    free_nuisance = np.flatnonzero(np.abs(residual.nuisance_pulls) < PULL_LIMIT - 1e-6)
    nuisance_response = np.linalg.solve(
        normal_equations.matrix[np.ix_(free_nuisance, free_nuisance)],
        normal_equations.matrix[free_nuisance, nuisance_count:],
    )
    strength_steps = candidate.step_sizes[strength_indices]
    lower_bounds, upper_bounds = (bound[strength_indices] for bound in candidate.parameters.bounds)
    for start_index, start_values in enumerate(possible_starts):
        parameter_slice = slice(
            nuisance_count + start_index * len(strength_indices),
            nuisance_count + (start_index + 1) * len(strength_indices),
        )
        start_response = nuisance_response[
            :, parameter_slice.start - nuisance_count : parameter_slice.stop - nuisance_count
        ]
        reduced_curvature = (
            normal_equations.matrix[parameter_slice, parameter_slice]
            - normal_equations.matrix[parameter_slice][:, free_nuisance] @ start_response
        )
        reduced_slope = (
            normal_equations.gradient[parameter_slice] - start_response.T @ normal_equations.gradient[free_nuisance]
        )
        if np.any(
            np.diag(reduced_curvature) <= 1e-9 * np.maximum(np.diag(normal_equations.matrix)[parameter_slice], 1.0)
        ):
            continue  # without influence, such as a force on a clamp
        scaled_step = (
            np.clip(
                start_values[strength_indices] + np.linalg.solve(reduced_curvature, reduced_slope) * strength_steps,
                lower_bounds,
                upper_bounds,
            )
            - start_values[strength_indices]
        ) / strength_steps
        best_values = start_values.copy()
        best_values[strength_indices] = start_values[strength_indices] + scaled_step * strength_steps
        screened_starts.append(
            ScreenedCandidate(
                candidate,
                float(2 * reduced_slope @ scaled_step - scaled_step @ reduced_curvature @ scaled_step),
                best_values,
            )
        )
    return screened_starts


def grid_screening(linearization: Linearization, candidates: Sequence[Candidate]) -> list[ScreenedCandidate]:
    """Screening by the linear residual over a grid of strengths and places, for effects too large for a slope.

    It holds for effects that change the linear model and need a selection of lines only: not with friction to the
    ground.
    """
    if needs_every_line(linearization.rig):
        return []
    thin_record = thinned_record(linearization.record)
    unmodelled_shares = linearization.scales.unmodelled_shares[:, 1::LINE_STRIDE]
    response_cache = ResponseCache(thin_record.omega)

    def linear_cost(rig: Rig) -> float:
        model = linear_model(thin_record, rig, unmodelled_shares, response_cache)
        return LINE_STRIDE * float(np.sum(np.abs(model.residual) ** 2))

    nominal_cost = linear_cost(linearization.rig)
    screened_candidates = []
    for candidate in candidates:
        changed_rig = candidate.applied(linearization.rig, candidate.typical_values)
        has_linear_change = not same_but_laws(linearization.rig, changed_rig)
        has_same_loads = changed_rig.loads == linearization.rig.loads
        if not (has_linear_change and has_same_loads) or candidate.kind.stochastic or needs_every_line(changed_rig):
            continue
        costs_and_values = []
        for grid_values in grid_values_of(candidate):
            try:
                costs_and_values.append((linear_cost(candidate.applied(linearization.rig, grid_values)), grid_values))
            except RigError:
                continue
        if costs_and_values:
            least_cost, grid_values = min(costs_and_values, key=lambda cost_and_values: cost_and_values[0])
            screened_candidates.append(ScreenedCandidate(candidate, nominal_cost - least_cost, grid_values))
    return sorted(screened_candidates, key=lambda item: -item.cost_decrease)


def law_candidates(rig: Rig, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that change contact laws alone."""
    return [
        candidate for candidate in candidates if same_but_laws(rig, candidate.applied(rig, candidate.typical_values))
    ]


def law_screening(
    linearization: Linearization, law_free_residual: Residual, candidates: Sequence[Candidate]
) -> list[ScreenedCandidate]:
    """Screening of `law_candidates` by the contact residuals over a grid of strengths; the best first.

    `law_free_residual` is one whose slow motion follows no law yet. A smaller clearance has no slope where the nominal
    contact is open. The gain is that for unknown variances, sum over contacts of n ln(mean square), as the error of the
    slow motion differs between contacts.
    """
    contact_unknowns = tuple(contact.unknowns for contact in law_free_residual.contacts)
    nominal_scatter = _log_scatter(law_free_residual)
    screened_candidates = []
    for candidate in candidates:
        start_values = candidate.start_values()[0]
        best_trial = ScreenedCandidate(candidate, 0.0, start_values)
        for strength in candidate.trial_strengths(STRENGTH_MULTIPLES):
            trial_values = np.append(strength, start_values[1:])
            with suppress(RigError):  # no such law
                trial_rig = candidate.applied(linearization.rig, trial_values)
                nuisance_pulls = law_free_residual.nuisance_pulls
                trial_residual = residual_of(
                    linearization, trial_rig, nuisance_pulls, contact_unknowns, reusable=law_free_residual
                )
                screened_trial = ScreenedCandidate(
                    candidate, nominal_scatter - _log_scatter(trial_residual), trial_values
                )
                best_trial = max(best_trial, screened_trial, key=lambda item: item.cost_decrease)
        screened_candidates.append(best_trial)
    return sorted(screened_candidates, key=lambda item: -item.cost_decrease)


def _log_scatter(residual: Residual) -> float:
    return float(sum(contact.residual.size * np.log(contact.cost) for contact in residual.contacts))


def grid_values_of(candidate: Candidate) -> Iterator[Float[np.ndarray, " parameters"]]:
    """Parameter values on the grid of strengths within the bounds, at every place."""
    for place_values in candidate.start_values():
        for strength in candidate.trial_strengths(STRENGTH_MULTIPLES):
            grid_values = place_values.copy()
            grid_values[0] = strength
            yield grid_values


def thinned_record(record: Record) -> Record:
    """Record on every `LINE_STRIDE`-th line."""
    line_slice = slice(1, None, LINE_STRIDE)
    return replace(
        record,
        omega=record.omega[line_slice],
        responses_windowed=False,
        base=record.base and record.base.thinned(line_slice),
        **{
            field_name: getattr(record, field_name)[..., line_slice]
            for field_name in (
                "force_spectra",
                "acceleration_signals",
                "displacement_signals",
                "velocity_correction",
                "noise_variance",
                "smoothed_power",
            )
        },
    )


def mode_screening(record: Record, rig: Rig, candidates: Sequence[Candidate]) -> list[ScreenedCandidate]:
    """Screening by the modes of a free decay, each effect at its best values; the best first, empty without modes."""
    if not record.measured_modes:
        return []
    nominal_cost = float(np.sum(mode_mismatch(record, rig) ** 2))
    screened_candidates = []
    for candidate in candidates:
        if candidate.kind.stochastic or candidate.kind.grid_screened:
            continue
        screened_candidates += [
            ScreenedCandidate(candidate, nominal_cost - least_cost, best_values)
            for least_cost, best_values in _cost_minima(record, rig, candidate)
        ]
    return sorted(screened_candidates, key=lambda item: -item.cost_decrease)


def mode_mismatch(record: Record, rig: Rig) -> Float[np.ndarray, " mismatch"]:
    """Deviation z of the measured modes from a rig's, whitened by their errors and the tolerances."""
    modes_of_rig, tolerances = matched_modes(record.measured_modes, rig), record.tolerances
    mode_tolerances = [tolerances.of_mode(mode.body_name, mode.mode_number) for mode in modes_of_rig]
    is_same_body = np.equal.outer([mode.body_name for mode in modes_of_rig], [mode.body_name for mode in modes_of_rig])
    frequency_variances = np.diag(
        [
            matched_mode.measured_mode.frequency_error**2 + mode_tolerance.frequency**2
            for matched_mode, mode_tolerance in zip(modes_of_rig, mode_tolerances, strict=True)
        ]
    )
    damping_variances = np.diag(
        [
            matched_mode.measured_mode.damping_error**2 + mode_tolerance.damping**2
            for matched_mode, mode_tolerance in zip(modes_of_rig, mode_tolerances, strict=True)
        ]
    )
    covariance = block_diag(
        frequency_variances + is_same_body * tolerances.frequency**2,
        damping_variances + is_same_body * tolerances.damping**2,
    )
    log_ratios = np.array([mode.log_ratios for mode in modes_of_rig]).reshape(-1, 2)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), log_ratios.T.ravel()))


def _cost_minima(
    record: Record, rig: Rig, candidate: Candidate
) -> list[tuple[float, Float[np.ndarray, " parameters"]]]:
    """Minima of the modes' cost, with their values, from the best strength at each of the best places.

    Few modes may fit one mass at one place as well as another elsewhere; the mode shapes at the sensors decide later.
    """

    def mismatch_at(effect_values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " mismatch"]:
        return mode_mismatch(record, candidate.applied(rig, effect_values))

    lower_bounds, upper_bounds = candidate.parameters.bounds
    best_of_places = []
    for place_values in candidate.start_values():
        costs_and_values = []
        for strength in candidate.trial_strengths(STRENGTH_MULTIPLES):
            start_values = np.append(strength, place_values[1:])
            with suppress(RigError):
                costs_and_values.append((float(np.sum(mismatch_at(start_values) ** 2)), start_values))
        best_of_places += [min(costs_and_values, key=_cost_of_minimum)] if costs_and_values else []
    distinct_minima: list[tuple[float, Float[np.ndarray, " parameters"]]] = []
    solver_options = {"diff_step": RELATIVE_STEP, "x_scale": upper_bounds - lower_bounds, "max_nfev": MAX_EVALUATIONS}
    for place_best in sorted(best_of_places, key=_cost_of_minimum)[:FOLLOWED_PLACES]:
        cost_and_values = place_best
        with suppress(RigError, ValueError):
            start_values = np.clip(place_best[1], lower_bounds, upper_bounds)
            solution = least_squares(
                mismatch_at, start_values, bounds=(lower_bounds, upper_bounds), method="dogbox", **solver_options
            )
            cost_and_values = 2 * float(solution.cost), solution.x
        distances = [np.abs(cost_and_values[1] - minimum_values) for _, minimum_values in distinct_minima]
        if all(np.any(distance > DISTINCT_SHARE * (upper_bounds - lower_bounds)) for distance in distances):
            distinct_minima.append(cost_and_values)
    return distinct_minima


def _cost_of_minimum(cost_and_values: tuple[float, Float[np.ndarray, " parameters"]]) -> float:
    return cost_and_values[0]
