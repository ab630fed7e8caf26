"""First rigs of masses: two with a bumper between them, or a row of them on springs, as the floors of a frame."""

from collections.abc import Iterator
from typing import Annotated

import msgspec
import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError
from rig.lab.starting.base import StartWithStops
from rig.model.description import Rig, Station
from rig.model.oscillator import Oscillator
from rig.model.structure import Structure, structure_of

MAX_MASS_COUNT = 50
"""Largest number of masses in a row."""


class TwoMassesRig(StartWithStops, frozen=True, kw_only=True):
    """Two masses, each on a spring to the ground, that meet at a contact; the force acts on the first.

    The relative displacement is that of the first mass less that of the second.
    """

    masses_kg: Annotated[tuple[float, ...], msgspec.Meta(description="Both masses, kg, with a comma.")]
    frequencies_hz: Annotated[
        tuple[float, ...], msgspec.Meta(description="Natural frequency of each on its spring, Hz; 0 of a free mass.")
    ]
    damping_ratio: Annotated[float, msgspec.Meta(description="Damping ratio of each; a free mass has none.")] = 0.01

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        for name, numbers in (("masses_kg", self.masses_kg), ("frequencies_hz", self.frequencies_hz)):
            if len(numbers) != 2:
                raise RigError(f"{name} has {len(numbers)} numbers; give two, one for each mass")
        first_mass, second_mass = (
            Oscillator(name=name, mass_kg=mass_kg, frequency_hz=hz, damping_ratio=self.damping_ratio if hz else 0.0)
            for name, mass_kg, hz in zip(("first", "second"), self.masses_kg, self.frequencies_hz, strict=True)
        )
        stations = Station("first"), Station("second")
        rig = self._rig((first_mass, second_mass), [stations], stations[0], stations)
        return rig, self.notes()


class ChainRig(StartWithStops, frozen=True, kw_only=True):
    """Masses in a row on springs, the first one's to the ground: a chain, or the floors of a frame.

    Its modes stand in rig.json as a structure named "chain", in which mass k is at k metres.
    """

    masses_kg: Annotated[tuple[float, ...], msgspec.Meta(description="Masses from the ground on, kg, with commas.")]
    springs_n_per_m: Annotated[
        tuple[float, ...],
        msgspec.Meta(description="Springs, N/m: ground to mass 1, 1 to 2, ...; one number for all. 0: none."),
    ]
    damping_ratio: Annotated[float, msgspec.Meta(description="Damping ratio of every mode.")] = 0.01
    contacts: Annotated[
        tuple[str, ...],
        msgspec.Meta(
            description="Pairs of masses that meet, as 3-2,4-0 where 0 is the ground; otherwise the last two."
        ),
    ] = ()
    force_mass: Annotated[int | None, msgspec.Meta(description="Mass on which the force acts; else the last.")] = None

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        count = len(self.masses_kg)
        if not 2 <= count <= MAX_MASS_COUNT or not all(0 < mass_kg < np.inf for mass_kg in self.masses_kg):
            raise RigError(f"masses_kg is {self.masses_kg}; give 2 to {MAX_MASS_COUNT} masses, each above zero")
        springs_n_per_m = self.springs_n_per_m * (count if len(self.springs_n_per_m) == 1 else 1)
        if len(springs_n_per_m) != count or not all(0 <= spring < np.inf for spring in springs_n_per_m):
            raise RigError(
                f"springs_n_per_m has {len(self.springs_n_per_m)} numbers for {count} masses; give one for all, or one "
                "for each mass, zero or above"
            )
        body = chain_modal_basis("chain", np.array(self.masses_kg), np.array(springs_n_per_m), self.damping_ratio)
        stations = [Station("chain", float(number)) for number in range(1, count + 1)]
        meeting_stations = [
            (stations[first_number - 1], stations[second_number - 1] if second_number else None)
            for first_number, second_number in self._mass_pairs(count)
        ]
        force_at = stations[
            self._checked_mass_number("force_mass", count if self.force_mass is None else self.force_mass, count) - 1
        ]
        frequency_words = ", ".join(f"{natural_hz:.4g}" for natural_hz in body.natural_hz)
        rig = self._rig((body,), meeting_stations, force_at, stations)
        return rig, (f"natural frequencies, without contacts: {frequency_words} Hz", *self.notes())

    def _mass_pairs(self, mass_count: int) -> Iterator[tuple[int, int]]:
        for pair in self.contacts or (f"{mass_count}-{mass_count - 1}",):
            first_text, dash, second_text = pair.strip().partition("-")
            if not (dash and first_text.isdecimal() and second_text.isdecimal()) or first_text == second_text:
                raise RigError(f"contacts has {pair!r}; give pairs of masses such as 3-2, or 3-0 against the ground")
            yield (
                self._checked_mass_number("contacts", int(first_text), mass_count),
                self._checked_mass_number("contacts", int(second_text), mass_count, least_number=0),
            )

    def _checked_mass_number(self, option: str, mass_number: int, mass_count: int, least_number: int = 1) -> int:
        if not least_number <= mass_number <= mass_count:
            raise RigError(f"{option} names mass {mass_number}; there are masses {least_number} to {mass_count}")
        return mass_number


def chain_modal_basis(
    name: str,
    masses_kg: Float[np.ndarray, " masses"],
    springs_n_per_m: Float[np.ndarray, " masses"],
    damping_ratio: float,
) -> Structure:
    """Modal basis of masses in a row: K phi = omega^2 M phi, spring k between mass k - 1 and k, 0 being the ground."""
    springs_above_n_per_m = np.append(springs_n_per_m[1:], 0.0)
    stiffness_matrix = (
        np.diag(springs_n_per_m + springs_above_n_per_m)
        - np.diag(springs_above_n_per_m[:-1], 1)
        - np.diag(springs_above_n_per_m[:-1], -1)
    )
    omega_squared, shapes = scipy.linalg.eigh(stiffness_matrix, np.diag(masses_kg))
    is_rigid = omega_squared < 1e-9 * omega_squared[-1]  # rounding would give a free row a frequency
    natural_hz = np.sqrt(np.where(is_rigid, 0.0, omega_squared)) / (2 * np.pi)
    positions_m = np.arange(1.0, len(masses_kg) + 1)
    return structure_of(name, positions_m[-1], natural_hz, np.where(is_rigid, 0.0, damping_ratio), positions_m, shapes)
