"""Shaken base whose motion is measured: its spectra in a record, and what it does at the sensors.

Sensors on bodies measure the motion in space, and contacts, springs and dampers to the ground act on the motion against
the base. With the base's acceleration a_B and the participations Gamma_m of the modes, sensors at x show

    A(x) = a_B (1 - sum_m phi_m(x) H_m Gamma_m) + ...        H_m: modal accelerance

The inertial force -a_B on each kilogram (N/kg) is the force on the ground of `input_shapes`. The noise of the base's
sensor enters all signals alike: it is one unknown input with a prior, as the noise of a force is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as with_fields

import numpy as np
from jaxtyping import Complex, Float
from scipy.interpolate import make_interp_spline

from identify.linear.model import Place, Response
from rig.errors import RigError
from rig.model.description import BaseMotion, Rig, Sensor
from rig.model.modes import participation
from rig.recording import Recording

READ_QUANTITIES = ("acceleration", "displacement")
"""Quantities of which the diagnosis reads a shaken base, the first that base and bodies have in common."""
SPLINE_DEGREE = 5
"""Degree of the spline that differentiates displacements of the base twice: its error is below 1 % up to a fifth of the
sampling rate."""


@dataclass(frozen=True)
class BaseSpectra:
    """Motion of a shaken base on a record's lines, under the record's window.

    sensor is that on the ground. acceleration is the windowed acceleration, acceleration_at_sensors what each sensor on
    a body shows of it: without a window correction the derivative of the windowed signal. noise_variance is by line.
    """

    sensor: Sensor
    acceleration: Complex[np.ndarray, " lines"]
    acceleration_at_sensors: Complex[np.ndarray, "sensors lines"]
    displacement: Complex[np.ndarray, " lines"]
    noise_variance: Float[np.ndarray, " lines"]

    def deconvolved(self, rig: Rig, omega: Float[np.ndarray, " lines"]) -> "BaseSpectra":
        """Motion behind these signals by the sensor's gain, delay and high-pass in a rig."""
        sensor = next(base_sensor for base_sensor in rig.base_sensors if base_sensor.name == self.sensor.name)
        sensor_response = sensor.response(omega)
        return with_fields(
            self,
            sensor=sensor,
            acceleration=self.acceleration / sensor_response,
            acceleration_at_sensors=self.acceleration_at_sensors / sensor_response,
            displacement=self.displacement / sensor_response,
            noise_variance=self.noise_variance / sensor.gain**2,
        )

    def thinned(self, kept_lines: slice) -> "BaseSpectra":
        """Motion on a selection of the lines."""
        return with_fields(
            self,
            acceleration=self.acceleration[kept_lines],
            acceleration_at_sensors=self.acceleration_at_sensors[:, kept_lines],
            displacement=self.displacement[kept_lines],
            noise_variance=self.noise_variance[kept_lines],
        )


def check_base(rig: Rig) -> None:
    """Check what measures a shaken base; raises RigError with what the diagnosis takes."""
    if not rig.base_sensors:
        return
    if body_forces := [force for force in rig.forces if not rig.is_on_ground(force)]:
        raise RigError(
            f"identify gap takes a base that alone shakes a rig, and {rig.name!r} has a force on "
            f"{body_forces[0].body!r} beside {rig.base_sensors[0].name!r} on the ground; record without that force and "
            "leave force_at out, or record by the force with the base at rest and take the sensor off the ground"
        )
    if common_sensor_quantity(rig) is None:
        raise RigError(
            f"identify gap reads a shaken base and its bodies by {' or '.join(READ_QUANTITIES)} sensors, the same on "
            f"both, and {rig.name!r} has {_quantities(rig.base_sensors)} on the ground and "
            f"{_quantities(body_sensors(rig))} on bodies; put an accelerometer on the ground and on the bodies"
        )


def _quantities(sensors: tuple[Sensor, ...]) -> str:
    return " and ".join(dict.fromkeys(sensor.quantity for sensor in sensors)) or "none"


def body_sensors(rig: Rig) -> tuple[Sensor, ...]:
    """Sensors of motion on bodies."""
    return tuple(sensor for sensor in rig.sensors if sensor.measures.translates and sensor not in rig.base_sensors)


def common_sensor_quantity(rig: Rig) -> str | None:
    """Quantity by which base and bodies are read; None if they have none in common."""
    on_ground, on_bodies = ({sensor.quantity for sensor in group} for group in (rig.base_sensors, body_sensors(rig)))
    return next((quantity for quantity in READ_QUANTITIES if quantity in on_ground & on_bodies), None)


def base_sensor(rig: Rig) -> Sensor:
    """Sensor on the ground by which the base is read."""
    quantity = common_sensor_quantity(rig)
    return next(sensor for sensor in rig.base_sensors if sensor.quantity == quantity)


def with_inertial_force(recording: Recording) -> Recording:
    """Recording whose force is the inertial force on each kilogram, minus the base's acceleration, N/kg.

    It sets level, band and null simulations; the linear model reads the sensor itself. Recordings of a rig without a
    sensor on the ground stay as they are.
    """
    if not recording.rig.base_sensors:
        return recording
    sensor, force_signals = base_sensor(recording.rig), recording.signals["force"]
    base_signal = recording.values_of(sensor) / sensor.gain
    if sensor.measures.order == 0:
        samples = np.arange(base_signal.size)
        spline = make_interp_spline(samples, base_signal, SPLINE_DEGREE)
        base_signal = spline.derivative(2)(samples) * recording.rig.sample_rate_hz**2
    inertial_force = with_fields(force_signals, values=-base_signal[None])
    return with_fields(recording, signals={**recording.signals, "force": inertial_force})


def unmeasured_base_accelerations(
    rig: Rig,
    base_motion: BaseMotion,
    responses: tuple[Response, ...],
    sensor_places: Sequence[Place],
    sample_count: int,
) -> Complex[np.ndarray, "sensors lines"]:
    """Accelerations by an unmeasured base motion of one standard deviation per line, an inertial load on each mode."""
    omega = responses[0].cache.omega
    accelerations = np.ones((len(sensor_places), omega.size), dtype=complex)
    accelerations[[isinstance(place, Sensor) for place in sensor_places]] = 0.0  # strain gauges show bending alone
    for response in responses:
        modal_load = participation(rig, response.body, response.modes, response.mode_count)
        accelerations -= response.transfer(response.shapes(sensor_places), modal_load[None])[0]
    return np.asarray(accelerations * unmeasured_base_deviation(base_motion, omega, sample_count, rig.sample_rate_hz))


def unmeasured_base_deviation(
    base_motion: BaseMotion, omega: Float[np.ndarray, " lines"], sample_count: int, rate_hz: float
) -> Float[np.ndarray, " lines"]:
    """Standard deviation of each line of an unmeasured base's acceleration, zero outside its band."""
    lines_hz = omega / (2 * np.pi)
    power_density = base_motion.acceleration_rms_m_per_s2**2 / (base_motion.high_hz - base_motion.low_hz)
    is_in_band = (lines_hz >= base_motion.low_hz) & (lines_hz <= base_motion.high_hz)
    return np.asarray(np.sqrt(power_density * sample_count * rate_hz / 2) * is_in_band)
