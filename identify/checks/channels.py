"""Findings on a sensor or a force whose signal is not what all other channels predict: the likeliest cause.

A sensor is compared with the motion that the linear model predicts there, a force with the one that all sensors imply.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding, force_in_words, slipped_samples_finding, two_clocks_finding
from identify.checks.prediction import LinearCheck, Prediction, driven_masks, predicted_acceleration_at
from identify.checks.relations import MIN_COHERENCE, PerLine, Relation, Spectrum, band_gain_fit, relation, unit_mistake
from identify.checks.spectra import Spectra
from rig.model.description import Rig, Station
from rig.model.tolerances import Tolerances

POSITION_COUNT = 41
"""Places along a body that are tried for a sensor, twice: the second time around the best one."""
REFERENCE_WORDS = "the linear model and all other channels"

MAX_REMAINING_SHARE = 0.5
"""A change that leaves more than this share of what is unexplained explains nothing."""
MIN_ERROR_IN_TOLERANCES = 4.0
"""Smallest error that is named, in tolerances."""
DELAY_PART_COUNT, MIN_PART_COHERENCE = 8, 0.8
"""Parts of the record in which a delay is fitted; coherence of a channel with its prediction from which it counts."""
MIN_SLIP_S, MIN_GROWTH_S = 3e-4, 1e-4
"""Change of a channel's delay over the record from which on samples have slipped, or two clocks differ."""
MAX_GROWTH_DEVIATION, MAX_SLIP_DEVIATION = 0.25, 0.4
"""Deviation (rms) of a steadily growing delay from a line, and of one that changes at once from two constants, over its
own scatter about its mean."""


@dataclass(frozen=True)
class DelaysOverTime:
    """Delays of a channel against its prediction in those parts of a record that it follows, at the parts' middles."""

    times_s: Float[np.ndarray, " parts"]
    delays_s: Float[np.ndarray, " parts"]
    record_s: float

    def finding(self, name: str) -> Finding | None:
        """Finding: the delay grows steadily, or changes within the record; None if the parts are alike or few."""
        if self.delays_s.size < 3:
            return None
        growth, first_delay_s = np.polyfit(self.times_s, self.delays_s, 1)
        deviations_s = self.delays_s - first_delay_s - growth * self.times_s
        is_steady = self.delays_s.size > 3 and deviations_s.std() < MAX_GROWTH_DEVIATION * self.delays_s.std()
        if is_steady and abs(growth) * np.ptp(self.times_s) > MIN_GROWTH_S:
            return two_clocks_finding(name, REFERENCE_WORDS, float(first_delay_s), float(growth), self.record_s)
        slip_s, slip_deviation_s = self._slip()
        if slip_deviation_s < MAX_SLIP_DEVIATION * self.delays_s.std() and abs(slip_s) > MIN_SLIP_S:
            return slipped_samples_finding(name, slip_s)
        return None

    def _slip(self) -> tuple[float, float]:
        """Change at the time that leaves least deviation (rms) from one delay before and one after, both in s."""

        def deviation_s(split: int) -> float:
            parts = np.split(self.delays_s, [split])
            return float(np.sqrt(sum(np.sum((part - part.mean()) ** 2) for part in parts) / self.delays_s.size))

        split = min(range(1, self.delays_s.size), key=deviation_s)
        return float(self.delays_s[split:].mean() - self.delays_s[:split].mean()), deviation_s(split)


def delays_over_time(spectra: Spectra, measured: Spectrum, predicted: Spectrum, error_scale: PerLine) -> DelaysOverTime:
    """Delays of a channel in the parts of a record, from its measured and predicted spectra on all lines."""
    signals = spectra.compared_signals(np.stack([measured, predicted]) / error_scale)
    part_count = signals.shape[1] // DELAY_PART_COUNT
    times_s, delays_s = [], []
    for k in range(DELAY_PART_COUNT):
        part_signals = signals[:, k * part_count : (k + 1) * part_count]
        measured_part, predicted_part = np.fft.rfft(part_signals * np.hanning(part_count))[:, 1:]
        omega = 2 * np.pi * np.fft.rfftfreq(part_count, 1 / spectra.compared_rate_hz)[1:]
        part_relation = relation(omega, measured_part, predicted_part, np.ones(omega.size))
        if part_relation.coherence >= MIN_PART_COHERENCE:
            times_s.append(spectra.compared_span_s[0] + (k + 0.5) * part_count / spectra.compared_rate_hz)
            delays_s.append(part_relation.delay_s)
    return DelaysOverTime(np.array(times_s), np.array(delays_s), spectra.record_s)


