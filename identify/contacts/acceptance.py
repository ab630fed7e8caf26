"""Third stage, acceptance: standard errors widened by the pulls of nuisance parameters, and findings against a fit.

A finding is a pull beyond its tolerance, a difference between the record's halves, unexplained force, or negative
damping. A free decay that its contact laws do not explain is refused: a force acted that was not recorded.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from identify.checks import adding_first_finding_to_error, check_recording
from identify.checks.findings import Cause, Finding
from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.determination import determine
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import STIFFNESS_GRADIENT, FormName
from identify.contacts.outcomes import Outcomes
from identify.contacts.refusals import RefusalCode, refused
from identify.contacts.separation import Separation, is_unforced, separate_if_rig_is_modelled
from identify.contacts.unrecorded_motion import beyond_band_motion_shares
from identify.linear.modal import NEARLY_INVISIBLE_SHARE
from identify.linear.nuisance import Nuisance, NuisanceKind
from identify.pages.wording import interval, number, percent
from identify.paper.nifo import Nifo
from identify.signals.kinematics import MotionQuantity
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

PULL_LIMIT = 4.5
"""Tolerances by which a nuisance parameter is pulled before it is a finding."""
USUAL_PULL = 1.5
"""Tolerances by which `BODY_AND_FORCE_KINDS` may be pulled before the intervals widen: see
`with_errors_widened_by_pulls`."""
BODY_AND_FORCE_KINDS = (NuisanceKind.FREQUENCY, NuisanceKind.MASS, NuisanceKind.FORCE_GAIN)
SPLIT_HALF_Z_LIMIT = 3.7
"""Standard errors by which the halves of a record may differ; 4 is the largest value that 16 equal parts can give."""
UNEXPLAINED_LIMIT, FREE_DECAY_UNEXPLAINED_LIMIT = 0.3, 0.03
"""Share of a contact force's root mean square that the fit may leave. In a free decay less is left, unless a force acts
that was not recorded."""
STEADY_SHARE, CONTRADICTION_SHARE, CONTRADICTION_ERRORS = 0.1, 0.1, 5.0
"""A stiffness that varies over frequency by less than the first share contradicts the joint fit if it differs by more
than the second share and by so many standard errors."""
NEGATIVE_DAMPING_ERRORS = 5.0
"""Standard errors below zero from which a negative damping is a finding."""
CAUSES: dict[NuisanceKind, Cause] = {
    NuisanceKind.GAIN: "gain",
    NuisanceKind.POSITION: "station",
    NuisanceKind.DELAY: "delay",
    NuisanceKind.FORCE_GAIN: "gain",
    NuisanceKind.MASS: "mass",
    NuisanceKind.FREQUENCY: "frequency",
    NuisanceKind.DAMPING: "damping",
}
"""Cause by kind of nuisance parameter. A high-pass has none: the slow motion that accelerometers miss looks the
same."""
SENSOR_KINDS = (NuisanceKind.GAIN, NuisanceKind.POSITION, NuisanceKind.DELAY)
UNRECORDED_LIMIT = 0.002
"""Motion of a contact beyond the recorded band from which on it is a finding, over its depth. Set by hand: on plates
that have 0.003 to 0.005 (`tests.campaigns.fifteen_rigs`) a third of the contacts are off by 1 to 2 %; other rigs have
0.001 at most."""
UNRECORDED_MEND = "sample at a higher rate: what the record does not show may bias clearance and stiffness"
DOUBT = "do not rely on it: look at its force over the relative displacement, and ask identify gap what differs"

AnyEstimate = TypeVar("AnyEstimate", JointEstimate, AnnularEstimate)


@dataclass(frozen=True)
class AcceptedContacts:
    """Contacts of a recording: separated forces, outcome of each contact, and findings against them."""

    separation: Separation
    outcomes: Outcomes
    findings: tuple[Finding, ...]


def contacts_after_recording_check(
    recording: Recording, use: MotionQuantity, tolerances: Tolerances | None, forms: Sequence[FormName] = ()
) -> AcceptedContacts:
    """`estimated_contacts` after a check of the recording, with the findings of both.

    Leaves out two findings of the check: that the record begins in motion, which the fit allows for, and that the force
    channel of a free decay is dead. Raises RigError as `estimated_contacts` does, with the first finding.
    """
    findings = tuple(f for f in check_recording(recording, use, tolerances) if f.cause != "not at rest")
    with adding_first_finding_to_error(findings):
        accepted = estimated_contacts(recording, use, tolerances or recording.rig.tolerances or LABORATORY, forms)
    if is_unforced(accepted.separation.motion):
        findings = without_dead_force_channel_findings(findings, recording.force_names)
    return replace(accepted, findings=findings + accepted.findings)


def estimated_contacts(
    recording: Recording, use: MotionQuantity, tolerances: Tolerances, forms: Sequence[FormName] = ()
) -> AcceptedContacts:
    """Clearance, stiffness and damping of every contact, or why the record does not determine it. Its law is a dead
    zone, or the one of `forms` that the record supports.

    Raises RigError if the record allows nothing: too short, too few stations, no force, no contacts described.
    """
    separation = separate_if_rig_is_modelled(recording, use, tolerances)
    return accept(separation, determine(separation, forms))


def accept(separation: Separation, outcomes: Outcomes) -> AcceptedContacts:
    """Outcomes in the order of the rig, with standard errors widened by their pulls, and the findings on the fits.

    Without a recorded force, refusals say that one may be missing, and ContactRefusedError is raised if the contact
    laws do not explain the contact forces: other forces acted.
    """
    contact_names = [contact.name for contact in separation.rig.contacts]
    nuisances = separation.forces.nuisances.parameters
    widened = {
        name: with_errors_widened_by_pulls(outcomes.estimates[name], nuisances, separation.mass_pull)
        for name in contact_names
        if name in outcomes.estimates
    }
    refusals = {name: outcomes.refusals[name] for name in contact_names if name in outcomes.refusals}
    if is_unforced(separation.motion):
        _refuse_unrecorded_force(widened)
        refusals = {name: replace(refusal, unforced=True) for name, refusal in refusals.items()}
    findings = (*fit_findings(widened, nuisances), *_beyond_band_motion_findings(separation, widened))
    return AcceptedContacts(separation, Outcomes(widened, refusals), findings)


def _refuse_unrecorded_force(estimates: Mapping[str, JointEstimate]) -> None:
    """Raises ContactRefusedError if a contact's law leaves more of its force than in a free decay."""
    for name, estimate in estimates.items():
        unexplained_share = estimate.unexplained_share
        if unexplained_share > FREE_DECAY_UNEXPLAINED_LIMIT:
            raise refused(RefusalCode.FORCE_NOT_RECORDED, contact=name, unexplained_percent=100 * unexplained_share)


