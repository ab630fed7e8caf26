"""Linear model of a rig: accelerations at some places by forces at others, and across its contacts.

With modes of natural frequency omega_m, damping ratio zeta_m and mass-normalised shapes phi_m,

    a(x) = sum_k G(x, x_k) F_k - sum_j G_j(x) f_j,   G(x, x_k) = sum_m phi_m(x) A_m phi_m(x_k)
    A_m = -omega^2 / D_m,   D_m = omega_m^2 - omega^2 + 2 i zeta_m omega_m omega

Where the base shakes, a is relative to it, and the inertial force F = -a_base on each kilogram is one more input, with
the participation integral of mu phi_m dx in place of phi_m(x_k).

It also says on which modes springs act where accelerations do not show slow motion (`slow_stiffness` says how stiffly
they hold contacts then).
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Complex, Float

from identify.linear.modal import receptance
from identify.linear.point_dampers import DamperFeedback, damper_feedback
from identify.signals.kinematics import CORNER_HZ, omega_power
from identify.signals.recent_values import RecentValues
from rig.errors import RigError
from rig.model.description import Body, PointDamper, Rig, Sensor, Station
from rig.model.modes import Modes, modes_of, participation

SLOPE_STEP_SHARE = 1e-4
"""Step of the differences for slopes of shapes, as a share of the body's length, to either side."""
RANK_TOLERANCE = 1e-9
"""Smallest share of the largest modal displacement of a contact that counts as motion."""

Stations = Sequence[Station | None]
Place = Station | Sensor | None
"""Station, or sensor at one; None stands for the ground."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Modes on the lines of a record; one object for the same modes of one cache.

    The springs of the slowly_free_modes act on the high-passed displacement alone.
    """

    natural_hz: Float[np.ndarray, " modes"]
    damping_ratios: Float[np.ndarray, " modes"]
    omega: Float[np.ndarray, " lines"]
    slowly_free_modes: tuple[int, ...]


class ResponseCache:
    """Cache of the modal accelerances, and of the transfers between places, on the lines `omega`.

    To compare many rigs with one record, make one cache, hand it to every model and drop it with them: most rigs change
    at most one body. With `size` zero it keeps nothing, for a single model of many lines.
    """

    def __init__(self, omega: Float[np.ndarray, " lines"], size: int = 4) -> None:
        self.omega = omega
        self._dynamics = RecentValues[Dynamics](4 * size)
        self._accelerances = RecentValues[Complex[np.ndarray, "modes lines"]](size)
        self._transfers = RecentValues[Complex[np.ndarray, "inputs outputs lines"]](2 * size)

    def dynamics(
        self,
        natural_hz: Float[np.ndarray, " modes"],
        damping_ratios: Float[np.ndarray, " modes"],
        slowly_free_modes: tuple[int, ...] = (),
    ) -> Dynamics:
        key = (*natural_hz.tolist(), *damping_ratios.tolist(), slowly_free_modes)
        return self._dynamics.get(key, lambda: Dynamics(natural_hz, damping_ratios, self.omega, slowly_free_modes))

    def accelerance(self, dynamics: Dynamics) -> Complex[np.ndarray, "modes lines"]:
        return self._accelerances.get(dynamics, lambda: _accelerance(dynamics))

    def transfer(
        self, dynamics: Dynamics, outputs: Float[np.ndarray, "outputs modes"], inputs: Float[np.ndarray, "inputs modes"]
    ) -> Complex[np.ndarray, "inputs outputs lines"]:
        """Accelerations along some shapes per force along others: sum over modes of output, accelerance and input."""

        def make_transfer() -> Complex[np.ndarray, "inputs outputs lines"]:
            shape_products = (inputs[:, None, :] * outputs).reshape(-1, outputs.shape[1])
            products = real_product(shape_products, self.accelerance(dynamics))
            transfer = products.reshape(len(inputs), len(outputs), products.shape[-1])
            transfer.flags.writeable = False
            return transfer

        return self._transfers.get((dynamics, outputs.tobytes(), inputs.tobytes(), len(inputs)), make_transfer)


