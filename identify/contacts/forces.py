"""The contact forces, each by itself and over time, without assuming a law: from all stations and the linear model."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import next_fast_len

from identify.contacts.beginning import as_sensed, initial_states, settled_s
from identify.contacts.lines import Lines
from identify.contacts.nuisance_signals import NuisanceSignals, drawn_noise, nuisance_signals, weighed
from identify.signals.kinematics import TAPER_S, Kinematics
from identify.signals.spectra import decimated
from identify.structure.modal import transformation
from identify.structure.nuisance import BodyMotion, Change, Observed, changes_of
from identify.structure.response import Response, across
from identify.structure.slow_motion import responses_of, slow_damping, slow_stiffness
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.modes import Modes, modes_of
from rig.model.tolerances import Tolerances

LEFT_OUT_S = 2.5
"""At the end of a record, where the beams' ringing is cut off, the separated forces are wrong."""
RING_S = 12.0
LEFT_SHARE = 1e-4
"""Of the contact forces; what an initial state adds less is left out."""


@dataclass(frozen=True)
class ContactForces:
    """Contact forces (N), low-passed and sampled at the record's rate over `factor`.

    slow_n_per_m are the forces that slow relative displacements take, which accelerations do not tell, slow_n_s_per_m
    those of slow velocities.
    """

    force_n: Float[np.ndarray, "contacts fewer"]
    factor: int
    nuisances: NuisanceSignals
    slow_n_per_m: Float[np.ndarray, "contacts contacts"]
    slow_n_s_per_m: Float[np.ndarray, "contacts contacts"]

    def after(self, fewer: int) -> "ContactForces":
        """Without the first samples, so many of the forces."""
        return replace(self, force_n=self.force_n[:, fewer:], nuisances=self.nuisances.after(fewer))


