"""Third stage: what of the determined contacts is relied upon, and what speaks against them.

Pulls of the nuisance parameters, scatter between the record's halves, what the fit leaves, negative damping; a force
that was not recorded.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identify.checks import check_recording, naming
from identify.checks.findings import Cause, Finding
from identify.contacts.contact_record import STIFFNESS
from identify.contacts.determination import Outcomes, determine
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import FormName
from identify.contacts.refusals import RefusalCode, refused
from identify.contacts.separation import Separation, check_described, is_unforced, separate
from identify.linear.modal import NEARLY_INVISIBLE
from identify.linear.nuisance import Nuisance, NuisanceKind
from identify.pages.wording import interval, number
from identify.paper.nifo import Nifo
from identify.signals.kinematics import Use
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

BROKEN = 4.5
"""A nuisance parameter that is pulled by more tolerances than this is off."""
USUAL = 1.5
"""A body's frequency or mass, or the force's gain, that is pulled by more widens the intervals: see `widened`."""
WHOLE = (NuisanceKind.FREQUENCY, NuisanceKind.MASS, NuisanceKind.FORCE_GAIN)
UNLIKE = 3.7
"""The halves of a record differ by so many standard errors; of sixteen parts that all agree, 4 is the most."""
UNEXPLAINED = 0.3
SURE, APART, ERRORS = 0.1, 0.1, 5.0
"""A modal equation in which a stiffness varies over frequency by less than that share is sure of it: if it is further
from the joint fit's, and by so many standard errors, the two do not agree."""
NEGATIVE = 5.0
CAUSES: dict[NuisanceKind, Cause] = {
    NuisanceKind.GAIN: "gain",
    NuisanceKind.POSITION: "station",
    NuisanceKind.DELAY: "delay",
    NuisanceKind.FORCE_GAIN: "gain",
    NuisanceKind.MASS: "mass",
    NuisanceKind.FREQUENCY: "frequency",
    NuisanceKind.DAMPING: "damping",
}
"""Not of an unknown high-pass: the slow motion that accelerometers miss has its shape."""
OF_SENSORS = (NuisanceKind.GAIN, NuisanceKind.POSITION, NuisanceKind.DELAY)


MOST_UNEXPLAINED = 0.03
"""Of a contact's force: in a free decay less is left, where a force acts that was not recorded more."""


@dataclass(frozen=True)
class Contacts:
    """The contacts of a recording: what was separated of them, what is determined, and what speaks against it."""

    separation: Separation
    outcomes: Outcomes
    findings: tuple[Finding, ...]


def checked_contacts(
    recording: Recording, use: Use, tolerances: Tolerances | None, forms: Sequence[FormName] = ()
) -> Contacts:
    """`find_contacts` of a recording that is checked before; the findings are those of both.

    Of the check's findings, not that the record begins in motion, which the fit takes as it is, nor that the channel of
    the force is dead, which a free decay explains. Raises RigError as `find_contacts` does, with the first finding.
    """
    findings = tuple(f for f in check_recording(recording, use, tolerances) if f.cause != "not at rest")
    with naming(findings):
        contacts = find_contacts(recording, use, tolerances or recording.rig.tolerances or LABORATORY, forms)
    if is_unforced(contacts.separation.motion):
        findings = without_dead_force(findings, recording.force_names)
    return replace(contacts, findings=findings + contacts.findings)


def find_contacts(recording: Recording, use: Use, tolerances: Tolerances, forms: Sequence[FormName] = ()) -> Contacts:
    """Clearance, stiffness and damping of every contact, or why the record does not determine it; its law is a dead
    zone, or the one of `forms` that the record asks for.

    Raises RigError if the record allows nothing: too short, too few stations, no force, no contacts described.
    """
    check_described(recording.rig)
    separation = separate(recording, use, tolerances)
    return accept(separation, determine(separation, forms))


def accept(separation: Separation, outcomes: Outcomes) -> Contacts:
    """The outcomes, in the order of the rig, with the standard errors that their pulls ask for, and what cannot be.

    Of a record without a force a refusal says that one may be missing. Raises ContactRefusedError if then the contacts'
    forces do not follow from the motion: other forces acted.
    """
    names = [c.name for c in separation.rig.contacts]
    parameters = separation.forces.nuisances.parameters
    estimates = {
        name: widened(outcomes.estimates[name], parameters, separation.mass_pull)
        for name in names
        if name in outcomes.estimates
    }
    refusals = {name: outcomes.refusals[name] for name in names if name in outcomes.refusals}
    if is_unforced(separation.motion):
        _check_free_decay(estimates)
        refusals = {name: replace(refusal, unforced=True) for name, refusal in refusals.items()}
    return Contacts(separation, Outcomes(estimates, refusals), tuple(fit_findings(estimates, parameters)))


def _check_free_decay(estimates: Mapping[str, JointEstimate]) -> None:
    for name, estimate in estimates.items():
        if estimate.unexplained > MOST_UNEXPLAINED:
            percent = 100 * estimate.unexplained
            raise refused(RefusalCode.FORCE_NOT_RECORDED, contact=name, unexplained_percent=percent)


