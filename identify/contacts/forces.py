"""Contact forces over time, separated without a law by all stations and the linear model: f = W (A - G_F F), with the
signals that one standard deviation of every nuisance parameter adds to them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.fft import next_fast_len

from identify.contacts.station_spectra import (
    SpectralLines,
    StationErrors,
    force_weights,
    full_motion,
    has_hidden_modes,
    initial_states,
    observed_motion,
    sensed_accelerations,
    start_left_out_s,
)
from identify.linear.modal import force_on_mass
from identify.linear.model import (
    Response,
    ResponseCache,
    accelerances,
    responses_of,
    slow_damping,
    slow_stiffness,
    times,
)
from identify.linear.nuisance import THE_RECORD, Nuisance, NuisanceKind, Observed, ObservedBase, changes_of
from identify.signals.drift import KNOT_S
from identify.signals.kinematics import TAPER_S, Kinematics
from identify.signals.measured_base import MeasuredBase, count_on_bodies
from identify.signals.spectra import decimated
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.model.tolerances import Tolerances

END_LEFT_OUT_S = 2.5
"""End of a record in which the separated forces are wrong, as the beams' ringing is cut off."""
RING_S = 12.0
"""Time in which the beams' ringing decays."""
LEAST_INITIAL_SHARE = 1e-4
"""Least force by an initial state over the contact forces; smaller ones are left out."""

ToForce = Complex[np.ndarray, "contacts stations lines"]


@dataclass(frozen=True)
class NuisanceSignals:
    """Signals that one standard deviation of each nuisance parameter adds to the contact forces and to the relative
    displacements, in single precision.

    noise_in_n and noise_in_m are the multiples of the sensors' noise of forces and displacements that they contain.
    """

    parameters: tuple[Nuisance, ...]
    force_n: Float[np.ndarray, "nuisances contacts fewer"]
    eta_m: Float[np.ndarray, "nuisances contacts fewer"]
    noise_in_n: Float[np.ndarray, "nuisances contacts"]
    noise_in_m: Float[np.ndarray, "nuisances contacts"]

    def with_record_signals(
        self, kind: NuisanceKind, force_n: Float[np.ndarray, "more contacts fewer"]
    ) -> "NuisanceSignals":
        """Signals with further ones of parameters of the record itself, which change no displacement."""
        no_noise = np.zeros(force_n.shape[:2])
        return NuisanceSignals(
            (*self.parameters, *(Nuisance(kind, THE_RECORD, i + 1) for i in range(len(force_n)))),
            np.concatenate([self.force_n, force_n.astype(np.float32)]),
            np.concatenate([self.eta_m, np.zeros(force_n.shape, np.float32)]),
            np.concatenate([self.noise_in_n, no_noise]),
            np.concatenate([self.noise_in_m, no_noise]),
        )

    def without_start(self, samples: int) -> "NuisanceSignals":
        """Signals without their first samples."""
        return replace(self, force_n=self.force_n[..., samples:], eta_m=self.eta_m[..., samples:])


def nuisance_signals(
    parameters: tuple[Nuisance, ...],
    observed: Observed,
    noise: Observed,
    to_force: ToForce,
    signs: Float[np.ndarray, "contacts stations"],
    lines: SpectralLines,
    samples: int,
) -> NuisanceSignals:
    """Nuisance signals of the parameters of `changes_of(observed)` over some samples; `noise` is the observation of the
    sensors' noise alone."""
    shape = (len(parameters), len(signs), samples)
    force_n, eta_m = np.empty(shape, np.float32), np.zeros(shape, np.float32)
    noise_in_n, noise_in_m = np.zeros(shape[:2]), np.zeros(shape[:2])
    noise_force, noise_motion = weighted_stations(to_force, noise.explained), times(signs, noise.displaced)
    for i, (change, noise_change) in enumerate(zip(changes_of(observed), changes_of(noise), strict=True)):
        to_force_there, signs_there = to_force[:, change.sensors], signs[:, change.sensors]
        force_n[i] = lines.signals(weighted_stations(to_force_there, change.delivered), samples)
        noise_in_n[i] = _noise_share(noise_force, weighted_stations(to_force_there, noise_change.delivered))
        if change.displaced is not None and noise_change.displaced is not None and np.any(signs_there):
            eta_m[i] = lines.signals(times(signs_there, change.displaced), samples)
            noise_in_m[i] = _noise_share(noise_motion, times(signs_there, noise_change.displaced))
    return NuisanceSignals(parameters, force_n, eta_m, noise_in_n, noise_in_m)