@dataclass(frozen=True)
class Response:
    """Modes of one body, and their accelerations per modal force."""

    body: Body
    modes: Modes
    mode_count: int
    dynamics: Dynamics
    cache: ResponseCache = field(repr=False)
    shape_cache: dict[Hashable, Float[np.ndarray, "places _"]] = field(default_factory=dict, repr=False, compare=False)
    feedback: DamperFeedback | None = None

    @property
    def accelerance(self) -> Complex[np.ndarray, "modes lines"]:
        return self.cache.accelerance(self.dynamics)

    def shapes(self, places: Sequence[Place]) -> Float[np.ndarray, "places modes"]:
        """Mode shapes at places of motion, -h phi''(x) at strain gauges; zero on other bodies and at the ground."""
        return self._array(tuple(places), lambda: self._shapes_at(places, 0.0))

    def slopes(self, places: Sequence[Station | Sensor]) -> Float[np.ndarray, "places modes"]:
        """Derivatives of `shapes` along the body, per metre, at places on it; zero for a single mass."""
        length_m = self.body.length_m
        if not length_m:
            return np.zeros((len(places), self.mode_count))
        step_m, positions_m = SLOPE_STEP_SHARE * length_m, np.array([_station_of(place).position_m for place in places])
        span_m = np.minimum(positions_m + step_m, length_m) - np.maximum(positions_m - step_m, 0.0)
        return np.asarray((self._shapes_at(places, step_m) - self._shapes_at(places, -step_m)) / span_m[:, None])

    def _shapes_at(self, places: Sequence[Place], offset_m: float) -> Float[np.ndarray, "places modes"]:
        """Rows of `shapes` with every place moved along the body, to its end at most."""
        shape_rows = np.zeros((len(places), self.mode_count))
        body_indices = [i for i, p in enumerate(places) if p is not None and _station_of(p).body == self.body.name]
        for are_gauges in (False, True):
            place_indices = [i for i in body_indices if _is_gauge(places[i]) == are_gauges]
            if not place_indices:
                continue
            positions_m = np.array([_station_of(places[i]).position_m + offset_m for i in place_indices])
            if offset_m:
                positions_m = np.clip(positions_m, 0.0, self.body.length_m)
            derivative_orders = range(3) if are_gauges else range(1)
            derivatives = [self.modes.shapes(positions_m, self.mode_count, order) for order in derivative_orders]
            shape_rows[place_indices] = derivatives[0]
            for row, i in enumerate(place_indices if are_gauges else ()):
                shape_rows[i] = _strain_row(places[i], self.body, np.array([shapes[row] for shapes in derivatives]))
        return shape_rows

    def sensor_weights(
        self, sensor_places: Sequence[Place], stations: Stations
    ) -> Float[np.ndarray, "stations sensors"]:
        """Weights from the body's sensors to other stations on it, by as many of its modes as it has sensors; none of
        strain gauges."""

        def make() -> Float[np.ndarray, "stations sensors"]:
            sensor_indices = [
                i for i, p in enumerate(sensor_places) if isinstance(p, Station) and p.body == self.body.name
            ]
            mode_count = min(len(sensor_indices), self.mode_count)
            sensor_weights = np.zeros((len(stations), len(sensor_places)))
            inverse_shapes = np.linalg.pinv(self.shapes([sensor_places[i] for i in sensor_indices])[:, :mode_count])
            sensor_weights[:, sensor_indices] = self.shapes(stations)[:, :mode_count] @ inverse_shapes
            return sensor_weights

        return self._array((tuple(sensor_places), tuple(stations)), make)

    def _array(self, key: Hashable, make: Callable[[], Float[np.ndarray, "places _"]]) -> Float[np.ndarray, "places _"]:
        """Array by a key, made once; not to be written to."""
        if key not in self.shape_cache:
            self.shape_cache[key] = make()
            self.shape_cache[key].flags.writeable = False
        return self.shape_cache[key]

    def sensitivity(self, by_frequency: bool, modes: slice = slice(None)) -> Complex[np.ndarray, "modes lines"]:
        """Relative change -dD / D of each mode's acceleration by that of its frequency, or of its damping.

        An error dD changes a mode's acceleration by -dD / D times its true, that is its measured, value.
        """
        hz, zeta, omega = self.dynamics.natural_hz[modes], self.dynamics.damping_ratios[modes], self.dynamics.omega
        natural_omega = 2 * np.pi * hz[:, None]
        relative_change = -2j * zeta[:, None] * natural_omega * omega
        if by_frequency:
            relative_change -= 2 * natural_omega**2
        relative_change *= receptance(hz, zeta, omega / (2 * np.pi))
        return relative_change

    def transfer(
        self, outputs: Float[np.ndarray, "outputs modes"], inputs: Float[np.ndarray, "inputs modes"]
    ) -> Complex[np.ndarray, "inputs outputs lines"]:
        """Accelerations along some shapes per force along others."""
        undamped = partial(self.cache.transfer, self.dynamics)
        return self.feedback.transfer(undamped, outputs, inputs) if self.feedback else undamped(outputs, inputs)

    def modal_accelerations(
        self, modal_forces: Complex[np.ndarray, "modes lines"]
    ) -> Complex[np.ndarray, "modes lines"]:
        """Accelerations of the modes by modal forces."""
        return self.with_damper_feedback(self.accelerance * modal_forces)

    def with_damper_feedback(
        self, accelerations: Complex[np.ndarray, "modes lines"]
    ) -> Complex[np.ndarray, "modes lines"]:
        """Accelerations of the modes with the dampers, from those that the same cause has without them."""
        if self.feedback is None:
            return accelerations
        return accelerations - self.accelerance * self.feedback.modal_reactions(accelerations)

    def damped_by(self, dampers: Sequence[PointDamper]) -> "Response":
        """Response with those of some dampers that stand on the body; the modes stay as they are."""
        dampers = [d for d in dampers if d.station.body == self.body.name and d.damping_n_s_per_m]
        if not dampers:
            return self
        undamped, shapes = partial(self.cache.transfer, self.dynamics), self.shapes([d.station for d in dampers])
        feedback = damper_feedback(shapes, [d.damping_n_s_per_m for d in dampers], undamped, self.cache.omega)
        return replace(self, feedback=feedback)

    def tuned(self, hz_factors: Float[np.ndarray, " modes"], zeta_factors: Float[np.ndarray, " modes"]) -> "Response":
        """Response with factors on the frequency and on the damping ratio of each mode."""
        hz, zeta = self.dynamics.natural_hz * hz_factors, self.dynamics.damping_ratios * zeta_factors
        return replace(self, dynamics=self.cache.dynamics(hz, zeta, self.dynamics.slowly_free_modes))

    def with_slowly_free_modes(self, mode_indices: tuple[int, ...]) -> "Response":
        """Response in which the springs of these modes act on the high-passed displacement alone."""
        hz, zeta = self.dynamics.natural_hz, self.dynamics.damping_ratios
        return replace(self, dynamics=self.cache.dynamics(hz, zeta, mode_indices))


