"""Nuisance parameters: properties that a laboratory never knows exactly, and how each changes the sensors' signals.

With D = omega_m^2 - omega^2 + 2 i zeta_m omega_m omega of a mode, an error dD changes its acceleration by exactly -dD /
D times the true one: therefore these changes hold the measured modal accelerations. All are in units of one standard
deviation, as the tolerances state it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from identify.linear.model import Response, real_product
from identify.linear.observed_motion import BodyMotion, ObservedBase, ObservedTransverse
from identify.signals.kinematics import CORNER_HZ, omega_power
from rig.model.description import Sensor, force_names
from rig.model.tolerances import Tolerances

SINGLE_FORCE_NAME = "the force"
RECORD_NAME = "the record"
BAND_MARGIN = 1.25
"""Modes up to this multiple of the band's end have tolerances; those beyond are taken as exact."""


class NuisanceKind(StrEnum):
    """Kinds of nuisance parameters: of a sensor, a force, a body or one of its modes, a record."""

    GAIN = "gain"
    POSITION = "position"
    DELAY = "delay"
    HIGH_PASS = "high-pass"
    CROSS_AXIS = "cross-axis share"
    ZERO = "zero"
    TRUNCATION = "truncated response"
    CROSSTALK = "crosstalk"
    FORCE_GAIN = "force gain"
    MASS = "mass"
    FREQUENCY = "frequency"
    DAMPING = "damping"
    INITIAL_STATE = "initial state"
    MODULUS_DRIFT = "modulus drift"


@dataclass(frozen=True)
class Nuisance:
    """One nuisance parameter of a sensor, a force, a record, a body, or a mode of a body (numbered from 1)."""

    kind: NuisanceKind
    owner: str
    mode_number: int | None = None

    @property
    def name(self) -> str:
        return f"{self.kind} of {self.owner}" + ("" if self.mode_number is None else f" {self.mode_number}")


@dataclass(frozen=True)
class SensorPattern:
    """Change as a function of measured signals: `pattern` times the weighted sum of the sensors' accelerations."""

    pattern: Complex[np.ndarray, "some lines"]
    weights: Float[np.ndarray, " sensors"]


@dataclass(frozen=True)
class Change:
    """Change by one standard deviation of a parameter in the signals of some sensors, and in the displacements there.

    sensor_pattern is None if nothing measured enters, or if its way is unknown.
    """

    parameter: Nuisance
    sensors: list[int]
    signals: Complex[np.ndarray, "some lines"]
    displacements: Complex[np.ndarray, "some lines"] | None = None
    sensor_pattern: SensorPattern | None = None

    @property
    def in_single_precision(self) -> "Change":
        displacements = None if self.displacements is None else self.displacements.astype(np.complex64)
        return replace(self, signals=self.signals.astype(np.complex64), displacements=displacements)

    def at_all_sensors(self, sensor_count: int) -> Complex[np.ndarray, "sensors lines"]:
        """Change at all sensors."""
        signals = np.zeros((sensor_count, self.signals.shape[1]), dtype=complex)
        signals[self.sensors] = self.signals
        return signals


