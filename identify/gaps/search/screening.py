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
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Column, Linearization, Residual, residual_of, same_but_laws
from identify.gaps.residual.tuning import matched_modes
from identify.gaps.residual.windowed import needs_every_line
from identify.gaps.search.candidates import Candidate, strength_columns
from identify.linear.model import ResponseCache
from rig.errors import RigError
from rig.model.description import Rig

STRENGTHS = (0.3, 0.6, 1.2, 2.4, 4.8)
"""Trial strengths as multiples of what a typical effect adds, dense enough for every minimum of the linear residual.
Set by hand."""
LINE_STRIDE = 16
"""Step between the lines used: these suffice to locate a minimum. Effort."""
PEAKS, PEAK_BAND_HZ = 1, 2.0
"""Number of followed lines, and bandwidth (Hz) above whose other lines they must stand out. Set by hand."""
FOLLOWED_PLACES, DISTINCT_SHARE = 3, 0.01
"""Number of an effect's places from which minima are sought; share of the range below which two minima are one."""
MAX_EVALUATIONS, RELATIVE_STEP = 40, 1e-4
"""Evaluations per minimum at most; relative step of derivatives, above the accuracy of computed modes."""


@dataclass(frozen=True)
class Screened:
    """Screened candidate: the decrease of the cost that it promises, and the parameter values from which to fit it."""

    candidate: Candidate
    cost_decrease: float
    values: Float[np.ndarray, " parameters"]


def score_screening(
    linearization: Linearization, residual: Residual, candidates: Sequence[Candidate]
) -> list[Screened]:
    """Screening by the gain of the linearised cost, with nuisance parameters and drifts free; the best first.

    This is Rao's score test of each effect at every trial place.
    """
    equations = reduced_equations(linearization, residual)
    peaks_hz, equations_with_lines = [], equations
    if any(candidate.kind.grid_screened for candidate in candidates):
        peaks_hz = peak_frequencies_hz(linearization, residual, PEAKS).tolist()
        equations_with_lines = equations.with_lines()
    screened = []
    for candidate in candidates:
        candidate_equations = equations_with_lines if candidate.kind.grid_screened else equations
        starts = _strength_gains(linearization, candidate_equations, candidate, peaks_hz)
        screened.append(max(starts, key=lambda item: item.cost_decrease))
    return sorted(screened, key=lambda item: -item.cost_decrease)


def peak_frequencies_hz(linearization: Linearization, residual: Residual, count: int) -> Float[np.ndarray, " lines"]:
    """Frequencies of the lines that stand out most in the linear and the contact residuals."""
    rows = np.concatenate(
        [residual.linear, *(contact.residual[None, : residual.linear.shape[1]] for contact in residual.contacts)]
    )
    rate_hz = linearization.record.rate_hz
    return rate_hz * sharpest_frequencies(rows, count, PEAK_BAND_HZ / rate_hz, linearization.record.repeats)


def _strength_gains(
    linearization: Linearization, equations: ReducedEquations, candidate: Candidate, peaks_hz: Sequence[float]
) -> list[Screened]:
    """Gains of the strengths at every start, within their bounds; none where the record shows no change."""
    strengths, residual = candidate.parameters.strengths, equations.residual
    screened = [Screened(candidate, 0.0, candidate.default)]
    starts: list[Float[np.ndarray, " parameters"]] = []
    columns: list[Column] = []
    for start in candidate.starts(peaks_hz):
        with suppress(RigError):  # no such rig
            columns += strength_columns(linearization, residual, candidate, start)
            starts.append(start)
    normal = equations.with_columns(columns)
    nuisance_count = len(equations.gradient)
    free_nuisance = np.flatnonzero(np.abs(residual.nuisance) < LIMIT - 1e-6)
    response = np.linalg.solve(
        normal.matrix[np.ix_(free_nuisance, free_nuisance)], normal.matrix[free_nuisance, nuisance_count:]
    )
    steps = candidate.steps[strengths]
    low, high = (bound[strengths] for bound in candidate.parameters.bounds)
    for k, start in enumerate(starts):
        term = slice(nuisance_count + k * len(strengths), nuisance_count + (k + 1) * len(strengths))
        term_response = response[:, term.start - nuisance_count : term.stop - nuisance_count]
        curvature = normal.matrix[term, term] - normal.matrix[term][:, free_nuisance] @ term_response
        slope = normal.gradient[term] - term_response.T @ normal.gradient[free_nuisance]
        if np.any(np.diag(curvature) <= 1e-9 * np.maximum(np.diag(normal.matrix)[term], 1.0)):
            continue  # without influence, such as a force on a clamp
        step = (
            np.clip(start[strengths] + np.linalg.solve(curvature, slope) * steps, low, high) - start[strengths]
        ) / steps
        values = start.copy()
        values[strengths] = start[strengths] + step * steps
        screened.append(Screened(candidate, float(2 * slope @ step - step @ curvature @ step), values))
    return screened


