"""Methods of the paper: restoring force surface, histogram and NIFO of every modal equation.

No estimate of the joint fit rests on them. A method that fails is left out, and a note says why.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from identify.contacts.joint_fit import JointEstimate
from identify.contacts.outcomes import UNCERTAIN_SHARE, Outcomes
from identify.contacts.separation import Separation
from identify.linear.modal import (
    ModalEquation,
    Transformation,
    correctable_sample_count,
    equivalent_force_n,
    modal_equations,
    transformation,
)
from identify.paper.nifo import Nifo, NifoForm, nifo
from identify.paper.surface import Stops, Surface, fit_surface, stops_from_eta_density
from identify.signals.kinematics import Kinematics
from identify.signals.law_evaluation import evaluated_law
from identify.signals.spectra import Averaging, Blocks, blocks, force_band_hz
from rig.errors import RigError
from rig.model.description import Body, Rig
from rig.recording import Recording

LOWEST_NIFO_HZ = 0.5
"""Lowest frequency of NIFO: a free body's response below it is drift."""
LOWEST_NIFO_CORNER_RATIO = 4.0
"""Lowest frequency of NIFO on integrated accelerations over the corner frequency, clear of the blocks' leakage."""
MAX_EQUATIONS_PER_BODY = 4
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
    force_over_stiffness_m: Float[np.ndarray, "contacts samples"]


@dataclass(frozen=True)
class PaperMethods:
    """Results of the paper's methods; notes say which could not be computed, and why.

    motion and eta_m are the inputs, transformations those of the bodies. histogram has the stops of each contact, None
    where the density does not show them. main_equation is the one that the figures show; main_nifo_results are its
    NIFO in the weak form and in the paper's, empty without NIFO, as of a record without a force.
    """

    motion: Kinematics
    eta_m: Float[np.ndarray, "contacts samples"]
    transformations: tuple[Transformation, ...]
    surfaces: tuple[Surface, ...]
    histogram: tuple[Stops | None, ...]
    nifo_results: tuple[Nifo, ...]
    main_equation: str
    main_nifo_results: tuple[Nifo, ...]
    notes: tuple[str, ...]

    @property
    def main_surfaces(self) -> tuple[Surface, ...]:
        """Surfaces of the main equation, as far as they could be computed."""
        return tuple(surface for surface in self.surfaces if surface.equation.name == self.main_equation)


def results_or_notes_by_name(
    notes: list[str], description: str, inputs_by_name: Mapping[str, Item], compute: Callable[[Item], Result]
) -> dict[str, Result]:
    """Results of `compute` for each input, by its name; a note for each where it fails numerically."""
    results = {}
    for name, method_input in inputs_by_name.items():
        try:
            results[name] = compute(method_input)
        except (ValueError, ArithmeticError) as error:  # RigError and LinAlgError are ValueErrors
            notes.append(f"{description} of {name} cannot be made: {error}")
    return results


def check_equation_and_averaging(recording: Recording, averaging: Averaging, equation: str | None) -> None:
    """Raises RigError if there is no such equation, or if the requested blocks do not fit the record."""
    rig = recording.rig
    equation_names = [
        f"{body.name} {mode_number}"
        for body in driven_bodies(rig)
        for mode_number in range(1, 1 + min(MAX_EQUATIONS_PER_BODY, body.max_modes))
    ]
    if equation not in (None, *equation_names):
        raise RigError(f"no modal equation {equation!r} with a measured force; there are {', '.join(equation_names)}")
    if averaging != Averaging():
        rate_hz = rig.sample_rate_hz
        blocks(round(recording.duration_s * rate_hz), rate_hz, averaging, averaging.band_hz or (0.0, rate_hz / 4))


def driven_bodies(rig: Rig) -> list[Body]:
    """Bodies on which a measured force acts: all where a measured base shakes."""
    body_names = [body.name for body in rig.bodies] if rig.base_sensors else [station.body for station in rig.inputs]
    return [rig.body(name) for name in dict.fromkeys(body_names)]


