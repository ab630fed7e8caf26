"""The column of what is attached to a point of a body, or acts there, by the measured motion: cheap, to screen with."""

import numpy as np
from jaxtyping import Complex
from msgspec.structs import replace

from identify.gaps.residual.fit import Column
from identify.gaps.residual.grounded import displaced_at, ground_forces
from identify.gaps.residual.linear import Linear, delivered_by, places_of
from identify.gaps.residual.nuisance import counted
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual
from rig.model.description import Rig, Station

ATTACHED = ("springs", "dampers", "masses", "tones")
"""The fields of a rig that hold what sits, or acts, at a point of a body."""


def added(rig: Rig, moved: Rig) -> Rig | None:
    """The rig with only that attached which another one has beside; None if that is nothing, or differs otherwise."""
    more = {kind: getattr(moved, kind)[len(getattr(rig, kind)) :] for kind in ATTACHED}
    joined = replace(rig, **{kind: getattr(rig, kind) + new for kind, new in more.items()})
    return replace(rig, **more) if moved == joined and any(more.values()) else None


def attached(linearization: Linearization, moved: Rig, at: Residual) -> Column | None:
    """Decrease of the residuals by added springs, dampers, masses or tones; None for any other change of the rig.

    They push with -k w, -m a and so on of the measured w and a, which is exact to first order. Slow changes of the
    relative displacements move the laws by their mean slope around every sample.
    """
    record, model, rig = linearization.record, at.model, at.rig
    more = added(rig, moved)
    if more is None or any(b.is_mass for b in rig.bodies):
        return None
    forces = _forces(record, model, more)
    left, less_n = model.projection.of(delivered_by(model, places_of(record, model.rig), forces))
    less_m = -record.in_time(model.unseen_m(forces, -less_n))
    columns = []
    for contact, force_n, eta_m in zip(at.contacts, record.in_time(less_n), less_m, strict=True):
        column = np.zeros(contact.residual.size)
        column[: force_n.size] = contact.seen.weights * (force_n - contact.by_eta * eta_m)
        columns.append(column)
    return counted(record, left), columns


def _forces(record: Record, model: Linear, more: Rig) -> list[tuple[Station, Complex[np.ndarray, " lines"]]]:
    """Forces of what is attached: the place of each, and how it pushes."""
    places = places_of(record, model.rig)
    displacements, accelerations = model.displaced, model.accelerations
    found = ground_forces(record, more, model.responses, places, displacements)
    springs = [s for s in more.springs if s.stiffness_n_per_m]
    for spring, w in zip(springs, displaced_at(model.responses, places, springs, displacements), strict=True):
        found.append((spring.station, -spring.stiffness_n_per_m * w))
    for mass, a in zip(more.masses, displaced_at(model.responses, places, more.masses, accelerations), strict=True):
        found.append((mass.station, -mass.mass_kg * a))
    return found + [(tone.station, record.spectrum(tone.force_n(record.sample_times_s))) for tone in more.tones]
