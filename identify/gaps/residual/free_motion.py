"""The free motion of elastic bodies in a record that begins in motion and has no force, as unknowns of the linear model.

While such a record fades in, by the window w, the modal equation of w q holds with a further force on the mode,

    w (q'' + 2 zeta omega q' + omega^2 q) + 2 w' q' + w'' q + 2 zeta omega w' q

Behind the fade only the ringing of that force is left: two unknowns a mode, as of its initial displacement and
velocity. So two bursts at the mode's frequency within the fade stand for it, whatever their shape.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex
from scipy.signal.windows import hann

from identify.gaps.residual.projection import Projection
from identify.gaps.residual.spectra import TAPER_S, Record
from identify.structure.response import Response
from rig.model.description import Station


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """The acceleration of one mode (from 0) of a body, and what the sensors deliver of it."""

    body: int
    mode: int
    acceleration: Complex[np.ndarray, " lines"]
    delivered: Complex[np.ndarray, "sensors lines"]

    def as_large_as(self, delivered: Complex[np.ndarray, "sensors lines"]) -> "FreeMotion":
        return self.times(float(np.linalg.norm(delivered) / np.linalg.norm(self.delivered)))

    def times(self, factor: float) -> "FreeMotion":
        return replace(self, acceleration=factor * self.acceleration, delivered=factor * self.delivered)


def free_motions(
    record: Record,
    responses: Sequence[Response],
    places: list[Station | None],
    sensor_response: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMotion, ...]:
    """Two of each mode of elastic bodies in the band that rings, as large as the record; none where a force acts."""
    if record.forced:
        return ()
    turning, order = 1j * record.omega, record.sensors[0].measures.order
    found = []
    for k, response in enumerate(responses):
        hz, zeta = response.dynamics.natural_hz, response.dynamics.damping_ratios
        shapes = response.shapes(places)
        for m in np.flatnonzero(hz < record.highest_hz) if response.body.length_m else ():
            of_velocity, damped = response.accelerance[m], 4 * np.pi * zeta[m] * hz[m]
            of_displacement = (turning + damped) * of_velocity
            for acceleration in (of_displacement - (order > 0) * turning, of_velocity - (order > 1)):
                delivered = sensor_response * (shapes[:, m, None] * acceleration)
                if np.any(delivered):
                    found.append(FreeMotion(k, int(m), acceleration, delivered).as_large_as(record.delivered))
    return tuple(found)


def fitted_motions(
    motions: Sequence[FreeMotion],
    projection: Projection,
    delivered: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMotion, ...]:
    """As large as they leave least of the linear residual."""
    left, *rows = (projection.of(one)[0].ravel() for one in (delivered, *(m.delivered for m in motions)))
    columns = np.array(rows).view(float)
    sizes = np.linalg.pinv(columns @ columns.T, hermitian=True) @ (columns @ left.view(float))
    return tuple(motion.times(size) for motion, size in zip(motions, sizes.tolist(), strict=True))
