"""First stage, separation: motion and contact forces of a recording, without assuming a law, and the contact records
that are fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.signal import welch

from identify.checks.masses import mass_pull
from identify.contacts.contact_record import ContactRecord
from identify.contacts.forces import ContactForces, separated_forces
from identify.contacts.gauges import Gauges, gauges_and_motion_of
from identify.contacts.observation import RINGING_S, SeparationInput
from identify.contacts.refusals import RefusalCode, RemedyCode, refused
from identify.contacts.station_spectra import start_transient_s
from identify.linear.joined import ContactGroup, contact_groups, rig_with_joined_contacts
from identify.linear.modal import signals_across_contacts
from identify.linear.nuisance import NuisanceKind
from identify.signals.drift import HIGHEST_DRIFT_HZ, SLOW_DRIFT_HZ, DriftPrior, spline
from identify.signals.kinematics import Kinematics, MotionQuantity, kinematics
from identify.signals.noise import NOISE_BAND_RATE_SHARES, acceleration_noise_m_per_s2, displacement_noise
from identify.signals.spectra import decimated, force_band_hz, oversampled
from rig.model.description import ForceSensor, Rig, Station, contact_stations
from rig.model.modes import with_attachments_merged
from rig.model.tolerances import Tolerances
from rig.recording import Recording

FORCE_BAND_RATIO = 4.0
"""Highest frequency of the separated contact forces over that of the exciting force."""
LEAST_FORCE_BAND_HZ = 64.0
"""Least highest frequency of the separated contact forces where strain gauges show slow ones: at both ends of a record
the low-pass rings over some periods of its corner, by what the force has there."""
LEAST_NOISE_DENSITY = 1e-5
"""Least noise of an accelerometer, m/s^2/sqrt(Hz): below it other errors than noise make the drift."""
EDGE_SAMPLES = 32
"""Samples at the end of a force, at most an eighth, that are not fitted: a low-passed law lacks what follows there."""
LEAST_RECORD_S = 1.0
"""Least usable length of a record."""
WELCH_SEGMENT_S, NOISE_POWER_RATIO = 1.0, 4.0
"""Length of Welch's segments, and power over that of the noise that counts as motion."""
ROUNDING_SHARE = 1e-7
"""Least noise of a contact force over the exciting force: less is rounding, in a record without noise."""
UNMODELLED_FIELDS = ("loads", "base_motion", "force_sensor", "dampers", "tones")
"""Fields of a rig that the linear model of the identification leaves out; so it does the cubic part of springs."""


@dataclass(frozen=True)
class Separation:
    """Measured motion of a rig, and the contact forces that follow from it.

    forces and records have one entry for each pair of places, whose contacts are in contact_groups. mass_pull is how
    many tolerances the mass of a rig's single mass is off while its contacts are open.
    """

    rig: Rig
    motion: Kinematics
    forces: ContactForces
    contact_groups: tuple[ContactGroup, ...]
    records: tuple[ContactRecord, ...]
    mass_pull: float


def separate(recording: Recording, use: MotionQuantity, tolerances: Tolerances) -> Separation:
    """Contact forces of a recording, without assuming a law.

    The first seconds of a segment of a longer record, in which the beams ring of what was before, are left out.

    Raises RigError if the record allows nothing: too short, too few stations, no force, no contacts described.
    """
    (separation,) = separate_planes((recording,), use, tolerances)
    return separation