def without_dead_force(findings: Sequence[Finding], forces: Sequence[str]) -> tuple[Finding, ...]:
    """The findings without those of force channels at zero, which a free decay explains."""
    return tuple(f for f in findings if f.cause != "dead" or not set(f.channels) <= set(forces))


def widened(found: JointEstimate, parameters: Sequence[Nuisance], in_gaps: float) -> JointEstimate:
    """Standard errors times the largest pull p of what belongs to a whole body or to the force, where it is unusual.

    A clock, a density or a unit that is off shows there, and what it does beside is in no tolerance. A rig of one body
    has no second one to tell a clock from its frequencies by: there p always counts, as sqrt(1 + p^2). So does the
    pull of a mass while its contacts are open, which is no part of the fit. Where a spring holds the bodies, a sensor's
    high-pass counts too: it stands for slow motion that accelerometers miss, and that the spring feels.
    """
    kinds = (*WHOLE, NuisanceKind.HIGH_PASS) if found.sides_known else WHOLE
    whole = {of: abs(p) for p, of in zip(found.pulls, parameters, strict=True) if of.kind in kinds and of.mode is None}
    pull = max(whole.values(), default=0.0)
    alone = sum(of.kind == NuisanceKind.FREQUENCY for of in whole) == 1
    unusual = 1 + pull**2 if alone else pull**2 if pull > USUAL else 1.0
    square = max(unusual, 1 + in_gaps**2)
    return replace(
        found,
        covariance=square * found.covariance,
        of_tolerances=square * found.of_tolerances,
        of_drift=square * found.of_drift,
        of_misfit=square * found.of_misfit,
    )


def fit_findings(estimates: Mapping[str, JointEstimate], parameters: Sequence[Nuisance]) -> Iterator[Finding]:
    """Findings on the fits: parameters beyond their tolerances, and the faults of each contact."""
    for k, parameter in enumerate(parameters):
        pull = max((estimate.pulls[k] for estimate in estimates.values()), key=abs, default=0.0)
        if parameter.kind in CAUSES and abs(pull) > BROKEN:
            yield _beyond_tolerance(parameter, pull)
    for name, estimate in estimates.items():
        yield from _faults(name, estimate)


def _beyond_tolerance(parameter: Nuisance, pull: float) -> Finding:
    of = parameter.of + ("" if parameter.mode is None else f" {parameter.mode}")
    return Finding(
        cause=CAUSES[parameter.kind],
        channels=(parameter.of,)
        if parameter.kind in (NuisanceKind.GAIN, NuisanceKind.POSITION, NuisanceKind.DELAY)
        else (),
        of=of,
        evidence=f"the contacts' fit asks for the {parameter.kind} of {of} to be {pull:+.2g} tolerances off",
        mend="check it (a clock that is off shifts all frequencies alike), or widen its tolerance",
    )


def _faults(name: str, estimate: JointEstimate) -> Iterator[Finding]:
    damping, error = float(estimate.values[-1]), float(estimate.errors[-1])
    if damping < -NEGATIVE * error:
        yield _of_fit(name, f"{name} comes out with a negative damping of {interval(damping, error, 'N s/m')}")
    if max(np.abs(estimate.halves)) > UNLIKE:
        yield _of_fit(name, f"{name} differs between the halves of the record by more than scatter makes")
    if estimate.unexplained > UNEXPLAINED:
        unexplained = f"{100 * estimate.unexplained:.2g} %"
        yield _of_fit(name, f"no clearance and stiffness explain {unexplained} of {name}'s force")


def equation_findings(
    names: Sequence[str], estimates: Mapping[str, JointEstimate], spectra: Sequence[Nifo]
) -> Iterator[Finding]:
    """Contacts of which a modal equation by itself, by NIFO, is sure that they are other than all stations say."""
    for one in spectra:
        for j, mean, error, deviation in zip(
            one.contacts, one.mean_n_per_m, one.stiffness_error_n_per_m, one.deviation_n_per_m, strict=True
        ):
            name, clear = names[j], one.equation.visibility[j] >= NEARLY_INVISIBLE
            if name not in estimates or not clear or deviation > SURE * abs(mean):
                continue
            found, of_found = estimates[name].stiffness_n_per_m, estimates[name].error(STIFFNESS)
            if abs(mean - found) > max(APART * found, ERRORS * float(np.hypot(error, of_found))):
                yield _of_fit(
                    name,
                    f"{one.equation.name} by itself gives {name} {number(mean)} N/m, all stations "
                    f"together {interval(found, of_found, 'N/m')} (± 95 %)",
                )


def _of_fit(contact: str, evidence: str) -> Finding:
    return Finding(
        cause="fit",
        of=contact,
        evidence=evidence,
        mend="do not rely on it: look at its force over the relative displacement, and ask identify gap what differs",
    )
