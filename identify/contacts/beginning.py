"""Contact forces of a record that does not begin at rest: what the modes' free motion from its start delivers."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Complex, Float

from identify.contacts.lines import Lines
from identify.contacts.station_errors import StationErrors
from identify.linear.free_motion import InitialStates, estimated_states, free_motions, free_spectra
from identify.linear.model import Response
from identify.signals.kinematics import CORNER_HZ, Kinematics
from rig.model.description import Rig

SETTLED_S = 0.5
"""At the start of a record that does not begin at rest, where fast modes ring of what was before."""


def settled_s(rig: Rig, slow_n_per_m: Float[np.ndarray, "contacts contacts"]) -> float:
    """Seconds of the forces left out at the start of a record that does not begin at rest.

    Where springs of an elastic body act on high-passed displacements, until these have forgotten the start.
    """
    forgets = np.any(slow_n_per_m) and any(b.length_m for b in rig.bodies)
    return 2 / CORNER_HZ if forgets else SETTLED_S


def as_sensed(motion: Kinematics, lines: Lines) -> Complex[np.ndarray, "stations lines"]:
    """The accelerations' spectra, by powers of i omega of those of what each station's sensor measures.

    So a displacement that does not begin at zero has the spectrum of a step, which has no course in time.
    """
    rows = (motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2)
    orders = [s.measures.order for s in motion.sensors]
    sensed = lines.spectra(np.array([rows[order][i] for i, order in enumerate(orders)]))
    return np.asarray(sensed * (1j * lines.omega) ** (2 - np.array(orders))[:, None])


def initial_states(
    responses: tuple[Response, ...],
    motion: Kinematics,
    in_metres: Bool[np.ndarray, "stations lines"],
    lines: Lines,
    delivered: Complex[np.ndarray, "inputs stations lines"],
    errors: StationErrors,
) -> InitialStates:
    """The free motion of the modes at the record's start, from the record as it is, cut off at both ends.

    Behind its end, where nothing was measured, the modes lack the free motion from their state there: likewise unknown.
    """
    sharp = replace(lines, tapered=False)
    samples, behind, forces = motion.samples, lines.length - motion.samples, len(motion.forces_n)
    motions, at_start, at_end = free_motions(responses, motion, float(lines.omega[-1]) / (2 * np.pi), lines.length)
    orders = [s.measures.order for s in motion.sensors]
    of_start = free_spectra(motions, orders, in_metres, lines.omega, lambda rows: sharp.spectra(rows[:, :samples]))
    of_end = free_spectra(motions, orders, in_metres, lines.omega, lambda rows: sharp.spectra(rows[:, :behind]))
    late = np.exp(-1j * lines.omega * samples / lines.rate_hz)
    measured = np.where(in_metres, sharp.spectra(motion.displacement_m), as_sensed(motion, sharp))
    held = np.array([m.held for m in motions])
    found = estimated_states(
        np.concatenate([of_start, late * of_end]),
        np.concatenate([at_start[0], at_end[0]]),
        np.concatenate([at_start[1], at_end[1]]),
        measured - np.sum(delivered[:forces] * sharp.spectra(motion.forces_n)[:, None], axis=0),
        delivered[forces:],
        errors.parts(0 if motion.zero_known else int(np.count_nonzero(lines.omega < 2 * 2 * np.pi * CORNER_HZ))),
        alike=lines.alike,
    )
    tapered = free_spectra(motions, orders, in_metres, lines.omega, lambda rows: lines.spectra(rows[:, :samples]))
    return found.of(tapered, np.flatnonzero(held))
