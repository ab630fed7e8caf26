"""Modes of a beam from cubic Hermite finite elements (Bernoulli-Euler; Przemieniecki, Matrix Structural Analysis)."""

from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from tests.campaigns.worlds.body_modes import BodyModes
from tests.campaigns.worlds.machine import MODES, TrueBeam

ELEMENTS = 64


def interpolation(length_m: float, position_m: float) -> Float[np.ndarray, " coordinates"]:
    """The weights of every node's displacement and slope in the displacement at a place."""
    size_m = length_m / ELEMENTS
    element = min(int(position_m / size_m), ELEMENTS - 1)
    s = position_m / size_m - element
    row = np.zeros(2 * ELEMENTS + 2)
    row[2 * element : 2 * element + 4] = [
        1 - s * s * (3 - 2 * s),
        size_m * s * (1 - s) ** 2,
        s * s * (3 - 2 * s),
        size_m * s * s * (s - 1),
    ]
    return row


def modes_of(beam: TrueBeam) -> BodyModes:
    """The modes of the beam with its point masses and springs, perturbed by its factors.

    The rigid modes of a free beam, and what springs make of them, are undamped.
    """
    size_m = beam.length_m / ELEMENTS
    nodes = 2 * ELEMENTS + 2
    mass, stiffness = np.zeros((nodes, nodes)), np.zeros((nodes, nodes))
    element_mass, element_stiffness = _element(size_m)
    for first in range(0, nodes - 2, 2):
        here = slice(first, first + 4)
        mass[here, here] += beam.mass_per_length_kg_per_m * element_mass
        stiffness[here, here] += beam.bending_stiffness_n_m2 * element_stiffness
    for position_m, mass_kg in beam.masses:
        row = interpolation(beam.length_m, position_m)
        mass += mass_kg * np.outer(row, row)
    for position_m, spring_n_per_m in beam.springs:
        row = interpolation(beam.length_m, position_m)
        stiffness += spring_n_per_m * np.outer(row, row)
    if beam.clamp_n_m_per_rad is not None:
        stiffness[1, 1] += beam.clamp_n_m_per_rad
    held = 0 if not beam.clamped else 2 if beam.clamp_n_m_per_rad is None else 1
    squares, free = eigh(stiffness[held:, held:], mass[held:, held:], subset_by_index=[0, MODES - 1])
    vectors = np.concatenate([np.zeros((held, MODES)), free])
    rigid = np.arange(MODES) < (0 if beam.clamped else 2)
    floating = rigid & (not beam.springs)
    omega = np.sqrt(np.where(floating, 0.0, np.maximum(squares, 0.0))) * np.array(beam.frequency_factors)
    damping = np.where(rigid, 0.0, beam.damping_ratio * np.array(beam.damping_factors))
    translation = np.tile([1.0, 0.0], ELEMENTS + 1)
    carried = vectors.T @ mass @ translation
    return BodyModes(omega, damping, vectors, carried, partial(interpolation, beam.length_m))


def _element(h: float) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]]:
    """Mass and stiffness for unit mass per length and unit E I, from the shapes by exact quadrature."""
    points, weights = np.polynomial.legendre.leggauss(4)
    s = (points + 1) / 2
    shape = np.array([1 - 3 * s**2 + 2 * s**3, h * (s - 2 * s**2 + s**3), 3 * s**2 - 2 * s**3, h * (s**3 - s**2)])
    bent = np.array([-6 + 12 * s, h * (-4 + 6 * s), 6 - 12 * s, h * (6 * s - 2)]) / h**2
    return (shape * weights * h / 2) @ shape.T, (bent * weights * h / 2) @ bent.T
