"""Responses and ground forces under the record's window: known forces on held bodies, cubic springs and dampers.

With the window w(t), the force F(t) and the impulse response h(t), a held body rings on where w falls, so that
h * (w F) differs from w (h * F), and weights by frequency spread the difference over seconds before the end of the
record. For a rig without contacts the response is therefore windowed, w (h * F), not the force. Forces of springs and
dampers to the ground are laws of the measured motion itself: they are evaluated on w x / w and windowed afterwards.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft, rfft

from identify.gaps.residual.extent import is_free
from identify.gaps.residual.record import Record
from identify.linear.model import Response, times, weights_of
from identify.signals.kinematics import integrated
from identify.signals.law_evaluation import oversampling
from rig.model.description import PointDamper, PointMass, PointSpring, Rig, Station

LEAST_WINDOW = 1e-2
"""Window below which signals are not restored from windowed ones."""

Spectrum = Complex[np.ndarray, " lines"]
Motions = Complex[np.ndarray, "sensors lines"]


def response_to_force(
    record: Record, rig: Rig, per_newton: Complex[np.ndarray, "sensors lines"], force_n: Complex[np.ndarray, " lines"]
) -> Complex[np.ndarray, "sensors lines"]:
    """Accelerations at the sensors by a windowed force."""
    by_window = per_newton * force_n
    rings_on = np.array([_rings_on(record, rig, s.station.body) for s in record.sensors])
    if not rings_on.any():
        return by_window
    orders = [s.measures.order for s in record.sensors]
    return np.where(
        rings_on[:, None], _windowed(record, per_newton * _unwindowed_force(record, force_n), orders), by_window
    )


def modal_response(
    record: Record, rig: Rig, response: Response, modal_force: Complex[np.ndarray, "modes lines"]
) -> Complex[np.ndarray, "modes lines"]:
    """Modal accelerations of a body by windowed forces, consistent with `response_to_force` at its sensors."""
    if not _rings_on(record, rig, response.body.name):
        return response.accelerance * modal_force
    order = next((s.measures.order for s in record.sensors if s.station.body == response.body.name), 2)
    accelerations = response.accelerance * _unwindowed_force(record, modal_force)
    return _windowed(record, accelerations, [order] * len(accelerations))


def _rings_on(record: Record, rig: Rig, body: str) -> bool:
    """True for a held body in a record whose responses are windowed."""
    return record.windows_responses and not is_free(rig, body)


def _unwindowed_force(record: Record, force: Complex[np.ndarray, "*rows lines"]) -> Complex[np.ndarray, "*rows lines"]:
    """Force up to the record's end from the windowed one, F(t) = (w F)(t) / w(t) where w > LEAST_WINDOW."""
    fall = _window_fall(record)
    windowed = irfft(force, fall.size)
    return np.asarray(rfft(np.divide(windowed, fall, out=np.zeros_like(windowed), where=fall > LEAST_WINDOW)))


def _windowed(
    record: Record, accelerations: Complex[np.ndarray, "rows lines"], orders: Sequence[int]
) -> Complex[np.ndarray, "rows lines"]:
    """Windowed accelerations: signals w(t) y(t) of the given derivatives, differentiated to accelerations."""
    fall = _window_fall(record)
    integration = np.stack([integrated(record.omega, 2 - order, 0.0) for order in orders])
    return np.asarray(rfft(irfft(accelerations / integration, fall.size) * fall) * integration)


