"""Nuisance columns D of the whitened residual, and the column of a modulus that drifts."""

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.gauges import gauge_nuisance_changes
from identify.gaps.residual.nuisance import MODE_FREQUENCY_REACH
from identify.gaps.residual.record import Record
from identify.gaps.unmeasured_force.whitened_record import (
    WhitenedRecord,
    modal_inverse,
    whitened_record_without_nuisance,
    with_columns,
)
from identify.linear.free_motion import initial_state_changes
from identify.linear.nuisance import Change, Nuisance, ObservedSignals, changes_of, crosstalk_changes
from identify.linear.observed_motion import BodyMotion
from identify.signals.kinematics import omega_power
from rig.model.description import Rig


def whitened_record(record: Record, rig: Rig) -> WhitenedRecord:
    """Whitened residual of a record against the linear part of a rig, with its nuisance columns.

    Raises RigError if the contacts' free forces explain all that the sensors give.
    """
    whitened = whitened_record_without_nuisance(record, rig)
    parameters, columns, trace_terms = nuisance_columns(whitened)
    return with_columns(whitened, parameters, [columns], trace_terms)


def nuisance_columns(
    whitened: WhitenedRecord,
) -> tuple[tuple[Nuisance, ...], Complex[np.ndarray, "columns lines rows"], Float[np.ndarray, " columns"]]:
    """Nuisance parameters, the columns D by one tolerance of each, and the trace term 2 Re tr(dD/dA) of each."""
    model, sensor_count = whitened.model, len(whitened.record.sensors)
    signal_norm = float(np.linalg.norm(whitened.record.acceleration_signals))
    body_names = [response.body.name for response in model.responses]
    motion = _observed_signals_of_record(whitened)
    parameters, columns, trace_terms = list[Nuisance](), list[Complex[np.ndarray, "lines rows"]](), list[float]()
    for parameter_changes in (
        changes_of(motion, with_common_tolerances=False),
        crosstalk_changes(motion),
        initial_state_changes(model.free_modes, body_names, model.sensor_response, signal_norm),
    ):
        for change in parameter_changes:
            column = whitened.gated_residual(change.at_all_sensors(sensor_count) / model.error_deviation)
            if np.any(column):
                parameters.append(change.parameter)
                columns.append(column.astype(np.complex64))  # they are many
                trace_terms.append(_trace_by_data(whitened, change))
    all_columns = np.array(columns).reshape(len(columns), *whitened.whitened_residual.shape)
    return tuple(parameters), all_columns, np.array(trace_terms)


def _observed_signals_of_record(whitened: WhitenedRecord) -> ObservedSignals:
    """Linearisation about the measured motion; the modelled one would lack what an unmeasured force causes."""
    record, model = whitened.record, whitened.model
    highest_hz = MODE_FREQUENCY_REACH * record.omega[-1] / (2 * np.pi)
    bodies = []
    for response, accelerations in zip(model.responses, whitened.modal_accelerations, strict=True):
        natural_hz = response.dynamics.natural_hz
        mode_indices = np.flatnonzero((natural_hz > 0) & (natural_hz < highest_hz))
        bodies.append(BodyMotion(response, accelerations, mode_indices, modal_inverse(record, response)))
    return ObservedSignals(
        sensors=record.sensors,
        displacement_sensors=record.sensors,
        tolerances=record.tolerances,
        omega=record.omega,
        sensor_response=model.sensor_response,
        signals=record.acceleration_signals - model.sensor_response * model.base_at_sensors,
        force_accelerations=model.acceleration_by_force[: 0 if model.base else None],
        displacements=record.displacement_signals,
        further_changes=gauge_nuisance_changes(record, model),
        base=model.observed_base,
        bodies=tuple(bodies),
    )


def _trace_by_data(whitened: WhitenedRecord, change: Change) -> float:
    """Twice the trace of a column's derivative by the data, 2 Re sum of tr(dD/dA); zero if it does not read them."""
    if change.sensor_pattern is None:
        return 0.0
    sensor_response, error_deviation = whitened.model.sensor_response, whitened.model.error_deviation
    pattern = np.zeros_like(sensor_response)
    pattern[change.sensors] = change.sensor_pattern.pattern
    weighted = change.sensor_pattern.weights[:, None] * error_deviation / sensor_response.conj()
    weighted_rows, pattern_rows = (
        whitened.projected_rows(signals[:, whitened.line_slice]) for signals in (weighted, pattern / error_deviation)
    )
    return 2 * float(np.sum(weighted_rows.conj() * pattern_rows).real)


def modulus_drift_column(whitened: WhitenedRecord, body_name: str) -> Complex[np.ndarray, "lines rows"]:
    """Whitened residual, gated in time, by a modulus that drifts (`modulus_drift_accelerations`)."""
    accelerations = modulus_drift_accelerations(whitened, body_name)
    return whitened.gated_residual(whitened.model.sensor_response * accelerations / whitened.model.error_deviation)


def modulus_drift_accelerations(whitened: WhitenedRecord, body_name: str) -> Complex[np.ndarray, "sensors alllines"]:
    """Accelerations by a body's modulus that grows by its own size over the record: -Phi H FFT[tau omega_n^2 q].

    tau, relative_time, runs from -1/2 to 1/2 over the record; a constant change is among the nuisance parameters.
    """
    record, model = whitened.record, whitened.model
    sample_count = record.transform_length // record.decimation
    relative_time = np.arange(sample_count) / (record.sample_count / record.decimation) - 0.5
    relative_time[relative_time > 0.5] = 0.0
    accelerations = np.zeros(model.sensor_response.shape, dtype=complex)
    integration = omega_power(record.omega, -2, record.corner_hz)
    for response, modal_accelerations in zip(model.responses, whitened.modal_accelerations, strict=True):
        if response.body.name == body_name and not response.body.is_mass:
            natural_omega = 2 * np.pi * response.modes.frequencies_hz(response.mode_count)
            is_in_band = natural_omega < MODE_FREQUENCY_REACH * record.omega[-1]
            stiffness_spectra = natural_omega[is_in_band, None] ** 2 * integration * modal_accelerations[is_in_band]
            modal_forces = np.zeros_like(modal_accelerations)
            modal_forces[is_in_band] = -np.fft.rfft(relative_time * np.fft.irfft(stiffness_spectra, sample_count))
            accelerations += response.shapes(record.sensor_places) @ response.modal_accelerations(modal_forces)
    return accelerations
