"""Identification of the contacts of a recording: separate, determine, accept, then the paper's methods and the
report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.contacts import results
from identify.contacts.acceptance import contacts_after_recording_check, nifo_contradiction_findings
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_fit import FORMS_BESIDE_DEAD_ZONE
from identify.contacts.outcomes import Outcomes
from identify.contacts.paper_methods import (
    PaperMethods,
    check_equation_and_averaging,
    paper_methods,
    signals_by_law,
    stops_of,
)
from identify.contacts.refusals import Refusal
from identify.contacts.results import ContactReport
from identify.linear.joined import ContactGroup
from identify.linear.modal import NEARLY_INVISIBLE_SHARE, Transformation
from identify.pages.wording import COVERED
from identify.paper.nifo import Nifo, fit_mode
from identify.paper.surface import Stops, Surface
from identify.signals.kinematics import Kinematics, MotionQuantity
from identify.signals.measured_base import body_force_count
from identify.signals.noise import noise_source
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.model.description import Rig, contact_stations
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

MAX_SHARE_HALF_WIDTH = 0.05
"""Largest half-width of the 95 % interval of a share of time that is reported."""


@dataclass(frozen=True)
class Identification:
    """Result of an identification: the report, and the signals and estimates behind it.

    motion has the forces and the sensors, but not the stations' signals. eta_m includes the drift; separated_n are the
    contact forces at every `decimation`-th sample, one for each of the contact_groups.
    """

    report: ContactReport
    rig: Rig
    motion: Kinematics
    eta_m: Float[np.ndarray, "contacts samples"]
    contact_groups: tuple[ContactGroup, ...]
    separated_n: Float[np.ndarray, "groups fewer"]
    decimation: int
    outcomes: Outcomes
    methods: PaperMethods
    tolerances: Tolerances

    @property
    def weak_nifo(self) -> Nifo:
        """NIFO's weak form of the main equation; raises RigError if there is none."""
        return self._main_nifo[0]

    @property
    def paper_nifo(self) -> Nifo:
        """NIFO in the paper's form; raises RigError if there is none."""
        return self._main_nifo[1]

    @property
    def surface(self) -> Surface:
        """Surface of the main equation; raises RigError if there is none."""
        for surface in self.methods.main_surfaces:
            return surface
        raise RigError("; ".join(self.methods.notes) or "no modal equation has a restoring force surface")

    @property
    def stops(self) -> tuple[Stops | None, ...]:
        """Stops of each contact of the rig; None where the record does not determine it."""
        return stops_of(self.rig, self.outcomes)

    @property
    def _main_nifo(self) -> tuple[Nifo, ...]:
        if not self.methods.main_nifo_results:
            notes = "; ".join(self.methods.notes)
            raise RigError(notes or "NIFO needs a force, and the exciting force is zero throughout")
        return self.methods.main_nifo_results


