"""NIFO: regression with the contact force as a further input, at each frequency (paper, equations 4, 5, 23 to 28)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float

from identify.linear.modal import ModalEquation, receptance
from identify.signals.regression import influences, jackknife_variance, weights_by_line
from identify.signals.spectra import Blocks, WindowedTerm
from rig.errors import RigError

NifoForm = Literal["weak", "paper"]


@dataclass(frozen=True)
class Nifo:
    """Result of NIFO in one modal equation.

    frf is q over the modal force (s^2); stiffness_n_per_m is the complex contact stiffness of each contact that takes
    part, and contact_indices are their indices. stiffness_error_n_per_m is the standard error of the spectral means.
    """

    equation: ModalEquation
    contact_indices: tuple[int, ...]
    frequency_hz: Float[np.ndarray, " lines"]
    frf: Complex[np.ndarray, " lines"]
    stiffness_n_per_m: Complex[np.ndarray, "contacts lines"]
    stiffness_error_n_per_m: Float[np.ndarray, " contacts"]
    average_count: int
    resolution_hz: float

    @property
    def mean_n_per_m(self) -> Float[np.ndarray, " contacts"]:
        """Spectral mean of the real part."""
        return self.stiffness_n_per_m.real.mean(axis=1)

    @property
    def deviation_n_per_m(self) -> Float[np.ndarray, " contacts"]:
        """Rms over frequency of the deviation from the spectral mean."""
        return np.sqrt(np.mean(np.abs(self.stiffness_n_per_m - self.mean_n_per_m[:, None]) ** 2, axis=1))

    def described_frf(self) -> Complex[np.ndarray, " lines"]:
        """FRF of the mode as the rig's description has it."""
        return receptance(self.equation.frequency_hz, self.equation.damping_ratio, self.frequency_hz)


def nifo(
    equation: ModalEquation,
    force_n: Float[np.ndarray, " samples"],
    penetration_m: Float[np.ndarray, "contacts samples"],
    blocks: Blocks,
    form: NifoForm = "weak",
) -> Nifo:
    """Regression of the modal coordinate on the modal force and the penetrations, line by line over the blocks.

    The paper's form is Q = H (phi_F F - sum_j phi_j k_j P_j) with spectra under the window w; it leaks, as the window
    does not commute with the derivatives in the equation of motion. The weak form keeps the window's derivatives: with
    Q' and Q'' the spectra of q under w' and w'' ::

        Q = H (phi_F F - Q'' + 2 i omega Q' - sum_j phi_j k_j P_j) + 2 zeta omega_0 H Q'

    which is exact for any motion, since w and w' vanish at a block's ends.

    Contacts that are not visible in the equation, or that never close, take no part. Raises RigError if there are not
    more blocks than unknowns.
    """
    contact_indices = tuple(j for j, visible in enumerate(equation.is_visible) if visible and np.any(penetration_m[j]))
    unknown_count = 1 + len(contact_indices) + (form == "weak")
    if len(blocks.starts) <= unknown_count:
        raise RigError(
            f"{len(blocks.starts)} blocks for {unknown_count} unknowns a line; use shorter blocks or record longer"
        )
    displacement = equation.displacement
    channel_terms = [[WindowedTerm(force_n, factor=equation.shape_at_force)]]
    channel_terms += [[WindowedTerm(penetration_m[j], factor=equation.shape_at_contacts[j])] for j in contact_indices]
    if form == "weak":
        channel_terms[0].append(WindowedTerm(displacement, derivative_order=2, factor=-1.0))
        channel_terms.append([WindowedTerm(displacement, derivative_order=1)])
    channel_terms.append([WindowedTerm(displacement)])
    derivative_factor = 2j * 2 * np.pi * blocks.frequency_hz

    def channel_spectra(block_indices: Sequence[int]) -> Complex[np.ndarray, "channels blocks lines"]:
        spectra = blocks.spectra_of_sums(channel_terms, [blocks.starts[k] for k in block_indices])
        if form == "weak":
            spectra[0] += derivative_factor * spectra[-2]
        return spectra

    input_weights, inverse_normals = weights_by_line(channel_spectra, len(blocks.starts))
    frf, contact_columns = input_weights[:, 0], slice(1, 1 + len(contact_indices))
    stiffness_n_per_m = -input_weights[:, contact_columns] / frf[:, None]

    def mean_stiffness_influence(
        weight_changes: Complex[np.ndarray, "chunk blocks unknowns"], chunk: slice
    ) -> Float[np.ndarray, "blocks contacts"]:
        """Changes of the spectral means of the stiffness k = -w / H by those of the weights w and of the FRF H."""
        contact_weight_changes, frf_changes = weight_changes[:, :, contact_columns], weight_changes[:, :, :1]
        stiffness_changes = -(
            (contact_weight_changes + stiffness_n_per_m[chunk, None] * frf_changes) / frf[chunk, None, None]
        )
        return stiffness_changes.real.sum(axis=0) / frf.size

    def block_influences(block_indices: Sequence[int]) -> Float[np.ndarray, "blocks contacts"]:
        return influences(channel_spectra, block_indices, input_weights, inverse_normals, mean_stiffness_influence)

    mean_variances = jackknife_variance(block_influences, len(blocks.starts))
    return Nifo(
        equation=equation,
        contact_indices=contact_indices,
        frequency_hz=blocks.frequency_hz,
        frf=frf,
        stiffness_n_per_m=stiffness_n_per_m.T,
        stiffness_error_n_per_m=np.sqrt(mean_variances),
        average_count=len(blocks.starts),
        resolution_hz=blocks.resolution_hz,
    )


def fit_mode(nifo_result: Nifo) -> tuple[float, float]:
    """Natural frequency (Hz) and damping ratio fitted to the FRF: 1/H = omega_0^2 - omega^2 + 2 i zeta omega_0 omega.

    Linear least squares of H (omega_0^2 + i omega g) = 1 + omega^2 H, so that resonance and noise weigh as in H.
    """
    omega = 2 * np.pi * nifo_result.frequency_hz
    columns = np.stack([nifo_result.frf, 1j * omega * nifo_result.frf], axis=1)
    target = 1 + omega**2 * nifo_result.frf
    real_columns, real_target = np.concatenate([columns.real, columns.imag]), np.concatenate([target.real, target.imag])
    (natural_omega_squared, damping_rate), *_ = np.linalg.lstsq(real_columns, real_target, rcond=None)
    natural_rad_per_s = float(np.sqrt(max(float(natural_omega_squared), 0.0)))
    damping_ratio = float(damping_rate) / (2 * natural_rad_per_s) if natural_rad_per_s > 0 else 0.0
    return natural_rad_per_s / (2 * np.pi), damping_ratio
