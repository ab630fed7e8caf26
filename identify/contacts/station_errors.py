"""Errors of the stations, line by line, and what each of them adds to every contact force."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.linear.nuisance import Change
from identify.linear.projection import to_free_inputs
from rig.errors import RigError

CHUNK = 1024
"""Lines that are worked on at once."""
LEAST = 1e-9
"""No station is believed to err less, of the mean variance."""
CONDITION = 1e12
"""Of the normal equations: contact forces are told apart up to this condition number."""


@dataclass(frozen=True)
class StationErrors:
    """The sensors' noise (variance of each line), no less than a floor, and what every tolerance does at the response
    that was measured. So many neighbouring lines are taken to be alike."""

    noise: Float[np.ndarray, "stations lines"]
    floor: float
    changes: tuple[Change, ...]
    alike: int

    def covariance(self, begin: int, end: int) -> Complex[np.ndarray, "some stations stations"]:
        """Covariance on the lines from `begin` to before `end`."""
        stations, lines = self.noise.shape
        first, last = max(begin - self.alike, 0), min(end + self.alike, lines)
        inner = slice(begin - first, end - first)
        found = np.zeros((stations, stations, end - begin), dtype=complex)
        index = np.arange(stations)
        found[index, index] = self.noise[:, begin:end] + max(LEAST * self._mean, self.floor)
        for change in self.changes:
            rows, delivered = np.array(change.sensors), change.delivered[:, first:last]
            products = uniform_filter1d(delivered[:, None] * delivered[None].conj(), self.alike, axis=-1)
            found[rows[:, None], rows[None]] += products[..., inner]
        return np.ascontiguousarray(np.transpose(found, (2, 0, 1)))

    @cached_property
    def _mean(self) -> float:
        """Mean of the variance over stations and lines."""
        changed = sum(np.linalg.norm(change.delivered) ** 2 for change in self.changes)
        return float(np.sum(self.noise) + changed) / self.noise.size

    def parts(self, begin: int = 0) -> Iterator[tuple[slice, Complex[np.ndarray, "_ stations stations"]]]:
        """The covariance chunk by chunk of all lines from `begin` on."""
        lines = self.noise.shape[1]
        for first in range(begin, lines, CHUNK):
            last = min(first + CHUNK, lines)
            yield slice(first, last), self.covariance(first, last)


def forces_by_stations(
    by_contacts: Complex[np.ndarray, "contacts stations lines"], errors: StationErrors
) -> Complex[np.ndarray, "contacts stations lines"]:
    """Contact forces by each station's A - G_F F, line by line, with its accelerations by each force.

    Raises RigError if the stations cannot tell the contact forces apart.
    """
    to_contacts, condition = to_free_inputs(by_contacts, errors.parts())
    if not condition <= CONDITION:
        raise RigError("the sensors cannot tell the contact forces apart; measure more stations on the bodies")
    return to_contacts
