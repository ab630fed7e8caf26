"""Prediction of each channel by all others and the linear model: contact forces are unknown at every line.

    A = sum_k G_k F_k - sum_j G_j f_j + error

with the accelerances G. The f_j, and a force F_k that is doubted, are found by least squares from the channels that are
kept; each line's squared error, over the degrees of freedom, is in units of a rough share of what the body does there.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.checks.spectra import SMOOTHED, Spectra
from identify.linear.model import ResponseCache, accelerances, input_shapes, response_of, times
from identify.linear.projection import Projection, projection
from rig.model.description import Rig, Station

ROUGH = 0.03
"""A sound model may be wrong by this share of what its body does at a line: far more than tolerances make."""
NOISY, TOLD = 0.1, 0.05
"""A line on which noise makes more than this share of the scale's square tells of noise, not of the bodies: it does not
count, unless fewer than this share of the lines are left."""
DRIVEN = 0.05
"""A force drives the lines on which it has this share of its largest level."""


@dataclass(frozen=True)
class Predicted:
    """Prediction of all channels by those that are kept and the model.

    misfit is the median over the lines of the mean square of the error of the kept ones, or that over the lines which
    a force drives where it is larger, without those that noise rules; nan where they tell nothing.
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
        """Unknown inputs: the force of that number, if one is doubted, and the contacts."""
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

    def beside(self, spectra: Spectra, kept: list[int]) -> "LinearCheck":
        """Other spectra of the same sensors and lines beside the same accelerances; see `linear_check`."""
        return LinearCheck(spectra, self.accelerance, _scale(spectra, kept), driven_by(spectra.forces))

    def projection(self, kept: list[int], doubted: int | None = None) -> Projection:
        """Projection of the contact forces, and a force that is doubted, from the channels kept."""
        unknown, scale = self.unknown(doubted)[:, kept], self.scale[kept]
        return projection(unknown / scale, scale, len(unknown))

    def predicted(self, kept: list[int], doubted: int | None = None) -> Predicted:
        """Prediction by the channels kept and the measured forces, but for the one of that number if one is doubted."""
        spectra, unknown = self.spectra, self.unknown(doubted)
        known = self.by_force if doubted is None else np.delete(self.by_each_force, doubted, axis=0).sum(axis=0)
        residual, inputs = self.projection(kept, doubted).of((spectra.acceleration - known)[kept])
        freedom = len(kept) - len(unknown)
        per_line, telling = np.sum(np.abs(residual) ** 2, axis=0), self._telling(kept)
        driven = (per_line[lines & telling] for lines in self.driven if np.any(lines & telling))
        worst = max(float(np.median(x)) for x in (per_line[telling], *driven))
        misfit = worst / freedom if freedom > 0 else np.nan
        forces, contacts = spectra.forces, inputs
        if doubted is not None:
            forces, contacts = forces.copy(), inputs[1:]
            forces[doubted] = inputs[0]
        return Predicted(misfit, known + np.einsum("isl,il->sl", unknown, inputs), forces, contacts)

    def _telling(self, kept: list[int]) -> Bool[np.ndarray, " lines"]:
        """The lines on which the motion of these channels, not their noise, decides."""
        noise = np.mean((self.spectra.noise[kept] / self.scale[kept]) ** 2, axis=0)
        telling = noise < NOISY
        return np.asarray(telling) if np.mean(telling) > TOLD else np.ones_like(telling)


def linear_check(
    rig: Rig, spectra: Spectra, kept: list[int] | None = None, cache: ResponseCache | None = None
) -> LinearCheck:
    """A rig beside spectra, in the scale of the channels kept. `cache` is that of whoever tries many rigs."""
    kept = list(range(len(spectra.sensors))) if kept is None else kept
    made = _accelerances(rig, spectra, cache or ResponseCache(spectra.omega, 0))
    return LinearCheck(spectra, made, _scale(spectra, kept), driven_by(spectra.forces))


def _scale(spectra: Spectra, kept: list[int]) -> Float[np.ndarray, "sensors lines"]:
    """Scale of the median channel of each body (of those kept), so that no single one rules it."""
    bodies = [s.station.body for s in spectra.sensors]
    scale = np.empty(spectra.noise.shape)
    for body in dict.fromkeys(bodies):
        own = [i for i, b in enumerate(bodies) if b == body]
        told = [i for i in own if i in kept] or own
        scale[own] = ROUGH * np.median(spectra.level[told], axis=0)
    scale = np.hypot(scale, spectra.noise)
    return np.asarray(np.maximum(scale, 1e-9 * float(scale.max()) or 1.0))


def by_forces(
    rig: Rig, predicted: Predicted, omega: Float[np.ndarray, " lines"], stations: list[Station]
) -> Complex[np.ndarray, "stations lines"]:
    """The accelerations at any stations by the forces and the estimated contact forces."""
    forces, cache = np.concatenate([predicted.forces, predicted.contacts]), ResponseCache(omega, 0)
    responses = (response_of(rig, body, cache) for body in rig.bodies)
    rows = (
        times(r.shapes(stations), r.accelerance * times(input_shapes(rig, r, rig.forces).T, forces)) for r in responses
    )
    return np.asarray(sum(rows))


def driven_by(forces: Complex[np.ndarray, "forces lines"]) -> Bool[np.ndarray, "forces lines"]:
    """The lines on which each force has a share of its largest level."""
    level = np.sqrt(np.maximum(uniform_filter1d(np.abs(forces) ** 2, SMOOTHED, axis=1), 0.0))
    return np.asarray(level > DRIVEN * level.max(axis=1, keepdims=True))


def _accelerances(rig: Rig, spectra: Spectra, cache: ResponseCache) -> Complex[np.ndarray, "inputs sensors lines"]:
    """Accelerances of each force, then of each contact (which drives by minus its force)."""
    responses = [response_of(rig, body, cache) for body in rig.bodies]
    return accelerances(rig, responses, rig.forces, [s.station for s in spectra.sensors])
