"""Contact forces over time, separated without a law by all stations, strain gauges and the linear model:
f = W (A - G_F F)."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from identify.contacts.gauges import Gauges
from identify.contacts.nuisance_signals import (
    NuisanceSignals,
    ToForce,
    nuisance_signals,
    random_noise,
    weighted_stations,
)
from identify.contacts.observation import (
    SeparationInput,
    noise_observation,
    observation_of,
    with_driven_modes,
    with_modes_at_rest,
)
from identify.contacts.slow_motion import (
    LOWEST_CORNER_HZ,
    SlowMotion,
    is_held,
    quietest_corner,
    slow_model,
    slow_motion,
)
from identify.contacts.station_spectra import (
    SpectralLines,
    StationErrors,
    force_weights,
    has_hidden_modes,
    initial_states,
    start_left_out_s,
)
from identify.linear.free_motion import InitialStates
from identify.linear.modal import force_on_mass
from identify.linear.model import (
    Response,
    ResponseCache,
    accelerances,
    responses_of,
    slow_damping,
    slow_stiffness,
)
from identify.linear.nuisance import Nuisance, NuisanceKind, Observed, changes_of
from identify.signals.kinematics import TAPER_S, Kinematics
from identify.signals.spectra import decimated
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.model.tolerances import Tolerances

END_LEFT_OUT_S = 2.5
"""End of a record in which the separated forces are wrong, as the beams' ringing is cut off."""
LEAST_INITIAL_SHARE = 1e-4
"""Least force by an initial state over the contact forces; smaller ones are left out."""


@dataclass(frozen=True)
class ContactForces:
    """Contact forces (N), low-passed and sampled at the record's rate over `factor`.

    slow is the slow motion of held bodies where strain gauges tell it, else None. noise_n is the standard deviation of
    the sensors' noise in them. slow_n_per_m and slow_n_s_per_m are the stiffness
    and damping against slow relative displacements, whose forces accelerations do not show.
    """

    force_n: Float[np.ndarray, "contacts fewer"]
    factor: int
    noise_n: Float[np.ndarray, " contacts"]
    nuisances: NuisanceSignals
    slow_n_per_m: Float[np.ndarray, "contacts contacts"]
    slow_n_s_per_m: Float[np.ndarray, "contacts contacts"]
    slow: SlowMotion | None = None

    def without_start(self, samples: int) -> "ContactForces":
        """Contact forces without their first samples."""
        return replace(self, force_n=self.force_n[:, samples:], nuisances=self.nuisances.without_start(samples))


def separated_forces(
    rig: Rig,
    motion: Kinematics,
    factor: int,
    noise: Float[np.ndarray, " stations"],
    tolerances: Tolerances,
    gauges: Gauges,
    from_rest: bool = True,
) -> ContactForces:
    """Contact forces of all bodies by all their stations and strain gauges.

    noise is the standard deviation per sample of each station's acceleration (m/s^2). Where the zero of displacements
    is known, displacements of bodies that are held replace their slow accelerations; else strain gauges tell the slow
    forces, and these the slow displacements of held bodies, if that is quiet enough (`SlowMotion.is_quiet`). In a
    record that does not begin at rest the free motion of every mode is estimated as well, and its remaining uncertainty
    is a nuisance.

    Raises RigError if the stations or the modes cannot tell the contacts apart.
    """
    record = SeparationInput(rig, motion, factor, noise, tolerances, gauges, from_rest)
    if gauges.sensors and not motion.zero_known:
        try:
            forces = _separated(record, slow_by_gauges=True)
        except RigError:
            forces = None
        if forces and forces.slow and forces.slow.is_quiet(rig, forces.force_n):
            return forces
    return _separated(record, slow_by_gauges=False)