def grid_screening(linearization: Linearization, candidates: Sequence[Candidate]) -> list[Screened]:
    """Screening by the linear residual over a grid of strengths and places, for effects too large for a slope.

    It holds for effects that change the linear model and need a selection of lines only: not with friction to the
    ground.
    """
    if needs_every_line(linearization.rig):
        return []
    thinned_record = _thinned(linearization.record)
    discrepancy, responses = linearization.scales.discrepancy[:, 1::LINE_STRIDE], ResponseCache(thinned_record.omega)

    def cost(rig: Rig) -> float:
        model = linear_model(thinned_record, rig, discrepancy, responses)
        return LINE_STRIDE * float(np.sum(np.abs(model.residual) ** 2))

    nominal_cost = cost(linearization.rig)
    screened = []
    for candidate in candidates:
        changed_rig = candidate.applied(linearization.rig, candidate.default)
        has_linear_change = not same_but_laws(linearization.rig, changed_rig)
        has_same_loads = changed_rig.loads == linearization.rig.loads
        if not (has_linear_change and has_same_loads) or candidate.kind.stochastic or needs_every_line(changed_rig):
            continue
        costs = []
        for values in _grid(candidate):
            try:
                costs.append((cost(candidate.applied(linearization.rig, values)), values))
            except RigError:
                continue
        if costs:
            least_cost, values = min(costs, key=lambda pair: pair[0])
            screened.append(Screened(candidate, nominal_cost - least_cost, values))
    return sorted(screened, key=lambda item: -item.cost_decrease)


