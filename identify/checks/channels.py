"""Findings on channels that do not fit the others."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.findings import Finding
from identify.checks.prediction import LinearCheck, Predicted, by_forces
from identify.checks.relations import FOLLOWS, Relation, bandwise, relation, usual_factor
from identify.checks.spectra import Spectra
from rig.model.description import Rig, Station

PLACES = 41
SAYS = "the linear model and all other channels"


@dataclass(frozen=True)
class Explanation:
    """A cause, and the share of a channel's power that it leaves unexplained."""

    left: float
    finding: Finding
    allowance: float = 1.0
    """A cause with more freedom has to leave so much less."""


def channel_finding(
    rig: Rig,
    check: LinearCheck,
    channel: int,
    predicted: Predicted,
    over_time: Callable[[], Float[np.ndarray, " parts"] | None],
) -> Finding:
    """The likeliest reason why a channel is not what all others predict.

    over_time gives its delays in each part of the record, where they differ.
    """
    spectra, weight = check.spectra, 1 / check.scale[channel]
    measured, omega, name = spectra.acceleration[channel], spectra.omega, spectra.sensors[channel].name
    expected = predicted.acceleration[channel]
    own = relation(omega, measured, expected, weight)
    power = float(np.sum(np.abs(measured * weight) ** 2)) or 1.0

    def left_by(explained: Complex[np.ndarray, " lines"]) -> float:
        return float(np.sum(np.abs((measured - explained) * weight) ** 2)) / power

    tried = [*_simple(name, own, omega, expected, left_by)]
    tried += _elsewhere(rig, spectra, channel, predicted, weight, left_by)
    tried += _differentiated(spectra, channel, expected, weight)
    if (filtered := _filtered(name, omega, measured, expected, weight)) is not None:
        tried.append(filtered)
    best = min(tried, key=lambda one: one.left * one.allowance)
    if best.left > 0.02 and (slipped := over_time()) is not None:
        return _slipped(name, slipped)
    if best.left > 1 - FOLLOWS:
        return Finding(
            cause="unrelated",
            channels=(name,),
            evidence=f"{name} follows {100 * max(own.coherence, 0):.2g} % of what all other channels predict there",
            mend="check its cable, its mounting and which column it was imported from, or take it out of rig.json",
        )
    return best.finding


def _simple(
    name: str,
    own: Relation,
    omega: Float[np.ndarray, " lines"],
    expected: Complex[np.ndarray, " lines"],
    left_by: Callable[[Complex[np.ndarray, " lines"]], float],
) -> Iterator[Explanation]:
    """Sign, unit or gain; delay."""
    late = np.exp(-1j * omega * own.delay_s)
    turned = own.gain < 0 or abs(own.gain - 1) > 0.3
    yield Explanation(left_by(own.gain * (late if turned else 1.0) * expected), channel_gain(name, own.gain))
    if 0.7 < own.gain < 1.3:
        yield Explanation(
            left_by(late * expected),
            Finding(
                cause="delay",
                channels=(name,),
                evidence=f"{name} comes {1e3 * abs(own.delay_s):.3g} ms {'late' if own.delay_s > 0 else 'early'} "
                f"against what {SAYS} predict",
                mend=f"set delay_s = {own.delay_s:.3g} in rig.json, or synchronise its clock",
            ),
        )


def channel_gain(name: str, gain: float) -> Finding:
    """A sign, a unit or a calibration that is wrong: the channel delivers so many times what it should."""
    if gain < 0 and 0.5 < -gain < 2:
        return Finding(
            cause="polarity",
            channels=(name,),
            evidence=f"{name} has the opposite sign of what {SAYS} predict (gain {gain:.4g})",
            mend="turn it with scale = -1 in the import map",
        )
    units = usual_factor(gain)
    return Finding(
        cause="units" if units else "gain",
        channels=(name,),
        evidence=f"{name} delivers {gain:.4g} times what {SAYS} predict",
        mend=f"correct its unit or scale in the import map, it looks like {units}"
        if units
        else f"calibrate it again, or set gain = {gain:.4g} in rig.json",
    )


