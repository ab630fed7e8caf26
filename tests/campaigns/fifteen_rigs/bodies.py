"""Bodies by their modes: uniform beams by Bernoulli's theory, stepped or supported beams by finite elements, masses in
a row, a plate (numpy and scipy alone)."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh
from scipy.optimize import brentq

Rows = Callable[[float], Float[np.ndarray, " modes"]]


@dataclass(frozen=True)
class ModalBody:
    """Frequencies (Hz, 0: rigid), damping ratios, and by place the mass-normalised shapes (1/sqrt(kg)) and their second
    derivatives; participations, the integrals of the shapes over the mass, sqrt(kg)."""

    frequencies_hz: Float[np.ndarray, " modes"]
    ratios: Float[np.ndarray, " modes"]
    shapes: Rows
    curvatures: Rows | None = None
    participations: Float[np.ndarray, " modes"] | None = None

    def scaled(self, factor: float) -> "ModalBody":
        """Of a mass that is so much larger, at the same frequencies."""
        root = np.sqrt(factor)
        bent, moved = self.curvatures, self.participations
        return replace(
            self,
            shapes=lambda x: self.shapes(x) / root,
            curvatures=None if bent is None else lambda x: bent(x) / root,
            participations=None if moved is None else moved * root,
        )


@dataclass(frozen=True)
class Section:
    """A rectangular bar of steel: width and thickness, m."""

    width_m: float
    thickness_m: float
    youngs_modulus_pa: float = 210e9
    density_kg_per_m3: float = 7850.0

    @property
    def bending_n_m2(self) -> float:
        return self.youngs_modulus_pa * self.width_m * self.thickness_m**3 / 12

    @property
    def mass_kg_per_m(self) -> float:
        return self.density_kg_per_m3 * self.width_m * self.thickness_m


def uniform_beam(length_m: float, section: Section, count: int, ratio: float, clamped: bool) -> ModalBody:
    """Clamped at its left end, or free with both rigid motions.

    w = cosh(b x) -+ cos(b x) - s (sinh(b x) -+ sin(b x)), upper signs of the clamped beam, written without differences
    of large numbers (Blevins, Formulas for Natural Frequency and Mode Shape).
    """
    sign = 1.0 if clamped else -1.0
    bends = count if clamped else count - 2
    first = 0.1 if clamped else 1.1
    kl = np.array(
        [
            brentq(lambda z: np.cos(z) + sign / np.cosh(z), (n + first) * np.pi, (n + first + 0.8) * np.pi, xtol=1e-14)
            for n in range(bends)
        ]
    )
    wave = kl / length_m
    shrunk = np.exp(-kl)
    below = (1 - shrunk**2) / 2 + sign * np.sin(kl) * shrunk  # sinh +- sin, over exp
    # 1 - s and 1 + s, the first over exp(-kl)
    lacking = (sign * (np.sin(kl) - np.cos(kl)) - shrunk) / below
    exceeding = 2 - lacking * shrunk
    mass_kg = section.mass_kg_per_m * length_m
    root = np.sqrt(mass_kg)

    def bending(x: float, inner: float) -> Float[np.ndarray, " bends"]:
        grown = lacking * np.exp(wave * x - kl) + exceeding * np.exp(-wave * x)
        s = 1 - lacking * shrunk
        return (grown / 2 - inner * (np.cos(wave * x) - s * np.sin(wave * x))) / root

    omega = wave**2 * np.sqrt(section.bending_n_m2 / section.mass_kg_per_m)
    s = 1 - lacking * shrunk
    if clamped:
        return ModalBody(
            omega / (2 * np.pi),
            np.full(count, ratio),
            lambda x: bending(x, 1.0),
            lambda x: wave**2 * bending(x, -1.0),
            2 * s / wave * section.mass_kg_per_m / root,
        )

    def shapes(x: float) -> Float[np.ndarray, " modes"]:
        return np.concatenate([[1.0, np.sqrt(12) * (x / length_m - 0.5)] / root, bending(x, -1.0)])

    return ModalBody(
        np.concatenate([[0.0, 0.0], omega / (2 * np.pi)]),
        np.concatenate([[0.0, 0.0], np.full(bends, ratio)]),
        shapes,
        lambda x: np.concatenate([[0.0, 0.0], wave**2 * bending(x, 1.0)]),
        np.concatenate([[root], np.zeros(count - 1)]),
    )


def element_beam(
    nodes_m: Float[np.ndarray, " nodes"],
    sections: list[Section],
    count: int,
    ratio: float,
    clamped: bool,
    roller_m: float | None = None,
) -> ModalBody:
    """A beam of cubic Hermite elements (Przemieniecki, Matrix Structural Analysis) with a section each, on a roller."""
    size = 2 * len(nodes_m)
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for k, section in enumerate(sections):
        h = nodes_m[k + 1] - nodes_m[k]
        here = slice(2 * k, 2 * k + 4)
        stiffness[here, here] += (section.bending_n_m2 / h**3) * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h * h, -6 * h, 4 * h * h],
            ]
        )
        mass[here, here] += (section.mass_kg_per_m * h / 420) * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
            ]
        )
    held = {0, 1} if clamped else set()
    if roller_m is not None:
        held.add(2 * int(np.argmin(np.abs(nodes_m - roller_m))))
    free = [i for i in range(size) if i not in held]
    squares, inner = eigh(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)], subset_by_index=[0, count - 1])
    vectors = np.zeros((size, count))
    vectors[free] = inner
    rigid = np.arange(count) < (0 if clamped else 2)

    def shapes(x: float) -> Float[np.ndarray, " modes"]:
        k = int(np.clip(np.searchsorted(nodes_m, x, side="right") - 1, 0, len(sections) - 1))
        h = nodes_m[k + 1] - nodes_m[k]
        s = (x - nodes_m[k]) / h
        weights = [1 - s * s * (3 - 2 * s), h * s * (1 - s) ** 2, s * s * (3 - 2 * s), h * s * s * (s - 1)]
        return weights @ vectors[2 * k : 2 * k + 4]

    omega = np.where(rigid, 0.0, np.sqrt(np.maximum(squares, 0.0)))
    return ModalBody(omega / (2 * np.pi), np.where(rigid, 0.0, ratio), shapes)


def point_mass(mass_kg: float, frequency_hz: float, ratio: float) -> ModalBody:
    root = np.sqrt(mass_kg)
    ratio = ratio if frequency_hz else 0.0
    return ModalBody(
        np.array([frequency_hz]),
        np.array([ratio]),
        lambda _x: np.array([1 / root]),
        participations=np.array([root]),
    )


def masses_in_a_row(masses_kg: list[float], springs_n_per_m: list[float], ratio: float) -> ModalBody:
    """Masses at 1, 2, ... m, a spring from the ground to the first and between neighbours."""
    stiffness = np.zeros((len(masses_kg), len(masses_kg)))
    for k, spring in enumerate(springs_n_per_m):
        stiffness[k, k] += spring
        if k:
            stiffness[k - 1, k - 1] += spring
            stiffness[[k, k - 1], [k - 1, k]] -= spring
    squares, vectors = eigh(stiffness, np.diag(masses_kg))
    return ModalBody(
        np.sqrt(squares) / (2 * np.pi),
        np.full(len(masses_kg), ratio),
        lambda x: vectors[round(x) - 1],
        participations=vectors.T @ np.array(masses_kg),
    )


@dataclass(frozen=True)
class SupportedPlate:
    """A rectangular plate of steel on simple supports: sides and thickness, m."""

    length_m: float
    width_m: float
    thickness_m: float

    def body(self, count: int, ratio: float, points: list[tuple[float, float]]) -> ModalBody:
        """Its lowest modes sin(m pi x / a) sin(n pi y / b); point number k stands at `place` k."""
        bending = 210e9 * self.thickness_m**3 / 12 / (1 - 0.3**2)
        area_kg_per_m2 = 7850.0 * self.thickness_m
        m, n = (grid.ravel() for grid in np.meshgrid(np.arange(1, 31), np.arange(1, 31)))
        frequency = np.pi / 2 * np.sqrt(bending / area_kg_per_m2) * ((m / self.length_m) ** 2 + (n / self.width_m) ** 2)
        lowest = np.argsort(frequency)[:count]
        m, n = m[lowest], n[lowest]
        root = np.sqrt(area_kg_per_m2 * self.length_m * self.width_m / 4)

        def shapes(place: float) -> Float[np.ndarray, " modes"]:
            x, y = points[round(place)]
            return np.sin(m * np.pi * x / self.length_m) * np.sin(n * np.pi * y / self.width_m) / root

        return ModalBody(frequency[lowest], np.full(count, ratio), shapes)
