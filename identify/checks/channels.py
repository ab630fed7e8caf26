"""Findings on a sensor or a force whose signal is not what all other channels predict: the likeliest cause.

A sensor is compared with the motion that the linear model predicts there, a force with the one that all sensors imply.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.findings import Finding, force_in_words
from identify.checks.prediction import LinearCheck, Prediction, acceleration_by_forces, driven_lines
from identify.checks.relations import MIN_COHERENCE, Relation, gain_by_band, relation, unit_mistake
from identify.checks.spectra import Spectra
from rig.model.description import Rig, Station

POSITION_COUNT = 41
"""Places along a body that are tried for a sensor, twice: the second time around the best one."""
REFERENCE_WORDS = "the linear model and all other channels"


@dataclass(frozen=True)
class Explanation:
    """A cause, and the share of the channel's power that it leaves unexplained.

    A cause with more freedom has a larger allowance, by which its share counts more.
    """

    unexplained_share: float
    finding: Finding
    share_factor: float = 1.0


def channel_finding(
    rig: Rig,
    check: LinearCheck,
    channel_index: int,
    prediction: Prediction,
    delays_over_time: Callable[[], Float[np.ndarray, " parts"] | None],
) -> Finding:
    """Likeliest reason why a channel is not what all others predict.

    delays_over_time gives its delays in each part of the record, or None if these are alike.
    """
    spectra, line_weights = check.spectra, 1 / check.error_scale[channel_index]
    measured, omega, name = spectra.acceleration[channel_index], spectra.omega, spectra.sensors[channel_index].name
    predicted_spectrum = prediction.accelerations[channel_index]
    relation_to_predicted = relation(omega, measured, predicted_spectrum, line_weights)
    measured_power = float(np.sum(np.abs(measured * line_weights) ** 2)) or 1.0

    def unexplained_by(explained_spectrum: Complex[np.ndarray, " lines"]) -> float:
        return float(np.sum(np.abs((measured - explained_spectrum) * line_weights) ** 2)) / measured_power

    explanations = [*_gain_or_delay(name, relation_to_predicted, omega, predicted_spectrum, unexplained_by)]
    explanations += _wrong_station(rig, spectra, channel_index, prediction, line_weights, unexplained_by)
    explanations += _wrong_derivative(spectra, channel_index, predicted_spectrum, line_weights)
    if (filter_explanation := _filter_explanation(name, omega, measured, predicted_spectrum, line_weights)) is not None:
        explanations.append(filter_explanation)
    best_explanation = min(
        explanations, key=lambda explanation: explanation.unexplained_share * explanation.share_factor
    )
    if best_explanation.unexplained_share > 0.02 and (delays_s := delays_over_time()) is not None:
        return _slipped_finding(name, delays_s)
    if best_explanation.unexplained_share > 1 - MIN_COHERENCE:
        return Finding(
            cause="unrelated",
            channels=(name,),
            evidence=f"{name} follows {100 * max(relation_to_predicted.coherence, 0):.2g} % of what all other "
            "channels predict there",
            mend="check its cable, its mounting and which column it was imported from, or take it out of rig.json",
        )
    return best_explanation.finding


def _gain_or_delay(
    name: str,
    relation_to_predicted: Relation,
    omega: Float[np.ndarray, " lines"],
    predicted_spectrum: Complex[np.ndarray, " lines"],
    unexplained_by: Callable[[Complex[np.ndarray, " lines"]], float],
) -> Iterator[Explanation]:
    """Explanations by a sign, a unit or a gain; and by a delay."""
    delay_factor = np.exp(-1j * omega * relation_to_predicted.delay_s)
    gain_is_wrong = relation_to_predicted.gain < 0 or abs(relation_to_predicted.gain - 1) > 0.3
    yield Explanation(
        unexplained_by(relation_to_predicted.gain * (delay_factor if gain_is_wrong else 1.0) * predicted_spectrum),
        gain_finding(name, relation_to_predicted.gain),
    )
    if 0.7 < relation_to_predicted.gain < 1.3:
        yield Explanation(
            unexplained_by(delay_factor * predicted_spectrum),
            Finding(
                cause="delay",
                channels=(name,),
                evidence=f"{name} comes {1e3 * abs(relation_to_predicted.delay_s):.3g} ms "
                f"{'late' if relation_to_predicted.delay_s > 0 else 'early'} against what {REFERENCE_WORDS} predict",
                mend=f"set delay_s = {relation_to_predicted.delay_s:.3g} in rig.json, or synchronise its clock",
            ),
        )


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
    line_weights: Float[np.ndarray, " lines"],
    unexplained_by: Callable[[Complex[np.ndarray, " lines"]], float],
) -> Iterator[Explanation]:
    """Explanations: the sensor shows what another one should, or stands at another place of its body."""
    sensor = spectra.sensors[channel_index]
    for other_index, other_sensor in enumerate(spectra.sensors):
        if other_index != channel_index and other_sensor.station != sensor.station:
            relation_to_other = relation(
                spectra.omega,
                spectra.acceleration[channel_index],
                prediction.accelerations[other_index],
                line_weights,
                0.0,
            )
            if 0.8 < abs(relation_to_other.gain) < 1.25:
                yield Explanation(
                    1 - relation_to_other.coherence,
                    Finding(
                        cause="station",
                        channels=(sensor.name, other_sensor.name),
                        evidence=f"{sensor.name} shows the motion at {other_sensor.station.position_m:g} m of "
                        f"{other_sensor.station.body} ({100 * relation_to_other.coherence:.4g} % of its power), "
                        "not that of its station",
                        mend=f"check its place, its cable and its column; it may be a copy of {other_sensor.name}",
                    ),
                    2.0,
                )
    body_length_m = rig.body(sensor.station.body).length_m
    if not body_length_m:
        return
    positions_m = np.linspace(0, body_length_m, POSITION_COUNT)
    for _ in range(2):
        stations = [Station(sensor.station.body, float(position_m)) for position_m in positions_m]
        unexplained_shares = [
            unexplained_by(explained_spectrum)
            for explained_spectrum in acceleration_by_forces(rig, prediction, spectra.omega, stations)
        ]
        best_index = int(np.argmin(unexplained_shares))
        bracket_m = positions_m[max(best_index - 1, 0)], positions_m[min(best_index + 1, positions_m.size - 1)]
        fitted_m, positions_m = float(positions_m[best_index]), np.linspace(*bracket_m, POSITION_COUNT)
    if abs(fitted_m - sensor.station.position_m) > 2e-3:
        yield Explanation(
            min(unexplained_shares),
            Finding(
                cause="station",
                channels=(sensor.name,),
                of=sensor.station.body,
                evidence=f"{sensor.name} moves as the place {fitted_m:.3f} m of {sensor.station.body} does, not as "
                f"{sensor.station.position_m:g} m",
                mend="measure its place and correct rig.json",
            ),
            1.5,
        )


def _wrong_derivative(
    spectra: Spectra,
    channel_index: int,
    predicted_spectrum: Complex[np.ndarray, " lines"],
    line_weights: Float[np.ndarray, " lines"],
) -> Iterator[Explanation]:
    """Explanations: the channel is a derivative or an integral of the predicted motion."""
    name, omega = spectra.sensors[channel_index].name, spectra.omega
    words_by_order = {1: "differentiated", 2: "differentiated twice", -1: "integrated", -2: "integrated twice"}
    for derivative_order, operation_words in words_by_order.items():
        relation_to_predicted = relation(
            omega,
            spectra.acceleration[channel_index] * (1j * omega) ** -derivative_order,
            predicted_spectrum,
            line_weights,
            0.0,
        )
        if not (0.5 < abs(relation_to_predicted.gain) < 2 or unit_mistake(relation_to_predicted.gain)):
            continue
        yield Explanation(
            1 - relation_to_predicted.coherence,
            Finding(
                cause="derivative",
                channels=(name,),
                evidence=f"{name} is the motion that the others predict, {operation_words} "
                f"({100 * relation_to_predicted.coherence:.4g} % of it)",
                mend="correct its quantity in rig.json and in the import map",
            ),
            3.0,
        )


def _filter_explanation(
    name: str,
    omega: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, " lines"],
    predicted_spectrum: Complex[np.ndarray, " lines"],
    line_weights: Float[np.ndarray, " lines"],
) -> Explanation | None:
    """Explanation: gain and phase change with frequency; constants of each in bands of growing width."""
    gain_sizes, unexplained_share, centres_hz = gain_by_band(omega, measured, predicted_spectrum, line_weights)
    if not (gain_sizes.max() > 1.03 * gain_sizes.min() > 0):
        return None
    return Explanation(
        unexplained_share,
        Finding(
            cause="filtered",
            channels=(name,),
            evidence=f"{name} passes {100 * gain_sizes[0]:.3g} % of the predicted motion at {centres_hz[0]:.3g} Hz and "
            f"{100 * gain_sizes[-1]:.3g} % at {centres_hz[-1]:.3g} Hz",
            mend="undo its filter or its coupling, or record without",
        ),
        4.0,
    )


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


def force_finding(
    spectra: Spectra,
    force_index: int,
    implied_force: Complex[np.ndarray, " lines"],
    line_weights: Float[np.ndarray, " lines"],
) -> Finding:
    """Finding on one measured force, by the one that all sensors, and the other forces, imply."""
    name, has_other_forces = spectra.force_names[force_index], len(spectra.forces) > 1
    subject = force_in_words(name)
    driven_mask = driven_lines(spectra.forces)[force_index]
    omega, measured, implied_force, line_weights = (
        line_values[driven_mask]
        for line_values in (spectra.omega, spectra.forces[force_index], implied_force, line_weights)
    )
    to_implied = relation(omega, measured, implied_force, line_weights)
    gain_sizes, unexplained_share, centres_hz = gain_by_band(omega, measured, implied_force, line_weights)
    if (
        unexplained_share < 0.3
        and 1 - to_implied.coherence > 2.5 * unexplained_share
        and gain_sizes.max() > 1.25 * gain_sizes.min()
    ):
        is_low_passed = gain_sizes[-1] < gain_sizes[0]
        return Finding(
            cause="filtered",
            channels=(name,),
            evidence=f"{subject} is {gain_sizes[0]:.3g} times what all sensors imply at "
            f"{centres_hz[0]:.3g} Hz and {gain_sizes[-1]:.3g} times at {centres_hz[-1]:.3g} Hz: "
            f"{'it' if is_low_passed else 'all sensors'} went through a low-pass",
            mend="undo the filter, or put the force and the sensors through the same",
        )
    if to_implied.coherence < MIN_COHERENCE:
        return Finding(
            cause="force",
            channels=(name,),
            evidence=f"{name if has_other_forces else 'the force channel'} explains "
            f"{100 * max(to_implied.coherence, 0):.2g} % of the force that moves the rig by all sensors",
            mend="check that it is the channel of the load cell, and of this record",
        )
    if to_implied.gain < 0:
        return Finding(
            cause="polarity",
            channels=(name,),
            evidence=f"{subject} has the opposite sign of what all sensors imply (gain {to_implied.gain:.4g})",
            mend="turn the force with scale = -1 in the import map, or all sensors",
        )
    unit_words = unit_mistake(to_implied.gain)
    if unit_words:
        gain_factor, faulty_words = (
            (to_implied.gain, "it") if has_other_forces else (1 / to_implied.gain, "the sensors or of the force")
        )
        evidence = f"{name} is {gain_factor:.4g} times what all sensors and the other forces imply"
        if not has_other_forces:
            evidence = f"all sensors deliver {gain_factor:.4g} times what the force and the masses of rig.json make"
        return Finding(
            cause="units",
            channels=(name,) if has_other_forces else (),
            evidence=evidence,
            mend=f"correct the unit of {faulty_words} in the import map; it looks like {unit_words}",
        )
    if abs(to_implied.delay_s) > 1e-4:
        return Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{subject} comes {1e3 * abs(to_implied.delay_s):.3g} ms "
            f"{'late' if to_implied.delay_s > 0 else 'early'} against all sensors",
            mend="synchronise the force's clock with the sensors', or shift its column",
        )
    return Finding(
        cause="gain",
        channels=(name,),
        evidence=f"{subject} is {to_implied.gain:.4g} times what all sensors and the masses of rig.json imply",
        mend="calibrate the load cell, or check all masses of rig.json",
    )
