"""Extent of a recording that the diagnosis reads: its sensors and their noise, the start and end of the samples that
count, and the highest frequency."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import periodogram

from identify.contacts.separation import highest_excitation_hz
from identify.gaps.residual.ringing import highest_hz_of_any_segment, highest_ringing_hz
from identify.gaps.residual.shaken_base import body_sensors, common_sensor_quantity
from identify.signals.beginning import QUIET_S, excitation_start
from identify.signals.kinematics import CORNER_HZ, kinematics
from identify.signals.noise import noise_density_and_certainty, rounding_noise_density
from identify.signals.spectra import force_band_hz
from rig.errors import RigError
from rig.model.description import Rig, Sensor, contact_stations
from rig.model.modes import modes_of
from rig.model.sensing import PASSBAND
from rig.model.tolerances import Tolerances
from rig.recording import Recording

FADE_LENGTH_S = 0.5
"""Length of the fade at either end of a record. Set by hand."""
OMITTED_EDGE_S, OMITTED_SHARE = 4.5, 0.45
"""Seconds omitted at a record's end, where taper and integration distort residuals, and their largest share of it. Set
by hand."""
OMITTED_FADES, FADE_SHARE = 1.5, 0.1
"""Part omitted at a faded end without integration, and at a faded start where nothing rings, in lengths of the fade;
and the largest share of a record that is a fade. Set by hand."""
OMITTED_RELEASE_S = 2.0
"""Seconds omitted at the start of a decay of floating elastic bodies between contacts, as the separated forces of two
beams are wrong by many times the noise in its first half second. Set by hand."""
QUIET_MARGIN_S = 0.05
"""Time before the force at which a quiet start ends."""
SIGNAL_TO_NOISE_RATIO, CORNER_SHARE = 100.0, 0.25
"""Mean power of a sensor over that of its noise from which a half octave is integrated; and the highest corner of the
integration, as a share of the lowest natural frequency. Set by hand: noise in a law's argument biases the law, motion
that is missing in it hardly does (errors in variables of the classical kind and of Berkson's)."""
FORCE_BAND_RATIO = 1.6
"""Highest frequency of the diagnosis, as a multiple of the force's highest frequency. Set by hand: impacts excite
beyond the force."""
POWER_BAND_RATIO, POWER_SHARE = 2.0, 0.9
"""Its bound, as a multiple of the frequency below which this share of the force's power lies: that of a hammer falls
slowly with frequency. Set by hand: above 1.6/0.9, so it binds for blows alone, whose power falls slowly: 0.31 kHz of
half-sines of 5 ms, not 0.88."""
SHORTEST_RECORD_S, SHORTEST_UNCUT_S = 10.0, 1.0
"""Shortest record; the second for one that counts from its first sample and is not integrated. Set by hand."""
DECAYED_SHARE, LEAST_COUNTED_S = 0.03, 4.0
"""Share of the loudest second's acceleration below which a record ends, and the least time that counts: accelerometers
do not show contacts of a rig at rest. Set by hand: later the slow motion of a floating body is not known to its
clearance."""


def diagnosis_sensors(recording: Recording) -> tuple[Sensor, ...]:
    """Sensors of the quantity that the diagnosis reads: accelerations, else velocities, else displacements; in reverse
    order for a record without a force; those on bodies of the quantity that a shaken base has, too.

    Raises RigError if there are no sensors of motion.
    """
    sensors = body_sensors(recording.rig)
    if not sensors:
        raise RigError("the recording has no sensors of motion; the diagnosis needs them, best accelerometers")
    highest_or_lowest = max if np.any(recording.forces_n) else min
    quantity = (
        common_sensor_quantity(recording.rig) or highest_or_lowest(sensors, key=lambda s: s.measures.order).quantity
    )
    return tuple(sensor for sensor in sensors if sensor.quantity == quantity)


@dataclass(frozen=True)
class RecordBeginning:
    """Start of a record, and whether its signals are integrated.

    zero_known: displacements are measured. integrates: relative displacements at contacts follow from velocities or
    accelerations. fits_initial_state: a free motion whose initial state is estimated. all_free: all bodies are
    unsupported masses, so that nothing rings. floats_in_contacts: contacts alone hold an elastic body.
    excitation_start_sample is the first sample at which a force acts; the quiet samples before it determine the noise.
    """

    zero_known: bool
    has_contacts: bool
    integrates: bool
    fits_initial_state: bool
    all_free: bool
    floats_in_contacts: bool
    excitation_start_sample: int
    quiet_sample_count: int
    fade_length_s: float
    duration_s: float

    @property
    def starts_quiet(self) -> bool:
        """True if the record starts with quiet samples."""
        return self.quiet_sample_count > 0

    @property
    def omitted_s(self) -> tuple[float, float]:
        """Seconds omitted at the start and at the end."""
        omitted_end_s = OMITTED_FADES * self.fade_length_s
        if not self.all_free and (self.has_contacts or not self.fits_initial_state):  # the end rings on
            omitted_end_s = min(OMITTED_EDGE_S, OMITTED_SHARE * self.duration_s)
        if self.starts_quiet:
            return 0.0, omitted_end_s
        if self.fits_initial_state:
            return OMITTED_RELEASE_S * self.floats_in_contacts, omitted_end_s
        return omitted_end_s if self.all_free else OMITTED_EDGE_S, omitted_end_s


def beginning_of(recording: Recording, sensors: tuple[Sensor, ...]) -> RecordBeginning:
    """Start of a recording as given sensors show it."""
    rig, rate_hz = recording.rig, recording.rig.sample_rate_hz
    zero_known = all(sensor.measures.order == 0 for sensor in sensors)
    has_contacts = bool(rig.contacts)
    is_integrated = has_contacts and not zero_known
    start_sample = excitation_start(recording.forces_n, (recording.values_of(sensor) for sensor in sensors), rate_hz)
    sample_count_before = start_sample - round(QUIET_MARGIN_S * rate_hz)
    fits_initial_state = not np.any(recording.forces_n) and not is_integrated
    fade_length_s = 2 * FADE_LENGTH_S if zero_known and not fits_initial_state else FADE_LENGTH_S
    return RecordBeginning(
        zero_known=zero_known,
        has_contacts=has_contacts,
        integrates=is_integrated,
        fits_initial_state=fits_initial_state,
        all_free=zero_known and all(is_free_mass(rig, body.name) for body in rig.bodies),
        floats_in_contacts=floats_in_contacts(rig),
        excitation_start_sample=start_sample,
        quiet_sample_count=sample_count_before if sample_count_before > QUIET_S * rate_hz else 0,
        fade_length_s=fade_length_s if has_contacts else min(fade_length_s, FADE_SHARE * recording.duration_s),
        duration_s=recording.duration_s,
    )


def check_length(recording: Recording, beginning: RecordBeginning) -> None:
    """Check a record's length; raises RigError if it is too short."""
    is_uncut = not beginning.has_contacts and (beginning.starts_quiet or beginning.fits_initial_state)
    shortest_s = SHORTEST_UNCUT_S if is_uncut else SHORTEST_RECORD_S
    if recording.duration_s < shortest_s:
        raise RigError(
            f"the record lasts {recording.duration_s:.3g} s; the diagnosis needs {shortest_s:g} s, better "
            f"{'some' if is_uncut else '30'} s or more"
        )


def highest_diagnosed_hz(
    recording: Recording,
    sensors: tuple[Sensor, ...],
    noise_densities: Float[np.ndarray, " sensors"],
    tolerances: Tolerances,
) -> float:
    """Highest frequency of the diagnosis, Hz; raises RigError if nothing above `CORNER_HZ` is excited."""
    rate_hz = recording.rig.sample_rate_hz
    if np.any(recording.forces_n):
        excited_hz = _excited_hz(recording.forces_n, rate_hz)
    elif floats_in_contacts(recording.rig) or (recording.rig.contacts and sensors[0].measures.order):
        excited_hz = FORCE_BAND_RATIO * highest_excitation_hz(kinematics(recording, sensors[0].quantity, least_order=0))
    else:
        signals = np.stack([recording.values_of(sensor) for sensor in sensors])
        if recording.rig.contacts:
            highest_shown_hz = highest_hz_of_any_segment(signals, rate_hz, noise_densities)
        else:
            highest_shown_hz = highest_ringing_hz(signals, rate_hz, sensors[0].measures.order, noise_densities)
        excited_hz = FORCE_BAND_RATIO * highest_shown_hz
    highest_hz = min(excited_hz, PASSBAND * rate_hz, tolerances.highest_hz or np.inf)
    if highest_hz <= CORNER_HZ:
        raise RigError(
            f"the force excites the rig up to {highest_hz:.2g} Hz alone; the diagnosis needs more than {CORNER_HZ:g} "
            "Hz: look at the force's channel"
        )
    return highest_hz


def _excited_hz(forces_n: Float[np.ndarray, "forces samples"], rate_hz: float) -> float:
    """Highest frequency to which forces excite the rig, Hz."""
    return max(
        min(
            FORCE_BAND_RATIO * force_band_hz(n, rate_hz)[1],
            POWER_BAND_RATIO * force_band_hz(n, rate_hz, 1 - POWER_SHARE)[1],
        )
        for n in forces_n
        if np.any(n)
    )


def integration_corner_hz(
    rig: Rig,
    omega: Float[np.ndarray, " lines"],
    sensor_power: Float[np.ndarray, "sensors lines"],
    noise_power: Float[np.ndarray, " sensors"],
) -> float:
    """Corner of the high-pass under integration, Hz, for a rig without contacts.

    It is raised from `CORNER_HZ` by half octaves in which no sensor shows `SIGNAL_TO_NOISE_RATIO` times its noise, up
    to `CORNER_SHARE` of the lowest natural frequency. Noise integrated twice grows as omega^-2, and a law of the
    displacement that is fitted to it is biased: a cubic spring on a beam of 12 Hz came out half as strong.
    """
    lowest_natural_hz = np.inf
    for body in rig.bodies:
        natural_hz = modes_of(rig, body).frequencies_hz(body.max_modes)
        lowest_natural_hz = min(lowest_natural_hz, float(np.min(natural_hz[natural_hz > 0], initial=np.inf)))
    lines_hz, corner_hz = omega / (2 * np.pi), CORNER_HZ
    while (next_corner_hz := corner_hz * np.sqrt(2)) < CORNER_SHARE * lowest_natural_hz:
        is_in_half_octave = (lines_hz >= corner_hz) & (lines_hz < next_corner_hz)
        if not is_in_half_octave.any():
            break
        if np.any(sensor_power[:, is_in_half_octave].mean(axis=1) > SIGNAL_TO_NOISE_RATIO * noise_power):
            break
        corner_hz = float(next_corner_hz)
    return corner_hz


def is_free_mass(rig: Rig, body_name: str) -> bool:
    """True if a body is an unsupported mass."""
    body = rig.body(body_name)
    support_stations = [spring.station for spring in rig.springs]
    support_stations += [station for contact in rig.contacts for station in contact_stations(contact)]
    return body.is_mass and bool(body.rigid_modes) and all(station.body != body_name for station in support_stations)


def floats_in_contacts(rig: Rig) -> bool:
    """True if contacts alone hold an elastic body."""
    return bool(rig.contacts) and any(body.rigid_modes and not body.is_mass for body in rig.bodies)


def end_of_motion_s(accelerations: Float[np.ndarray, "sensors times"], rate_hz: float) -> float:
    """End of the last second with motion, s; inf for the whole record. Raises RigError if the sensors show none."""
    samples_per_second = max(1, round(min(1.0, accelerations.shape[1] / rate_hz / 4) * rate_hz))
    second_count = accelerations.shape[1] // samples_per_second
    power_by_sample = (accelerations[:, : second_count * samples_per_second] ** 2).sum(axis=0)
    power_by_second = power_by_sample.reshape(second_count, samples_per_second).mean(axis=1)
    moving_seconds = np.flatnonzero(power_by_second > DECAYED_SHARE**2 * power_by_second.max())
    if not moving_seconds.size:
        raise RigError("the sensors show no motion; look at their channels")
    end_second = int(moving_seconds[-1]) + 1
    return np.inf if end_second == second_count else end_second * samples_per_second / rate_hz


def force_noise_n(recording: Recording, quiet_samples: int, tolerances: Tolerances) -> Float[np.ndarray, " forces"]:
    """Standard deviation of each force channel's noise, N: from the quiet start, else from the tolerances.

    Zero in a free decay, in which no force acts, and of a shaken base, whose sensor has noise of its own.
    """
    forces_n = recording.forces_n
    if not np.any(forces_n) or recording.rig.base_sensors:
        return np.zeros(len(forces_n))
    if quiet_samples:
        return np.asarray(np.std(forces_n[:, :quiet_samples], axis=1))
    stated_noise_n = tolerances.force_noise_density * np.sqrt(recording.rig.sample_rate_hz / 2)
    return np.full(len(forces_n), stated_noise_n)


def sensor_noise_densities(
    recording: Recording, sensors: tuple[Sensor, ...], quiet_sample_count: int
) -> Float[np.ndarray, " sensors"]:
    """One-sided noise density of each sensor in its own unit per sqrt(Hz), from the quiet start, else from the record.

    The quiet start gives the median power over frequency, as a running motor or a shaking floor raises part of it only;
    the median of an exponential distribution is ln 2 times its mean. The record's own estimate is limited to the
    described noise unless it is certain, or unless it is a free decay, between whose sharp modes the noise shows.
    """
    rate_hz, is_free_decay, noise_densities = recording.rig.sample_rate_hz, not np.any(recording.forces_n), []
    for sensor in sensors:
        signal = recording.values_of(sensor)
        if quiet_sample_count:
            line_hz, power_density = periodogram(signal[:quiet_sample_count], rate_hz, "hann")
            is_in_band = (line_hz > 0) & (line_hz < PASSBAND * rate_hz)
            noise_density = float(np.sqrt(np.median(power_density[is_in_band]) / np.log(2)))
        else:
            noise_density, is_certain = noise_density_and_certainty(signal, rate_hz)
            noise_density = noise_density if is_certain or is_free_decay else min(noise_density, sensor.noise_density)
        noise_densities.append(max(noise_density, rounding_noise_density(signal, rate_hz)))
    return np.array(noise_densities)
