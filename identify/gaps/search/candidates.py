"""Candidates: every effect of the library at every place where it can act, and its derivative of the residuals."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace

from identify.gaps.residual.linear import LinearModel, sensor_places_of, signals_by_forces
from identify.gaps.residual.nuisance import residual_in_time
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, ResidualColumn, contact_columns, residual_decrease
from identify.gaps.residual.windowed import displacements_at_elements, ground_forces
from identify.linear.joined import contact_groups
from rig.effects import effects
from rig.effects.base import Effect, Place, Scale
from rig.errors import RigError
from rig.model.description import Rig, Station
from rig.model.parameters import Parameter, ParameterSet

PLACE_GRID_COUNT = 9
"""Trial values of a parameter that is a place or a frequency, not a strength."""
RATIO_GRID_COUNT = 8
"""Trial values of a ratio over its whole range."""
STEP_SHARE = 0.05
"""Step for derivatives, as a share of what the typical effect adds. Set by hand."""
ATTACHED_FIELDS = ("springs", "dampers", "masses", "tones")
"""Fields of a rig for what is attached to, or acts at, a point of a body."""
STOP_STIFFNESSES = ("contact_stiffness", "one_stop")
"""Effects on the stiffness of both stops of a contact, and of one."""


@dataclass(frozen=True)
class Candidate:
    """Effect at a place: a typical one, and the ranges of its parameters, the strength first.

    The effect vanishes where all parameters that have a neutral value are at it. The other parameters are places or
    frequencies, of which `start_values` gives trial values. An effect with a twin place acts there too
    (`residual.unfolding`).
    """

    kind: type[Effect]
    place: Place
    parameters: ParameterSet
    typical_effect: Effect
    twin_place: Place | None = None

    @property
    def name(self) -> str:
        return ":".join([self.kind.name, *(target or "all" for target in self.place.values())])

    @property
    def neutral_strength(self) -> float:
        """Strength without the effect."""
        return next(parameter.neutral for parameter in self.parameters if parameter.neutral is not None)

    @property
    def typical_values(self) -> Float[np.ndarray, " parameters"]:
        """Parameters of the typical effect."""
        return np.array([getattr(self.typical_effect, name) for name in self.parameters.names])

    @property
    def step_sizes(self) -> Float[np.ndarray, " parameters"]:
        """Steps for derivatives: `STEP_SHARE` of what the typical effect adds, or of the range of another parameter.

        For a sharp frequency it is a share of the lowest one, which has two periods in the record; for a parameter of a
        logarithmic range, of its typical value.
        """
        additions = [
            value - parameter.neutral
            if parameter.neutral is not None
            else parameter.low
            if parameter.name == self.kind.grid_screened
            else value
            if _has_logarithmic_range(parameter)
            else parameter.high - parameter.low
            for value, parameter in zip(self.typical_values, self.parameters, strict=True)
        ]
        strength_addition = self.typical_values[0] - self.neutral_strength
        return STEP_SHARE * np.array([addition or strength_addition for addition in additions])

    def start_values(self, screened_values: Sequence[float] = ()) -> list[Float[np.ndarray, " parameters"]]:
        """Parameters of neutral strength at every trial place; `screened_values` are values of the grid-screened one.

        An effect that contains another has one trial value, as the other one stands for further ones at small
        strengths.
        """
        trial_values: list[Sequence[float] | Float[np.ndarray, " trials"]] = []
        for parameter, typical_value in zip(self.parameters, self.typical_values, strict=True):
            if parameter.name == self.kind.grid_screened:
                trial_values.append([value for value in screened_values if parameter.low <= value <= parameter.high])
            elif parameter.neutral is not None:
                trial_values.append([parameter.neutral])
            elif self.kind.contains:
                trial_values.append([typical_value])
            elif _has_logarithmic_range(parameter):
                trial_values.append(np.geomspace(parameter.low, parameter.high, PLACE_GRID_COUNT + 2)[1:-1])
            else:
                trial_values.append(np.linspace(parameter.low, parameter.high, PLACE_GRID_COUNT))
        return [np.array(trial) for trial in product(*trial_values)]

    def trial_strengths(self, multiples: Sequence[float]) -> list[float]:
        """Trial strengths: multiples of what the typical effect adds, of both signs, and the whole range of ratios."""
        lowest, highest = (float(bounds[0]) for bounds in self.parameters.bounds)
        neutral = self.neutral_strength
        typical_addition = float(self.typical_values[0]) - neutral
        strengths = [neutral + sign * multiple * typical_addition for sign in (1, -1) for multiple in multiples]
        if neutral == 1 and lowest > 0 and highest > 4 * lowest:
            strengths += list(np.geomspace(lowest, highest, RATIO_GRID_COUNT))
        return [float(strength) for strength in strengths if lowest <= strength <= highest]

    def effect(self, parameter_values: Float[np.ndarray, " parameters"]) -> Effect:
        """Typical effect with other values of its parameters."""
        return replace(self.typical_effect, **self.parameters.named(parameter_values))

    def applied(self, rig: Rig, values: Float[np.ndarray, " parameters"]) -> Rig:
        """Rig with the effect; the rig itself at neutral values, at which some effects are not exactly nothing."""
        if all(p.neutral in (None, value) for value, p in zip(values, self.parameters, strict=True)):
            return rig
        effect = self.effect(values)
        changed_rig = effect.applied_to(rig)
        return changed_rig if self.twin_place is None else replace(effect, **self.twin_place).applied_to(changed_rig)


def contains(container: Candidate, contained: Candidate) -> bool:
    """True if the container's parameters beside its strength make the contained effect at the same place."""
    return contained.kind.name in container.kind.contains and contained.place == container.place


