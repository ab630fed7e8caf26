"""Statistic S of the diagnosis as a function of all candidates at once, about one fitted rig.

Notes for maintainers
1. The residuals of a fitted rig are taken as linear in theta: nuisance parameters, contact tolerances, parameters of
   effects that are in the rig already, and strengths of candidates at some places,

       linear residual of sensor i in band b:  r - X theta,   L_bi(theta) = mean |r - X theta|^2
       contact residual j, slow motion eliminated:  L_j(theta) = L_j0 + c_j (theta' M_j theta - 2 g_j' theta)

   both in the variances that the nominal rig states (`likelihood.NominalVariances`).
2. The statistic is that of `likelihood`, with p the pulls of the tolerances:

       S(theta) = N_b sum_bi ln((1 + L_bi)/2) + N sum_j ln((1 + L_j)/2) + |p + theta|^2 + inputs

3. It is majorised at theta_k, as ln is concave: every L weighs N/(1 + L(theta_k)). Each step is a bounded least-squares
   problem in one small normal matrix (Lange, Hunter and Yang, J. Comput. Graph. Stat. 9, 2000).
4. Only the knots of the slow motion are eliminated. Contact tolerances are explicit, with their prior: eliminated, they
   would absorb contact laws at almost no cost.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Int
from scipy.signal.windows import hann

from identify.gaps.residual.fit import DERIVATIVE_STEP, bounded_minimum, contact_jacobian
from identify.gaps.residual.likelihood import NominalVariances
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.residual import Column, Linearization, Residual, derivative
from identify.gaps.residual.scales import BAND_HZ, SEGMENT_S, by_band
from identify.gaps.search.candidates import Candidate, strength_columns
from identify.gaps.search.hypothesis import Hypothesis, applied, parameters_of, steps_of
from identify.gaps.search.pooled import without_drift
from rig.errors import RigError
from rig.model.description import Rig

MAJORIZATIONS = 5
"""Steps of the majorisation at most. Effort."""
STATISTIC_TOLERANCE = 0.1
"""Decrease of S below which the majorisation ends: odds change by 1 %."""
RELATIVE_RIDGE = 1e-5
"""Added to the diagonal, relative: rounding of sums of 1e5 products in single precision."""
RIDGE_FLOOR = 1e-15
"""Added to the diagonal, of its largest entry: what the record does not show stays zero."""
ELIMINATION_ROUNDING = 1e-9
"""Added to the diagonal, of a column's square before the slow motion is eliminated: rounding of the difference."""
MIN_REMAINING_SHARE = 1e-9
"""Least share of a column's weighted square that the nuisance parameters must leave of it."""

Theta = Float[np.ndarray, " columns"]


@dataclass(frozen=True)
class CandidateTerm:
    """Candidate at one place: its columns, its parameters at theta = 0, and the range of theta.

    theta is in units of `Candidate.steps` of the strengths.
    """

    candidate: Candidate
    start: Float[np.ndarray, " parameters"]
    strengths: tuple[int, ...]
    columns: Int[np.ndarray, " selected"]
    low: Float[np.ndarray, " selected"]
    high: Float[np.ndarray, " selected"]

    def values(self, theta: Theta) -> Float[np.ndarray, " parameters"]:
        """Parameters of the effect at theta."""
        values = self.start.copy()
        strengths = list(self.strengths)
        values[strengths] += theta[self.columns] * self.candidate.steps[strengths]
        return values


@dataclass(frozen=True)
class Solution:
    """Minimum of S over some columns, all others zero."""

    theta: Theta
    statistic: float


