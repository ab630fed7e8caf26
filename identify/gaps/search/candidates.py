"""Candidates: every effect of the library at every place where it can act, and its derivative of the residuals."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import msgspec
import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace

from identify.gaps.residual.linear import Linear, delivered_by, sensor_stations_of
from identify.gaps.residual.nuisance import residual_in_time
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Column, Linearization, Residual, contact_columns, derivative
from identify.gaps.residual.windowed import displaced_at, ground_forces
from identify.linear.joined import joined_contacts
from rig.effects import effects
from rig.effects.base import Effect, Place, Scale
from rig.errors import RigError
from rig.model.description import Rig, Station
from rig.model.parameters import Parameter, ParameterSet

PLACE_VALUES = 9
"""Trial values of a parameter that is a place or a frequency, not a strength."""
RATIO_VALUES = 8
"""Trial values of a ratio over its whole range."""
STEP_SHARE = 0.05
"""Step for derivatives, as a share of what the typical effect adds. Set by hand."""
ATTACHED_FIELDS = ("springs", "dampers", "masses", "tones")
"""Fields of a rig for what is attached to, or acts at, a point of a body."""


@dataclass(frozen=True)
class Candidate:
    """Effect at a place: a typical one, and the ranges of its parameters, the strength first.

    The effect vanishes where all parameters that have a neutral value are at it. The other parameters are places or
    frequencies, of which `starts` gives trial values.
    """

    kind: type[Effect]
    place: Place
    parameters: ParameterSet
    typical: Effect

    @property
    def name(self) -> str:
        return ":".join([self.kind.name, *(target or "all" for target in self.place.values())])

    @property
    def neutral(self) -> float:
        """Strength without the effect."""
        return next(p.neutral for p in self.parameters if p.neutral is not None)

    @property
    def default(self) -> Float[np.ndarray, " parameters"]:
        """Parameters of the typical effect."""
        return np.array([getattr(self.typical, name) for name in self.parameters.names])

    @property
    def steps(self) -> Float[np.ndarray, " parameters"]:
        """Steps for derivatives: `STEP_SHARE` of what the typical effect adds, or of the range of another parameter.

        For a sharp frequency it is a share of the lowest one, which has two periods in the record; for a parameter of a
        logarithmic range, of its typical value.
        """
        adds = [
            typical - p.neutral
            if p.neutral is not None
            else p.low
            if p.name == self.kind.grid_screened
            else typical
            if _is_logarithmic(p)
            else p.high - p.low
            for typical, p in zip(self.default, self.parameters, strict=True)
        ]
        adds = [a or self.default[0] - self.neutral for a in adds]
        return STEP_SHARE * np.array(adds)

    def starts(self, screened: Sequence[float] = ()) -> list[Float[np.ndarray, " parameters"]]:
        """Parameters of neutral strength at every trial place; `screened` are values of the grid-screened one.

        An effect that contains another has one trial value, as the other one stands for further ones at small
        strengths.
        """
        grids = []
        for parameter, typical in zip(self.parameters, self.default, strict=True):
            bounds = (parameter.low, parameter.high)
            if parameter.name == self.kind.grid_screened:
                grids.append(np.array([v for v in screened if bounds[0] <= v <= bounds[1]]))
                continue
            if parameter.neutral is not None:
                grids.append(np.array([parameter.neutral]))
            elif self.kind.contains:
                grids.append(np.array([typical]))
            elif _is_logarithmic(parameter):
                grids.append(np.geomspace(*bounds, PLACE_VALUES + 2)[1:-1])
            else:
                grids.append(np.linspace(*bounds, PLACE_VALUES))
        return [np.array(values) for values in product(*grids)]

    def strengths(self, multiples: Sequence[float]) -> list[float]:
        """Trial strengths: multiples of what the typical effect adds, of both signs, and the whole range of ratios."""
        low, high = (float(bounds[0]) for bounds in self.parameters.bounds)
        adds = float(self.default[0]) - self.neutral
        strengths = [self.neutral + sign * m * adds for sign in (1, -1) for m in multiples]
        if self.neutral == 1 and low > 0 and high > 4 * low:
            strengths += list(np.geomspace(low, high, RATIO_VALUES))
        return [float(strength) for strength in strengths if low <= strength <= high]

    def effect(self, values: Float[np.ndarray, " parameters"]) -> Effect:
        """Typical effect with other values of its parameters."""
        return msgspec.structs.replace(self.typical, **self.parameters.named(values))

    def applied(self, rig: Rig, values: Float[np.ndarray, " parameters"]) -> Rig:
        """Rig with the effect; the rig itself at neutral values, at which some effects are not exactly nothing."""
        is_neutral = all(p.neutral in (None, value) for value, p in zip(values, self.parameters, strict=True))
        return rig if is_neutral else self.effect(values).applied_to(rig)


def contains(container: Candidate, contained: Candidate) -> bool:
    """True if the container's parameters beside its strength make the contained effect at the same place."""
    return contained.kind.name in container.kind.contains and contained.place == container.place


def _is_logarithmic(parameter: Parameter) -> bool:
    return parameter.low > 0 and parameter.high > 20 * parameter.low


