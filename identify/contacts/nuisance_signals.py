"""Nuisance signals: contact forces and relative displacements over time by one standard deviation of each parameter."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from identify.contacts.lines import Lines
from identify.linear.model import times
from identify.linear.nuisance import THE_RECORD, Nuisance, NuisanceKind, Observed, changes_of
from identify.signals.drift import KNOT_S

ToForce = Complex[np.ndarray, "contacts stations lines"]


@dataclass(frozen=True)
class NuisanceSignals:
    """Signals that one standard deviation of each nuisance parameter adds to the forces and to the relative
    displacements, in single precision.

    They hold the sensors' noise, too: a share of that of the forces, and of the relative displacements (noise_in_n and
    noise_in_m).
    """

    parameters: tuple[Nuisance, ...]
    force_n: Float[np.ndarray, "nuisances contacts fewer"]
    eta_m: Float[np.ndarray, "nuisances contacts fewer"]
    noise_in_n: Float[np.ndarray, "nuisances contacts"]
    noise_in_m: Float[np.ndarray, "nuisances contacts"]

    def beside(self, kind: NuisanceKind, force_n: Float[np.ndarray, "more contacts fewer"]) -> "NuisanceSignals":
        """Signals with further ones of the record itself, which move no displacement."""
        none = np.zeros(force_n.shape[:2])
        return NuisanceSignals(
            (*self.parameters, *(Nuisance(kind, THE_RECORD, i + 1) for i in range(len(force_n)))),
            np.concatenate([self.force_n, force_n.astype(np.float32)]),
            np.concatenate([self.eta_m, np.zeros(force_n.shape, np.float32)]),
            np.concatenate([self.noise_in_n, none]),
            np.concatenate([self.noise_in_m, none]),
        )

    def after(self, fewer: int) -> "NuisanceSignals":
        """Signals without the first samples."""
        return replace(self, force_n=self.force_n[..., fewer:], eta_m=self.eta_m[..., fewer:])

    def of_contact(self, contact: int) -> "NuisanceSignals":
        """Signals of one contact."""
        return replace(
            self,
            force_n=self.force_n[:, [contact]],
            eta_m=self.eta_m[:, [contact]],
            noise_in_n=self.noise_in_n[:, [contact]],
            noise_in_m=self.noise_in_m[:, [contact]],
        )


def nuisance_signals(
    parameters: tuple[Nuisance, ...],
    observed: Observed,
    noise: Observed,
    to_force: ToForce,
    signs: Float[np.ndarray, "contacts stations"],
    lines: Lines,
    kept: int,
) -> NuisanceSignals:
    """Over `kept` samples, of the parameters of `changes_of(observed)`; noise is what the sensors' noise alone would
    show."""
    count = (len(parameters), len(signs), kept)
    forces, eta = np.empty(count, np.float32), np.zeros(count, np.float32)
    in_n, in_m = np.zeros(count[:2]), np.zeros(count[:2])
    noise_n, noise_eta = weighed(to_force, noise.explained), times(signs, noise.displaced)
    for i, (change, noisy) in enumerate(zip(changes_of(observed), changes_of(noise), strict=True)):
        to_own, own_signs = to_force[:, change.sensors], signs[:, change.sensors]
        forces[i] = lines.in_time(weighed(to_own, change.delivered), kept)
        in_n[i] = _share(noise_n, weighed(to_own, noisy.delivered))
        if change.displaced is not None and noisy.displaced is not None and np.any(own_signs):
            eta[i] = lines.in_time(times(own_signs, change.displaced), kept)
            in_m[i] = _share(noise_eta, times(own_signs, noisy.displaced))
    return NuisanceSignals(parameters, forces, eta, in_n, in_m)


def drawn_noise(
    power: Float[np.ndarray, "stations lines"], least: float, lines: Lines
) -> Complex[np.ndarray, "stations lines"]:
    """Noise of a power spectrum and random phase, above what the drift's knots can follow."""
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, power.shape)
    followed = lines.omega < 2 * np.pi * 0.5 / KNOT_S
    return np.asarray(np.sqrt(np.maximum(power, least)) * np.exp(1j * phase) * ~followed)


def weighed(
    to_force: Complex[np.ndarray, "contacts some lines"], spectra: Complex[np.ndarray, "some lines"]
) -> Complex[np.ndarray, "contacts lines"]:
    return np.asarray(np.einsum("jsf,sf->jf", to_force, spectra))


def _share(
    noise: Complex[np.ndarray, "contacts lines"], of_nuisance: Complex[np.ndarray, "contacts lines"]
) -> Float[np.ndarray, " contacts"]:
    """The multiple of the one that is nearest to the other."""
    size = np.sum(np.abs(noise) ** 2, axis=1)
    product = np.sum((noise.conj() * of_nuisance).real, axis=1)
    return np.divide(product, size, out=np.zeros_like(size), where=size > 0)
