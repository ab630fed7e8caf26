"""A record that does not begin at rest: the free motion that each mode's displacement and velocity at its start cause.

With the poles p of q'' + 2 zeta omega q' + omega^2 q = 0, a mode moves by q_0 u(t) + q_0' v(t),

    u = (p_2 exp(p_1 t) - p_1 exp(p_2 t)) / (p_2 - p_1),   v = (exp(p_2 t) - exp(p_1 t)) / (p_2 - p_1)

in addition to what the forces cause from rest. All q_0 and q_0' are linear in what the sensors deliver.

Of a record that does not fade in, as a free decay, what they add to the second derivative of the displacements, the
jump at the first sample included, is, with the accelerance A_m = -omega^2 / D_m,

    q_0 (i omega + 2 zeta_m omega_m) A_m + q_0' A_m

Sensors show it as the sum over the samples, half of the first, under a half cosine at the record's end: that is known
exactly, as a sum of geometric ones (`faded_sum`). So a velocity sensor does not show the jump of the displacement,
i omega q_0 of this, an accelerometer also not that of the velocity, q_0'.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from identify.linear.model import Response, times
from identify.linear.nuisance import Change, Nuisance, NuisanceKind
from identify.linear.projection import Covariances, Projection, without_free_inputs
from identify.signals.kinematics import Kinematics
from rig.model.description import Station

TOLD = 10.0
"""What tells no more than a tenth of that, as a multiple of the prior, is hardly believed."""
WIDE = 3.0
"""The prior of the initial state, as a multiple of what the whole motion at the sensors would be by that mode alone."""
LEAST_HZ = 0.5
"""Slower modes are taken to move as slowly as that."""
DETUNED = 1e-6
"""Relative change of a frequency or a damping ratio by which derivatives are taken."""
KNOWN = 0.05
"""Likewise where displacement sensors show all modes of a body."""


@dataclass(frozen=True)
class FreeMotion:
    """Free motion of one mode: its initial displacement (order 0) or velocity (order 1), and the coordinate over time
    per unit.

    rows are the time histories of the displacement, velocity and acceleration of the coordinate; shape is the mode's
    at the stations. held is False of a mode whose spring acts on the high-passed displacement: the drift has what its
    initial state does.
    """

    body: str
    mode: int
    order: int
    rows: Float[np.ndarray, "3 samples"]
    shape: Float[np.ndarray, " stations"]
    held: bool


Prior = tuple[Float[np.ndarray, " values"], Float[np.ndarray, " values"]]
"""Mean and standard deviation."""


def free_motion(
    natural_hz: float, damping_ratio: float, order: int, time_s: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "3 samples"]:
    """u (order 0, of a unit displacement) or v (order 1, of a unit velocity) with its two derivatives in time."""
    if natural_hz == 0:
        one, zero = np.ones_like(time_s), np.zeros_like(time_s)
        return np.stack([time_s, one, zero] if order else [one, zero, zero])
    poles = _poles(natural_hz, damping_ratio)
    first, second = (np.exp(p * time_s) for p in poles)
    over = poles[1] - poles[0]
    if order:
        rows = [(poles[1] ** k * second - poles[0] ** k * first) / over for k in range(3)]
    else:
        rows = [(poles[1] * poles[0] ** k * first - poles[0] * poles[1] ** k * second) / over for k in range(3)]
    return np.asarray(np.real(rows))


def _poles(natural_hz: float, damping_ratio: float) -> Complex[np.ndarray, "2"] | Float[np.ndarray, "2"]:
    zeta = damping_ratio if abs(damping_ratio - 1) > 1e-6 else 1 + 1e-6
    return 2 * np.pi * natural_hz * (-zeta + np.array([1, -1]) * np.emath.sqrt(zeta**2 - 1))


def free_motions(
    responses: Sequence[Response], motion: Kinematics, highest_hz: float, length: int
) -> tuple[list[FreeMotion], Prior, Prior]:
    """The free motions of the modes that lie in the band and still ring after the first seconds; with the priors of
    the initial values, and of those at the record's end.

    The mean is what the stations show at the first sample. Where they show all modes of a body, and their zero, it is
    known to a share; else the deviation is wide. A mode whose spring acts on the high-passed displacement moves as a
    free one: what integration loses of it.
    """
    time_s = np.arange(max(motion.samples, length - motion.samples)) / motion.sample_rate_hz
    motions: list[FreeMotion] = []
    mean: list[float] = []
    share: list[float] = []
    size: list[float] = []
    for response in responses:
        hz, zeta = response.dynamics.natural_hz, response.dynamics.damping_ratios
        shapes = response.shapes(motion.stations)
        own = np.flatnonzero([s.body == response.body.name for s in motion.stations])
        told = min(own.size, response.count)
        coordinates = np.linalg.pinv(shapes[own, :told]) @ np.array(
            [motion.displacement_m[own], motion.velocity_m_per_s[own]]
        )
        exact = told == response.count and motion.zero_known
        rms_m, rms_m_per_s2 = (
            float(np.max(rows[own].std(axis=1))) for rows in (motion.displacement_m, motion.acceleration_m_per_s2)
        )
        for m in range(response.count):
            if hz[m] >= highest_hz:
                continue
            largest = float(np.max(np.abs(shapes[own, m])))
            turning = 2 * np.pi * max(hz[m], LEAST_HZ)
            moved = float(np.hypot(rms_m, rms_m_per_s2 / turning**2)) / max(largest, 1e-9)
            for order in range(2):
                by = free_motion(float(hz[m]), float(zeta[m]), order, time_s)
                motions.append(
                    FreeMotion(response.body.name, m, order, by, shapes[:, m], m not in response.dynamics.high_passed)
                )
                mean.append(float(coordinates[order, m, 0]) if exact else 0.0)
                share.append(KNOWN if exact else WIDE)
                size.append(moved * turning**order)
    begun = (np.array(mean), np.array(share) * size)
    return motions, begun, (np.zeros(len(mean)), WIDE * np.array(size))


@dataclass(frozen=True)
class InitialStates:
    """Free motion that a record begins with, as the sensors deliver it.

    delivered is the best estimate of it; the columns of root are the directions in which it is uncertain, each a
    standard deviation long: columns = sum_i spectra_i root_ij, of the spectra of a unit of every initial value.
    """

    delivered: Complex[np.ndarray, "stations lines"]
    spectra: Complex[np.ndarray, "values stations lines"]
    root: Float[np.ndarray, "values values"]


@dataclass(frozen=True)
class Estimated:
    """Initial values and their covariance."""

    values: Float[np.ndarray, " values"]
    covariance: Float[np.ndarray, "values values"]

    def of(
        self, spectra: Complex[np.ndarray, "values stations lines"], wanted: Int[np.ndarray, " some"]
    ) -> InitialStates:
        """Free motion of some of the initial values, the first of which have these spectra."""
        own = self.covariance[np.ix_(wanted, wanted)]
        scale = np.sqrt(np.diag(own))
        sizes, directions = np.linalg.eigh(own / (scale[:, None] * scale))
        root = scale[:, None] * directions * np.sqrt(np.maximum(sizes, 0.0))
        delivered = np.einsum("i,isf->sf", self.values[wanted], spectra[wanted])
        return InitialStates(delivered, spectra[wanted], root)


def free_spectra(
    motions: list[FreeMotion],
    orders: list[int],
    in_metres: Bool[np.ndarray, "stations lines"],
    omega: Float[np.ndarray, " lines"],
    spectra: Callable[[Float[np.ndarray, "rows samples"]], Complex[np.ndarray, "rows lines"]],
) -> Complex[np.ndarray, "values stations lines"]:
    """Spectra by a unit of every initial value at the stations: accelerations, (i omega)^(2 - order) times the spectrum
    of what the station's sensor measures; where lines are in metres displacements."""
    turning = 1j * omega
    powers = {order: turning ** (2 - order) for order in range(3)}
    found = np.empty((len(motions), *in_metres.shape), dtype=complex)
    for one, motion in zip(found, motions, strict=True):
        rows = spectra(motion.rows)
        for station, (share, order) in enumerate(zip(motion.shape, orders, strict=True)):
            one[station] = share * np.where(in_metres[station], rows[0], powers[order] * rows[order])
    return found