def without_dead_force_channel_findings(findings: Sequence[Finding], forces: Sequence[str]) -> tuple[Finding, ...]:
    """Findings without those of force channels at zero, which a free decay explains."""
    return tuple(finding for finding in findings if finding.cause != "dead" or not set(finding.channels) <= set(forces))


def with_errors_widened_by_pulls(
    estimate: AnyEstimate, parameters: Sequence[Nuisance], mass_pull: float
) -> AnyEstimate:
    """Estimate with standard errors times the largest pull p of `BODY_AND_FORCE_KINDS`, where p exceeds `USUAL_PULL`.

    An error of the clock, a density or a unit pulls these parameters, and its other consequences are in no tolerance.
    A rig of one body has no second body that would tell a clock error from a frequency error: there the factor is
    always sqrt(1 + p^2). So it is with mass_pull, the pull of a mass while its contacts are open, which is no part of
    the fit. Where a spring holds the bodies, a sensor's high-pass counts too: it represents slow motion that
    accelerometers miss and that the spring feels.
    """
    widening_kinds = (*BODY_AND_FORCE_KINDS, NuisanceKind.HIGH_PASS) if estimate.sides_known else BODY_AND_FORCE_KINDS
    pull_sizes = {
        parameter: abs(pull)
        for pull, parameter in zip(estimate.pulls, parameters, strict=True)
        if parameter.kind in widening_kinds and parameter.mode_number is None
    }
    largest_pull = max(pull_sizes.values(), default=0.0)
    is_single_body = sum(parameter.kind == NuisanceKind.FREQUENCY for parameter in pull_sizes) == 1
    squared_factor = 1 + largest_pull**2 if is_single_body else largest_pull**2 if largest_pull > USUAL_PULL else 1.0
    variance_factor = max(squared_factor, 1 + mass_pull**2)
    covariances = {source: variance_factor * covariance for source, covariance in estimate.covariances.items()}
    return replace(estimate, covariances=covariances, widening_factor=float(np.sqrt(variance_factor)))