@dataclass(frozen=True)
class LocalModel:
    """Statistic S(theta) about a fitted rig.

    spectra holds X and spectrum r: windowed spectra in the nominal rig's standard deviations, real and imaginary parts,
    scaled so that the squares of a cell's rows add up to L. cell is the index of a row's band and sensor. base_columns
    are the columns that every solution has: tolerances, whose `pulls` are p, then the effects already in the rig.
    """

    spectra: Float[np.ndarray, "columns rows"]
    spectrum: Float[np.ndarray, " rows"]
    cell: Int[np.ndarray, " rows"]
    contact_matrix: Float[np.ndarray, "contacts columns columns"]
    contact_gradient: Float[np.ndarray, "contacts columns"]
    contact_level: Float[np.ndarray, " contacts"]
    input_matrix: Float[np.ndarray, "columns columns"]
    input_gradient: Float[np.ndarray, " columns"]
    pulls: Float[np.ndarray, " tolerances"]
    low: Theta
    high: Theta
    samples_per_cell: float
    samples: float
    base_columns: Int[np.ndarray, " selected"]
    terms: tuple[CandidateTerm, ...]

    def levels(self, theta: Theta) -> tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " contacts"]]:
        """Levels L of all cells, and of all contacts."""
        moved_columns = np.flatnonzero(theta)
        residual = self.spectrum - theta[moved_columns].astype(np.float32) @ self.spectra[moved_columns]
        contact_levels = self.contact_level + np.einsum("k,jkl,l->j", theta, self.contact_matrix, theta)
        contact_levels -= 2 * self.contact_gradient @ theta
        return np.bincount(self.cell, residual.astype(float) ** 2), np.maximum(contact_levels, 0.0)

    def statistic(self, theta: Theta) -> float:
        """Statistic S, up to a constant of the record."""
        cells, contacts = self.levels(theta)
        residual_cost = self.samples_per_cell * np.sum(np.log1p(cells)) + self.samples * np.sum(np.log1p(contacts))
        input_cost = theta @ self.input_matrix @ theta - 2 * self.input_gradient @ theta
        return float(residual_cost + np.sum((self.pulls + theta[: self.pulls.size]) ** 2) + input_cost)

    def normal(
        self, theta: Theta, columns: Int[np.ndarray, " selected"]
    ) -> tuple[Float[np.ndarray, "selected selected"], Float[np.ndarray, " selected"]]:
        """Matrix A and right-hand side b of S majorised at theta, whose minimum x solves A x = b."""
        cell_levels, contact_levels = self.levels(theta)
        weights = self.samples_per_cell / (1 + cell_levels)
        row_weights = np.sqrt(weights[self.cell]).astype(np.float32)
        rows = self.spectra[columns]
        rows *= row_weights
        normal = (rows @ rows.T).astype(float) + self.input_matrix[np.ix_(columns, columns)]
        right_side = (rows @ (self.spectrum * row_weights)).astype(float)
        right_side += self.input_gradient[columns]
        for weight, contact_matrix, contact_gradient in zip(
            self.samples / (1 + contact_levels), self.contact_matrix, self.contact_gradient, strict=True
        ):
            normal += weight * contact_matrix[np.ix_(columns, columns)]
            right_side += weight * contact_gradient[columns]
        is_tolerance = columns < self.pulls.size
        normal[is_tolerance, is_tolerance] += 1.0
        right_side[is_tolerance] -= self.pulls[columns[is_tolerance]]
        return normal, right_side

    def solved(self, terms: Sequence[CandidateTerm], start: Theta | None = None) -> Solution:
        """Minimum of S with some candidates, by majorisation from `start`."""
        columns = np.concatenate([self.base_columns, *(term.columns for term in terms)]).astype(int)
        theta = np.zeros(len(self.spectra))
        if start is not None:
            theta[columns] = start[columns]
        best = Solution(theta, self.statistic(theta))
        for _ in range(MAJORIZATIONS):
            normal, right_side = self.normal(best.theta, columns)
            diagonal = np.diag(normal)
            normal += np.diag(RELATIVE_RIDGE * diagonal + RIDGE_FLOOR * diagonal.max())  # what is not shown stays zero
            theta = np.zeros(len(self.spectra))
            current = best.theta[columns]
            low, high = self.low[columns] - current, self.high[columns] - current
            step = bounded_minimum(normal, right_side - normal @ current, low, high)
            theta[columns] = current + step
            solution = Solution(theta, self.statistic(theta))
            decrease = best.statistic - solution.statistic
            if decrease > 0:
                best = solution
            if decrease < STATISTIC_TOLERANCE:
                break
        return best

    def promised(self, terms: Sequence[CandidateTerm], solution: Solution) -> Float[np.ndarray, " terms"]:
        """Lower bound of the decrease of S by each joining term: that of the majorised S within its range."""
        all_columns = np.arange(len(self.spectra))
        normal, right_side = self.normal(solution.theta, all_columns)
        slope = right_side - normal @ solution.theta
        base = np.concatenate([self.base_columns, *(term.columns for term in terms)]).astype(int)
        response = np.linalg.solve(normal[np.ix_(base, base)] + 1e-12 * np.eye(base.size), normal[base])
        decreases = np.zeros(len(self.terms))
        for k, term in enumerate(self.terms):
            columns = term.columns
            curvature = normal[np.ix_(columns, columns)] - normal[np.ix_(columns, base)] @ response[:, columns]
            is_hidden = np.diag(curvature) <= MIN_REMAINING_SHARE * np.diag(normal)[columns]
            if np.any(np.isin(columns, base)) or np.any(is_hidden):
                continue
            reduced_slope = slope[columns] - response[:, columns].T @ slope[base]
            step = np.clip(np.linalg.solve(curvature, reduced_slope), term.low, term.high)
            decreases[k] = 2 * reduced_slope @ step - step @ curvature @ step
        return decreases