def _window_fall(record: Record) -> Float[np.ndarray, " times"]:
    """Falling half of the window over the padded record at `rate_hz`, one before it."""
    window = record.window[:: record.factor]
    fall = np.zeros(record.length // record.factor)
    fall[: window.size] = np.where(np.arange(window.size) < window.size // 2, 1.0, window)
    return fall


def ground_forces(
    record: Record,
    rig: Rig,
    responses: tuple[Response, ...],
    sensor_stations: list[Station | None],
    displacements: Motions,
) -> list[tuple[Station, Spectrum]]:
    """Windowed forces of ground springs and dampers, -k3 x^3 and -c v - F tanh(v / v0), each with its station."""
    springs, dampers = _cubic_springs(rig), rig.dampers
    spring_displacements = displaced_at(responses, sensor_stations, springs, displacements)
    damper_motions = displaced_at(responses, sensor_stations, dampers, _velocities(record, displacements))
    forces = []
    for spring, displacement in zip(springs, spring_displacements, strict=True):
        (fine,), window = _oversampled(record, 3, displacement)
        forces.append((spring.station, -_spectrum_on_lines(record, window * spring.law.force_n(fine / window))))
    for damper, velocity in zip(dampers, damper_motions, strict=True):
        if damper.friction_n:
            (fine,), window = _oversampled(record, _oversampling_factor(record), velocity)
            force_n = window * damper.law.force_n(np.zeros_like(fine), fine / window)
            forces.append((damper.station, -_spectrum_on_lines(record, force_n)))
        else:
            forces.append((damper.station, -damper.damping_n_s_per_m * velocity))
    return forces


def ground_force_changes(
    record: Record,
    rig: Rig,
    responses: tuple[Response, ...],
    sensor_stations: list[Station | None],
    displacements: Motions,
    changes: Motions,
) -> list[tuple[Station, Spectrum]]:
    """Directional derivative of each of the `ground_forces` along a change of the displacements."""
    springs, dampers = _cubic_springs(rig), rig.dampers
    spring_displacements = [displaced_at(responses, sensor_stations, springs, d) for d in (displacements, changes)]
    velocities = _velocities(record, displacements), 1j * record.omega * changes
    damper_motions = [displaced_at(responses, sensor_stations, dampers, v) for v in velocities]
    force_changes = []
    for spring, displacement, displacement_change in zip(springs, *spring_displacements, strict=True):
        (fine, change), window = _oversampled(record, 3, displacement, displacement_change)
        force_changes.append(
            (spring.station, -_spectrum_on_lines(record, spring.law.by_eta_n_per_m(fine / window) * change))
        )
    for damper, velocity, change in zip(dampers, *damper_motions, strict=True):
        if damper.friction_n:
            (fine, fine_change), window = _oversampled(record, _oversampling_factor(record), velocity, change)
            steepness = damper.law.by_rate_n_s_per_m(np.zeros_like(fine), fine / window)
            force_changes.append((damper.station, -_spectrum_on_lines(record, steepness * fine_change)))
        else:
            force_changes.append((damper.station, -damper.damping_n_s_per_m * change))
    return force_changes


def has_ground_forces(rig: Rig) -> bool:
    """True if a rig has forces to the ground that follow from the measured motion."""
    return bool(_cubic_springs(rig) or rig.dampers)


def needs_every_line(rig: Rig) -> bool:
    """True if forces to the ground are nonlinear, so that they cannot be computed from a selection of lines."""
    return bool(_cubic_springs(rig)) or any(d.friction_n for d in rig.dampers)


def _cubic_springs(rig: Rig) -> list[PointSpring]:
    return [s for s in rig.springs if s.cubic_n_per_m3]


def displaced_at(
    responses: tuple[Response, ...],
    sensor_stations: list[Station | None],
    elements: Sequence[PointSpring | PointDamper | PointMass],
    displacements: Motions,
) -> Complex[np.ndarray, "attached lines"]:
    """Displacements (or accelerations) at attached elements from those at the sensors."""
    stations: list[Station | None] = [element.station for element in elements]
    return times(np.sum([weights_of(r, sensor_stations, stations) for r in responses], axis=0), displacements)


def _oversampling_factor(record: Record) -> int:
    """Multiple of the record's rate that resolves a friction force."""
    return max(3, oversampling(record.rate_hz))


def _velocities(record: Record, displacements: Motions) -> Motions:
    """Windowed velocities at the sensors: derivatives of windowed displacements, corrected by `Record.faded`."""
    return 1j * record.omega * displacements + record.faded


def _oversampled(
    record: Record, factor: int, *spectra: Spectrum
) -> tuple[list[Float[np.ndarray, " fine"]], Float[np.ndarray, " fine"]]:
    """Signals over the padded record at a multiple of its rate, and their window, bounded below by LEAST_WINDOW."""
    length = record.length // record.factor
    time = np.arange(factor * length) * (record.factor / factor)
    window = np.interp(time, np.arange(record.samples), record.window, right=0.0)
    return [factor * np.fft.irfft(s / record.factor, factor * length) for s in spectra], np.maximum(
        window, LEAST_WINDOW
    )


def _spectrum_on_lines(record: Record, fine: Float[np.ndarray, " fine"]) -> Spectrum:
    """Spectrum of an oversampled signal on the record's lines, without aliasing."""
    length = record.length // record.factor
    return np.asarray(np.fft.rfft(fine)[: length // 2 + 1] * record.factor * length / fine.size)
