"""Strain gauges in a record: rows of the linear residual behind those of the sensors of motion.

A gauge at the distance h from the neutral fibre shows epsilon = -h w''(x) (`identify.contacts.gauges`). Its second
derivative by time, an exact factor (i omega)^2 on the spectrum, has the form of an acceleration: a modal sum of
-h phi_m''(x) A_m. So gain, delay, place, modes and effects change it as they change accelerations. What no tolerance
states, its zero and the modes beyond the last, are nuisance parameters of their own. Relative displacements follow from
the sensors of motion alone.
"""

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace

from identify.contacts.gauges import GaugeErrors, truncation_of
from identify.gaps.residual.extent import SIGNAL_TO_NOISE_RATIO, RecordBeginning
from identify.gaps.residual.linear import LinearModel
from identify.gaps.residual.record import Record
from identify.gaps.residual.unfolding import IN_Z
from identify.linear.nuisance import Change
from rig.model.description import Sensor
from rig.recording import Recording


def reason_against_gauges(recording: Recording) -> str:
    """Reason why the diagnosis does not read the strain gauges of a recording; empty if it does."""
    if not np.any(recording.forces_n):
        return "identify gap reads strain gauges in records of a measured force alone"
    if recording.rig.base_sensors:
        return "identify gap reads no strain gauges on a shaken base"
    if any(body.name.endswith(IN_Z) for body in recording.rig.bodies):
        return "identify gap reads strain gauges of rigs that move in one direction alone"
    return ""


def gauge_sensors(recording: Recording) -> tuple[Sensor, ...]:
    """Strain gauges that the diagnosis reads, each with its fibre_m."""
    if reason_against_gauges(recording):
        return ()
    rig = recording.rig
    return tuple(replace(s, fibre_m=rig.fibre_m(s)) for s in rig.sensors if not s.measures.translates)


def zeros_of(
    recording: Recording, gauges: tuple[Sensor, ...], beginning: RecordBeginning
) -> tuple[Float[np.ndarray, " gauges"], Float[np.ndarray, " gauges"]]:
    """Zero of each gauge and its standard deviation: the mean before the force, or without a quiet start that of the
    record, which is as uncertain as the strain is large."""
    signals = np.array([recording.values_of(gauge) for gauge in gauges]).reshape(len(gauges), recording.samples)
    quiet = signals[:, : beginning.quiet_sample_count or None]
    return quiet.mean(axis=1), quiet.std(axis=1) / np.sqrt(max(1, beginning.quiet_sample_count))


def without_noise_lines(
    record: Record, body_name: str, accelerations: Complex[np.ndarray, "sensors lines"]
) -> Complex[np.ndarray, "sensors lines"]:
    """Accelerations of which the modal ones of a body follow; in a record with gauges zero on the lines where a sensor
    of motion on the body shows much noise, which would be as large as the slow bending that gauges show."""
    sensor_indices = record.motion_sensors_on(body_name)
    if not sensor_indices or len(record.sensors) == len(record.motion_sensors):
        return accelerations
    noise_ratio = record.noise_variance[sensor_indices] / np.maximum(record.smoothed_power[sensor_indices], 1e-300)
    return accelerations * (noise_ratio.max(axis=0) < 1 / SIGNAL_TO_NOISE_RATIO)


def gauge_changes(record: Record, model: LinearModel) -> tuple[Change, ...]:
    """Changes of the gauges' signals by one standard deviation of their zeros, and of the modes left out."""
    rig, motion_count = model.rig, len(record.motion_sensors)
    gauges = record.sensors[motion_count:]
    if not gauges:
        return ()
    measured_forces_n = [force_n for _, force_n in model.known_forces[: len(rig.forces)]]
    unit_zero = -(record.omega**2) * record.spectrum(np.ones(record.sample_count))
    errors = GaugeErrors(
        motion_count,
        tuple(gauge.name for gauge in gauges),
        (*rig.force_names, *(contact.name for contact in rig.contacts)),
        np.outer(record.zero_errors[motion_count:], unit_zero),
        truncation_of(gauges, rig, model.responses, model.sensor_response[motion_count:]),
    )
    return errors.changes(np.stack([*measured_forces_n, *model.contact_force_n]))
