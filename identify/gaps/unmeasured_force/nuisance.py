"""What a laboratory never knows exactly, and a modulus that drifts, as columns of the whitened residual."""

import numpy as np
from jaxtyping import Complex, Float, Inexact

from identify.gaps.residual.nuisance import BEYOND
from identify.gaps.residual.spectra import Record
from identify.gaps.unmeasured_force.observed import WhitenedRecord, bare_residual, inverse_of, with_columns
from identify.linear.nuisance import chain_sensitivities
from identify.signals.kinematics import CORNER_HZ, integrated
from rig.model.description import Rig


def observed(record: Record, rig: Rig) -> WhitenedRecord:
    """The residual of a rig's linear part against a record, with its nuisance columns.

    Raises RigError if the contacts' free forces explain all that the sensors give.
    """
    bare = bare_residual(record, rig)
    return with_columns(bare, *nuisances(bare))


def nuisances(
    own: WhitenedRecord,
) -> tuple[tuple[str, ...], Complex[np.ndarray, "columns lines rows"], Float[np.ndarray, " columns"]]:
    """Names, columns D by one tolerance each, and how much each stretches the data."""
    record, model, tolerances = own.record, own.model, own.record.tolerances
    omega, deviation = record.omega, own.model.deviation
    names: list[str] = []
    columns: list[Complex[np.ndarray, "lines rows"]] = []
    trace: list[float] = []
    ones = np.ones((1, omega.size))

    def take(
        name: str,
        pattern: Inexact[np.ndarray, "sensors _"],
        history: Complex[np.ndarray, " alllines"],
        read: Float[np.ndarray, " sensors"],
    ) -> None:
        """Accelerations pattern times history, which is read from those measured."""
        pattern = pattern * ones
        column = own.gated(model.sensor_response * pattern * history / deviation)
        if np.any(column):
            names.append(name)
            columns.append(column.astype(np.complex64))  # they are many
            back = own.rowed((read[:, None] * deviation / model.sensor_response.conj())[:, own.lines])
            there = own.rowed((model.sensor_response * pattern / deviation)[:, own.lines])
            trace.append(2 * float(np.sum(back.conj() * there).real))

    for name, station, force in zip(model.rig.force_names, model.rig.forces, record.forces, strict=True):
        by_force = own.accelerance(station) / model.rig.force_sensor.gain
        of = "the force" if name == "force" else name
        take(f"gain of {of}", tolerances.force_gain * by_force, force, np.zeros(len(record.sensors)))
    singly = np.eye(len(record.sensors))
    for sensor, single, delivered in zip(record.sensors, singly, record.delivered / model.sensor_response, strict=True):
        for kind, factor in chain_sensitivities(sensor, tolerances, omega).items():
            take(f"{kind} of {sensor.name}", single[:, None] * factor, delivered, single)
    for response, motion in zip(model.responses, own.modal, strict=True):
        body = response.body
        inverse = np.zeros((response.count, len(record.sensors)))
        low = inverse_of(record, response)
        inverse[: len(low)] = low
        places = [s.station if s.station.body == body.name else None for s in record.sensors]
        for sensor, single, place in zip(record.sensors, singly, places, strict=True):
            if place is None or not body.length_m:
                continue
            (slope,) = response.slopes([place])
            exact_m = tolerances.of_sensor(sensor.name).position_m
            take(f"place of {sensor.name}", exact_m * single[:, None], slope @ motion, slope @ inverse)
        shapes = response.shapes(list(places))
        natural_hz = response.dynamics.natural_hz
        stiffer, damped = response.sensitivity("frequency"), response.sensitivity("damping")
        for m in np.flatnonzero((natural_hz > 0) & (natural_hz < BEYOND * omega[-1] / (2 * np.pi))):
            exact, shape = tolerances.of_mode(body.name, int(m) + 1), shapes[:, m : m + 1]
            take(f"frequency of {body.name} {m + 1}", shape * exact.frequency * stiffer[m], motion[m], inverse[m])
            take(f"damping of {body.name} {m + 1}", shape * exact.damping * damped[m], motion[m], inverse[m])
    size = np.linalg.norm(record.delivered)
    for one in model.free:
        for unit in one.units:
            pattern = one.shape[:, None] * size / max(np.linalg.norm(np.outer(one.shape, unit)), 1e-300)
            take(f"initial state of {model.responses[one.body].body.name} {one.mode + 1}", pattern, unit, 0 * one.shape)
    return tuple(names), np.array(columns).reshape(len(columns), *own.residual.shape), np.array(trace)


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