def _station_of(place: Place) -> Station:
    station = place.station if isinstance(place, Sensor) else place
    assert station is not None
    return station


def _is_gauge(place: Place) -> bool:
    """True of a sensor that shows no motion but the bending of its body."""
    return isinstance(place, Sensor) and not place.measures.translates


def _strain_row(gauge: Place, body: Body, derivatives: Float[np.ndarray, "3 modes"]) -> Float[np.ndarray, " modes"]:
    """Strain per unit of every modal coordinate, from the shapes, slopes and curvatures at the gauge's place."""
    assert isinstance(gauge, Sensor)
    return gauge.measures.operator(derivatives, gauge.fibre_m or body.half_thickness_m or 0.0)


def response_of(rig: Rig, body: Body, cache: ResponseCache) -> Response:
    """Response of a body with what the rig attaches to it."""
    modes, mode_count = modes_of(rig, body), body.max_modes
    dynamics = cache.dynamics(modes.frequencies_hz(mode_count), modes.damping_ratios(mode_count))
    return Response(body, modes, mode_count, dynamics, cache)


def _accelerance(dynamics: Dynamics) -> Complex[np.ndarray, "modes lines"]:
    """Accelerance A_m of each mode."""
    hz, zeta, omega = dynamics.natural_hz, dynamics.damping_ratios, dynamics.omega
    accelerance = -(omega**2) * receptance(hz, zeta, omega / (2 * np.pi))
    for mode in dynamics.slowly_free_modes:
        natural_omega = 2 * np.pi * hz[mode]
        spring_term = natural_omega**2 * omega_power(omega, -2, CORNER_HZ)
        accelerance[mode] = 1 / (1 + spring_term + 2 * zeta[mode] * natural_omega * omega_power(omega, -1, CORNER_HZ))
    accelerance[hz == 0] = 1.0
    accelerance.flags.writeable = False
    return accelerance


def accelerances(
    rig: Rig, responses: Sequence[Response], force_stations: Sequence[Station], places: Sequence[Place]
) -> Complex[np.ndarray, "inputs places lines"]:
    """Accelerations at some places (at strain gauges the second derivative of the strain) per newton of each force,
    then of each contact force f_j (-G_j)."""
    line_count = responses[0].cache.omega.size
    accelerance = np.zeros((len(force_stations) + len(rig.contacts), len(places), line_count), dtype=complex)
    for response in responses:
        place_indices = [i for i, p in enumerate(places) if p is not None and _station_of(p).body == response.body.name]
        drive_shapes = input_shapes(rig, response, force_stations)
        input_indices = np.flatnonzero(np.any(drive_shapes, axis=1))
        if place_indices and input_indices.size:
            shapes = response.shapes([places[row] for row in place_indices])
            accelerance[input_indices[:, None], place_indices] = response.transfer(shapes, drive_shapes[input_indices])
    return accelerance


