"""The smallest unmeasured force that explains a gap: found on one record, demanded of another."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.observation import is_closed
from identify.gaps.residual.spectra import Record
from identify.gaps.results import ResidualMap, Value
from identify.gaps.unknown.descent import kept
from identify.gaps.unknown.description import laws, shortest
from identify.gaps.unknown.evidence import explained
from identify.gaps.unknown.forms import Against
from identify.gaps.unknown.law import ForceLaw
from identify.gaps.unknown.location import Kind, Located, located, response_of
from identify.gaps.unknown.nuisance import drift_accelerations, observed
from identify.gaps.unknown.observed import BAND_HZ, WhitenedRecord
from identify.gaps.unknown.time_history import FINER, ForceHistory, explained_share, force_of, history_of
from identify.signals.beginning import QUIET_S
from rig.model.description import Rig, Station

When = Literal["always", "in contact", "growing with time"]
SAME_M = 0.05
"""Two records show the same place if theirs differ by no more, or by five standard errors."""
DESCRIBED = 0.2
"""No law is looked for if less is explained: null simulations explain one direction of ten."""
NAMED = 0.7
"""A law is named if it keeps at least this share of what the free force gains."""
IN_BAND = 0.9
CELLS, PARTS = 24, 8
GROWING = 1.5
MOSTLY = 0.7


class UnknownForce(msgspec.Struct, frozen=True, kw_only=True):
    """What acts unmeasured, where, when and by what law.

    A force or a pair acts at `position_m` of `body`, a pair also against `against_body`; a sensor's signal does not
    follow the motion; a distributed force is a modulus of `bodies` that drifts by `growth`, relative over the record.
    gain is by how much -2 ln L falls with it, explained_share of the linear residual's mean square: on the fit record
    with everything free, on the validation record with the place and the shape of the spectrum held. same_place says
    whether the validation record alone shows the same. in_contact_share is the share of its mean square while a contact
    is closed (0 if one nearly always is), before_excitation its rms before the measured force begins over that after
    (0 without a quiet start), by_time its rms in equal parts of the time. law gives the force against the motion there
    (w in m, v in m/s, positive against it), "" if none keeps `NAMED` of what the free force gains; law_share and
    validation_law_share say how much it keeps. surface holds the mean of the force (N) over displacement and velocity,
    0 where it never was.
    """

    kind: Kind
    body: str
    position_m: Value
    validation_position_m: Value
    against_body: str
    against_position_m: float
    sensor: str
    bodies: tuple[str, ...]
    growth: tuple[Value, ...]
    same_place: bool
    band_hz: tuple[float, float]
    frequency_hz: float | None
    when: When
    in_contact_share: float
    before_excitation: float
    by_time: tuple[float, ...]
    against: Against
    rms: Value
    amplitude_n: float | None
    explained_share: float
    validation_explained_share: float
    gain: float
    validation_gain: float
    gains_of_kinds: dict[str, float]
    law_name: str
    law: str
    law_parameters: dict[str, Value]
    law_share: float
    validation_law_share: float
    surface: ResidualMap | None
    spectrum_hz: tuple[float, ...]
    spectrum: tuple[float, ...]
    """One-sided, by bands of 2 Hz: N^2/Hz, of a sensor (m/s^2)^2/Hz."""


@dataclass(frozen=True)
class Sought:
    """The unmeasured force that explains the fit record best, what the validation record alone shows (again), and that
    record with the place and the shape of the spectrum held.
    """

    there: Located
    again: Located
    held: Located

    @property
    def same_place(self) -> bool:
        return same_place(self.there, self.again)

    @property
    def directions(self) -> int:
        """How many directions of the residual, of `held.observed.rows`, are free to follow it."""
        return 0 if self.there.candidate.kind == "distributed" else 1

    def delivered(self) -> Complex[np.ndarray, "sensors alllines"]:
        """What the sensors of the validation record deliver of it, at its likeliest time history."""
        own, candidate = self.held.observed, self.held.candidate
        found = np.zeros(own.model.sensor_response.shape, dtype=complex)
        if candidate.kind == "distributed":
            for body, growth in zip(candidate.bodies, self.held.growth, strict=True):
                found += growth * drift_accelerations(own, body)
        elif candidate.kind == "sensor":
            found[[s.name for s in own.record.sensors].index(candidate.sensor)] = force_of(self.held)
        else:
            for station, sign in zip(candidate.stations, (1.0, -1.0), strict=False):
                found += sign * own.accelerance(station) * force_of(self.held)
        return own.model.sensor_response * found

    def described(self) -> UnknownForce:
        """With its law, and when it acts."""
        law, history, law_share, shown = None, None, 0.0, 0.0
        if self.there.candidate.stations:
            history = history_of(self.there)
            law = shortest(laws(history), NAMED) if explained_share(self.there) > DESCRIBED else None
            if law is not None:
                freely = explained(self.held.observed, self.held.response, self.held.before)
                law_share, shown = law.share, kept(history_of(replace(self.held, after=freely)), law)
        return _told(self.there, self.again, self.held, history, law, law_share, shown)


def likeliest_force(fit: Record, rig: Rig, validation: Record) -> Sought:
    """The unmeasured force that explains the fit record best beside a rig, and how far both records agree.

    Whether it deserves to be believed, `same_place` and the gains say. Raises RigError if there are too few sensors to
    show an unmeasured force.
    """
    there = located(observed(fit, rig))
    other = observed(validation, rig)
    again = located(other)
    return Sought(there, again, _held(there, other, again))


def _held(there: Located, own: WhitenedRecord, again: Located) -> Located:
    """Another record with the place, and the shape of the spectrum, of the fit record; of a drift its bodies."""
    candidate = there.candidate
    if candidate.kind == "distributed":
        return again if again.candidate == candidate else located(own, near=candidate)
    shape = np.zeros(own.starts.size)
    common = min(shape.size, there.after.spectrum.size)
    shape[:common] = there.after.spectrum[:common]
    response = response_of(own, candidate)
    after = explained(own, response, again.before, shape=shape)
    return Located(candidate, again.before.criterion - after.criterion, 0.0, again.before, after, own, response, {})


def same_place(one: Located, other: Located) -> bool:
    """Whether two records show the same."""
    a, b = one.candidate, other.candidate
    if (a.kind, a.sensor, a.bodies) != (b.kind, b.sensor, b.bodies):
        return False
    near = max(SAME_M, 5 * float(np.hypot(one.error_m, other.error_m)))
    return all(
        p.body == q.body and abs(p.position_m - q.position_m) <= near
        for p, q in zip(a.stations, b.stations, strict=True)
    )


def _told(
    there: Located,
    again: Located,
    held: Located,
    history: ForceHistory | None,
    law: ForceLaw | None,
    law_share: float,
    shown: float,
) -> UnknownForce:
    own, candidate = there.observed, there.candidate
    first, second = ([*candidate.stations, Station("", 0.0), Station("", 0.0)])[:2]
    elsewhere = again.candidate.stations[0].position_m if again.candidate.stations else 0.0
    density = 2 * there.after.spectrum * 2 / (own.count * own.record.length * own.record.sample_rate_hz)
    power = density * own.sizes
    tone = law is not None and law.form.name == "tone"
    rms = float(np.sqrt(np.sum(power) * own.record.sample_rate_hz / own.record.length))
    unit = "m/s^2" if candidate.kind == "sensor" else "N"
    in_contact, by_time = (0.0, ()) if history is None else _times(history)
    before = 0.0 if history is None else _before(history)
    return UnknownForce(
        kind=candidate.kind,
        body=first.body,
        position_m=Value(first.position_m, there.error_m, "m"),
        validation_position_m=Value(elsewhere, again.error_m, "m"),
        against_body=second.body,
        against_position_m=second.position_m,
        sensor=candidate.sensor,
        bodies=candidate.bodies,
        growth=tuple(Value(g, e, "1") for g, e in zip(there.growth, there.growth_errors, strict=True)),
        same_place=same_place(there, again),
        band_hz=_band(own, power),
        frequency_hz=law.parameter if law is not None and tone else None,
        when=_when(in_contact, by_time, candidate.kind, law),
        in_contact_share=in_contact,
        before_excitation=before,
        by_time=by_time,
        against="none" if law is None or tone else law.form.against,
        rms=Value(
            rms, rms / float(np.sqrt(max(own.count * np.sum(power) ** 2 / max(np.sum(power**2), 1e-300), 2.0))), unit
        ),
        amplitude_n=float(math.hypot(*law.coefficients)) if law is not None and tone else None,
        explained_share=explained_share(there),
        validation_explained_share=explained_share(held),
        gain=there.gain,
        validation_gain=held.gain,
        gains_of_kinds=there.of_kinds,
        law_name="" if law is None else law.form.name,
        law="" if law is None else law.text,
        law_parameters={} if law is None else _parameters(law),
        law_share=law_share,
        validation_law_share=shown,
        surface=None if history is None else _surface(history),
        spectrum_hz=tuple(((np.floor(own.omega[own.starts] / (2 * np.pi * BAND_HZ)) + 0.5) * BAND_HZ).tolist()),
        spectrum=tuple(density.tolist()),
    )


def _parameters(law: ForceLaw) -> dict[str, Value]:
    names = ("amplitude of cosine", "amplitude of sine") if law.form.name == "tone" else ("coefficient", "cubic")
    found = {
        name: Value(value, error, unit)
        for name, value, error, unit in zip(names, law.coefficients, law.errors, law.form.units, strict=False)
    }
    if law.form.parameter:
        found[law.form.parameter] = Value(law.parameter, law.parameter_error, law.form.unit)
    if law.form.slow:
        found["offset"] = Value(law.offset_m, 0.0, "m")
    return found


def _band(own: WhitenedRecord, power: Float[np.ndarray, " bands"]) -> tuple[float, float]:
    """Holds `IN_BAND` of the force's power, as much left out at either end; the whole band if there is none."""
    if not np.any(power):
        return float(own.omega[0] / (2 * np.pi)), float(own.omega[-1] / (2 * np.pi))
    grown = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    first, last = np.searchsorted(grown, [(1 - IN_BAND) / 2, (1 + IN_BAND) / 2])
    low = own.omega[own.starts[min(first, grown.size - 1)]]
    high = own.omega[np.append(own.starts, own.omega.size)[min(last, grown.size - 1) + 1] - 1]
    return float(low / (2 * np.pi)), float(high / (2 * np.pi))


