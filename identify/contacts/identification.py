"""The identification of the contacts: separated forces, joint estimate, and the paper's surface and NIFO beside it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks import naming
from identify.contacts.estimates import Contacts, find_contacts
from identify.contacts.joint import Joint
from identify.contacts.linearised import law_force_n
from identify.contacts.quality import equation_findings, findings_before, fit_findings
from identify.contacts.results import ContactReport
from identify.contacts.summary import contact_report
from identify.contacts.told import LOOSE, ContactFit
from identify.contacts.unforced import driven_to_hz, is_unforced, without_dead_force
from identify.linear.joined import Joined
from identify.linear.modal import modal_equations, pushing_force, transformation, until
from identify.paper.nifo import Nifo, nifo
from identify.paper.surface import Stops, Surface, clearance_from_occurrence, fit_surface
from identify.signals.kinematics import Kinematics, Use
from identify.signals.law_evaluation import penetration
from identify.signals.spectra import Averaging, blocks, force_band
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

LOWEST_HZ = 0.5
"""Lines below are not looked at: a free body's response there is drift."""
CLEAR_OF_CORNER = 4.0
"""NIFO on integrated accelerations begins at this multiple of the corner, clear of what the blocks leak over it."""
EQUATIONS = 4


@dataclass(frozen=True)
class Identification:
    """The report, and what it was drawn from, for figures and for further work.

    motion has the force and what was measured where, but not the stations' rows. eta_m is complete with its drift;
    separated_n are the contact forces at every `factor`-th sample, one of all contacts that are of the `same_place`;
    estimates has one entry a contact. forms are NIFO's weak form and the paper's of the main equation; None of a record
    without a force.
    """

    report: ContactReport
    rig: Rig
    motion: Kinematics
    eta_m: Float[np.ndarray, "contacts samples"]
    same_place: tuple[Joined, ...]
    separated_n: Float[np.ndarray, "places fewer"]
    factor: int
    estimates: tuple[ContactFit, ...]
    surface: Surface
    forms: tuple[Nifo, Nifo] | None
    tolerances: Tolerances

    @property
    def weak(self) -> Nifo:
        return self._form(0)

    @property
    def paper(self) -> Nifo:
        return self._form(1)

    def _form(self, index: int) -> Nifo:
        if self.forms is None:
            raise RigError("NIFO needs a force, and the exciting force is zero throughout")
        return self.forms[index]

    @property
    def stops(self) -> tuple[Stops | None, ...]:
        return tuple(_stops(a) for a in self.estimates)


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
    ("barrel 3").

    Before all that the record is checked (`identify.checks`): what is wrong with it or with rig.json stands in the
    report's findings, beside what does not fit in the joint estimates.

    Raises RigError if the record does not allow it: too short, too few stations, no force; with the first finding.
    """
    averaging = averaging or Averaging()
    pushed = dict.fromkeys(station.body for station in recording.rig.forces)
    names = [f"{body} {i}" for body in pushed for i in range(1, EQUATIONS + 1)]
    if equation not in (None, *names):
        raise RigError(f"no modal equation {equation!r} with a measured force; there are {', '.join(names)}")
    findings = findings_before(recording, use, tolerances)
    progress(0.1)
    with naming(findings):
        found = find_contacts(recording, use, tolerances or recording.rig.tolerances or LABORATORY)
    names = [c.name for c in recording.rig.contacts]
    unforced = is_unforced(found.motion)
    findings = without_dead_force(findings, recording.force_names) if unforced else findings
    findings += tuple(fit_findings(names, found.estimates, found.separated.nuisances.parameters))
    progress(0.5)
    rig, motion, estimates, separated = found.rig, found.motion, found.estimates, found.separated.force_n
    factor, same_place = found.separated.factor, found.same_place
    bands = _bands(rig, motion, averaging)
    eta, force, depth = _with_law(found)
    del found  # the nuisance parameters over time take much memory
    motion = motion.part(slice(eta.shape[1]))
    kept = until(motion)
    eta, depth = eta[:, :kept], depth[:, :kept]
    stops = tuple(_stops(a) for a in estimates)
    alone = {place.members[0] for place in same_place if len(place.members) == 1}  # a histogram tells one knee a side
    cut = {body: blocks(kept, motion.sample_rate_hz, averaging, band) for body, band in bands.items()}
    equations = [e for body in rig.bodies for e in modal_equations(rig, motion, body, EQUATIONS, force)]
    motion = motion.part(slice(kept)).without_rows
    forced = [e for e in equations if e.shape_at_force != 0]
    acting = [] if unforced else [e for e in forced if e.body in cut]
    spectra = [nifo(e, pushing_force(rig, e, motion.forces_n), depth, cut[e.body]) for e in acting]
    findings += tuple(equation_findings(names, estimates, spectra))
    progress(0.7)
    coarse = _decimation(rig, motion)
    surfaces = [fit_surface(e, pushing_force(rig, e, motion.forces_n), eta, coarse, stops) for e in equations]
    progress(0.95)
    weak = _main(spectra, equation) if spectra else None
    name = weak.equation.name if weak else equation or forced[0].name
    forms = None
    if weak:
        exciting_n = pushing_force(rig, weak.equation, motion.forces_n)
        forms = (weak, nifo(weak.equation, exciting_n, depth, cut[weak.equation.body], "paper"))
    return Identification(
        report=contact_report(
            rig,
            motion,
            estimates=estimates,
            transformations=[transformation(rig, body, motion) for body in rig.bodies],
            surfaces=surfaces,
            histogram=[
                None if s is None or j not in alone else _by_histogram(eta[j, motion.excited_from :])
                for j, s in enumerate(stops)
            ],
            main_equation=name,
            spectra=spectra,
            findings=findings,
        ),
        rig=rig,
        motion=motion,
        eta_m=eta,
        same_place=same_place,
        separated_n=separated,
        factor=factor,
        estimates=estimates,
        surface=next(s for s in surfaces if s.equation.name == name),
        forms=forms,
        tolerances=tolerances or rig.tolerances or LABORATORY,
    )


def _bands(rig: Rig, motion: Kinematics, averaging: Averaging) -> dict[str, tuple[float, float]]:
    """By body the band of the forces on it, Hz; where none acts on any body that of the motion."""
    found = {}
    for body in dict.fromkeys(station.body for station in rig.forces):
        forces_n = motion.forces_n[[station.body == body for station in rig.forces]]
        if is_unforced(motion):
            low, high = 0.0, driven_to_hz(motion)
        elif np.any(forces_n):
            low, high = force_band(forces_n, motion.sample_rate_hz)
        else:
            continue
        found[body] = averaging.band_hz or (
            max(low, CLEAR_OF_CORNER * motion.trusted_hz[0], LOWEST_HZ),
            min(high, motion.trusted_hz[1]),
        )
    return found


def _with_law(
    contacts: Contacts,
) -> tuple[
    Float[np.ndarray, "contacts samples"], Float[np.ndarray, "contacts samples"], Float[np.ndarray, "contacts samples"]
]:
    """Relative displacement with its drift; contact force and penetration by the law found, zero where none was."""
    eta = np.empty((len(contacts.estimates), contacts.observed[0].eta_m.size))
    force, depth = np.zeros_like(eta), np.zeros_like(eta)
    for place, seen in zip(contacts.same_place, contacts.observed, strict=True):
        told = {j: contacts.estimates[j] for j in place.members}
        moved, rate = seen.eta_m, seen.velocity_m_per_s
        joints = [(f, s) for f, s in zip(told.values(), place.signs, strict=True) if isinstance(f, Joint)]
        for joint, sign in joints[:1]:  # they share the drift
            moved, rate = moved + sign * joint.drift_m, rate + sign * joint.drift_m_per_s
        for (j, found), side in zip(told.items(), place.signs, strict=True):
            eta[j] = side * moved
            if isinstance(found, Joint):
                lower, upper, _, _ = found.values.tolist()
                depth[j] = penetration(eta[j], lower, upper, seen.sample_rate_hz)
                force[j] = law_force_n(found.values, eta[j], side * rate)
    return eta, force, depth


def _stops(found: ContactFit) -> Stops | None:
    if not isinstance(found, Joint):
        return None
    (lower, upper, _, _), (of_lower, of_upper, _, _) = found.values.tolist(), found.errors.tolist()
    return Stops(lower, upper, of_lower, of_upper, found.clearance_error_m)


def _by_histogram(eta_m: Float[np.ndarray, " samples"]) -> Stops | None:
    """The stops by the histogram; None where it hardly tells them, as of a decay, which rests most of the time."""
    found = clearance_from_occurrence(eta_m)
    return found if found.clearance_error_m < LOOSE * found.clearance_m else None


def _decimation(rig: Rig, motion: Kinematics) -> int:
    """So that a surface is fitted below four fifths of the first frequency that the stations cannot resolve."""
    limits = [motion.trusted_hz[1]]
    for body in rig.bodies:
        stations = sum(s.body == body.name for s in motion.stations)
        if body.length_m > 0 and stations < body.max_modes:
            limits.append(0.8 * float(body.frequencies_hz(max(stations, body.rigid_modes) + 1)[-1]))
    return max(1, int(motion.sample_rate_hz / 2 / min(limits)))


def _main(spectra: list[Nifo], wanted: str | None) -> Nifo:
    """The equation that is wanted, or the one with the least deviation of the stiffnesses over frequency."""

    def deviation(result: Nifo) -> tuple[int, float]:
        return -len(result.contacts), float(np.max(result.deviation_n_per_m / np.abs(result.mean_n_per_m), initial=0.0))

    return min((n for n in spectra if wanted in (None, n.equation.name)), key=deviation)