def separate_planes(
    recordings: Sequence[Recording], use: MotionQuantity, tolerances: Tolerances
) -> tuple[Separation, ...]:
    """Contact forces of one record in each of its directions, as `separate`, with one start and one band for all.

    The band is that of the forces; of the motion where no force acts. The shakers of one direction move the others.
    """
    gauges_and_motions = [gauges_and_motion_of(recording, use, kinematics(recording, use)) for recording in recordings]
    driven_motions = [motion for _, motion in gauges_and_motions if not is_unforced(motion)]
    if driven_motions:
        highest_hz = max(map(highest_excitation_hz, driven_motions))
    else:
        highest_hz = max(highest_vibration_hz(motion) for _, motion in gauges_and_motions)
    excited_from = min((motion.excited_from for motion in driven_motions), default=0)
    transverse_motions = [motion for _, motion in gauges_and_motions[::-1]] if len(gauges_and_motions) > 1 else [None]
    separations = []
    for recording, (gauges, motion), transverse in zip(recordings, gauges_and_motions, transverse_motions, strict=True):
        motion_in_space = replace(motion, excited_from=excited_from, transverse=transverse)
        separations.append(_separated(recording, gauges, motion_in_space, highest_hz, tolerances))
    return tuple(separations)


def _separated(
    recording: Recording, gauges: Gauges, motion: Kinematics, highest_excited_hz: float, tolerances: Tolerances
) -> Separation:
    """Contact forces of a recording that is excited up to that frequency."""
    rig, least_band_end_hz = recording.rig, LEAST_FORCE_BAND_HZ if gauges.sensors else 0.0
    band_end_hz = min(max(FORCE_BAND_RATIO * highest_excited_hz, least_band_end_hz), motion.trusted_hz[1])
    noise_m_per_s2, group_rig = acceleration_noise_m_per_s2(motion, rig), rig_with_joined_contacts(rig)
    begins_at_rest = recording.start_s > 0 or motion.excited_from > 0
    if motion.zero_known:
        _check_displacement_observable(rig, motion)
    rig_mass_pull = mass_pull(rig, motion, tolerances)
    forces = separated_forces(
        SeparationInput(
            rig=group_rig,
            motion=motion,
            decimation=max(1, int(motion.sample_rate_hz / 2 / band_end_hz)),
            noise_m_per_s2=noise_m_per_s2,
            displacement_noise=displacement_noise(motion, rig),
            tolerances=tolerances,
            gauges=gauges,
            begins_at_rest=begins_at_rest,
        )
    )
    if forces.slow_motion:
        motion = forces.slow_motion.added_to(motion)
        _check_displacement_observable(rig, motion)
    if recording.start_s > 0 or not begins_at_rest:
        motion, forces = _without_start(recording, group_rig, motion, forces, begins_at_rest)
    records = _contact_records(group_rig, motion, noise_m_per_s2, forces, tolerances)
    return Separation(rig, motion, forces, contact_groups(rig), records, rig_mass_pull)


def separate_if_rig_is_modelled(recording: Recording, use: MotionQuantity, tolerances: Tolerances) -> Separation:
    """Contact forces of a recording of which rig.json has no more than the linear model knows. Masses, linear springs,
    supports and clamps are part of the bodies of the separation's rig (`rig.model.modes.condensed`).

    Raises RigError as `separate`, and if rig.json has more.
    """
    check_rig_is_modelled(recording.rig)
    return separate(replace(recording, rig=with_attachments_merged(recording.rig)), use, tolerances)


def is_unforced(motion: Kinematics) -> bool:
    """True if the exciting force is zero throughout, as in a free decay after a release or an unmeasured blow."""
    return not np.any(motion.forces_n)


def highest_excitation_hz(motion: Kinematics) -> float:
    """Highest frequency, Hz, of the exciting force or, without one, of the displacements.

    Raises ContactRefusedError if neither a force nor a motion was recorded.
    """
    driven_signals = [row for row in (motion.displacement_m if is_unforced(motion) else motion.forces_n) if np.any(row)]
    if not driven_signals:
        raise refused(RefusalCode.ALL_ZERO)
    return max(force_band_hz(row, motion.sample_rate_hz)[1] for row in driven_signals)


