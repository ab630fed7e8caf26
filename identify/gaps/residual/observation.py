"""Observation of contacts, whatever their laws: when they are closed, how exactly their forces are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from identify.gaps.residual.linear import Linear
from identify.gaps.residual.record import Record
from identify.linear.joined import JoinedLaw
from identify.signals.drift import Spline, spline

CLOSED = 5.0
"""A contact force is more than noise where it exceeds this many standard deviations; ..."""
STRUCK = 0.1
"""... where it also exceeds this share of its root mean square, which no open contact's error does, it is closed."""

EDGE = 8
"""A contact force so few samples before a record ends rings on: the low-pass of its law lacks what follows."""


@dataclass(frozen=True)
class ContactObservation:
    """Observation of one contact, whatever its law: how exactly its force is known, and its slow drift.

    trusted are the standard deviations of clearance and stiffness (relative) and of damping over stiffness (s).
    """

    weights: Float[np.ndarray, " times"]
    closed: Float[np.ndarray, " times"]
    curve: Spline
    sample_ratio: float
    trusted: tuple[float, float, float]

    @property
    def tolerances(self) -> slice:
        """Slice of the law's tolerances among a contact's unknowns: behind the knots of the drift."""
        return slice(self.curve.knots, None)

    @property
    def firm(self) -> float:
        """The weight of a tolerance's standard deviation."""
        return float(self.sample_ratio**0.5)


def seen_contacts(
    record: Record, model: Linear, laws: Sequence[JoinedLaw], levels: Sequence[float]
) -> tuple[ContactObservation, ...]:
    """Observations of a record's contacts, by the linear model and the laws of the nominal rig.

    levels are the variances of the contact residuals, in units of what noise and unmodelled share make of them.
    """
    forces, spreads = record.in_time(model.contact_n), model.open_n(record)
    found = []
    believed = record.tolerances
    trusted = believed.clearance, believed.stiffness, believed.contact_damping_s
    for force, open_n, law, drift, level in zip(forces, spreads, laws, record.drifts, levels, strict=True):
        loud = np.abs(force) > CLOSED * open_n
        fast_m = 0.0 if drift is None else drift.unfollowed_m
        stiffness = sum(one.stiffness_n_per_m for one in law.laws)
        moving = record.time_s > record.excited_s  # at rest nothing tells on which side of a stop it rests
        weights = (
            moving
            / np.sqrt(level)
            / np.sqrt(
                open_n**2
                + (stiffness * fast_m * loud) ** 2
                + (believed.unmodelled_contact * force) ** 2
                + _ringing(record, force) ** 2
            )
        )
        slow = drift
        if drift is not None:
            at = np.arange(record.taken.start, record.taken.stop) * record.factor
            slow = replace(drift, acceleration_m_per_s2=drift.acceleration_m_per_s2[at])
        found.append(
            ContactObservation(
                weights,
                is_closed(force, open_n).astype(float),
                spline(force.size, record.rate_hz, slow),
                record.sample_ratio,
                trusted,
            )
        )
    return tuple(found)


def is_closed(
    force_n: Float[np.ndarray, " times"], open_n: float | Float[np.ndarray, " times"]
) -> Bool[np.ndarray, " times"]:
    """Mask of a closed contact: its force exceeds the error of an open one, open_n, and a share of its rms."""
    return np.abs(force_n) > np.maximum(CLOSED * open_n, STRUCK * np.sqrt(np.mean(force_n**2)))


def _ringing(record: Record, force_n: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """Ringing F / (pi n) that an ideal low-pass makes n samples from where a force is cut off."""
    after = np.arange(force_n.size) + 1.0
    rings = np.max(np.abs(force_n[-EDGE:])) / (np.pi * after[::-1])
    if record.taken.start > 0:
        rings = np.hypot(rings, np.max(np.abs(force_n[:EDGE])) / (np.pi * after))
    return np.asarray(rings)
