"""Description of an unmeasured force for gap.json: body, place, band, size, time pattern and law."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.observation import is_closed
from identify.gaps.unmeasured_force.force import UnmeasuredForceFit
from identify.gaps.unmeasured_force.force_laws import ForceLaw
from identify.gaps.unmeasured_force.law_fit import fit_laws, shortest_law
from identify.gaps.unmeasured_force.location import LocatedForce
from identify.gaps.unmeasured_force.time_history import OVERSAMPLING, ForceHistory, explained_share, force_history
from identify.gaps.unmeasured_force.whitened_record import BAND_HZ, WhitenedRecord
from identify.signals.beginning import QUIET_S
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce, Value, When

LAW_SEARCH_SHARE = 0.2
"""Explained share from which a law is searched; null simulations explain one direction of ten. Set by hand."""
LAW_GAIN_SHARE = 0.7
"""Share of the free force's gain from which a law is named. Set by hand."""
IN_BAND = 0.9
"""Share of the power within the stated band; share in contact, and correlation with time, from which they are stated.
Set by hand."""
CELLS, PARTS = 24, 8
"""Cells of the drawn surface along either axis, and intervals of the time. Display."""
GROWTH_RATIO = 1.5
"""Ratio of the last to the first interval of the time above which a force grows. Set by hand."""
MOSTLY_CLOSED_SHARE = 0.7
"""Share of the time above which a contact is nearly always closed. Set by hand."""
RANDOM_RATIO = 0.5
"""Rms before the excitation over that after its start, above which a force without a law is called random. Set by
hand."""