def fit_findings(
    estimates: Mapping[str, JointEstimate | AnnularEstimate], parameters: Sequence[Nuisance], damping_index: int = -1
) -> Iterator[Finding]:
    """Findings on the fits: nuisance parameters pulled beyond `PULL_LIMIT`, and those of each estimate, whose damping
    (N s/m) is the value of that index."""
    for parameter_index, parameter in enumerate(parameters):
        largest_pull = max((estimate.pulls[parameter_index] for estimate in estimates.values()), key=abs, default=0.0)
        if parameter.kind in CAUSES and abs(largest_pull) > PULL_LIMIT:
            yield _pull_finding(parameter, largest_pull)
    for name, estimate in estimates.items():
        damping, error = float(estimate.values[damping_index]), float(estimate.errors[damping_index])
        if damping < -NEGATIVE_DAMPING_ERRORS * error:
            yield _fit_finding(name, f"{name} comes out with a negative damping of {interval(damping, error, 'N s/m')}")
        if max(np.abs(estimate.split_half_z)) > SPLIT_HALF_Z_LIMIT:
            yield _fit_finding(name, f"{name} differs between the halves of the record by more than scatter makes")
        if isinstance(estimate, JointEstimate) and estimate.open_friction_n:
            friction_text = f"while {name} is open, {number(estimate.open_friction_n)} N act against its motion"
            friction_mend = "the values allow for it; identify gap tells where it acts and how large it is"
            yield _fit_finding(name, f"{friction_text}: friction that rig.json lacks", friction_mend)
        if estimate.unexplained_share > UNEXPLAINED_LIMIT:
            share_text = f"{100 * estimate.unexplained_share:.2g} %"
            yield _fit_finding(name, f"no clearance and stiffness explain {share_text} of {name}'s force")


def _beyond_band_motion_findings(separation: Separation, estimates: Mapping[str, JointEstimate]) -> Iterator[Finding]:
    """Findings on contacts that move beyond the recorded band."""
    for name, share in beyond_band_motion_shares(separation, estimates).items():
        if share > UNRECORDED_LIMIT:
            evidence = f"{name} moves beyond the recorded band, by {percent(share)} of the depth to which it closes"
            yield _fit_finding(name, evidence, UNRECORDED_MEND)


def _pull_finding(parameter: Nuisance, pull: float) -> Finding:
    owner_text = parameter.owner + ("" if parameter.mode_number is None else f" {parameter.mode_number}")
    return Finding(
        cause=CAUSES[parameter.kind],
        channels=(parameter.owner,) if parameter.kind in SENSOR_KINDS else (),
        of=owner_text,
        evidence=f"the contacts' fit asks for the {parameter.kind} of {owner_text} to be {pull:+.2g} tolerances off",
        mend="check it (a clock that is off shifts all frequencies alike), or widen its tolerance",
    )


def nifo_contradiction_findings(
    contact_names: Sequence[str], estimates: Mapping[str, JointEstimate], nifo_results: Sequence[Nifo]
) -> Iterator[Finding]:
    """Findings on contacts whose stiffness by NIFO of one modal equation contradicts that of the joint fit."""
    for nifo in nifo_results:
        for index, mean_n_per_m, mean_error, deviation in zip(
            nifo.contact_indices, nifo.mean_n_per_m, nifo.stiffness_error_n_per_m, nifo.deviation_n_per_m, strict=True
        ):
            name, is_visible = contact_names[index], nifo.equation.visibility[index] >= NEARLY_INVISIBLE_SHARE
            if name not in estimates or not is_visible or deviation > STEADY_SHARE * abs(mean_n_per_m):
                continue
            stiffness_n_per_m, error = estimates[name].stiffness_n_per_m, estimates[name].error(STIFFNESS_GRADIENT)
            limit_n_per_m = CONTRADICTION_ERRORS * float(np.hypot(mean_error, error))
            if abs(mean_n_per_m - stiffness_n_per_m) > max(CONTRADICTION_SHARE * stiffness_n_per_m, limit_n_per_m):
                yield _fit_finding(
                    name,
                    f"{nifo.equation.name} by itself gives {name} {number(mean_n_per_m)} N/m, all stations "
                    f"together {interval(stiffness_n_per_m, error, 'N/m')} (± 95 %)",
                )


def _fit_finding(contact_name: str, evidence: str, mend: str = DOUBT) -> Finding:
    return Finding(cause="fit", of=contact_name, evidence=evidence, mend=mend)
