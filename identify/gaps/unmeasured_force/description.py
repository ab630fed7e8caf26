"""Description of an unmeasured force for gap.json: body, place, band, size, time pattern and law."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.observation import is_closed
from identify.gaps.unmeasured_force.force import UnmeasuredForceFit
from identify.gaps.unmeasured_force.force_laws import ForceLaw
from identify.gaps.unmeasured_force.law_fit import fit_laws, simplest_adequate_law
from identify.gaps.unmeasured_force.location import LocatedForce
from identify.gaps.unmeasured_force.time_history import (
    LAW_OVERSAMPLING,
    ForceAndMotionHistory,
    explained_share,
    force_and_motion_history,
)
from identify.gaps.unmeasured_force.whitened_record import BAND_WIDTH_HZ, WhitenedRecord
from identify.pages.wording import change_words, estimate_words, number
from identify.signals.beginning import QUIET_S
from rig.model.description import Rig, Station
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce, Value, When

LAW_SEARCH_SHARE = 0.2
"""Explained share from which a law is searched; null simulations explain one direction of ten. Set by hand."""
LAW_GAIN_SHARE = 0.7
"""Share of the free force's gain from which a law is named. Set by hand."""
BAND_POWER_SHARE = 0.9
"""Share of the power within the stated band; share in contact, and correlation with time, from which they are stated.
Set by hand."""
MOTION_CELLS, TIME_INTERVALS = 24, 8
"""Cells of the drawn surface along either axis, and intervals of the time. Display."""
GROWTH_RATIO = 1.5
"""Ratio of the last to the first interval of the time above which a force grows. Set by hand."""
MOSTLY_CLOSED_SHARE = 0.7
"""Share of the time above which a contact is nearly always closed. Set by hand."""
RANDOM_RMS_RATIO = 0.5
"""Rms before the excitation over that after its start, above which a force without a law is called random. Set by
hand."""


