"""Channels of a recording: the sensors that the diagnosis reads, and the noise of forces and sensors."""

import numpy as np
from jaxtyping import Float
from scipy.signal import periodogram

from identify.signals.noise import heard_density, least_density
from rig.errors import RigError
from rig.model.description import Sensor
from rig.model.sensing import PASSBAND, sensors_of
from rig.model.tolerances import Tolerances
from rig.recording import Recording


def read_sensors(recording: Recording) -> tuple[Sensor, ...]:
    """The sensors of the quantity that the diagnosis reads: accelerations, without any velocities or else
    displacements; where no force was measured the other way round.

    Raises RigError if there are no sensors of motion.
    """
    moving = [s for s in recording.rig.sensors if s.measures.translates]
    if not moving:
        raise RigError("the recording has no sensors of motion; the diagnosis needs them, best accelerometers")
    first = max if np.any(recording.forces_n) else min
    return sensors_of(recording.rig, first(moving, key=lambda s: s.measures.order).quantity)


def force_noise_n(recording: Recording, quiet_samples: int, tolerances: Tolerances) -> Float[np.ndarray, " forces"]:
    """Standard deviation of each force channel's noise: heard in the quiet start, else as the tolerances state it.

    None of a free decay, in which no force acts.
    """
    forces_n = recording.forces_n
    if not np.any(forces_n):
        return np.zeros(len(forces_n))
    if quiet_samples:
        return np.asarray(np.std(forces_n[:, :quiet_samples], axis=1))
    stated_n = tolerances.force_noise_density * np.sqrt(recording.rig.sample_rate_hz / 2)
    return np.full(len(forces_n), stated_n)


def sensor_densities(
    recording: Recording, sensors: tuple[Sensor, ...], quiet_samples: int
) -> Float[np.ndarray, " sensors"]:
    """One-sided noise of each sensor in its own unit per sqrt(Hz): heard in the quiet start, else in the record.

    In a quiet start the median over the frequencies tells it: a motor that runs, or a floor that shakes, raises some of
    them only. That of powers which are distributed exponentially is ln 2 of their mean. Of what the record tells
    without one, the description is believed where it says less and the record does not surely show noise. Not of a free
    decay, whose sharp modes leave the noise between them bare.
    """
    rate_hz, decays, densities = recording.rig.sample_rate_hz, not np.any(recording.forces_n), []
    for sensor in sensors:
        row = recording.values_of(sensor)
        if quiet_samples:
            hz, power = periodogram(row[:quiet_samples], rate_hz, "hann")
            inner = (hz > 0) & (hz < PASSBAND * rate_hz)
            density = float(np.sqrt(np.median(power[inner]) / np.log(2)))
        else:
            density, surely = heard_density(row, rate_hz)
            density = density if surely or decays else min(density, sensor.noise_density)
        densities.append(max(density, least_density(row, rate_hz)))
    return np.array(densities)
