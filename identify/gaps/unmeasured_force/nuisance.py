"""Nuisance parameters, and a modulus that drifts, as columns of the whitened residual."""

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.nuisance import BEYOND
from identify.gaps.residual.record import Record
from identify.gaps.unmeasured_force.observed import WhitenedRecord, bare_residual, inverse_of, with_columns
from identify.linear.free_motion import state_changes
from identify.linear.nuisance import BodyMotion, Change, Nuisance, Observed, changes_of, crosstalk_of
from identify.signals.kinematics import CORNER_HZ, integrated
from rig.model.description import Rig


def observed(record: Record, rig: Rig) -> WhitenedRecord:
    """The residual of a rig's linear part against a record, with its nuisance columns.

    Raises RigError if the contacts' free forces explain all that the sensors give.
    """
    bare = bare_residual(record, rig)
    return with_columns(bare, *nuisances(bare))


def nuisances(
    bare: WhitenedRecord,
) -> tuple[tuple[Nuisance, ...], Complex[np.ndarray, "columns lines rows"], Float[np.ndarray, " columns"]]:
    """The parameters, columns D by one tolerance each, and how much each stretches the data."""
    model = bare.model
    size, bodies = float(np.linalg.norm(bare.record.delivered)), [r.body.name for r in model.responses]
    parameters: list[Nuisance] = []
    columns: list[Complex[np.ndarray, "lines rows"]] = []
    trace: list[float] = []
    measured = _measured(bare)
    for changes in (
        changes_of(measured, common=False),
        crosstalk_of(measured),
        state_changes(model.free, bodies, model.sensor_response, size),
    ):
        for change in changes:
            column = bare.gated(change.at_all(len(bare.record.sensors)) / model.deviation)
            if np.any(column):
                parameters.append(change.parameter)
                columns.append(column.astype(np.complex64))  # they are many
                trace.append(_stretching(bare, change))
    return tuple(parameters), np.array(columns).reshape(len(columns), *bare.residual.shape), np.array(trace)


def _measured(bare: WhitenedRecord) -> Observed:
    """The accelerations as measured: about the modelled ones they would lack what an unmeasured force does."""
    record, model = bare.record, bare.model
    highest = BEYOND * record.omega[-1] / (2 * np.pi)
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
                inverse_of(record, response),
            )
            for response, motion in zip(model.responses, bare.modal, strict=True)
        ),
    )


def _stretching(bare: WhitenedRecord, change: Change) -> float:
    """Twice the trace of a column's derivative by the data: 2 Re sum of tr(dr/dA)."""
    if change.reading is None:
        return 0.0
    response, deviation = bare.model.sensor_response, bare.model.deviation
    pattern = np.zeros_like(response)
    pattern[change.sensors] = change.reading.pattern
    back = bare.rowed((change.reading.weights[:, None] * deviation / response.conj())[:, bare.lines])
    there = bare.rowed((pattern / deviation)[:, bare.lines])
    return 2 * float(np.sum(back.conj() * there).real)


def drifting(own: WhitenedRecord, body: str) -> Complex[np.ndarray, "lines rows"]:
    """The residual by a modulus of a body that grows by its own size over the record."""
    return own.gated(own.model.sensor_response * drift_accelerations(own, body) / own.model.deviation)


def drift_accelerations(own: WhitenedRecord, body: str) -> Complex[np.ndarray, "sensors alllines"]:
    """Accelerations by a modulus that grows by its own size over the record: -Phi H FFT[tau omega_n^2 q].

    tau runs from -1/2 to 1/2; a constant change is a nuisance already.
    """
    record, model = own.record, own.model
    length = record.length // record.factor
    tau = np.arange(length) / (record.samples / record.factor) - 0.5
    tau[tau > 0.5] = 0.0
    found = np.zeros(model.sensor_response.shape, dtype=complex)
    twice = integrated(record.omega, -2, CORNER_HZ)
    for response, motion in zip(model.responses, own.modal, strict=True):
        if response.body.name == body and not response.body.is_mass:
            natural = 2 * np.pi * response.modes.frequencies_hz(response.count)
            near = natural < BEYOND * record.omega[-1]
            pushed = -np.fft.rfft(tau * np.fft.irfft(natural[near, None] ** 2 * twice * motion[near], length))
            found += response.shapes([s.station for s in record.sensors])[:, near] @ (
                response.accelerance[near] * pushed
            )
    return found
