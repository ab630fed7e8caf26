"""The linear part of a rig against a record: what no contact force explains, and the contact forces that explain most.

At every line the accelerations of all sensors are, by the rig's description,

    A = G_F F + G_T T - G_K (k3 w^3 + c v + F_c tanh(v / v0)) - G_C f + G_B a_base + error

with the accelerances G at the sensors of the force F, of tones T, of cubic springs and dampers to the ground (by the
measured motion w, v at their places), of contact forces f, and of a base that shakes unmeasured. Static loads
accelerate nothing: the contacts hold them. The f are found by least squares, without a contact
law; so is a_base, held by its spectrum. What they leave, in standard deviations of the error, is the linear residual:
sensors less contacts tell it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Complex, Float

from identify.gap.grounded import ground_force_changes, ground_forces
from identify.gap.response import Response, times, weights_of
from identify.gap.spectra import Record
from identify.kinematics import CORNER_HZ, integrated
from identify.modal import receptance
from rig.description import Body, Rig, Station
from rig.modes import modes_of, participation
from rig.oscillator import Oscillator


@dataclass(frozen=True)
class Linear:
    """A rig's linear model laid against a record.

    chain is what each sensor makes of an acceleration. residual is in standard deviations; where the base shakes, a
    last row holds its acceleration in those of its own spectrum, and log_determinant is what that freedom costs. eta_m
    lacks the slow part that integration loses. modal are the accelerations of each body's modes, by_force those
    that the measured force alone makes at the sensors, holding_n the constant contact forces under static loads.
    """

    rig: Rig
    responses: tuple[Response, ...]
    chain: Complex[np.ndarray, "sensors lines"]
    spread: Float[np.ndarray, "sensors lines"]
    unknown: Complex[np.ndarray, "lines sensors inputs"]
    solve: Complex[np.ndarray, "lines inputs sensors"]
    residual: Complex[np.ndarray, "rows lines"]
    contact_n: Complex[np.ndarray, "contacts lines"]
    eta_m: Complex[np.ndarray, "contacts lines"]
    modal: tuple[Complex[np.ndarray, "modes lines"], ...]
    by_force: Complex[np.ndarray, "sensors lines"]
    holding_n: Float[np.ndarray, " contacts"]
    log_determinant: float

    def projected(
        self, change: Complex[np.ndarray, "sensors lines"]
    ) -> tuple[Complex[np.ndarray, "rows lines"], Complex[np.ndarray, "contacts lines"]]:
        """The residual and the contact forces that something delivered beside what is known makes."""
        return _split(self.unknown, self.solve, change / self.spread, len(self.rig.contacts))

    def projected_many(
        self, changes: Complex[np.ndarray, "many sensors lines"]
    ) -> tuple[Complex[np.ndarray, "many rows lines"], Complex[np.ndarray, "many contacts lines"]]:
        """`projected` of many at once."""
        contacts = len(self.rig.contacts)
        weighted = np.ascontiguousarray((changes / self.spread).transpose(2, 1, 0))
        inputs = self.solve @ weighted
        left = weighted - self.unknown @ inputs
        rows = np.concatenate([left, inputs[:, contacts:]], axis=1).transpose(2, 1, 0)
        return np.ascontiguousarray(rows), np.ascontiguousarray(inputs[:, :contacts].transpose(2, 1, 0))

    def open_n(self, record: Record) -> Float[np.ndarray, " contacts"]:
        """Standard deviation over time of each contact force, by the errors of the accelerations."""
        contacts = len(self.rig.contacts)
        variance = np.sum(np.abs(self.solve[:, :contacts]) ** 2, axis=2)
        return np.asarray(np.sqrt(2 * variance.sum(axis=0) / (record.length * record.samples)))


def linear_model(record: Record, rig: Rig, model_error: float | Float[np.ndarray, "sensors lines"]) -> Linear:
    """The linear residual of a rig that has the record's sensors and contacts, whatever else it has.

    model_error is the share of each acceleration that no model of this kind explains. The noise of the measured force
    is a further unknown input, with a prior of its own size.
    """
    omega, chain = record.omega, chain_of(record, rig)
    displacements = record.displaced / chain
    responses = tuple(_response(record, rig, body) for body in rig.bodies)
    named = {s.name: s for s in rig.sensors}
    places: list[Station | None] = [named[s.name].station for s in record.sensors]
    held = ground_forces(record, rig, responses, places, displacements)
    forces = [record.force * np.exp(-1j * omega * rig.force_sensor.lag_s) / rig.force_sensor.gain]
    forces += [record.spectrum(tone.force_n(record.sample_times_s)) for tone in rig.tones]
    forces += [force_n for _, force_n in held]
    pushed: list[Station | None] = [rig.force_at, *(tone.station for tone in rig.tones), *(at for at, _ in held)]
    drives = [times(r.shapes(pushed).T, np.stack(forces)) for r in responses]
    ends: list[list[Station | None]] = [[c.at for c in rig.contacts], [c.against for c in rig.contacts]]
    across = [r.shapes(ends[0]) - r.shapes(ends[1]) for r in responses]
    at = [r.shapes(places) for r in responses]
    driven = [r.accelerance * d for r, d in zip(responses, drives, strict=True)]
    known = times(np.concatenate(at, axis=1), np.concatenate(driven))
    spread = np.sqrt(record.noise + model_error**2 * record.power)
    spread = np.maximum(spread, 1e-9 * spread.max())
    sensed = (chain / spread).T
    unknown = -_accelerances(responses, at, across) * sensed[:, :, None]
    if rig.base_motion is not None:
        unknown = np.concatenate(
            [unknown, _base(record, rig, responses, at).T[:, :, None] * sensed[:, :, None]], axis=2
        )
    exciting = [r.accelerance * r.shapes([rig.force_at]).T for r in responses]
    per_newton = times(np.concatenate(at, axis=1), np.concatenate(exciting))
    if record.force_noise:
        heard = np.sqrt(record.force_noise) / rig.force_sensor.gain * per_newton
        unknown = np.concatenate([unknown, heard.T[:, :, None] * sensed[:, :, None]], axis=2)
    contacts = len(rig.contacts)
    solve, log_determinant = _least_squares(unknown, contacts)
    residual, contact_n = _split(unknown, solve, record.delivered / spread - known * sensed.T, contacts)
    modal = tuple(d - r.accelerance * times(c.T, contact_n) for r, d, c in zip(responses, driven, across, strict=True))
    eta = np.zeros((contacts, omega.size), dtype=complex)
    high_passed = integrated(omega, -2, CORNER_HZ)
    for response, own, over, motion in zip(responses, at, across, modal, strict=True):
        weights = weights_of(response, places, ends[0]) - weights_of(response, places, ends[1])
        eta += times(weights, displacements) + times(over - weights @ own, motion) * high_passed
    holding_n = _holding(rig, responses, across)
    return Linear(
        rig=rig,
        responses=responses,
        chain=chain,
        spread=spread,
        unknown=unknown,
        solve=solve,
        residual=residual,
        contact_n=contact_n,
        eta_m=eta,
        modal=modal,
        by_force=per_newton * forces[0],
        holding_n=holding_n,
        log_determinant=log_determinant,
    )


def chain_of(record: Record, rig: Rig) -> Complex[np.ndarray, "sensors lines"]:
    """What each sensor makes of an acceleration: its gain and delay."""
    named, omega = {s.name: s for s in rig.sensors}, record.omega
    return np.stack(
        [
            s.gain * (np.exp(-1j * omega * s.delay_s) if s.delay_s else np.ones(omega.size, dtype=complex))
            for s in (named[sensor.name] for sensor in record.sensors)
        ]
    )


def _response(record: Record, rig: Rig, body: Body) -> Response:
    """Of a mass with accelerometers alone, its spring acts on the high-passed displacement only."""
    modes, count = modes_of(rig, body), body.most_modes
    natural_hz, zeta = modes.frequencies_hz(count), modes.damping_ratios(count)
    high_passed = isinstance(body, Oscillator) and not record.zero_known
    accelerance = _accelerance(natural_hz.tobytes(), zeta.tobytes(), record.omega.tobytes(), high_passed)
    return Response(body, modes, count, accelerance)


@lru_cache(maxsize=16)
def _accelerance(
    natural_hz: bytes, damping_ratios: bytes, omega_rad_per_s: bytes, high_passed: bool
) -> Complex[np.ndarray, "modes lines"]:
    """Of the modes whose doubles are given; most candidates change those of one body at most."""
    hz, zeta, omega = (np.frombuffer(values) for values in (natural_hz, damping_ratios, omega_rad_per_s))
    if high_passed:
        natural = 2 * np.pi * hz[:, None]
        held = natural**2 * integrated(omega, -2, CORNER_HZ)
        found = 1 / (1 + held + 2 * zeta[:, None] * natural * integrated(omega, -1, CORNER_HZ))
    else:
        found = -(omega**2) * receptance(hz, zeta, omega / (2 * np.pi))
    found[hz == 0] = 1.0
    found.flags.writeable = False
    return found


def _accelerances(
    responses: tuple[Response, ...],
    at: list[Float[np.ndarray, "sensors modes"]],
    across: list[Float[np.ndarray, "contacts modes"]],
) -> Complex[np.ndarray, "lines sensors contacts"]:
    products = [(s[:, None, :] * c[None]).reshape(-1, s.shape[1]) for s, c in zip(at, across, strict=True)]
    found = times(np.concatenate(products, axis=1), np.concatenate([r.accelerance for r in responses]))
    return found.T.reshape(found.shape[1], len(at[0]), len(across[0]))


def _holding(
    rig: Rig, responses: tuple[Response, ...], across: list[Float[np.ndarray, "contacts modes"]]
) -> Float[np.ndarray, " contacts"]:
    """The constant contact forces that hold static loads: of what floats by its balance, of a single mass the load."""
    held = np.zeros(len(rig.contacts))
    for response, contacts in zip(responses, across, strict=True):
        free = response.modes.frequencies_hz(response.count) == 0
        if isinstance(response.body, Oscillator):
            free[:] = True
        push = np.sum([x.force_n * response.shapes([x.station])[0] for x in rig.loads] or [np.zeros(free.size)], axis=0)
        if np.any(push[free]):
            held += np.linalg.lstsq(contacts[:, free].T, push[free], rcond=None)[0]
    return held


def bent(
    record: Record, model: Linear, displaced: Complex[np.ndarray, "sensors lines"]
) -> Complex[np.ndarray, "sensors lines"]:
    """What the sensors give beside, as springs and dampers to the ground are displaced less than the sensors say."""
    found = np.zeros(displaced.shape, dtype=complex)
    places: list[Station | None] = [s.station for s in record.sensors]
    less = ground_force_changes(record, model.rig, model.responses, places, record.displaced / model.chain, displaced)
    for station, force_n in less:
        for r in model.responses:
            shape = r.shapes([station])[0]
            found -= model.chain * times(r.shapes(places) * shape, r.accelerance * force_n)
    return found


def _base(
    record: Record, rig: Rig, responses: tuple[Response, ...], at: list[Float[np.ndarray, "sensors modes"]]
) -> Complex[np.ndarray, "sensors lines"]:
    """Accelerations by a base motion of one standard deviation a line: a mode feels the base as an inertial load."""
    base = rig.base_motion
    assert base is not None
    follows = np.ones((len(at[0]), record.omega.size), dtype=complex)
    for response, sensors in zip(responses, at, strict=True):
        load = participation(rig, response.body, response.modes, response.count)
        follows -= sensors @ (response.accelerance * load[:, None])
    hz = record.omega / (2 * np.pi)
    density = base.acceleration_rms_m_per_s2**2 / (base.high_hz - base.low_hz)
    size = np.sqrt(density * record.samples * record.sample_rate_hz / 2)
    return np.asarray(follows * size * ((hz >= base.low_hz) & (hz <= base.high_hz)))


def _least_squares(
    unknown: Complex[np.ndarray, "lines sensors inputs"], contacts: int
) -> tuple[Complex[np.ndarray, "lines inputs sensors"], float]:
    """The inputs from the weighted accelerations, line by line; those behind the contacts with a prior of one.

    The logarithm is that of the determinant by which such inputs widen the residual's distribution.
    """
    adjoint = unknown.conj().transpose(0, 2, 1)
    normal = adjoint @ unknown
    inputs = normal.shape[1]
    size = np.einsum("lii->li", normal).real
    normal = normal + np.eye(inputs) * (1e-10 * size + 1e-300)[:, None, :]
    if inputs == contacts:
        return np.linalg.solve(normal, adjoint), 0.0
    free = np.linalg.slogdet(normal[:, :contacts, :contacts])[1] if contacts else 0.0
    normal[:, range(contacts, inputs), range(contacts, inputs)] += 1.0
    return np.linalg.solve(normal, adjoint), float(np.sum(np.linalg.slogdet(normal)[1] - free))


def _split(
    unknown: Complex[np.ndarray, "lines sensors inputs"],
    solve: Complex[np.ndarray, "lines inputs sensors"],
    weighted: Complex[np.ndarray, "sensors lines"],
    contacts: int,
) -> tuple[Complex[np.ndarray, "rows lines"], Complex[np.ndarray, "contacts lines"]]:
    inputs = solve @ weighted.T[:, :, None]
    left = weighted - (unknown @ inputs)[:, :, 0].T
    return np.concatenate([left, inputs[:, contacts:, 0].T]), inputs[:, :contacts, 0].T
