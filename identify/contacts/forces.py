"""Contact forces over time, separated without a law by all stations, strain gauges and the linear model:
f = W (A - G_F F)."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.contacts.nuisance_signals import (
    ForceWeights,
    NuisanceSignals,
    contact_spectra,
    nuisance_signals,
    random_phase_noise_spectra,
)
from identify.contacts.observation import (
    SeparationInput,
    noise_observation,
    observation_of,
    station_rows,
    with_driven_modes,
)
from identify.contacts.slow_motion import (
    LOWEST_CORNER_HZ,
    SlowMotion,
    is_held,
    quietest_corner_and_noise,
    slow_model,
    slow_motion,
    with_slow_modes,
)
from identify.contacts.station_spectra import (
    SpectralLines,
    StationErrors,
    force_weights,
    has_hidden_modes,
    start_free_motion,
    start_transient_s,
)
from identify.linear.free_motion import FreeMotionEstimate
from identify.linear.modal import force_on_mass
from identify.linear.model import Response, ResponseCache, accelerances, responses_of
from identify.linear.nuisance import Nuisance, NuisanceKind, ObservedSignals, changes_of
from identify.linear.slow_stiffness import slow_damping, slow_stiffness
from identify.signals.drift import slow_force_density
from identify.signals.kinematics import CORNER_HZ, TAPER_S, Kinematics, omega_power
from identify.signals.spectra import at_force_rate
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.modes import modes_of

END_TRANSIENT_S = 2.5
"""End of a record in which the separated forces are wrong, as the beams' ringing is cut off."""
LEAST_INITIAL_SHARE = 1e-4
"""Least force by an initial state over the contact forces; smaller ones are left out."""
LEAST_SLOW_FORCE = 1e-9
"""Least density of a slow force, N/s^2/sqrt(Hz): in place of zero."""


@dataclass(frozen=True)
class ContactForces:
    """Contact forces (N), low-passed and sampled at the record's rate over `decimation`.

    slow_motion is that of held bodies where strain gauges tell it, else None. noise_n is the standard deviation of the
    sensors' noise in them. slow_n_per_m and slow_n_s_per_m are the stiffness and damping against slow relative
    displacements, whose forces accelerations do not show; slow_force_density is that of
    `_slow_force_error_densities`.
    """

    force_n: Float[np.ndarray, "contacts fewer"]
    decimation: int
    noise_n: Float[np.ndarray, " contacts"]
    nuisances: NuisanceSignals
    slow_n_per_m: Float[np.ndarray, "contacts contacts"]
    slow_n_s_per_m: Float[np.ndarray, "contacts contacts"]
    slow_force_density: Float[np.ndarray, " contacts"]
    slow_motion: SlowMotion | None = None

    def of_contacts(self, indices: list[int]) -> "ContactForces":
        """Forces of some contacts, without slow motion."""
        pairs = np.ix_(indices, indices)
        return ContactForces(
            self.force_n[indices],
            self.decimation,
            self.noise_n[indices],
            self.nuisances.of_contacts(indices),
            self.slow_n_per_m[pairs],
            self.slow_n_s_per_m[pairs],
            self.slow_force_density[indices],
        )

    def without_start(self, sample_count: int) -> "ContactForces":
        """Contact forces without their first samples."""
        nuisances = self.nuisances.without_start(sample_count)
        return replace(self, force_n=self.force_n[:, sample_count:], nuisances=nuisances)


def separated_forces(record: SeparationInput) -> ContactForces:
    """Contact forces of all bodies by all their stations and strain gauges.

    Where the zero of displacements is known, displacements of bodies that are held replace their slow accelerations;
    else strain gauges tell the slow forces, and these the slow displacements of held bodies, if that is quiet enough
    (`SlowMotion.is_quiet`). In a record that does not begin at rest the free motion of every mode is estimated as well,
    and its remaining uncertainty is a nuisance.

    Raises RigError if the stations or the modes cannot tell the contacts apart.
    """
    if record.gauges.sensors and not record.motion.zero_known:
        try:
            forces = _contact_forces(record, slow_by_gauges=True)
        except RigError:
            forces = None
        if forces and forces.slow_motion and forces.slow_motion.is_quiet(record.rig, forces.force_n):
            return forces
    return _contact_forces(record, slow_by_gauges=False)


