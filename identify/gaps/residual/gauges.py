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

from identify.contacts.gauges import gauge_zero_changes
from identify.gaps.residual.extent import RecordBeginning, diagnosis_sensors
from identify.gaps.residual.linear import LinearModel
from identify.gaps.residual.record import Record
from identify.gaps.residual.unfolding import IN_Z
from identify.linear.joined import rig_with_joined_contacts
from identify.linear.model import Response, ResponseCache, responses_of
from identify.linear.nuisance import Change
from identify.linear.truncation import truncations_of
from rig.model.description import Rig, Sensor
from rig.recording import Recording

SLOW_BENDING_SHARE = 1 / 4
"""Share of a body's lowest natural frequency below which sensors of motion do not correct its bending. Set by hand: an
error of 0.1 % in a rigid acceleration is one of 2 % in the bending there, and 0.2 % of that is no more than noise."""


def gauge_sensors(recording: Recording) -> tuple[Sensor, ...]:
    """Strain gauges that the diagnosis reads, each with its fibre_m."""
    rig, gauges = recording.rig, _gauges_of(recording.rig)
    return () if reason_against_gauges(recording) else tuple(replace(s, fibre_m=rig.fibre_m(s)) for s in gauges)


def reason_against_gauges(recording: Recording) -> str:
    """Reason why the diagnosis leaves the strain gauges of a recording out; empty if it reads them, or has none."""
    if not _gauges_of(recording.rig):
        return ""
    if not np.any(recording.forces_n):
        return "they are read in records of a measured force"
    if recording.rig.base_sensors:
        return "they are not read on a shaken base"
    if any(body.name.endswith(IN_Z) for body in recording.rig.bodies):
        return "they are read of rigs that move in one direction"
    if floating := _bodies_without_slow_bending(recording):
        return f"the other sensors do not show where {floating} rests between its stops; identify contact reads them"
    return ""


def _bodies_without_slow_bending(recording: Recording) -> str:
    """Bodies with gauges whose bending the linear model lets float, as the sensors of motion lose where it rests."""
    rig, zero_known = (
        rig_with_joined_contacts(recording.rig),
        all(s.measures.order == 0 for s in diagnosis_sensors(recording)),
    )
    gauged = {gauge.station.body for gauge in _gauges_of(rig)}
    responses = [r for r in responses_of(rig, ResponseCache(np.ones(1), 0), zero_known) if r.body.name in gauged]
    bends = [r for r in responses if any(mode >= r.body.rigid_modes for mode in r.dynamics.slowly_free_modes)]
    return " and ".join(r.body.name for r in bends)


def _gauges_of(rig: Rig) -> list[Sensor]:
    return [sensor for sensor in rig.sensors if not sensor.measures.translates]


def gauge_zeros_and_deviations(
    recording: Recording, gauges: tuple[Sensor, ...], beginning: RecordBeginning
) -> tuple[Float[np.ndarray, " gauges"], Float[np.ndarray, " gauges"]]:
    """Zero of each gauge and its standard deviation: the mean before the force, or without a quiet start that of the
    record, which is as uncertain as the strain is large."""
    signals = np.array([recording.values_of(gauge) for gauge in gauges]).reshape(len(gauges), recording.samples)
    quiet = signals[:, : beginning.quiet_sample_count or None]
    return quiet.mean(axis=1), quiet.std(axis=1) / np.sqrt(max(1, beginning.quiet_sample_count))


def without_slow_bending(
    record: Record, response: Response, correction: Complex[np.ndarray, "modes lines"]
) -> Complex[np.ndarray, "modes lines"]:
    """Correction of a body's modal accelerations by its sensors of motion; in a record with gauges none of bending far
    below its first frequency, where errors of those sensors exceed the bending that gauges show and the model knows."""
    if len(record.sensors) == len(record.motion_sensors):
        return correction
    natural_hz = response.dynamics.natural_hz[: len(correction)]
    first_hz = np.min(response.dynamics.natural_hz, where=response.dynamics.natural_hz > 0, initial=np.inf)
    is_slow = record.omega < 2 * np.pi * SLOW_BENDING_SHARE * first_hz
    return np.where(np.outer(natural_hz > 0, is_slow), 0.0, correction)


def gauge_nuisance_changes(record: Record, model: LinearModel) -> tuple[Change, ...]:
    """Changes of the gauges' signals by one standard deviation of their zeros, and of the modes left out."""
    rig, motion_count = model.rig, len(record.motion_sensors)
    gauges = record.sensors[motion_count:]
    if not gauges:
        return ()
    measured_forces_n = [force_n for _, force_n in model.known_forces[: len(rig.forces)]]
    unit_zero = -(record.omega**2) * record.spectrum(np.ones(record.sample_count))
    zeros = gauge_zero_changes(gauges, motion_count, np.outer(record.zero_errors[motion_count:], unit_zero))
    gauge_by_row = dict(enumerate(gauges, motion_count))
    truncations = truncations_of(
        rig, model.responses, rig.forces, gauge_by_row, model.sensor_response, record.tolerances.truncation
    )
    input_spectra = np.stack([*measured_forces_n, *model.contact_force_n])
    return (*zeros, *(truncation.change(input_spectra) for truncation in truncations))
