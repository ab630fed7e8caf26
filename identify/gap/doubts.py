"""What a laboratory never knows exactly (gains, positions, frequencies, damping), as columns of the residual."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace

from identify.gap.linear import Linear, bent
from identify.gap.spectra import Record
from identify.kinematics import CORNER_HZ, integrated
from identify.modal import receptance
from identify.tolerances import Tolerances
from rig.description import Body, Contact, Rig
from rig.oscillator import Oscillator

LIMIT = 6.0
"""No doubt goes further than so many of its standard deviations: beyond, something else is wrong."""
BEYOND = 1.3
"""Modes up to this multiple of the highest frequency are in doubt, each by itself, ..."""
SINGLY = 0.5
"""... by this share of what is in doubt of all modes of a body together."""


@dataclass(frozen=True)
class Doubts:
    """Derivatives of the linear residual, the contact forces and the relative displacements, each by one tolerance."""

    names: tuple[str, ...]
    residual: Float[np.ndarray, "doubts rows times"]
    contact_n: Float[np.ndarray, "doubts contacts times"]
    eta_m: Float[np.ndarray, "doubts contacts times"]


def doubts_of(record: Record, model: Linear, tolerances: Tolerances) -> Doubts:
    """One column for each gain and position; for frequency and damping of each body, and of each mode in the band."""
    names: list[str] = []
    changes: list[Complex[np.ndarray, "sensors lines"]] = []
    moved: list[Complex[np.ndarray, "sensors lines"] | None] = []
    omega = record.omega
    twice = integrated(omega, -2, CORNER_HZ)
    index = np.arange(len(record.sensors))[:, None]
    explained = record.delivered - model.residual[: len(record.sensors)] * model.spread
    for i, sensor in enumerate(record.sensors):
        own = index == i
        names.append(f"gain of {sensor.name}")
        changes.append(tolerances.gain * explained * own)
        moved.append(tolerances.gain * record.displaced / model.chain * own)
    for response, motion in zip(model.responses, model.modal, strict=True):
        body = response.body
        rows = [i for i, s in enumerate(record.sensors) if s.station.body == body.name]
        places = np.array([record.sensors[i].station.position_m for i in rows])
        if body.length_m and rows:
            step = 1e-4 * body.length_m
            right, left = np.minimum(places + step, body.length_m), np.maximum(places - step, 0.0)
            beside = [response.modes.shapes(at, response.count) for at in (right, left)]
            slopes = (beside[0] - beside[1]) / (right - left)[:, None]
            for i, slope in zip(rows, slopes @ motion, strict=True):
                names.append(f"position of {record.sensors[i].name}")
                change = tolerances.position_m * slope * (index == i)
                changes.append(model.chain * change)
                moved.append(twice * change)
        shapes = response.shapes([s.station for s in record.sensors])
        natural_hz, zeta = response.modes.frequencies_hz(response.count), response.modes.damping_ratios(response.count)
        flexible = receptance(natural_hz, zeta, omega / (2 * np.pi)) * motion
        natural = 2 * np.pi * natural_hz[:, None]
        loss = 1j * zeta[:, None] * natural * omega
        of_each = {
            "frequency": -2 * tolerances.frequency * (natural**2 + loss) * flexible,
            "damping": -2 * tolerances.damping * loss * flexible,
        }
        flexing = np.arange(response.count) >= body.rigid_modes  # no matter which springs hold the body
        elastic = np.flatnonzero(flexing & (natural_hz < BEYOND * omega[-1] / (2 * np.pi)))
        for what, change in of_each.items():
            names.append(f"{what} of {body.name}")
            changes.append(model.chain * (shapes @ change))
            for m in elastic if not isinstance(body, Oscillator) else []:
                names.append(f"{what} of {body.name} {m + 1}")
                changes.append(SINGLY * model.chain * np.outer(shapes[:, m], change[m]))
        moved += [None] * (len(changes) - len(moved))
    residual, forces, eta = [], [], []
    scale = residual_scale(record)
    for change, displaced in zip(changes, moved, strict=True):
        left, force = model.projected(change if displaced is None else change + bent(record, model, displaced))
        residual.append(scale * record.in_time(left))
        forces.append(record.in_time(force))
        eta.append(
            np.zeros_like(forces[-1]) if displaced is None else record.in_time(_at_contacts(record, model, displaced))
        )
    return Doubts(tuple(names), np.array(residual), np.array(forces), np.array(eta))


def moved(
    rig: Rig, names: tuple[str, ...], doubts: Float[np.ndarray, " doubts"], tolerances: Tolerances
) -> tuple[Rig, Float[np.ndarray, " doubts"]]:
    """The rig with the doubts about its single masses and their sensors put into it, and those doubts, the others zero.

    Those alone bend the residual: a single mass may have been believed from a record of another level, and a resonance
    that lies off by a part of its width is no linear matter. The modes of other bodies are not moved one by one.
    """
    put = np.zeros(len(names))

    def factor(name: str, tolerance: float) -> float:
        if name not in names:
            return 1.0
        at = names.index(name)
        put[at] = doubts[at]
        return max(0.1, 1 + tolerance * float(doubts[at]))

    bodies: list[Body] = []
    for body in rig.bodies:
        if isinstance(body, Oscillator):
            natural_hz = body.frequency_hz * factor(f"frequency of {body.name}", tolerances.frequency)
            ratio = body.damping_ratio * factor(f"damping of {body.name}", tolerances.damping)
            bodies.append(replace(body, frequency_hz=natural_hz, damping_ratio=ratio))
        else:
            bodies.append(body)
    single = {b.name for b in rig.bodies if isinstance(b, Oscillator)}
    sensors = tuple(
        replace(s, gain=s.gain * factor(f"gain of {s.name}", tolerances.gain)) if s.station.body in single else s
        for s in rig.sensors
    )
    return replace(rig, bodies=tuple(bodies), sensors=sensors), put


def residual_scale(record: Record) -> float:
    """Makes the residual over time, of lines with a variance of one, have a variance of one."""
    return float(np.sqrt(record.length * record.samples / (2 * record.omega.size)))


def _at_contacts(
    record: Record, model: Linear, displaced: Complex[np.ndarray, "sensors lines"]
) -> Complex[np.ndarray, "contacts lines"]:
    """Relative displacements from the sensors at the contacts."""

    def of(contact: Contact) -> Complex[np.ndarray, " lines"]:
        found = np.zeros(displaced.shape[1], dtype=complex)
        for i, sensor in enumerate(record.sensors):
            found += displaced[i] * ((sensor.station == contact.at) * 1.0 - (sensor.station == contact.against) * 1.0)
        return found

    return np.array([of(c) for c in model.rig.contacts], dtype=complex).reshape(-1, displaced.shape[1])