def local_model(
    linearization: Linearization,
    residual: Residual,
    variances: NominalVariances,
    rig: Rig,
    present: Hypothesis,
    candidates: Sequence[Candidate],
) -> LocalModel:
    """Local model about the residual of `rig` with the effects `present`, with the columns of every candidate."""
    columns: list[Column] = list(_present_columns(linearization, residual, rig, present))
    present_count, terms = len(columns), list[CandidateTerm]()
    first = residual.pulls.size
    for candidate in candidates:
        for start in candidate.starts():
            with suppress(RigError):  # no such rig
                new_columns = strength_columns(linearization, residual, candidate, start)
                terms.append(_term(candidate, start, first + len(columns)))
                columns += [
                    (linear.astype(np.float32), [column.astype(np.float32) for column in contacts])
                    for linear, contacts in new_columns
                ]
    return _assembled(linearization, residual, variances, columns, present_count, tuple(terms), _present_range(present))


def _term(candidate: Candidate, start: Float[np.ndarray, " parameters"], first_column: int) -> CandidateTerm:
    """Term of a candidate at `start`, whose columns begin with column `first`."""
    strengths = list(candidate.parameters.strengths)
    low, high = (
        (bound[strengths] - start[strengths]) / candidate.steps[strengths] for bound in candidate.parameters.bounds
    )
    columns = first_column + np.arange(len(strengths))
    return CandidateTerm(candidate, start, tuple(strengths), columns, np.minimum(low, high), np.maximum(low, high))


def _present_columns(
    linearization: Linearization, residual: Residual, rig: Rig, present: Hypothesis
) -> Iterator[Column]:
    """Decrease of the residuals by a step of each parameter of the effects already in the rig."""
    candidates, values = present.candidates, present.values
    build = partial(applied, rig, candidates)
    steps = steps_of(candidates)
    signs = np.where(values + steps > parameters_of(candidates).bounds[1], -DERIVATIVE_STEP, DERIVATIVE_STEP)
    for sign, step in zip(signs, np.diag(steps), strict=True):
        linear, contacts = derivative(linearization, build(values + sign * step), residual)
        yield linear / sign, [column / sign for column in contacts]


def _present_range(present: Hypothesis) -> tuple[Float[np.ndarray, " present"], Float[np.ndarray, " present"]]:
    if not present.candidates:
        return np.zeros(0), np.zeros(0)
    limits = parameters_of(present.candidates).bounds
    bounds = [(limit - present.values) / steps_of(present.candidates) for limit in limits]
    return np.minimum(*bounds), np.maximum(*bounds)


