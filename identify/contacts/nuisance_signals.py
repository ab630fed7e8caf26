"""Signals that one standard deviation of every nuisance parameter adds to separated contact forces and to relative
displacements, and the sensors' noise in both."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from identify.contacts.slow_motion import SlowModel
from identify.contacts.station_spectra import SpectralLines
from identify.linear.model import real_product
from identify.linear.nuisance import RECORD_NAME, Nuisance, NuisanceKind, ObservedSignals, changes_of
from identify.signals.drift import HIGHEST_DRIFT_HZ

ForceWeights = Complex[np.ndarray, "contacts rows lines"]


@dataclass(frozen=True)
class NuisanceSignals:
    """Signals that one standard deviation of each nuisance parameter adds to the contact forces and to the relative
    displacements, in single precision.

    force_noise_multiple and eta_noise_multiple are the multiples of the sensors' noise of forces and displacements
    that they contain.
    """

    parameters: tuple[Nuisance, ...]
    force_n: Float[np.ndarray, "nuisances contacts fewer"]
    eta_m: Float[np.ndarray, "nuisances contacts fewer"]
    force_noise_multiple: Float[np.ndarray, "nuisances contacts"]
    eta_noise_multiple: Float[np.ndarray, "nuisances contacts"]

    def with_initial_states(self, force_n: Float[np.ndarray, "more contacts fewer"]) -> "NuisanceSignals":
        """Signals with the contact forces by initial states, which change no displacement."""
        state_parameters = (Nuisance(NuisanceKind.INITIAL_STATE, RECORD_NAME, k + 1) for k in range(len(force_n)))
        zero_multiples = np.zeros(force_n.shape[:2])
        return NuisanceSignals(
            (*self.parameters, *state_parameters),
            np.concatenate([self.force_n, force_n.astype(np.float32)]),
            np.concatenate([self.eta_m, np.zeros(force_n.shape, np.float32)]),
            np.concatenate([self.force_noise_multiple, zero_multiples]),
            np.concatenate([self.eta_noise_multiple, zero_multiples]),
        )

    def of_contacts(self, indices: list[int]) -> "NuisanceSignals":
        """Signals of some contacts."""
        return NuisanceSignals(
            self.parameters,
            self.force_n[:, indices],
            self.eta_m[:, indices],
            self.force_noise_multiple[:, indices],
            self.eta_noise_multiple[:, indices],
        )

    def without_start(self, sample_count: int) -> "NuisanceSignals":
        """Signals without their first samples."""
        return replace(self, force_n=self.force_n[..., sample_count:], eta_m=self.eta_m[..., sample_count:])


def nuisance_signals(
    parameters: tuple[Nuisance, ...],
    observed: ObservedSignals,
    observed_noise: ObservedSignals,
    contact_weights: ForceWeights,
    signs: Float[np.ndarray, "contacts stations"],
    lines: SpectralLines,
    sample_count: int,
    slow_model: SlowModel | None = None,
) -> NuisanceSignals:
    """Nuisance signals of the parameters of `changes_of(observed)` over some samples.

    `observed_noise` is the observation of the sensors' noise; the stations are the first rows of both. With a slow
    model, what a parameter adds to the contact forces moves the stations slowly.
    """
    row_count, station_count = contact_weights.shape[1], signs.shape[1]
    signs = np.pad(signs, ((0, 0), (0, row_count - station_count)))
    signal_shape = (len(parameters), len(signs), sample_count)
    force_n, eta_m = np.empty(signal_shape, np.float32), np.zeros(signal_shape, np.float32)
    force_noise_multiple, eta_noise_multiple = np.zeros(signal_shape[:2]), np.zeros(signal_shape[:2])
    noise_force_spectra = contact_spectra(contact_weights, observed_noise.signals)
    noise_eta_spectra = real_product(signs, observed_noise.displacements)
    change_pairs = zip(changes_of(observed), changes_of(observed_noise), strict=True)
    for parameter_index, (change, noise_change) in enumerate(change_pairs):
        sensor_weights, sensor_signs = contact_weights[:, change.sensors], signs[:, change.sensors]
        force_spectra = contact_spectra(sensor_weights, change.signals)
        force_n[parameter_index] = lines.signals(force_spectra, sample_count)
        noise_force_change = contact_spectra(sensor_weights, noise_change.signals)
        force_noise_multiple[parameter_index] = _noise_multiple(noise_force_spectra, noise_force_change)
        moves_contact = np.any(sensor_signs)
        if slow_model is not None:
            displacements = np.zeros((row_count, change.signals.shape[1]), dtype=complex)
            displacements[change.sensors] = 0.0 if change.displacements is None else change.displacements
            slow_change = slow_model.displacement_change(change.parameter, force_spectra, displacements[:station_count])
            eta_m[parameter_index] = lines.signals(real_product(signs[:, :station_count], slow_change), sample_count)
        elif moves_contact and change.displacements is not None:
            eta_m[parameter_index] = lines.signals(real_product(sensor_signs, change.displacements), sample_count)
        if moves_contact and not (change.displacements is None or noise_change.displacements is None):
            noise_eta_change = real_product(sensor_signs, noise_change.displacements)
            eta_noise_multiple[parameter_index] = _noise_multiple(noise_eta_spectra, noise_eta_change)
    return NuisanceSignals(parameters, force_n, eta_m, force_noise_multiple, eta_noise_multiple)


def random_phase_noise_spectra(
    noise_power: Float[np.ndarray, "stations lines"], least_power: float, lines: SpectralLines
) -> Complex[np.ndarray, "stations lines"]:
    """Spectra of noise with this power and random phases; zero where the drift's knots can follow it."""
    phase_rad = np.random.default_rng(0).uniform(0, 2 * np.pi, noise_power.shape)
    is_drift_line = lines.omega < 2 * np.pi * HIGHEST_DRIFT_HZ
    return np.asarray(np.sqrt(np.maximum(noise_power, least_power)) * np.exp(1j * phase_rad) * ~is_drift_line)


def contact_spectra(
    weights: Complex[np.ndarray, "contacts some lines"], spectra: Complex[np.ndarray, "some lines"]
) -> Complex[np.ndarray, "contacts lines"]:
    """Spectra of the contact forces: the weighted sum over the stations."""
    return np.asarray(np.einsum("jsf,sf->jf", weights, spectra))


def _noise_multiple(
    noise_spectra: Complex[np.ndarray, "contacts lines"], nuisance_spectra: Complex[np.ndarray, "contacts lines"]
) -> Float[np.ndarray, " contacts"]:
    """Multiple of the noise that is nearest to the nuisance, by least squares."""
    noise_power = np.sum(np.abs(noise_spectra) ** 2, axis=1)
    cross_power = np.sum((noise_spectra.conj() * nuisance_spectra).real, axis=1)
    return np.divide(cross_power, noise_power, out=np.zeros_like(noise_power), where=noise_power > 0)
