"""One body of a linear model: its modes, and how its motion at some places follows from that at others."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Complex, Float

from identify.signals.kinematics import CORNER_HZ, integrated
from identify.structure.modal import receptance
from rig.model.description import Body, Station
from rig.model.modes import Modes


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Modes on the lines of a record; one object for the same modes, so that products of theirs are kept.

    The springs of so many of the lowest act on the high-passed displacement alone.
    """

    natural_hz: Float[np.ndarray, " modes"]
    damping_ratios: Float[np.ndarray, " modes"]
    omega: Float[np.ndarray, " lines"]
    high_passed: int


@dataclass(frozen=True)
class Response:
    """One body's modes, and their accelerations per modal force."""

    body: Body
    modes: Modes
    count: int
    dynamics: Dynamics

    @property
    def accelerance(self) -> Complex[np.ndarray, "modes lines"]:
        return _accelerance(self.dynamics)

    def shapes(self, stations: Sequence[Station | None]) -> Float[np.ndarray, "stations modes"]:
        """Zero at stations of other bodies and at the ground."""
        found = np.zeros((len(stations), self.count))
        own = [(i, s.position_m) for i, s in enumerate(stations) if s is not None and s.body == self.body.name]
        if own:
            rows, places = zip(*own, strict=True)
            found[list(rows)] = self.modes.shapes(np.array(places), self.count)
        return found

    def transfer(
        self, outputs: Float[np.ndarray, "outputs modes"], inputs: Float[np.ndarray, "inputs modes"]
    ) -> Complex[np.ndarray, "inputs outputs lines"]:
        """Accelerations along some shapes per force along others: sum over the modes of output, accelerance and input.

        Kept, as most effects change one body at most.
        """
        return _transfer(self.dynamics, outputs.tobytes(), inputs.tobytes())


@lru_cache(maxsize=16)
def dynamics_of(natural_hz: bytes, damping_ratios: bytes, omega_rad_per_s: bytes, high_passed: int) -> Dynamics:
    """Of the modes whose doubles are given."""
    hz, zeta, omega = (np.frombuffer(values) for values in (natural_hz, damping_ratios, omega_rad_per_s))
    return Dynamics(hz, zeta, omega, high_passed)


@lru_cache(maxsize=4)
def _accelerance(modes: Dynamics) -> Complex[np.ndarray, "modes lines"]:
    hz, zeta, omega = modes.natural_hz, modes.damping_ratios, modes.omega
    found = -(omega**2) * receptance(hz, zeta, omega / (2 * np.pi))
    for mode in range(modes.high_passed):
        natural = 2 * np.pi * hz[mode]
        held = natural**2 * integrated(omega, -2, CORNER_HZ)
        found[mode] = 1 / (1 + held + 2 * zeta[mode] * natural * integrated(omega, -1, CORNER_HZ))
    found[hz == 0] = 1.0
    found.flags.writeable = False
    return found


@lru_cache(maxsize=8)
def _transfer(dynamics: Dynamics, outputs: bytes, inputs: bytes) -> Complex[np.ndarray, "inputs outputs lines"]:
    accelerance = _accelerance(dynamics)
    modes, lines = accelerance.shape
    to, by = (np.frombuffer(shapes).reshape(-1, modes) for shapes in (outputs, inputs))
    found = times((by[:, None, :] * to[None]).reshape(-1, modes), accelerance)
    found.flags.writeable = False
    return found.reshape(len(by), len(to), lines)


def weights_of(
    response: Response, places: list[Station | None], stations: list[Station | None]
) -> Float[np.ndarray, "stations sensors"]:
    """From the body's sensors to other places on it, by as many of its modes as it has sensors."""
    rows = [i for i, place in enumerate(places) if place is not None and place.body == response.body.name]
    weights = np.zeros((len(stations), len(places)))
    if rows:
        modes = min(len(rows), response.count)
        inverse = np.linalg.pinv(response.shapes([places[i] for i in rows])[:, :modes])
        weights[:, rows] = response.shapes(stations)[:, :modes] @ inverse
    return weights


def times(
    real: Float[np.ndarray, "rows inner"], spectra: Complex[np.ndarray, "inner lines"]
) -> Complex[np.ndarray, "rows lines"]:
    """The product, without taking the real factor as complex: twice as fast."""
    return np.asarray((real @ np.ascontiguousarray(spectra).view(float)).view(complex))