def _assembled(
    linearization: Linearization,
    residual: Residual,
    variances: NominalVariances,
    added_columns: Sequence[Column],
    present_count: int,
    terms: tuple[CandidateTerm, ...],
    present_range: tuple[Float[np.ndarray, " present"], Float[np.ndarray, " present"]],
) -> LocalModel:
    record, nuisance_count = linearization.record, len(linearization.columns.parameters)
    sensor_count, times = len(record.sensors), residual.linear.shape[1]
    pulls = residual.pulls
    size = pulls.size + len(added_columns)
    scale, cell = _cells(linearization, variances, times)
    spectra = np.zeros((size, cell.size), np.float32)
    inputs = np.zeros((size, (len(residual.linear) - sensor_count) * times), np.float32)
    for k, column in enumerate(linearization.columns.residual):
        spectra[k], inputs[k] = _windowed(record.rate_hz, column[:sensor_count], scale), column[sensor_count:].ravel()
    for k, (linear, _) in enumerate(added_columns, pulls.size):
        spectra[k], inputs[k] = _windowed(record.rate_hz, linear[:sensor_count], scale), linear[sensor_count:].ravel()
    matrices, gradients, levels = [], [], []
    first = nuisance_count
    for j, contact in enumerate(residual.contacts):
        rows = np.zeros((contact.residual.size, size))
        rows[:, :nuisance_count] = contact_jacobian(linearization, residual, j)
        sample_count = contact.observation.weights.size
        tolerances = slice(first, first + contact.pulls.size)
        first = tolerances.stop
        rows[:sample_count, tolerances] = contact.columns[:sample_count, contact.observation.tolerance_slice].toarray()
        for k, (_, contacts) in enumerate(added_columns, pulls.size):
            rows[:, k] = contacts[j]
        normal_matrix, gradient = without_drift(residual, j, rows)
        normal_matrix += np.diag(ELIMINATION_ROUNDING * np.sum(rows**2, axis=0))
        sum_of_squares = float(np.sum(contact.residual[:sample_count] ** 2))
        level = _contact_level(variances, residual, j)
        matrices.append(normal_matrix * level / sum_of_squares if sum_of_squares else normal_matrix)
        gradients.append(gradient * level / sum_of_squares if sum_of_squares else gradient)
        levels.append(level)
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    low[: pulls.size], high[: pulls.size] = -LIMIT - pulls, LIMIT - pulls
    low[pulls.size : pulls.size + present_count], high[pulls.size : pulls.size + present_count] = present_range
    for term in terms:
        low[term.columns], high[term.columns] = term.low, term.high
    ratio = record.sample_ratio
    band_count = int(cell.max()) // sensor_count + 1
    samples = times / ratio
    return LocalModel(
        spectra=spectra,
        spectrum=_windowed(record.rate_hz, residual.linear_without_lines[:sensor_count], scale),
        cell=cell,
        contact_matrix=np.array(matrices).reshape(len(matrices), size, size),
        contact_gradient=np.array(gradients).reshape(len(gradients), size),
        contact_level=np.array(levels),
        input_matrix=(inputs @ inputs.T).astype(float) / ratio,
        input_gradient=(inputs @ residual.linear[sensor_count:].ravel().astype(np.float32)).astype(float) / ratio,
        pulls=pulls,
        low=low,
        high=high,
        samples_per_cell=samples / band_count,
        samples=samples,
        base_columns=np.arange(pulls.size + present_count),
        terms=terms,
    )


def _contact_level(variances: NominalVariances, residual: Residual, contact_index: int) -> float:
    """Mean square of a contact's residual relative to the nominal rig's variances."""
    contact, weights = residual.contacts[contact_index], residual.contacts[contact_index].observation.weights
    residual_n = np.divide(contact.residual[: weights.size], weights, out=np.zeros(weights.size), where=weights > 0)
    return float(np.mean((residual_n * variances.observations[contact_index].weights) ** 2))


def _segments(rate_hz: float, sample_count: int) -> tuple[int, int, int, int]:
    """Samples per segment, number of segments, lines per band and number of bands, as in `scales.second_levels`."""
    segment = min(round(SEGMENT_S * rate_hz), sample_count)
    per_band = max(1, round(BAND_HZ * segment / rate_hz))
    return segment, sample_count // segment, per_band, (segment // 2 + 1) // per_band


def _cells(
    linearization: Linearization, variances: NominalVariances, sample_count: int
) -> tuple[Float[np.ndarray, "sensors bands"], Int[np.ndarray, " rows"]]:
    """Factors that make the squares of spectra in standard deviations add up to L; and the cell of each row."""
    record, sensor_count = linearization.record, len(linearization.record.sensors)
    _, count, per_band, band_count = _segments(record.rate_hz, sample_count)
    variance = by_band(record, linearization.model.deviation**2, band_count) / variances.expected_variance
    scale = np.sqrt(variance.T / (count * per_band))
    shape = (sensor_count, count, band_count, per_band, 2)
    sensor_index = np.arange(sensor_count)[:, None, None, None, None]
    cell = np.arange(band_count)[None, None, :, None, None] * sensor_count + sensor_index
    return scale, np.ascontiguousarray(np.broadcast_to(cell, shape)).ravel()


def _windowed(
    rate_hz: float, rows: Float[np.ndarray, "sensors times"], scale: Float[np.ndarray, "sensors bands"]
) -> Float[np.ndarray, " values"]:
    """Spectra of the segments under a Hann window, real and imaginary parts, scaled by band and sensor."""
    segment, count, per_band, band_count = _segments(rate_hz, rows.shape[1])
    window = hann(segment, sym=False)
    pieces = rows[:, : count * segment].reshape(len(rows), count, segment) * (window / np.sqrt(np.sum(window**2)))
    lines = np.fft.rfft(pieces, axis=2)[:, :, : band_count * per_band].reshape(len(rows), count, band_count, per_band)
    lines = lines * scale[:, None, :, None]
    return np.stack([lines.real, lines.imag], axis=-1).astype(np.float32).ravel()
