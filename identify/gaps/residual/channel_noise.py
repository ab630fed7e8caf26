"""Noise of a recording's channels: of the forces, and of the sensors each in its own unit."""

import numpy as np
from jaxtyping import Float
from scipy.signal import periodogram

from identify.contacts.separation import is_unforced
from identify.signals.kinematics import Kinematics
from identify.signals.noise import heard_density, least_density
from rig.model.description import Sensor
from rig.model.sensing import PASSBAND
from rig.model.tolerances import Tolerances
from rig.recording import Recording


def force_noise_n(motion: Kinematics, tolerances: Tolerances) -> Float[np.ndarray, " forces"]:
    """Standard deviation of each force channel's noise: heard in the quiet start, else as the tolerances state it.

    None of a free decay, in which no force acts.
    """
    if motion.quiet_samples and not is_unforced(motion):
        return np.asarray(np.std(motion.forces_n[:, : motion.quiet_samples], axis=1))
    stated_n = tolerances.force_noise_density * np.sqrt(motion.sample_rate_hz / 2)
    return np.full(len(motion.forces_n), 0.0 if is_unforced(motion) else stated_n)


def sensor_densities(
    recording: Recording, sensors: tuple[Sensor, ...], motion: Kinematics
) -> Float[np.ndarray, " sensors"]:
    """One-sided noise of each sensor in its own unit per sqrt(Hz): heard in the quiet start, else in the record.

    In a quiet start the median over the frequencies tells it: a motor that runs, or a floor that shakes, raises some of
    them only. That of powers which are distributed exponentially is ln 2 of their mean. Of what the record tells
    without one, the description is believed where it says less and the record does not surely show noise.
    """
    rate_hz, densities = motion.sample_rate_hz, []
    for sensor in sensors:
        row = recording.values_of(sensor)
        if motion.quiet_samples:
            hz, power = periodogram(row[: motion.quiet_samples], rate_hz, "hann")
            inner = (hz > 0) & (hz < PASSBAND * rate_hz)
            density = float(np.sqrt(np.median(power[inner]) / np.log(2)))
        else:
            density, surely = heard_density(row, rate_hz)
            density = density if surely else min(density, sensor.noise_density)
        densities.append(max(density, least_density(row, rate_hz)))
    return np.array(densities)