@dataclass(frozen=True)
class ObservedSignals:
    """Signals that the sensors deliver of the true motion, and its parts that the changes need.

    force_accelerations are those by each measured force on a body; displacements those at the sensors' stations, which
    the `displacement_sensors` gave, as they gave the signals on the lines `is_from_displacement`, if any.
    sensor_response is a sensor's signal per acceleration. further_changes are those by parameters that no tolerance
    states. Where a base is measured, all motion is relative to it.
    """

    sensors: tuple[Sensor, ...]
    displacement_sensors: tuple[Sensor, ...]
    tolerances: Tolerances
    omega: Float[np.ndarray, " lines"]
    sensor_response: Complex[np.ndarray, "sensors lines"]
    signals: Complex[np.ndarray, "sensors lines"]
    force_accelerations: Complex[np.ndarray, "forces sensors lines"]
    displacements: Complex[np.ndarray, "sensors lines"]
    bodies: tuple[BodyMotion, ...]
    further_changes: tuple[Change, ...] = ()
    base: ObservedBase | None = None
    transverse: ObservedTransverse | None = None
    is_from_displacement: Bool[np.ndarray, "sensors lines"] | None = None

    def line_mask_of_channel(
        self, channel: Sensor, sensor_index: int, base: ObservedBase | None = None
    ) -> Bool[np.ndarray, " lines"]:
        """Lines on which a channel gives the signal of a row, or the motion of the base in it."""
        sensor, displacement_sensor = self.sensors[sensor_index], self.displacement_sensors[sensor_index]
        if base is not None:
            sensor, displacement_sensor = base.sensor, base.displacement_sensor
        from_displacement = np.zeros(self.omega.size, dtype=bool)
        if self.is_from_displacement is not None:
            from_displacement = self.is_from_displacement[sensor_index]
        return ((channel == sensor) & ~from_displacement) | ((channel == displacement_sensor) & from_displacement)

    @property
    def is_motion_sensed(self) -> bool:
        """True if the motion of all bodies follows from the sensors."""
        return all(body.sensor_weights is not None for body in self.bodies)


def elastic_mode_indices(response: Response, mode_count: int) -> Int[np.ndarray, " some"]:
    """Modes among the first `mode_count` that bend a body; none for a single mass."""
    body = response.body
    return np.arange(body.rigid_modes, max(mode_count, body.rigid_modes) if not body.is_mass else body.rigid_modes)


def mode_count_below_band_margin(response: Response, margin: float = BAND_MARGIN) -> int:
    """Number of modes up to `margin` times the band's end."""
    dynamics = response.dynamics
    return int(np.count_nonzero(dynamics.natural_hz < margin * dynamics.omega[-1] / (2 * np.pi)))


def changes_of(observed: ObservedSignals, with_common_tolerances: bool = True) -> Iterator[Change]:
    """Changes by every tolerance above zero, then the further ones; by tolerances that all modes of a body have in
    common only on request."""
    yield from _sensor_changes(observed)
    yield from _cross_axis_changes(observed)
    yield from _base_changes(observed)
    yield from _force_changes(observed)
    for body in observed.bodies:
        sensor_indices = [i for i, s in enumerate(observed.sensors) if s.station.body == body.response.body.name]
        yield from _position_changes(observed, body, sensor_indices)
        yield from _mode_changes(observed, body, sensor_indices, with_common_tolerances)
    yield from observed.further_changes


def _sensor_changes(observed: ObservedSignals) -> Iterator[Change]:
    """Changes by each sensor's chain, which passes the motion in space: that against the base and the base's."""
    base = observed.base
    base_acceleration, base_displacement = (base.acceleration, base.displacement) if base else (0.0, 0.0)
    sensor_units = np.eye(len(observed.sensors))
    sensor_pairs = zip(observed.sensors, observed.displacement_sensors, strict=True)
    for i, (sensor, displacement_sensor) in enumerate(sensor_pairs):
        response = observed.sensor_response[[i]]
        for channel in dict.fromkeys((sensor, displacement_sensor)):
            for kind, relative in _chain_changes(channel, observed.tolerances, observed.omega).items():
                if np.any(relative):
                    signals = relative * (observed.signals[[i]] + response * base_acceleration)
                    signals = signals * observed.line_mask_of_channel(channel, i)
                    absolute_displacement = observed.displacements[[i]] + base_displacement
                    displacements = relative * absolute_displacement if channel == displacement_sensor else None
                    pattern = SensorPattern(relative * response, sensor_units[i]) if observed.is_motion_sensed else None
                    yield Change(Nuisance(kind, channel.name), [i], signals, displacements, pattern)


