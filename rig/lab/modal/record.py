"""A structure fitted to a measured force and the responses to it: modes by H1 FRFs, then by least output error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.lab.modal.fit import ModalFit, fit_modes
from rig.lab.modal.refine import accelerances, refined_by_frfs, refined_by_output
from rig.model.structure import Structure, structure_of
from rig.recording.period import period_of

MIN_FORCE_SHARE = 1e-3
"""Least power density of the force at a line that is used, relative to its largest."""
AVERAGES = 8
"""Averages, overlapping by half, for a force that does not repeat."""
DECAY_FACTOR = 100.0
"""Decay of a free vibration after which the misfit is evaluated."""


@dataclass(frozen=True)
class MeasuredResponse:
    """A force (N) and responses to it at one rate: displacements, velocities or accelerations (order 0, 1, 2; SI)."""

    force_n: Float[np.ndarray, " samples"]
    responses: Float[np.ndarray, "sensors samples"]
    order: int
    sample_rate_hz: float


@dataclass(frozen=True)
class FittedRecord:
    """Fitted body, the misfit of its free run and the noise of the sensors.

    misfit is the rms error over the rms of each response, by modes on the FRFs alone and after the refinement.
    unmodelled is the rms of that beyond the noise, over all sensors. noise_density is one-sided, in the response's unit
    per sqrt(Hz), by the median over the lines that the force does not excite.
    """

    body: Structure
    misfit_of_frfs: Float[np.ndarray, " sensors"]
    misfit: Float[np.ndarray, " sensors"]
    unmodelled: float
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
    period = period_of(measured.force_n)
    hz, force_density, frfs, noise_density = _frfs(measured, period)
    used = (hz > 0) & (force_density > MIN_FORCE_SHARE * force_density.max())
    if band_hz:
        if len(band_hz) != 2:
            raise RigError(f"band_hz has {len(band_hz)} numbers; give LOW,HIGH")
        used &= (hz >= band_hz[0]) & (hz <= band_hz[1])
    if not used.any():
        raise RigError("the force excites no line in band_hz; give a band that it excites")
    hz, frfs, weights = hz[used], frfs[:, used], np.sqrt(force_density[used])
    accelerance = frfs * (2j * np.pi * hz) ** (2 - measured.order)
    frf_fit = fit_modes(hz, accelerance, driving_index)
    refined = refined_by_frfs(
        hz, accelerance, weights / (2 * np.pi * hz) ** (2 - measured.order), frf_fit, driving_index
    )
    band = float(hz[0]), float(hz[-1])
    refined = refined_by_output(*_outputs(measured, refined, band), band, refined, driving_index)
    order = np.argsort(positions_m)
    places = np.array(positions_m, dtype=float)[order]
    shapes = refined.residues / np.sqrt(refined.residues[driving_index])
    misfit = _misfit(measured, refined)
    noise = noise_density * np.sqrt(measured.sample_rate_hz / 2) / measured.responses.std(axis=1)
    return FittedRecord(
        body=structure_of(name, length_m, refined.frequencies_hz, refined.ratios, places, shapes[order]),
        misfit_of_frfs=_misfit(measured, frf_fit),
        misfit=misfit,
        unmodelled=float(np.sqrt(np.mean(np.maximum(misfit**2 - noise**2, 0.0)))),
        noise_density=noise_density,
        period_s=None if period is None else period / measured.sample_rate_hz,
        band_hz=band,
    )


def free_run(measured: MeasuredResponse, modes: ModalFit) -> Float[np.ndarray, "sensors samples"]:
    """Responses of the modes to the measured force from rest, zero-padded behind the record."""
    force, hz, powers = _spectrum(measured, modes)
    unit_responses = powers * accelerances(hz, modes.frequencies_hz, modes.ratios)
    return np.asarray(
        modes.residues @ scipy.fft.irfft(force * unit_responses, 2 * (hz.size - 1))[:, : measured.force_n.size]
    )


def _spectrum(
    measured: MeasuredResponse, modes: ModalFit
) -> tuple[Complex[np.ndarray, " lines"], Float[np.ndarray, " lines"], Complex[np.ndarray, " lines"]]:
    """Spectrum of the zero-padded force, its frequencies (Hz), and (i omega)^(order - 2), which is 0 at 0 Hz.

    That leaves out the means, which accelerometers do not measure.
    """
    samples, rate = measured.force_n.size, measured.sample_rate_hz
    length = 2 * scipy.fft.next_fast_len(samples // 2 + round(min(_decay_time_s(modes), samples / rate) * rate / 2) + 1)
    hz = np.fft.rfftfreq(length, 1 / rate)
    powers = np.zeros(hz.size, dtype=complex)
    powers[1:] = (2j * np.pi * hz[1:]) ** (measured.order - 2)
    return scipy.fft.rfft(measured.force_n, length), hz, powers


def _outputs(
    measured: MeasuredResponse, modes: ModalFit, band_hz: tuple[float, float]
) -> tuple[
    Complex[np.ndarray, "sensors lines"],
    Callable[[Complex[np.ndarray, "parts all"]], Complex[np.ndarray, "parts lines"]],
    Float[np.ndarray, " all"],
]:
    """Spectra of the responses in the band, a map from accelerances to those of a free run, and its lines (Hz)."""
    counted, samples = _first_counted(measured, modes), measured.force_n.size
    force, hz, powers = _spectrum(measured, modes)
    response_hz = np.fft.rfftfreq(samples - counted, 1 / measured.sample_rate_hz)
    inside = (response_hz >= band_hz[0]) & (response_hz <= band_hz[1])
    simulated = hz <= 2 * band_hz[1]
    force, powers = force[simulated], powers[simulated]

    def through(accelerance: Complex[np.ndarray, "parts all"]) -> Complex[np.ndarray, "parts lines"]:
        responses = scipy.fft.irfft(force * powers * accelerance, 2 * (hz.size - 1))[:, counted:samples]
        return np.asarray(scipy.fft.rfft(responses)[:, inside])

    return scipy.fft.rfft(measured.responses[:, counted:])[:, inside], through, hz[simulated]


def _frfs(
    measured: MeasuredResponse, period_samples: int | None
) -> tuple[
    Float[np.ndarray, " lines"],
    Float[np.ndarray, " lines"],
    Complex[np.ndarray, "sensors lines"],
    Float[np.ndarray, " sensors"],
]:
    """Frequencies (Hz), power density of the force, H1, and noise density of the sensors."""
    force_n, responses = measured.force_n, measured.responses
    if period_samples is None:
        averages = AVERAGES
        block = {"nperseg": 2 * force_n.size // (averages + 1), "window": "hann"}
    else:
        averages = force_n.size // period_samples - 1
        force_n, responses = force_n[-averages * period_samples :], responses[:, -averages * period_samples :]
        block = {"nperseg": period_samples, "noverlap": 0, "window": "boxcar"}
    hz, force_density = scipy.signal.welch(force_n, measured.sample_rate_hz, **block)
    _, cross = scipy.signal.csd(force_n, responses, measured.sample_rate_hz, **block)
    _, density = scipy.signal.welch(responses, measured.sample_rate_hz, **block)
    unexcited = force_density <= MIN_FORCE_SHARE * force_density.max()
    unexcited[0] = False
    median_to_mean = (
        scipy.stats.gamma.median(averages) / averages
    )  # of the mean of so many powers, each distributed exponentially
    noise = (
        np.sqrt(np.median(density[:, unexcited], axis=1) / median_to_mean)
        if unexcited.any()
        else np.zeros(len(responses))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return hz, force_density, cross / force_density, noise


def _misfit(measured: MeasuredResponse, modes: ModalFit) -> Float[np.ndarray, " sensors"]:
    """Rms error of the free run over the rms response, without means, after the start has decayed."""
    counted = _first_counted(measured, modes)
    error = measured.responses - free_run(measured, modes)
    return np.asarray(error[:, counted:].std(axis=1) / measured.responses[:, counted:].std(axis=1))


def _first_counted(measured: MeasuredResponse, modes: ModalFit) -> int:
    """First sample after the start has decayed, at most a quarter of the record."""
    return round(min(_decay_time_s(modes) * measured.sample_rate_hz, measured.force_n.size / 4))


def _decay_time_s(modes: ModalFit) -> float:
    """Time until a free vibration of any mode has decayed by DECAY_FACTOR, s."""
    return float(np.log(DECAY_FACTOR) / np.min(2 * np.pi * modes.frequencies_hz * modes.ratios))
