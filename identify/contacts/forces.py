"""The contact forces, each by itself and over time, without assuming a law: from all stations and the linear model."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.fft import next_fast_len

from identify.contacts.beginning import as_sensed, initial_states, settled_s
from identify.contacts.lines import Lines
from identify.contacts.modal_motion import has_hidden_modes, told_motion, whole_motion
from identify.contacts.nuisance_signals import NuisanceSignals, ToForce, drawn_noise, nuisance_signals, weighed
from identify.contacts.station_errors import StationErrors, forces_by_stations
from identify.linear.model import Response, ResponseCache, accelerances, responses_of, slow_damping, slow_stiffness
from identify.linear.nuisance import NuisanceKind, Observed, changes_of
from identify.signals.kinematics import TAPER_S, Kinematics
from identify.signals.spectra import decimated
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

    noise_n is the standard deviation of what the sensors' noise makes of them. slow_n_per_m are the forces that slow
    relative displacements take, which accelerations do not tell, slow_n_s_per_m those of slow velocities.
    """

    force_n: Float[np.ndarray, "contacts fewer"]
    factor: int
    noise_n: Float[np.ndarray, " contacts"]
    nuisances: NuisanceSignals
    slow_n_per_m: Float[np.ndarray, "contacts contacts"]
    slow_n_s_per_m: Float[np.ndarray, "contacts contacts"]

    def after(self, fewer: int) -> "ContactForces":
        """Separation without this number of first samples of the forces."""
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
    samples, rate, known = motion.samples, motion.sample_rate_hz, len(rig.forces)
    length = factor * next_fast_len(-(-(samples + round(RING_S * rate)) // factor), real=True)
    lines = Lines(length, factor, rate)
    responses = responses_of(rig, ResponseCache(lines.omega, 0), motion.zero_known)
    floats = {r.body.name: bool(np.any(r.dynamics.natural_hz == 0)) for r in responses}
    in_metres = np.array([[motion.zero_known and not floats[s.body]] for s in motion.stations]) & lines.slow
    drives = accelerances(rig, responses, rig.forces, motion.stations)
    forces = lines.spectra(motion.forces_n)
    observed = _observed(
        rig, motion, lines, responses, in_metres, tolerances, drives[:known] * forces[:, None], from_rest
    )
    measured, scale = observed.explained, observed.sensor_response
    noises = (samples * noise**2)[:, None] * np.abs(scale) ** 2
    floor = 1e-12 * float(np.mean(np.abs(measured) ** 2))
    noisy = _noise_alone(rig, motion, observed, drawn_noise(noises, floor, lines))
    begun = None
    for again in (True, False) if any(has_hidden_modes(r, motion) for r in responses) else (False,):
        changes = tuple(change.in_single_precision for change in changes_of(observed))
        errors = StationErrors(noises, floor, changes, lines.alike)
        to_force = forces_by_stations(drives[known:] * scale, errors)
        rest = measured - scale * observed.by_force.sum(axis=0)
        if not from_rest:
            begun = initial_states(responses, motion, in_metres, lines, scale * drives, errors)
            rest = rest - begun.delivered
        if again:
            observed = _with_hidden_modes(rig, motion, observed, forces, weighed(to_force, rest))
            of_noise = weighed(to_force, noisy.explained)
            noisy = _with_hidden_modes(rig, motion, noisy, np.zeros_like(forces), of_noise)
    left_out_s = LEFT_OUT_S if any(b.length_m for b in rig.bodies) else TAPER_S
    kept = (samples - round(left_out_s * rate)) // factor
    signs = np.array([[float(s == c.at) - float(s == c.against) for s in motion.stations] for c in rig.contacts])
    parameters = tuple(c.parameter for c in changes)
    del changes, errors  # they take much memory
    nuisances = nuisance_signals(parameters, observed, noisy, to_force, signs, lines, kept)
    found = lines.in_time(weighed(to_force, rest), kept)
    slow_n_per_m = slow_stiffness(rig, responses)
    if rig.bodies[0].is_mass and len(rig.bodies) == len(rig.contacts) == 1:
        found = _on_mass(modes_of(rig, rig.bodies[0]), motion, factor)[:, :kept]
    elif begun:
        begin = min(round(settled_s(rig, slow_n_per_m) * rate / factor), kept - 1)
        by_values = lines.in_time(np.einsum("jsf,isf->ijf", to_force, begun.spectra), kept)
        by_values = np.tensordot(begun.root.T, by_values, 1)
        felt = np.sqrt(np.mean(by_values[..., begin:] ** 2, axis=(1, 2))) > LEFT_SHARE * found.std()
        nuisances = nuisances.beside(NuisanceKind.INITIAL_STATE, by_values[felt])
    return ContactForces(
        force_n=found,
        factor=factor,
        noise_n=_noise_n(to_force, noises, motion, lines),
        nuisances=nuisances,
        slow_n_per_m=slow_n_per_m,
        slow_n_s_per_m=slow_damping(rig, responses, slow_n_per_m),
    )


def _noise_n(
    to_force: ToForce, power: Float[np.ndarray, "stations lines"], motion: Kinematics, lines: Lines
) -> Float[np.ndarray, " contacts"]:
    """Standard deviation of the forces by the sensors' noise, which is white in what they measure: differentiated n
    times it has the share (2 n + 1) (f / f_N)^(2 n) of its mean power at the frequency f."""
    times = np.array([[max(0, 2 - s.measures.order)] for s in motion.sensors])
    shape = (2 * times + 1) * (lines.omega / (np.pi * lines.rate_hz)) ** (2 * times)
    drawn = drawn_noise(power * shape * lines.length / motion.samples, 0.0, lines)  # over the silence behind, too
    return np.asarray(lines.in_time(weighed(to_force, drawn), motion.samples // lines.factor).std(axis=1))


def _observed(
    rig: Rig,
    motion: Kinematics,
    lines: Lines,
    responses: tuple[Response, ...],
    in_metres: Bool[np.ndarray, "stations lines"],
    tolerances: Tolerances,
    by_force: Complex[np.ndarray, "forces stations lines"],
    from_rest: bool,
) -> Observed:
    """Measured spectra: accelerations; displacements where `in_metres`."""
    displaced = lines.spectra(motion.displacement_m)
    accelerations = lines.spectra(motion.acceleration_m_per_s2) if from_rest else as_sensed(motion, lines)
    measured = np.where(in_metres, displaced, accelerations)
    scale = np.where(in_metres, -1 / lines.omega**2, 1.0).astype(complex)
    return Observed(
        sensors=motion.sensors,
        displaced_by=motion.displaced_by,
        tolerances=tolerances,
        omega=lines.omega,
        sensor_response=scale,
        explained=measured,
        by_force=by_force,
        displaced=displaced,
        bodies=tuple(told_motion(rig, r, motion, measured / scale) for r in responses),
    )


def _noise_alone(
    rig: Rig, motion: Kinematics, observed: Observed, noise: Complex[np.ndarray, "stations lines"]
) -> Observed:
    accelerations = noise / observed.sensor_response
    return replace(
        observed,
        explained=noise,
        by_force=np.zeros_like(observed.by_force),
        displaced=-accelerations / observed.omega**2,
        bodies=tuple(told_motion(rig, b.response, motion, accelerations) for b in observed.bodies),
    )


def _with_hidden_modes(
    rig: Rig,
    motion: Kinematics,
    observed: Observed,
    forces: Complex[np.ndarray, "forces lines"],
    contact_forces: Complex[np.ndarray, "contacts lines"],
) -> Observed:
    accelerations = observed.explained / observed.sensor_response
    moved = (whole_motion(rig, b.response, motion, accelerations, forces, contact_forces) for b in observed.bodies)
    return replace(observed, bodies=tuple(moved))


def _on_mass(mass: Modes, motion: Kinematics, factor: int) -> Float[np.ndarray, "contacts fewer"]:
    """F - m a - c v - k x, which needs no quiet start; F is the sum of all forces."""
    per_mass = float(mass.shapes(np.zeros(1), 1)[0, 0] ** 2)
    natural, ratio = 2 * np.pi * float(mass.frequencies_hz(1)[0]), float(mass.damping_ratios(1)[0])
    own = motion.acceleration_m_per_s2[:1] + 2 * ratio * natural * motion.velocity_m_per_s[:1]
    return decimated(motion.forces_n.sum(axis=0) - (own + natural**2 * motion.displacement_m[:1]) / per_mass, factor)
