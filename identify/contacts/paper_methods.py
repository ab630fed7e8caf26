"""Methods of the paper: restoring force surface, histogram and NIFO of every modal equation.

No estimate of the joint fit rests on them. A method that fails is left out, and a note says why.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from identify.contacts.joint_fit import JointEstimate
from identify.contacts.outcomes import UNCERTAIN_SHARE, Outcomes
from identify.contacts.separation import Separation
from identify.linear.modal import (
    ModalEquation,
    Transformation,
    correctable_samples,
    modal_equations,
    pushing_force,
    transformation,
)
from identify.paper.nifo import Form, Nifo, nifo
from identify.paper.surface import Stops, Surface, clearance_from_occurrence, fit_surface
from identify.signals.kinematics import Kinematics
from identify.signals.law_evaluation import evaluated_law
from identify.signals.spectra import Averaging, Blocks, blocks, force_band
from rig.errors import RigError
from rig.model.description import Body, Rig
from rig.recording import Recording

LOWEST_HZ = 0.5
"""Lowest frequency of NIFO: a free body's response below it is drift."""
CLEAR_OF_CORNER = 4.0
"""Lowest frequency of NIFO on integrated accelerations over the corner frequency, clear of the blocks' leakage."""
EQUATIONS = 4
"""Modal equations of each body, or as many as it has modes or stations."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class SignalsByLaw:
    """Signals of each contact: relative displacement with its drift, and force and penetration by the estimated law;
    zero without an estimate.
    """

    eta_m: Float[np.ndarray, "contacts samples"]
    force_n: Float[np.ndarray, "contacts samples"]
    penetration_m: Float[np.ndarray, "contacts samples"]


@dataclass(frozen=True)
class PaperMethods:
    """Results of the paper's methods; notes say which could not be computed, and why.

    motion and eta_m are the inputs, transformations those of the bodies. histogram has the stops of each contact, None
    where the density does not show them. main_equation is the one that the figures show; forms are its NIFO in the weak
    form and in the paper's, empty without NIFO, as of a record without a force.
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


def attempted(
    notes: list[str], description: str, items: Mapping[str, Item], make: Callable[[Item], Result]
) -> dict[str, Result]:
    """Results of `make` for each item, by its name; a note for each item where it fails numerically."""
    results = {}
    for name, item in items.items():
        try:
            results[name] = make(item)
        except (ValueError, ArithmeticError) as error:  # RigError and LinAlgError are ValueErrors
            notes.append(f"{description} of {name} cannot be made: {error}")
    return results


def check_request(recording: Recording, averaging: Averaging, equation: str | None) -> None:
    """Raises RigError if there is no such equation, or if the requested blocks do not fit the record."""
    rig = recording.rig
    names = [f"{body.name} {i}" for body in driven_bodies(rig) for i in range(1, 1 + min(EQUATIONS, body.max_modes))]
    if equation not in (None, *names):
        raise RigError(f"no modal equation {equation!r} with a measured force; there are {', '.join(names)}")
    if averaging != Averaging():
        rate_hz = rig.sample_rate_hz
        blocks(round(recording.duration_s * rate_hz), rate_hz, averaging, averaging.band_hz or (0.0, rate_hz / 4))


def driven_bodies(rig: Rig) -> list[Body]:
    """Bodies on which a measured force acts: all where a measured base shakes."""
    names = [body.name for body in rig.bodies] if rig.base_sensors else [station.body for station in rig.inputs]
    return [rig.body(name) for name in dict.fromkeys(names)]


