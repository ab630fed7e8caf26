"""Forces of cubic springs and dampers to the ground, by the measured motion at their places."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.spectra import Record
from identify.linear.model import Response, times, weights_of
from identify.signals.law_evaluation import oversampling
from rig.model.description import PointDamper, PointMass, PointSpring, Rig, Station

Spectrum = Complex[np.ndarray, " lines"]
Motions = Complex[np.ndarray, "sensors lines"]


def ground_forces(
    record: Record, rig: Rig, responses: tuple[Response, ...], places: list[Station | None], displacements: Motions
) -> list[tuple[Station, Spectrum]]:
    """Where each spring and damper pushes the rig, and with which force: -k3 w^3, or -c v - F tanh(v / v0)."""
    springs, dampers = _bending(rig), rig.dampers
    moved = displaced_at(responses, places, [*springs, *dampers], displacements)
    found = []
    for spring, w in zip(springs, moved, strict=False):
        (fine,) = _finely(record, 3, w)
        found.append((spring.station, -_coarsely(record, spring.law.force_n(fine))))
    for damper, w in zip(dampers, moved[len(springs) :], strict=True):
        velocity = 1j * record.omega * w
        if damper.friction_n:
            (fine,) = _finely(record, _often(record), velocity)
            found.append((damper.station, -_coarsely(record, damper.law.force_n(np.zeros_like(fine), fine))))
        else:
            found.append((damper.station, -damper.damping_n_s_per_m * velocity))
    return found


def ground_force_changes(
    record: Record,
    rig: Rig,
    responses: tuple[Response, ...],
    places: list[Station | None],
    displacements: Motions,
    changes: Motions,
) -> list[tuple[Station, Spectrum]]:
    """The derivative of each of the `ground_forces` along a change of the displacements."""
    springs, dampers = _bending(rig), rig.dampers
    both = [displaced_at(responses, places, [*springs, *dampers], d) for d in (displacements, changes)]
    found = []
    for spring, w, more in zip(springs, *both, strict=False):
        fine, change = _finely(record, 3, w, more)
        found.append((spring.station, -_coarsely(record, spring.law.by_eta_n_per_m(fine) * change)))
    for damper, w, more in zip(dampers, *(moved[len(springs) :] for moved in both), strict=True):
        change = 1j * record.omega * more
        if damper.friction_n:
            fine, finely_changed = _finely(record, _often(record), 1j * record.omega * w, change)
            steepness = damper.law.by_rate_n_s_per_m(np.zeros_like(fine), fine)
            found.append((damper.station, -_coarsely(record, steepness * finely_changed)))
        else:
            found.append((damper.station, -damper.damping_n_s_per_m * change))
    return found


def pushed_by_motion(rig: Rig) -> bool:
    """Whether forces to the ground are had from the measured motion."""
    return bool(_bending(rig) or rig.dampers)


def needs_every_line(rig: Rig) -> bool:
    """Whether forces to the ground mix frequencies, so that a selection of a record's lines does not tell them."""
    return bool(_bending(rig)) or any(d.friction_n for d in rig.dampers)


def _bending(rig: Rig) -> list[PointSpring]:
    return [s for s in rig.springs if s.cubic_n_per_m3]


def displaced_at(
    responses: tuple[Response, ...],
    places: list[Station | None],
    attached: Sequence[PointSpring | PointDamper | PointMass],
    displacements: Motions,
) -> Complex[np.ndarray, "attached lines"]:
    """The displacements (or accelerations) where something is attached, from those of the sensors."""
    stations: list[Station | None] = [a.station for a in attached]
    return times(np.sum([weights_of(r, places, stations) for r in responses], axis=0), displacements)


def _often(record: Record) -> int:
    """So many times the record's own rate is fine enough for a friction force."""
    return max(3, oversampling(record.rate_hz))


def _finely(record: Record, finer: int, *spectra: Spectrum) -> list[Float[np.ndarray, " fine"]]:
    """Courses over the padded record, at so many times its own rate."""
    length = record.length // record.factor
    return [finer * np.fft.irfft(s / record.factor, finer * length) for s in spectra]


def _coarsely(record: Record, fine: Float[np.ndarray, " fine"]) -> Spectrum:
    """Back to the record's lines, without alias."""
    length = record.length // record.factor
    return np.asarray(np.fft.rfft(fine)[: length // 2 + 1] * record.factor * length / fine.size)
