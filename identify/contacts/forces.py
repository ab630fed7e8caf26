"""The contact forces, each by itself and over time, without assuming a law: from all stations and the linear model."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d

from identify.signals.kinematics import CORNER_HZ, TAPER_S, Kinematics, integrated, taper
from identify.signals.spectra import decimated
from identify.structure.modal import transformation
from identify.structure.nuisance import BodyMotion, Change, Nuisance, Observed, changes_of
from identify.structure.response import Response, across, response_of, times
from rig.errors import RigError
from rig.model.description import Body, Rig
from rig.model.tolerances import Tolerances

SMOOTHED_HZ = 1.0
LEFT_OUT_S = 2.5
"""At the end of a record, where the beams' ringing is cut off, the separated forces are wrong."""
RING_S = 12.0


@dataclass(frozen=True)
class NuisanceSignals:
    """What one standard deviation of each nuisance parameter adds to the forces and to the relative displacements."""

    parameters: tuple[Nuisance, ...]
    force_n: Float[np.ndarray, "nuisances contacts fewer"]
    eta_m: Float[np.ndarray, "nuisances contacts fewer"]

    def of_contact(self, contact: int) -> "NuisanceSignals":
        """Those of one alone."""
        return replace(self, force_n=self.force_n[:, [contact]], eta_m=self.eta_m[:, [contact]])


@dataclass(frozen=True)
class ContactForces:
    """Contact forces (N), low-passed and sampled at the record's rate over `factor`.

    spring_n_per_m is the linear spring to the ground under the contacts.
    """

    force_n: Float[np.ndarray, "contacts fewer"]
    factor: int
    nuisances: NuisanceSignals
    spring_n_per_m: float

    def after(self, fewer: int) -> "ContactForces":
        """Without the first samples, so many of the forces."""
        own = self.nuisances
        later = replace(own, force_n=own.force_n[..., fewer:], eta_m=own.eta_m[..., fewer:])
        return replace(self, force_n=self.force_n[:, fewer:], nuisances=later)


