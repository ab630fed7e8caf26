"""Uniform Bernoulli-Euler beams with analytic modes (the assumed modes of equations 13 to 16 of the paper)."""

from functools import lru_cache
from typing import ClassVar, Literal

import msgspec
import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError

MAX_MODES = 40
MIN_PROPERTY, MAX_PROPERTY = 1e-12, 1e15
"""Range of every property of a beam, in SI units."""


class Beam(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="beam"):
    """A uniform beam; its left end is at position 0. It is a rectangle, or a tube by its diameters.

    A rectangle has its thickness along y and its width along z. A tube bends alike in both directions.
    Modes are mass-normalised: the integral of rho A phi_i phi_k over the length is 1 for i = k and 0 otherwise.
    A free-free beam has two rigid modes, translation then rotation, as modes 1 and 2 (frequency and damping 0).
    """

    is_mass: ClassVar[bool] = False
    positions_m: ClassVar[tuple[float, ...]] = ()

    name: str
    ends: Literal["clamped-free", "free-free"]
    length_m: float
    width_m: float = 0.0
    thickness_m: float = 0.0
    youngs_modulus_pa: float = 210e9
    density_kg_per_m3: float = 7850.0
    damping_ratio: float = 0.01
    outer_diameter_m: float = 0.0
    inner_diameter_m: float = 0.0

    def __post_init__(self) -> None:
        is_tube = bool(self.outer_diameter_m or self.inner_diameter_m)
        if is_tube and (self.width_m or self.thickness_m):
            raise RigError(
                f"beam {self.name!r} has a width or thickness and a diameter; give width_m and thickness_m of a "
                "rectangle, or outer_diameter_m and inner_diameter_m of a tube"
            )
        if is_tube and not 0 <= self.inner_diameter_m < self.outer_diameter_m:
            raise RigError(
                f"beam {self.name!r}: inner_diameter_m is {self.inner_diameter_m} and outer_diameter_m "
                f"{self.outer_diameter_m}; give 0 <= inner < outer"
            )
        section_fields = ("outer_diameter_m",) if is_tube else ("width_m", "thickness_m")
        for field in ("length_m", *section_fields, "youngs_modulus_pa", "density_kg_per_m3"):
            value = getattr(self, field)
            if not MIN_PROPERTY <= value <= MAX_PROPERTY:  # beyond, their powers are lost in rounding
                raise RigError(
                    f"beam {self.name!r}: {field} is {value}; give a value from {MIN_PROPERTY:g} to {MAX_PROPERTY:g}"
                )
        if not (np.isfinite(self.damping_ratio) and self.damping_ratio >= 0):
            raise RigError(
                f"beam {self.name!r}: damping_ratio is {self.damping_ratio}; give a finite value, zero or above"
            )

    @property
    def area_factors(self) -> tuple[float, float]:
        """Two factors of the cross-section's area: width and thickness, m; of a tube the area itself, m^2, and 1."""
        if self.outer_diameter_m:
            return float(np.pi / 4 * (self.outer_diameter_m**2 - self.inner_diameter_m**2)), 1.0
        return self.width_m, self.thickness_m

    @property
    def mass_per_length_kg_per_m(self) -> float:
        first_factor, second_factor = self.area_factors
        return self.density_kg_per_m3 * first_factor * second_factor

    @property
    def mass_kg(self) -> float:
        return self.mass_per_length_kg_per_m * self.length_m

    @property
    def bending_stiffness_n_m2(self) -> float:
        """E I for bending in y, over the thickness, N m^2."""
        if self.outer_diameter_m:
            second_moment_m4 = np.pi / 64 * (self.outer_diameter_m**4 - self.inner_diameter_m**4)
            return float(self.youngs_modulus_pa * second_moment_m4)
        return self.youngs_modulus_pa * self.width_m * self.thickness_m**3 / 12

    @property
    def half_thickness_m(self) -> float:
        """Distance from the neutral fibre to the surface, m."""
        return (self.outer_diameter_m or self.thickness_m) / 2

    @property
    def bending_in_z(self) -> "Beam":
        """Beam as it bends in z: a rectangle over its width."""
        return msgspec.structs.replace(self, width_m=self.thickness_m, thickness_m=self.width_m)

    @property
    def kind(self) -> str:
        return self.ends

    @property
    def clamped(self) -> bool:
        """True if it is clamped at its left end."""
        return self.ends == "clamped-free"

    @property
    def max_modes(self) -> int:
        return MAX_MODES

    @property
    def rigid_modes(self) -> int:
        return 2 if self.ends == "free-free" else 0

    def places(self, count: int) -> Float[np.ndarray, " places"]:
        """Positions (m), `count` of them, evenly spaced from end to end."""
        return np.linspace(0, self.length_m, count)

    def frequencies_hz(self, count: int) -> Float[np.ndarray, " modes"]:
        """Natural frequencies beta_i^2 sqrt(E I / rho A) / 2 pi; zero for rigid modes."""
        wavenumbers_per_m = self._wavenumbers_times_length(count) / self.length_m
        return wavenumbers_per_m**2 * np.sqrt(self.bending_stiffness_n_m2 / self.mass_per_length_kg_per_m) / (2 * np.pi)

    def damping_ratios(self, count: int) -> Float[np.ndarray, " modes"]:
        """Modal damping ratios: the same for every elastic mode, zero for rigid ones."""
        return np.where(np.arange(count) < self.rigid_modes, 0.0, self.damping_ratio)

    def scale_damping(self, factor: float) -> "Beam":
        """Beam with the damping ratio times a factor."""
        return msgspec.structs.replace(self, damping_ratio=self.damping_ratio * factor)

    def scale_frequencies(self, factor: float) -> "Beam":
        """Beam with all frequencies times a factor, by Young's modulus."""
        return msgspec.structs.replace(self, youngs_modulus_pa=self.youngs_modulus_pa * factor**2)

    def scale_mass(self, factor: float) -> "Beam":
        """Beam with the mass times a factor, at the same frequencies: density and Young's modulus."""
        return msgspec.structs.replace(
            self, density_kg_per_m3=self.density_kg_per_m3 * factor, youngs_modulus_pa=self.youngs_modulus_pa * factor
        )

    def shapes(
        self, positions_m: Float[np.ndarray, " stations"], count: int, order: int = 0
    ) -> Float[np.ndarray, "stations modes"]:
        """Mass-normalised mode shapes phi_i(x), in 1/sqrt(kg), for positions 0 <= x <= length.

        order is that of the derivative along x: 0 the shape, 1 its slope (per m), 2 its curvature (per m^2).

        cosh and sinh are never formed: the shapes are written with decaying exponentials, so they stay exact to
        rounding up to mode 40 (Gonçalves, Brennan and Elliott, J. Sound Vib. 301, 2007, treat the problem).
        """
        self._check_modes(count)
        relative_positions = np.asarray(positions_m, dtype=float)[:, None] / self.length_m
        rotation_shape = (
            np.sqrt(12)
            * np.array([relative_positions - 0.5, np.ones_like(relative_positions), np.zeros_like(relative_positions)])[
                order
            ]
        )
        rigid_shapes = np.concatenate([np.full_like(relative_positions, order == 0), rotation_shape], axis=1)[
            :, : self.rigid_modes
        ]
        beta_l = self._wavenumbers_times_length(count)[self.rigid_modes :]
        trigonometric_sign = -1.0 if self.ends == "clamped-free" else 1.0  # of the trigonometric part
        decay, sine, cosine = np.exp(-beta_l), np.sin(beta_l), np.cos(beta_l)
        denominator = 1 - decay**2 - trigonometric_sign * 2 * sine * decay  # 2 e^-b (sinh b -+ sin b)
        growing_coefficient = trigonometric_sign * (cosine - sine) - decay  # (1 - sigma)(sinh b -+ sin b)
        sine_coefficient = (1 + decay**2 - trigonometric_sign * 2 * cosine * decay) / denominator
        argument = beta_l * relative_positions
        waves = np.cos(argument), -np.sin(argument), -np.cos(argument), np.sin(argument)  # each the last one's slope
        elastic_shapes = (
            growing_coefficient / denominator * np.exp(beta_l * (relative_positions - 1))
            + (-1.0) ** order * (1 + sine_coefficient) / 2 * np.exp(-argument)
            + trigonometric_sign * (waves[order] - sine_coefficient * waves[order - 1])
        )
        unscaled_derivatives = np.concatenate([rigid_shapes, beta_l**order * elastic_shapes], axis=1)[:, :count]
        return unscaled_derivatives / (self.length_m**order * np.sqrt(self.mass_kg))

    def _wavenumbers_times_length(self, count: int) -> Float[np.ndarray, " modes"]:
        self._check_modes(count)
        return np.array(_characteristic_roots(self.ends)[:count])

    def _check_modes(self, count: int) -> None:
        if not 1 <= count <= MAX_MODES:
            raise RigError(f"beam {self.name!r}: {count} modes asked for; a beam has 1 to {MAX_MODES} here")


@lru_cache
def _characteristic_roots(end_condition: str) -> tuple[float, ...]:
    """Roots beta l of cos(b) cosh(b) = -1 (clamped-free) or +1 (free-free, after two zeros)."""
    cosh_sign, first_centre_over_pi = (1.0, 0.5) if end_condition == "clamped-free" else (-1.0, 1.5)

    def characteristic(beta: float) -> float:
        return float(np.cos(beta) + cosh_sign / np.cosh(beta))

    root_centres = (first_centre_over_pi + np.arange(MAX_MODES)) * np.pi
    elastic_roots = [
        scipy.optimize.brentq(characteristic, root_centre - 0.4, root_centre + 0.4, xtol=1e-14, rtol=1e-15)
        for root_centre in root_centres
    ]
    return tuple(([] if end_condition == "clamped-free" else [0.0, 0.0]) + elastic_roots)