@dataclass(frozen=True, eq=False)
class _SeparationWeights:
    """Stations and gauges weighed against each other: weights of the contact forces, what no exciting force explains,
    and the observations behind, of the signals and of their noise alone.

    corner_hz is that below which held modes move by the forces, eta_noise_m the noise of relative displacements then.
    """

    responses: tuple[Response, ...]
    input_accelerances: Complex[np.ndarray, "inputs rows lines"]
    noise_power: Float[np.ndarray, "rows lines"]
    observed: ObservedSignals
    observed_noise: ObservedSignals
    force_weights: ForceWeights
    unexplained_signals: Complex[np.ndarray, "rows lines"]
    start_motion: FreeMotionEstimate | None
    parameters: tuple[Nuisance, ...]
    corner_hz: float
    eta_noise_m: Float[np.ndarray, " contacts"]


def _separation_weights(record: SeparationInput, slow_by_gauges: bool) -> _SeparationWeights:
    """Weights of the contact forces, again with the hidden and the slow modes where the first forces move some.

    Raises RigError as `separated_forces`, and if gauges shall tell the slow motion of a body that is_floating.
    """
    rig, motion, gauges, lines = record.rig, record.motion, record.gauges, record.lines
    force_count, station_count = len(rig.inputs), len(motion.stations)
    responses = responses_of(rig, ResponseCache(lines.omega, 0), motion.zero_known or slow_by_gauges)
    is_floating = {response.body.name: not is_held(response) for response in responses}
    if slow_by_gauges and any(is_floating.values()):
        raise RigError("a body is_floating, whose slow motion no strain gauge shows")
    stations = station_rows(record, lines, np.array([not is_floating[station.body] for station in motion.stations]))
    accelerance = accelerances(rig, responses, rig.inputs, [*motion.sensors, *gauges.sensors])
    excitations = lines.spectra(motion.forces_n)
    input_accelerations = accelerance[:force_count] * excitations[:, None]
    observed, further_errors, noise_power = observation_of(record, lines, responses, stations, input_accelerations)
    signals, sensor_response = observed.signals, observed.sensor_response
    least_noise_power = 1e-12 * float(np.mean(np.abs(signals) ** 2))
    observed_noise = noise_observation(
        rig, motion, observed, random_phase_noise_spectra(noise_power, least_noise_power, lines)
    )
    lacks_slow_motion = bool(gauges.sensors)
    if motion.zero_known:
        lacks_slow_motion = any(sensor.measures.order > 0 for sensor in motion.displacement_sensors)
    corner_hz = LOWEST_CORNER_HZ if lacks_slow_motion else 0.0
    observed = replace(observed, further_changes=further_errors.changes(excitations))
    observed_noise = replace(observed_noise, further_changes=further_errors.changes(0 * excitations))
    if corner_hz:  # held modes rest as long as no contact force is known
        no_inputs = np.zeros((len(accelerance), lines.omega.size), dtype=complex)
        observed, observed_noise = (with_slow_modes(rig, o, no_inputs, corner_hz) for o in (observed, observed_noise))
    start_motion, eta_noise_m = None, np.zeros(len(rig.contacts))
    has_hidden = any(has_hidden_modes(response, motion) for response in responses)
    has_driven_modes = corner_hz > 0 or bool(further_errors.truncations) or has_hidden
    for is_first_pass in (True, False) if has_driven_modes else (False,):
        changes = tuple(change.in_single_precision for change in changes_of(observed))
        # without the zeros of gauges, which are at 0 Hz
        weighed_changes = tuple(change for change in changes if change.parameter.kind is not NuisanceKind.ZERO)
        errors = StationErrors(noise_power, least_noise_power, weighed_changes, lines.correlated_line_count)
        contact_weights = force_weights(accelerance[force_count:] * sensor_response, errors) * lines.force_gain
        unexplained_signals = signals - sensor_response * input_accelerations.sum(axis=0)
        if not record.begins_at_rest:
            start_motion = start_free_motion(responses, motion, stations, lines, sensor_response * accelerance, errors)
            unexplained_signals = unexplained_signals - start_motion.signals
        if slow_by_gauges:
            padded_power = noise_power * (lines.padded_samples / motion.sample_count)
            acceleration_power = padded_power[:station_count] / np.abs(stations.response) ** 2
            corner_hz, eta_noise_m = quietest_corner_and_noise(
                record.eta_signs, accelerance[force_count:], contact_weights, padded_power, acceleration_power, lines
            )
        if is_first_pass:
            input_spectra = np.concatenate([excitations, contact_spectra(contact_weights, unexplained_signals)])
            further_errors = further_errors.without_negligible(input_spectra, signals)
            observed = with_driven_modes(record, observed, input_spectra, corner_hz, further_errors)
            input_spectra = np.concatenate([0 * excitations, contact_spectra(contact_weights, observed_noise.signals)])
            observed_noise = with_driven_modes(record, observed_noise, input_spectra, corner_hz, further_errors)
    return _SeparationWeights(
        responses=responses,
        input_accelerances=accelerance,
        noise_power=noise_power,
        observed=observed,
        observed_noise=observed_noise,
        force_weights=contact_weights,
        unexplained_signals=unexplained_signals,
        start_motion=start_motion,
        parameters=tuple(change.parameter for change in changes),
        corner_hz=corner_hz,
        eta_noise_m=eta_noise_m,
    )


