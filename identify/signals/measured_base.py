"""Measured motion of a shaken base: the stations then move relative to it, and its acceleration is an input.

In coordinates relative to a base of the acceleration a_base, a body feels the inertial force -a_base on each kilogram,
and contacts with the ground act on its displacement. Sensors on the body measure the sum of both motions.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from rig.model.description import Rig, Sensor
from rig.recording import Recording


@dataclass(frozen=True)
class MeasuredBase:
    """Motion of the base by the sensors on it; `sensor` is that of the acceleration, `displacement_sensor` that of the
    displacement, which may be left out. lost_m_per_s2 is the slow part of the acceleration that an integrated
    displacement lacks."""

    sensor: Sensor
    displacement_sensor: Sensor
    displacement_m: Float[np.ndarray, " _"]
    acceleration_m_per_s2: Float[np.ndarray, " samples"]
    lost_m_per_s2: Float[np.ndarray, " samples"]

    def segment(self, sample_slice: slice) -> "MeasuredBase":
        """Motion over a slice of the samples."""
        return replace(
            self,
            displacement_m=self.displacement_m[sample_slice],
            acceleration_m_per_s2=self.acceleration_m_per_s2[sample_slice],
            lost_m_per_s2=self.lost_m_per_s2[sample_slice],
        )


def excitations(recording: Recording) -> Float[np.ndarray, "excitations samples"]:
    """Signals that excite a rig, as recorded: the forces on bodies, and what the sensors on a shaken base deliver."""
    rig = recording.rig
    if not rig.base_sensors:
        return recording.forces_n
    return np.stack([*forces_on_bodies(recording), *(recording.values_of(sensor) for sensor in rig.base_sensors)])


def excitation_names(rig: Rig) -> tuple[str, ...]:
    """Channels of the `excitations`."""
    return (*rig.force_names[: body_force_count(rig)], *(sensor.name for sensor in rig.base_sensors))


def forces_on_bodies(recording: Recording) -> Float[np.ndarray, "forces samples"]:
    """Measured forces on bodies, N; none where the base alone shakes the rig."""
    return recording.forces_n[: body_force_count(recording.rig)]


def body_force_count(rig: Rig) -> int:
    """Number of the measured forces on bodies, which come first among the inputs of a rig."""
    return len(rig.inputs) - bool(rig.base_sensors)
