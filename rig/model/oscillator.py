"""Single mass, free or on a linear spring to the ground: the body of the one-mass rig (figure 1 of the paper)."""

from typing import ClassVar

import msgspec
import numpy as np
from jaxtyping import Float

from rig.errors import RigError


class Oscillator(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="oscillator"):
    """A mass with a natural frequency and a damping ratio; seen as a body, it has one mode, 1/sqrt(mass) everywhere.

    At a frequency of 0 it is free, and has no damping.
    """

    is_mass: ClassVar[bool] = True
    positions_m: ClassVar[tuple[float, ...]] = ()
    clamped: ClassVar[bool] = False

    name: str
    mass_kg: float
    frequency_hz: float
    damping_ratio: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mass_kg) and self.mass_kg > 0):
            raise RigError(f"oscillator {self.name!r}: mass_kg is {self.mass_kg}; give a finite value above zero")
        for field in ("frequency_hz", "damping_ratio"):
            value = getattr(self, field)
            if not (np.isfinite(value) and value >= 0):
                raise RigError(f"oscillator {self.name!r}: {field} is {value}; give a finite value, zero or above")

    @property
    def half_thickness_m(self) -> None:
        """None: a mass does not bend."""
        return None

    @property
    def kind(self) -> str:
        return "mass on a spring" if self.frequency_hz else "free mass"

    @property
    def length_m(self) -> float:
        return 0.0

    @property
    def max_modes(self) -> int:
        return 1

    @property
    def rigid_modes(self) -> int:
        return 0 if self.frequency_hz else 1

    @property
    def stiffness_n_per_m(self) -> float:
        return self.mass_kg * (2 * np.pi * self.frequency_hz) ** 2

    @property
    def damping_n_s_per_m(self) -> float:
        return 2 * self.damping_ratio * self.mass_kg * 2 * np.pi * self.frequency_hz

    def places(self, _count: int) -> Float[np.ndarray, " places"]:
        """Positions at which its shapes are known: 0 m alone."""
        return np.zeros(1)

    def frequencies_hz(self, count: int) -> Float[np.ndarray, " modes"]:
        return np.full(self._checked_count(count), self.frequency_hz)

    def damping_ratios(self, count: int) -> Float[np.ndarray, " modes"]:
        return np.full(self._checked_count(count), self.damping_ratio)

    def scale_damping(self, factor: float) -> "Oscillator":
        """Mass with the damping ratio times a factor."""
        return msgspec.structs.replace(self, damping_ratio=self.damping_ratio * factor)

    def scale_frequencies(self, factor: float) -> "Oscillator":
        """Mass with the frequency times a factor, by the spring."""
        return msgspec.structs.replace(self, frequency_hz=self.frequency_hz * factor)

    def scale_mass(self, factor: float) -> "Oscillator":
        """Mass times a factor, at the same frequency."""
        return msgspec.structs.replace(self, mass_kg=self.mass_kg * factor)

    def shapes(
        self, positions_m: Float[np.ndarray, " stations"], count: int, order: int = 0
    ) -> Float[np.ndarray, "stations modes"]:
        """Mode shape 1/sqrt(mass) at every position; its derivatives along the body are zero."""
        return np.full((len(positions_m), self._checked_count(count)), (order == 0) / np.sqrt(self.mass_kg))

    def _checked_count(self, count: int) -> int:
        if count != 1:
            raise RigError(f"oscillator {self.name!r}: {count} modes asked for; it has exactly one")
        return count
