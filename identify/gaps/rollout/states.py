"""The state of a rig at any sample of a record, from its sensors; handed over at stations, whatever the rig's modes.

As many of each body's lowest modes as it has stations follow from what the stations show. Their rates are as exact as
the channels are. Their displacements are not: of a mode at 50 Hz that moves by 0.8 mm, errors of gains and places leave
0.2 mm, as the rigid and lowest modes move by centimetres. So two sources complete each other, by frequency: above
`CROSSOVER` of a mode's natural frequency its displacement is what the sensors show; below, what the measured force and
the separated contact forces make of it, A = -omega^2 / D,

    Q = W Q_sensors + (1 - W) A (phi_F F - phi_C f) / (i omega)^2

Modes that are free to move slowly (rigid ones, single masses) have the sensors' alone, with the slow motion b that
integration loses and the fit of the rig to the record estimates. Last, the displacements are moved by least squares
until the relative displacements are those of the fit, which the contacts' laws tell to some hundredths of a millimetre.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.fft import irfft, rfft

from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Residual
from identify.linear.joined import joined
from identify.signals.kinematics import CORNER_HZ, kinematics
from rig.model.description import Body, Rig, Station
from rig.model.modes import Modes, modes_of
from rig.recording import Recording

CROSSOVER = 0.3
"""Of a mode's natural frequency: where its displacement by the forces gives way to that by the sensors."""
BY_FORCES, BY_SENSORS = 1e-2, 3e-3
"""Relative errors: of the displacement of a mode that forces tell, of that of a station."""
SOFTEST_HZ = 0.05
"""Slow motion bends a body less than it moves one that is free, as if that were held with this frequency."""
EDGE = 16
"""Samples at either end of a record whose derivatives lack what lies beyond."""


@dataclass(frozen=True)
class MeasuredMotion:
    """Motion that a record shows at its sensors' stations, read by the chain of one rig.

    displacement and velocity are those of the sensors, with the slow motion; states are displacement and velocity in
    the rig's lowest modes. Everything is right from the sample `first` up to `stop`. orders are those of the sensors'
    quantities.
    """

    rig: Rig
    stations: tuple[Station, ...]
    names: tuple[str, ...]
    orders: tuple[int, ...]
    sample_rate_hz: float
    forces_n: Float[np.ndarray, "forces samples"]
    displacement_m: Float[np.ndarray, "stations samples"]
    velocity_m_per_s: Float[np.ndarray, "stations samples"]
    states: Float[np.ndarray, "2 stations samples"]
    first: int
    stop: int

    @property
    def now(self) -> slice:
        return slice(self.first, self.stop)


def motion_of(recording: Recording, rig: Rig, at: Residual) -> MeasuredMotion:
    """The motion of a record as a rig reads it; `at` is the residual of the fit that tells slow motion and forces."""
    record = at.model.record
    moved = kinematics(Recording(rig, recording.signals, recording.provenance), record.sensors[0].quantity)
    modes, slow = _modes_of(rig, at, moved.stations), _slow(at, moved.samples)
    follows = modes.followed()
    displacement_m = moved.displacement_m + follows @ slow[0]
    velocity_m_per_s = moved.velocity_m_per_s + follows @ slow[1]
    begin, drifting = record.taken.start * record.factor, any(drift is not None for drift in record.drifts)
    first = max(moved.excited_from, begin if drifting else 0, EDGE)
    stop = min(moved.samples, (record.taken.stop - 1) * record.factor + 1) - EDGE

    inverse = modes.inverse()
    sensed_m = inverse @ displacement_m
    coordinates_m = _completed(sensed_m, modes, record)
    error = np.sqrt(inverse**2 @ (BY_SENSORS * _rms(displacement_m[:, first:stop])) ** 2)
    error[modes.forced] = BY_FORCES * _rms(coordinates_m[modes.forced, first:stop])
    between = error[:, None] ** 2 * modes.across.T
    gain = between @ np.linalg.pinv(modes.across @ between, rcond=1e-9, hermitian=True)
    missed = modes.across @ coordinates_m
    for row, contact in zip(missed, at.contacts, strict=True):
        told = contact.eta_m[: moved.samples - begin]
        row[:begin], row[begin + told.size :] = 0.0, 0.0
        row[begin : begin + told.size] -= told
    coordinates_m -= gain @ missed
    return MeasuredMotion(
        rig=rig,
        stations=moved.stations,
        names=tuple(s.name for s in moved.sensors),
        orders=tuple(s.measures.order for s in moved.sensors),
        sample_rate_hz=moved.sample_rate_hz,
        forces_n=moved.forces_n,
        displacement_m=displacement_m,
        velocity_m_per_s=velocity_m_per_s,
        states=np.stack([modes.shapes @ coordinates_m, modes.shapes @ inverse @ velocity_m_per_s]),
        first=first,
        stop=stop,
    )