def _cross_axis_changes(observed: ObservedSignals) -> Iterator[Change]:
    """Changes by the share of the motion across that each sensor shows."""
    transverse = observed.transverse
    for i, signals, displacements in (
        zip(transverse.sensors, transverse.signals, transverse.displacements, strict=True) if transverse else ()
    ):
        sensor, displacement_sensor = observed.sensors[i], observed.displacement_sensors[i]
        for channel in dict.fromkeys((sensor, displacement_sensor)):
            if cross_axis_share := observed.tolerances.of_sensor(channel.name).cross_axis:
                yield Change(
                    Nuisance(NuisanceKind.CROSS_AXIS, channel.name),
                    [i],
                    cross_axis_share * signals[None] * (channel == sensor),
                    cross_axis_share * displacements[None] if channel == displacement_sensor else None,
                )


def _base_changes(observed: ObservedSignals) -> Iterator[Change]:
    """Changes by the chains of the sensors on a shaken base: a gain that is too large takes too much motion from every
    sensor, and more for what the base causes."""
    base, sensor_indices = observed.base, list(range(len(observed.sensors)))
    if base is None:
        return
    for channel in dict.fromkeys((base.sensor, base.displacement_sensor)):
        for kind, relative_change in _chain_changes(channel, observed.tolerances, observed.omega).items():
            if np.any(relative_change):
                given_lines = np.stack([observed.line_mask_of_channel(channel, i, base) for i in sensor_indices])
                accelerations = given_lines * base.acceleration + base.station_accelerations * (channel == base.sensor)
                signals = -relative_change * observed.sensor_response * accelerations
                displacements = None
                if channel == base.displacement_sensor:
                    displacements = np.tile(-relative_change * base.displacement, (len(sensor_indices), 1))
                yield Change(Nuisance(kind, channel.name), sensor_indices, signals, displacements)


def crosstalk_changes(observed: ObservedSignals) -> Iterator[Change]:
    """Changes by crosstalk between neighbouring channels of the same quantity: tolerance times A."""
    crosstalk_share, sensors, units = observed.tolerances.crosstalk, observed.sensors, np.eye(len(observed.sensors))
    gives_displacement = [a == b for a, b in zip(sensors, observed.displacement_sensors, strict=True)]
    for left, right in pairwise(range(len(sensors)) if crosstalk_share else ()):
        if sensors[left].measures != sensors[right].measures:
            continue
        for source, target in ((left, right), (right, left)):
            parameter = Nuisance(NuisanceKind.CROSSTALK, f"{sensors[source].name} in {sensors[target].name}")
            both_give_displacement = gives_displacement[source] and gives_displacement[target]
            displacements = crosstalk_share * observed.displacements[[source]] if both_give_displacement else None
            pattern = None
            if observed.is_motion_sensed:
                pattern = SensorPattern(crosstalk_share * observed.sensor_response[[source]], units[source])
            yield Change(parameter, [target], crosstalk_share * observed.signals[[source]], displacements, pattern)


def _chain_changes(
    sensor: Sensor, tolerances: Tolerances, omega: Float[np.ndarray, " lines"]
) -> dict[NuisanceKind, Complex[np.ndarray, " lines"]]:
    """Relative change of a sensor's signal by one tolerance each of its gain g, its delay tau, and the corner w of the
    first-order high-pass i omega / (i omega + w) of an AC-coupled one: g, -i omega tau, -w / (i omega + w).
    """
    sensor_tolerance, i_omega = tolerances.of_sensor(sensor.name), 1j * omega
    corner_omega = 2 * np.pi * sensor_tolerance.high_pass_hz if sensor.measures.ac_coupled else 0.0
    return {
        NuisanceKind.GAIN: np.full(omega.size, sensor_tolerance.gain, dtype=complex),
        NuisanceKind.DELAY: -sensor_tolerance.delay_s * i_omega,
        NuisanceKind.HIGH_PASS: -corner_omega / (i_omega + corner_omega) if corner_omega else np.zeros_like(i_omega),
    }


