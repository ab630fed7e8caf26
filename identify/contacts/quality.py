"""How well the joint fit of a contact hangs together: pulls, scatter between halves, what is left, negative damping."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from identify.checks import check_recording
from identify.checks.findings import Cause, Finding
from identify.contacts.joint import Joint
from identify.contacts.start import STIFFNESS
from identify.linear.modal import NEARLY_INVISIBLE
from identify.linear.nuisance import Kind, Nuisance
from identify.pages.wording import interval
from identify.paper.nifo import Nifo
from identify.signals.kinematics import Use
from rig.model.tolerances import Tolerances
from rig.recording import Recording

BROKEN = 4.5
"""A nuisance parameter that is pulled by more tolerances than this is off."""
USUAL = 1.5
"""A body's frequency or mass, or the force's gain, that is pulled by more widens the intervals: see `widened`."""
WHOLE: tuple[Kind, ...] = ("frequency", "mass", "force gain")
UNLIKE = 3.7
"""The halves of a record differ by so many standard errors; of sixteen parts that all agree, 4 is the most."""
UNEXPLAINED = 0.3
SURE, APART, ERRORS = 0.1, 0.1, 5.0
"""A modal equation in which a stiffness varies over frequency by less than that share is sure of it: if it is further
from the joint fit's, and by so many standard errors, the two do not agree."""
NEGATIVE = 5.0
CAUSES: dict[Kind, Cause] = {
    "gain": "gain",
    "position": "station",
    "delay": "delay",
    "force gain": "gain",
    "mass": "mass",
    "frequency": "frequency",
    "damping": "damping",
}
"""Not of an unknown high-pass: the slow motion that accelerometers miss has its shape."""


def findings_before(recording: Recording, use: Use, tolerances: Tolerances | None) -> tuple[Finding, ...]:
    """Those of `check_recording`, but for a record that does not begin at rest: the fit takes it as it is."""
    return tuple(f for f in check_recording(recording, use, tolerances) if f.cause != "not at rest")


def widened(found: Joint, parameters: Sequence[Nuisance], in_gaps: float) -> Joint:
    """Standard errors times the largest pull p of what belongs to a whole body or to the force, where it is unusual.

    A clock, a density or a unit that is off shows there, and what it does beside is in no tolerance. A rig of one body
    has no second one to tell a clock from its frequencies by: there p always counts, as sqrt(1 + p^2). So does the
    pull of a mass while its contacts are open, which is no part of the fit. Where a spring holds the bodies, a sensor's
    high-pass counts too: it stands for slow motion that accelerometers miss, and that the spring feels.
    """
    kinds = (*WHOLE, "high-pass") if found.sides_known else WHOLE
    whole = {of: abs(p) for p, of in zip(found.pulls, parameters, strict=True) if of.kind in kinds and of.mode is None}
    pull = max(whole.values(), default=0.0)
    alone = sum(of.kind == "frequency" for of in whole) == 1
    unusual = 1 + pull**2 if alone else pull**2 if pull > USUAL else 1.0
    square = max(unusual, 1 + in_gaps**2)
    return replace(
        found,
        covariance=square * found.covariance,
        of_tolerances=square * found.of_tolerances,
        of_drift=square * found.of_drift,
    )


def fit_findings(
    names: Sequence[str], fits: Sequence[Joint | str], parameters: Sequence[Nuisance]
) -> Iterator[Finding]:
    """What of the fits cannot be: parameters beyond their tolerances, and each contact's faults of its own."""
    joints = [(name, fit) for name, fit in zip(names, fits, strict=True) if isinstance(fit, Joint)]
    for k, parameter in enumerate(parameters):
        if parameter.kind not in CAUSES:
            continue
        pull = max((fit.pulls[k] for _, fit in joints), key=abs, default=0.0)
        if abs(pull) > BROKEN:
            of = parameter.of + ("" if parameter.mode is None else f" {parameter.mode}")
            yield Finding(
                cause=CAUSES[parameter.kind],
                channels=(parameter.of,) if parameter.kind in ("gain", "position", "delay") else (),
                of=of,
                evidence=f"the contacts' fit asks for the {parameter.kind} of {of} to be {pull:+.2g} tolerances off",
                mend="check it (a clock that is off shifts all frequencies alike), or widen its tolerance",
            )
    for name, fit in joints:
        damping, error = float(fit.values[-1]), float(fit.errors[-1])
        if damping < -NEGATIVE * error:
            yield _of_fit(name, f"{name} comes out with a negative damping of {interval(damping, error, 'N s/m')}")
        if max(np.abs(fit.halves)) > UNLIKE:
            yield _of_fit(name, f"{name} differs between the halves of the record by more than scatter makes")
        if fit.unexplained > UNEXPLAINED:
            yield _of_fit(name, f"no clearance and stiffness explain {100 * fit.unexplained:.2g} % of {name}'s force")


def equation_findings(names: Sequence[str], fits: Sequence[Joint | str], spectra: Sequence[Nifo]) -> Iterator[Finding]:
    """Contacts of which a modal equation by itself, by NIFO, is sure that they are other than all stations say."""
    for one in spectra:
        for j, mean, error, deviation in zip(
            one.contacts, one.mean_n_per_m, one.stiffness_error_n_per_m, one.deviation_n_per_m, strict=True
        ):
            fit, clear = fits[j], one.equation.visibility[j] >= NEARLY_INVISIBLE
            if not isinstance(fit, Joint) or not clear or deviation > SURE * abs(mean):
                continue
            found, of_found = fit.stiffness_n_per_m, fit.error(STIFFNESS)
            if abs(mean - found) > max(APART * found, ERRORS * float(np.hypot(error, of_found))):
                yield _of_fit(
                    names[j],
                    f"{one.equation.name} by itself gives {names[j]} {interval(mean, error, 'N/m')}, all stations "
                    f"together {interval(found, of_found, 'N/m')} (± 95 %)",
                )


def _of_fit(contact: str, evidence: str) -> Finding:
    return Finding(
        cause="fit",
        of=contact,
        evidence=evidence,
        mend="do not rely on it: look at its force over the relative displacement, and ask identify gap what differs",
    )
