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
from identify.gaps.unmeasured_force.whitened_record import BAND_WIDTH_HZ, WhitenedRecord
from identify.signals.beginning import QUIET_S
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
RANDOM_RATIO = 0.5
"""Rms before the excitation over that after its start, above which a force without a law is called random. Set by
hand."""


def described(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of the force by its fit record; the explained share is that of the validation record."""
    if force_fit.on_fit.force_place.stations:
        return _force_description(force_fit)
    return (
        _sensor_description(force_fit)
        if force_fit.on_fit.force_place.kind == "sensor"
        else _drift_description(force_fit)
    )


def _force_description(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a force at one station, or of a pair at two."""
    located_force, candidate = force_fit.on_fit, force_fit.on_fit.force_place
    history, force_size = force_history(located_force), _force_size(located_force)
    force_law = (
        shortest_law(fit_laws(history), LAW_GAIN_SHARE) if explained_share(located_force) > LAW_SEARCH_SHARE else None
    )
    place, *opposing_stations = candidate.stations
    timing = _time_pattern(history)
    time_pattern: When = "always" if force_law is not None else timing.pattern
    place_text = f"on the {place.body} near {place.position_m:.2f} m"
    if opposing_stations:
        place_text = (
            f"between the {place.body} near {place.position_m:.2f} m and the {opposing_stations[0].body} near "
            f"{opposing_stations[0].position_m:.2f} m"
        )
    tone_law = force_law if force_law is not None and force_law.form.is_tone else None
    return UnmeasuredForce(
        sentence=_sentence(force_law, force_size, timing, place_text),
        kind=candidate.kind,
        body=place.body,
        position_m=place.position_m,
        position_error_m=located_force.position_error_m,
        against_body=opposing_stations[0].body if opposing_stations else None,
        against_position_m=opposing_stations[0].position_m if opposing_stations else None,
        same_place=force_fit.same_place,
        frequency_hz=tone_law.parameter_value if tone_law else None,
        band_hz=force_size.band_hz,
        rms_n=force_size.rms_value,
        amplitude_n=_amplitude_n(tone_law) if tone_law else None,
        when=time_pattern,
        before_excitation=timing.before_excitation_ratio,
        by_time=timing.rms_by_interval,
        against="none" if force_law is None or tone_law else force_law.form.argument,
        law_name="" if force_law is None else force_law.form.name,
        law="" if force_law is None else force_law.formula,
        law_parameters={} if force_law is None else force_law.parameters,
        explained=explained_share(force_fit.at_fit_place),
        over_motion=_mean_force_over_motion(history),
        spectrum_hz=force_size.spectrum_hz,
        spectrum=force_size.spectral_density,
    )


def _sensor_description(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a sensor's signal of its own, with the spectrum in (m/s^2)^2/Hz."""
    force_size, sensor_name = _force_size(force_fit.on_fit), force_fit.on_fit.force_place.sensor_name
    return UnmeasuredForce(
        sentence=f"a fault of sensor {sensor_name}: its signal does not follow the motion",
        kind="sensor",
        sensor=sensor_name,
        same_place=force_fit.same_place,
        band_hz=force_size.band_hz,
        rms_n=force_size.rms_value,
        explained=explained_share(force_fit.at_fit_place),
        spectrum_hz=force_size.spectrum_hz,
        spectrum=force_size.spectral_density,
    )


def _drift_description(force_fit: UnmeasuredForceFit) -> UnmeasuredForce:
    """Description of a modulus that changes over the record."""
    force_size, located_force = _force_size(force_fit.on_fit), force_fit.on_fit
    growth_by_body = {
        body_name: Value(relative_change, change_error, "1")
        for body_name, relative_change, change_error in zip(
            located_force.force_place.body_names,
            located_force.modulus_growth,
            located_force.modulus_growth_errors,
            strict=True,
        )
    }
    change_texts = " and ".join(
        f"that of the {body_name} by {100 * relative_change.value:+.2g} %"
        for body_name, relative_change in growth_by_body.items()
    )
    return UnmeasuredForce(
        sentence=f"a stiffness that changes over the record: {change_texts}",
        kind="distributed",
        growth=growth_by_body,
        same_place=force_fit.same_place,
        band_hz=force_size.band_hz,
        rms_n=force_size.rms_value,
        when="growing with time",
        explained=explained_share(force_fit.at_fit_place),
        spectrum_hz=force_size.spectrum_hz,
        spectrum=force_size.spectral_density,
    )


@dataclass(frozen=True)
class _ForceSize:
    """One-sided spectral density by band (centres in Hz), rms, and the band with most of the power."""

    spectrum_hz: tuple[float, ...]
    spectral_density: tuple[float, ...]
    rms_value: float
    band_hz: tuple[float, float]


def _force_size(located_force: LocatedForce) -> _ForceSize:
    whitened, record = located_force.whitened_record, located_force.whitened_record.record
    spectral_density = (
        2
        * located_force.fit_with_force.force_spectrum
        * 2
        / (whitened.reals_per_line * record.transform_length * record.sample_rate_hz)
    )
    band_power = spectral_density * whitened.band_sizes
    band_number = np.floor(whitened.line_omegas[whitened.band_starts] / (2 * np.pi * BAND_WIDTH_HZ))
    return _ForceSize(
        spectrum_hz=tuple(((band_number + 0.5) * BAND_WIDTH_HZ).tolist()),
        spectral_density=tuple(spectral_density.tolist()),
        rms_value=float(np.sqrt(np.sum(band_power) * record.sample_rate_hz / record.transform_length)),
        band_hz=_power_band_hz(whitened, band_power),
    )


def _power_band_hz(whitened: WhitenedRecord, band_power: Float[np.ndarray, " bands"]) -> tuple[float, float]:
    """Limits (Hz) that hold `BAND_POWER_SHARE` of the power, equal parts below and above; all lines if it is zero."""
    if not np.any(band_power):
        return float(whitened.line_omegas[0] / (2 * np.pi)), float(whitened.line_omegas[-1] / (2 * np.pi))
    cumulative_power = np.cumsum(band_power) / max(float(np.sum(band_power)), 1e-300)
    first_band, second_band = np.searchsorted(
        cumulative_power, [(1 - BAND_POWER_SHARE) / 2, (1 + BAND_POWER_SHARE) / 2]
    )
    band_edge_lines, last_band = np.append(whitened.band_starts, whitened.line_omegas.size), cumulative_power.size - 1
    lowest_omega = whitened.line_omegas[band_edge_lines[min(first_band, last_band)]]
    highest_omega = whitened.line_omegas[band_edge_lines[min(second_band, last_band) + 1] - 1]
    return float(lowest_omega / (2 * np.pi)), float(highest_omega / (2 * np.pi))


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
        if min(self.rms_by_interval) > 0:
            correlation = float(np.corrcoef(np.arange(len(self.rms_by_interval)), np.array(self.rms_by_interval))[0, 1])
            if correlation > BAND_POWER_SHARE and self.rms_by_interval[-1] > GROWTH_RATIO * self.rms_by_interval[0]:
                return "growing with time"
        return "always"


def _time_pattern(history: ForceHistory) -> _ForceTiming:
    whitened = history.located_force.whitened_record
    record, model = whitened.record, whitened.model
    force_n = history.force_n[record.counted_slice]
    force_squares, is_excited = force_n**2, record.residual_times_s > record.excitation_start_s
    is_any_closed = np.zeros(force_squares.size, dtype=bool)
    for contact_n, open_error_n in zip(
        record.in_time(model.contact_n), model.contact_force_error_n(record), strict=True
    ):
        is_any_closed |= is_closed(contact_n, open_error_n)
    closed_share = float(force_squares[is_any_closed].sum() / max(float(force_squares.sum()), 1e-300))
    is_quiet_at_start = np.mean(~is_excited) * force_squares.size >= QUIET_S * record.rate_hz
    return _ForceTiming(
        in_contact_share=closed_share if np.mean(is_any_closed) < MOSTLY_CLOSED_SHARE else 0.0,
        rms_by_interval=tuple(
            float(np.sqrt(np.mean(interval_squares)))
            for interval_squares in np.array_split(force_squares[is_excited], TIME_INTERVALS)
        ),
        before_excitation_ratio=float(
            np.sqrt(np.mean(force_squares[~is_excited]) / max(float(np.mean(force_squares[is_excited])), 1e-300))
        )
        if is_quiet_at_start
        else 0.0,
    )


def _mean_force_over_motion(history: ForceHistory) -> MeanForce:
    """Mean of the force against the motion (N) in cells of displacement (m) and velocity (m/s), where ungated."""
    is_ungated = history.time_gate == 1
    displacement_m = history.displacement_m[::OVERSAMPLING][is_ungated]
    velocity_m_per_s = history.velocity_m_per_s[::OVERSAMPLING][is_ungated]
    force_sums, displacement_edges, velocity_edges = np.histogram2d(
        displacement_m, velocity_m_per_s, bins=MOTION_CELLS, weights=-history.force_n[is_ungated]
    )
    samples_per_cell = np.histogram2d(displacement_m, velocity_m_per_s, bins=(displacement_edges, velocity_edges))[0]
    mean_forces_n = force_sums / np.maximum(samples_per_cell, 1)
    return MeanForce(
        tuple(displacement_edges.tolist()),
        tuple(velocity_edges.tolist()),
        tuple(tuple(force_row) for force_row in mean_forces_n.tolist()),
    )


def _amplitude_n(tone: ForceLaw) -> float:
    return math.hypot(*tone.coefficients)


def _sentence(force_law: ForceLaw | None, force_size: _ForceSize, timing: _ForceTiming, place_text: str) -> str:
    """Phrase such as "a force at 50.0 Hz, 1.4 N, on the cradle near 0.80 m"."""
    if force_law is None:
        low_hz, high_hz = force_size.band_hz
        timing_text = {
            "always": "",
            "in contact": ", while contacts are closed",
            "growing with time": ", growing with time",
        }
        force_noun = (
            "a random force" if timing.before_excitation_ratio > RANDOM_RATIO else "a force that follows no law tried,"
        )
        return (
            f"{force_noun} from {low_hz:.3g} to {high_hz:.3g} Hz, {force_size.rms_value:.2g} N rms, "
            f"{place_text}{timing_text[timing.pattern]}"
        )
    if force_law.form.is_tone:
        return f"a force at {force_law.parameter_value:.1f} Hz, {_amplitude_n(force_law):.2g} N, {place_text}"
    return f"{force_law.form.phrase_template.format(where=place_text)}, {force_law.formula}"
