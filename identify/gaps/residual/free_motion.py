"""The free motion of elastic bodies in a record without a force, which begins in motion: unknowns of the linear model.

Such a record does not fade in. What a mode of displacement q_0 and velocity q_0' at its first sample adds to the second
derivative of the displacements, the jump at the first sample included, is, with its accelerance A_m = -omega^2 / D_m,

    q_0 (i omega + 2 zeta_m omega_m) A_m + q_0' A_m

All q_0 and q_0' are found by least squares, for every rig that is laid against the record.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.spectra import Record
from identify.linear.model import Response, times
from identify.linear.projection import Projection
from rig.model.description import Station
from rig.model.modes import modes_of


@dataclass(frozen=True, eq=False)
class FreeMode:
    """Of one mode (from 0) of a body: its shape at the sensors, and its accelerations by a unit of its displacement and
    of its velocity at the beginning; state is how large these were, times the sample rate, as spectra are sums."""

    body: int
    mode: int
    shape: Float[np.ndarray, " sensors"]
    units: Complex[np.ndarray, "2 lines"]
    state: Float[np.ndarray, " 2"]

    @property
    def acceleration(self) -> Complex[np.ndarray, " lines"]:
        return np.asarray(self.state @ self.units)


def free_modes(record: Record, responses: Sequence[Response], places: list[Station | None]) -> tuple[FreeMode, ...]:
    """Those of the modes of elastic bodies, with nothing in them; none of a record with a force.

    The modes are those in the band by the believed rig, so that all rigs have the same unknowns.
    """
    if record.forced:
        return ()
    turning = 1j * record.omega
    found = []
    for k, response in enumerate(responses):
        if response.body.is_mass:
            continue
        believed_hz = modes_of(record.rig, record.rig.body(response.body.name)).frequencies_hz(response.count)
        damped = 4 * np.pi * response.dynamics.natural_hz * response.dynamics.damping_ratios
        shapes = response.shapes(places)
        for m in np.flatnonzero(believed_hz < record.highest_hz):
            units = np.stack([(turning + damped[m]) * response.accelerance[m], response.accelerance[m]])
            found.append(FreeMode(k, int(m), shapes[:, m], units, np.zeros(2)))
    return tuple(found)


def fitted_modes(
    motions: Sequence[FreeMode],
    projection: Projection,
    sensed: Complex[np.ndarray, "sensors lines"],
    left: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMode, ...]:
    """The states at the beginning that leave least of a linear residual.

    sensed is what accelerations are in standard deviations. With the shapes Phi at the sensors and the projection B T,

        N = Phi sensed* (1 - B T) sensed Phi'

    is what any two modes' accelerations are weighed by, line by line.
    """
    shapes, units = np.array([m.shape for m in motions]), np.array([m.units for m in motions])
    both = (shapes[:, None] * shapes).reshape(-1, shapes.shape[1])
    weights = (both @ np.abs(sensed) ** 2).reshape(len(shapes), *units.shape[::2]).astype(complex)
    for by_one, to_one in zip(projection.by_input, projection.to_inputs, strict=True):
        weights -= times(shapes, sensed.conj() * by_one)[:, None] * times(shapes, sensed * to_one)
    normal, gradient = (
        np.concatenate([_products(one, own) for one, own in zip(units, of_modes, strict=True)])
        for of_modes in (
            (weights[:, :, None] * units).reshape(len(units), -1, sensed.shape[1]),
            times(shapes, sensed.conj() * left)[:, None],
        )
    )
    size = np.sqrt(np.diag(normal))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    states = scale * (np.linalg.pinv(scale[:, None] * normal * scale, hermitian=True) @ (scale * gradient[:, 0]))
    return tuple(replace(m, state=state) for m, state in zip(motions, states.reshape(-1, 2), strict=True))


def _products(
    one: Complex[np.ndarray, "some lines"], other: Complex[np.ndarray, "more lines"]
) -> Float[np.ndarray, "some more"]:
    """The real parts of the scalar products."""
    return np.asarray(one.view(float) @ np.ascontiguousarray(other).view(float).T)