def signals_by_law(separation: Separation, outcomes: Outcomes) -> SignalsByLaw:
    """Signals of contacts between the same places, whose estimates share the drift, each in its own direction."""
    contact_names = [contact.name for contact in separation.rig.contacts]
    eta = np.empty((len(contact_names), separation.records[0].eta_m.size))
    force_n, force_over_stiffness_m = np.zeros_like(eta), np.zeros_like(eta)
    for group, record in zip(separation.contact_groups, separation.records, strict=True):
        eta_m, velocity, rate_hz = record.eta_m, record.velocity_m_per_s, record.sample_rate_hz
        signs = dict(zip(group.contact_indices, group.signs, strict=True))
        estimates = {k: outcomes.estimates[contact_names[k]] for k in signs if contact_names[k] in outcomes.estimates}
        if estimates:
            k, estimate = next(iter(estimates.items()))
            eta_m, velocity = eta_m + signs[k] * estimate.drift_m, velocity + signs[k] * estimate.drift_m_per_s
        for k, sign in signs.items():
            eta[k] = sign * eta_m
            if k in estimates:
                force_over_stiffness_m[k] = evaluated_law(
                    estimates[k].spring_force_over_stiffness_m, eta[k][None], rate_hz
                )
                force_n[k] = estimates[k].force_n(eta[k], sign * velocity)
    return SignalsByLaw(eta, force_n, force_over_stiffness_m)


def stops_of(rig: Rig, outcomes: Outcomes) -> tuple[Stops | None, ...]:
    """Stops of each contact of the rig; None where the record does not determine it."""
    estimates = [outcomes.estimates.get(contact.name) for contact in rig.contacts]
    return tuple(None if estimate is None else _stops(estimate) for estimate in estimates)


def _stops(estimate: JointEstimate) -> Stops:
    (lower_m, upper_m, _, _), (lower_error, upper_error, _, _) = estimate.values.tolist(), estimate.errors.tolist()
    return Stops(lower_m, upper_m, lower_error, upper_error, estimate.clearance_error_m, estimate.touched)


def paper_methods(
    rig: Rig,
    motion: Kinematics,
    signals: SignalsByLaw,
    stops: tuple[Stops | None, ...],
    *,
    single_contacts: set[int],
    averaging: Averaging,
    equation: str | None,
    with_surfaces: bool = True,
) -> PaperMethods:
    """Results of all methods on the motion less the response of the modes beyond the fitted ones.

    The histogram shows one knee a side, so it is applied only to contacts in `single_contacts`, which share their
    places with no other. The main equation is the requested one, or the one whose stiffnesses vary least over
    frequency.
    """
    notes: list[str] = []
    motion = motion.segment(slice(signals.eta_m.shape[1]))
    sample_count = correctable_sample_count(motion)
    etas_m, force_over_stiffness_m = signals.eta_m[:, :sample_count], signals.force_over_stiffness_m[:, :sample_count]
    blocks_by_body = _blocks_by_body(rig, motion, sample_count, averaging, notes)
    uncorrected_motion, bodies = motion, {body.name: body for body in rig.bodies}

    def body_transformation(body: Body) -> Transformation:
        return transformation(rig, body, uncorrected_motion)

    def body_equations(transformation: Transformation) -> tuple[ModalEquation, ...]:
        return modal_equations(rig, uncorrected_motion, transformation.body, MAX_EQUATIONS_PER_BODY, signals.force_n)

    transformations = results_or_notes_by_name(notes, "the modal transformation", bodies, body_transformation)
    equations_by_body = results_or_notes_by_name(notes, "the modal equations", transformations, body_equations)
    equations = {e.name: e for row in equations_by_body.values() for e in row}
    motion = motion.segment(slice(sample_count)).without_motion
    driven_equations = {name: e for name, e in equations.items() if e.shape_at_force != 0}
    nifo_equations = {name: e for name, e in driven_equations.items() if e.body in blocks_by_body}
    surface_decimation = _surface_decimation(rig, motion)

    def nifo_of(modal: ModalEquation, form: NifoForm = "weak") -> Nifo:
        force_n = equivalent_force_n(rig, modal, motion.forces_n)
        return nifo(modal, force_n, force_over_stiffness_m, blocks_by_body[modal.body], form)

    def surface_of(modal: ModalEquation) -> Surface:
        return fit_surface(modal, equivalent_force_n(rig, modal, motion.forces_n), etas_m, surface_decimation, stops)

    nifo_results = results_or_notes_by_name(notes, "NIFO", nifo_equations, nifo_of)
    surface_equations = equations if with_surfaces else {}
    surfaces = results_or_notes_by_name(notes, "the restoring force surface", surface_equations, surface_of)
    histogram_inputs = {
        contact.name: (etas_m[k, motion.excited_from :], stop.touched)
        for k, (contact, stop) in enumerate(zip(rig.contacts, stops, strict=True))
        if stop and k in single_contacts
    }
    histogram_stops = results_or_notes_by_name(notes, "the histogram", histogram_inputs, _histogram_stops)
    main_equation_name = _main_equation_name(nifo_results, driven_equations, equation, notes)
    main_results = {main_equation_name: nifo_results[main_equation_name]} if main_equation_name in nifo_results else {}
    main_equations = {name: spectrum.equation for name, spectrum in main_results.items()}
    paper_results = results_or_notes_by_name(
        notes, "the paper's form of NIFO", main_equations, lambda e: nifo_of(e, "paper")
    )
    return PaperMethods(
        motion=motion,
        eta_m=etas_m,
        transformations=tuple(transformations.values()),
        surfaces=tuple(surfaces.values()),
        histogram=tuple(histogram_stops.get(contact.name) for contact in rig.contacts),
        nifo_results=tuple(nifo_results.values()),
        main_equation=main_equation_name,
        main_nifo_results=(*main_results.values(), *paper_results.values()) if paper_results else (),
        notes=tuple(notes),
    )