def identify_contact(
    recording: Recording,
    *,
    use: MotionQuantity = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Identification:
    """Clearance, stiffness and damping of every contact of a recording's rig.

    The record is checked first (`identify.checks`). The contact forces are separated without a law; each is fitted
    together with the drift of its relative displacement, which gives the estimates. With the estimated laws, the
    response of the modes beyond the fitted ones is subtracted from the motion, and the paper's methods, the restoring
    force surface and NIFO, are applied to every modal equation. The main equation, which the figures show, is the one
    whose stiffness varies least over frequency, unless `equation` names one ("barrel 3").

    The findings of the report are those of the check and those on the fits; its notes are the methods that failed.

    Raises RigError if the record does not allow it: too short, too few stations, no force; with the first finding.
    """
    averaging = averaging or Averaging()
    check_equation_and_averaging(recording, averaging, equation)
    rig, accepted = recording.rig, contacts_after_recording_check(recording, use, tolerances, FORMS_BESIDE_DEAD_ZONE)
    separation, outcomes = accepted.separation, accepted.outcomes
    condensed_rig, motion, contact_groups = separation.rig, separation.motion, separation.contact_groups
    separated_n, decimation = separation.forces.force_n, separation.forces.decimation
    findings, signals, stops = accepted.findings, signals_by_law(separation, outcomes), stops_of(rig, outcomes)
    del accepted, separation  # whose nuisance signals take much memory
    progress(0.5)
    single_contacts = {group.contact_indices[0] for group in contact_groups if len(group.contact_indices) == 1}
    methods = paper_methods(
        condensed_rig, motion, signals, stops, single_contacts=single_contacts, averaging=averaging, equation=equation
    )
    progress(0.95)
    contact_names = [contact.name for contact in rig.contacts]
    findings += tuple(nifo_contradiction_findings(contact_names, outcomes.estimates, methods.nifo_results))
    return Identification(
        report=contact_report(rig, outcomes, methods, findings),
        rig=rig,
        motion=methods.motion,
        eta_m=methods.eta_m,
        contact_groups=contact_groups,
        separated_n=separated_n,
        decimation=decimation,
        outcomes=outcomes,
        methods=methods,
        tolerances=tolerances or rig.tolerances or LABORATORY,
    )


def contact_report(
    rig: Rig, outcomes: Outcomes, methods: PaperMethods, findings: tuple[Finding, ...] = ()
) -> results.ContactReport:
    """Report of the outcomes and of the results of the paper's methods."""
    motion = methods.motion
    etas_m = {contact.name: row for contact, row in zip(rig.contacts, methods.eta_m, strict=True)}
    surface_results = tuple(results.SurfaceResult(s.equation.name, _clearances(rig, s.stops)) for s in methods.surfaces)
    return results.ContactReport(
        rig=rig.name,
        contacts=tuple(contact_estimate(name, estimate, etas_m[name]) for name, estimate in outcomes.estimates.items()),
        unanswered=results.unanswered(outcomes.refusals),
        main_equation=methods.main_equation,
        modes=_mode_results(rig, methods.nifo_results, outcomes.refusals),
        nifo=tuple(nifo_result(rig, nifo) for nifo in methods.nifo_results),
        surface=results.Surfaces(surface_results, _clearances(rig, methods.histogram)),
        transformation=tuple(map(_transformation_result, methods.transformations)),
        trusted_hz=motion.trusted_hz,
        channels_used=(*rig.force_names[: body_force_count(rig)], *motion.channels),
        findings=findings,
        noise_from=noise_source(motion, rig),
        notes=methods.notes,
    )


def closed_share(estimate: JointEstimate, eta_m: Float[np.ndarray, " samples"]) -> float | None:
    """Share of the samples beyond the touched stops; None if it depends too much on the 95 % intervals of these,
    and of a spring."""
    if estimate.is_spring:
        return None
    lower_touched, upper_touched = estimate.touched
    (lower_m, upper_m, *_), (lower_error_m, upper_error_m, *_) = estimate.values, estimate.errors

    def share_beyond(stop_shift_errors: float) -> float:
        is_below = lower_touched & (eta_m < -lower_m - stop_shift_errors * lower_error_m)
        return float(np.mean(is_below | (upper_touched & (eta_m > upper_m + stop_shift_errors * upper_error_m))))

    return share_beyond(0.0) if share_beyond(-COVERED) - share_beyond(COVERED) < 2 * MAX_SHARE_HALF_WIDTH else None


def contact_estimate(
    name: str, estimate: JointEstimate, eta_m: Float[np.ndarray, " samples"]
) -> results.ContactEstimate:
    """Entry of contact.json of a contact of one direction."""
    lower_clearance, upper_clearance, stiffness, damping, clearance = (
        results.Estimate(float(gradient @ estimate.values), estimate.error(gradient), estimate.own_error(gradient))
        for gradient in (*np.eye(len(estimate.values)), estimate.clearance_gradient)
    )
    form, (lower_touched, upper_touched) = estimate.form, estimate.touched
    return results.ContactEstimate(
        name=name,
        clearance_m=clearance,
        stiffness_n_per_m=stiffness,
        damping_n_s_per_m=damping,
        lower_clearance_m=lower_clearance if estimate.sides_known and lower_touched else None,
        upper_clearance_m=upper_clearance if estimate.sides_known and upper_touched else None,
        closed_share=closed_share(estimate, eta_m),
        law=form.name,
        exponent=results.Estimate(estimate.exponent, estimate.exponent_error) if form.exponent_count else None,
        reference_depth_m=form.reference_depth_m if form.exponent_count else None,
    )


def _mode_results(rig: Rig, nifo_results: Sequence[Nifo], refusals: Mapping[str, Refusal]) -> tuple[results.Mode, ...]:
    """Elastic modes within the band of NIFO."""
    mode_results = []
    for nifo in nifo_results:
        equation = nifo.equation
        if 0 < equation.frequency_hz < nifo.frequency_hz[-1]:
            undetermined_names = tuple(
                contact.name
                for contact in rig.contacts
                if contact.name in refusals and equation.body in {s.body for s in contact_stations(contact)}
            )
            mode_results.append(results.Mode(equation.body, equation.mode_number, *fit_mode(nifo), undetermined_names))
    return tuple(mode_results)


def nifo_result(rig: Rig, nifo: Nifo) -> results.NifoResult:
    """Entry of contact.json of NIFO on one modal equation."""
    equation, contact_names = nifo.equation, [contact.name for contact in rig.contacts]
    stiffnesses = tuple(
        results.Stiffness(contact_names[index], results.Estimate(float(mean_n_per_m), float(error)), float(deviation))
        for index, mean_n_per_m, error, deviation in zip(
            nifo.contact_indices, nifo.mean_n_per_m, nifo.stiffness_error_n_per_m, nifo.deviation_n_per_m, strict=True
        )
    )
    names_and_visibilities = zip(contact_names, equation.visibility, strict=True)
    hidden_names = tuple(name for name, visibility in names_and_visibilities if visibility < NEARLY_INVISIBLE_SHARE)
    band_hz = (float(nifo.frequency_hz[0]), float(nifo.frequency_hz[-1]))
    return results.NifoResult(equation.name, band_hz, nifo.resolution_hz, nifo.average_count, stiffnesses, hidden_names)


def _clearances(rig: Rig, stop_by_contact: Sequence[Stops | None]) -> tuple[results.Clearance, ...]:
    return tuple(
        results.Clearance(contact.name, results.Estimate(stop.clearance_m, stop.clearance_error_m))
        for contact, stop in zip(rig.contacts, stop_by_contact, strict=True)
        if stop is not None
    )


def _transformation_result(transform: Transformation) -> results.TransformationResult:
    mode_count, station_count = transform.inverse_shapes.shape
    shares, condition_number = tuple(transform.truncation_shares.tolist()), transform.condition_number
    return results.TransformationResult(transform.body.name, station_count, mode_count, condition_number, shares)
