"""Findings on a sensor or a force whose signal is not what all other channels predict: the likeliest cause.

A sensor is compared with the motion that the linear model predicts there, a force with the one that all sensors imply.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding, force_in_words
from identify.checks.prediction import LinearCheck, Prediction, driven_masks, predicted_acceleration_at
from identify.checks.relations import MIN_COHERENCE, PerLine, Relation, Spectrum, band_gain_fit, relation, unit_mistake
from identify.checks.spectra import Spectra
from rig.model.description import Rig, Station

POSITION_COUNT = 41
"""Places along a body that are tried for a sensor, twice: the second time around the best one."""
REFERENCE_WORDS = "the linear model and all other channels"

DelaysOnDemand = Callable[[], Float[np.ndarray, " parts"] | None]


@dataclass(frozen=True)
class Explanation:
    """Cause of a fault, and the share of the channel's power that it leaves unexplained.

    A cause with more freedom has a larger freedom_factor, by which its share counts more.
    """

    unexplained_share: float
    finding: Finding
    freedom_factor: float = 1.0


def likeliest_channel_finding(
    rig: Rig, check: LinearCheck, channel_index: int, prediction: Prediction, delays_over_time: DelaysOnDemand
) -> Finding:
    """Likeliest reason why a channel is not what all others predict.

    delays_over_time gives its delays in each part of the record, or None if these are alike.
    """
    spectra, line_weights = check.spectra, 1 / check.error_scale[channel_index]
    measured, omega, name = spectra.acceleration[channel_index], spectra.omega, spectra.sensors[channel_index].name
    predicted = prediction.accelerations[channel_index]
    fit = relation(omega, measured, predicted, line_weights)
    measured_power = float(np.sum(np.abs(measured * line_weights) ** 2)) or 1.0

    def residual_share(explained: Spectrum) -> float:
        return float(np.sum(np.abs((measured - explained) * line_weights) ** 2)) / measured_power

    explanations = [
        *_gain_and_delay_explanations(name, fit, omega, predicted, residual_share),
        *_sensor_place_explanations(rig, spectra, channel_index, prediction, line_weights, residual_share),
        *_wrong_derivative_explanations(spectra, channel_index, predicted, line_weights),
        *_filter_explanations(name, omega, measured, predicted, line_weights),
    ]
    likeliest = min(explanations, key=lambda explanation: explanation.unexplained_share * explanation.freedom_factor)
    if likeliest.unexplained_share > 0.02 and (delays_s := delays_over_time()) is not None:
        return _slipped_samples_finding(name, delays_s)
    if likeliest.unexplained_share > 1 - MIN_COHERENCE:
        return Finding(
            cause="unrelated",
            channels=(name,),
            evidence=f"{name} follows {100 * max(fit.coherence, 0):.2g} % of what all other channels predict there",
            mend="check its cable, its mounting and which column it was imported from, or take it out of rig.json",
        )
    return likeliest.finding


def _gain_and_delay_explanations(
    name: str, fit: Relation, omega: PerLine, predicted: Spectrum, residual_share: Callable[[Spectrum], float]
) -> Iterator[Explanation]:
    """Explanations by a sign, a unit or a gain; and by a delay."""
    gain, delay_s = fit.gain, fit.delay_s
    delay_phase_factor = np.exp(-1j * omega * delay_s)
    gain_is_wrong = gain < 0 or abs(gain - 1) > 0.3
    unexplained_share = residual_share(gain * (delay_phase_factor if gain_is_wrong else 1.0) * predicted)
    yield Explanation(unexplained_share, gain_finding(name, gain))
    if 0.7 < gain < 1.3:
        delay_finding = Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{name} comes {1e3 * abs(delay_s):.3g} ms {'late' if delay_s > 0 else 'early'} against what "
            f"{REFERENCE_WORDS} predict",
            mend=f"set delay_s = {delay_s:.3g} in rig.json, or synchronise its clock",
        )
        yield Explanation(residual_share(delay_phase_factor * predicted), delay_finding)


def gain_finding(channel_name: str, gain: float) -> Finding:
    """Finding: a sign, a unit or a calibration is wrong, and the channel delivers `gain` times what it should."""
    if gain < 0 and 0.5 < -gain < 2:
        return Finding(
            cause="polarity",
            channels=(channel_name,),
            evidence=f"{channel_name} has the opposite sign of what {REFERENCE_WORDS} predict (gain {gain:.4g})",
            mend="turn it with scale = -1 in the import map",
        )
    unit_words = unit_mistake(gain)
    return Finding(
        cause="units" if unit_words else "gain",
        channels=(channel_name,),
        evidence=f"{channel_name} delivers {gain:.4g} times what {REFERENCE_WORDS} predict",
        mend=f"correct its unit or scale in the import map, it looks like {unit_words}"
        if unit_words
        else f"calibrate it again, or set gain = {gain:.4g} in rig.json",
    )


def _sensor_place_explanations(
    rig: Rig,
    spectra: Spectra,
    channel_index: int,
    prediction: Prediction,
    line_weights: PerLine,
    residual_share: Callable[[Spectrum], float],
) -> Iterator[Explanation]:
    """Explanations: the sensor shows what another one should, or stands at another place of its body."""
    sensor, measured = spectra.sensors[channel_index], spectra.acceleration[channel_index]
    for other_sensor, predicted in zip(spectra.sensors, prediction.accelerations, strict=True):
        if other_sensor.station != sensor.station:
            fit = relation(spectra.omega, measured, predicted, line_weights, 0.0)
            if 0.8 < abs(fit.gain) < 1.25:
                finding = Finding(
                    cause="station",
                    channels=(sensor.name, other_sensor.name),
                    evidence=f"{sensor.name} shows the motion at {other_sensor.station.position_m:g} m of "
                    f"{other_sensor.station.body} ({100 * fit.coherence:.4g} % of its power), not that of its station",
                    mend=f"check its place, its cable and its column; it may be a copy of {other_sensor.name}",
                )
                yield Explanation(1 - fit.coherence, finding, 2.0)
    body_name, stated_m = sensor.station.body, sensor.station.position_m
    length_m = rig.body(body_name).length_m
    if not length_m:
        return
    positions_m = np.linspace(0, length_m, POSITION_COUNT)
    for _ in range(2):
        stations = [Station(body_name, float(position_m)) for position_m in positions_m]
        residual_shares = [*map(residual_share, predicted_acceleration_at(rig, prediction, spectra.omega, stations))]
        best_index = int(np.argmin(residual_shares))
        bracket_m = positions_m[max(best_index - 1, 0)], positions_m[min(best_index + 1, positions_m.size - 1)]
        fitted_m, positions_m = float(positions_m[best_index]), np.linspace(*bracket_m, POSITION_COUNT)
    if abs(fitted_m - stated_m) > 2e-3:
        finding = Finding(
            cause="station",
            channels=(sensor.name,),
            of=body_name,
            evidence=f"{sensor.name} moves as the place {fitted_m:.3f} m of {body_name} does, not as {stated_m:g} m",
            mend="measure its place and correct rig.json",
        )
        yield Explanation(min(residual_shares), finding, 1.5)


def _wrong_derivative_explanations(
    spectra: Spectra, channel_index: int, predicted: Spectrum, line_weights: PerLine
) -> Iterator[Explanation]:
    """Explanations: the channel is a derivative or an integral of the predicted motion."""
    name, measured, omega = spectra.sensors[channel_index].name, spectra.acceleration[channel_index], spectra.omega
    words_by_order = {1: "differentiated", 2: "differentiated twice", -1: "integrated", -2: "integrated twice"}
    for order, words in words_by_order.items():
        fit = relation(omega, measured * (1j * omega) ** -order, predicted, line_weights, 0.0)
        if 0.5 < abs(fit.gain) < 2 or unit_mistake(fit.gain):
            finding = Finding(
                cause="derivative",
                channels=(name,),
                evidence=f"{name} is the motion that the others predict, {words} ({100 * fit.coherence:.4g} % of it)",
                mend="correct its quantity in rig.json and in the import map",
            )
            yield Explanation(1 - fit.coherence, finding, 3.0)


def _filter_explanations(
    name: str, omega: PerLine, measured: Spectrum, predicted: Spectrum, line_weights: PerLine
) -> Iterator[Explanation]:
    """Explanation: gain and phase change with frequency; constants of each in bands of growing width."""
    gain_sizes, unexplained_share, centres_hz = band_gain_fit(omega, measured, predicted, line_weights)
    if gain_sizes.max() > 1.03 * gain_sizes.min() > 0:
        finding = Finding(
            cause="filtered",
            channels=(name,),
            evidence=f"{name} passes {100 * gain_sizes[0]:.3g} % of the predicted motion at {centres_hz[0]:.3g} Hz and "
            f"{100 * gain_sizes[-1]:.3g} % at {centres_hz[-1]:.3g} Hz",
            mend="undo its filter or its coupling, or record without",
        )
        yield Explanation(unexplained_share, finding, 4.0)


def _slipped_samples_finding(channel_name: str, delays_s: Float[np.ndarray, " parts"]) -> Finding:
    """Finding: the delay changes over the record."""
    delay_change_s = float(delays_s[-1] - delays_s[0])
    return Finding(
        cause="slipped samples",
        channels=(channel_name,),
        evidence=f"{channel_name} is {1e3 * abs(delay_change_s):.3g} ms {'later' if delay_change_s > 0 else 'earlier'} "
        "against the others at the record's end than at its beginning",
        mend="it lost or doubled samples, or has a clock of its own: synchronise it and record again",
    )


def force_finding(spectra: Spectra, force_index: int, implied_force: Spectrum, line_weights: PerLine) -> Finding:
    """Finding on one measured force, by the one that all sensors, and the other forces, imply."""
    name, is_one_of_several = spectra.force_names[force_index], len(spectra.forces) > 1
    force_words = force_in_words(name)
    driven_mask = driven_masks(spectra.forces)[force_index]
    omega, measured = spectra.omega[driven_mask], spectra.forces[force_index][driven_mask]
    implied, line_weights = implied_force[driven_mask], line_weights[driven_mask]
    fit = relation(omega, measured, implied, line_weights)
    gain, delay_s = fit.gain, fit.delay_s
    gain_sizes, residual_share, centres_hz = band_gain_fit(omega, measured, implied, line_weights)
    if residual_share < 0.3 and 1 - fit.coherence > 2.5 * residual_share and gain_sizes.max() > 1.25 * gain_sizes.min():
        return _filtered_force_finding(
            name, (float(gain_sizes[0]), float(gain_sizes[-1])), (centres_hz[0], centres_hz[-1])
        )
    if fit.coherence < MIN_COHERENCE:
        return Finding(
            cause="force",
            channels=(name,),
            evidence=f"{name if is_one_of_several else 'the force channel'} explains "
            f"{100 * max(fit.coherence, 0):.2g} % of the force that moves the rig by all sensors",
            mend="check that it is the channel of the load cell, and of this record",
        )
    if gain < 0:
        return Finding(
            cause="polarity",
            channels=(name,),
            evidence=f"{force_words} has the opposite sign of what all sensors imply (gain {gain:.4g})",
            mend="turn the force with scale = -1 in the import map, or all sensors",
        )
    if unit_words := unit_mistake(gain):
        faulty_words = "it" if is_one_of_several else "the sensors or of the force"
        return Finding(
            cause="units",
            channels=(name,) if is_one_of_several else (),
            evidence=f"{name} is {gain:.4g} times what all sensors and the other forces imply"
            if is_one_of_several
            else f"all sensors deliver {1 / gain:.4g} times what the force and the masses of rig.json make",
            mend=f"correct the unit of {faulty_words} in the import map; it looks like {unit_words}",
        )
    if abs(delay_s) > 1e-4:
        return Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{force_words} comes {1e3 * abs(delay_s):.3g} ms {'late' if delay_s > 0 else 'early'} against "
            "all sensors",
            mend="synchronise the force's clock with the sensors', or shift its column",
        )
    return Finding(
        cause="gain",
        channels=(name,),
        evidence=f"{force_words} is {gain:.4g} times what all sensors and the masses of rig.json imply",
        mend="calibrate the load cell, or check all masses of rig.json",
    )


def _filtered_force_finding(name: str, end_gain_sizes: tuple[float, float], end_hz: tuple[float, float]) -> Finding:
    """Finding: the force over the implied one changes from the lowest to the highest frequency, at which one is right.

    The end that is nearer to one was passed: of a high-pass the upper, of a low-pass the lower one.
    """
    low_gain, high_gain = end_gain_sizes
    is_high_pass = bool(abs(np.log(high_gain)) < abs(np.log(low_gain)))
    filtered_words = "it" if (high_gain < low_gain) != is_high_pass else "all sensors"
    return Finding(
        cause="filtered",
        channels=(name,),
        evidence=f"{force_in_words(name)} is {low_gain:.3g} times what all sensors imply at {end_hz[0]:.3g} Hz and "
        f"{high_gain:.3g} times at {end_hz[1]:.3g} Hz: {filtered_words} went through a "
        f"{'high' if is_high_pass else 'low'}-pass",
        mend="undo the filter, or put the force and the sensors through the same"
        + "; a spring that rig.json lacks would look alike" * is_high_pass,
    )
