"""Findings on a sensor or a force whose signal is not what all other channels predict: the likeliest cause.

A sensor is compared with the motion that the linear model predicts there, a force with the one that all sensors imply.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding, force_in_words
from identify.checks.prediction import LinearCheck, Prediction, acceleration_by_forces, driven_lines
from identify.checks.relations import MIN_COHERENCE, Lines, Relation, Spectrum, gain_by_band, relation, unit_mistake
from identify.checks.spectra import Spectra
from rig.model.description import Rig, Station

POSITION_COUNT = 41
"""Places along a body that are tried for a sensor, twice: the second time around the best one."""
REFERENCE_WORDS = "the linear model and all other channels"

DelaysOnDemand = Callable[[], Float[np.ndarray, " parts"] | None]


@dataclass(frozen=True)
class Explanation:
    """A cause, and the share of the channel's power that it leaves unexplained.

    A cause with more freedom has a larger allowance, by which its share counts more.
    """

    unexplained_share: float
    finding: Finding
    share_factor: float = 1.0


def channel_finding(
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

    def unexplained_by(explained: Spectrum) -> float:
        return float(np.sum(np.abs((measured - explained) * line_weights) ** 2)) / measured_power

    explanations = [
        *_gain_or_delay(name, fit, omega, predicted, unexplained_by),
        *_wrong_station(rig, spectra, channel_index, prediction, line_weights, unexplained_by),
        *_wrong_derivative(spectra, channel_index, predicted, line_weights),
        *_filtered(name, omega, measured, predicted, line_weights),
    ]
    best = min(explanations, key=lambda explanation: explanation.unexplained_share * explanation.share_factor)
    if best.unexplained_share > 0.02 and (delays_s := delays_over_time()) is not None:
        return _slipped_finding(name, delays_s)
    if best.unexplained_share > 1 - MIN_COHERENCE:
        return Finding(
            cause="unrelated",
            channels=(name,),
            evidence=f"{name} follows {100 * max(fit.coherence, 0):.2g} % of what all other channels predict there",
            mend="check its cable, its mounting and which column it was imported from, or take it out of rig.json",
        )
    return best.finding


def _gain_or_delay(
    name: str, fit: Relation, omega: Lines, predicted: Spectrum, unexplained_by: Callable[[Spectrum], float]
) -> Iterator[Explanation]:
    """Explanations by a sign, a unit or a gain; and by a delay."""
    gain, delay_s = fit.gain, fit.delay_s
    delay_factor = np.exp(-1j * omega * delay_s)
    gain_is_wrong = gain < 0 or abs(gain - 1) > 0.3
    unexplained_share = unexplained_by(gain * (delay_factor if gain_is_wrong else 1.0) * predicted)
    yield Explanation(unexplained_share, gain_finding(name, gain))
    if 0.7 < gain < 1.3:
        delay_finding = Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{name} comes {1e3 * abs(delay_s):.3g} ms {'late' if delay_s > 0 else 'early'} against what "
            f"{REFERENCE_WORDS} predict",
            mend=f"set delay_s = {delay_s:.3g} in rig.json, or synchronise its clock",
        )
        yield Explanation(unexplained_by(delay_factor * predicted), delay_finding)


def gain_finding(name: str, gain: float) -> Finding:
    """Finding: a sign, a unit or a calibration is wrong, and the channel delivers `gain` times what it should."""
    if gain < 0 and 0.5 < -gain < 2:
        return Finding(
            cause="polarity",
            channels=(name,),
            evidence=f"{name} has the opposite sign of what {REFERENCE_WORDS} predict (gain {gain:.4g})",
            mend="turn it with scale = -1 in the import map",
        )
    unit_words = unit_mistake(gain)
    return Finding(
        cause="units" if unit_words else "gain",
        channels=(name,),
        evidence=f"{name} delivers {gain:.4g} times what {REFERENCE_WORDS} predict",
        mend=f"correct its unit or scale in the import map, it looks like {unit_words}"
        if unit_words
        else f"calibrate it again, or set gain = {gain:.4g} in rig.json",
    )


def _wrong_station(
    rig: Rig,
    spectra: Spectra,
    channel_index: int,
    prediction: Prediction,
    line_weights: Lines,
    unexplained_by: Callable[[Spectrum], float],
) -> Iterator[Explanation]:
    """Explanations: the sensor shows what another one should, or stands at another place of its body."""
    sensor, measured = spectra.sensors[channel_index], spectra.acceleration[channel_index]
    for other, predicted in zip(spectra.sensors, prediction.accelerations, strict=True):
        if other.station != sensor.station:
            fit = relation(spectra.omega, measured, predicted, line_weights, 0.0)
            if 0.8 < abs(fit.gain) < 1.25:
                finding = Finding(
                    cause="station",
                    channels=(sensor.name, other.name),
                    evidence=f"{sensor.name} shows the motion at {other.station.position_m:g} m of "
                    f"{other.station.body} ({100 * fit.coherence:.4g} % of its power), not that of its station",
                    mend=f"check its place, its cable and its column; it may be a copy of {other.name}",
                )
                yield Explanation(1 - fit.coherence, finding, 2.0)
    body, stated_m = sensor.station.body, sensor.station.position_m
    length_m = rig.body(body).length_m
    if not length_m:
        return
    positions_m = np.linspace(0, length_m, POSITION_COUNT)
    for _ in range(2):
        stations = [Station(body, float(position_m)) for position_m in positions_m]
        shares = [*map(unexplained_by, acceleration_by_forces(rig, prediction, spectra.omega, stations))]
        best = int(np.argmin(shares))
        bracket_m = positions_m[max(best - 1, 0)], positions_m[min(best + 1, positions_m.size - 1)]
        fitted_m, positions_m = float(positions_m[best]), np.linspace(*bracket_m, POSITION_COUNT)
    if abs(fitted_m - stated_m) > 2e-3:
        finding = Finding(
            cause="station",
            channels=(sensor.name,),
            of=body,
            evidence=f"{sensor.name} moves as the place {fitted_m:.3f} m of {body} does, not as {stated_m:g} m",
            mend="measure its place and correct rig.json",
        )
        yield Explanation(min(shares), finding, 1.5)


def _wrong_derivative(
    spectra: Spectra, channel_index: int, predicted: Spectrum, line_weights: Lines
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


def _filtered(
    name: str, omega: Lines, measured: Spectrum, predicted: Spectrum, line_weights: Lines
) -> Iterator[Explanation]:
    """Explanation: gain and phase change with frequency; constants of each in bands of growing width."""
    gains, unexplained_share, centres_hz = gain_by_band(omega, measured, predicted, line_weights)
    if gains.max() > 1.03 * gains.min() > 0:
        finding = Finding(
            cause="filtered",
            channels=(name,),
            evidence=f"{name} passes {100 * gains[0]:.3g} % of the predicted motion at {centres_hz[0]:.3g} Hz and "
            f"{100 * gains[-1]:.3g} % at {centres_hz[-1]:.3g} Hz",
            mend="undo its filter or its coupling, or record without",
        )
        yield Explanation(unexplained_share, finding, 4.0)


def _slipped_finding(name: str, delays_s: Float[np.ndarray, " parts"]) -> Finding:
    """Finding: the delay changes over the record."""
    delay_change_s = float(delays_s[-1] - delays_s[0])
    return Finding(
        cause="slipped samples",
        channels=(name,),
        evidence=f"{name} is {1e3 * abs(delay_change_s):.3g} ms {'later' if delay_change_s > 0 else 'earlier'} "
        "against the others at the record's end than at its beginning",
        mend="it lost or doubled samples, or has a clock of its own: synchronise it and record again",
    )


def force_finding(spectra: Spectra, force_index: int, implied_force: Spectrum, line_weights: Lines) -> Finding:
    """Finding on one measured force, by the one that all sensors, and the other forces, imply."""
    name, is_one_of_several = spectra.force_names[force_index], len(spectra.forces) > 1
    subject = force_in_words(name)
    driven = driven_lines(spectra.forces)[force_index]
    omega, measured = spectra.omega[driven], spectra.forces[force_index][driven]
    implied, line_weights = implied_force[driven], line_weights[driven]
    fit = relation(omega, measured, implied, line_weights)
    gain, delay_s = fit.gain, fit.delay_s
    gains, unexplained, centres_hz = gain_by_band(omega, measured, implied, line_weights)
    if unexplained < 0.3 and 1 - fit.coherence > 2.5 * unexplained and gains.max() > 1.25 * gains.min():
        return _filter_finding(name, (float(gains[0]), float(gains[-1])), (centres_hz[0], centres_hz[-1]))
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
            evidence=f"{subject} has the opposite sign of what all sensors imply (gain {gain:.4g})",
            mend="turn the force with scale = -1 in the import map, or all sensors",
        )
    if unit_words := unit_mistake(gain):
        faulty = "it" if is_one_of_several else "the sensors or of the force"
        return Finding(
            cause="units",
            channels=(name,) if is_one_of_several else (),
            evidence=f"{name} is {gain:.4g} times what all sensors and the other forces imply"
            if is_one_of_several
            else f"all sensors deliver {1 / gain:.4g} times what the force and the masses of rig.json make",
            mend=f"correct the unit of {faulty} in the import map; it looks like {unit_words}",
        )
    if abs(delay_s) > 1e-4:
        return Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{subject} comes {1e3 * abs(delay_s):.3g} ms {'late' if delay_s > 0 else 'early'} against all "
            "sensors",
            mend="synchronise the force's clock with the sensors', or shift its column",
        )
    return Finding(
        cause="gain",
        channels=(name,),
        evidence=f"{subject} is {gain:.4g} times what all sensors and the masses of rig.json imply",
        mend="calibrate the load cell, or check all masses of rig.json",
    )


def _filter_finding(name: str, gains: tuple[float, float], centres_hz: tuple[float, float]) -> Finding:
    """Finding: the force over the implied one changes from the lowest to the highest frequency, at which one is right.

    The end that is nearer to one was passed: of a high-pass the upper, of a low-pass the lower one.
    """
    low_gain, high_gain = gains
    is_high_pass = bool(abs(np.log(high_gain)) < abs(np.log(low_gain)))
    filtered_channels = "it" if (high_gain < low_gain) != is_high_pass else "all sensors"
    return Finding(
        cause="filtered",
        channels=(name,),
        evidence=f"{force_in_words(name)} is {low_gain:.3g} times what all sensors imply at {centres_hz[0]:.3g} Hz and "
        f"{high_gain:.3g} times at {centres_hz[1]:.3g} Hz: {filtered_channels} went through a "
        f"{'high' if is_high_pass else 'low'}-pass",
        mend="undo the filter, or put the force and the sensors through the same"
        + "; a spring that rig.json lacks would look alike" * is_high_pass,
    )