@dataclass(frozen=True)
class _Modes:
    """Modes of each body, as many as it has stations: shapes at the stations and across the contacts.

    forced are those whose slow displacement forces tell, forced_m the spectra of all displacements by the forces.
    """

    natural_hz: Float[np.ndarray, " modes"]
    shapes: Float[np.ndarray, "stations modes"]
    across: Float[np.ndarray, "contacts modes"]
    forced: Bool[np.ndarray, " modes"]
    forced_m: np.ndarray

    def inverse(self) -> Float[np.ndarray, "modes stations"]:
        """The coordinates that fit the stations best."""
        return np.asarray(np.linalg.pinv(self.shapes, rcond=1e-9))

    def followed(self) -> Float[np.ndarray, "stations contacts"]:
        """Motion of the stations with slow relative displacements of the contacts: with the least of elastic energy."""
        compliant = self.across.T / (self.natural_hz**2 + SOFTEST_HZ**2)[:, None]
        return np.asarray(self.shapes @ compliant @ np.linalg.pinv(self.across @ compliant, rcond=1e-9))


def _modes_of(rig: Rig, at: Residual, stations: tuple[Station, ...]) -> _Modes:
    """Modes of a rig, with the displacements that the fitted one's forces make, in the order of its bodies' modes."""
    record, parts = at.model.record, []
    by_body = zip(at.model.responses, at.model.modal, strict=True)
    fitted = {response.body.name: (motion, response.dynamics.high_passed) for response, motion in by_body}
    ends: list[list[Station | None]] = [[c.at for c in joined(rig).contacts], [c.against for c in joined(rig).contacts]]
    for body in rig.bodies:
        modes = modes_of(rig, body)
        count = min(sum(s.body == body.name for s in stations), body.max_modes)
        acceleration, loose = fitted[body.name]
        natural_hz = modes.frequencies_hz(count)
        above, below = (_shapes(body, modes, count, places) for places in ends)
        slow = np.isin(np.arange(count), loose)
        displaced = -acceleration[:count] / record.omega**2
        displaced[:, 0] = 0.0
        parts.append(
            (
                natural_hz,
                _shapes(body, modes, count, stations),
                above - below,
                ~slow & (CROSSOVER * natural_hz > 2 * CORNER_HZ),
                displaced,
            )
        )
    hz, shapes, over, forced, displaced = zip(*parts, strict=True)
    return _Modes(
        np.concatenate(hz),
        np.concatenate(shapes, axis=1),
        np.concatenate(over, axis=1),
        np.concatenate(forced),
        np.concatenate(displaced),
    )


def _shapes(
    body: Body, modes: Modes, count: int, places: Sequence[Station | None]
) -> Float[np.ndarray, "places modes"]:
    """Shapes of the lowest modes; zero at places on other bodies and on the ground."""
    rows = np.zeros((len(places), count))
    for row, place in zip(rows, places, strict=True):
        if place is not None and place.body == body.name:
            row[:] = modes.shapes(np.array([place.position_m]), count)[0]
    return rows


def _completed(
    sensed_m: Float[np.ndarray, "modes samples"], modes: _Modes, record: Record
) -> Float[np.ndarray, "modes samples"]:
    """The displacements with their slow part by the forces, where those tell it."""
    found = sensed_m.copy()
    hz = np.fft.rfftfreq(record.length, 1 / record.sample_rate_hz)
    for mode in np.flatnonzero(modes.forced):
        end_hz = min(CROSSOVER * modes.natural_hz[mode], record.highest_hz)
        rises = np.sin(np.pi / 2 * np.clip(2 * hz / end_hz - 1, 0, 1)) ** 2
        whole = rises * rfft(sensed_m[mode], record.length)
        lines = modes.forced_m.shape[1]
        whole[:lines] += (1 - rises[:lines]) * modes.forced_m[mode]
        found[mode] = irfft(whole, record.length)[: sensed_m.shape[1]]
    return found


def _slow(at: Residual, samples: int) -> Float[np.ndarray, "2 contacts samples"]:
    """The slow relative displacement of every contact, and its rate, at all samples of a record."""
    record, times = at.model.record, np.arange(samples)
    taken = np.arange(record.taken.start, record.taken.stop) * record.factor
    found = np.zeros((2, len(at.contacts), samples))
    for j, contact in enumerate(at.contacts):
        curve = contact.seen.curve
        for row, by_knot in zip(found[:, j], (curve.value, curve.rate), strict=True):
            row[:] = np.interp(times, taken, by_knot @ contact.unknowns[: curve.knots])
    return found


def _rms(rows: Float[np.ndarray, "rows samples"]) -> Float[np.ndarray, " rows"]:
    return np.asarray(np.sqrt(np.mean(rows**2, axis=1)))
