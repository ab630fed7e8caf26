"""Forces of cubic springs and dampers to the ground, by the measured motion at their places."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.record import Record
from identify.gaps.residual.windowed import LEAST
from identify.linear.model import Response, times, weights_of
from identify.signals.law_evaluation import oversampling
from rig.model.description import PointDamper, PointMass, PointSpring, Rig, Station

Spectrum = Complex[np.ndarray, " lines"]
Motions = Complex[np.ndarray, "sensors lines"]


def ground_forces(
    record: Record, rig: Rig, responses: tuple[Response, ...], places: list[Station | None], displacements: Motions
) -> list[tuple[Station, Spectrum]]:
    """Forces of springs and dampers to the ground, each with its place: -k3 w^3, or -c v - F tanh(v / v0)."""
    springs, dampers = _bending(rig), rig.dampers
    moved = displaced_at(responses, places, springs, displacements)
    moving = displaced_at(responses, places, dampers, _velocities(record, displacements))
    found = []
    for spring, w in zip(springs, moved, strict=True):
        (fine,), window = _finely(record, 3, w)
        found.append((spring.station, -_coarsely(record, window * spring.law.force_n(fine / window))))
    for damper, velocity in zip(dampers, moving, strict=True):
        if damper.friction_n:
            (fine,), window = _finely(record, _often(record), velocity)
            force_n = window * damper.law.force_n(np.zeros_like(fine), fine / window)
            found.append((damper.station, -_coarsely(record, force_n)))
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
    moved = [displaced_at(responses, places, springs, d) for d in (displacements, changes)]
    velocities = _velocities(record, displacements), 1j * record.omega * changes
    moving = [displaced_at(responses, places, dampers, v) for v in velocities]
    found = []
    for spring, w, more in zip(springs, *moved, strict=True):
        (fine, change), window = _finely(record, 3, w, more)
        found.append((spring.station, -_coarsely(record, spring.law.by_eta_n_per_m(fine / window) * change)))
    for damper, velocity, change in zip(dampers, *moving, strict=True):
        if damper.friction_n:
            (fine, finely_changed), window = _finely(record, _often(record), velocity, change)
            steepness = damper.law.by_rate_n_s_per_m(np.zeros_like(fine), fine / window)
            found.append((damper.station, -_coarsely(record, steepness * finely_changed)))
        else:
            found.append((damper.station, -damper.damping_n_s_per_m * change))
    return found


def pushed_by_motion(rig: Rig) -> bool:
    """True if forces to the ground follow from the measured motion."""
    return bool(_bending(rig) or rig.dampers)


def needs_every_line(rig: Rig) -> bool:
    """True if forces to the ground mix frequencies, so that a selection of a record's lines does not tell them."""
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
    """Multiple of the record's rate that is fine enough for a friction force."""
    return max(3, oversampling(record.rate_hz))


def _velocities(record: Record, displacements: Motions) -> Motions:
    """The windowed velocities at the sensors, which are less than those of the windowed displacements."""
    return 1j * record.omega * displacements + record.faded


def _finely(
    record: Record, finer: int, *spectra: Spectrum
) -> tuple[list[Float[np.ndarray, " fine"]], Float[np.ndarray, " fine"]]:
    """Courses over the padded record, at so many times its own rate, and the window that they are under: a law is of
    the motion itself, and its force under the window."""
    length = record.length // record.factor
    time = np.arange(finer * length) * (record.factor / finer)
    window = np.interp(time, np.arange(record.samples), record.window, right=0.0)
    return [finer * np.fft.irfft(s / record.factor, finer * length) for s in spectra], np.maximum(window, LEAST)


def _coarsely(record: Record, fine: Float[np.ndarray, " fine"]) -> Spectrum:
    """Back to the record's lines, without alias."""
    length = record.length // record.factor
    return np.asarray(np.fft.rfft(fine)[: length // 2 + 1] * record.factor * length / fine.size)
