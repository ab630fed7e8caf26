"""What the linear model says of each channel by all others: contact forces are unknown at every line.

    A = sum_k G_k F_k - sum_j G_j f_j + error

with the accelerances G. The f_j, and a force F_k that is doubted, are found by least squares from the channels that are
kept; each line's squared error, over the degrees of freedom, is in units of a rough share of what the body does there.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.checks.spectra import SMOOTHED, Spectra
from identify.linear.model import across, response_of, times
from rig.model.description import Rig, Station

ROUGH = 0.03
"""A sound model may be wrong by this share of what its body does at a line: far more than tolerances make."""


DRIVEN = 0.05
"""A force drives the lines on which it has this share of its largest level."""


@dataclass(frozen=True)
class Predicted:
    """What some kept channels, and the model, say of all.

    misfit is the median over the lines of the mean square of the error of the kept ones, or that over the lines which
    a force drives where it is larger; nan where they tell nothing.
    """

    misfit: float
    acceleration: Complex[np.ndarray, "sensors lines"]
    forces: Complex[np.ndarray, "forces lines"]
    contacts: Complex[np.ndarray, "contacts lines"]


@dataclass(frozen=True)
class LinearCheck:
    """A record's spectra beside a rig's accelerances, of the forces first, then of the contacts."""

    spectra: Spectra
    accelerance: Complex[np.ndarray, "inputs sensors lines"]
    scale: Float[np.ndarray, "sensors lines"]
    driven: Bool[np.ndarray, "forces lines"]

    @property
    def contacts(self) -> int:
        return len(self.of_contacts)

    @property
    def of_contacts(self) -> Complex[np.ndarray, "contacts sensors lines"]:
        return self.accelerance[len(self.spectra.forces) :]

    def unknown(self, doubted: int | None = None) -> Complex[np.ndarray, "inputs sensors lines"]:
        """Of the force of that number, if one is doubted, and of the contacts."""
        if doubted is None:
            return self.of_contacts
        return np.concatenate([self.accelerance[doubted : doubted + 1], self.of_contacts])

    @property
    def by_each_force(self) -> Complex[np.ndarray, "forces sensors lines"]:
        return self.accelerance[: len(self.spectra.forces)] * self.spectra.forces[:, None]

    @property
    def by_force(self) -> Complex[np.ndarray, "sensors lines"]:
        """The accelerations by all measured forces."""
        return np.asarray(self.by_each_force.sum(axis=0))

    def predicted(self, kept: list[int], doubted: int | None = None) -> Predicted:
        """From the channels kept and the measured forces, but for the one of that number if one is doubted."""
        own, unknown = self.spectra, self.unknown(doubted)
        known = self.by_force if doubted is None else np.delete(self.by_each_force, doubted, axis=0).sum(axis=0)
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
        driven = (per_line[lines] for lines in self.driven if lines.any())
        worst = max(float(np.median(x)) for x in (per_line, *driven))
        misfit = worst / freedom if freedom > 0 else np.nan
        forces, contacts = own.forces, inputs
        if doubted is not None:
            forces, contacts = forces.copy(), inputs[1:]
            forces[doubted] = inputs[0]
        return Predicted(misfit, known + np.einsum("isl,il->sl", unknown, inputs), forces, contacts)


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
    return LinearCheck(spectra, accelerances(rig, spectra), scale, driven_by(spectra.forces))


def by_forces(
    rig: Rig, predicted: Predicted, omega: Float[np.ndarray, " lines"], stations: list[Station]
) -> Complex[np.ndarray, "stations lines"]:
    """The accelerations at any stations by the forces and the contact forces that were found."""
    forces = np.concatenate([predicted.forces, predicted.contacts])
    found = np.zeros((len(stations), omega.size), dtype=complex)
    for body in rig.bodies:
        r = response_of(rig, body, omega)
        pushed = np.concatenate([r.shapes([*rig.forces]), -across(rig, r)])
        found += times(r.shapes(stations), r.accelerance * times(pushed.T, forces))
    return found


def driven_by(forces: Complex[np.ndarray, "forces lines"]) -> Bool[np.ndarray, "forces lines"]:
    """The lines on which each force has a share of its largest level."""
    level = np.sqrt(np.maximum(uniform_filter1d(np.abs(forces) ** 2, SMOOTHED, axis=1), 0.0))
    return np.asarray(level > DRIVEN * level.max(axis=1, keepdims=True))


def accelerances(rig: Rig, spectra: Spectra) -> Complex[np.ndarray, "inputs sensors lines"]:
    """Of each force, then of each contact (which drives by minus its force)."""
    stations = [s.station for s in spectra.sensors]
    found = np.zeros((len(rig.forces) + len(rig.contacts), len(stations), spectra.omega.size), dtype=complex)
    for body in rig.bodies:
        r = response_of(rig, body, spectra.omega)
        found += r.transfer(r.shapes(stations), np.concatenate([r.shapes([*rig.forces]), -across(rig, r)]))
    return found