DelaysOnDemand = Callable[[], DelaysOverTime]


@dataclass(frozen=True)
class Explanation:
    """Cause of a fault, and the share of the channel's power that it leaves unexplained.

    A cause with more freedom has a larger freedom_factor, by which its share counts more. size_in_tolerances is that of
    the error that it names, infinite where no tolerance is stated.
    """

    unexplained_share: float
    finding: Finding
    freedom_factor: float = 1.0
    size_in_tolerances: float = np.inf


def likeliest_channel_finding(
    rig: Rig,
    check: LinearCheck,
    channel_index: int,
    prediction: Prediction,
    delays: DelaysOnDemand,
    tolerances: Tolerances,
) -> Finding:
    """Likeliest reason why a channel is not what all others predict; or that it is unexplained.

    A reason is off by more than its tolerance, and takes away a material part of what is unexplained.
    """
    spectra, line_weights = check.spectra, 1 / check.error_scale[channel_index]
    measured, omega, name = spectra.acceleration[channel_index], spectra.omega, spectra.sensors[channel_index].name
    predicted = prediction.accelerations[channel_index]
    fit = relation(omega, measured, predicted, line_weights)
    measured_power = float(np.sum(np.abs(measured * line_weights) ** 2)) or 1.0

    def residual_share(explained: Spectrum) -> float:
        return float(np.sum(np.abs((measured - explained) * line_weights) ** 2)) / measured_power

    own_tolerances = tolerances.of_sensor(name)
    explanations = [
        *_gain_and_delay_explanations(name, fit, omega, predicted, residual_share, own_tolerances),
        *_turned_explanations(spectra, channel_index, predicted, line_weights, own_tolerances),
        *_sensor_place_explanations(rig, spectra, channel_index, prediction, line_weights, residual_share, tolerances),
        *_wrong_derivative_explanations(spectra, channel_index, predicted, line_weights),
        *_filter_explanations(name, omega, measured, predicted, line_weights),
    ]
    likeliest = min(explanations, key=lambda explanation: explanation.unexplained_share * explanation.freedom_factor)
    if likeliest.unexplained_share > 0.02 or likeliest.finding.cause == "delay":
        changing = delays().finding(name)
        if changing is not None:
            return changing
    if likeliest.unexplained_share > 1 - MIN_COHERENCE:
        return Finding(
            cause="unrelated",
            channels=(name,),
            evidence=f"{name} follows {100 * max(fit.coherence, 0):.2g} % of what all other channels predict there",
            mend="check its cable, its mounting and which column it was imported from, or take it out of rig.json",
        )
    undoubted_share = residual_share(predicted)
    material = [
        explanation
        for explanation in explanations
        if explanation.size_in_tolerances > MIN_ERROR_IN_TOLERANCES
        and explanation.unexplained_share < MAX_REMAINING_SHARE * undoubted_share
    ]
    if not material:
        return unexplained_finding(name, float(np.sqrt(undoubted_share)))
    return min(material, key=lambda explanation: explanation.unexplained_share * explanation.freedom_factor).finding


def unexplained_finding(name: str, motion_share: float) -> Finding:
    """Finding: a channel is off by a share of its motion (rms), and no single cause accounts for it."""
    return Finding(
        cause="unexplained",
        channels=(name,),
        evidence=f"{name} is off by {100 * motion_share:.2g} % of its motion from what {REFERENCE_WORDS} predict, and "
        "no gain, delay, place, turn or filter takes a material part of that away",
        mend="unexplained at this channel; look at its mounting and cable, and at what rig.json leaves out there",
    )


def _size_in_tolerances(error: float, tolerance: float) -> float:
    return abs(error) / tolerance if tolerance else np.inf


def _gain_and_delay_explanations(
    name: str,
    fit: Relation,
    omega: PerLine,
    predicted: Spectrum,
    residual_share: Callable[[Spectrum], float],
    tolerances: Tolerances,
) -> Iterator[Explanation]:
    """Explanations by a sign, a unit or a gain; and by a delay."""
    gain, delay_s = fit.gain, fit.delay_s
    delay_phase_factor = np.exp(-1j * omega * delay_s)
    gain_is_wrong = gain < 0 or abs(gain - 1) > 0.3
    unexplained_share = residual_share(gain * (delay_phase_factor if gain_is_wrong else 1.0) * predicted)
    gain_size = _size_in_tolerances(gain - 1, tolerances.gain)
    yield Explanation(unexplained_share, gain_finding(name, gain), size_in_tolerances=gain_size)
    if 0.7 < gain < 1.3:
        delay_finding = Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{name} comes {1e3 * abs(delay_s):.3g} ms {'late' if delay_s > 0 else 'early'} against what "
            f"{REFERENCE_WORDS} predict",
            mend=f"set delay_s = {delay_s:.3g} in rig.json, or synchronise its clock",
        )
        delay_size = _size_in_tolerances(delay_s, tolerances.delay_s)
        yield Explanation(residual_share(delay_phase_factor * predicted), delay_finding, size_in_tolerances=delay_size)


