"""Slow displacement of held bodies by the separated contact forces, where strain gauges tell these down to 0 Hz.

Twice integrated, the noise of accelerometers grows towards low frequencies, and below the corner of the kinematics
their displacement is lost. If every body is held, the linear model gives it from the exciting and the separated contact
forces:

    u(x) = (1 - L) u_acceleration(x) + L / -omega^2 (sum_k G(x, x_k) F_k - sum_j G_j(x) f_j)

with the low-pass L from half a corner frequency to itself, chosen for the least noise. An error of f_j, or of the
model, is then one of u.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import Complex, Float

from identify.contacts.station_spectra import SpectralLines
from identify.linear.model import Response, ResponseCache, input_shapes, responses_of
from identify.linear.nuisance import Nuisance, ObservedSignals, changes_of
from identify.signals.kinematics import CORNER_HZ, Kinematics, omega_power
from rig.model.description import Rig

LOWEST_CORNER_HZ = 2 * CORNER_HZ
"""Lowest corner of L, above which the kinematics cut nothing off."""
HIGHEST_CORNER_HZ, CORNER_STEP = 16.0, 2**0.5
"""Highest corner, and the ratio of the corners that are tried."""
NOISE_FORCE_SHARE = 0.05
"""Largest force that the noise of a relative displacement makes by the nominal stiffness of a contact, over its rms."""


def is_held(response: Response) -> bool:
    """True if springs or a clamp hold every mode of a body."""
    return bool(np.all(response.dynamics.natural_hz > 0))


def low_pass(omega: Float[np.ndarray, " lines"], corner_hz: float) -> Float[np.ndarray, " lines"]:
    """L: one below half the corner, zero above it."""
    return np.asarray(1 + omega**2 * omega_power(omega, -2, corner_hz).real)


@dataclass(frozen=True)
class SlowModel:
    """Slow displacement of the stations per newton of each force, and its changes by one standard deviation of the
    nuisance parameters at given forces; low_pass_gain is L at every station whose displacement is integrated."""

    low_pass_gain: Float[np.ndarray, "stations slow"]
    displacements_per_n: Complex[np.ndarray, "inputs stations slow"]
    nuisance_changes: Mapping[Nuisance, Complex[np.ndarray, "stations slow"]]

    def correction(
        self, input_spectra: Complex[np.ndarray, "inputs lines"], displacements: Complex[np.ndarray, "stations lines"]
    ) -> Complex[np.ndarray, "stations slow"]:
        """Slow displacement by exciting and contact forces, less the integrated one."""
        slow_lines = slice(self.low_pass_gain.shape[1])
        force_displacements = np.einsum("isl,il->sl", self.displacements_per_n, input_spectra[:, slow_lines])
        return np.asarray(force_displacements - self.low_pass_gain * displacements[:, slow_lines])

    def displacement_change(
        self,
        parameter: Nuisance,
        contact_force_changes: Complex[np.ndarray, "contacts lines"],
        displacement_changes: Complex[np.ndarray, "stations lines"],
    ) -> Complex[np.ndarray, "stations lines"]:
        """Change of the stations' displacement by a parameter, given its changes of the contact forces and of the
        integrated displacement."""
        slow_count = self.low_pass_gain.shape[1]
        contact_displacements = self.displacements_per_n[-len(contact_force_changes) :]
        slow_changes = np.einsum("isl,il->sl", contact_displacements, contact_force_changes[:, :slow_count])
        slow_changes = slow_changes - self.nuisance_changes.get(parameter, 0.0)
        integrated_motion = (1 - self.low_pass_gain) * displacement_changes[:, :slow_count]
        return np.concatenate([integrated_motion + slow_changes, displacement_changes[:, slow_count:]], axis=1)


def slow_model(
    rig: Rig,
    motion: Kinematics,
    lines: SpectralLines,
    corner_hz: float,
    unit_accelerations: Complex[np.ndarray, "inputs rows lines"],
    observed: ObservedSignals,
) -> SlowModel:
    """Slow model of a rig; `unit_accelerations` are per newton, those of the stations first; `observed` has the
    motion of the modes."""
    station_count, slow_count = len(motion.stations), int(np.count_nonzero(lines.omega < 2 * np.pi * corner_hz))
    omega = lines.omega[:slow_count]
    is_integrated = [float(sensor.measures.order > 0) for sensor in motion.displacement_sensors]
    low_pass_gain = np.outer(is_integrated, low_pass(omega, corner_hz))
    sensor_free_tolerances = msgspec.structs.replace(
        observed.tolerances, gain=0.0, position_m=0.0, delay_s=0.0, high_pass_hz=0.0, sensors={}
    )
    no_motion = np.zeros((station_count, slow_count), dtype=complex)
    responses = responses_of(rig, ResponseCache(omega, 0), zero_known=True)
    slow_signals = ObservedSignals(
        sensors=motion.sensors,
        displacement_sensors=motion.sensors,
        tolerances=sensor_free_tolerances,
        omega=omega,
        sensor_response=(low_pass_gain / -(omega**2)).astype(complex),
        signals=no_motion,
        force_accelerations=observed.force_accelerations[:, :station_count, :slow_count],
        displacements=no_motion,
        bodies=tuple(
            replace(body, response=response, acceleration=body.acceleration[:, :slow_count])
            for body, response in zip(observed.bodies, responses, strict=True)
        ),
    )
    displacements_by_input = unit_accelerations[:, :station_count, :slow_count] * slow_signals.sensor_response
    changes = {change.parameter: change.at_all_sensors(station_count) for change in changes_of(slow_signals)}
    return SlowModel(low_pass_gain, displacements_by_input, changes)


@dataclass(frozen=True)
class SlowMotion:
    """Slow displacement (m) and velocity that every station lacks; eta_noise_m is the noise of each relative
    displacement with it."""

    displacement_m: Float[np.ndarray, "stations samples"]
    velocity_m_per_s: Float[np.ndarray, "stations samples"]
    eta_noise_m: Float[np.ndarray, " contacts"]

    def added_to(self, motion: Kinematics) -> Kinematics:
        """Motion with the slow displacement: its zero is known."""
        return replace(
            motion,
            displacement_m=motion.displacement_m + self.displacement_m,
            velocity_m_per_s=motion.velocity_m_per_s + self.velocity_m_per_s,
            lost_m_per_s2=np.zeros_like(motion.lost_m_per_s2),
            zero_known=True,
            trusted_hz=(0.0, motion.trusted_hz[1]),
            slow_by_gauges=True,
        )

    def is_quiet(self, rig: Rig, force_n: Float[np.ndarray, "contacts samples"]) -> bool:
        """True if the noise of the relative displacements is small against the penetrations by the nominal
        stiffness."""
        stiffnesses_n_per_m = np.array([contact.law.stiffness_n_per_m for contact in rig.contacts])
        return bool(np.all(stiffnesses_n_per_m * self.eta_noise_m <= NOISE_FORCE_SHARE * force_n.std(axis=1)))


def slow_motion(
    correction_spectra: Complex[np.ndarray, "stations slow"],
    lines: SpectralLines,
    sample_count: int,
    eta_noise_m: Float[np.ndarray, " contacts"],
) -> SlowMotion:
    """Slow motion over some samples, at the rate of the record."""
    i_omega = 1j * lines.omega[: correction_spectra.shape[-1]]
    real_at_zero = np.concatenate([correction_spectra[:, :1].real, correction_spectra[:, 1:]], axis=1)
    displacement_m, velocity_m_per_s = (
        np.fft.irfft(spectra, lines.padded_samples)[:, :sample_count]
        for spectra in (real_at_zero, i_omega * correction_spectra)
    )
    return SlowMotion(displacement_m, velocity_m_per_s, eta_noise_m)


def quietest_corner_and_noise(
    eta_signs: Float[np.ndarray, "contacts stations"],
    contact_accelerances: Complex[np.ndarray, "contacts rows lines"],
    force_weights: Complex[np.ndarray, "contacts rows lines"],
    noise_power: Float[np.ndarray, "rows lines"],
    acceleration_power: Float[np.ndarray, "stations lines"],
    lines: SpectralLines,
) -> tuple[float, Float[np.ndarray, " contacts"]]:
    """Corner of L, Hz, with the least noise of the relative displacements, and that noise's standard deviation (m).

    noise_power is that of the rows over the padded record, acceleration_power that of the stations as accelerations:
    integrated twice above the corner, and what all rows make of the contact forces below it.
    """
    omega, station_count = lines.omega, eta_signs.shape[1]
    integrated_noise = np.einsum("cs,sl->cl", eta_signs**2, acceleration_power) / omega**4
    eta_by_contact_force = np.einsum("cs,jsl->cjl", eta_signs, contact_accelerances[:, :station_count]) / omega**2
    eta_by_row = np.einsum("cjl,jrl->crl", eta_by_contact_force, force_weights)
    modelled_noise = np.einsum("crl,rl->cl", np.abs(eta_by_row) ** 2, noise_power)
    highest_hz = min(HIGHEST_CORNER_HZ, omega[-1] / (2 * np.pi))
    corner_count = int(np.log(max(highest_hz / LOWEST_CORNER_HZ, 1.0)) / np.log(CORNER_STEP)) + 1
    corners_hz, noises_m = LOWEST_CORNER_HZ * CORNER_STEP ** np.arange(corner_count), []
    for corner_hz in corners_hz:
        low_pass_gain = low_pass(omega, float(corner_hz))
        noise_power_m2 = low_pass_gain**2 * modelled_noise + (1 - low_pass_gain) ** 2 * integrated_noise
        noises_m.append(np.sqrt(2 * noise_power_m2.sum(axis=1)) / lines.padded_samples)
    quietest_index = int(np.argmin(np.sum(np.array(noises_m) ** 2 / np.min(noises_m, axis=0) ** 2, axis=1)))
    return float(corners_hz[quietest_index]), noises_m[quietest_index]


def with_slow_modes(
    rig: Rig, observed: ObservedSignals, input_spectra: Complex[np.ndarray, "inputs lines"], corner_hz: float
) -> ObservedSignals:
    """Observation in which the modes that springs hold move, below a corner, by the exciting and the contact forces:
    accelerometers do not show it."""
    slow_lines, bodies = slice(int(np.count_nonzero(observed.omega < 2 * np.pi * corner_hz))), []
    for body in observed.bodies:
        response, accelerations = body.response, body.acceleration.copy()
        held_indices = np.flatnonzero(response.dynamics.natural_hz[: len(accelerations)]).tolist()
        held_indices = [mode for mode in held_indices if mode not in response.dynamics.slowly_free_modes]
        modal_force = input_shapes(rig, response, rig.forces)[:, held_indices].T @ input_spectra[:, slow_lines]
        accelerations[held_indices, slow_lines] = response.accelerance[held_indices, slow_lines] * modal_force
        bodies.append(replace(body, acceleration=accelerations))
    return replace(observed, bodies=tuple(bodies))
