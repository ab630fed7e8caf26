"""The contacts of a recording in stages: separate, determine, accept; the paper's methods beside them, the report."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.contacts.acceptance import checked_contacts, equation_findings
from identify.contacts.determination import Outcomes
from identify.contacts.law_choice import FORMS
from identify.contacts.paper_methods import (
    PaperMethods,
    SignalsByLaw,
    check_asked,
    paper_methods,
    signals_by_law,
    stops_of,
)
from identify.contacts.results import ContactReport
from identify.contacts.summary import contact_report
from identify.linear.joined import Joined
from identify.paper.nifo import Nifo
from identify.paper.surface import Stops, Surface
from identify.signals.kinematics import Kinematics, Use
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording


@dataclass(frozen=True)
class Identification:
    """The report, and what it was drawn from, for figures and for further work.

    motion has the force and what was measured where, but not the stations' rows. eta_m is complete with its drift;
    separated_n are the contact forces at every `factor`-th sample, one of all contacts that are of the `same_place`.
    """

    report: ContactReport
    rig: Rig
    motion: Kinematics
    eta_m: Float[np.ndarray, "contacts samples"]
    same_place: tuple[Joined, ...]
    separated_n: Float[np.ndarray, "places fewer"]
    factor: int
    outcomes: Outcomes
    methods: PaperMethods
    tolerances: Tolerances

    @property
    def weak(self) -> Nifo:
        """NIFO's weak form of the main equation; raises RigError if there is none."""
        return self._forms[0]

    @property
    def paper(self) -> Nifo:
        """NIFO in the paper's form; raises RigError if there is none."""
        return self._forms[1]

    @property
    def surface(self) -> Surface:
        """Surface of the main equation; raises RigError if there is none."""
        for surface in self.methods.main_surfaces:
            return surface
        raise RigError("; ".join(self.methods.notes) or "no modal equation has a restoring force surface")

    @property
    def stops(self) -> tuple[Stops | None, ...]:
        return stops_of(self.rig, self.outcomes)

    @property
    def _forms(self) -> tuple[Nifo, ...]:
        if not self.methods.forms:
            raise RigError(
                "; ".join(self.methods.notes) or "NIFO needs a force, and the exciting force is zero throughout"
            )
        return self.methods.forms


@dataclass(frozen=True)
class _Answers:
    """Results of the first three stages, for the paper's methods and the report."""

    motion: Kinematics
    same_place: tuple[Joined, ...]
    separated_n: Float[np.ndarray, "places fewer"]
    factor: int
    outcomes: Outcomes
    findings: tuple[Finding, ...]
    signals: SignalsByLaw


def identify_contact(
    recording: Recording,
    *,
    use: Use = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Identification:
    """Clearance, stiffness and damping of every contact of a recording's rig.

    The contact forces are separated without a law, then each is fitted together with the slow drift of its relative
    displacement: these are the answers. With the law found, the modes beyond the fitted ones are taken off the
    motion, and the paper's methods are applied to every modal equation: the restoring force surface and NIFO. The main
    equation, which the figures show, is the one whose stiffness varies least over frequency, unless it is named
    ("barrel 3"). What cannot be made of them is a note of the report.

    Before all that the record is checked (`identify.checks`): what is wrong with it or with rig.json stands in the
    report's findings, beside what does not fit in the joint estimates.

    Raises RigError if the record does not allow it: too short, too few stations, no force; with the first finding.
    """
    averaging = averaging or Averaging()
    check_asked(recording, averaging, equation)
    rig = recording.rig
    answers = _answers(recording, use, tolerances)
    progress(0.5)
    alone = {place.members[0] for place in answers.same_place if len(place.members) == 1}
    methods = paper_methods(
        rig,
        answers.motion,
        answers.signals,
        stops_of(rig, answers.outcomes),
        alone=alone,
        averaging=averaging,
        equation=equation,
    )
    progress(0.95)
    names = [contact.name for contact in rig.contacts]
    findings = answers.findings + tuple(equation_findings(names, answers.outcomes.estimates, methods.spectra))
    return Identification(
        report=contact_report(rig, answers.outcomes, methods, findings),
        rig=rig,
        motion=methods.motion,
        eta_m=methods.eta_m,
        same_place=answers.same_place,
        separated_n=answers.separated_n,
        factor=answers.factor,
        outcomes=answers.outcomes,
        methods=methods,
        tolerances=tolerances or rig.tolerances or LABORATORY,
    )


def _answers(recording: Recording, use: Use, tolerances: Tolerances | None) -> _Answers:
    """Results without the nuisance signals over time, which take much memory."""
    contacts = checked_contacts(recording, use, tolerances, FORMS)
    separation = contacts.separation
    return _Answers(
        motion=separation.motion,
        same_place=separation.same_place,
        separated_n=separation.forces.force_n,
        factor=separation.forces.factor,
        outcomes=contacts.outcomes,
        findings=contacts.findings,
        signals=signals_by_law(separation, contacts.outcomes),
    )