def random_noise(
    power: Float[np.ndarray, "stations lines"], floor: float, lines: SpectralLines
) -> Complex[np.ndarray, "stations lines"]:
    """Spectra of noise with this power and random phases; zero where the drift's knots can follow it."""
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, power.shape)
    followed = lines.omega < 2 * np.pi * 0.5 / KNOT_S
    return np.asarray(np.sqrt(np.maximum(power, floor)) * np.exp(1j * phase) * ~followed)


def weighted_stations(
    to_force: Complex[np.ndarray, "contacts some lines"], spectra: Complex[np.ndarray, "some lines"]
) -> Complex[np.ndarray, "contacts lines"]:
    """Spectra of the contact forces: the weighted sum over the stations."""
    return np.asarray(np.einsum("jsf,sf->jf", to_force, spectra))


def _noise_share(
    noise: Complex[np.ndarray, "contacts lines"], nuisance: Complex[np.ndarray, "contacts lines"]
) -> Float[np.ndarray, " contacts"]:
    """Multiple of the noise that is nearest to the nuisance, by least squares."""
    power = np.sum(np.abs(noise) ** 2, axis=1)
    product = np.sum((noise.conj() * nuisance).real, axis=1)
    return np.divide(product, power, out=np.zeros_like(power), where=power > 0)


@dataclass(frozen=True)
class ContactForces:
    """Contact forces (N), low-passed and sampled at the record's rate over `factor`.

    noise_n is the standard deviation of the sensors' noise in them. slow_n_per_m and slow_n_s_per_m are the stiffness
    and damping against slow relative displacements, whose forces accelerations do not show.
    """

    force_n: Float[np.ndarray, "contacts fewer"]
    factor: int
    noise_n: Float[np.ndarray, " contacts"]
    nuisances: NuisanceSignals
    slow_n_per_m: Float[np.ndarray, "contacts contacts"]
    slow_n_s_per_m: Float[np.ndarray, "contacts contacts"]

    def without_start(self, samples: int) -> "ContactForces":
        """Contact forces without their first samples."""
        return replace(self, force_n=self.force_n[:, samples:], nuisances=self.nuisances.without_start(samples))


