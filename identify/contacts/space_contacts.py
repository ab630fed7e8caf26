"""Contacts of a rig in space: its two plane rigs are separated by themselves, and each annular contact is fitted over
both; contacts of one direction are those of its plane rig."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from identify.checks import adding_first_finding_to_error, check_recording
from identify.checks.findings import Finding
from identify.contacts.acceptance import fit_findings, with_errors_widened_by_pulls, without_dead_force_channel_findings
from identify.contacts.annular_estimate import AnnularEstimate, estimate_annular
from identify.contacts.annular_law import CLEARANCE, DAMPING, STIFFNESS
from identify.contacts.annular_record import AnnularRecord, annular_record
from identify.contacts.contact_record import ContactRecord
from identify.contacts.determination import determine
from identify.contacts.outcomes import NO_OUTCOMES, UNCERTAIN_SHARE, Outcomes, length_ratio
from identify.contacts.refusals import ContactRefusedError, Refusal, RefusalCode, refused
from identify.contacts.separation import Separation, check_rig_is_modelled, separate_planes
from identify.linear.nuisance import Nuisance, NuisanceKind
from identify.signals.beginning import excitation_start
from identify.signals.kinematics import MotionQuantity
from identify.signals.spectra import decimated, oversampled
from rig.model.contact_laws.annular import Annular
from rig.model.description import Contact, Rig, contact_stations
from rig.model.modes import with_attachments_merged
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording, plane_recording


@dataclass(frozen=True)
class SpaceContacts:
    """Contacts of a recording in space: separations of y and z, estimates of annular contacts, the outcomes of
    contacts of one direction, refusals of annular ones, and findings."""

    separations: tuple[Separation, Separation]
    annular: Mapping[str, AnnularEstimate]
    plane: Outcomes
    refusals: Mapping[str, Refusal]
    findings: tuple[Finding, ...]


def space_contacts_after_check(
    recording: Recording, use: MotionQuantity, tolerances: Tolerances | None
) -> SpaceContacts:
    """Contacts after a check of the recording in both directions, with the findings of all.

    Raises RigError if the record allows nothing, with the first finding.
    """
    check_both_directions_measured(recording.rig, use)
    findings = space_recording_findings(recording, use, tolerances)
    with adding_first_finding_to_error(findings):
        checked = space_contacts(recording, use, tolerances or recording.rig.tolerances or LABORATORY)
    return replace(checked, findings=findings + checked.findings)


def space_recording_findings(
    recording: Recording, use: MotionQuantity, tolerances: Tolerances | None
) -> tuple[Finding, ...]:
    """Findings of the check, without what weight does to displacements at rest."""
    findings = check_recording(recording_relative_to_rest(recording), use, tolerances)
    findings = without_dead_force_channel_findings(
        findings, () if np.any(recording.forces_n) else recording.force_names
    )
    return tuple(finding for finding in findings if finding.cause != "not at rest")


def check_both_directions_measured(rig: Rig, use: MotionQuantity) -> None:
    """Raises ContactRefusedError if a body of an annular contact has sensors in one direction alone."""
    for contact in (contact for contact in rig.contacts if contact.law.spatial):
        for body in (station.body for station in contact_stations(contact)):
            measured_directions = {
                sensor.station.direction
                for sensor in rig.sensors
                if sensor.station.body == body and use in ("auto", sensor.quantity) and sensor.measures.translates
            }
            if missing := {*rig.directions} - measured_directions:
                raise refused(RefusalCode.ONE_DIRECTION, contact=contact.name, body=body, direction=min(missing))


def recording_relative_to_rest(recording: Recording) -> Recording:
    """Recording with displacements and strains counted from the rest position of a rig that has weight; by itself if it
    has none, or does not begin at rest."""
    rig, first_excited_sample = recording.rig, 0
    if rig.gravity_m_per_s2 and not recording.start_s:
        sensor_signals = (recording.values_of(sensor) for sensor in rig.sensors)
        first_excited_sample = excitation_start(recording.forces_n, sensor_signals, rig.sample_rate_hz)
    signals = dict(recording.signals)
    for name in {"displacement", "strain"} & signals.keys() if first_excited_sample else ():
        quantity_values = signals[name].values
        rest_values = quantity_values[:, :first_excited_sample].mean(axis=1, keepdims=True)
        signals[name] = replace(signals[name], values=quantity_values - rest_values)
    return replace(recording, signals=signals)


def space_contacts(recording: Recording, use: MotionQuantity, tolerances: Tolerances) -> SpaceContacts:
    """Estimate of every contact of a rig in space, or why the record does not determine it.

    Raises RigError if the record allows nothing: too short, too few stations, no force, no contacts described.
    """
    rig = recording.rig
    check_rig_is_modelled(rig)
    for contact in rig.contacts if rig.gravity_m_per_s2 else ():
        if not contact.law.spatial and contact.at.direction == "y":
            unmodelled = f"gravity_m_per_s2 and contact {contact.name!r} in y that is not annular"
            raise refused(RefusalCode.NOT_MODELLED, rig=rig.name, what=unmodelled)
    rest_recording = recording_relative_to_rest(recording)
    planes = [plane_recording(rest_recording, direction) for direction in rig.directions]
    y_plane, z_plane = separate_planes(
        [replace(plane, rig=with_attachments_merged(plane.rig)) for plane in planes], use, tolerances
    )
    records = annular_records(rig, (y_plane, z_plane), tolerances)
    estimates, refusals = dict[str, AnnularEstimate](), dict[str, Refusal]()
    for name, record in records.items():
        law = rig.contact(name).law
        assert isinstance(law, Annular)
        try:
            estimate = estimate_annular(record, law.sliding_speed_m_per_s)
            _check_certain(estimate)
        except ContactRefusedError as error:
            refusals[name] = error.refusal
        else:
            estimates[name] = with_errors_widened_by_pulls(
                estimate, record.parameters, mass_pull=0.0
            )  # known of no ring
    plane_outcomes, findings = _plane_outcomes(rig, (y_plane, z_plane))
    shared_parameters = next(iter(records.values())).parameters if estimates else ()
    ring_findings = fit_findings(estimates, shared_parameters, DAMPING)
    return SpaceContacts((y_plane, z_plane), estimates, plane_outcomes, refusals, (*findings, *ring_findings))


def annular_records(
    rig: Rig, separations: tuple[Separation, Separation], tolerances: Tolerances
) -> dict[str, AnnularRecord]:
    """Record of every annular contact."""
    (y_names, z_names) = (rig.force_names_in(direction) for direction in rig.directions)
    (y_parameters, z_parameters) = (separation.forces.nuisances.parameters for separation in separations)
    records, quiet_count = {}, separations[0].motion.quiet_sample_count
    for name in (contact.name for contact in rig.contacts if contact.law.spatial):
        y_record, z_record = (_contact_record_in_direction(name, separation, tolerances) for separation in separations)
        records[name] = annular_record(
            (y_record, z_record), (y_parameters, z_parameters), (y_names, z_names), quiet_count
        )
    return records


def _contact_record_in_direction(contact_name: str, separation: Separation, tolerances: Tolerances) -> ContactRecord:
    """Record of a contact of that name in one direction."""
    contacts = separation.rig.contacts
    (record,) = (
        record
        for group, record in zip(separation.contact_groups, separation.records, strict=True)
        if contact_name in [contacts[contact_index].name for contact_index in group.contact_indices]
    )
    return _with_full_band_nuisances(record, separation, separation.rig.contact(contact_name), tolerances)


def _with_full_band_nuisances(
    record: ContactRecord, separation: Separation, contact: Contact, tolerances: Tolerances
) -> ContactRecord:
    """Contact record whose gains, delays and cross-axis shares change the relative displacement in the whole band.

    The separation knows them in the band of the forces alone. A delay tau and the damping of a contact press nearly
    alike, by k tau v and c v: what of tau v is left out counts as damping.
    """
    motion, sample_count, nuisance_m = separation.motion, record.eta_m.size, record.nuisance_m.copy()
    parameters = list(compress(separation.forces.nuisances.parameters, record.shifts_eta))
    for sign, station in ((1.0, contact.at), (-1.0, contact.against)):
        if station is None or (row := motion.row(station)) is None:
            continue
        sensor_name = motion.displacement_sensors[row].name
        tolerance = tolerances.of_sensor(sensor_name)
        changes_m = {
            NuisanceKind.GAIN: tolerance.gain * motion.displacement_m[row],
            NuisanceKind.DELAY: -tolerance.delay_s * motion.velocity_m_per_s[row],
        }
        if motion.transverse and (transverse_row := motion.transverse.row(station)) is not None:
            changes_m[NuisanceKind.CROSS_AXIS] = tolerance.cross_axis * motion.transverse.displacement_m[transverse_row]
        for kind, change_m in changes_m.items():
            if (parameter := Nuisance(kind, sensor_name)) in parameters:
                whole_change_m = sign * change_m[:sample_count]
                band_m = oversampled(decimated(whole_change_m, record.decimation), record.decimation)[:sample_count]
                nuisance_m[parameters.index(parameter)] += whole_change_m - band_m
    return replace(record, nuisance_m=nuisance_m)


def _check_certain(estimate: AnnularEstimate) -> None:
    """Raises ContactRefusedError if clearance or stiffness is too uncertain."""
    for quantity, parameter_index in (("clearance", CLEARANCE), ("stiffness", STIFFNESS)):
        value, error = float(estimate.values[parameter_index]), float(estimate.errors[parameter_index])
        if not error / value < UNCERTAIN_SHARE:
            scatter_variance = float(estimate.covariances["scatter"][parameter_index, parameter_index])
            ratio, error_percent = length_ratio(scatter_variance, error**2, value), min(100 * error / value, 100.0)
            raise refused(RefusalCode.UNCERTAIN, None, ratio, quantity=quantity, uncertain_percent=error_percent)


def _plane_outcomes(rig: Rig, separations: tuple[Separation, Separation]) -> tuple[Outcomes, tuple[Finding, ...]]:
    """Outcomes of the contacts of one direction, and findings on them."""
    outcomes, findings = NO_OUTCOMES, list[Finding]()
    annular_names = {contact.name for contact in rig.contacts if contact.law.spatial}
    for separation in separations:
        contacts, groups = separation.rig.contacts, separation.contact_groups
        indices = [k for k, g in enumerate(groups) if not annular_names & {contacts[i].name for i in g.contact_indices}]
        if not indices:
            continue
        plane_separation = replace(
            separation,
            forces=separation.forces.of_contacts(indices),
            contact_groups=tuple(groups[k] for k in indices),
            records=tuple(separation.records[k] for k in indices),
        )
        plane_outcomes, parameters = determine(plane_separation), separation.forces.nuisances.parameters
        estimates = {
            name: with_errors_widened_by_pulls(estimate, parameters, separation.mass_pull)
            for name, estimate in plane_outcomes.estimates.items()
        }
        outcomes = outcomes | Outcomes(estimates, plane_outcomes.refusals)
        findings += fit_findings(estimates, parameters)
    return outcomes, tuple(findings)