def _contact_forces(record: SeparationInput, slow_by_gauges: bool) -> ContactForces:
    """Contact forces, and the slow motion of the bodies if gauges shall carry it; raises RigError as
    `_separation_weights`."""
    rig, motion, decimation, lines, signs = record.rig, record.motion, record.decimation, record.lines, record.eta_signs
    weighed, rate_hz = _separation_weights(record, slow_by_gauges), motion.sample_rate_hz
    weights, start_motion = weighed.force_weights, weighed.start_motion
    contact_force_spectra = contact_spectra(weights, weighed.unexplained_signals)
    end_transient_s = END_TRANSIENT_S if any(body.length_m for body in rig.bodies) else TAPER_S
    slow_gains, gauged_motion = None, None
    if slow_by_gauges:
        slow_gains = slow_model(rig, motion, lines, weighed.corner_hz, weighed.input_accelerances, weighed.observed)
        end_transient_s = max(end_transient_s, TAPER_S + 2 / weighed.corner_hz)
        input_spectra = np.concatenate([lines.spectra(motion.forces_n), contact_force_spectra])
        correction = slow_gains.correction(input_spectra, weighed.observed.displacements[: len(motion.stations)])
        gauged_motion = slow_motion(correction, lines, motion.sample_count, weighed.eta_noise_m)
    kept_count = (motion.sample_count - round(end_transient_s * rate_hz)) // decimation
    nuisances = nuisance_signals(
        weighed.parameters, weighed.observed, weighed.observed_noise, weights, signs, lines, kept_count, slow_gains
    )
    force_n = lines.signals(contact_force_spectra, kept_count)
    slow_n_per_m = slow_stiffness(rig, weighed.responses)
    if record.is_single_mass:
        spectral_force_n, force_n = force_n, _single_mass_contact_force_n(rig, motion, decimation)[:, :kept_count]
        # so that a mass is in proportion to the force that it tells
        force_shares = nuisances.force_n @ spectral_force_n[0] / max(float(np.sum(spectral_force_n**2)), 1e-300)
        corrected_n = nuisances.force_n + force_shares[..., None] * (force_n - spectral_force_n)
        nuisances = replace(nuisances, force_n=corrected_n.astype(np.float32))
    elif start_motion:
        settled_sample = min(round(start_transient_s(rig, slow_n_per_m) * rate_hz / decimation), kept_count - 1)
        state_forces_n = lines.signals(np.einsum("jsf,isf->ijf", weights, start_motion.unit_spectra), kept_count)
        state_forces_n = np.tensordot(start_motion.error_root.T, state_forces_n, 1)
        state_rms_n = np.sqrt(np.mean(state_forces_n[..., settled_sample:] ** 2, axis=(1, 2)))
        nuisances = nuisances.with_initial_states(state_forces_n[state_rms_n > LEAST_INITIAL_SHARE * force_n.std()])
    slow_n_s_per_m = slow_damping(rig, weighed.responses, slow_n_per_m)
    return ContactForces(
        force_n=force_n,
        decimation=decimation,
        noise_n=_force_noise_n(weights, weighed.noise_power, motion, lines),
        nuisances=nuisances,
        slow_n_per_m=slow_n_per_m,
        slow_n_s_per_m=slow_n_s_per_m,
        slow_force_density=_slow_force_error_densities(record, weighed, slow_n_per_m, slow_n_s_per_m),
        slow_motion=gauged_motion,
    )


