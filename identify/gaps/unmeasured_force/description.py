"""An unmeasured force as gap.json tells it: on which body, where, in which band, when, and by what law."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.observation import is_closed
from identify.gaps.unmeasured_force.force import UnmeasuredForceFit
from identify.gaps.unmeasured_force.force_laws import ForceLaw
from identify.gaps.unmeasured_force.law_fit import laws, shortest
from identify.gaps.unmeasured_force.location import Located
from identify.gaps.unmeasured_force.observed import BAND_HZ, WhitenedRecord
from identify.gaps.unmeasured_force.time_history import FINER, ForceHistory, explained_share, history_of
from identify.signals.beginning import QUIET_S
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce, Value, When

DESCRIBED = 0.2
"""No law is looked for if less is explained: null simulations explain one direction of ten."""
NAMED = 0.7
"""A law is named if it keeps at least this share of what the free force gains."""
IN_BAND = 0.9
CELLS, PARTS = 24, 8
GROWING = 1.5
MOSTLY = 0.7
ALONE = 0.5
"""A force is random if it is at least this share of itself before the excitation begins."""


def described(fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """The force as its fit record shows it; what it explains, as the validation record does."""
    if fit.on_fit.candidate.stations:
        return _force(fit)
    return _sensor(fit) if fit.on_fit.candidate.kind == "sensor" else _drift(fit)


def _force(fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a force at a place, or between two."""
    located, candidate = fit.on_fit, fit.on_fit.candidate
    history, size = history_of(located), _size(located)
    law = shortest(laws(history), NAMED) if explained_share(located) > DESCRIBED else None
    place, *against = candidate.stations
    timing = _timing(history)
    when: When = "always" if law is not None else timing.when
    where = f"on the {place.body} near {place.position_m:.2f} m"
    if against:
        where = (
            f"between the {place.body} near {place.position_m:.2f} m and the {against[0].body} near "
            f"{against[0].position_m:.2f} m"
        )
    tone = law if law is not None and law.form.is_tone else None
    return UnmeasuredForce(
        sentence=_sentence(law, size, timing, where),
        kind=candidate.kind,
        body=place.body,
        position_m=place.position_m,
        position_error_m=located.error_m,
        against_body=against[0].body if against else None,
        against_position_m=against[0].position_m if against else None,
        same_place=fit.same_place,
        frequency_hz=tone.parameter if tone else None,
        band_hz=size.band_hz,
        rms_n=size.rms,
        amplitude_n=_amplitude_n(tone) if tone else None,
        when=when,
        before_excitation=timing.before_excitation,
        by_time=timing.by_time,
        against="none" if law is None or tone else law.form.against,
        law_name="" if law is None else law.form.name,
        law="" if law is None else law.text,
        law_parameters={} if law is None else law.parameters,
        explained=explained_share(fit.held),
        over_motion=_over_motion(history),
        spectrum_hz=size.spectrum_hz,
        spectrum=size.spectrum,
    )


def _sensor(fit: UnmeasuredForceFit) -> UnmeasuredForce:
    size, sensor = _size(fit.on_fit), fit.on_fit.candidate.sensor
    return UnmeasuredForce(
        sentence=f"a fault of sensor {sensor}: its signal does not follow the motion",
        kind="sensor",
        sensor=sensor,
        same_place=fit.same_place,
        band_hz=size.band_hz,
        rms_n=size.rms,
        explained=explained_share(fit.held),
        spectrum_hz=size.spectrum_hz,
        spectrum=size.spectrum,
    )


