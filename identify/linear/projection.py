"""Solution of the linear model: unknown inputs by generalised least squares, and the residual.

At every line, of the sensors' accelerations y beyond those by known forces,

    y = B x + e,   cov(e) = C,   var(x_i) = 1 of inputs with a prior, any of free ones
    x = T y,   T = N^-1 B^H C^-1,   N = B^H C^-1 B + P,   r = y - B x

with the accelerations B per unit of each input, and P one for inputs with a prior, zero for free ones. The first
`free_count` inputs are the free ones.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

RIDGE_SHARE, MIN_RIDGE = 1e-13, 1e-300
"""Added to the diagonal of N: a share of it, and the least for inputs that no sensor shows. Inputs that the sensors
cannot tell apart then share their effect."""

Covariances = Iterable[tuple[slice, Complex[np.ndarray, "_ sensors sensors"]]]
"""Lines, batch by batch, and the covariance of the sensors' errors on each: all lines at once take too much memory."""


@dataclass(frozen=True, eq=False)
class Projection:
    """T of sensors with independent errors of the standard deviation `deviation`.

    `by_input` is B over it, and `to_inputs` gives the inputs of y over it.
    """

    by_input: Complex[np.ndarray, "inputs sensors lines"]
    to_inputs: Complex[np.ndarray, "inputs sensors lines"]
    deviation: Float[np.ndarray, "sensors lines"]
    free_count: int

    def applied_to(
        self, signal_change: Complex[np.ndarray, "some lines"], sensor_indices: list[int] | slice = slice(None)
    ) -> tuple[Complex[np.ndarray, "rows lines"], Complex[np.ndarray, "free lines"]]:
        """Residual of a change that some sensors deliver, in standard deviations, and the free inputs.

        The inputs with a prior are the residual's last rows.
        """
        signals = (signal_change / self.deviation[sensor_indices]).astype(self.by_input.dtype, copy=False)
        inputs = np.empty_like(signals, shape=(len(self.to_inputs), signals.shape[1]))
        for input_spectrum, to_input in zip(inputs, self.to_inputs[:, sensor_indices], strict=True):
            np.sum(to_input * signals, axis=0, out=input_spectrum)
        residual = input_residual(self.by_input, inputs, signals, sensor_indices)
        return np.concatenate([residual, inputs[self.free_count :]]), inputs[: self.free_count]

    def in_single_precision(self) -> "Projection":
        """Projection in single precision, half as large: enough for derivatives."""
        return replace(self, by_input=self.by_input.astype(np.complex64), to_inputs=self.to_inputs.astype(np.complex64))


def projection(
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    deviation: Float[np.ndarray, "sensors lines"],
    free_count: int,
) -> Projection:
    """Projection of unknown inputs, with `by_input` in standard deviations."""
    to_inputs = _line_solutions(_normal_matrices(by_input, by_input, free_count), by_input.conj())
    return Projection(by_input, to_inputs, deviation, free_count)


def estimated_inputs_and_log_det(
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    standardised_signals: Complex[np.ndarray, "sensors lines"],
    free_count: int,
) -> tuple[Complex[np.ndarray, "inputs lines"], float]:
    """Inputs of one set of accelerations, both in standard deviations; and ln(det N / det N of the free inputs alone).

    The latter is the factor by which inputs with a prior widen the residual's distribution.
    """
    normal_matrices = _normal_matrices(by_input, by_input, free_count)
    signal_products = np.einsum("isl,sl->il", by_input.conj(), standardised_signals)
    inputs = _line_solutions(normal_matrices, signal_products[:, None])[:, 0]
    if free_count == len(by_input):
        return inputs, 0.0
    log_det, free_log_det = (
        np.linalg.slogdet(matrix)[1].sum() for matrix in (normal_matrices, normal_matrices[:, :free_count, :free_count])
    )
    return inputs, float(log_det - free_log_det)


def input_residual(
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    inputs: Complex[np.ndarray, "inputs lines"],
    standardised_signals: Complex[np.ndarray, "some lines"],
    sensor_indices: list[int] | slice = slice(None),
) -> Complex[np.ndarray, "sensors lines"]:
    """Residual r = y - B x of accelerations that some sensors deliver."""
    residual = np.zeros_like(by_input, shape=by_input.shape[1:])
    for signals_per_unit, input_spectrum in zip(by_input, inputs, strict=True):
        residual -= signals_per_unit * input_spectrum
    residual[sensor_indices] += standardised_signals
    return residual