def estimated_states(
    spectra: Complex[np.ndarray, "values stations lines"],
    mean: Float[np.ndarray, " values"],
    deviation: Float[np.ndarray, " values"],
    rest: Complex[np.ndarray, "stations lines"],
    by_contacts: Complex[np.ndarray, "contacts stations lines"],
    errors: Covariances,
    alike: int,
) -> Estimated:
    """The initial values by generalised least squares from what no contact forces explain.

    rest = sum_i theta_i spectra_i + sum_j by_contacts_j f_j + error, with the contact forces f_j free at every line and
    the prior mean and deviation of theta. errors are the lines that are used, part by part, with their covariances; so
    many neighbouring lines err alike.
    """
    normal, gradient = np.diag(deviation**-2), np.zeros_like(mean)
    rest = rest - np.einsum("i,isf->sf", mean, spectra)
    for rows in without_free_inputs([spectra, rest[None]], by_contacts, errors):
        flat = np.concatenate([rows.real, rows.imag])
        normal += 2 / alike * flat[:, :-1].T @ flat[:, :-1]
        gradient += 2 / alike * flat[:, :-1].T @ flat[:, -1]
    sizes, directions = np.linalg.eigh(normal * deviation[:, None] * deviation)
    root = deviation[:, None] * directions
    sizes = np.maximum(sizes, 1.0)  # less is rounding: the prior alone gives one
    believed = (sizes - 1) / (sizes + TOLD)
    return Estimated(mean + root @ (believed / sizes * (root.T @ gradient)), (root / sizes) @ root.T)