@dataclass(frozen=True)
class _Lines:
    """The lines of a record that ends in silence, up to the band of forces at every `factor`-th sample."""

    length: int
    factor: int
    rate_hz: float

    @property
    def omega(self) -> Float[np.ndarray, " lines"]:
        return 2 * np.pi * np.arange(self.length // self.factor // 2 + 1) * self.rate_hz / self.length

    def spectra(self, signals: Float[np.ndarray, "*rows samples"]) -> Complex[np.ndarray, "*rows lines"]:
        """With the end tapered off and silence behind, so that what rings on after it does not wrap to the start."""
        tapered = signals * taper(signals.shape[-1], round(TAPER_S * self.rate_hz))
        return np.asarray(np.fft.rfft(tapered, self.length)[..., : self.omega.size])

    def in_time(self, spectra: Complex[np.ndarray, "*rows lines"], samples: int) -> Float[np.ndarray, "*rows fewer"]:
        ends = np.concatenate([spectra[..., :1].real, spectra[..., 1:]], axis=-1)
        return np.asarray(np.fft.irfft(ends, self.length // self.factor)[..., :samples] / self.factor)

    def smoothed(self, products: Complex[np.ndarray, "*rows lines"]) -> Complex[np.ndarray, "*rows lines"]:
        width = max(1, round(SMOOTHED_HZ * self.length / self.rate_hz))
        return np.asarray(uniform_filter1d(products, width, axis=-1))


def separated_forces(
    rig: Rig, motion: Kinematics, factor: int, noise: Float[np.ndarray, " stations"], tolerances: Tolerances
) -> ContactForces:
    """The contact forces between bodies from all their stations, or of one mass from its equation of motion.

    noise is the standard deviation per sample of each station's acceleration (m/s^2).

    Raises RigError if the stations cannot tell the contacts apart, or the contacts hold more than can float.
    """
    samples, rate = motion.force_n.size, motion.sample_rate_hz
    length = factor * next_fast_len(-(-(samples + round(RING_S * rate)) // factor), real=True)
    lines = _Lines(length, factor, rate)
    force, measured = lines.spectra(motion.force_n), lines.spectra(motion.acceleration_m_per_s2)
    responses = tuple(response_of(rig, body, lines.omega) for body in rig.bodies)
    drives = _accelerances(rig, motion, responses)
    observed = Observed(
        sensors=motion.sensors,
        displaced_by=motion.displaced_by,
        tolerances=tolerances,
        omega=lines.omega,
        sensor_response=np.ones_like(measured),
        explained=measured,
        by_force=drives[0] * force,
        displaced=lines.spectra(motion.displacement_m),
        bodies=tuple(_body_motion(rig, r, motion, measured) for r in responses),
    )
    changes = tuple(changes_of(observed))
    if rig.bodies[0].is_mass and len(rig.bodies) == len(rig.contacts) == 1:
        mass = rig.bodies[0]
        kept, to_force = (samples - round(TAPER_S * rate)) // factor, -_apparent_mass(mass, lines.omega)[None, None]
        separated, spring_n_per_m = _on_mass(mass, motion, factor)[:, :kept], mass.mass_kg * _natural(mass) ** 2
    else:
        kept, spring_n_per_m = (samples - round(LEFT_OUT_S * rate)) // factor, 0.0
        variances = _covariance(samples * noise**2, measured, changes, lines)
        to_force = _least_squares(rig, -drives[1:], variances)
        separated = lines.in_time(_weighed(to_force, measured - observed.by_force), kept)
    signs = np.array([[float(s == c.at) - float(s == c.against) for s in motion.stations] for c in rig.contacts])
    count = (len(changes), len(rig.contacts), kept)
    forces, eta = np.empty(count), np.zeros(count)
    for i, change in enumerate(changes):
        forces[i] = lines.in_time(_weighed(to_force[:, change.sensors], change.delivered), kept)
        if change.displaced is not None and np.any(signs[:, change.sensors]):
            eta[i] = lines.in_time(times(signs[:, change.sensors], change.displaced), kept)
    nuisances = NuisanceSignals(tuple(c.parameter for c in changes), forces, eta)
    return ContactForces(separated, factor, nuisances, float(spring_n_per_m))


def _natural(mass: Body) -> float:
    return float(2 * np.pi * mass.frequencies_hz(1)[0])


def _apparent_mass(mass: Body, omega: Float[np.ndarray, " lines"]) -> Complex[np.ndarray, " lines"]:
    """Force per acceleration, of what is measured above the corner of the integration."""
    damping = 2 * mass.damping_ratios(1)[0] * _natural(mass) * integrated(omega, -1, CORNER_HZ)
    return np.asarray(mass.mass_kg * (1 + damping + _natural(mass) ** 2 * integrated(omega, -2, CORNER_HZ)))


def _on_mass(mass: Body, motion: Kinematics, factor: int) -> Float[np.ndarray, "contacts fewer"]:
    """F - m a - c v - k x."""
    own = mass.mass_kg * motion.acceleration_m_per_s2[:1]
    own = own + 2 * mass.damping_ratios(1)[0] * mass.mass_kg * _natural(mass) * motion.velocity_m_per_s[:1]
    return decimated(motion.force_n - own - mass.mass_kg * _natural(mass) ** 2 * motion.displacement_m[:1], factor)


def _covariance(
    noise: Float[np.ndarray, " stations"],
    measured: Complex[np.ndarray, "stations lines"],
    changes: tuple[Change, ...],
    lines: _Lines,
) -> Complex[np.ndarray, "lines stations stations"]:
    """Of the stations' errors: the sensors' noise, and what every tolerance does at the response that was measured."""
    stations = len(measured)
    found = np.zeros((stations, stations, measured.shape[1]), dtype=complex)
    index = np.arange(stations)
    found[index, index] = noise[:, None]
    for change in changes:
        rows = np.array(change.sensors)
        products = change.delivered[:, None] * change.delivered[None].conj()
        found[rows[:, None], rows[None]] += lines.smoothed(products)
    least = 1e-9 * np.einsum("iif->f", found).real.mean() / stations
    found[index, index] += max(least, 1e-12 * float(np.mean(np.abs(measured) ** 2)))
    return np.ascontiguousarray(np.transpose(found, (2, 0, 1)))


def _least_squares(
    rig: Rig,
    to_contacts: Complex[np.ndarray, "contacts stations lines"],
    covariance: Complex[np.ndarray, "lines stations stations"],
) -> Complex[np.ndarray, "contacts stations lines"]:
    """Generalised least squares, frequency by frequency, of all stations' accelerations A on the contact forces f:

        A = G_F F - sum_j G_j f_j + error

    with G the accelerances of the rig's description (all modes): what each station's A - G_F F adds to each force.
    """
    by_contact = np.ascontiguousarray(np.transpose(to_contacts, (2, 1, 0)))
    told = int(np.linalg.matrix_rank(by_contact[0]))
    if told < len(rig.contacts):
        raise RigError(
            f"accelerations tell the constant forces of {told} of the {len(rig.contacts)} contacts, as constant forces "
            "only move bodies that float; describe fewer contacts, and a body that floats by its modes at 0 Hz"
        )
    weighted = np.linalg.solve(covariance, by_contact)
    normal = weighted.conj().transpose(0, 2, 1) @ by_contact
    condition = np.linalg.cond(normal[len(normal) // 4])
    if not np.isfinite(condition) or condition > 1e12:
        raise RigError("the stations cannot tell the contact forces apart; measure more stations on both bodies")
    return np.ascontiguousarray(np.transpose(np.linalg.inv(normal) @ weighted.conj().transpose(0, 2, 1), (1, 2, 0)))


def _weighed(
    to_force: Complex[np.ndarray, "contacts some lines"], spectra: Complex[np.ndarray, "some lines"]
) -> Complex[np.ndarray, "contacts lines"]:
    return np.asarray(np.einsum("jsf,sf->jf", to_force, spectra))


def _accelerances(
    rig: Rig, motion: Kinematics, responses: tuple[Response, ...]
) -> Complex[np.ndarray, "inputs stations lines"]:
    """Acceleration of every station per newton at the exciting force (first) and in each contact's direction."""
    return np.asarray(
        sum(
            r.transfer(r.shapes(motion.stations), np.concatenate([r.shapes([rig.force_at]), across(rig, r)]))
            for r in responses
        )
    )


def _body_motion(
    rig: Rig, response: Response, motion: Kinematics, measured: Complex[np.ndarray, "stations lines"]
) -> BodyMotion:
    """The modal accelerations that the stations tell; those of higher modes are left out."""
    transform = transformation(rig, response.body, motion)
    found = np.zeros((response.count, measured.shape[1]), dtype=complex)
    told = len(transform.inverse)
    found[:told] = transform.inverse @ measured[list(transform.rows)]
    return BodyMotion(response, found, np.arange(response.body.rigid_modes, told))