def input_shapes(rig: Rig, response: Response, force_stations: Sequence[Station]) -> Float[np.ndarray, "inputs modes"]:
    """Mode shapes through which forces at some places, and contact forces, drive a body; the participation of its modes
    in a force on the ground, which is the inertial force on each kilogram."""
    force_shapes = response.shapes([*force_stations]).copy()
    for row, station in zip(force_shapes, force_stations, strict=True):
        if rig.is_on_ground(station):
            row[:] = participation(rig, response.body, response.modes, response.mode_count)
    return np.concatenate([force_shapes, -relative_shapes(rig, response)])


def relative_shapes(rig: Rig, response: Response) -> Float[np.ndarray, "contacts modes"]:
    """Mode shapes of a body in the relative displacements of the contacts."""
    return response.shapes([c.at for c in rig.contacts]) - response.shapes([c.against for c in rig.contacts])


def real_product(
    real_matrix: Float[np.ndarray, "rows inner"], spectra: Complex[np.ndarray, "inner lines"]
) -> Complex[np.ndarray, "rows lines"]:
    """Product of a real and a complex matrix, twice as fast as with the real factor taken as complex."""
    return np.asarray((real_matrix @ np.ascontiguousarray(spectra).view(spectra.real.dtype)).view(complex))


def responses_of(rig: Rig, cache: ResponseCache, zero_known: bool) -> tuple[Response, ...]:
    """Responses of every body.

    If no sensor shows the zero of displacements, the springs of some modes act on the high-passed displacement alone,
    as only modes that are then free show a constant contact force in accelerations. These are the modes that would be
    rigid without attached springs, the mode of a single mass, and further the lowest ones that move the contacts, until
    every contact force can be identified.

    Raises RigError if no number of modes identifies every contact force.
    """
    responses = tuple(response_of(rig, body, cache) for body in rig.bodies)
    eta_shapes, _ = eta_shapes_and_omega(rig, responses)
    if _identifiable_force_count(eta_shapes, range(eta_shapes.shape[1])) < len(rig.contacts):
        raise RigError(
            f"the {len(rig.contacts)} contacts of rig {rig.name!r} move by fewer independent modes; describe more "
            "modes, or fewer contacts"
        )
    if zero_known or not rig.contacts:
        return responses
    free_body_modes = _slowly_free_modes(responses, eta_shapes)
    return tuple(
        r.with_slowly_free_modes(tuple(sorted(m for body, m in free_body_modes if body == k)))
        for k, r in enumerate(responses)
    )


def _slowly_free_modes(
    responses: Sequence[Response], eta_shapes: Float[np.ndarray, "contacts modes"]
) -> list[tuple[int, int]]:
    """Modes (body and number) whose springs act on the high-passed displacement alone; see `responses_of`."""
    body_modes = [(k, m) for k, response in enumerate(responses) for m in range(response.mode_count)]
    rigid_counts = [max(response.body.rigid_modes, response.body.is_mass) for response in responses]
    high_passed_indices = [i for i, (k, m) in enumerate(body_modes) if m < rigid_counts[k]]
    force_rank = _identifiable_force_count(eta_shapes, high_passed_indices)
    natural_hz = np.concatenate([response.dynamics.natural_hz for response in responses])
    for i in np.argsort(natural_hz, kind="stable").tolist():
        if force_rank == len(eta_shapes):
            break
        if _identifiable_force_count(eta_shapes, [*high_passed_indices, i]) > force_rank:
            high_passed_indices.append(i)
            force_rank += 1
    return [body_modes[i] for i in high_passed_indices]


def _identifiable_force_count(eta_shapes: Float[np.ndarray, "contacts modes"], mode_indices: Sequence[int]) -> int:
    """Number of contact forces that some modes tell apart."""
    least_value = RANK_TOLERANCE * float(np.max(np.abs(eta_shapes), initial=0.0))
    return int(np.linalg.matrix_rank(eta_shapes[:, list(mode_indices)], least_value))


def eta_shapes_and_omega(
    rig: Rig, responses: Sequence[Response]
) -> tuple[Float[np.ndarray, "contacts modes"], Float[np.ndarray, " modes"]]:
    """Shapes of all bodies' modes in the relative displacements, and their natural frequencies, rad/s."""
    natural_hz = np.concatenate([response.dynamics.natural_hz for response in responses])
    return np.concatenate([relative_shapes(rig, response) for response in responses], axis=1), 2 * np.pi * natural_hz
