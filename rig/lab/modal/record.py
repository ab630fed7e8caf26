"""A structure fitted to a measured force and the responses to it: modes by H1 FRFs, then by least output error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.lab.modal.fit import Lines, ModalFit, fit_modes, lines_in_band
from rig.lab.modal.refine import ResponseMap, refined_by_frfs, refined_by_output_error, unit_residue_accelerances
from rig.model.structure import Structure, structure_of
from rig.recording.period import force_period_samples

MIN_FORCE_SHARE = 1e-3
"""Least power density of the force at a line that is used, relative to its largest."""
AVERAGE_COUNT = 8
"""Averages, overlapping by half, for a force that does not repeat."""
DECAY_FACTOR = 100.0
"""Decay of a free vibration after which the misfit is evaluated."""


@dataclass(frozen=True)
class MeasuredResponse:
    """A force (N) and responses to it at one rate: displacements, velocities or accelerations (order 0, 1, 2; SI)."""

    force_n: Float[np.ndarray, " samples"]
    responses: Float[np.ndarray, "sensors samples"]
    derivative_order: int
    sample_rate_hz: float


@dataclass(frozen=True)
class FittedRecord:
    """Fitted body, the misfit of its free run and the noise of the sensors.

    frf_fit_misfits and misfits are the rms error over the rms of each response, by modes on the FRFs alone and after
    the refinement. unmodelled_share is the rms of that beyond the noise, over all sensors. noise_density is one-sided,
    in the response's unit per sqrt(Hz), by the median over the lines that the force does not excite.
    """

    body: Structure
    frf_fit_misfits: Float[np.ndarray, " sensors"]
    misfits: Float[np.ndarray, " sensors"]
    unmodelled_share: float
    noise_density: Float[np.ndarray, " sensors"]
    period_s: float | None
    band_hz: tuple[float, float]


def fit_record(
    measured: MeasuredResponse,
    positions_m: Sequence[float],
    driving_index: int,
    length_m: float,
    band_hz: tuple[float, ...] = (),
    name: str = "structure",
) -> FittedRecord:
    """Modes fitted to the responses to a measured force; sensor `driving_index` is at the force.

    The FRFs are H1 = S_fy / S_ff: over whole periods of a force that repeats, without the first one, else over Hann
    blocks that overlap by half. `fit_modes` finds the modes in the band, `refine` minimises their output error. Raises
    RigError if no mode is found.
    """
    period_samples = force_period_samples(measured.force_n)
    line_hz, force_density, frfs, noise_density = _h1_frfs_and_densities(measured, period_samples)
    is_used = (line_hz > 0) & (force_density > MIN_FORCE_SHARE * force_density.max())
    is_used &= lines_in_band(line_hz, band_hz)
    if not is_used.any():
        raise RigError("the force excites no line in band_hz; give a band that it excites")
    line_hz, frfs, force_amplitudes = line_hz[is_used], frfs[:, is_used], np.sqrt(force_density[is_used])
    accelerance = frfs * (2j * np.pi * line_hz) ** (2 - measured.derivative_order)
    frf_modes = fit_modes(line_hz, accelerance, driving_index)
    error_weights = force_amplitudes / (2 * np.pi * line_hz) ** (2 - measured.derivative_order)
    modes = refined_by_frfs(line_hz, accelerance, error_weights, frf_modes, driving_index)
    used_band_hz = float(line_hz[0]), float(line_hz[-1])
    modes = refined_by_output_error(
        *_response_spectra_and_map(measured, modes, used_band_hz), used_band_hz, modes, driving_index
    )
    position_order = np.argsort(positions_m)
    sorted_m, shapes = np.array(positions_m, dtype=float)[position_order], modes.shapes(driving_index)[position_order]
    misfits = _free_run_misfits(measured, modes)
    noise_shares = noise_density * np.sqrt(measured.sample_rate_hz / 2) / measured.responses.std(axis=1)
    return FittedRecord(
        body=structure_of(name, length_m, modes.frequencies_hz, modes.damping_ratios, sorted_m, shapes),
        frf_fit_misfits=_free_run_misfits(measured, frf_modes),
        misfits=misfits,
        unmodelled_share=float(np.sqrt(np.mean(np.maximum(misfits**2 - noise_shares**2, 0.0)))),
        noise_density=noise_density,
        period_s=None if period_samples is None else period_samples / measured.sample_rate_hz,
        band_hz=used_band_hz,
    )


def free_run(measured: MeasuredResponse, modal_fit: ModalFit) -> Float[np.ndarray, "sensors samples"]:
    """Responses of the modes to the measured force from rest, zero-padded behind the record."""
    force_spectrum, line_hz, response_by_acceleration = _force_spectrum_and_integrator(measured, modal_fit)
    spectra = response_by_acceleration * unit_residue_accelerances(
        line_hz, modal_fit.frequencies_hz, modal_fit.damping_ratios
    )
    modal_responses = scipy.fft.irfft(force_spectrum * spectra, 2 * (line_hz.size - 1))[:, : measured.force_n.size]
    return np.asarray(modal_fit.residues @ modal_responses)


def _force_spectrum_and_integrator(
    measured: MeasuredResponse, modal_fit: ModalFit
) -> tuple[Complex[np.ndarray, " lines"], Float[np.ndarray, " lines"], Complex[np.ndarray, " lines"]]:
    """Spectrum of the zero-padded force, its frequencies (Hz), and (i omega)^(order - 2), which is 0 at 0 Hz.

    That leaves out the means, which accelerometers do not measure.
    """
    sample_count, rate_hz = measured.force_n.size, measured.sample_rate_hz
    padding_s = min(_decay_time_s(modal_fit), sample_count / rate_hz)
    padded_length = 2 * scipy.fft.next_fast_len(sample_count // 2 + round(padding_s * rate_hz / 2) + 1)
    line_hz = np.fft.rfftfreq(padded_length, 1 / rate_hz)
    response_by_acceleration = np.zeros(line_hz.size, dtype=complex)
    response_by_acceleration[1:] = (2j * np.pi * line_hz[1:]) ** (measured.derivative_order - 2)
    return scipy.fft.rfft(measured.force_n, padded_length), line_hz, response_by_acceleration


def _response_spectra_and_map(
    measured: MeasuredResponse, modal_fit: ModalFit, band_hz: tuple[float, float]
) -> tuple[Complex[np.ndarray, "sensors lines"], ResponseMap, Float[np.ndarray, " all"]]:
    """Spectra of the responses in the band, a map from accelerances to those of a free run, and its lines (Hz)."""
    first_sample, sample_count = _first_decayed_sample(measured, modal_fit), measured.force_n.size
    force_spectrum, line_hz, response_by_acceleration = _force_spectrum_and_integrator(measured, modal_fit)
    is_in_band = lines_in_band(np.fft.rfftfreq(sample_count - first_sample, 1 / measured.sample_rate_hz), band_hz)
    is_simulated = line_hz <= 2 * band_hz[1]
    response_by_accelerance = force_spectrum[is_simulated] * response_by_acceleration[is_simulated]

    def response_map(accelerance: Complex[np.ndarray, "parts all"]) -> Complex[np.ndarray, "parts lines"]:
        responses = scipy.fft.irfft(response_by_accelerance * accelerance, 2 * (line_hz.size - 1))
        return np.asarray(scipy.fft.rfft(responses[:, first_sample:sample_count])[:, is_in_band])

    return scipy.fft.rfft(measured.responses[:, first_sample:])[:, is_in_band], response_map, line_hz[is_simulated]


def _h1_frfs_and_densities(
    measured: MeasuredResponse, period_samples: int | None
) -> tuple[Lines, Lines, Complex[np.ndarray, "sensors lines"], Float[np.ndarray, " sensors"]]:
    """Frequencies (Hz), power density of the force, H1, and noise density of the sensors."""
    force_n, responses, rate_hz = measured.force_n, measured.responses, measured.sample_rate_hz
    if period_samples is None:
        average_count = AVERAGE_COUNT
        welch_settings = {"nperseg": 2 * force_n.size // (average_count + 1), "window": "hann"}
    else:
        average_count = force_n.size // period_samples - 1
        force_n, responses = force_n[-average_count * period_samples :], responses[:, -average_count * period_samples :]
        welch_settings = {"nperseg": period_samples, "noverlap": 0, "window": "boxcar"}
    line_hz, force_density = scipy.signal.welch(force_n, rate_hz, **welch_settings)
    _, cross_density = scipy.signal.csd(force_n, responses, rate_hz, **welch_settings)
    _, response_density = scipy.signal.welch(responses, rate_hz, **welch_settings)
    is_unexcited = force_density <= MIN_FORCE_SHARE * force_density.max()
    is_unexcited[0] = False
    # the mean of so many powers, each distributed exponentially
    median_to_mean = scipy.stats.gamma.median(average_count) / average_count
    noise_density = np.zeros(len(responses))
    if is_unexcited.any():
        noise_density = np.sqrt(np.median(response_density[:, is_unexcited], axis=1) / median_to_mean)
    with np.errstate(divide="ignore", invalid="ignore"):
        return line_hz, force_density, cross_density / force_density, noise_density


def _free_run_misfits(measured: MeasuredResponse, modal_fit: ModalFit) -> Float[np.ndarray, " sensors"]:
    """Rms error of the free run over the rms response, without means, after the start has decayed."""
    first_sample = _first_decayed_sample(measured, modal_fit)
    free_run_error = measured.responses - free_run(measured, modal_fit)
    return np.asarray(free_run_error[:, first_sample:].std(axis=1) / measured.responses[:, first_sample:].std(axis=1))


def _first_decayed_sample(measured: MeasuredResponse, modal_fit: ModalFit) -> int:
    """First sample after the start has decayed, at most a quarter of the record."""
    return round(min(_decay_time_s(modal_fit) * measured.sample_rate_hz, measured.force_n.size / 4))


def _decay_time_s(modal_fit: ModalFit) -> float:
    """Time until a free vibration of any mode has decayed by DECAY_FACTOR, s."""
    return float(np.log(DECAY_FACTOR) / np.min(2 * np.pi * modal_fit.frequencies_hz * modal_fit.damping_ratios))
