"""The diagnosis's statistic as a function of every candidate at once, about one fitted rig.

Notes for maintainers
1. The residuals of a fitted rig are taken as linear in theta: nuisance parameters, contact tolerances, parameters of
   effects that are in the rig already, and strengths of candidates at some places,

       linear residual of sensor i in band b:  r - X theta,   L_bi(theta) = mean |r - X theta|^2
       contact residual j, slow motion eliminated:  L_j(theta) = L_j0 + c_j (theta' M_j theta - 2 g_j' theta)

   both in the variances that the nominal rig states (`likelihood.Reference`).
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

from identify.gaps.residual.fit import FINE, Column, bounded, by_nuisance, derivative
from identify.gaps.residual.likelihood import Reference
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.residual.scales import BAND_HZ, SEGMENT_S, by_band
from identify.gaps.search.attached import attached
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis, applied, parameters_of, steps_of
from identify.gaps.search.pooled import without_drift
from rig.errors import RigError
from rig.model.description import Rig

MAJORIZATIONS = 5
"""Steps of the majorisation at most; ..."""
SETTLED = 0.1
"""... it ends where S falls by less: odds change by 1 %."""
ROUNDING = 1e-5
"""Of sums of 1e5 products in single precision, relative to the diagonal."""
UNSEEN = 1e-15
"""Of the largest entry of the diagonal: what nothing shows stays zero."""
ELIMINATED = 1e-9
"""Of a column's square before the slow motion was eliminated: rounding of the difference that is left."""
VISIBLE = 1e-9
"""Least share of a column's weighted square that the nuisance parameters must leave of it."""

Theta = Float[np.ndarray, " columns"]


@dataclass(frozen=True)
class CandidateTerm:
    """A candidate at one place: its columns, the values of its parameters at theta = 0, and the range of theta.

    theta counts `Candidate.steps` of its strengths.
    """

    candidate: Candidate
    start: Float[np.ndarray, " parameters"]
    strengths: tuple[int, ...]
    columns: Int[np.ndarray, " some"]
    low: Float[np.ndarray, " some"]
    high: Float[np.ndarray, " some"]

    def values(self, theta: Theta) -> Float[np.ndarray, " parameters"]:
        """The effect's parameters."""
        values = self.start.copy()
        chosen = list(self.strengths)
        values[chosen] += theta[self.columns] * self.candidate.steps[chosen]
        return values


@dataclass(frozen=True)
class Solution:
    """The least S over some columns, all others zero."""

    theta: Theta
    statistic: float


