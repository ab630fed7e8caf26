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
from operator import attrgetter, itemgetter

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from identify.gaps.residual.fit import ReducedEquations, reduced_equations
from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.lines import sharpest_line_frequencies
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, ResidualColumn, residual_of, same_except_laws
from identify.gaps.residual.tuning import matched_modes
from identify.gaps.residual.windowed import has_nonlinear_ground_forces
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


def rao_score_screening(
    linearization: Linearization, residual: Residual, candidates: Sequence[Candidate]
) -> list[ScreenedCandidate]:
    """Screening by the gain of the linearised cost, with nuisance parameters and drifts free; the best first.

    This is Rao's score test of each effect at every trial place.
    """
    equations = reduced_equations(linearization, residual)
    peaks_hz, equations_with_lines = [], equations
    if any(candidate.kind.grid_screened for candidate in candidates):
        peaks_hz = peak_frequencies_hz(linearization, residual, PEAK_COUNT).tolist()
        equations_with_lines = equations.with_outstanding_lines()
    screened = []
    for candidate in candidates:
        candidate_equations = equations_with_lines if candidate.kind.grid_screened else equations
        screened_starts = _screened_strengths(linearization, candidate_equations, candidate, peaks_hz)
        screened.append(max(screened_starts, key=attrgetter("cost_decrease")))
    return _by_cost_decrease(screened)


def _by_cost_decrease(screened: list[ScreenedCandidate]) -> list[ScreenedCandidate]:
    return sorted(screened, key=lambda start: -start.cost_decrease)


def peak_frequencies_hz(
    linearization: Linearization, residual: Residual, peak_count: int
) -> Float[np.ndarray, " lines"]:
    """Frequencies of the lines that stand out most in the linear and the contact residuals."""
    linear_residual, record = residual.linear_residual, linearization.record
    contact_rows = (contact.residual[None, : linear_residual.shape[1]] for contact in residual.contacts)
    residual_rows, rate_hz = np.concatenate([linear_residual, *contact_rows]), record.residual_rate_hz
    return rate_hz * sharpest_line_frequencies(
        residual_rows, peak_count, PEAK_BAND_HZ / rate_hz, record.repeats_per_sample
    )


def _screened_strengths(
    linearization: Linearization, equations: ReducedEquations, candidate: Candidate, peaks_hz: Sequence[float]
) -> list[ScreenedCandidate]:
    """Gains of the strengths at every start, within their bounds; none where the record shows no change."""
    strengths, residual = candidate.parameters.strengths, equations.residual
    screened = [ScreenedCandidate(candidate, 0.0, candidate.typical_values)]
    possible_starts: list[Float[np.ndarray, " parameters"]] = []
    decreases: list[ResidualColumn] = []
    for start_values in candidate.start_values(peaks_hz):
        with suppress(RigError):  # no such rig
            decreases += strength_columns(linearization, residual, candidate, start_values)
            possible_starts.append(start_values)
    normal_equations = equations.with_columns(decreases)
    matrix, gradient, nuisance_count = normal_equations.matrix, normal_equations.gradient, len(equations.gradient)
    free = np.flatnonzero(np.abs(residual.nuisance_pulls) < PULL_LIMIT - 1e-6)
    nuisance_response = np.linalg.solve(matrix[np.ix_(free, free)], matrix[free, nuisance_count:])
    strength_steps = candidate.step_sizes[strengths]
    lower_bounds, upper_bounds = (bound[strengths] for bound in candidate.parameters.bounds)
    for start_index, start_values in enumerate(possible_starts):
        first_column = start_index * len(strengths)
        response = nuisance_response[:, first_column : first_column + len(strengths)]
        column_slice = slice(nuisance_count + first_column, nuisance_count + first_column + len(strengths))
        curvature = matrix[column_slice, column_slice] - matrix[column_slice][:, free] @ response
        slope = gradient[column_slice] - response.T @ gradient[free]
        if np.any(np.diag(curvature) <= 1e-9 * np.maximum(np.diag(matrix)[column_slice], 1.0)):
            continue  # without influence, such as a force on a clamp
        newton_strengths = start_values[strengths] + np.linalg.solve(curvature, slope) * strength_steps
        scaled_step = (np.clip(newton_strengths, lower_bounds, upper_bounds) - start_values[strengths]) / strength_steps
        gain = float(2 * slope @ scaled_step - scaled_step @ curvature @ scaled_step)
        best_values = start_values.copy()
        best_values[strengths] = start_values[strengths] + scaled_step * strength_steps
        screened.append(ScreenedCandidate(candidate, gain, best_values))
    return screened