def law_candidates(rig: Rig, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that change contact laws alone."""
    return [c for c in candidates if same_but_laws(rig, c.applied(rig, c.default))]


def law_screening(
    linearization: Linearization, law_free_residual: Residual, candidates: Sequence[Candidate]
) -> list[Screened]:
    """Screening of `law_candidates` by the contact residuals over a grid of strengths; the best first.

    `law_free_residual` is one whose slow motion follows no law yet. A smaller clearance has no slope where the nominal
    contact is open. The gain is that for unknown variances, sum over contacts of n ln(mean square), as the error of the
    slow motion differs between contacts.
    """
    contact_unknowns, nominal_scatter = (
        tuple(c.unknowns for c in law_free_residual.contacts),
        _scatter(law_free_residual),
    )
    screened = []
    for candidate in candidates:
        values = candidate.starts()[0]
        best = Screened(candidate, 0.0, values)
        for strength in candidate.strengths(STRENGTHS):
            trial_values = np.append(strength, values[1:])
            with suppress(RigError):  # no such law
                rig = candidate.applied(linearization.rig, trial_values)
                nuisance = law_free_residual.nuisance
                residual = residual_of(linearization, rig, nuisance, contact_unknowns, base=law_free_residual)
                trial = Screened(candidate, nominal_scatter - _scatter(residual), trial_values)
                best = max(best, trial, key=lambda item: item.cost_decrease)
        screened.append(best)
    return sorted(screened, key=lambda item: -item.cost_decrease)


def _scatter(residual: Residual) -> float:
    return float(sum(contact.residual.size * np.log(contact.cost) for contact in residual.contacts))


def _grid(candidate: Candidate) -> Iterator[Float[np.ndarray, " parameters"]]:
    """Parameter values on the grid of strengths within the bounds, at every place."""
    for place in candidate.starts():
        for strength in candidate.strengths(STRENGTHS):
            values = place.copy()
            values[0] = strength
            yield values


def _thinned(record: Record) -> Record:
    lines = slice(1, None, LINE_STRIDE)
    return replace(
        record,
        omega=record.omega[lines],
        windows_responses=False,
        **{
            name: getattr(record, name)[..., lines]
            for name in ("forces", "delivered", "displaced", "faded", "noise", "power")
        },
    )


def mode_screening(record: Record, rig: Rig, candidates: Sequence[Candidate]) -> list[Screened]:
    """Screening by the modes of a free decay, each effect at its best values; the best first, empty without modes."""
    if not record.modes:
        return []
    nominal_cost = float(np.sum(mode_mismatch(record, rig) ** 2))
    screened = []
    for candidate in candidates:
        if candidate.kind.stochastic or candidate.kind.grid_screened:
            continue
        screened += [
            Screened(candidate, nominal_cost - cost, values) for cost, values in _cost_minima(record, rig, candidate)
        ]
    return sorted(screened, key=lambda item: -item.cost_decrease)


def mode_mismatch(record: Record, rig: Rig) -> Float[np.ndarray, " mismatch"]:
    """Deviation z of the measured modes from a rig's, whitened by their errors and the tolerances."""
    modes, tolerances = matched_modes(record.modes, rig), record.tolerances
    mode_tolerances = [tolerances.of_mode(mode.body, mode.mode_number) for mode in modes]
    is_same_body = np.equal.outer([mode.body for mode in modes], [mode.body for mode in modes])
    frequency = np.diag(
        [m.measured.frequency_error**2 + t.frequency**2 for m, t in zip(modes, mode_tolerances, strict=True)]
    )
    damping = np.diag([m.measured.damping_error**2 + t.damping**2 for m, t in zip(modes, mode_tolerances, strict=True)])
    covariance = block_diag(
        frequency + is_same_body * tolerances.frequency**2, damping + is_same_body * tolerances.damping**2
    )
    logarithms = np.array([mode.logarithms for mode in modes]).reshape(-1, 2)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), logarithms.T.ravel()))


def _cost_minima(
    record: Record, rig: Rig, candidate: Candidate
) -> list[tuple[float, Float[np.ndarray, " parameters"]]]:
    """Minima of the modes' cost, with their values, from the best strength at each of the best places.

    Few modes may fit one mass at one place as well as another elsewhere; the mode shapes at the sensors decide later.
    """

    def mismatch(values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " mismatch"]:
        return mode_mismatch(record, candidate.applied(rig, values))

    low, high = candidate.parameters.bounds
    starts = []
    for place in candidate.starts():
        fits = []
        for strength in candidate.strengths(STRENGTHS):
            values = np.append(strength, place[1:])
            with suppress(RigError):
                fits.append((float(np.sum(mismatch(values) ** 2)), values))
        starts += [min(fits, key=_cost)] if fits else []
    minima: list[tuple[float, Float[np.ndarray, " parameters"]]] = []
    options = {"diff_step": RELATIVE_STEP, "x_scale": high - low, "max_nfev": MAX_EVALUATIONS}
    for start in sorted(starts, key=_cost)[:FOLLOWED_PLACES]:
        minimum = start
        with suppress(RigError, ValueError):
            values = np.clip(start[1], low, high)
            solution = least_squares(mismatch, values, bounds=(low, high), method="dogbox", **options)
            minimum = 2 * float(solution.cost), solution.x
        distances = [np.abs(minimum[1] - values) for _, values in minima]
        if all(np.any(distance > DISTINCT_SHARE * (high - low)) for distance in distances):
            minima.append(minimum)
    return minima


def _cost(fit: tuple[float, Float[np.ndarray, " parameters"]]) -> float:
    return fit[0]