def _drift(fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """A modulus that changes over the record."""
    size, located = _size(fit.on_fit), fit.on_fit
    growth = {
        body: Value(change, error, "1")
        for body, change, error in zip(located.candidate.bodies, located.growth, located.growth_errors, strict=True)
    }
    changes = " and ".join(f"of the {body} by {100 * change.value:+.2g} %" for body, change in growth.items())
    return UnmeasuredForce(
        sentence=f"a stiffness that changes over the record, {changes}",
        kind="distributed",
        growth=growth,
        same_place=fit.same_place,
        band_hz=size.band_hz,
        rms_n=size.rms,
        when="growing with time",
        explained=explained_share(fit.held),
        spectrum_hz=size.spectrum_hz,
        spectrum=size.spectrum,
    )


@dataclass(frozen=True)
class _Size:
    """Spectral density by bands, the root mean square, and the band that holds most of the power."""

    spectrum_hz: tuple[float, ...]
    spectrum: tuple[float, ...]
    rms: float
    band_hz: tuple[float, float]


def _size(located: Located) -> _Size:
    own = located.observed
    density = 2 * located.after.spectrum * 2 / (own.count * own.record.length * own.record.sample_rate_hz)
    power = density * own.sizes
    return _Size(
        spectrum_hz=tuple(((np.floor(own.omega[own.starts] / (2 * np.pi * BAND_HZ)) + 0.5) * BAND_HZ).tolist()),
        spectrum=tuple(density.tolist()),
        rms=float(np.sqrt(np.sum(power) * own.record.sample_rate_hz / own.record.length)),
        band_hz=_band(own, power),
    )


def _band(own: WhitenedRecord, power: Float[np.ndarray, " bands"]) -> tuple[float, float]:
    """Holds `IN_BAND` of the force's power, as much left out at either end; the whole band if there is none."""
    if not np.any(power):
        return float(own.omega[0] / (2 * np.pi)), float(own.omega[-1] / (2 * np.pi))
    grown = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    first, last = np.searchsorted(grown, [(1 - IN_BAND) / 2, (1 + IN_BAND) / 2])
    low = own.omega[own.starts[min(first, grown.size - 1)]]
    high = own.omega[np.append(own.starts, own.omega.size)[min(last, grown.size - 1) + 1] - 1]
    return float(low / (2 * np.pi)), float(high / (2 * np.pi))


@dataclass(frozen=True)
class _Timing:
    """Timing of a force: by_time and before_excitation as in `UnmeasuredForce`; in_contact_share is the share of its
    mean square while a contact is closed, zero if one nearly always is."""

    in_contact_share: float
    by_time: tuple[float, ...]
    before_excitation: float

    @property
    def when(self) -> When:
        if self.in_contact_share > IN_BAND:
            return "in contact"
        if min(self.by_time) > 0:
            steady = float(np.corrcoef(np.arange(len(self.by_time)), np.array(self.by_time))[0, 1])
            if steady > IN_BAND and self.by_time[-1] > GROWING * self.by_time[0]:
                return "growing with time"
        return "always"


def _timing(history: ForceHistory) -> _Timing:
    own = history.located.observed
    record, model = own.record, own.model
    force_n = history.found_n[record.taken]
    squares, excited = force_n**2, record.time_s > record.excited_s
    closed = np.zeros(squares.size, dtype=bool)
    for contact_n, open_n in zip(record.in_time(model.contact_n), model.open_n(record), strict=True):
        closed |= is_closed(contact_n, open_n)
    share = float(squares[closed].sum() / max(float(squares.sum()), 1e-300))
    quiet = np.mean(~excited) * squares.size >= QUIET_S * record.rate_hz
    return _Timing(
        in_contact_share=share if np.mean(closed) < MOSTLY else 0.0,
        by_time=tuple(float(np.sqrt(np.mean(part))) for part in np.array_split(squares[excited], PARTS)),
        before_excitation=float(np.sqrt(np.mean(squares[~excited]) / max(float(np.mean(squares[excited])), 1e-300)))
        if quiet
        else 0.0,
    )


def _over_motion(history: ForceHistory) -> MeanForce:
    """The mean of the force against the motion, where it is known."""
    inside = history.counted == 1
    w, v = history.moved_m[::FINER][inside], history.rate_m_per_s[::FINER][inside]
    force, rows, columns = np.histogram2d(w, v, bins=CELLS, weights=-history.found_n[inside])
    count = np.histogram2d(w, v, bins=(rows, columns))[0]
    mean = force / np.maximum(count, 1)
    return MeanForce(tuple(rows.tolist()), tuple(columns.tolist()), tuple(tuple(row) for row in mean.tolist()))


def _amplitude_n(tone: ForceLaw) -> float:
    return math.hypot(*tone.coefficients)


def _sentence(law: ForceLaw | None, size: _Size, timing: _Timing, where: str) -> str:
    """Sentence such as "a force at 50.0 Hz, 1.4 N, on the cradle near 0.80 m"."""
    if law is None:
        low, high = size.band_hz
        when = {"always": "", "in contact": ", while contacts are closed", "growing with time": ", growing with time"}
        what = "a random force" if timing.before_excitation > ALONE else "a force by no law that was tried,"
        return f"{what} from {low:.3g} to {high:.3g} Hz, {size.rms:.2g} N rms, {where}{when[timing.when]}"
    if law.form.is_tone:
        return f"a force at {law.parameter:.1f} Hz, {_amplitude_n(law):.2g} N, {where}"
    return f"{law.form.words.format(where=where)}, {law.text}"