@dataclass(frozen=True, eq=False)
class FreeMode:
    """Free motion of one mode (from 0) of a body: its shape at the sensors, and its accelerations by a unit of its
    displacement and of its velocity at the beginning; shown_units are those as the sampled sensors show them, state how
    large these were, times the sample rate, as spectra are sums.
    """

    body: int
    mode: int
    shape: Float[np.ndarray, " sensors"]
    units: Complex[np.ndarray, "2 lines"]
    shown_units: Complex[np.ndarray, "2 lines"]
    state: Float[np.ndarray, " 2"]

    @property
    def acceleration(self) -> Complex[np.ndarray, " lines"]:
        return np.asarray(self.state @ self.units)

    @property
    def shown(self) -> Complex[np.ndarray, "sensors lines"]:
        """Acceleration that the sensors show of the free motion."""
        return np.outer(self.shape, self.state @ self.shown_units)

    @property
    def not_shown(self) -> Complex[np.ndarray, "sensors lines"]:
        """Acceleration of the free motion that the sensors do not show."""
        return np.outer(self.shape, self.state @ (self.units - self.shown_units))


@dataclass(frozen=True)
class Sampling:
    """Sampling of a free motion: the derivative that is measured, the rate, the samples and how many of them fade, as
    in `kinematics.taper`.
    """

    order: int
    rate_hz: float
    samples: int
    fading: int


def free_modes(
    responses: Sequence[Response],
    modes: Sequence[Int[np.ndarray, "_"]],
    places: Sequence[Station | None],
    sampling: Sampling | None,
) -> tuple[FreeMode, ...]:
    """Free modes of each body at zero amplitude, as sensors show them; whole without a sampling."""
    free = []
    for k, (response, chosen) in enumerate(zip(responses, modes, strict=True)):
        turning = 1j * response.dynamics.omega
        damped = 4 * np.pi * response.dynamics.natural_hz * response.dynamics.damping_ratios
        shapes = response.shapes(places)
        for m in chosen.tolist():
            units = np.stack([(turning + damped[m]) * response.accelerance[m], response.accelerance[m]])
            hz, zeta = float(response.dynamics.natural_hz[m]), float(response.dynamics.damping_ratios[m])
            shown = _sampled(hz, zeta, response.dynamics.omega, sampling) if sampling and hz else units
            free.append(FreeMode(k, m, shapes[:, m], units, shown, np.zeros(2)))
    return tuple(free)


def faded_sum(pole: complex, omega: Float[np.ndarray, " lines"], sampling: Sampling) -> Complex[np.ndarray, " lines"]:
    """The transform of exp(pole t) over the samples: with z = exp((pole - i omega) / rate), and g(z, n) the sum of the
    first n powers of z,

        g(z, M) - 1/2 + z^M [ g(z, F) / 2 + (c g(c z, F) + c* g(c* z, F)) / 4 ],   c = exp(i pi / F)

    of the first M samples, half of the first, and of F that fade.
    """
    exponent = (pole - 1j * omega) / sampling.rate_hz
    whole, turn = sampling.samples - sampling.fading, 1j * np.pi / sampling.fading
    fading = 0.5 * _geometric(exponent, sampling.fading) + 0.25 * sum(
        np.exp(c) * _geometric(exponent + c, sampling.fading) for c in (turn, -turn)
    )
    return np.asarray(_geometric(exponent, whole) - 0.5 + np.exp(whole * exponent) * fading)


