"""The unknown inputs of a linear model, found by least squares line by line, and what they leave."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float


@dataclass(frozen=True)
class Projection:
    """What the unknown inputs explain best of accelerations, line by line: `to_inputs` gives them from accelerations in
    standard deviations, `by_input` the accelerations that they make; the first are the contact forces."""

    by_input: Complex[np.ndarray, "inputs sensors lines"]
    to_inputs: Complex[np.ndarray, "inputs sensors lines"]
    deviation: Float[np.ndarray, "sensors lines"]
    contacts: int

    def of(
        self, change: Complex[np.ndarray, "some lines"], sensors: list[int] | slice = slice(None)
    ) -> tuple[Complex[np.ndarray, "rows lines"], Complex[np.ndarray, "contacts lines"]]:
        """The residual and the contact forces that something makes which some sensors deliver beside what is known."""
        weighted = (change / self.deviation[sensors]).astype(self.by_input.dtype, copy=False)
        inputs = np.einsum("isl,sl->il", self.to_inputs[:, sensors], weighted)
        left = left_by(self.by_input, inputs, weighted, sensors)
        return np.concatenate([left, inputs[self.contacts :]]), inputs[: self.contacts]

    def single(self) -> "Projection":
        """In single precision, half as large: enough for derivatives."""
        return replace(self, by_input=self.by_input.astype(np.complex64), to_inputs=self.to_inputs.astype(np.complex64))


def least_squares(
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    right: Complex[np.ndarray, "inputs many lines"],
    contacts: int,
) -> tuple[Complex[np.ndarray, "inputs many lines"], float]:
    """The solution of the normal equations of the inputs, line by line; those behind the contacts have a prior of one.

    By elimination: the matrix is Hermitian and positive. The logarithm is that of the determinant by which the inputs
    with a prior widen the residual's distribution: of their pivots.
    """
    inputs = len(by_input)
    normal = np.empty((inputs, *by_input.shape[::2]), dtype=complex)
    for i, column in enumerate(by_input.conj()):
        normal[i, i:] = np.einsum("sl,jsl->jl", column, by_input[i:])
        normal[i, i] += 1e-10 * normal[i, i].real + 1e-300 + (i >= contacts)
    found, log_determinant = right.copy(), 0.0
    for i in range(inputs):
        for j in range(i + 1, inputs):
            ratio = normal[i, j].conj() / normal[i, i]
            normal[j, j:] -= ratio * normal[i, j:]
            found[j] -= ratio * found[i]
    for i in reversed(range(inputs)):
        for j in range(i + 1, inputs):
            found[i] -= normal[i, j] * found[j]
        found[i] /= normal[i, i]
        if i >= contacts:
            log_determinant += float(np.sum(np.log(normal[i, i].real)))
    return found, log_determinant


def left_by(
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    inputs: Complex[np.ndarray, "inputs lines"],
    weighted: Complex[np.ndarray, "some lines"],
    sensors: list[int] | slice = slice(None),
) -> Complex[np.ndarray, "sensors lines"]:
    """What some weighted accelerations are without that of the inputs."""
    left = -np.einsum("isl,il->sl", by_input, inputs)
    left[sensors] += weighted
    return left
