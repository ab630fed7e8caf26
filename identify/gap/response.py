"""One body of a linear model: its modes, and how its motion at some places follows from that at others."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from rig.description import Body, Station
from rig.modes import Modes


@dataclass(frozen=True)
class Response:
    """One body's modes, and their accelerations per modal force."""

    body: Body
    modes: Modes
    count: int
    accelerance: Complex[np.ndarray, "modes lines"]

    def shapes(self, stations: list[Station | None]) -> Float[np.ndarray, "stations modes"]:
        """Zero at stations of other bodies and at the ground."""
        own = np.array([s is not None and s.body == self.body.name for s in stations], dtype=float)
        places = [s.position_m if s is not None and here else 0.0 for s, here in zip(stations, own, strict=True)]
        return np.asarray(self.modes.shapes(np.array(places), self.count) * own[:, None])


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
