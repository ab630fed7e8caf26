"""Identification of the contacts of a recording in space, and its report."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from identify.contacts import results
from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_law import CENTER, CLEARANCE, DAMPING, FRICTION, LOG_SPEED, REST, STIFFNESS
from identify.contacts.identification import Identification, contact_estimate, identify_contact, nifo_result
from identify.contacts.paper_methods import PaperMethods
from identify.contacts.ring_shares import RingShares, ring_shares
from identify.contacts.space_contacts import SpaceContacts, space_contacts_after_check
from identify.contacts.space_nifo import space_nifo
from identify.signals.kinematics import MotionQuantity
from identify.signals.noise import noise_source
from identify.signals.spectra import Averaging
from rig.model.description import Rig
from rig.model.space import check_plane
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

COUPLED_RINGS = (
    "springs to the ground couple the slow motions of the contacts, which accelerometers miss: of rings this coupling "
    "is left out, and in no interval"
)


@dataclass(frozen=True)
class SpaceIdentification:
    """Result of an identification in space: the report, and the estimates and signals behind it.

    methods are the results of NIFO in y and in z.
    """

    report: results.ContactReport
    rig: Rig
    contacts: SpaceContacts
    methods: tuple[PaperMethods, ...]
    tolerances: Tolerances

    @property
    def rate_hz(self) -> float:
        return self.contacts.separations[0].motion.sample_rate_hz

    @property
    def decimation(self) -> int:
        """Samples per sample of the separated forces."""
        return self.contacts.separations[0].forces.decimation


def identify_recording(
    recording: Recording,
    *,
    use: MotionQuantity = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Identification | SpaceIdentification:
    """Contacts of a recording: of one direction by `identify_contact`, of two by `identify_in_space`."""
    if recording.rig.in_space:
        return identify_in_space(recording, use=use, averaging=averaging, tolerances=tolerances, progress=progress)
    check_plane(recording.rig, "identify contact without annular contacts")
    return identify_contact(
        recording, use=use, averaging=averaging, equation=equation, tolerances=tolerances, progress=progress
    )


def identify_in_space(
    recording: Recording,
    *,
    use: MotionQuantity = "auto",
    averaging: Averaging | None = None,
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> SpaceIdentification:
    """Contacts of a recording in space (`identify.contacts.space_contacts` says how).

    Raises RigError if the record allows nothing, with the first finding.
    """
    contacts = space_contacts_after_check(recording, use, tolerances)
    progress(0.8)
    methods = space_nifo(contacts, averaging or Averaging())
    progress(0.95)
    rig, motions = recording.rig, [separation.motion for separation in contacts.separations]
    plane_etas_m = {
        name: record.eta_m + contacts.plane.estimates[name].drift_m
        for separation in contacts.separations
        for group, record in zip(separation.contact_groups, separation.records, strict=True)
        for name in [separation.rig.contacts[contact_index].name for contact_index in group.contact_indices]
        if name in contacts.plane.estimates
    }
    estimates = []
    for name in (contact.name for contact in rig.contacts):
        if name in contacts.annular:
            estimate, motion = contacts.annular[name], motions[0]
            shares = ring_shares(estimate, motion.sample_rate_hz, motion.excited_from, motion.start_s)
            estimates.append(_annular_estimate(name, estimate, shares))
        elif name in contacts.plane.estimates:
            estimates.append(contact_estimate(name, contacts.plane.estimates[name], plane_etas_m[name]))
    refusals = {**contacts.refusals, **contacts.plane.refusals}
    refusals = {contact.name: refusals[contact.name] for contact in rig.contacts if contact.name in refusals}
    report = results.ContactReport(
        rig=rig.name,
        contacts=tuple(estimates),
        unanswered=results.unanswered(refusals),
        main_equation="",
        modes=(),
        nifo=tuple(
            replace(nifo_result(separation.rig, nifo), equation=f"{nifo.equation.name} in {direction}")
            for direction, separation, plane_methods in zip("yz", contacts.separations, methods, strict=True)
            for nifo in plane_methods.nifo_results
        ),
        surface=results.Surfaces((), ()),
        transformation=(),
        trusted_hz=motions[0].trusted_hz,
        channels_used=(*rig.force_names, *motions[0].channels, *motions[1].channels),
        findings=contacts.findings,
        noise_from=noise_source(motions[0], contacts.separations[0].rig),
        notes=tuple(_notes(rig, contacts, methods)),
    )
    return SpaceIdentification(report, rig, contacts, methods, tolerances or rig.tolerances or LABORATORY)


def _notes(rig: Rig, contacts: SpaceContacts, methods: Sequence[PaperMethods]) -> Iterator[str]:
    """Methods that failed, and what the intervals do not hold."""
    for direction, plane_methods in zip("yz", methods, strict=True):
        yield from (f"in {direction}, {note}" for note in plane_methods.notes)
    if _has_coupled_rings(rig, contacts):
        yield COUPLED_RINGS


def _has_coupled_rings(rig: Rig, contacts: SpaceContacts) -> bool:
    """True if springs couple the slow motion of some contact to that of others, beside a ring."""
    stiffnesses = [separation.forces.slow_n_per_m for separation in contacts.separations]
    has_rings = any(contact.law.spatial for contact in rig.contacts)
    return has_rings and any(np.any(matrix - np.diag(np.diag(matrix))) for matrix in stiffnesses)


def _annular_estimate(name: str, estimate: AnnularEstimate, shares: RingShares) -> results.ContactEstimate:
    values, errors, own_errors = estimate.values, estimate.errors, estimate.own_errors

    def ring_estimate(index: int) -> results.Estimate:
        return results.Estimate(float(values[index]), float(errors[index]), float(own_errors[index]))

    speed_m_per_s = float(np.exp(values[LOG_SPEED]))
    speed_errors = (speed_m_per_s * float(errors[LOG_SPEED]), speed_m_per_s * float(own_errors[LOG_SPEED]))
    center_y, center_z = (ring_estimate(index) for index in range(len(values))[CENTER])
    rest_y, rest_z = (ring_estimate(index) for index in range(len(values))[REST])
    return results.ContactEstimate(
        name=name,
        clearance_m=ring_estimate(CLEARANCE),
        stiffness_n_per_m=ring_estimate(STIFFNESS),
        damping_n_s_per_m=ring_estimate(DAMPING),
        closed_share=1.0 - shares.free,
        law="annular",
        friction_coefficient=ring_estimate(FRICTION),
        sliding_speed_m_per_s=results.Estimate(speed_m_per_s, *speed_errors),
        center_y_m=center_y if estimate.center_known else None,
        center_z_m=center_z if estimate.center_known else None,
        rest_force_y_n=rest_y,
        rest_force_z_n=rest_z,
        ring=shares,
    )
