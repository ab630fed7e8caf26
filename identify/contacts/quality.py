"""How well the joint fit of a contact hangs together: pulls, scatter between halves, what is left, negative damping."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from identify.checks import check_recording
from identify.checks.findings import Cause, Finding
from identify.contacts.joint import Joint
from identify.signals.kinematics import Use
from identify.structure.nuisance import Kind, Nuisance
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
NEGATIVE = 5.0
CAUSES: dict[Kind, Cause] = {
    "gain": "gain",
    "position": "station",
    "delay": "delay",
    "high-pass": "filtered",
    "force gain": "gain",
    "mass": "mass",
    "frequency": "frequency",
    "damping": "damping",
}


def findings_before(recording: Recording, use: Use, tolerances: Tolerances | None) -> tuple[Finding, ...]:
    """Those of `check_recording`, but for a record that does not begin at rest: the fit takes it as it is."""
    return tuple(f for f in check_recording(recording, use, tolerances) if f.cause != "not at rest")


def widened(found: Joint, parameters: Sequence[Nuisance]) -> Joint:
    """Standard errors times the largest pull of what belongs to a whole body or to the force, where it is unusual.

    A clock, a density or a unit that is off shows there, and what it does beside is in no tolerance.
    """
    pulls = [abs(p) for p, of in zip(found.pulls, parameters, strict=True) if of.kind in WHOLE and of.mode is None]
    factor = max(pulls, default=0.0)
    if factor < USUAL:
        return found
    square = factor**2
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
                channels=(parameter.of,) if parameter.kind in ("gain", "position", "delay", "high-pass") else (),
                of=of,
                evidence=f"the contacts' fit asks for the {parameter.kind} of {of} to be {pull:+.2g} tolerances off",
                mend="check it (a clock that is off shifts all frequencies alike), or widen its tolerance",
            )
    for name, fit in joints:
        damping, error = float(fit.values[-1]), float(fit.errors[-1])
        if damping < -NEGATIVE * error:
            yield _of_fit(name, f"{name} comes out with a negative damping of {damping:.3g} ± {error:.2g} N s/m")
        if max(np.abs(fit.halves)) > UNLIKE:
            yield _of_fit(name, f"{name} differs between the halves of the record by more than scatter makes")
        if fit.unexplained > UNEXPLAINED:
            yield _of_fit(name, f"no clearance and stiffness explain {100 * fit.unexplained:.2g} % of {name}'s force")


def _of_fit(contact: str, evidence: str) -> Finding:
    return Finding(
        cause="fit",
        of=contact,
        evidence=evidence,
        mend="do not rely on it: look at its force over the relative displacement, and ask identify gap what differs",
    )