def grid_screening(linearization: Linearization, candidates: Sequence[Candidate]) -> list[ScreenedCandidate]:
    """Screening by the linear residual over a grid of strengths and places, for effects too large for a slope.

    It holds for effects that change the linear model and need a selection of lines only: not with friction to the
    ground.
    """
    rig = linearization.rig
    if has_nonlinear_ground_forces(rig):
        return []
    record = thinned_record(linearization.record)
    unmodelled_shares = linearization.scales.unmodelled_shares[:, 1::LINE_STRIDE]
    response_cache = ResponseCache(record.omega)

    def linear_cost(rig: Rig) -> float:
        model = linear_model(record, rig, unmodelled_shares, response_cache)
        return LINE_STRIDE * float(np.sum(np.abs(model.residual) ** 2))

    nominal_cost = linear_cost(rig)
    screened = []
    for candidate in candidates:
        changed_rig = candidate.applied(rig, candidate.typical_values)
        is_linear_change = changed_rig.loads == rig.loads and not same_except_laws(rig, changed_rig)
        if not is_linear_change or candidate.kind.stochastic or has_nonlinear_ground_forces(changed_rig):
            continue
        trials = []
        for grid_values in grid_values_of(candidate):
            with suppress(RigError):
                trials.append((linear_cost(candidate.applied(rig, grid_values)), grid_values))
        if trials:
            least_cost, grid_values = min(trials, key=itemgetter(0))
            screened.append(ScreenedCandidate(candidate, nominal_cost - least_cost, grid_values))
    return _by_cost_decrease(screened)