def free_input_estimator_and_condition(
    by_input: Complex[np.ndarray, "inputs sensors lines"], covariances: Covariances
) -> tuple[Complex[np.ndarray, "inputs sensors lines"], float]:
    """T of free inputs where the sensors' errors have a covariance; and the largest condition number of N.

    The condition number is infinite if the sensors cannot tell the inputs apart.
    """
    to_inputs, condition_number = np.empty_like(by_input), 1.0
    for lines, covariance in covariances:
        line_columns = by_input[..., lines]
        weighted_columns = np.linalg.solve(covariance, _lines_first(line_columns)).transpose(2, 1, 0)
        normal_matrices = _normal_matrices(line_columns, weighted_columns, len(line_columns))
        if not np.isfinite(normal_matrices).all():
            return to_inputs, np.inf
        condition_number = float(np.maximum(condition_number, np.max(np.linalg.cond(normal_matrices))))
        to_inputs[..., lines] = _line_solutions(normal_matrices, weighted_columns.conj())
    return to_inputs, condition_number


def residuals_without_free_inputs(
    signal_sets: Sequence[Complex[np.ndarray, "_ sensors lines"]],
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    covariances: Covariances,
) -> Iterator[Complex[np.ndarray, "rows columns"]]:
    """Residuals of some columns in standard deviations, batch of lines by batch.

    With C = L L^H, those of y = L^-1 column and B = L^-1 by_input.
    """
    input_count = len(by_input)
    for lines, covariance in covariances:
        stacked = _lines_first(np.concatenate([by_input[..., lines], *(signal[..., lines] for signal in signal_sets)]))
        standardised = np.linalg.solve(np.linalg.cholesky(covariance), stacked)
        line_inputs, line_columns = standardised[..., :input_count], standardised[..., input_count:]
        input_products = (line_inputs.conj().transpose(0, 2, 1) @ line_columns).transpose(1, 2, 0)
        input_rows = line_inputs.transpose(2, 1, 0)
        solutions = _line_solutions(_normal_matrices(input_rows, input_rows, input_count), input_products)
        residual = line_columns - line_inputs @ solutions.transpose(2, 0, 1)
        yield residual.reshape(-1, residual.shape[-1])


def input_complement(
    by_input: Complex[np.ndarray, "inputs sensors lines"],
) -> Complex[np.ndarray, "lines rows sensors"]:
    """Orthonormal rows that no input reaches, line by line: |rows y|^2 = |r|^2 for free inputs."""
    input_count, sensor_count, line_count = by_input.shape
    if not input_count:
        return np.broadcast_to(np.eye(sensor_count, dtype=complex), (line_count, sensor_count, sensor_count))
    if input_count >= sensor_count:
        return np.zeros((line_count, 0, sensor_count), dtype=complex)
    unitary = np.linalg.qr(by_input.transpose(2, 1, 0), mode="complete")[0]
    return np.ascontiguousarray(unitary[:, :, input_count:].conj().transpose(0, 2, 1))


def _normal_matrices(
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    weighted_columns: Complex[np.ndarray, "inputs sensors lines"],
    free_count: int,
) -> Complex[np.ndarray, "lines inputs inputs"]:
    """N = weighted^H B + P, weighted = C^-1 B, line by line."""
    input_count, _, line_count = by_input.shape
    normal_matrices = np.empty((line_count, input_count, input_count), dtype=complex)
    for i, column in enumerate(weighted_columns.conj()):
        normal_matrices[:, i, i:] = np.einsum("sl,jsl->lj", column, by_input[i:])
        normal_matrices[:, i:, i] = normal_matrices[:, i, i:].conj()
        normal_matrices[:, i, i] += RIDGE_SHARE * normal_matrices[:, i, i].real + MIN_RIDGE + (i >= free_count)
    return normal_matrices


def _line_solutions(
    normal_matrices: Complex[np.ndarray, "lines inputs inputs"], right_side: Complex[np.ndarray, "inputs many lines"]
) -> Complex[np.ndarray, "inputs many lines"]:
    """N^-1 right_side, line by line."""
    return np.ascontiguousarray(np.linalg.solve(normal_matrices, right_side.transpose(2, 0, 1)).transpose(1, 2, 0))


def _lines_first(columns: Complex[np.ndarray, "columns sensors lines"]) -> Complex[np.ndarray, "lines sensors columns"]:
    """Array with the line as the first axis and the input as the last."""
    return np.ascontiguousarray(columns.transpose(2, 1, 0))