def scale_of(record: Record, rig: Rig) -> Scale:
    """Scale of the effects' ranges: the rig, and the record's force (root mean square, N) and duration (s).

    In a free decay the inertial forces of the bodies, averaged over the sensors, stand for the force.
    """
    if record.forced:
        forces_n = record.in_time(record.forces)
    else:
        masses = np.array([rig.body(s.station.body).mass_kg for s in record.sensors])
        forces_n = record.in_time(masses[:, None] * record.delivered) / np.sqrt(masses.size)
    return Scale(rig, float(np.sqrt(np.mean(np.sum(forces_n**2, axis=0)))), record.samples / record.sample_rate_hz)


def candidates(scale: Scale, sensors: Sequence[str], zero_known: bool, forced: bool = True) -> list[Candidate]:
    """Every effect that the rig can have, at every place and sensor that a record observes.

    Left out are effects that only the zero of a relative displacement shows, where that is not known; those on the
    force and on channels where no force is measured (free motion has no scale, and may begin at any time); those on the
    force where several act; those that change nothing, or that separate contacts between the same places.
    """
    possible = []
    for kind in effects().values():
        if kind.needs_zero and not zero_known:
            continue
        for place in kind.placements(scale.rig, sensors):
            place_scale = scale.with_place(place)
            candidate = Candidate(kind, place, kind.parameters(place_scale), kind.typical(place_scale))
            try:
                changed_rig = candidate.applied(scale.rig, candidate.default)
            except RigError:
                continue  # the effect cannot act here
            nominal = scale.rig
            if not forced or len(nominal.forces) > 1:
                changed_rig = replace(changed_rig, force_sensor=nominal.force_sensor)
            if not forced:
                changed_rig = replace(changed_rig, sensors=nominal.sensors, force_at=nominal.force_at)
            if changed_rig != scale.rig and len(joined_contacts(changed_rig)) == len(joined_contacts(scale.rig)):
                possible.append(candidate)
    return possible


def is_possible(candidate: Candidate, rig: Rig) -> bool:
    """True if a rig can have the effect."""
    try:
        candidate.applied(rig, candidate.default)
    except RigError:
        return False
    return True


def strength_columns(
    linearization: Linearization, residual: Residual, candidate: Candidate, start: Float[np.ndarray, " parameters"]
) -> list[Column]:
    """Decrease of the residuals by a step of each strength of a candidate, at the parameters `start`.

    Raises RigError where no rig has the effect with these parameters.
    """
    columns = []
    for k in candidate.parameters.strengths:
        values = start.copy()
        values[k] = start[k] + candidate.steps[k]
        rig = candidate.applied(linearization.rig, values)
        columns.append(attached_column(linearization, rig, residual) or derivative(linearization, rig, residual))
    return columns


def attachments_of(rig: Rig, changed_rig: Rig) -> Rig | None:
    """Rig with only the attachments that `changed_rig` adds to `rig`; None if it adds none, or differs otherwise."""
    attachments = {kind: getattr(changed_rig, kind)[len(getattr(rig, kind)) :] for kind in ATTACHED_FIELDS}
    expected_rig = replace(rig, **{kind: getattr(rig, kind) + items for kind, items in attachments.items()})
    return replace(rig, **attachments) if changed_rig == expected_rig and any(attachments.values()) else None


def attached_column(linearization: Linearization, changed_rig: Rig, residual: Residual) -> Column | None:
    """Decrease of the residuals by added springs, dampers, masses or tones; None for any other change of the rig.

    They act with forces -k w, -m a and so on of the measured w and a, which is exact to first order and cheap.
    """
    record, model, rig = linearization.record, residual.model, residual.rig
    attachments = attachments_of(rig, changed_rig)
    if attachments is None or any(b.is_mass for b in rig.bodies):
        return None
    forces = _attached_forces(record, model, attachments)
    linear_decrease, contact_force_decrease_n = model.projection.of(
        delivered_by(model, sensor_stations_of(record, model.rig), forces)
    )
    eta_decrease_m = -model.unobserved_eta_m(forces, -contact_force_decrease_n)
    columns = contact_columns(record, residual, record.in_time(contact_force_decrease_n), eta_decrease_m)
    return residual_in_time(record, linear_decrease), columns


def _attached_forces(
    record: Record, model: Linear, attachments: Rig
) -> list[tuple[Station, Complex[np.ndarray, " lines"]]]:
    """Station and force spectrum (N) of each attachment."""
    sensor_stations = sensor_stations_of(record, model.rig)
    displacements, accelerations = model.displaced, model.accelerations
    attached_forces = ground_forces(record, attachments, model.responses, sensor_stations, displacements)
    springs = [s for s in attachments.springs if s.stiffness_n_per_m]
    for spring, w in zip(springs, displaced_at(model.responses, sensor_stations, springs, displacements), strict=True):
        attached_forces.append((spring.station, -spring.stiffness_n_per_m * w))
    masses = attachments.masses
    for mass, a in zip(masses, displaced_at(model.responses, sensor_stations, masses, accelerations), strict=True):
        attached_forces.append((mass.station, -mass.mass_kg * a))
    tones = [(tone.station, record.spectrum(tone.force_n(record.sample_times_s))) for tone in attachments.tones]
    return attached_forces + tones