def separated_forces(
    rig: Rig,
    motion: Kinematics,
    factor: int,
    noise: Float[np.ndarray, " stations"],
    tolerances: Tolerances,
    from_rest: bool = True,
) -> ContactForces:
    """Contact forces of all bodies by all their stations.

    noise is the standard deviation per sample of each station's acceleration (m/s^2). Where the zero of displacements
    is known, displacements of bodies that are held replace their slow accelerations. In a record that does not begin at
    rest the free motion of every mode is estimated as well, and its remaining uncertainty is a nuisance.

    Raises RigError if the stations or the modes cannot tell the contacts apart.
    """
    samples, rate, force_count = motion.samples, motion.sample_rate_hz, len(rig.inputs)
    length = factor * next_fast_len(-(-(samples + round(RING_S * rate)) // factor), real=True)
    lines = SpectralLines(length, factor, rate)
    responses = responses_of(rig, ResponseCache(lines.omega, 0), motion.zero_known)
    floats = {r.body.name: bool(np.any(r.dynamics.natural_hz == 0)) for r in responses}
    in_metres = np.array([[motion.zero_known and not floats[s.body]] for s in motion.stations]) & lines.slow
    by_input = accelerances(rig, responses, rig.inputs, motion.stations)
    force_spectra = lines.spectra(motion.forces_n)
    by_inputs = by_input[:force_count] * force_spectra[:, None]
    observed = _observation(rig, motion, lines, responses, in_metres, tolerances, by_inputs, from_rest)
    measured, sensor_response = observed.explained, observed.sensor_response
    noise_power = (samples * noise**2)[:, None] * np.abs(sensor_response) ** 2
    floor = 1e-12 * float(np.mean(np.abs(measured) ** 2))
    noise_alone = _noise_alone(rig, motion, observed, random_noise(noise_power, floor, lines))
    initial = None
    for modes_hidden in (True, False) if any(has_hidden_modes(r, motion) for r in responses) else (False,):
        changes = tuple(change.in_single_precision for change in changes_of(observed))
        errors = StationErrors(noise_power, floor, changes, lines.correlated_line_count)
        to_force = force_weights(by_input[force_count:] * sensor_response, errors)
        unexplained = measured - sensor_response * by_inputs.sum(axis=0)
        if not from_rest:
            initial = initial_states(responses, motion, in_metres, lines, sensor_response * by_input, errors)
            unexplained = unexplained - initial.delivered
        if modes_hidden:
            contact_spectra = weighted_stations(to_force, unexplained)
            observed = _with_hidden_modes(rig, motion, observed, force_spectra, contact_spectra)
            noise_spectra = weighted_stations(to_force, noise_alone.explained)
            noise_alone = _with_hidden_modes(rig, motion, noise_alone, np.zeros_like(force_spectra), noise_spectra)
    end_left_out_s = END_LEFT_OUT_S if any(b.length_m for b in rig.bodies) else TAPER_S
    kept_samples = (samples - round(end_left_out_s * rate)) // factor
    signs = np.array([[float(s == c.at) - float(s == c.against) for s in motion.stations] for c in rig.contacts])
    nuisance_parameters = tuple(c.parameter for c in changes)
    del changes, errors  # they take much memory
    nuisance = nuisance_signals(nuisance_parameters, observed, noise_alone, to_force, signs, lines, kept_samples)
    force_n = lines.signals(weighted_stations(to_force, unexplained), kept_samples)
    slow_n_per_m = slow_stiffness(rig, responses)
    if rig.bodies[0].is_mass and len(rig.bodies) == len(rig.contacts) == 1:
        force_n = _force_on_mass(rig, motion, factor)[:, :kept_samples]
    elif initial:
        start_sample = min(round(start_left_out_s(rig, slow_n_per_m) * rate / factor), kept_samples - 1)
        force_by_state = lines.signals(np.einsum("jsf,isf->ijf", to_force, initial.spectra), kept_samples)
        force_by_state = np.tensordot(initial.root.T, force_by_state, 1)
        state_rms_n = np.sqrt(np.mean(force_by_state[..., start_sample:] ** 2, axis=(1, 2)))
        significant = state_rms_n > LEAST_INITIAL_SHARE * force_n.std()
        nuisance = nuisance.with_record_signals(NuisanceKind.INITIAL_STATE, force_by_state[significant])
    return ContactForces(
        force_n=force_n,
        factor=factor,
        noise_n=_noise_n(to_force, noise_power, motion, lines),
        nuisances=nuisance,
        slow_n_per_m=slow_n_per_m,
        slow_n_s_per_m=slow_damping(rig, responses, slow_n_per_m),
    )


def _noise_n(
    to_force: ToForce, power: Float[np.ndarray, "stations lines"], motion: Kinematics, lines: SpectralLines
) -> Float[np.ndarray, " contacts"]:
    """Standard deviation of the sensors' noise in the contact forces, N.

    It is white in the measured quantity: differentiated n times it has (2 n + 1) (f / f_N)^(2 n) times its mean power
    at the frequency f.
    """
    differentiations = np.array([[max(0, 2 - s.measures.order)] for s in motion.sensors])
    shape = (2 * differentiations + 1) * (lines.omega / (np.pi * lines.rate_hz)) ** (2 * differentiations)
    padded_power = power * shape * lines.length / motion.samples  # over the silence behind, too
    noise_n = weighted_stations(to_force, random_noise(padded_power, 0.0, lines))
    return np.asarray(lines.signals(noise_n, motion.samples // lines.factor).std(axis=1))


def _observation(
    rig: Rig,
    motion: Kinematics,
    lines: SpectralLines,
    responses: tuple[Response, ...],
    in_metres: Bool[np.ndarray, "stations lines"],
    tolerances: Tolerances,
    by_inputs: Complex[np.ndarray, "inputs stations lines"],
    from_rest: bool,
) -> Observed:
    """Observation by the spectra of accelerations, and of displacements where `in_metres`."""
    displacements = lines.spectra(motion.displacement_m)
    accelerations = lines.spectra(motion.acceleration_m_per_s2) if from_rest else sensed_accelerations(motion, lines)
    measured = np.where(in_metres, displacements, accelerations)
    sensor_response = np.where(in_metres, -1 / lines.omega**2, 1.0).astype(complex)
    return Observed(
        sensors=motion.sensors,
        displaced_by=motion.displaced_by,
        tolerances=tolerances,
        omega=lines.omega,
        sensor_response=sensor_response,
        explained=measured,
        by_force=by_inputs[: count_on_bodies(rig)],
        displaced=displacements,
        bodies=tuple(observed_motion(rig, r, motion, measured / sensor_response) for r in responses),
        base=_observed_base(motion.base, lines, by_inputs[-1]) if motion.base else None,
    )


def _observed_base(
    base: MeasuredBase, lines: SpectralLines, by_base: Complex[np.ndarray, "stations lines"]
) -> ObservedBase:
    """Spectra of a measured base, with the accelerations of the stations that it causes."""
    return ObservedBase(
        sensor=base.sensor,
        displaced_by=base.displaced_by,
        acceleration=lines.spectra(base.acceleration_m_per_s2),
        displacement=lines.spectra(base.displacement_m),
        by_base=by_base,
    )


def _noise_alone(
    rig: Rig, motion: Kinematics, observed: Observed, noise: Complex[np.ndarray, "stations lines"]
) -> Observed:
    """Observation of the sensors' noise alone."""
    accelerations = noise / observed.sensor_response
    return replace(
        observed,
        explained=noise,
        by_force=np.zeros_like(observed.by_force),
        displaced=-accelerations / observed.omega**2,
        bodies=tuple(observed_motion(rig, b.response, motion, accelerations) for b in observed.bodies),
        base=observed.base and observed.base.silent,
    )


def _with_hidden_modes(
    rig: Rig,
    motion: Kinematics,
    observed: Observed,
    force_spectra: Complex[np.ndarray, "forces lines"],
    contact_force_spectra: Complex[np.ndarray, "contacts lines"],
) -> Observed:
    """Observation with the hidden modes, driven by the exciting and the contact forces."""
    accelerations = observed.explained / observed.sensor_response
    motions = (
        full_motion(rig, b.response, motion, accelerations, force_spectra, contact_force_spectra)
        for b in observed.bodies
    )
    return replace(observed, bodies=tuple(motions))


def _force_on_mass(rig: Rig, motion: Kinematics, factor: int) -> Float[np.ndarray, "contacts fewer"]:
    """Contact force F - m a - c v - k x on a single mass, which needs no quiet start; F is the sum of all forces."""
    mass = modes_of(rig, rig.bodies[0])
    inverse_mass = float(mass.shapes(np.zeros(1), 1)[0, 0] ** 2)
    omega, damping_ratio = 2 * np.pi * float(mass.frequencies_hz(1)[0]), float(mass.damping_ratios(1)[0])
    resisting = motion.acceleration_m_per_s2[:1] + 2 * damping_ratio * omega * motion.velocity_m_per_s[:1]
    resisting_n = (resisting + omega**2 * motion.displacement_m[:1]) / inverse_mass
    return decimated(force_on_mass(rig, rig.bodies[0], motion.forces_n) - resisting_n, factor)