@dataclass(frozen=True)
class LocalModel:
    """S(theta) about a fitted rig.

    spectra holds X and spectrum r, windowed spectra in the nominal rig's standard deviations, real and imaginary parts,
    scaled so that the squares of a cell's rows add up to L; cell says which band and sensor a row is of. always are
    the columns that every solution has: tolerances, whose `pulls` are p, then the rig's own effects.
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
    always: Int[np.ndarray, " some"]
    terms: tuple[CandidateTerm, ...]

    def levels(self, theta: Theta) -> tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " contacts"]]:
        """L of every cell and of every contact."""
        used = np.flatnonzero(theta)
        residual = self.spectrum - theta[used].astype(np.float32) @ self.spectra[used]
        contacts = self.contact_level + np.einsum("k,jkl,l->j", theta, self.contact_matrix, theta)
        contacts -= 2 * self.contact_gradient @ theta
        return np.bincount(self.cell, residual.astype(float) ** 2), np.maximum(contacts, 0.0)

    def statistic(self, theta: Theta) -> float:
        """S, up to a constant of the record."""
        cells, contacts = self.levels(theta)
        by_bands = self.samples_per_cell * np.sum(np.log1p(cells)) + self.samples * np.sum(np.log1p(contacts))
        inputs = theta @ self.input_matrix @ theta - 2 * self.input_gradient @ theta
        return float(by_bands + np.sum((self.pulls + theta[: self.pulls.size]) ** 2) + inputs)

    def normal(
        self, theta: Theta, columns: Int[np.ndarray, " some"]
    ) -> tuple[Float[np.ndarray, "some some"], Float[np.ndarray, " some"]]:
        """Matrix and right-hand side of the majorised S at theta: least where matrix @ x = right-hand side."""
        cells, contacts = self.levels(theta)
        weights = self.samples_per_cell / (1 + cells)
        by_row = np.sqrt(weights[self.cell]).astype(np.float32)
        rows = self.spectra[columns]
        rows *= by_row
        matrix = (rows @ rows.T).astype(float) + self.input_matrix[np.ix_(columns, columns)]
        vector = (rows @ (self.spectrum * by_row)).astype(float)
        vector += self.input_gradient[columns]
        for weight, by_pair, by_one in zip(
            self.samples / (1 + contacts), self.contact_matrix, self.contact_gradient, strict=True
        ):
            matrix += weight * by_pair[np.ix_(columns, columns)]
            vector += weight * by_one[columns]
        tolerances = columns < self.pulls.size
        matrix[tolerances, tolerances] += 1.0
        vector[tolerances] -= self.pulls[columns[tolerances]]
        return matrix, vector

    def solved(self, terms: Sequence[CandidateTerm], start: Theta | None = None) -> Solution:
        """The least S with some candidates, by majorisation from `start`."""
        columns = np.concatenate([self.always, *(term.columns for term in terms)]).astype(int)
        theta = np.zeros(len(self.spectra))
        if start is not None:
            theta[columns] = start[columns]
        best = Solution(theta, self.statistic(theta))
        for _ in range(MAJORIZATIONS):
            matrix, vector = self.normal(best.theta, columns)
            size = np.diag(matrix)
            matrix += np.diag(ROUNDING * size + UNSEEN * size.max())  # what nothing shows stays zero
            theta = np.zeros(len(self.spectra))
            here = best.theta[columns]
            step = bounded(matrix, vector - matrix @ here, self.low[columns] - here, self.high[columns] - here)
            theta[columns] = here + step
            solution = Solution(theta, self.statistic(theta))
            gain = best.statistic - solution.statistic
            if gain > 0:
                best = solution
            if gain < SETTLED:
                break
        return best

    def promised(self, terms: Sequence[CandidateTerm], at: Solution) -> Float[np.ndarray, " terms"]:
        """Least fall of S if a candidate joins: the gain of the majorised S, within the range of theta."""
        every = np.arange(len(self.spectra))
        matrix, vector = self.normal(at.theta, every)
        slope = vector - matrix @ at.theta
        inside = np.concatenate([self.always, *(term.columns for term in terms)]).astype(int)
        inner = np.linalg.solve(matrix[np.ix_(inside, inside)] + 1e-12 * np.eye(inside.size), matrix[inside])
        gains = np.zeros(len(self.terms))
        for k, term in enumerate(self.terms):
            own = term.columns
            curvature = matrix[np.ix_(own, own)] - matrix[np.ix_(own, inside)] @ inner[:, own]
            if np.any(np.isin(own, inside)) or np.any(np.diag(curvature) <= VISIBLE * np.diag(matrix)[own]):
                continue
            mine = slope[own] - inner[:, own].T @ slope[inside]
            size = np.clip(np.linalg.solve(curvature, mine), term.low, term.high)
            gains[k] = 2 * mine @ size - size @ curvature @ size
        return gains


def local_model(
    linearization: Linearization,
    at: Residual,
    reference: Reference,
    rig: Rig,
    present: Hypothesis,
    known: Sequence[Candidate],
) -> LocalModel:
    """The statistic about a residual of `rig` with the effects `present`, and every candidate's columns."""
    tolerances = linearization.columns.parameters
    parts: list[Column] = list(_present_columns(linearization, at, rig, present))
    own, terms = len(parts), list[CandidateTerm]()
    contact_pulls = [c.pulls.size for c in at.contacts]
    first = len(tolerances) + sum(contact_pulls)
    for candidate in known:
        for start in candidate.starts():
            chosen = list(candidate.parameters.strengths)
            with suppress(RigError):  # no such rig
                columns = [_column(linearization, at, candidate, start, k) for k in chosen]
                low, high = (
                    (ends[chosen] - start[chosen]) / candidate.steps[chosen] for ends in candidate.parameters.bounds
                )
                index = first + len(parts) + np.arange(len(columns))
                terms.append(
                    CandidateTerm(candidate, start, tuple(chosen), index, np.minimum(low, high), np.maximum(low, high))
                )
                parts += columns
    return _assembled(linearization, at, reference, parts, own, tuple(terms), _present_range(present))


