"""What the linear model says of each channel by all others: contact forces are unknown at every line.

    A = G_F F - sum_j G_j f_j + error

with the accelerances G. The f_j, and F where it is doubted, are found by least squares from the channels that are kept;
each line's squared error, over the degrees of freedom, is in units of a rough share of what the body does there.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.checks.spectra import SMOOTHED, Spectra
from identify.structure.response import across, response_of, times
from rig.model.description import Rig, Station

ROUGH = 0.03
"""A sound model may be wrong by this share of what its body does at a line: far more than tolerances make."""


DRIVEN = 0.05
"""The force drives the lines on which it has this share of its largest level."""


@dataclass(frozen=True)
class Predicted:
    """What some kept channels, and the model, say of all.

    misfit is the median over the lines of the mean square of the error of the kept ones, or that over the lines which
    the force drives where it is larger; nan where they tell nothing.
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
    driven: Bool[np.ndarray, " lines"]

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
        per_line = np.sum(np.abs(left) ** 2, axis=0)
        worst = max(float(np.median(x)) for x in (per_line, per_line[self.driven]))
        misfit = worst / freedom if freedom > 0 else np.nan
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
    return LinearCheck(spectra, accelerances(rig, spectra), scale, driven_by(spectra))


def by_forces(
    rig: Rig, predicted: Predicted, omega: Float[np.ndarray, " lines"], stations: list[Station]
) -> Complex[np.ndarray, "stations lines"]:
    """The accelerations at any stations by the force and the contact forces that were found."""
    forces = np.concatenate([predicted.force[None], predicted.contacts])
    found = np.zeros((len(stations), omega.size), dtype=complex)
    for body in rig.bodies:
        r = response_of(rig, body, omega)
        pushed = np.concatenate([r.shapes([rig.force_at]), -across(rig, r)])
        found += times(r.shapes(stations), r.accelerance * times(pushed.T, forces))
    return found


def driven_by(spectra: Spectra) -> Bool[np.ndarray, " lines"]:
    """The lines on which the force has a share of its largest level."""
    level = np.sqrt(uniform_filter1d(np.abs(spectra.force) ** 2, SMOOTHED))
    return np.asarray(level > DRIVEN * float(level.max()))


def accelerances(rig: Rig, spectra: Spectra) -> Complex[np.ndarray, "inputs sensors lines"]:
    """Of the force, then of each contact (which drives by minus its force)."""
    stations = [s.station for s in spectra.sensors]
    found = np.zeros((1 + len(rig.contacts), len(stations), spectra.omega.size), dtype=complex)
    for body in rig.bodies:
        r = response_of(rig, body, spectra.omega)
        found += r.transfer(r.shapes(stations), np.concatenate([r.shapes([rig.force_at]), -across(rig, r)]))
    return found
