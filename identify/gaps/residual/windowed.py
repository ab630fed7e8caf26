"""Responses of a rig to forces that are known under the record's window.

With the window w(t), the force F(t) and the response h(t) to a pulse: a held body rings on where w falls, so that
h * (w F) is not w (h * F). Weights by frequency spread the difference over seconds before the end of the record. For a
rig without contacts this module therefore windows the response, w (h * F), not the force.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft, rfft

from identify.gaps.residual.extent import is_free
from identify.gaps.residual.record import Record
from identify.linear.model import Response
from identify.signals.kinematics import integrated
from rig.model.description import Rig

LEAST = 1e-2
"""Where a window is lower than this, what it hides is not looked for."""


def response_to_force(
    record: Record, rig: Rig, per_newton: Complex[np.ndarray, "sensors lines"], force_n: Complex[np.ndarray, " lines"]
) -> Complex[np.ndarray, "sensors lines"]:
    """Accelerations at the sensors under a force, which is given windowed."""
    by_window = per_newton * force_n
    rings_on = np.array([_rings_on(record, rig, s.station.body) for s in record.sensors])
    if not rings_on.any():
        return by_window
    orders = [s.measures.order for s in record.sensors]
    return np.where(rings_on[:, None], _windowed(record, per_newton * _as_it_acted(record, force_n), orders), by_window)


def modal_response(
    record: Record, rig: Rig, response: Response, modal_force: Complex[np.ndarray, "modes lines"]
) -> Complex[np.ndarray, "modes lines"]:
    """Modal accelerations of a body under windowed forces, as `response_to_force` has them at its sensors."""
    if not _rings_on(record, rig, response.body.name):
        return response.accelerance * modal_force
    order = next((s.measures.order for s in record.sensors if s.station.body == response.body.name), 2)
    accelerations = response.accelerance * _as_it_acted(record, modal_force)
    return _windowed(record, accelerations, [order] * len(accelerations))


def _rings_on(record: Record, rig: Rig, body: str) -> bool:
    """True of a held body where responses are windowed."""
    return record.windows_responses and not is_free(rig, body)


def _as_it_acted(record: Record, force: Complex[np.ndarray, "*rows lines"]) -> Complex[np.ndarray, "*rows lines"]:
    """The force up to the record's end, F(t) = (w F)(t) / w(t) where w > LEAST, of the windowed one."""
    fall = _falling_window(record)
    windowed = irfft(force, fall.size)
    return np.asarray(rfft(np.divide(windowed, fall, out=np.zeros_like(windowed), where=fall > LEAST)))


def _windowed(
    record: Record, accelerations: Complex[np.ndarray, "rows lines"], orders: Sequence[int]
) -> Complex[np.ndarray, "rows lines"]:
    """Accelerations as windowed derivatives of these orders, w(t) y(t), deliver a motion that does not fade."""
    fall = _falling_window(record)
    turned = np.stack([integrated(record.omega, 2 - order, 0.0) for order in orders])
    return np.asarray(rfft(irfft(accelerations / turned, fall.size) * fall) * turned)


def _falling_window(record: Record) -> Float[np.ndarray, " times"]:
    """The window's fall over the padded record, at `rate_hz`; one before it."""
    window = record.window[:: record.factor]
    fall = np.zeros(record.length // record.factor)
    fall[: window.size] = np.where(np.arange(window.size) < window.size // 2, 1.0, window)
    return fall