@dataclass(frozen=True, eq=False)
class _Weighted:
    """Stations and gauges weighed against each other: weights of the contact forces, what no exciting force explains,
    and the observations behind, of the signals and of their noise alone.

    corner_hz is that below which held modes move by the forces, noise_m the noise of the relative displacements then.
    """

    responses: tuple[Response, ...]
    by_input: Complex[np.ndarray, "inputs rows lines"]
    noise_power: Float[np.ndarray, "rows lines"]
    observed: Observed
    noise_alone: Observed
    to_force: ToForce
    unexplained: Complex[np.ndarray, "rows lines"]
    initial: InitialStates | None
    parameters: tuple[Nuisance, ...]
    corner_hz: float
    noise_m: Float[np.ndarray, " contacts"]


def _weighted(record: SeparationInput, slow_by_gauges: bool) -> _Weighted:
    """Weights of the contact forces, again with the hidden and the slow modes where the first forces move some.

    Raises RigError as `separated_forces`, and if gauges shall tell the slow motion of a body that floats.
    """
    rig, motion, gauges, lines = record.rig, record.motion, record.gauges, record.lines
    force_count, padding = len(rig.inputs), lines.length / motion.samples
    responses = responses_of(rig, ResponseCache(lines.omega, 0), motion.zero_known or slow_by_gauges)
    floats = {r.body.name: not is_held(r) for r in responses}
    if slow_by_gauges and any(floats.values()):
        raise RigError("a body floats, whose slow motion no strain gauge shows")
    in_metres = np.array([[motion.zero_known and not floats[s.body]] for s in motion.stations]) & lines.slow
    by_input = accelerances(rig, responses, rig.inputs, [*motion.sensors, *gauges.sensors])
    force_spectra = lines.spectra(motion.forces_n)
    by_inputs = by_input[:force_count] * force_spectra[:, None]
    observed, gauge_errors, noise_power = observation_of(record, lines, responses, in_metres, by_inputs)
    measured, sensor_response = observed.explained, observed.sensor_response
    floor = 1e-12 * float(np.mean(np.abs(measured) ** 2))
    noise_alone = noise_observation(rig, motion, observed, random_noise(noise_power, floor, lines))
    corner_hz = LOWEST_CORNER_HZ if gauges.sensors and not motion.zero_known else 0.0
    observed = with_modes_at_rest(record, observed, force_spectra, corner_hz, gauge_errors)
    noise_alone = with_modes_at_rest(record, noise_alone, 0 * force_spectra, corner_hz, gauge_errors)
    initial, noise_m = None, np.zeros(len(rig.contacts))
    by_modes = corner_hz > 0 or any(has_hidden_modes(r, motion) for r in responses)
    for modes_hidden in (True, False) if by_modes else (False,):
        changes = tuple(change.in_single_precision for change in changes_of(observed))
        weighed = tuple(c for c in changes if c.parameter.kind is not NuisanceKind.ZERO)  # those are at 0 Hz alone
        errors = StationErrors(noise_power, floor, weighed, lines.correlated_line_count)
        to_force = force_weights(by_input[force_count:] * sensor_response, errors)
        unexplained = measured - sensor_response * by_inputs.sum(axis=0)
        if not record.from_rest:
            initial = initial_states(responses, motion, in_metres, lines, sensor_response * by_input, errors)
            unexplained = unexplained - initial.delivered
        if slow_by_gauges:
            by_contacts = by_input[force_count:]
            corner_hz, noise_m = quietest_corner(record.signs, by_contacts, to_force, noise_power * padding, lines)
        if modes_hidden:
            inputs = np.concatenate([force_spectra, weighted_stations(to_force, unexplained)])
            observed = with_driven_modes(record, observed, inputs, corner_hz, gauge_errors)
            inputs = np.concatenate([0 * force_spectra, weighted_stations(to_force, noise_alone.explained)])
            noise_alone = with_driven_modes(record, noise_alone, inputs, corner_hz, gauge_errors)
    return _Weighted(
        responses,
        by_input,
        noise_power,
        observed,
        noise_alone,
        to_force,
        unexplained,
        initial,
        tuple(change.parameter for change in changes),
        corner_hz,
        noise_m,
    )


