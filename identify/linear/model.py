"""The linear model of one body: accelerations at some places by forces at others, and what its modes are uncertain by.

With modes of natural frequency omega_m, damping ratio zeta_m and mass-normalised shapes phi_m,

    a(x) = sum_m phi_m(x) A_m phi_m(x_F) F
    A_m = -omega^2 / D_m,   D_m = omega_m^2 - omega^2 + 2 i zeta_m omega_m omega
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float

from identify.linear.modal import receptance
from identify.signals.kinematics import CORNER_HZ, integrated
from rig.errors import RigError
from rig.model.description import Body, Rig, Station
from rig.model.modes import Modes, modes_of

SLOPE = 1e-4
"""Slopes of shapes are differences over this share of the body's length to either side."""
RANK = 1e-9
"""A mode that moves a contact by a smaller share of the largest does not move it."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Modes on the lines of a record; one object for the same modes, so that products of theirs are kept.

    The springs of those that are high_passed act on the high-passed displacement alone.
    """

    natural_hz: Float[np.ndarray, " modes"]
    damping_ratios: Float[np.ndarray, " modes"]
    omega: Float[np.ndarray, " lines"]
    high_passed: tuple[int, ...]

    def with_high_passed(self, modes: tuple[int, ...]) -> "Dynamics":
        return _dynamics(self.natural_hz.tobytes(), self.damping_ratios.tobytes(), self.omega.tobytes(), modes)


@dataclass(frozen=True)
class Response:
    """One body's modes, and their accelerations per modal force."""

    body: Body
    modes: Modes
    count: int
    dynamics: Dynamics

    @property
    def accelerance(self) -> Complex[np.ndarray, "modes lines"]:
        return _accelerance(self.dynamics)

    def shapes(self, stations: Sequence[Station | None]) -> Float[np.ndarray, "stations modes"]:
        """Zero at stations of other bodies and at the ground."""
        found = np.zeros((len(stations), self.count))
        own = [(i, s.position_m) for i, s in enumerate(stations) if s is not None and s.body == self.body.name]
        if own:
            rows, places = zip(*own, strict=True)
            found[list(rows)] = self.modes.shapes(np.array(places), self.count)
        return found

    def slopes(self, stations: Sequence[Station]) -> Float[np.ndarray, "stations modes"]:
        """The shapes' derivatives along the body, 1/m, at stations on it; zero of a single mass."""
        places, length = np.array([s.position_m for s in stations]), self.body.length_m
        if not length:
            return np.zeros((len(stations), self.count))
        step = SLOPE * length
        right, left = np.minimum(places + step, length), np.maximum(places - step, 0.0)
        beside = [self.modes.shapes(at, self.count) for at in (right, left)]
        return np.asarray((beside[0] - beside[1]) / (right - left)[:, None])

    def sensitivity(
        self, kind: Literal["frequency", "damping"], modes: slice = slice(None)
    ) -> Complex[np.ndarray, "modes lines"]:
        """The relative change of each mode's acceleration by that of its frequency, or of its damping: -dD / D.

        An error dD changes a mode's acceleration by -dD / D of what it truly is: of what was measured.
        """
        hz, zeta, omega = self.dynamics.natural_hz[modes], self.dynamics.damping_ratios[modes], self.dynamics.omega
        natural = 2 * np.pi * hz[:, None]
        changed = -2j * zeta[:, None] * natural * omega
        if kind == "frequency":
            changed -= 2 * natural**2
        changed *= receptance(hz, zeta, omega / (2 * np.pi))
        return changed

    def transfer(
        self, outputs: Float[np.ndarray, "outputs modes"], inputs: Float[np.ndarray, "inputs modes"]
    ) -> Complex[np.ndarray, "inputs outputs lines"]:
        """Accelerations along some shapes per force along others: sum over the modes of output, accelerance and input.

        Kept, as most effects change one body at most.
        """
        return _transfer(self.dynamics, outputs.tobytes(), inputs.tobytes())


def response_of(rig: Rig, body: Body, omega: Float[np.ndarray, " lines"]) -> Response:
    """Of a body with what the rig attaches to it."""
    modes, count = modes_of(rig, body), body.max_modes
    natural_hz, zeta = modes.frequencies_hz(count), modes.damping_ratios(count)
    return Response(body, modes, count, _dynamics(natural_hz.tobytes(), zeta.tobytes(), omega.tobytes(), ()))


@lru_cache(maxsize=16)
def _dynamics(
    natural_hz: bytes, damping_ratios: bytes, omega_rad_per_s: bytes, high_passed: tuple[int, ...]
) -> Dynamics:
    """Of the modes whose doubles are given."""
    hz, zeta, omega = (np.frombuffer(values) for values in (natural_hz, damping_ratios, omega_rad_per_s))
    return Dynamics(hz, zeta, omega, high_passed)


@lru_cache(maxsize=4)
def _accelerance(modes: Dynamics) -> Complex[np.ndarray, "modes lines"]:
    hz, zeta, omega = modes.natural_hz, modes.damping_ratios, modes.omega
    found = -(omega**2) * receptance(hz, zeta, omega / (2 * np.pi))
    for mode in modes.high_passed:
        natural = 2 * np.pi * hz[mode]
        held = natural**2 * integrated(omega, -2, CORNER_HZ)
        found[mode] = 1 / (1 + held + 2 * zeta[mode] * natural * integrated(omega, -1, CORNER_HZ))
    found[hz == 0] = 1.0
    found.flags.writeable = False
    return found