def _turned_explanations(
    spectra: Spectra, channel_index: int, predicted: Spectrum, line_weights: PerLine, tolerances: Tolerances
) -> Iterator[Explanation]:
    """Explanation: the sensor is turned and shows a share of the motion across, where that is measured too."""
    measured, across = spectra.acceleration[channel_index] * line_weights, spectra.across[channel_index] * line_weights
    across_power = float(np.vdot(across, across).real)
    if not across_power:
        return
    unexplained = measured - predicted * line_weights
    share = float(np.vdot(across, unexplained).real) / across_power
    unexplained_share = float(np.sum(np.abs(unexplained - share * across) ** 2) / np.sum(np.abs(measured) ** 2))
    size_in_tolerances = _size_in_tolerances(share, tolerances.cross_axis)
    yield Explanation(
        unexplained_share,
        turned_finding(spectra.sensors[channel_index].name, share),
        1.5,
        size_in_tolerances=size_in_tolerances,
    )


TURNED_MEND = "align it, or turn both of its directions back by that angle before the import"


def turned_words(share: float) -> str:
    """What a sensor does that shows a share of the motion across its direction, in a sentence."""
    return (
        f"is turned by {np.degrees(np.arctan(abs(share))):.2g} deg about the axis of its body: it shows "
        f"{100 * share:+.2g} % of the motion across"
    )


def turned_finding(name: str, share: float) -> Finding:
    """Finding: a sensor shows a share of the motion across its direction, as one that is turned."""
    return Finding(cause="turned", channels=(name,), evidence=f"{name} {turned_words(share)}", mend=TURNED_MEND)


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
    tolerances: Tolerances,
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
        position_size = _size_in_tolerances(fitted_m - stated_m, tolerances.of_sensor(sensor.name).position_m)
        yield Explanation(min(residual_shares), finding, 1.5, position_size)


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


def force_finding(
    spectra: Spectra, force_index: int, implied_force: Spectrum, line_weights: PerLine, delays: DelaysOnDemand
) -> Finding:
    """Finding on one measured force, by the one that all sensors, and the other forces, imply."""
    name, is_one_of_several = spectra.force_names[force_index], len(spectra.forces) > 1
    force_in_words(name)
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
    unit_words = unit_mistake(gain)
    if gain < 0 or unit_words:
        return _scaled_force_finding(name, gain, unit_words, is_one_of_several)
    undoubted_power = float(np.sum(np.abs((measured - implied) * line_weights) ** 2))
    fitted = gain * np.exp(-1j * omega * delay_s) * implied
    remaining_power = float(np.sum(np.abs((measured - fitted) * line_weights) ** 2))
    if remaining_power > MAX_REMAINING_SHARE * undoubted_power:
        measured_power = float(np.sum(np.abs(measured * line_weights) ** 2)) or 1.0
        return unexplained_finding(name, float(np.sqrt(undoubted_power / measured_power)))
    changing = delays().finding(name) if abs(delay_s) > 1e-4 else None
    return changing or _force_calibration_finding(name, gain, delay_s)


def _force_calibration_finding(name: str, gain: float, delay_s: float) -> Finding:
    """Finding: the force is late or early, or its gain is off."""
    force_words = force_in_words(name)
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


def _scaled_force_finding(name: str, gain: float, unit_words: str | None, is_one_of_several: bool) -> Finding:
    """Finding: the force has the opposite sign, or another unit, than all sensors imply."""
    if gain < 0:
        return Finding(
            cause="polarity",
            channels=(name,),
            evidence=f"{force_in_words(name)} has the opposite sign of what all sensors imply (gain {gain:.4g})",
            mend="turn the force with scale = -1 in the import map, or all sensors",
        )
    faulty_words = "it" if is_one_of_several else "the sensors or of the force"
    return Finding(
        cause="units",
        channels=(name,) if is_one_of_several else (),
        evidence=f"{name} is {gain:.4g} times what all sensors and the other forces imply"
        if is_one_of_several
        else f"all sensors deliver {1 / gain:.4g} times what the force and the masses of rig.json make",
        mend=f"correct the unit of {faulty_words} in the import map; it looks like {unit_words}",
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