def law_candidates(rig: Rig, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that change contact laws alone."""
    return [
        candidate for candidate in candidates if same_except_laws(rig, candidate.applied(rig, candidate.typical_values))
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
    nuisance_pulls, nominal_scatter = law_free_residual.nuisance_pulls, _log_scatter(law_free_residual)
    screened = []
    for candidate in candidates:
        start_values = candidate.start_values()[0]
        best_trial = ScreenedCandidate(candidate, 0.0, start_values)
        for strength in candidate.trial_strengths(STRENGTH_MULTIPLES):
            values = np.append(strength, start_values[1:])
            with suppress(RigError):  # no such law
                rig = candidate.applied(linearization.rig, values)
                trial_residual = residual_of(
                    linearization, rig, nuisance_pulls, contact_unknowns, reusable=law_free_residual
                )
                screened_trial = ScreenedCandidate(candidate, nominal_scatter - _log_scatter(trial_residual), values)
                best_trial = max(best_trial, screened_trial, key=attrgetter("cost_decrease"))
        screened.append(best_trial)
    return _by_cost_decrease(screened)


def _log_scatter(residual: Residual) -> float:
    return float(sum(contact_fit.residual.size * np.log(contact_fit.cost) for contact_fit in residual.contacts))


def grid_values_of(candidate: Candidate) -> Iterator[Float[np.ndarray, " parameters"]]:
    """Parameter values on the grid of strengths within the bounds, at every place."""
    for place_values in candidate.start_values():
        for strength in candidate.trial_strengths(STRENGTH_MULTIPLES):
            yield np.append(strength, place_values[1:])


def thinned_record(record: Record) -> Record:
    """Record on every `LINE_STRIDE`-th line of its spectra."""
    line_slice = slice(1, None, LINE_STRIDE)
    field_names = ["force_spectra", "acceleration_signals", "displacement_signals", "velocity_correction"]
    field_names += ["noise_variance", "smoothed_power"]
    return replace(
        record,
        omega=record.omega[line_slice],
        responses_windowed=False,
        base=record.base and record.base.thinned(line_slice),
        **{name: getattr(record, name)[..., line_slice] for name in field_names},
    )


def mode_screening(record: Record, rig: Rig, candidates: Sequence[Candidate]) -> list[ScreenedCandidate]:
    """Screening by the modes of a free decay, each effect at its best values; the best first, empty without modes."""
    if not record.measured_modes:
        return []
    nominal_cost = float(np.sum(mode_mismatch(record, rig) ** 2))
    return _by_cost_decrease(
        [
            ScreenedCandidate(candidate, nominal_cost - least_cost, best_values)
            for candidate in candidates
            if not (candidate.kind.stochastic or candidate.kind.grid_screened)
            for least_cost, best_values in _mode_mismatch_minima(record, rig, candidate)
        ]
    )


def mode_mismatch(record: Record, rig: Rig) -> Float[np.ndarray, " mismatch"]:
    """Deviation z of the measured modes from a rig's, whitened by their errors and the tolerances."""
    modes, tolerances = matched_modes(record.measured_modes, rig), record.tolerances
    body_names, measured_modes = [mode.body_name for mode in modes], [mode.measured_mode for mode in modes]
    stated = [tolerances.of_mode(mode.body_name, mode.mode_number) for mode in modes]
    frequency_variances = [m.frequency_error**2 + s.frequency**2 for m, s in zip(measured_modes, stated, strict=True)]
    damping_variances = [m.damping_error**2 + s.damping**2 for m, s in zip(measured_modes, stated, strict=True)]
    is_same_body = np.equal.outer(body_names, body_names)
    covariance = block_diag(
        np.diag(frequency_variances) + is_same_body * tolerances.frequency**2,
        np.diag(damping_variances) + is_same_body * tolerances.damping**2,
    )
    log_ratios = np.array([mode.log_ratios for mode in modes]).reshape(-1, 2)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), log_ratios.T.ravel()))


def _mode_mismatch_minima(
    record: Record, rig: Rig, candidate: Candidate
) -> list[tuple[float, Float[np.ndarray, " parameters"]]]:
    """Minima of the modes' cost, with their values, from the best strength at each of the best places.

    Few modes may fit one mass at one place as well as another elsewhere; the mode shapes at the sensors decide later.
    """

    def mismatch_at(effect_values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " mismatch"]:
        return mode_mismatch(record, candidate.applied(rig, effect_values))

    lower_bounds, upper_bounds = candidate.parameters.bounds
    ranges = upper_bounds - lower_bounds
    best_by_place = []
    for place_values in candidate.start_values():
        strength_trials = []
        for strength in candidate.trial_strengths(STRENGTH_MULTIPLES):
            values = np.append(strength, place_values[1:])
            with suppress(RigError):
                strength_trials.append((float(np.sum(mismatch_at(values) ** 2)), values))
        best_by_place += [min(strength_trials, key=itemgetter(0))] if strength_trials else []
    minima: list[tuple[float, Float[np.ndarray, " parameters"]]] = []
    options = {"method": "dogbox", "diff_step": RELATIVE_STEP, "x_scale": ranges, "max_nfev": MAX_EVALUATIONS}
    for cost, values in sorted(best_by_place, key=itemgetter(0))[:FOLLOWED_PLACES]:
        minimum = cost, values
        with suppress(RigError, ValueError):
            start_values = np.clip(values, lower_bounds, upper_bounds)
            solution = least_squares(mismatch_at, start_values, bounds=(lower_bounds, upper_bounds), **options)
            minimum = 2 * float(solution.cost), solution.x
        if all(np.any(np.abs(minimum[1] - found_values) > DISTINCT_SHARE * ranges) for _, found_values in minima):
            minima.append(minimum)
    return minima