def described_force(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of the force by its fit record; the explained share is that of the validation record."""
    place = force_fit.on_fit_record.force_place
    if place.stations:
        return _force_description(force_fit)
    return _sensor_description(force_fit) if place.kind == "sensor" else _drift_description(force_fit)


def _force_description(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a force at one station, or of a pair at two."""
    located, place = force_fit.on_fit_record, force_fit.on_fit_record.force_place
    history, size = force_and_motion_history(located), _force_size(located)
    law = (
        simplest_adequate_law(fit_laws(history), LAW_GAIN_SHARE)
        if explained_share(located) > LAW_SEARCH_SHARE
        else None
    )
    tone = law if law and law.form.is_tone else None
    timing = _force_timing(history)
    station, opposite_station = place.stations[0], place.stations[1] if len(place.stations) > 1 else None
    rig = located.whitened_record.record.rig
    station_error_m = located.whitened_record.record.tolerances.position_m  # as places are told by the sensors
    place_error_m = float(np.hypot(located.position_error_m, station_error_m))
    position_error_m = None if rig.body(station.body).is_mass else place_error_m
    near_text = _near_text(rig, station, place_error_m)
    place_text = (
        f"between {near_text} and {_near_text(rig, opposite_station)}" if opposite_station else f"on {near_text}"
    )
    return UnmeasuredForce(
        sentence=_sentence(law, size, timing, place_text),
        kind=place.kind,
        body=station.body,
        position_m=station.position_m,
        position_error_m=position_error_m,
        against_body=opposite_station.body if opposite_station else None,
        against_position_m=opposite_station.position_m if opposite_station else None,
        same_place=force_fit.same_place,
        frequency_hz=tone.parameter_value if tone else None,
        band_hz=size.band_hz,
        rms_n=size.rms_value,
        amplitude_n=_amplitude_and_error_n(tone)[0] if tone else None,
        when="always" if law else timing.pattern,
        before_excitation=timing.before_excitation_ratio,
        by_time=timing.rms_by_interval,
        against=law.form.argument if law and not tone else "none",
        law_name=law.form.name if law else "",
        law=law.formula if law else "",
        law_parameters=law.parameters if law else {},
        explained=explained_share(force_fit.at_fit_place),
        over_motion=_mean_force_over_motion(history),
        spectrum_hz=size.spectrum_hz,
        spectrum=size.spectral_density,
    )


def _sensor_description(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a sensor's signal of its own, with the spectrum in (m/s^2)^2/Hz."""
    size, sensor_name = _force_size(force_fit.on_fit_record), force_fit.on_fit_record.force_place.sensor_name
    return UnmeasuredForce(
        sentence=f"a fault of sensor {sensor_name}: its signal does not follow the motion",
        kind="sensor",
        sensor=sensor_name,
        same_place=force_fit.same_place,
        band_hz=size.band_hz,
        rms_n=size.rms_value,
        explained=explained_share(force_fit.at_fit_place),
        spectrum_hz=size.spectrum_hz,
        spectrum=size.spectral_density,
    )


def _drift_description(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a modulus that changes over the record."""
    size, located = _force_size(force_fit.on_fit_record), force_fit.on_fit_record
    growth_and_errors = zip(
        located.force_place.body_names, located.modulus_growth, located.modulus_growth_errors, strict=True
    )
    growth = {body: Value(change, error, "1") for body, change, error in growth_and_errors}
    growth_words = " and ".join(
        f"that of the {body} by {change_words(change.value, change.standard_error)}" for body, change in growth.items()
    )
    return UnmeasuredForce(
        sentence=f"a stiffness that changes over the record: {growth_words}",
        kind="distributed",
        growth=growth,
        same_place=force_fit.same_place,
        band_hz=size.band_hz,
        rms_n=size.rms_value,
        when="growing with time",
        explained=explained_share(force_fit.at_fit_place),
        spectrum_hz=size.spectrum_hz,
        spectrum=size.spectral_density,
    )


@dataclass(frozen=True)
class _ForceSize:
    """One-sided spectral density by band (centres in Hz), rms, and the band with most of the power."""

    spectrum_hz: tuple[float, ...]
    spectral_density: tuple[float, ...]
    rms_value: float
    band_hz: tuple[float, float]


def _force_size(located: LocatedForce) -> _ForceSize:
    whitened, record = located.whitened_record, located.whitened_record.record
    spectral_density = (
        2
        * located.with_force.force_spectrum
        * 2
        / (whitened.reals_per_line * record.transform_length * record.sample_rate_hz)
    )
    band_power = spectral_density * whitened.band_line_counts
    band_numbers = np.floor(whitened.line_omegas[whitened.band_first_lines] / (2 * np.pi * BAND_WIDTH_HZ))
    return _ForceSize(
        spectrum_hz=tuple(((band_numbers + 0.5) * BAND_WIDTH_HZ).tolist()),
        spectral_density=tuple(spectral_density.tolist()),
        rms_value=float(np.sqrt(np.sum(band_power) * record.sample_rate_hz / record.transform_length)),
        band_hz=_power_band_hz(whitened, band_power),
    )


def _power_band_hz(whitened: WhitenedRecord, band_power: Float[np.ndarray, " bands"]) -> tuple[float, float]:
    """Limits (Hz) that hold `BAND_POWER_SHARE` of the power, equal parts below and above; all lines if it is zero."""
    omegas, last_band = whitened.line_omegas, band_power.size - 1
    if not np.any(band_power):
        return float(omegas[0] / (2 * np.pi)), float(omegas[-1] / (2 * np.pi))
    cumulative_power = np.cumsum(band_power) / max(float(np.sum(band_power)), 1e-300)
    low_band, high_band = np.searchsorted(cumulative_power, [(1 - BAND_POWER_SHARE) / 2, (1 + BAND_POWER_SHARE) / 2])
    edge_lines = np.append(whitened.band_first_lines, omegas.size)
    low_omega = omegas[edge_lines[min(low_band, last_band)]]
    high_omega = omegas[edge_lines[min(high_band, last_band) + 1] - 1]
    return float(low_omega / (2 * np.pi)), float(high_omega / (2 * np.pi))


@dataclass(frozen=True)
class _ForceTiming:
    """Time pattern of a force: rms_by_interval and before_excitation_ratio go to `UnmeasuredForce`.

    in_contact_share is the part of its sum of squares while a contact is closed; zero if one nearly always is.
    """

    in_contact_share: float
    rms_by_interval: tuple[float, ...]
    before_excitation_ratio: float

    @property
    def pattern(self) -> When:
        if self.in_contact_share > BAND_POWER_SHARE:
            return "in contact"
        rms = self.rms_by_interval
        if min(rms) > 0:
            correlation = float(np.corrcoef(np.arange(len(rms)), np.array(rms))[0, 1])
            if correlation > BAND_POWER_SHARE and rms[-1] > GROWTH_RATIO * rms[0]:
                return "growing with time"
        return "always"


def _force_timing(history: ForceAndMotionHistory) -> _ForceTiming:
    whitened = history.located_force.whitened_record
    record, model = whitened.record, whitened.model
    force_squares = history.free_force_n[record.counted_slice] ** 2
    is_excited = record.residual_times_s > record.excitation_start_s
    is_any_closed = np.zeros(force_squares.size, dtype=bool)
    contact_forces_n = record.in_time(model.contact_force_n)
    for force_n, error_n in zip(contact_forces_n, model.contact_force_error_n(record), strict=True):
        is_any_closed |= is_closed(force_n, error_n)
    square_share_closed = float(force_squares[is_any_closed].sum() / max(float(force_squares.sum()), 1e-300))
    before_excitation_ratio = 0.0
    if np.mean(~is_excited) * force_squares.size >= QUIET_S * record.residual_rate_hz:
        excited_square = max(float(np.mean(force_squares[is_excited])), 1e-300)
        before_excitation_ratio = float(np.sqrt(np.mean(force_squares[~is_excited]) / excited_square))
    intervals = np.array_split(force_squares[is_excited], TIME_INTERVALS)
    return _ForceTiming(
        in_contact_share=square_share_closed if np.mean(is_any_closed) < MOSTLY_CLOSED_SHARE else 0.0,
        rms_by_interval=tuple(float(np.sqrt(np.mean(interval))) for interval in intervals),
        before_excitation_ratio=before_excitation_ratio,
    )


def _mean_force_over_motion(history: ForceAndMotionHistory) -> MeanForce:
    """Mean of the force against the motion (N) in cells of displacement (m) and velocity (m/s), where ungated."""
    is_ungated = history.time_gate == 1
    displacement_m = history.displacement_m[::LAW_OVERSAMPLING][is_ungated]
    velocity_m_per_s = history.velocity_m_per_s[::LAW_OVERSAMPLING][is_ungated]
    force_n = -history.free_force_n[is_ungated]
    sums, edges_m, edges_m_per_s = np.histogram2d(displacement_m, velocity_m_per_s, bins=MOTION_CELLS, weights=force_n)
    sample_counts = np.histogram2d(displacement_m, velocity_m_per_s, bins=(edges_m, edges_m_per_s))[0]
    mean_forces_n = (sums / np.maximum(sample_counts, 1)).tolist()
    return MeanForce(tuple(edges_m.tolist()), tuple(edges_m_per_s.tolist()), tuple(map(tuple, mean_forces_n)))


def _amplitude_and_error_n(tone: ForceLaw) -> tuple[float, float]:
    """Amplitude A = sqrt(c^2 + s^2) of a tone with the coefficients c and s, and its standard error to first order."""
    amplitude_n = math.hypot(*tone.coefficients)
    return amplitude_n, math.hypot(*np.multiply(tone.coefficients, tone.coefficient_errors)) / max(amplitude_n, 1e-300)


def _near_text(rig: Rig, station: Station, position_error_m: float = 0.0) -> str:
    """Place in words; a mass has no length."""
    if rig.body(station.body).is_mass:
        return f"the {station.body}"
    position_words = estimate_words(station.position_m, position_error_m, "m", f"{station.position_m:.2f} m")
    return f"the {station.body} near {position_words}"


def _sentence(law: ForceLaw | None, size: _ForceSize, timing: _ForceTiming, place_text: str) -> str:
    """Phrase such as "a force at 50.02 ± 0.01 Hz, 1.40 ± 0.05 N, on the cradle near 0.800 ± 0.008 m"."""
    if law is None:
        low_hz, high_hz = size.band_hz
        timing_texts = {
            "always": "",
            "in contact": ", while contacts are closed",
            "growing with time": ", growing with time",
        }
        is_random = timing.before_excitation_ratio > RANDOM_RMS_RATIO
        noun = "a random force" if is_random else "a force that follows no law tried,"
        return (
            f"{noun} from {low_hz:.3g} to {high_hz:.3g} Hz, {number(size.rms_value, 2)} N rms, "
            f"{place_text}{timing_texts[timing.pattern]}"
        )
    if law.form.is_tone:
        frequency_words = estimate_words(law.parameter_value, law.parameter_error, "Hz")
        amplitude_words = estimate_words(*_amplitude_and_error_n(law), "N")
        return f"a force at {frequency_words}, {amplitude_words}, {place_text}"
    return f"{law.form.phrase_template.format(where=place_text)}, {law.formula}"