def equivalent_names(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """Names of effects, the same for sets that span the same rigs: any two of the stiffnesses of both stops of a
    contact, of its lower and of its upper one do."""
    stops = Counter(c.place["contact"] for c in candidates if c.kind.name in STOP_STIFFNESSES)
    return tuple(
        sorted(
            f"stops:{c.place['contact']}"
            if c.kind.name in STOP_STIFFNESSES and stops[c.place["contact"]] == len(STOP_STIFFNESSES)
            else c.name
            for c in candidates
        )
    )


def _has_logarithmic_range(parameter: Parameter) -> bool:
    return parameter.low > 0 and parameter.high > 20 * parameter.low


def effect_range_scale(record: Record, rig: Rig) -> Scale:
    """Scale of the effects' ranges: the rig, and the record's force (root mean square, N) and duration (s).

    In a free decay, and on a shaken base, the inertial forces of the bodies, averaged over the sensors, stand for the
    force.
    """
    if record.has_force and record.base is None:
        forces_n = record.in_time(record.force_spectra)
    else:
        masses_kg = np.array([rig.body(sensor.station.body).mass_kg for sensor in record.sensors])
        forces_n = record.in_time(masses_kg[:, None] * record.acceleration_signals) / np.sqrt(masses_kg.size)
    return Scale(rig, float(np.sqrt(np.mean(np.sum(forces_n**2, axis=0)))), record.sample_count / record.sample_rate_hz)


def candidates(scale: Scale, sensor_names: Sequence[str], zero_known: bool, has_force: bool = True) -> list[Candidate]:
    """Every effect that the rig can have, at every place and sensor that a record observes.

    Left out are effects that only the zero of a relative displacement shows, where that is not known; those on the
    force and on channels where no force is measured (free motion has no scale, and may begin at any time); those on the
    force where several act or the base alone shakes, and on a base's motion where it is measured; those that change
    nothing, or that separate contacts between the same places.
    """
    possible_candidates, rig = [], scale.rig
    for kind in effects().values():
        if (kind.needs_zero and not zero_known) or (kind.stochastic and rig.base_sensors):
            continue
        for place in kind.placements(rig, sensor_names):
            place_scale = scale.with_place(place)
            candidate = Candidate(kind, place, kind.parameters(place_scale), kind.typical(place_scale))
            try:
                changed_rig = candidate.applied(rig, candidate.typical_values)
            except RigError:
                continue  # the effect cannot act here
            if not has_force or len(rig.forces) > 1 or rig.base_sensors:
                changed_rig = replace(changed_rig, force_sensor=rig.force_sensor)
            if not has_force:
                changed_rig = replace(changed_rig, sensors=rig.sensors, force_at=rig.force_at)
            if changed_rig != rig and len(contact_groups(changed_rig)) == len(contact_groups(rig)):
                possible_candidates.append(candidate)
    return possible_candidates


def is_possible(candidate: Candidate, rig: Rig) -> bool:
    """True if a rig can have the effect."""
    try:
        candidate.applied(rig, candidate.typical_values)
    except RigError:
        return False
    return True


def strength_columns(
    linearization: Linearization,
    residual: Residual,
    candidate: Candidate,
    start_values: Float[np.ndarray, " parameters"],
) -> list[ResidualColumn]:
    """Decrease of the residuals by a step of each strength of a candidate, at the parameters `start_values`.

    Raises RigError where no rig has the effect with these parameters.
    """
    decreases = []
    for index in candidate.parameters.strengths:
        values = start_values.copy()
        values[index] = start_values[index] + candidate.step_sizes[index]
        rig = candidate.applied(linearization.rig, values)
        column = attachment_residual_decrease(linearization, rig, residual)
        decreases.append(column or residual_decrease(linearization, rig, residual))
    return decreases


def attachments_of(rig: Rig, changed_rig: Rig) -> Rig | None:
    """Rig with only the attachments that `changed_rig` adds to `rig`; None if it adds none, or differs otherwise."""
    attachments = {name: getattr(changed_rig, name)[len(getattr(rig, name)) :] for name in ATTACHED_FIELDS}
    expected_rig = replace(rig, **{name: getattr(rig, name) + attached for name, attached in attachments.items()})
    return replace(rig, **attachments) if changed_rig == expected_rig and any(attachments.values()) else None


def attachment_residual_decrease(
    linearization: Linearization, changed_rig: Rig, residual: Residual
) -> ResidualColumn | None:
    """Decrease of the residuals by added springs, dampers, masses or tones; None for any other change of the rig.

    They act with forces -k w, -m a and so on of the measured w and a, which is exact to first order and cheap.
    """
    record, model, rig = linearization.record, residual.model, residual.rig
    attachments = attachments_of(rig, changed_rig)
    if attachments is None or any(body.is_mass for body in rig.bodies):
        return None
    attached_forces = _attached_forces(record, model, attachments)
    attachment_signals = signals_by_forces(model, sensor_places_of(record, model.rig), attached_forces)
    linear_decrease, contact_decrease_n = model.projection.applied_to(attachment_signals)
    eta_decrease_m = -model.eta_by_unobserved_modes_m(attached_forces, -contact_decrease_n)
    contact_decreases = contact_columns(record, residual, record.in_time(contact_decrease_n), eta_decrease_m)
    return residual_in_time(record, linear_decrease), contact_decreases


def _attached_forces(
    record: Record, model: LinearModel, attachments: Rig
) -> list[tuple[Station, Complex[np.ndarray, " lines"]]]:
    """Station and force spectrum (N) of each attachment."""
    sensor_places, responses = sensor_places_of(record, model.rig), model.responses
    forces = ground_forces(record, attachments, responses, sensor_places, model.motion)
    springs = [spring for spring in attachments.springs if spring.stiffness_n_per_m]
    displacements = displacements_at_elements(responses, sensor_places, springs, model.displacements)
    for spring, displacement in zip(springs, displacements, strict=True):
        forces.append((spring.station, -spring.stiffness_n_per_m * displacement))
    base_acceleration = model.base.acceleration if model.base else 0.0
    accelerations = displacements_at_elements(responses, sensor_places, attachments.masses, model.accelerations)
    for mass, acceleration in zip(attachments.masses, accelerations, strict=True):
        forces.append((mass.station, -mass.mass_kg * (acceleration + base_acceleration)))
    tone_forces = [(tone.station, record.spectrum(tone.force_n(record.sample_times_s))) for tone in attachments.tones]
    return forces + tone_forces