def described(fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of the force by its fit record; the explained share is that of the validation record."""
    if fit.on_fit.candidate.stations:
        return _force(fit)
    return _sensor(fit) if fit.on_fit.candidate.kind == "sensor" else _drift(fit)


def _force(fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a force at one station, or of a pair at two."""
    located, candidate = fit.on_fit, fit.on_fit.candidate
    history, size = force_history(located), _size(located)
    law = shortest_law(fit_laws(history), LAW_GAIN_SHARE) if explained_share(located) > LAW_SEARCH_SHARE else None
    place, *against = candidate.stations
    timing = _timing(history)
    pattern: When = "always" if law is not None else timing.pattern
    place_text = f"on the {place.body} near {place.position_m:.2f} m"
    if against:
        place_text = (
            f"between the {place.body} near {place.position_m:.2f} m and the {against[0].body} near "
            f"{against[0].position_m:.2f} m"
        )
    tone = law if law is not None and law.form.is_tone else None
    return UnmeasuredForce(
        sentence=_sentence(law, size, timing, place_text),
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
        when=pattern,
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
    """Description of a sensor's signal of its own, with the spectrum in (m/s^2)^2/Hz."""
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
    """Description of a modulus that changes over the record."""
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
    """One-sided spectral density by band (centres in Hz), rms, and the band with most of the power."""

    spectrum_hz: tuple[float, ...]
    spectrum: tuple[float, ...]
    rms: float
    band_hz: tuple[float, float]


def _size(located: LocatedForce) -> _Size:
    whitened, record = located.whitened, located.whitened.record
    density = 2 * located.with_force.spectrum * 2 / (whitened.reals_per_line * record.length * record.sample_rate_hz)
    power = density * whitened.band_sizes
    band_number = np.floor(whitened.omega[whitened.band_starts] / (2 * np.pi * BAND_HZ))
    return _Size(
        spectrum_hz=tuple(((band_number + 0.5) * BAND_HZ).tolist()),
        spectrum=tuple(density.tolist()),
        rms=float(np.sqrt(np.sum(power) * record.sample_rate_hz / record.length)),
        band_hz=_band(whitened, power),
    )


def _band(whitened: WhitenedRecord, power: Float[np.ndarray, " bands"]) -> tuple[float, float]:
    """Limits (Hz) that hold `IN_BAND` of the power, with equal parts below and above; all lines if it is zero."""
    if not np.any(power):
        return float(whitened.omega[0] / (2 * np.pi)), float(whitened.omega[-1] / (2 * np.pi))
    cumulative_power = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    first, last = np.searchsorted(cumulative_power, [(1 - IN_BAND) / 2, (1 + IN_BAND) / 2])
    edges, last_band = np.append(whitened.band_starts, whitened.omega.size), cumulative_power.size - 1
    low = whitened.omega[edges[min(first, last_band)]]
    high = whitened.omega[edges[min(last, last_band) + 1] - 1]
    return float(low / (2 * np.pi)), float(high / (2 * np.pi))


@dataclass(frozen=True)
class _Timing:
    """Time pattern of a force: by_time and before_excitation as in `UnmeasuredForce`.

    in_contact_share is the part of its sum of squares while a contact is closed; zero if one nearly always is.
    """

    in_contact_share: float
    by_time: tuple[float, ...]
    before_excitation: float

    @property
    def pattern(self) -> When:
        if self.in_contact_share > IN_BAND:
            return "in contact"
        if min(self.by_time) > 0:
            correlation = float(np.corrcoef(np.arange(len(self.by_time)), np.array(self.by_time))[0, 1])
            if correlation > IN_BAND and self.by_time[-1] > GROWTH_RATIO * self.by_time[0]:
                return "growing with time"
        return "always"


def _timing(history: ForceHistory) -> _Timing:
    whitened = history.located.whitened
    record, model = whitened.record, whitened.model
    force_n = history.force_n[record.counted_samples]
    squares, excited = force_n**2, record.time_s > record.excited_s
    closed = np.zeros(squares.size, dtype=bool)
    for contact_n, open_n in zip(record.in_time(model.contact_n), model.contact_force_error_n(record), strict=True):
        closed |= is_closed(contact_n, open_n)
    share = float(squares[closed].sum() / max(float(squares.sum()), 1e-300))
    quiet = np.mean(~excited) * squares.size >= QUIET_S * record.rate_hz
    return _Timing(
        in_contact_share=share if np.mean(closed) < MOSTLY_CLOSED_SHARE else 0.0,
        by_time=tuple(float(np.sqrt(np.mean(interval))) for interval in np.array_split(squares[excited], PARTS)),
        before_excitation=float(np.sqrt(np.mean(squares[~excited]) / max(float(np.mean(squares[excited])), 1e-300)))
        if quiet
        else 0.0,
    )


def _over_motion(history: ForceHistory) -> MeanForce:
    """Mean of the force against the motion (N) in cells of displacement (m) and velocity (m/s), where ungated."""
    ungated = history.gate == 1
    w, v = history.displacement_m[::OVERSAMPLING][ungated], history.velocity_m_per_s[::OVERSAMPLING][ungated]
    force, rows, columns = np.histogram2d(w, v, bins=CELLS, weights=-history.force_n[ungated])
    count = np.histogram2d(w, v, bins=(rows, columns))[0]
    mean = force / np.maximum(count, 1)
    return MeanForce(tuple(rows.tolist()), tuple(columns.tolist()), tuple(tuple(row) for row in mean.tolist()))


def _amplitude_n(tone: ForceLaw) -> float:
    return math.hypot(*tone.coefficients)


def _sentence(law: ForceLaw | None, size: _Size, timing: _Timing, place_text: str) -> str:
    """Phrase such as "a force at 50.0 Hz, 1.4 N, on the cradle near 0.80 m"."""
    if law is None:
        low, high = size.band_hz
        timing_text = {
            "always": "",
            "in contact": ", while contacts are closed",
            "growing with time": ", growing with time",
        }
        noun = "a random force" if timing.before_excitation > RANDOM_RATIO else "a force by no law that was tried,"
        return (
            f"{noun} from {low:.3g} to {high:.3g} Hz, {size.rms:.2g} N rms, {place_text}{timing_text[timing.pattern]}"
        )
    if law.form.is_tone:
        return f"a force at {law.parameter:.1f} Hz, {_amplitude_n(law):.2g} N, {place_text}"
    return f"{law.form.words.format(where=place_text)}, {law.text}"