def _separated(record: SeparationInput, slow_by_gauges: bool) -> ContactForces:
    """Contact forces, and the slow motion of the bodies if gauges shall carry it; raises RigError as `_weighted`."""
    rig, motion, factor, lines = record.rig, record.motion, record.factor, record.lines
    weighted, rate = _weighted(record, slow_by_gauges), motion.sample_rate_hz
    to_force, initial = weighted.to_force, weighted.initial
    contact_spectra = weighted_stations(to_force, weighted.unexplained)
    end_left_out_s = END_LEFT_OUT_S if any(b.length_m for b in rig.bodies) else TAPER_S
    model, slow = None, None
    if slow_by_gauges:
        observed, corner_hz = weighted.observed, weighted.corner_hz
        model = slow_model(rig, motion, lines, corner_hz, weighted.by_input, observed)
        end_left_out_s = max(end_left_out_s, TAPER_S + 2 / corner_hz)
        inputs = np.concatenate([lines.spectra(motion.forces_n), contact_spectra])
        correction = model.correction(inputs, observed.displaced[: len(motion.stations)])
        slow = slow_motion(correction, lines, motion.samples, weighted.noise_m)
    kept_samples = (motion.samples - round(end_left_out_s * rate)) // factor
    nuisance = nuisance_signals(
        weighted.parameters,
        weighted.observed,
        weighted.noise_alone,
        to_force,
        record.signs,
        lines,
        kept_samples,
        model,
    )
    force_n = lines.signals(contact_spectra, kept_samples)
    slow_n_per_m = slow_stiffness(rig, weighted.responses)
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
        noise_n=_noise_n(to_force, weighted.noise_power, motion, lines),
        nuisances=nuisance,
        slow_n_per_m=slow_n_per_m,
        slow_n_s_per_m=slow_damping(rig, weighted.responses, slow_n_per_m),
        slow=slow,
    )


def _noise_n(
    to_force: ToForce, power: Float[np.ndarray, "rows lines"], motion: Kinematics, lines: SpectralLines
) -> Float[np.ndarray, " contacts"]:
    """Standard deviation of the sensors' noise in the contact forces, N.

    It is white in the measured quantity: differentiated n times it has (2 n + 1) (f / f_N)^(2 n) times its mean power
    at the frequency f.
    """
    differentiations = np.zeros((len(power), 1))  # gauges stay as they are
    differentiations[: len(motion.sensors), 0] = [max(0, 2 - s.measures.order) for s in motion.sensors]
    shape = (2 * differentiations + 1) * (lines.omega / (np.pi * lines.rate_hz)) ** (2 * differentiations)
    padded_power = power * shape * lines.length / motion.samples  # over the silence behind, too
    noise_n = weighted_stations(to_force, random_noise(padded_power, 0.0, lines))
    return np.asarray(lines.signals(noise_n, motion.samples // lines.factor).std(axis=1))


def _force_on_mass(rig: Rig, motion: Kinematics, factor: int) -> Float[np.ndarray, "contacts fewer"]:
    """Contact force F - m a - c v - k x on a single mass, which needs no quiet start; F is the sum of all forces."""
    mass = modes_of(rig, rig.bodies[0])
    inverse_mass = float(mass.shapes(np.zeros(1), 1)[0, 0] ** 2)
    omega, damping_ratio = 2 * np.pi * float(mass.frequencies_hz(1)[0]), float(mass.damping_ratios(1)[0])
    resisting = motion.acceleration_m_per_s2[:1] + 2 * damping_ratio * omega * motion.velocity_m_per_s[:1]
    resisting_n = (resisting + omega**2 * motion.displacement_m[:1]) / inverse_mass
    return decimated(force_on_mass(rig, rig.bodies[0], motion.forces_n) - resisting_n, factor)
