"""What the linear model says of each channel by all others: contact forces are unknown at every line.

    A = G_F F - sum_j G_j f_j + error

with the accelerances G. The f_j, and F where it is doubted, are found by least squares from the channels that are kept;
each line's squared error, over the degrees of freedom, is in units of a rough share of what the body does there.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.spectra import Spectra
from identify.structure.response import across, response_of
from rig.model.description import Rig

ROUGH = 0.03
"""A sound model may be wrong by this share of what its body does at a line: far more than tolerances make."""


@dataclass(frozen=True)
class Predicted:
    """What some kept channels, and the model, say of all.

    misfit is the median over the lines of the mean square of the error of the kept ones; nan where they tell nothing.
    """

    misfit: float
    acceleration: Complex[np.ndarray, "sensors lines"]
    force: Complex[np.ndarray, " lines"]
    contacts: Complex[np.ndarray, "contacts lines"]


@dataclass(frozen=True)
class LinearCheck:
    """A record's spectra beside a rig's accelerances, of the force first, then of the contacts."""

    spectra: Spectra
    accelerance: Complex[np.ndarray, "inputs sensors lines"]
    scale: Float[np.ndarray, "sensors lines"]

    @property
    def contacts(self) -> int:
        return len(self.accelerance) - 1

    def predicted(self, kept: list[int], force: bool = True) -> Predicted:
        """From the channels kept, and from the measured force or without it."""
        own = self.spectra
        unknown = self.accelerance[1:] if force else self.accelerance
        known = self.accelerance[0] * own.force if force else np.zeros_like(own.acceleration)
        weighted = ((own.acceleration - known) / self.scale)[kept]
        columns = (unknown / self.scale)[:, kept].transpose(2, 1, 0)
        adjoint = columns.conj().transpose(0, 2, 1)
        normal = adjoint @ columns
        size = np.trace(normal, axis1=1, axis2=2).real
        ridge = 1e-9 * np.maximum(size, 1e-300)[:, None, None] * np.eye(len(unknown))
        inputs = np.linalg.solve(normal + ridge, adjoint @ weighted.T[..., None])[..., 0].T
        left = weighted - np.einsum("lsi,il->sl", columns, inputs)
        freedom = len(kept) - len(unknown)
        misfit = float(np.median(np.sum(np.abs(left) ** 2, axis=0))) / freedom if freedom > 0 else np.nan
        return Predicted(
            misfit,
            known + np.einsum("isl,il->sl", unknown, inputs),
            own.force if force else inputs[0],
            inputs if force else inputs[1:],
        )


def linear_check(rig: Rig, spectra: Spectra, kept: list[int] | None = None) -> LinearCheck:
    """The scale is that of the median channel of each body (of those kept), so that no single one rules it."""
    kept = list(range(len(spectra.sensors))) if kept is None else kept
    bodies = [s.station.body for s in spectra.sensors]
    scale = np.empty(spectra.noise.shape)
    for body in dict.fromkeys(bodies):
        own = [i for i, b in enumerate(bodies) if b == body]
        told = [i for i in own if i in kept] or own
        scale[own] = ROUGH * np.median(spectra.level[told], axis=0)
    scale = np.hypot(scale, spectra.noise)
    scale = np.maximum(scale, 1e-9 * float(scale.max()) or 1.0)
    return LinearCheck(spectra, accelerances(rig, spectra), scale)


def accelerances(rig: Rig, spectra: Spectra) -> Complex[np.ndarray, "inputs sensors lines"]:
    """Of the force, then of each contact (which drives by minus its force)."""
    stations = [s.station for s in spectra.sensors]
    found = np.zeros((1 + len(rig.contacts), len(stations), spectra.omega.size), dtype=complex)
    for body in rig.bodies:
        r = response_of(rig, body, spectra.omega)
        found += r.transfer(r.shapes(stations), np.concatenate([r.shapes([rig.force_at]), -across(rig, r)]))
    return found