@lru_cache(maxsize=8)
def _transfer(dynamics: Dynamics, outputs: bytes, inputs: bytes) -> Complex[np.ndarray, "inputs outputs lines"]:
    accelerance = _accelerance(dynamics)
    modes, lines = accelerance.shape
    to, by = (np.frombuffer(shapes).reshape(-1, modes) for shapes in (outputs, inputs))
    found = times((by[:, None, :] * to[None]).reshape(-1, modes), accelerance)
    found.flags.writeable = False
    return found.reshape(len(by), len(to), lines)


def forget() -> None:
    """Frees what is kept of a record that is done with."""
    for kept in (_transfer, _accelerance, _dynamics):
        kept.cache_clear()


def across(rig: Rig, response: Response) -> Float[np.ndarray, "contacts modes"]:
    """How a body's modes enter the relative displacements."""
    return response.shapes([c.at for c in rig.contacts]) - response.shapes([c.against for c in rig.contacts])


def weights_of(
    response: Response, places: list[Station | None], stations: list[Station | None]
) -> Float[np.ndarray, "stations sensors"]:
    """From the body's sensors to other places on it, by as many of its modes as it has sensors."""
    rows = [i for i, place in enumerate(places) if place is not None and place.body == response.body.name]
    weights = np.zeros((len(stations), len(places)))
    if rows:
        modes = min(len(rows), response.count)
        inverse = np.linalg.pinv(response.shapes([places[i] for i in rows])[:, :modes])
        weights[:, rows] = response.shapes(stations)[:, :modes] @ inverse
    return weights


def times(
    real: Float[np.ndarray, "rows inner"], spectra: Complex[np.ndarray, "inner lines"]
) -> Complex[np.ndarray, "rows lines"]:
    """The product, without taking the real factor as complex: twice as fast."""
    return np.asarray((real @ np.ascontiguousarray(spectra).view(spectra.real.dtype)).view(complex))


def responses_of(rig: Rig, omega: Float[np.ndarray, " lines"], zero_known: bool) -> tuple[Response, ...]:
    """Of every body. Where no sensor shows the zero of displacements, the springs of some modes act on the high-passed
    displacement alone.

    Only modes that are then free tell a constant contact force from accelerations. So these are the modes that would be
    rigid but for attached springs, the mode of a single mass, and further the lowest that move the contacts, until
    every contact force is told.

    Raises RigError if no number of modes tells every contact force.
    """
    found = tuple(response_of(rig, body, omega) for body in rig.bodies)
    over = np.concatenate([across(rig, r) for r in found], axis=1)
    own = [(k, m) for k, r in enumerate(found) for m in range(r.count)]
    least = RANK * float(np.max(np.abs(over), initial=0.0))

    def told(modes: list[int]) -> int:
        return int(np.linalg.matrix_rank(over[:, modes], least)) if modes else 0

    if told(list(range(len(own)))) < len(rig.contacts):
        raise RigError(
            f"the {len(rig.contacts)} contacts of rig {rig.name!r} move by fewer independent modes; describe more "
            "modes, or fewer contacts"
        )
    if zero_known:
        return found
    chosen = [i for i, (k, m) in enumerate(own) if m < max(found[k].body.rigid_modes, found[k].body.is_mass)]
    for i in sorted(range(len(own)), key=lambda i: found[own[i][0]].dynamics.natural_hz[own[i][1]]):
        if told(chosen) < len(rig.contacts) and told([*chosen, i]) > told(chosen):
            chosen.append(i)
    loose = [tuple(sorted(own[i][1] for i in chosen if own[i][0] == k)) for k in range(len(found))]
    return tuple(replace(r, dynamics=r.dynamics.with_high_passed(m)) for r, m in zip(found, loose, strict=True))


def slow_damping(
    rig: Rig, responses: tuple[Response, ...], slow_n_per_m: Float[np.ndarray, "contacts contacts"]
) -> Float[np.ndarray, "contacts contacts"]:
    """The contact forces (N s) per slow relative velocity (m/s): K M K, M = sum of phi phi' 2 zeta / omega^3."""
    over = np.concatenate([across(rig, r) for r in responses], axis=1)
    omega = 2 * np.pi * np.concatenate([r.dynamics.natural_hz for r in responses])
    zeta = np.concatenate([r.dynamics.damping_ratios for r in responses])
    held, rate = over[:, omega > 0], 2 * zeta[omega > 0] / omega[omega > 0] ** 3
    return np.asarray(slow_n_per_m @ (held * rate) @ held.T @ slow_n_per_m)


def slow_stiffness(rig: Rig, responses: tuple[Response, ...]) -> Float[np.ndarray, "contacts contacts"]:
    """The contact forces (N) that slow relative displacements (m) take, where springs act on the high-passed ones.

    With C the sum of phi phi' / omega^2 over the modes that are held, and N the combinations of contacts which no free
    mode moves, K = N (N' C N)^-1 N'. Zero where no mode's spring acts on the high-passed displacement.
    """
    over = np.concatenate([across(rig, r) for r in responses], axis=1)
    omega = 2 * np.pi * np.concatenate([r.dynamics.natural_hz for r in responses])
    combined, sizes, _ = np.linalg.svd(over[:, omega == 0])
    still = combined[:, np.count_nonzero(sizes > RANK * np.max(np.abs(over), initial=0.0)) :]
    if not (still.size and any(np.any(r.dynamics.natural_hz[list(r.dynamics.high_passed)]) for r in responses)):
        return np.zeros((len(over), len(over)))
    held = over[:, omega > 0]
    compliance = still.T @ (held / omega[omega > 0] ** 2) @ held.T @ still
    return np.asarray(still @ np.linalg.pinv(compliance, rcond=1e-12, hermitian=True) @ still.T)