def _force_changes(observed: ObservedSignals) -> Iterator[Change]:
    """Changes by the gain of each measured force, which is gain times the true one."""
    force_count = len(observed.force_accelerations)
    gain_names = force_names(force_count) if force_count > 1 else (SINGLE_FORCE_NAME,) * force_count
    if gain_tolerance := observed.tolerances.force_gain:
        for name, accelerations in zip(gain_names, observed.force_accelerations, strict=True):
            signals = -gain_tolerance * observed.sensor_response * accelerations
            yield Change(Nuisance(NuisanceKind.FORCE_GAIN, name), list(range(len(signals))), signals)


def _position_changes(observed: ObservedSignals, motion: BodyMotion, sensors: list[int]) -> Iterator[Change]:
    """Changes by the position of each sensor along the body."""
    if not (motion.response.body.length_m and sensors):
        return
    shape_slopes = motion.response.slopes([observed.sensors[i] for i in sensors])[:, motion.moving_modes]
    double_integral = omega_power(observed.omega, -2, CORNER_HZ)
    for i, slope, slope_acceleration in zip(sensors, shape_slopes, shape_slopes @ motion.acceleration, strict=True):
        sensor, displacement_sensor, response = (
            observed.sensors[i],
            observed.displacement_sensors[i],
            observed.sensor_response[i],
        )
        for channel in dict.fromkeys((sensor, displacement_sensor)):
            if tolerance_m := observed.tolerances.of_sensor(channel.name).position_m:
                acceleration_change = tolerance_m * slope_acceleration[None]
                signals = response * acceleration_change * observed.line_mask_of_channel(channel, i)
                displacements = double_integral * acceleration_change if channel == displacement_sensor else None
                pattern = None
                if motion.sensor_weights is not None:
                    slope_weights = slope[: len(motion.sensor_weights)] @ motion.sensor_weights
                    pattern = SensorPattern(tolerance_m * response[None], slope_weights)
                yield Change(Nuisance(NuisanceKind.POSITION, channel.name), [i], signals, displacements, pattern)


def _mode_changes(
    observed: ObservedSignals, motion: BodyMotion, sensors: list[int], with_common_tolerances: bool
) -> Iterator[Change]:
    """Changes by the mass of a body, by its frequencies and its damping together, and by those of each mode.

    A body of another mass follows its base as before.
    """
    response, tolerances, sensor_weights = motion.response, observed.tolerances, motion.sensor_weights
    body, sensor_response = response.body, observed.sensor_response[sensors]
    shapes = response.shapes([observed.sensors[i] for i in sensors])[:, motion.moving_modes]
    if with_common_tolerances and tolerances.mass:
        driven_accelerations = real_product(shapes, motion.acceleration)
        if observed.base:
            driven_accelerations -= observed.base.station_accelerations[sensors]
        signals = -tolerances.mass * sensor_response * driven_accelerations
        yield Change(Nuisance(NuisanceKind.MASS, body.name), sensors, signals)
    for kind in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING):
        sensitivities = response.sensitivity(kind is NuisanceKind.FREQUENCY, motion.moving_modes)
        if with_common_tolerances and (tolerance := _frequency_or_damping_tolerance(tolerances, kind)):
            signals = tolerance * sensor_response * real_product(shapes, sensitivities * motion.acceleration)
            yield Change(Nuisance(kind, body.name), sensors, signals)
        for mode_index in motion.elastic_indices.tolist():
            if tolerance := _frequency_or_damping_tolerance(tolerances.of_mode(body.name, mode_index + 1), kind):
                mode_response = tolerance * sensor_response * (shapes[:, mode_index, None] * sensitivities[mode_index])
                pattern = None
                if sensor_weights is not None and mode_index < len(sensor_weights):
                    pattern = SensorPattern(mode_response, sensor_weights[mode_index])
                signals = mode_response * motion.acceleration[mode_index]
                yield Change(Nuisance(kind, body.name, mode_index + 1), sensors, signals, sensor_pattern=pattern)


def _frequency_or_damping_tolerance(tolerances: Tolerances, kind: NuisanceKind) -> float:
    """Tolerance of frequencies or of damping ratios."""
    return tolerances.frequency if kind is NuisanceKind.FREQUENCY else tolerances.damping