def _blocks_by_body(
    rig: Rig, motion: Kinematics, sample_count: int, averaging: Averaging, notes: list[str]
) -> dict[str, Blocks]:
    """Blocks of NIFO by body, in the band of the forces on it; none for a body without force."""
    forces_by_body_n = {}
    for body in driven_bodies(rig):
        acts_on_body = [station.body == body.name or rig.is_on_ground(station) for station in rig.inputs]
        if np.any(forces_n := motion.forces_n[acts_on_body]):
            forces_by_body_n[body.name] = forces_n

    def body_blocks(forces_n: Float[np.ndarray, "forces samples"]) -> Blocks:
        low_hz, high_hz = force_band_hz(forces_n, motion.sample_rate_hz)
        trusted_from_hz, trusted_to_hz = motion.trusted_hz
        low_hz = max(low_hz, LOWEST_NIFO_CORNER_RATIO * trusted_from_hz, LOWEST_NIFO_HZ)
        band_hz = averaging.band_hz or (low_hz, min(high_hz, trusted_to_hz))
        return blocks(sample_count, motion.sample_rate_hz, averaging, band_hz)

    return results_or_notes_by_name(notes, "NIFO of the equations", forces_by_body_n, body_blocks)


def _histogram_stops(eta_and_touched: tuple[Float[np.ndarray, " samples"], tuple[bool, bool]]) -> Stops | None:
    """Stops by the histogram of a relative displacement, which touches the given sides; None if too uncertain, as of a
    decay, which rests most of the time."""
    eta_m, touched = eta_and_touched
    stops = replace(stops_from_eta_density(eta_m), touched=touched)
    return stops if stops.clearance_error_m < UNCERTAIN_SHARE * stops.clearance_m else None


def _surface_decimation(rig: Rig, motion: Kinematics) -> int:
    """Decimation of a surface, to four fifths of the lowest natural frequency that the stations do not resolve."""
    limits_hz = [motion.trusted_hz[1]]
    for body in rig.bodies:
        station_count = sum(station.body == body.name for station in motion.stations)
        if body.length_m > 0 and station_count < body.max_modes:
            mode_number = min(max(station_count, body.rigid_modes) + 1, body.max_modes)
            limits_hz.append(0.8 * float(body.frequencies_hz(mode_number)[-1]))
    return max(1, int(motion.sample_rate_hz / 2 / min(limits_hz)))


def _main_equation_name(
    nifo_results: Mapping[str, Nifo],
    driven_equations: Mapping[str, ModalEquation],
    requested_name: str | None,
    notes: list[str],
) -> str:
    """Name of the requested equation, or of the one whose stiffnesses deviate least over frequency; without NIFO, of
    the first with a force. Empty if there is none."""
    if requested_name in (nifo_results or driven_equations):
        return str(requested_name)
    if requested_name is not None:
        notes.append(f"the modal equation {requested_name} cannot be made; the figures show another one")

    def count_and_deviation(name: str) -> tuple[int, float]:
        weak_nifo = nifo_results[name]
        deviation_shares = weak_nifo.deviation_n_per_m / np.abs(weak_nifo.mean_n_per_m)
        return -len(weak_nifo.contact_indices), float(np.max(deviation_shares, initial=0.0))

    return min(nifo_results, key=count_and_deviation) if nifo_results else next(iter(driven_equations), "")