def _times(history: ForceHistory) -> tuple[float, tuple[float, ...]]:
    """The share of the force's mean square while a contact is closed, zero if one nearly always is; its rms in equal
    parts of the time."""
    own = history.located.observed
    record, model = own.record, own.model
    squares = history.found_n[record.taken] ** 2
    forces, open_n = record.in_time(model.contact_n), model.open_n(record)
    closed = np.zeros(squares.size, dtype=bool)
    for force, deviation_n in zip(forces, open_n.tolist(), strict=True):
        closed |= is_closed(force, deviation_n)
    excited = record.time_s > record.excited_s
    parts = [float(np.sqrt(np.mean(part))) for part in np.array_split(squares[excited], PARTS)]
    share = float(squares[closed].sum() / max(float(squares.sum()), 1e-300))
    return share if np.mean(closed) < MOSTLY else 0.0, tuple(parts)


def _before(history: ForceHistory) -> float:
    record = history.located.observed.record
    found, excited = history.found_n[record.taken], record.time_s > record.excited_s
    if np.mean(~excited) * found.size < QUIET_S * record.rate_hz:
        return 0.0
    return float(np.sqrt(np.mean(found[~excited] ** 2) / max(float(np.mean(found[excited] ** 2)), 1e-300)))


def _when(in_contact: float, by_time: tuple[float, ...], kind: Kind, law: ForceLaw | None) -> When:
    if kind == "distributed":
        return "growing with time"
    if law is None and in_contact > IN_BAND:
        return "in contact"
    if law is None and len(by_time) > 1 and min(by_time) > 0:
        steady = float(np.corrcoef(np.arange(len(by_time)), np.array(by_time))[0, 1])
        if steady > IN_BAND and by_time[-1] > GROWING * by_time[0]:
            return "growing with time"
    return "always"


def _surface(history: ForceHistory) -> ResidualMap:
    """The mean of the force against the motion, where it is known."""
    inside = history.counted == 1
    w, v = history.moved_m[::FINER][inside], history.rate_m_per_s[::FINER][inside]
    force, rows, columns = np.histogram2d(w, v, bins=CELLS, weights=-history.found_n[inside])
    count = np.histogram2d(w, v, bins=(rows, columns))[0]
    mean = force / np.maximum(count, 1)
    return ResidualMap(tuple(rows.tolist()), tuple(columns.tolist()), tuple(tuple(row) for row in mean.tolist()))
