"""Observed motion as spectra: modal accelerations of a body, of a shaken base, and across a sensor's direction."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float, Int

from identify.linear.model import Response
from rig.model.description import Sensor


@dataclass(frozen=True)
class BodyMotion:
    """Modes of a body and the accelerations of the first of them; the others are taken to rest.

    elastic_indices are the modes with parameters of their own, from 0. Where sensor_weights are known, the
    accelerations of the first modes are those of all sensors times these, plus contributions of the model.
    """

    response: Response
    acceleration: Complex[np.ndarray, "modes lines"]
    elastic_indices: Int[np.ndarray, " some"]
    sensor_weights: Float[np.ndarray, "lowest sensors"] | None = None

    @property
    def moving_modes(self) -> slice:
        """Modes that do not rest."""
        return slice(len(self.acceleration))


@dataclass(frozen=True)
class ObservedBase:
    """Spectra of a base that sensors measure: its acceleration and displacement, and the accelerations of the stations
    against it that it causes."""

    sensor: Sensor
    displacement_sensor: Sensor
    acceleration: Complex[np.ndarray, " lines"]
    displacement: Complex[np.ndarray, " lines"]
    station_accelerations: Complex[np.ndarray, "sensors lines"]

    @property
    def at_rest(self) -> "ObservedBase":
        """The same base at rest."""
        return replace(
            self,
            acceleration=0 * self.acceleration,
            displacement=0 * self.displacement,
            station_accelerations=0 * self.station_accelerations,
        )


@dataclass(frozen=True)
class ObservedTransverse:
    """Signals and displacements, at the places of some sensors, of the motion in the other direction of a rig in
    space."""

    sensors: list[int]
    signals: Complex[np.ndarray, "some lines"]
    displacements: Complex[np.ndarray, "some lines"]

    @property
    def at_rest(self) -> "ObservedTransverse":
        """The same places without motion across."""
        return replace(self, signals=0 * self.signals, displacements=0 * self.displacements)