def highest_vibration_hz(motion: Kinematics) -> float:
    """Highest frequency, Hz, at which the displacements of a record without a force exceed the noise, which is taken
    from the highest frequencies. By windowed segments, as a record that begins in motion would leak.

    Raises ContactRefusedError if no motion was recorded.
    """
    highest_moving_hz = highest_excitation_hz(motion)
    displacements_m = motion.displacement_m[np.any(motion.displacement_m, axis=1)]
    segment_samples = min(motion.sample_count, round(WELCH_SEGMENT_S * motion.sample_rate_hz))
    line_hz, density = welch(displacements_m, motion.sample_rate_hz, nperseg=segment_samples)
    noise_low_hz, noise_high_hz = (share * motion.sample_rate_hz for share in NOISE_BAND_RATE_SHARES)
    noise_power = np.median(density[:, (line_hz > noise_low_hz) & (line_hz < noise_high_hz)], axis=1, keepdims=True)
    exceeds_noise = density > NOISE_POWER_RATIO * noise_power
    highest_hz = line_hz[density.shape[1] - 1 - np.argmax(exceeds_noise[:, ::-1], axis=1)]
    return float(min(highest_moving_hz, highest_hz.max()))


def _without_start(
    recording: Recording, group_rig: Rig, motion: Kinematics, forces: ContactForces, begins_at_rest: bool
) -> tuple[Kinematics, ContactForces]:
    """Motion and contact forces without the start, in which the beams ring of what was before.

    Raises ContactRefusedError if too little is left.
    """
    rate_hz, sample_count = motion.sample_rate_hz, forces.force_n.shape[1]
    skipped_s = RINGING_S if begins_at_rest else start_transient_s(group_rig, forces.slow_n_per_m)
    skipped_samples = round(skipped_s * rate_hz / forces.decimation)
    if (sample_count - skipped_samples) * forces.decimation < LEAST_RECORD_S * rate_hz:
        remedy = RemedyCode.RECORD_LONGER_FROM_REST_OR_DISPLACEMENTS
        at_end_s = recording.duration_s - sample_count * forces.decimation / recording.rig.sample_rate_hz
        raise refused(
            RefusalCode.TOO_SHORT,
            RemedyCode.RECORD_LONGER_OR_FROM_REST if motion.zero_known else remedy,
            duration_s=recording.duration_s,
            at_start_s=skipped_s,
            at_end_s=at_end_s,
            length_ratio=(skipped_s + LEAST_RECORD_S + at_end_s) / recording.duration_s,
        )
    return motion.segment(slice(skipped_samples * forces.decimation, None)), forces.without_start(skipped_samples)


def check_rig_is_modelled(rig: Rig) -> None:
    """Raises ContactRefusedError if the rig has no contact, or a field that the linear model leaves out."""
    if not rig.contacts:
        raise refused(RefusalCode.NO_CONTACTS, rig=rig.name)
    for name in UNMODELLED_FIELDS:
        if getattr(rig, name) in ((), None, ForceSensor()) or (name == "base_motion" and rig.base_sensors):
            continue
        if name == "base_motion":
            raise refused(RefusalCode.BASE_MOTION, rig=rig.name)
        raise refused(RefusalCode.NOT_MODELLED, rig=rig.name, what=name)
    if any(spring.cubic_n_per_m3 for spring in rig.springs):
        raise refused(RefusalCode.NOT_MODELLED, rig=rig.name, what="springs with cubic_n_per_m3")


def _check_displacement_observable(rig: Rig, motion: Kinematics) -> None:
    """Raises ContactRefusedError if a contact has no sensor, and its body more modes than stations: the displacement
    there does not follow from those at the stations."""
    for contact in rig.contacts:
        for station in contact_stations(contact):
            body, count = station.body, sum(place.body == station.body for place in motion.stations)
            if motion.row(station) is None and count < rig.body(body).max_modes:
                position_m = station.position_m
                raise refused(
                    RefusalCode.NO_SENSOR, contact=contact.name, position_m=position_m, body=body, stations=count
                )


