"""Nuisance columns D of the whitened residual, and the column of a modulus that drifts."""

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.nuisance import MODE_REACH
from identify.gaps.residual.record import Record
from identify.gaps.unmeasured_force.whitened_record import WhitenedRecord, bare_residual, modal_inverse, with_columns
from identify.linear.free_motion import state_changes
from identify.linear.nuisance import BodyMotion, Change, Nuisance, Observed, changes_of, crosstalk_of
from identify.signals.kinematics import integrated
from rig.model.description import Rig


def whitened_record(record: Record, rig: Rig) -> WhitenedRecord:
    """Whitened residual of a record against the linear part of a rig, with its nuisance columns.

    Raises RigError if the contacts' free forces explain all that the sensors give.
    """
    whitened = bare_residual(record, rig)
    return with_columns(whitened, *nuisance_columns(whitened))


def nuisance_columns(
    whitened: WhitenedRecord,
) -> tuple[tuple[Nuisance, ...], Complex[np.ndarray, "columns lines rows"], Float[np.ndarray, " columns"]]:
    """Nuisance parameters, the columns D by one tolerance of each, and the trace term 2 Re tr(dD/dA) of each."""
    model = whitened.model
    delivered_norm, bodies = float(np.linalg.norm(whitened.record.delivered)), [r.body.name for r in model.responses]
    parameters: list[Nuisance] = []
    columns: list[Complex[np.ndarray, "lines rows"]] = []
    trace_terms: list[float] = []
    measured = _measured_motion(whitened)
    for changes in (
        changes_of(measured, common=False),
        crosstalk_of(measured),
        state_changes(model.free, bodies, model.sensor_response, delivered_norm),
    ):
        for change in changes:
            column = whitened.gated_residual(change.at_all_sensors(len(whitened.record.sensors)) / model.deviation)
            if np.any(column):
                parameters.append(change.parameter)
                columns.append(column.astype(np.complex64))  # they are many
                trace_terms.append(_data_trace(whitened, change))
    return tuple(parameters), np.array(columns).reshape(len(columns), *whitened.residual.shape), np.array(trace_terms)


def _measured_motion(whitened: WhitenedRecord) -> Observed:
    """Linearisation about the measured motion; the modelled one would lack what an unmeasured force causes."""
    record, model = whitened.record, whitened.model
    highest = MODE_REACH * record.omega[-1] / (2 * np.pi)
    return Observed(
        sensors=record.sensors,
        displaced_by=record.sensors,
        tolerances=record.tolerances,
        omega=record.omega,
        sensor_response=model.sensor_response,
        explained=record.delivered,
        by_force=model.by_force,
        displaced=record.displaced,
        bodies=tuple(
            BodyMotion(
                response,
                motion,
                np.flatnonzero((response.dynamics.natural_hz > 0) & (response.dynamics.natural_hz < highest)),
                modal_inverse(record, response),
            )
            for response, motion in zip(model.responses, whitened.modal_accelerations, strict=True)
        ),
    )


def _data_trace(whitened: WhitenedRecord, change: Change) -> float:
    """Twice the trace of a column's derivative by the data, 2 Re sum of tr(dD/dA); zero if it does not read them."""
    if change.reading is None:
        return 0.0
    response, deviation = whitened.model.sensor_response, whitened.model.deviation
    pattern = np.zeros_like(response)
    pattern[change.sensors] = change.reading.pattern
    weighted_rows = whitened.project((change.reading.weights[:, None] * deviation / response.conj())[:, whitened.lines])
    pattern_rows = whitened.project((pattern / deviation)[:, whitened.lines])
    return 2 * float(np.sum(weighted_rows.conj() * pattern_rows).real)


def modulus_drift_column(whitened: WhitenedRecord, body: str) -> Complex[np.ndarray, "lines rows"]:
    """Gated residual of `drift_accelerations`."""
    return whitened.gated_residual(
        whitened.model.sensor_response * drift_accelerations(whitened, body) / whitened.model.deviation
    )


def drift_accelerations(whitened: WhitenedRecord, body: str) -> Complex[np.ndarray, "sensors alllines"]:
    """Accelerations by a body's modulus that grows by its own size over the record: -Phi H FFT[tau omega_n^2 q].

    tau runs from -1/2 to 1/2 over the record; a constant change is among the nuisance parameters.
    """
    record, model = whitened.record, whitened.model
    length = record.length // record.factor
    tau = np.arange(length) / (record.samples / record.factor) - 0.5
    tau[tau > 0.5] = 0.0
    accelerations = np.zeros(model.sensor_response.shape, dtype=complex)
    double_integration = integrated(record.omega, -2, record.corner_hz)
    for response, motion in zip(model.responses, whitened.modal_accelerations, strict=True):
        if response.body.name == body and not response.body.is_mass:
            natural_omega = 2 * np.pi * response.modes.frequencies_hz(response.count)
            in_band = natural_omega < MODE_REACH * record.omega[-1]
            modal_forces = -np.fft.rfft(
                tau * np.fft.irfft(natural_omega[in_band, None] ** 2 * double_integration * motion[in_band], length)
            )
            accelerations += response.shapes([s.station for s in record.sensors])[:, in_band] @ (
                response.accelerance[in_band] * modal_forces
            )
    return accelerations
