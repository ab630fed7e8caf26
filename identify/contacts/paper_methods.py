"""The paper's methods beside the answers: restoring force surface, histogram and NIFO of every modal equation.

No answer rests on them. What cannot be made is left out, and a note says why.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from identify.contacts.determination import UNCERTAIN_SHARE, Outcomes
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.separation import Separation
from identify.linear.modal import ModalEquation, Transformation, modal_equations, pushing_force, transformation, until
from identify.paper.nifo import Form, Nifo, nifo
from identify.paper.surface import Stops, Surface, clearance_from_occurrence, fit_surface
from identify.signals.kinematics import Kinematics
from identify.signals.law_evaluation import evaluated
from identify.signals.spectra import Averaging, Blocks, blocks, force_band
from rig.errors import RigError
from rig.model.description import Body, Rig
from rig.recording import Recording

LOWEST_HZ = 0.5
"""Lines below are not looked at: a free body's response there is drift."""
CLEAR_OF_CORNER = 4.0
"""NIFO on integrated accelerations begins at this multiple of the corner, clear of what the blocks leak over it."""
EQUATIONS = 4
"""So many modal equations of each body, or as many as it has modes or stations."""

Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True)
class SignalsByLaw:
    """Signals of each contact: the relative displacement with its drift, and force and penetration by the law that was
    found: zero where none was.
    """

    eta_m: Float[np.ndarray, "contacts samples"]
    force_n: Float[np.ndarray, "contacts samples"]
    penetration_m: Float[np.ndarray, "contacts samples"]


@dataclass(frozen=True)
class PaperMethods:
    """Results of the paper's methods; notes say which could not be computed, and why.

    motion and eta_m are those that they were applied to, transformations those of the bodies. histogram has the stops
    of each contact, None where its density does not tell them. main_equation is what the figures show; forms are NIFO's
    weak form and the paper's of it, empty where there is none, as of a record without a force.
    """

    motion: Kinematics
    eta_m: Float[np.ndarray, "contacts samples"]
    transformations: tuple[Transformation, ...]
    surfaces: tuple[Surface, ...]
    histogram: tuple[Stops | None, ...]
    spectra: tuple[Nifo, ...]
    main_equation: str
    forms: tuple[Nifo, ...]
    notes: tuple[str, ...]

    @property
    def main_surfaces(self) -> tuple[Surface, ...]:
        """Surfaces of the main equation, as far as they could be computed."""
        return tuple(s for s in self.surfaces if s.equation.name == self.main_equation)


def attempted(notes: list[str], what: str, items: Mapping[str, Item], make: Callable[[Item], Made]) -> dict[str, Made]:
    """Results of `make` for each item, by its name; where these numbers allow none, a note instead."""
    made = {}
    for name, item in items.items():
        try:
            made[name] = make(item)
        except (ValueError, ArithmeticError) as error:  # RigError and LinAlgError are ValueErrors
            notes.append(f"{what} of {name} cannot be made: {error}")
    return made


def check_asked(recording: Recording, averaging: Averaging, equation: str | None) -> None:
    """Raises RigError if there is no such equation, or blocks that were asked for do not fit the record."""
    rig = recording.rig
    driven = [rig.body(name) for name in dict.fromkeys(station.body for station in rig.forces)]
    names = [f"{body.name} {i}" for body in driven for i in range(1, 1 + min(EQUATIONS, body.max_modes))]
    if equation not in (None, *names):
        raise RigError(f"no modal equation {equation!r} with a measured force; there are {', '.join(names)}")
    if averaging != Averaging():
        rate_hz = rig.sample_rate_hz
        blocks(round(recording.duration_s * rate_hz), rate_hz, averaging, averaging.band_hz or (0.0, rate_hz / 4))


def signals_by_law(separation: Separation, outcomes: Outcomes) -> SignalsByLaw:
    """Signals of contacts between the same places, whose estimates share the drift, each in its own direction."""
    names = [c.name for c in separation.rig.contacts]
    eta = np.empty((len(names), separation.records[0].eta_m.size))
    force, depth = np.zeros_like(eta), np.zeros_like(eta)
    for place, record in zip(separation.same_place, separation.records, strict=True):
        moved, rate = record.eta_m, record.velocity_m_per_s
        signs = dict(zip((names[j] for j in place.members), place.signs, strict=True))
        told = [name for name in signs if name in outcomes.estimates]
        for name in told[:1]:
            shared = outcomes.estimates[name]
            moved, rate = moved + signs[name] * shared.drift_m, rate + signs[name] * shared.drift_m_per_s
        for j, sign in zip(place.members, place.signs, strict=True):
            eta[j] = sign * moved
            for estimate in [outcomes.estimates[names[j]]] if names[j] in told else []:
                depth[j] = evaluated(estimate.spring_m, eta[j][None], record.sample_rate_hz)
                force[j] = estimate.force_n(eta[j], sign * rate)
    return SignalsByLaw(eta, force, depth)


def stops_of(rig: Rig, outcomes: Outcomes) -> tuple[Stops | None, ...]:
    """Stops of each contact of the rig; None where the record does not determine it."""
    return tuple(_stops(outcomes.estimates[c.name]) if c.name in outcomes.estimates else None for c in rig.contacts)


def _stops(estimate: JointEstimate) -> Stops:
    (lower, upper, _, _), (of_lower, of_upper, _, _) = estimate.values.tolist(), estimate.errors.tolist()
    return Stops(lower, upper, of_lower, of_upper, estimate.clearance_error_m, estimate.touched)