def _force_noise_n(
    weights: ForceWeights, noise_power: Float[np.ndarray, "rows lines"], motion: Kinematics, lines: SpectralLines
) -> Float[np.ndarray, " contacts"]:
    """Standard deviation of the sensors' noise in the contact forces, N."""
    padded_noise_power = noise_power * lines.padded_samples / motion.sample_count  # over the silence behind, too
    force_noise_spectra = contact_spectra(weights, random_phase_noise_spectra(padded_noise_power, 0.0, lines))
    return np.asarray(lines.signals(force_noise_spectra, motion.sample_count // lines.decimation).std(axis=1))


def _slow_force_error_densities(
    record: SeparationInput,
    weighed: _SeparationWeights,
    slow_n_per_m: Float[np.ndarray, "contacts contacts"],
    slow_n_s_per_m: Float[np.ndarray, "contacts contacts"],
) -> Float[np.ndarray, " contacts"]:
    """Densities s_z of slow errors of held contacts' forces that no error of the relative displacement makes,
    N/s^2/sqrt(Hz); zero where no spring holds a contact.

    Noise n of the accelerations, and their motion across the axes, is an error W n of a separated force and
    -signs n / omega^2 of eta, which a spring k and a damper c beside the contact turn into a force. Of what remains,

        z = (W - (k + i omega c) signs / omega^2) n,

    `slow_force_density` is that of z.
    """
    motion, lines, rate_hz = record.motion, record.lines, record.motion.sample_rate_hz
    station_count, omega = len(motion.stations), lines.omega
    springs_n_per_m, dampers_n_s_per_m = np.diag(slow_n_per_m), np.diag(slow_n_s_per_m)
    error_power = weighed.noise_power.copy()
    station_power = np.abs(weighed.observed.signals[:station_count]) ** 2
    error_power[:station_count] += record.tolerances.lateral_motion**2 * uniform_filter1d(
        station_power, lines.correlated_line_count, axis=1
    )
    ground_n_per_m = springs_n_per_m[:, None] + 1j * np.outer(dampers_n_s_per_m, omega)
    force_errors = weighed.force_weights.copy()
    force_errors[:, :station_count] += (
        record.eta_signs[:, :, None] * (ground_n_per_m * omega_power(omega, -2, CORNER_HZ))[:, None]
    )
    density = 2 / (rate_hz * motion.sample_count) * np.einsum("jsf,sf->jf", np.abs(force_errors) ** 2, error_power)
    densities = [slow_force_density(contact_density, omega)[0] for contact_density in density]
    return np.where(springs_n_per_m > 0, np.maximum(densities, LEAST_SLOW_FORCE), 0.0)


def _single_mass_contact_force_n(rig: Rig, motion: Kinematics, decimation: int) -> Float[np.ndarray, "contacts fewer"]:
    """Contact force F - m a - c v - k x on a single mass, which needs no quiet start; F is the sum of all forces."""
    modes = modes_of(rig, rig.bodies[0])
    inverse_mass = float(modes.shapes(np.zeros(1), 1)[0, 0] ** 2)
    omega, damping_ratio = 2 * np.pi * float(modes.frequencies_hz(1)[0]), float(modes.damping_ratios(1)[0])
    resisting_m_per_s2 = motion.acceleration_m_per_s2[:1] + 2 * damping_ratio * omega * motion.velocity_m_per_s[:1]
    resisting_n = (resisting_m_per_s2 + omega**2 * motion.displacement_m[:1]) / inverse_mass
    return at_force_rate(force_on_mass(rig, rig.bodies[0], motion.forces_n) - resisting_n, decimation)
