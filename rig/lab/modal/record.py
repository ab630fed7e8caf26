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

EXCITED = 1e-3
"""Lines at which the force has less than this share of its largest power density are left out."""
BLOCKS = 8
"""So many averages, overlapping by half, of a force that does not repeat."""
GONE = 100.0
"""The misfit counts once a free vibration has fallen by so much."""


@dataclass(frozen=True)
class MeasuredResponse:
    """A force (N) and responses to it at one rate: displacements, velocities or accelerations (order 0, 1, 2; SI)."""

    force_n: Float[np.ndarray, " samples"]
    responses: Float[np.ndarray, "sensors samples"]
    order: int
    sample_rate_hz: float


@dataclass(frozen=True)
class FittedRecord:
    """A body, the misfit of its free run and the noise of the sensors.

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
    driving: int,
    length_m: float,
    band_hz: tuple[float, ...] = (),
    name: str = "structure",
) -> FittedRecord:
    """The modes that make the responses of the measured force, of which sensor `driving` sits at the force.

    H1 = S_fy / S_ff gives the FRFs: by whole periods of a force that repeats, the first left out, else by Hann blocks
    that overlap by half. `fit_modes` finds the modes in the band, `refined` the least output error. Raises RigError if
    no mode is found.
    """
    period = period_of(measured.force_n)
    hz, force_density, frfs, noise_density = _frfs(measured, period)
    taken = (hz > 0) & (force_density > EXCITED * force_density.max())
    if band_hz:
        if len(band_hz) != 2:
            raise RigError(f"band_hz has {len(band_hz)} numbers; give LOW,HIGH")
        taken &= (hz >= band_hz[0]) & (hz <= band_hz[1])
    if not taken.any():
        raise RigError("the force excites no line in band_hz; give a band that it excites")
    hz, frfs, weights = hz[taken], frfs[:, taken], np.sqrt(force_density[taken])
    accelerance = frfs * (2j * np.pi * hz) ** (2 - measured.order)
    found = fit_modes(hz, accelerance, driving)
    better = refined_by_frfs(hz, accelerance, weights / (2 * np.pi * hz) ** (2 - measured.order), found, driving)
    band = float(hz[0]), float(hz[-1])
    better = refined_by_output(*_outputs(measured, better, band), band, better, driving)
    order = np.argsort(positions_m)
    places = np.array(positions_m, dtype=float)[order]
    shapes = better.residues / np.sqrt(better.residues[driving])
    misfit = _misfit(measured, better)
    noise = noise_density * np.sqrt(measured.sample_rate_hz / 2) / measured.responses.std(axis=1)
    return FittedRecord(
        body=structure_of(name, length_m, better.frequencies_hz, better.ratios, places, shapes[order]),
        misfit_of_frfs=_misfit(measured, found),
        misfit=misfit,
        unmodelled=float(np.sqrt(np.mean(np.maximum(misfit**2 - noise**2, 0.0)))),
        noise_density=noise_density,
        period_s=None if period is None else period / measured.sample_rate_hz,
        band_hz=band,
    )


def free_run(measured: MeasuredResponse, modes: ModalFit) -> Float[np.ndarray, "sensors samples"]:
    """The responses of the modes to the measured force from rest, with silence behind the record."""
    force, hz, powers = _spectrum(measured, modes)
    parts = powers * accelerances(hz, modes.frequencies_hz, modes.ratios)
    return np.asarray(modes.residues @ scipy.fft.irfft(force * parts, 2 * (hz.size - 1))[:, : measured.force_n.size])


def _spectrum(
    measured: MeasuredResponse, modes: ModalFit
) -> tuple[Complex[np.ndarray, " lines"], Float[np.ndarray, " lines"], Complex[np.ndarray, " lines"]]:
    """Spectrum of the force with silence behind it: transform, frequencies, and (i omega)^(order - 2), 0 at 0 Hz.

    The means are left out, as accelerometers do not see them.
    """
    samples, rate = measured.force_n.size, measured.sample_rate_hz
    length = 2 * scipy.fft.next_fast_len(samples // 2 + round(min(_ringing_s(modes), samples / rate) * rate / 2) + 1)
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
    """The responses' spectra in the band, and what leads accelerances on the lines returned to those of a free run."""
    counted, samples = _counted(measured, modes), measured.force_n.size
    force, hz, powers = _spectrum(measured, modes)
    own_hz = np.fft.rfftfreq(samples - counted, 1 / measured.sample_rate_hz)
    inside = (own_hz >= band_hz[0]) & (own_hz <= band_hz[1])
    near = hz <= 2 * band_hz[1]
    force, powers = force[near], powers[near]

    def through(parts: Complex[np.ndarray, "parts all"]) -> Complex[np.ndarray, "parts lines"]:
        moved = scipy.fft.irfft(force * powers * parts, 2 * (hz.size - 1))[:, counted:samples]
        return np.asarray(scipy.fft.rfft(moved)[:, inside])

    return scipy.fft.rfft(measured.responses[:, counted:])[:, inside], through, hz[near]


def _frfs(
    measured: MeasuredResponse, period: int | None
) -> tuple[
    Float[np.ndarray, " lines"],
    Float[np.ndarray, " lines"],
    Complex[np.ndarray, "sensors lines"],
    Float[np.ndarray, " sensors"],
]:
    """Frequencies, the force's power density, H1, and the sensors' noise density."""
    force_n, responses = measured.force_n, measured.responses
    if period is None:
        averages = BLOCKS
        block = {"nperseg": 2 * force_n.size // (averages + 1), "window": "hann"}
    else:
        averages = force_n.size // period - 1
        force_n, responses = force_n[-averages * period :], responses[:, -averages * period :]
        block = {"nperseg": period, "noverlap": 0, "window": "boxcar"}
    hz, force_density = scipy.signal.welch(force_n, measured.sample_rate_hz, **block)
    _, cross = scipy.signal.csd(force_n, responses, measured.sample_rate_hz, **block)
    _, density = scipy.signal.welch(responses, measured.sample_rate_hz, **block)
    still = force_density <= EXCITED * force_density.max()
    still[0] = False
    usual = (
        scipy.stats.gamma.median(averages) / averages
    )  # of the mean of so many powers, each distributed exponentially
    noise = np.sqrt(np.median(density[:, still], axis=1) / usual) if still.any() else np.zeros(len(responses))
    with np.errstate(divide="ignore", invalid="ignore"):
        return hz, force_density, cross / force_density, noise


def _misfit(measured: MeasuredResponse, modes: ModalFit) -> Float[np.ndarray, " sensors"]:
    """Rms of the free run's error over that of the response, both without their means, once the start has died out."""
    counted = _counted(measured, modes)
    error = measured.responses - free_run(measured, modes)
    return np.asarray(error[:, counted:].std(axis=1) / measured.responses[:, counted:].std(axis=1))


def _counted(measured: MeasuredResponse, modes: ModalFit) -> int:
    """First sample at which the start does not matter; at most a quarter of the record is left out."""
    return round(min(_ringing_s(modes) * measured.sample_rate_hz, measured.force_n.size / 4))


def _ringing_s(modes: ModalFit) -> float:
    """Seconds until a free vibration of any mode has fallen by the factor `GONE`."""
    return float(np.log(GONE) / np.min(2 * np.pi * modes.frequencies_hz * modes.ratios))