def paper_methods(
    rig: Rig,
    motion: Kinematics,
    signals: SignalsByLaw,
    stops: tuple[Stops | None, ...],
    *,
    alone: set[int],
    averaging: Averaging,
    equation: str | None,
) -> PaperMethods:
    """All of them, with the response of the modes beyond the fitted ones taken off the motion.

    The histogram tells one knee a side, so only that of contacts that are alone between their places is taken. The main
    equation is the one that is asked for, or the one whose stiffnesses vary least over frequency.
    """
    notes: list[str] = []
    motion = motion.part(slice(signals.eta_m.shape[1]))
    kept = until(motion)
    eta, depth = signals.eta_m[:, :kept], signals.penetration_m[:, :kept]
    cut = _blocks(rig, motion, kept, averaging, notes)
    bodies = {body.name: body for body in rig.bodies}
    transformations = attempted(notes, "the modal transformation", bodies, lambda b: transformation(rig, b, motion))
    of_bodies = attempted(
        notes,
        "the modal equations",
        {name: bodies[name] for name in transformations},
        partial(_equations, rig, motion, signals.force_n),
    )
    equations = {e.name: e for of_body in of_bodies.values() for e in of_body}
    motion = motion.part(slice(kept)).without_rows
    forced = {name: e for name, e in equations.items() if e.shape_at_force != 0}
    acting = {name: e for name, e in forced.items() if e.body in cut}

    def by_nifo(of: ModalEquation, form: Form = "weak") -> Nifo:
        return nifo(of, pushing_force(rig, of, motion.forces_n), depth, cut[of.body], form)

    def by_surface(of: ModalEquation) -> Surface:
        return fit_surface(of, pushing_force(rig, of, motion.forces_n), eta, coarse, stops)

    coarse = _decimation(rig, motion)
    spectra = attempted(notes, "NIFO", acting, by_nifo)
    surfaces = attempted(notes, "the restoring force surface", equations, by_surface)
    single = {
        rig.contacts[j].name: (eta[j, motion.excited_from :], stop.touched)
        for j, stop in enumerate(stops)
        if stop and j in alone
    }
    histogram = attempted(notes, "the histogram", single, _by_histogram)
    main = _main(spectra, forced, equation, notes)
    shown = {main: spectra[main]} if main in spectra else {}
    paper = attempted(notes, "the paper's form of NIFO", shown, lambda weak: by_nifo(weak.equation, "paper"))
    return PaperMethods(
        motion=motion,
        eta_m=eta,
        transformations=tuple(transformations.values()),
        surfaces=tuple(surfaces.values()),
        histogram=tuple(histogram.get(contact.name) for contact in rig.contacts),
        spectra=tuple(spectra.values()),
        main_equation=main,
        forms=(*shown.values(), *paper.values()) if paper else (),
        notes=tuple(notes),
    )


def _equations(
    rig: Rig, motion: Kinematics, force_n: Float[np.ndarray, "contacts samples"], body: Body
) -> tuple[ModalEquation, ...]:
    return modal_equations(rig, motion, body, EQUATIONS, force_n)


def _blocks(rig: Rig, motion: Kinematics, kept: int, averaging: Averaging, notes: list[str]) -> dict[str, Blocks]:
    """Blocks of NIFO by body, in the band of the forces on it; none of a body on which no force acts."""
    acting = {}
    for body in dict.fromkeys(station.body for station in rig.forces):
        forces_n = motion.forces_n[[station.body == body for station in rig.forces]]
        if np.any(forces_n):
            acting[body] = forces_n

    def cut(forces_n: Float[np.ndarray, "forces samples"]) -> Blocks:
        low, high = force_band(forces_n, motion.sample_rate_hz)
        band = averaging.band_hz or (
            max(low, CLEAR_OF_CORNER * motion.trusted_hz[0], LOWEST_HZ),
            min(high, motion.trusted_hz[1]),
        )
        return blocks(kept, motion.sample_rate_hz, averaging, band)

    return attempted(notes, "NIFO of the equations", acting, cut)


def _by_histogram(of: tuple[Float[np.ndarray, " samples"], tuple[bool, bool]]) -> Stops | None:
    """The stops by the histogram of a relative displacement that touches these; None where it hardly tells them, as of
    a decay, which rests most of the time."""
    eta_m, touched = of
    stops = replace(clearance_from_occurrence(eta_m), touched=touched)
    return stops if stops.clearance_error_m < UNCERTAIN_SHARE * stops.clearance_m else None


def _decimation(rig: Rig, motion: Kinematics) -> int:
    """Decimation by which a surface is fitted below four fifths of the first frequency that stations do not resolve."""
    limits = [motion.trusted_hz[1]]
    for body in rig.bodies:
        stations = sum(s.body == body.name for s in motion.stations)
        if body.length_m > 0 and stations < body.max_modes:
            modes = min(max(stations, body.rigid_modes) + 1, body.max_modes)
            limits.append(0.8 * float(body.frequencies_hz(modes)[-1]))
    return max(1, int(motion.sample_rate_hz / 2 / min(limits)))


def _main(
    spectra: Mapping[str, Nifo], forced: Mapping[str, ModalEquation], wanted: str | None, notes: list[str]
) -> str:
    """The name of the equation that is wanted, or of the one whose stiffnesses deviate least over frequency; without
    NIFO of the first on which a force acts. Empty if there is none."""
    usable = spectra or forced
    if wanted in usable:
        return str(wanted)
    if wanted is not None:
        notes.append(f"the modal equation {wanted} cannot be made; the figures show another one")

    def deviation(name: str) -> tuple[int, float]:
        weak = spectra[name]
        return -len(weak.contacts), float(np.max(weak.deviation_n_per_m / np.abs(weak.mean_n_per_m), initial=0.0))

    return min(spectra, key=deviation) if spectra else next(iter(forced), "")