def _contact_records(
    rig: Rig,
    motion: Kinematics,
    noise_m_per_s2: Float[np.ndarray, " stations"],
    forces: ContactForces,
    tolerances: Tolerances,
) -> tuple[ContactRecord, ...]:
    """Contact record of each pair of places."""
    force_count = forces.force_n.shape[1]
    sample_count = min(force_count * forces.decimation, motion.sample_count)
    fitted = slice(force_count - min(EDGE_SAMPLES, force_count // 8))
    eta_m = signals_across_contacts(rig, motion, motion.displacement_m)
    velocity_m_per_s = signals_across_contacts(rig, motion, motion.velocity_m_per_s)
    records, nuisances = [], forces.nuisances
    is_initial_state = np.array([p.kind == NuisanceKind.INITIAL_STATE for p in nuisances.parameters], dtype=bool)
    quiet_force_n = forces.force_n[:, : motion.excited_from // forces.decimation]
    quiet_deviation_n = quiet_force_n.std(axis=1) if quiet_force_n.shape[1] else np.zeros(len(rig.contacts))
    quiet_deviation_n = np.maximum(quiet_deviation_n, ROUNDING_SHARE * motion.forces_n.std(axis=1).max())
    for j in range(len(rig.contacts)):
        nuisance_etas_m = nuisances.eta_m[:, j]
        shifts_eta = np.any(nuisance_etas_m, axis=1)
        drift = contact_drift_prior(rig, motion, j, noise_m_per_s2, tolerances, sample_count)
        if drift:
            drift = replace(
                drift,
                spring_n_per_m=float(forces.slow_n_per_m[j, j]),
                damper_n_s_per_m=float(forces.slow_n_s_per_m[j, j]),
                slow_force_density=float(forces.slow_force_density[j]),
            )
        nuisance_m = oversampled(nuisance_etas_m[shifts_eta], forces.decimation)[:, :sample_count].astype(np.float32)
        records.append(
            ContactRecord(
                eta_m=eta_m[j, :sample_count],
                velocity_m_per_s=velocity_m_per_s[j, :sample_count],
                sample_rate_hz=motion.sample_rate_hz,
                force_n=forces.force_n[j, fitted],
                decimation=forces.decimation,
                quiet_deviation_n=float(quiet_deviation_n[j]),
                noise_n=float(forces.noise_n[j]),
                unmodelled_share=tolerances.unmodelled_contact,
                eta_noise_m=float(forces.slow_motion.eta_noise_m[j]) if forces.slow_motion else 0.0,
                drift=drift,
                drift_spline=spline(sample_count, motion.sample_rate_hz, drift),
                nuisance_n=nuisances.force_n[:, j, fitted],
                force_noise_multiple=nuisances.force_noise_multiple[:, j],
                eta_noise_multiple=nuisances.eta_noise_multiple[shifts_eta, j],
                shifts_eta=shifts_eta,
                nuisance_m=nuisance_m,
                is_initial_state=is_initial_state,
            )
        )
    return tuple(records)


def contact_drift_prior(
    rig: Rig,
    motion: Kinematics,
    contact_index: int,
    noise_m_per_s2: Float[np.ndarray, " stations"],
    tolerances: Tolerances,
    sample_count: int,
) -> DriftPrior | None:
    """Drift of a contact: prior of the slow part of its relative displacement, which integration loses, and of motion
    across the axes of its accelerometers; None where no slow motion is lost.

    Raises ContactRefusedError if no sensor stands at the contact.
    """
    if motion.zero_known:
        return None
    contact = rig.contacts[contact_index]
    stations = contact_stations(contact)
    for station in stations:
        if motion.row(station) is None:
            raise refused(
                RefusalCode.NO_ACCELEROMETER, contact=contact.name, position_m=station.position_m, body=station.body
            )
    slow_m_per_s2 = [motion.lost_m_per_s2[motion.stations.index(station)] for station in stations]
    error_densities = [_acceleration_error_density(motion, station, noise_m_per_s2, tolerances) for station in stations]
    if motion.base and len(stations) == 1:
        gain_error = tolerances.of_sensor(motion.base.sensor.name).gain
        error_m_per_s2 = gain_error * _below_hz(SLOW_DRIFT_HZ, motion.base.acceleration_m_per_s2, motion)
        error_densities.append(float(np.sqrt(np.mean(error_m_per_s2**2) / SLOW_DRIFT_HZ)))
    slow_noise_density = max(float(np.hypot.reduce(error_densities)), LEAST_NOISE_DENSITY)
    acceleration_m_per_s2 = motion.acceleration_m_per_s2[[motion.stations.index(station) for station in stations]]
    lateral_m_per_s2 = tolerances.lateral_motion * _below_hz(HIGHEST_DRIFT_HZ, acceleration_m_per_s2, motion)
    lateral_density = float(np.sqrt(np.sum(np.mean(lateral_m_per_s2**2, axis=1)) / HIGHEST_DRIFT_HZ))
    return DriftPrior(
        acceleration_m_per_s2=(slow_m_per_s2[0] - (slow_m_per_s2[1] if len(slow_m_per_s2) > 1 else 0.0))[:sample_count],
        noise_density=max(lateral_density, slow_noise_density),
        slow_noise_density=slow_noise_density,
        spring_n_per_m=0.0,
    )


def _acceleration_error_density(
    motion: Kinematics, station: Station, noise_m_per_s2: Float[np.ndarray, " stations"], tolerances: Tolerances
) -> float:
    """One-sided density of a station's acceleration error in the band of the drift, m/s^2/sqrt(Hz).

    It is the sensor's noise, and the errors of the slow acceleration by the tolerances of gain, position and the share
    of the other direction.
    """
    station_row = motion.stations.index(station)
    body_rows = [k for k, place in enumerate(motion.stations) if place.body == station.body]
    body_rows.sort(key=lambda k: motion.stations[k].position_m)
    slow_m_per_s2 = np.stack([_below_hz(SLOW_DRIFT_HZ, motion.acceleration_m_per_s2[k], motion) for k in body_rows])
    row_on_body = body_rows.index(station_row)
    absolute_slow_m_per_s2 = slow_m_per_s2[row_on_body]
    if motion.base:
        base_m_per_s2 = motion.base.acceleration_m_per_s2
        absolute_slow_m_per_s2 = absolute_slow_m_per_s2 + _below_hz(SLOW_DRIFT_HZ, base_m_per_s2, motion)
    error_power = tolerances.gain**2 * np.mean(absolute_slow_m_per_s2**2)
    if len(body_rows) > 1:
        positions_m = [motion.stations[k].position_m for k in body_rows]
        acceleration_slope = np.gradient(slow_m_per_s2, positions_m, axis=0)[row_on_body]
        error_power += tolerances.position_m**2 * np.mean(acceleration_slope**2)
    if motion.transverse and (transverse_row := motion.transverse.row(station)) is not None:
        transverse_m_per_s2 = _below_hz(SLOW_DRIFT_HZ, motion.transverse.acceleration_m_per_s2[transverse_row], motion)
        error_power += tolerances.cross_axis**2 * np.mean(transverse_m_per_s2**2)
    return float(np.sqrt(2 * noise_m_per_s2[station_row] ** 2 / motion.sample_rate_hz + error_power / SLOW_DRIFT_HZ))


def _below_hz(
    highest_hz: float, acceleration: Float[np.ndarray, "*signals samples"], motion: Kinematics
) -> Float[np.ndarray, "*signals fewer"]:
    """Acceleration up to a frequency, at a lower sample rate."""
    return decimated(acceleration, max(1, int(motion.sample_rate_hz / (2 * highest_hz))))