def _geometric(exponent: Complex[np.ndarray, " lines"], count: int) -> Complex[np.ndarray, " lines"]:
    """The sum of the first powers of exp(exponent)."""
    below = np.expm1(exponent)
    return np.divide(np.expm1(count * exponent), below, out=np.full(exponent.shape, count, complex), where=below != 0)


def _sampled(
    natural_hz: float, damping_ratio: float, omega: Float[np.ndarray, " lines"], sampling: Sampling
) -> Complex[np.ndarray, "2 lines"]:
    """Accelerations by the sampled derivative of u and of v, over the sample rate."""
    first, second = _poles(natural_hz, damping_ratio)
    sums = [faded_sum(p, omega, sampling) for p in (first, second)]
    power = (1j * omega) ** (2 - sampling.order) / ((second - first) * sampling.rate_hz)
    u = second * first**sampling.order * sums[0] - first * second**sampling.order * sums[1]
    v = second**sampling.order * sums[1] - first**sampling.order * sums[0]
    return np.stack([power * u, power * v])


def detuned(
    motion: FreeMode, response: Response, sampling: Sampling, kind: NuisanceKind
) -> Complex[np.ndarray, "sensors lines"]:
    """The relative change of what sensors show of a mode, as an acceleration, by its frequency or its damping ratio."""
    dynamics = response.dynamics
    hz, zeta = float(dynamics.natural_hz[motion.mode]), float(dynamics.damping_ratios[motion.mode])
    if not hz:
        return np.zeros_like(motion.shown)
    ends = []
    for factor in (1 - DETUNED, 1 + DETUNED):
        changed = (hz * factor, zeta) if kind is NuisanceKind.FREQUENCY else (hz, zeta * factor)
        ends.append(motion.state @ _sampled(*changed, dynamics.omega, sampling))
    return np.outer(motion.shape, ends[1] - ends[0]) / (2 * DETUNED)


def fitted_modes(
    motions: Sequence[FreeMode],
    projection: Projection,
    sensed: Complex[np.ndarray, "sensors lines"],
    residual: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMode, ...]:
    """The states at the beginning that leave least of a linear residual.

    sensed is what accelerations are in standard deviations. With the shapes Phi at the sensors and the projection B T,

        N = Phi sensed* (1 - B T) sensed Phi'

    is what any two modes' accelerations are weighed by, line by line.
    """
    shapes, units = np.array([m.shape for m in motions]), np.array([m.shown_units for m in motions])
    both = (shapes[:, None] * shapes).reshape(-1, shapes.shape[1])
    weights = (both @ np.abs(sensed) ** 2).reshape(len(shapes), *units.shape[::2]).astype(complex)
    for by_input, to_input in zip(projection.by_input, projection.to_inputs, strict=True):
        weights -= times(shapes, sensed.conj() * by_input)[:, None] * times(shapes, sensed * to_input)
    normal, gradient = (
        np.concatenate([_products(unit, rows) for unit, rows in zip(units, of_modes, strict=True)])
        for of_modes in (
            (weights[:, :, None] * units).reshape(len(units), -1, sensed.shape[1]),
            times(shapes, sensed.conj() * residual)[:, None],
        )
    )
    size = np.sqrt(np.diag(normal))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    states = scale * (np.linalg.pinv(scale[:, None] * normal * scale, hermitian=True) @ (scale * gradient[:, 0]))
    return tuple(replace(m, state=state) for m, state in zip(motions, states.reshape(-1, 2), strict=True))


def _products(
    rows: Complex[np.ndarray, "some lines"], others: Complex[np.ndarray, "more lines"]
) -> Float[np.ndarray, "some more"]:
    """The real parts of the scalar products."""
    return np.asarray(rows.view(float) @ np.ascontiguousarray(others).view(float).T)


def state_changes(
    motions: Sequence[FreeMode],
    bodies: Sequence[str],
    sensor_response: Complex[np.ndarray, "sensors lines"],
    size: float,
) -> Iterator[Change]:
    """Changes of each mode's initial displacement and velocity, sized to move the sensors by this norm."""
    for motion in motions:
        parameter = Nuisance(NuisanceKind.INITIAL_STATE, bodies[motion.body], motion.mode + 1)
        for unit in motion.shown_units:
            delivered = sensor_response * np.outer(motion.shape, unit)
            scale = size / max(float(np.linalg.norm(delivered)), 1e-300)
            yield Change(parameter, list(range(len(delivered))), delivered * scale)