def signals_by_law(separation: Separation, outcomes: Outcomes) -> SignalsByLaw:
    """Signals of contacts between the same places, whose estimates share the drift, each in its own direction."""
    names = [c.name for c in separation.rig.contacts]
    eta = np.empty((len(names), separation.records[0].eta_m.size))
    force, depth = np.zeros_like(eta), np.zeros_like(eta)
    for place, record in zip(separation.same_place, separation.records, strict=True):
        eta_m, rate = record.eta_m, record.velocity_m_per_s
        signs = dict(zip((names[j] for j in place.members), place.signs, strict=True))
        determined = [name for name in signs if name in outcomes.estimates]
        if determined:
            estimate, sign = outcomes.estimates[determined[0]], signs[determined[0]]
            eta_m, rate = eta_m + sign * estimate.drift_m, rate + sign * estimate.drift_m_per_s
        for j, sign in zip(place.members, place.signs, strict=True):
            eta[j] = sign * eta_m
            if names[j] in determined:
                estimate = outcomes.estimates[names[j]]
                depth[j] = evaluated_law(estimate.spring_m, eta[j][None], record.sample_rate_hz)
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
    single_contacts: set[int],
    averaging: Averaging,
    equation: str | None,
) -> PaperMethods:
    """Results of all methods on the motion less the response of the modes beyond the fitted ones.

    The histogram shows one knee a side, so it is applied only to contacts in `single_contacts`, which share their
    places with no other. The main equation is the requested one, or the one whose stiffnesses vary least over
    frequency.
    """
    notes: list[str] = []
    motion = motion.segment(slice(signals.eta_m.shape[1]))
    samples = correctable_samples(motion)
    eta, depth = signals.eta_m[:, :samples], signals.penetration_m[:, :samples]
    blocks_by_body = _blocks(rig, motion, samples, averaging, notes)
    bodies = {body.name: body for body in rig.bodies}
    transformations = attempted(notes, "the modal transformation", bodies, lambda b: transformation(rig, b, motion))
    of_bodies = attempted(
        notes,
        "the modal equations",
        {name: bodies[name] for name in transformations},
        partial(_equations, rig, motion, signals.force_n),
    )
    equations = {e.name: e for of_body in of_bodies.values() for e in of_body}
    motion = motion.segment(slice(samples)).without_rows
    forced = {name: e for name, e in equations.items() if e.shape_at_force != 0}
    acting = {name: e for name, e in forced.items() if e.body in blocks_by_body}

    def by_nifo(modal: ModalEquation, form: Form = "weak") -> Nifo:
        return nifo(modal, pushing_force(rig, modal, motion.forces_n), depth, blocks_by_body[modal.body], form)

    def by_surface(modal: ModalEquation) -> Surface:
        return fit_surface(modal, pushing_force(rig, modal, motion.forces_n), eta, coarse, stops)

    coarse = _decimation(rig, motion)
    spectra = attempted(notes, "NIFO", acting, by_nifo)
    surfaces = attempted(notes, "the restoring force surface", equations, by_surface)
    single = {
        rig.contacts[j].name: (eta[j, motion.excited_from :], stop.touched)
        for j, stop in enumerate(stops)
        if stop and j in single_contacts
    }
    histogram = attempted(notes, "the histogram", single, _by_histogram)
    main = _main_equation(spectra, forced, equation, notes)
    main_spectra = {main: spectra[main]} if main in spectra else {}
    paper = attempted(notes, "the paper's form of NIFO", main_spectra, lambda weak: by_nifo(weak.equation, "paper"))
    return PaperMethods(
        motion=motion,
        eta_m=eta,
        transformations=tuple(transformations.values()),
        surfaces=tuple(surfaces.values()),
        histogram=tuple(histogram.get(contact.name) for contact in rig.contacts),
        spectra=tuple(spectra.values()),
        main_equation=main,
        forms=(*main_spectra.values(), *paper.values()) if paper else (),
        notes=tuple(notes),
    )


def _equations(
    rig: Rig, motion: Kinematics, force_n: Float[np.ndarray, "contacts samples"], body: Body
) -> tuple[ModalEquation, ...]:
    return modal_equations(rig, motion, body, EQUATIONS, force_n)


def _blocks(rig: Rig, motion: Kinematics, samples: int, averaging: Averaging, notes: list[str]) -> dict[str, Blocks]:
    """Blocks of NIFO by body, in the band of the forces on it; none for a body without force."""
    acting = {}
    for body in driven_bodies(rig):
        acts = [station.body == body.name or rig.is_on_ground(station) for station in rig.inputs]
        if np.any(forces_n := motion.forces_n[acts]):
            acting[body.name] = forces_n

    def body_blocks(forces_n: Float[np.ndarray, "forces samples"]) -> Blocks:
        low, high = force_band(forces_n, motion.sample_rate_hz)
        band = averaging.band_hz or (
            max(low, CLEAR_OF_CORNER * motion.trusted_hz[0], LOWEST_HZ),
            min(high, motion.trusted_hz[1]),
        )
        return blocks(samples, motion.sample_rate_hz, averaging, band)

    return attempted(notes, "NIFO of the equations", acting, body_blocks)


def _by_histogram(of: tuple[Float[np.ndarray, " samples"], tuple[bool, bool]]) -> Stops | None:
    """Stops by the histogram of a relative displacement, which touches the given sides; None if too uncertain, as of a
    decay, which rests most of the time."""
    eta_m, touched = of
    stops = replace(clearance_from_occurrence(eta_m), touched=touched)
    return stops if stops.clearance_error_m < UNCERTAIN_SHARE * stops.clearance_m else None


def _decimation(rig: Rig, motion: Kinematics) -> int:
    """Decimation of a surface, to four fifths of the lowest natural frequency that the stations do not resolve."""
    limits = [motion.trusted_hz[1]]
    for body in rig.bodies:
        stations = sum(s.body == body.name for s in motion.stations)
        if body.length_m > 0 and stations < body.max_modes:
            modes = min(max(stations, body.rigid_modes) + 1, body.max_modes)
            limits.append(0.8 * float(body.frequencies_hz(modes)[-1]))
    return max(1, int(motion.sample_rate_hz / 2 / min(limits)))


def _main_equation(
    spectra: Mapping[str, Nifo], forced: Mapping[str, ModalEquation], requested: str | None, notes: list[str]
) -> str:
    """Name of the requested equation, or of the one whose stiffnesses deviate least over frequency; without NIFO, of
    the first with a force. Empty if there is none."""
    usable = spectra or forced
    if requested in usable:
        return str(requested)
    if requested is not None:
        notes.append(f"the modal equation {requested} cannot be made; the figures show another one")

    def deviation(name: str) -> tuple[int, float]:
        weak = spectra[name]
        return -len(weak.contacts), float(np.max(weak.deviation_n_per_m / np.abs(weak.mean_n_per_m), initial=0.0))

    return min(spectra, key=deviation) if spectra else next(iter(forced), "")