def _elsewhere(
    rig: Rig,
    spectra: Spectra,
    channel: int,
    predicted: Predicted,
    weight: Float[np.ndarray, " lines"],
    left_by: Callable[[Complex[np.ndarray, " lines"]], float],
) -> Iterator[Explanation]:
    """Finding: the sensor stands at another place of its body, or shows what another sensor should."""
    sensor = spectra.sensors[channel]
    for k, other in enumerate(spectra.sensors):
        if k != channel and other.station != sensor.station:
            there = relation(spectra.omega, spectra.acceleration[channel], predicted.acceleration[k], weight, 0.0)
            if 0.8 < abs(there.gain) < 1.25:
                yield Explanation(
                    1 - there.coherence,
                    Finding(
                        cause="station",
                        channels=(sensor.name, other.name),
                        evidence=f"{sensor.name} shows the motion at {other.station.position_m:g} m of "
                        f"{other.station.body} ({100 * there.coherence:.4g} % of its power), not that of its station",
                        mend=f"check its place, its cable and its column; it may be a copy of {other.name}",
                    ),
                    2.0,
                )
    length = rig.body(sensor.station.body).length_m
    if not length:
        return
    places = np.linspace(0, length, PLACES)
    for _ in range(2):
        stations = [Station(sensor.station.body, float(x)) for x in places]
        left = [left_by(row) for row in by_forces(rig, predicted, spectra.omega, stations)]
        best = int(np.argmin(left))
        near = places[max(best - 1, 0)], places[min(best + 1, places.size - 1)]
        at, places = float(places[best]), np.linspace(*near, PLACES)
    if abs(at - sensor.station.position_m) > 2e-3:
        yield Explanation(
            min(left),
            Finding(
                cause="station",
                channels=(sensor.name,),
                of=sensor.station.body,
                evidence=f"{sensor.name} moves as the place {at:.3f} m of {sensor.station.body} does, not as "
                f"{sensor.station.position_m:g} m",
                mend="measure its place and correct rig.json",
            ),
            1.5,
        )


def _differentiated(
    spectra: Spectra, channel: int, expected: Complex[np.ndarray, " lines"], weight: Float[np.ndarray, " lines"]
) -> Iterator[Explanation]:
    name, omega = spectra.sensors[channel].name, spectra.omega
    said = {1: "differentiated", 2: "differentiated twice", -1: "integrated", -2: "integrated twice"}
    for order, what in said.items():
        turned = relation(omega, spectra.acceleration[channel] * (1j * omega) ** -order, expected, weight, 0.0)
        if not (0.5 < abs(turned.gain) < 2 or usual_factor(turned.gain)):
            continue
        yield Explanation(
            1 - turned.coherence,
            Finding(
                cause="derivative",
                channels=(name,),
                evidence=f"{name} is the motion that the others predict, {what} ({100 * turned.coherence:.4g} % of it)",
                mend="correct its quantity in rig.json and in the import map",
            ),
            3.0,
        )


def _filtered(
    name: str,
    omega: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, " lines"],
    expected: Complex[np.ndarray, " lines"],
    weight: Float[np.ndarray, " lines"],
) -> Explanation | None:
    """A gain and a phase that change over frequency: a constant of each in each of some bands, of growing width."""
    gains, left, middle = bandwise(omega, measured, expected, weight)
    size = np.abs(gains)
    if not (size.max() > 1.03 * size.min() > 0):
        return None
    low, high = middle[0] / (2 * np.pi), middle[-1] / (2 * np.pi)
    return Explanation(
        left,
        Finding(
            cause="filtered",
            channels=(name,),
            evidence=f"{name} passes {100 * size[0]:.3g} % of the predicted motion at {low:.3g} Hz and "
            f"{100 * size[-1]:.3g} % at {high:.3g} Hz",
            mend="undo its filter or its coupling, or record without",
        ),
        4.0,
    )


def _slipped(name: str, delays: Float[np.ndarray, " parts"]) -> Finding:
    more = float(delays[-1] - delays[0])
    return Finding(
        cause="slipped samples",
        channels=(name,),
        evidence=f"{name} is {1e3 * abs(more):.3g} ms {'later' if more > 0 else 'earlier'} against the others at the "
        "record's end than at its begin",
        mend="it lost or doubled samples, or has a clock of its own: synchronise it and record again",
    )