def _column(
    linearization: Linearization, at: Residual, candidate: Candidate, start: Float[np.ndarray, " parameters"], k: int
) -> Column:
    """Decrease of the residuals by a step of a candidate's strength."""
    moved = start.copy()
    moved[k] = start[k] + candidate.steps[k]
    rig = candidate.applied(linearization.rig, moved)
    linear, contacts = attached(linearization, rig, at) or derivative(linearization, rig, at)
    return linear.astype(np.float32), [column.astype(np.float32) for column in contacts]


def _present_columns(linearization: Linearization, at: Residual, rig: Rig, present: Hypothesis) -> Iterator[Column]:
    """Decrease of the residuals by a step of each parameter of the effects in the rig."""
    parts, values = present.parts, present.values
    build = partial(applied, rig, parts)
    steps = steps_of(parts)
    signs = np.where(values + steps > parameters_of(parts).bounds[1], -FINE, FINE)
    for sign, move in zip(signs, np.diag(steps), strict=True):
        linear, contacts = derivative(linearization, build(values + sign * move), at)
        yield linear / sign, [column / sign for column in contacts]


def _present_range(present: Hypothesis) -> tuple[Float[np.ndarray, " own"], Float[np.ndarray, " own"]]:
    if not present.parts:
        return np.zeros(0), np.zeros(0)
    ends = [(end - present.values) / steps_of(present.parts) for end in parameters_of(present.parts).bounds]
    return np.minimum(*ends), np.maximum(*ends)


def _assembled(
    linearization: Linearization,
    at: Residual,
    reference: Reference,
    parts: Sequence[Column],
    own: int,
    terms: tuple[CandidateTerm, ...],
    present_range: tuple[Float[np.ndarray, " own"], Float[np.ndarray, " own"]],
) -> LocalModel:
    record, nuisances = linearization.record, len(linearization.columns.parameters)
    sensors, times = len(record.sensors), at.linear.shape[1]
    pulls = at.pulls
    size = pulls.size + len(parts)
    scale, cell = _cells(linearization, reference, times)
    spectra = np.zeros((size, cell.size), np.float32)
    inputs = np.zeros((size, (len(at.linear) - sensors) * times), np.float32)
    for k, column in enumerate(linearization.columns.residual):
        spectra[k], inputs[k] = _windowed(record.rate_hz, column[:sensors], scale), column[sensors:].ravel()
    for k, (linear, _) in enumerate(parts, pulls.size):
        spectra[k], inputs[k] = _windowed(record.rate_hz, linear[:sensors], scale), linear[sensors:].ravel()
    matrices, gradients, levels = [], [], []
    first = nuisances
    for j, contact in enumerate(at.contacts):
        rows = np.zeros((contact.residual.size, size))
        rows[:, :nuisances] = by_nuisance(linearization, at, j)
        moving = contact.seen.weights.size
        tolerances = slice(first, first + contact.pulls.size)
        first = tolerances.stop
        rows[:moving, tolerances] = contact.columns[:moving, contact.seen.tolerances].toarray()
        for k, (_, contacts) in enumerate(parts, pulls.size):
            rows[:, k] = contacts[j]
        matrix, gradient = without_drift(at, j, rows)
        matrix += np.diag(ELIMINATED * np.sum(rows**2, axis=0))
        in_own = float(np.sum(contact.residual[:moving] ** 2))
        level = _contact_level(reference, at, j)
        matrices.append(matrix * level / in_own if in_own else matrix)
        gradients.append(gradient * level / in_own if in_own else gradient)
        levels.append(level)
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    low[: pulls.size], high[: pulls.size] = -LIMIT - pulls, LIMIT - pulls
    low[pulls.size : pulls.size + own], high[pulls.size : pulls.size + own] = present_range
    for term in terms:
        low[term.columns], high[term.columns] = term.low, term.high
    ratio = record.sample_ratio
    bands = int(cell.max()) // sensors + 1
    samples = times / ratio
    return LocalModel(
        spectra=spectra,
        spectrum=_windowed(record.rate_hz, at.quiet[:sensors], scale),
        cell=cell,
        contact_matrix=np.array(matrices).reshape(len(matrices), size, size),
        contact_gradient=np.array(gradients).reshape(len(gradients), size),
        contact_level=np.array(levels),
        input_matrix=(inputs @ inputs.T).astype(float) / ratio,
        input_gradient=(inputs @ at.linear[sensors:].ravel().astype(np.float32)).astype(float) / ratio,
        pulls=pulls,
        low=low,
        high=high,
        samples_per_cell=samples / bands,
        samples=samples,
        always=np.arange(pulls.size + own),
        terms=terms,
    )