def separated_forces(
    rig: Rig,
    motion: Kinematics,
    factor: int,
    noise: Float[np.ndarray, " stations"],
    tolerances: Tolerances,
    from_rest: bool = True,
) -> ContactForces:
    """The contact forces of all bodies from all their stations.

    noise is the standard deviation per sample of each station's acceleration (m/s^2). Where sensors show the zero of
    displacements, those of bodies that do not float stand in for their slow accelerations. Of a record that does not
    begin from rest the free motion of every mode is estimated along, and what stays uncertain of it is a nuisance.

    Raises RigError if the stations or the modes cannot tell the contacts apart.
    """
    samples, rate = motion.force_n.size, motion.sample_rate_hz
    length = factor * next_fast_len(-(-(samples + round(RING_S * rate)) // factor), real=True)
    lines = Lines(length, factor, rate)
    responses = responses_of(rig, lines.omega, motion.zero_known)
    floats = {r.body.name: bool(np.any(r.dynamics.natural_hz == 0)) for r in responses}
    in_metres = np.array([[motion.zero_known and not floats[s.body]] for s in motion.stations]) & lines.slow
    scale = np.where(in_metres, -1 / lines.omega**2, 1.0).astype(complex)
    force = lines.spectra(motion.force_n)
    displaced = lines.spectra(motion.displacement_m)
    accelerations = lines.spectra(motion.acceleration_m_per_s2) if from_rest else as_sensed(motion, lines)
    measured = np.where(in_metres, displaced, accelerations)
    accelerated = measured / scale
    drives = _accelerances(rig, motion, responses)
    observed = Observed(
        sensors=motion.sensors,
        displaced_by=motion.displaced_by,
        tolerances=tolerances,
        omega=lines.omega,
        sensor_response=scale,
        explained=measured,
        by_force=drives[0] * force,
        displaced=displaced,
        bodies=tuple(_body_motion(rig, r, motion, accelerated) for r in responses),
    )
    changes = tuple(changes_of(observed))
    noises = (samples * noise**2)[:, None] * np.abs(scale) ** 2
    noise_drawn = drawn_noise(noises, 1e-12 * float(np.mean(np.abs(measured) ** 2)), lines)
    noise_m = -noise_drawn / scale / lines.omega**2
    by_noise = changes_of(
        replace(
            observed,
            explained=noise_drawn,
            by_force=np.zeros_like(observed.by_force),
            displaced=noise_m,
            bodies=tuple(_body_motion(rig, r, motion, noise_drawn / scale) for r in responses),
        )
    )
    covariance = _covariance(noises, measured, changes, lines)
    to_force = _least_squares(-drives[1:] * scale, covariance)
    rest, begun = measured - scale * observed.by_force, None
    if not from_rest:
        begun = initial_states(responses, motion, in_metres, lines, scale * drives, covariance)
        rest = rest - begun.delivered
    left_out_s = LEFT_OUT_S if any(b.length_m for b in rig.bodies) else TAPER_S
    kept = (samples - round(left_out_s * rate)) // factor
    signs = np.array([[float(s == c.at) - float(s == c.against) for s in motion.stations] for c in rig.contacts])
    nuisances = nuisance_signals(changes, by_noise, noise_drawn, noise_m, to_force, signs, lines, kept)
    found = lines.in_time(weighed(to_force, rest), kept)
    if rig.bodies[0].is_mass and len(rig.bodies) == len(rig.contacts) == 1:
        found = _on_mass(modes_of(rig, rig.bodies[0]), motion, factor)[:, :kept]
        begun = None
    slow_n_per_m = slow_stiffness(rig, responses)
    if begun:
        by_values = np.array([lines.in_time(weighed(to_force, one), kept) for one in begun.spectra])
        by_values = by_values.reshape(-1, len(rig.contacts), kept)
        by_values = np.tensordot(begun.root.T, by_values, 1)
        begin = min(round(settled_s(rig, slow_n_per_m) * rate / factor), kept - 1)
        felt = np.sqrt(np.mean(by_values[..., begin:] ** 2, axis=(1, 2))) > LEFT_SHARE * found.std()
        nuisances = nuisances.beside("initial state", by_values[felt])
    return ContactForces(
        force_n=found,
        factor=factor,
        nuisances=nuisances,
        slow_n_per_m=slow_n_per_m,
        slow_n_s_per_m=slow_damping(rig, responses, slow_n_per_m),
    )


def _on_mass(mass: Modes, motion: Kinematics, factor: int) -> Float[np.ndarray, "contacts fewer"]:
    """F - m a - c v - k x, which needs no quiet start."""
    per_mass = float(mass.shapes(np.zeros(1), 1)[0, 0] ** 2)
    natural, ratio = 2 * np.pi * float(mass.frequencies_hz(1)[0]), float(mass.damping_ratios(1)[0])
    own = motion.acceleration_m_per_s2[:1] + 2 * ratio * natural * motion.velocity_m_per_s[:1]
    return decimated(motion.force_n - (own + natural**2 * motion.displacement_m[:1]) / per_mass, factor)


def _covariance(
    noise: Float[np.ndarray, "stations lines"],
    measured: Complex[np.ndarray, "stations lines"],
    changes: tuple[Change, ...],
    lines: Lines,
) -> Complex[np.ndarray, "lines stations stations"]:
    """Of the stations' errors: the sensors' noise, and what every tolerance does at the response that was measured."""
    stations = len(measured)
    found = np.zeros((stations, stations, measured.shape[1]), dtype=complex)
    index = np.arange(stations)
    found[index, index] = noise
    for change in changes:
        rows = np.array(change.sensors)
        products = change.delivered[:, None] * change.delivered[None].conj()
        found[rows[:, None], rows[None]] += lines.smoothed(products)
    least = 1e-9 * np.einsum("iif->f", found).real.mean() / stations
    found[index, index] += max(least, 1e-12 * float(np.mean(np.abs(measured) ** 2)))
    return np.ascontiguousarray(np.transpose(found, (2, 0, 1)))


def _least_squares(
    to_contacts: Complex[np.ndarray, "contacts stations lines"],
    covariance: Complex[np.ndarray, "lines stations stations"],
) -> Complex[np.ndarray, "contacts stations lines"]:
    """Generalised least squares, frequency by frequency, of all stations' accelerations A on the contact forces f:

        A = G_F F - sum_j G_j f_j + error

    with G the accelerances of the rig's description (all modes): what each station's A - G_F F adds to each force.
    """
    by_contact = np.ascontiguousarray(np.transpose(to_contacts, (2, 1, 0)))
    weighted = np.linalg.solve(covariance, by_contact)
    normal = weighted.conj().transpose(0, 2, 1) @ by_contact
    condition = np.linalg.cond(normal[len(normal) // 4])
    if not np.isfinite(condition) or condition > 1e12:
        raise RigError("the stations cannot tell the contact forces apart; measure more stations on both bodies")
    return np.ascontiguousarray(np.transpose(np.linalg.inv(normal) @ weighted.conj().transpose(0, 2, 1), (1, 2, 0)))


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