def _contact_level(reference: Reference, at: Residual, j: int) -> float:
    """Mean square of a contact's residual in the nominal rig's variances."""
    contact, weights = at.contacts[j], at.contacts[j].seen.weights
    residual_n = np.divide(contact.residual[: weights.size], weights, out=np.zeros(weights.size), where=weights > 0)
    return float(np.mean((residual_n * reference.seen[j].weights) ** 2))


def _segments(rate_hz: float, times: int) -> tuple[int, int, int, int]:
    """Samples of a segment, segments, lines of a band and bands, as `scales.second_levels` has them."""
    segment = min(round(SEGMENT_S * rate_hz), times)
    per_band = max(1, round(BAND_HZ * segment / rate_hz))
    return segment, times // segment, per_band, (segment // 2 + 1) // per_band


def _cells(
    linearization: Linearization, reference: Reference, times: int
) -> tuple[Float[np.ndarray, "sensors bands"], Int[np.ndarray, " rows"]]:
    """Factors by which the squares of spectra in standard deviations add up to L; and the cell of each row."""
    record = linearization.record
    _, count, per_band, bands = _segments(record.rate_hz, times)
    variance = by_band(record, linearization.model.deviation**2, bands) / reference.usual
    scale = np.sqrt(variance.T / (count * per_band))
    sensors = len(record.sensors)
    shape = (sensors, count, bands, per_band, 2)
    cell = np.arange(bands)[None, None, :, None, None] * sensors + np.arange(sensors)[:, None, None, None, None]
    return scale, np.ascontiguousarray(np.broadcast_to(cell, shape)).ravel()


def _windowed(
    rate_hz: float, rows: Float[np.ndarray, "sensors times"], scale: Float[np.ndarray, "sensors bands"]
) -> Float[np.ndarray, " values"]:
    """Spectra of the seconds under a Hann window, real and imaginary parts, scaled by band and sensor."""
    segment, count, per_band, bands = _segments(rate_hz, rows.shape[1])
    window = hann(segment, sym=False)
    pieces = rows[:, : count * segment].reshape(len(rows), count, segment) * (window / np.sqrt(np.sum(window**2)))
    lines = np.fft.rfft(pieces, axis=2)[:, :, : bands * per_band].reshape(len(rows), count, bands, per_band)
    lines = lines * scale[:, None, :, None]
    return np.stack([lines.real, lines.imag], axis=-1).astype(np.float32).ravel()
