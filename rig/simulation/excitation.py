"""Exciting forces: each a frozen description that gives the same force at any time step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import msgspec
import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.simulation.motion import ForceSignal

QUIET_S = 1.0
"""Quiet start of every recording, s: signals there are not caused by the force."""
RISE_S = 1 / 32
"""Rise time of noise and multisine, s: with a jump, the motion would depend on the time step."""
MAX_WHOLE_FORCE_S = 1024.0
"""Duration beyond which a Gaussian force is generated segment by segment, s."""
SEGMENT_S = 256.0


class _ExcitationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Band and rms value, taken over the excited part of the record, of any excitation."""

    rms_n: float
    """Root mean square of the excited part, N; for a free decay the peak over sqrt(2)."""
    low_hz: float
    """Lower end of the band, Hz; for a hammer the hits a second."""
    high_hz: float
    """Upper end of the band, Hz; for a hammer and a free decay half the inverse of a hit's length."""
    seed: int = 1
    """Seed of the random numbers."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rms_n) and self.rms_n >= 0):
            raise RigError(f"excitation: rms_n is {self.rms_n}; give a finite value, zero or above")
        if not 0 <= self.low_hz < self.high_hz < np.inf:
            raise RigError(f"excitation: the band {self.low_hz} to {self.high_hz} Hz is empty; give 0 <= low < high")
        if self.seed < 0:
            raise RigError(f"excitation: seed is {self.seed}; give zero or above")


class BandLimitedGaussian(_ExcitationSettings, frozen=True, tag="gaussian"):
    """Gaussian noise with a flat spectrum in the band and none outside: the paper's excitation.

    Drawn line by line in the frequency domain, so the force does not depend on the time step. One of more than 1024 s
    consists of independent segments of 256 s that overlap by half, under windows whose squares add up to one.
    """

    def excited_force_n(self, sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        unscaled_noise = _unscaled_noise(sample_count, step_s, self)
        return _scale_to_rms(unscaled_noise * _rise_window(sample_count, step_s), self.rms_n)


class BurstRandom(_ExcitationSettings, frozen=True, tag="burst"):
    """The band-limited Gaussian force, on for `on_fraction` of each period and off for the rest."""

    period_s: float = 4.0
    """Period of the bursts, s."""
    on_fraction: float = 0.6
    """Share of each period in which the force is on."""

    def excited_force_n(self, sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        unscaled_noise = _unscaled_noise(sample_count, step_s, self)
        burst_elapsed = np.mod(np.arange(sample_count) * step_s, self.period_s) / (self.period_s * self.on_fraction)
        # smooth edges over a twentieth of the burst
        edge_elapsed = np.clip(np.minimum(burst_elapsed, 1 - burst_elapsed) * 20, 0, 1)
        return _scale_to_rms(unscaled_noise * np.sin(np.pi / 2 * edge_elapsed) ** 2, self.rms_n)


class Sweep(_ExcitationSettings, frozen=True, tag="sweep"):
    """A linear sine sweep from the lower to the upper end of the band over the whole record."""

    def excited_force_n(self, sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        time_s = np.arange(sample_count) * step_s
        unit_chirp = scipy.signal.chirp(time_s, self.low_hz, sample_count * step_s, self.high_hz, phi=-90)
        return _scale_to_rms(unit_chirp, self.rms_n)


class Multisine(_ExcitationSettings, frozen=True, tag="multisine"):
    """A periodic sum of sines of equal amplitude and random phase on every line of 1/period in the band."""

    period_s: float = 8.0
    """Period, s."""

    def excited_force_n(self, sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        line_numbers = np.arange(np.ceil(self.low_hz * self.period_s), np.floor(self.high_hz * self.period_s) + 1)
        line_numbers = line_numbers[line_numbers > 0]
        phases_rad = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, len(line_numbers))
        time_s = np.arange(sample_count) * step_s
        cosine_sum = np.zeros(sample_count)
        for line_number, phase_rad in zip(line_numbers, phases_rad, strict=True):
            cosine_sum += np.cos(2 * np.pi * line_number / self.period_s * time_s + phase_rad)
        return cosine_sum * _rise_window(sample_count, step_s) * self.rms_n * np.sqrt(2 / max(len(line_numbers), 1))


class FreeDecay(_ExcitationSettings, frozen=True, tag="free_decay"):
    """One half-sine impact of length 1/(2 high_hz) and peak rms_n * sqrt(2), then free decay."""

    def excited_force_n(self, sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        time_s = np.arange(sample_count) * step_s
        unit_sine = np.sin(2 * np.pi * self.high_hz * time_s)
        return np.where(time_s < 0.5 / self.high_hz, unit_sine, 0.0) * self.rms_n * np.sqrt(2)


class Hammer(_ExcitationSettings, frozen=True, tag="hammer"):
    """Hits of an impact hammer: half-sines of length 1/(2 high_hz), low_hz of them a second, which varies by a fifth
    from hit to hit, as their peaks do. With low_hz = 0 there is one hit.

    The spectrum of a hit is flat within 3 dB up to 1.2 high_hz and first zero at 3 high_hz.
    """

    def excited_force_n(self, sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        duration_s, rng = sample_count * step_s, np.random.default_rng(self.seed)
        hit_count = max(1, int(duration_s * self.low_hz))
        mean_interval_s, relative_peaks = 1 / self.low_hz if self.low_hz else 0.0, rng.uniform(0.8, 1.2, hit_count)
        hit_starts_s = (np.arange(hit_count) + rng.uniform(0.0, 0.2, hit_count)) * mean_interval_s
        time_s, unscaled_force = np.arange(sample_count) * step_s, np.zeros(sample_count)
        for hit_start_s, relative_peak in zip(hit_starts_s, relative_peaks, strict=True):
            hit_samples = slice(int(hit_start_s / step_s), int((hit_start_s + 0.5 / self.high_hz) / step_s) + 2)
            phase = 2 * np.pi * self.high_hz * (time_s[hit_samples] - hit_start_s)
            unscaled_force[hit_samples] += relative_peak * np.where((phase > 0) & (phase < np.pi), np.sin(phase), 0.0)
        return _scale_to_rms(unscaled_force, self.rms_n)


class SteppedSine(_ExcitationSettings, frozen=True, tag="stepped_sine"):
    """A sine whose frequency rises in equal steps from the lower to the upper end of the band, each held equally long.

    The phase is continuous from step to step.
    """

    steps: int = 20
    """Number of frequencies."""

    def excited_force_n(self, sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        dwell_s, time_s = sample_count * step_s / self.steps, np.arange(sample_count) * step_s
        step_of_sample = np.minimum((time_s / dwell_s).astype(int), self.steps - 1)
        frequencies_hz = np.linspace(self.low_hz, self.high_hz, self.steps)
        turns_at_step_start = np.concatenate([[0.0], np.cumsum(frequencies_hz[:-1] * dwell_s)])
        turns_in_step = frequencies_hz[step_of_sample] * (time_s - step_of_sample * dwell_s)
        phase_rad = 2 * np.pi * (turns_at_step_start[step_of_sample] + turns_in_step)
        return _scale_to_rms(np.sin(phase_rad) * _rise_window(sample_count, step_s), self.rms_n)


Excitation = BandLimitedGaussian | BurstRandom | Sweep | SteppedSine | Multisine | Hammer | FreeDecay
_TYPE_BY_NAME: dict[str, type[Excitation]] = {
    "gaussian": BandLimitedGaussian,
    "burst": BurstRandom,
    "sweep": Sweep,
    "stepped_sine": SteppedSine,
    "multisine": Multisine,
    "hammer": Hammer,
    "free_decay": FreeDecay,
}


def excitation_of(kind: str, *, rms_n: float, low_hz: float, high_hz: float, seed: int = 1) -> Excitation:
    """Excitation of a kind by its name; raises RigError if there is none."""
    if kind not in _TYPE_BY_NAME:
        raise RigError(f"no excitation {kind!r}; there are {', '.join(_TYPE_BY_NAME)}")
    return _TYPE_BY_NAME[kind](rms_n=rms_n, low_hz=low_hz, high_hz=high_hz, seed=seed)


def force_history(excitation: Excitation, duration_s: float, step_s: float) -> Float[np.ndarray, " samples"]:
    """Force (N) at 0, step, 2 step, ... below the duration: a quiet second, then the excitation.

    Raises RigError if the record is not longer than the quiet second or the band reaches beyond half the step rate.
    """
    _check_force_settings(excitation, duration_s, step_s)
    quiet_count = round(QUIET_S / step_s)
    sample_count = round(duration_s / step_s)
    return np.concatenate([np.zeros(quiet_count), excitation.excited_force_n(sample_count - quiet_count, step_s)])


@dataclass(frozen=True)
class LongForce:
    """Long Gaussian force, computed slice by slice."""

    excitation: BandLimitedGaussian
    sample_count: int
    step_s: float

    def __len__(self) -> int:
        return self.sample_count

    def __getitem__(self, sample_span: slice) -> Float[np.ndarray, " some"]:
        first_sample, end_sample, _ = sample_span.indices(self.sample_count)
        quiet, hop = round(QUIET_S / self.step_s), round(SEGMENT_S / 2 / self.step_s)
        force_n = np.zeros(max(0, end_sample - first_sample))
        for segment_number in range((max(first_sample, quiet) - quiet) // hop, (end_sample - 1 - quiet) // hop + 2):
            segment_start = quiet + (segment_number - 1) * hop
            overlap_start, stop = max(first_sample, segment_start, quiet), min(end_sample, segment_start + 2 * hop)
            overlap_n = self._segment_by_number(segment_number)[overlap_start - segment_start : stop - segment_start]
            force_n[overlap_start - first_sample : stop - first_sample] += overlap_n
        return force_n

    @cached_property
    def _segment_by_number(self) -> Callable[[int], Float[np.ndarray, " samples"]]:
        """Segment by number; the last two are cached."""
        return lru_cache(maxsize=2)(partial(_segment_force_n, self.excitation, self.step_s))


def force_signal(excitation: Excitation, duration_s: float, step_s: float) -> ForceSignal:
    """Force of `force_history`; a Gaussian force of more than 1024 s is computed slice by slice."""
    if isinstance(excitation, BandLimitedGaussian) and duration_s > MAX_WHOLE_FORCE_S:
        _check_force_settings(excitation, duration_s, step_s)
        return LongForce(excitation, round(duration_s / step_s), step_s)
    return force_history(excitation, duration_s, step_s)


def noise_spectrum(
    sample_count: int, step_s: float, low_hz: float, high_hz: float, seed: int | Sequence[int]
) -> Complex[np.ndarray, " lines"]:
    """Spectrum with independent Gaussian lines at the multiples of 1/duration in the band, whatever the time step.

    Raises RigError if no line lies in the band.
    """
    duration_s = sample_count * step_s
    first_line, last_line = max(int(np.ceil(low_hz * duration_s)), 1), int(np.floor(high_hz * duration_s))
    if last_line < first_line:
        raise RigError(f"excitation: no line of {low_hz} to {high_hz} Hz fits {duration_s:.3g} s; record longer")
    normal_draws = np.random.default_rng(seed).standard_normal((last_line - first_line + 1, 2))
    spectrum = np.zeros(sample_count // 2 + 1, dtype=complex)
    spectrum[first_line : last_line + 1] = normal_draws[:, 0] + 1j * normal_draws[:, 1]
    return spectrum


def _check_force_settings(excitation: Excitation, duration_s: float, step_s: float) -> None:
    if not duration_s > QUIET_S:
        raise RigError(f"duration is {duration_s} s; give more than {QUIET_S} s, the quiet start of every recording")
    if not step_s > 0 or excitation.high_hz * step_s > 0.25:
        raise RigError(f"step is {step_s} s; {excitation.high_hz} Hz needs a step above 0 and at most 1/(4 high_hz)")


def _segment_force_n(force: BandLimitedGaussian, step_s: float, segment_number: int) -> Float[np.ndarray, " samples"]:
    """Segment of that number under its window; the force rises smoothly from its start, half-way through segment 0."""
    sample_count = 2 * round(SEGMENT_S / 2 / step_s)
    spectrum = noise_spectrum(sample_count, step_s, force.low_hz, force.high_hz, (force.seed, segment_number))
    unscaled_rms = 2 * np.sqrt(np.count_nonzero(spectrum)) / sample_count
    window = np.sin(np.pi * np.arange(sample_count) / sample_count)
    force_n = np.fft.irfft(spectrum, sample_count) * (force.rms_n / unscaled_rms) * window
    if segment_number < 2:
        rise_start = (1 - segment_number) * sample_count // 2
        force_n[rise_start:] *= _rise_window(sample_count - rise_start, step_s)
    force_n.flags.writeable = False
    return np.asarray(force_n)


def _unscaled_noise(sample_count: int, step_s: float, force: _ExcitationSettings) -> Float[np.ndarray, " samples"]:
    return np.fft.irfft(noise_spectrum(sample_count, step_s, force.low_hz, force.high_hz, force.seed), sample_count)


def _rise_window(sample_count: int, step_s: float) -> Float[np.ndarray, " samples"]:
    return np.sin(np.pi / 2 * np.clip(np.arange(sample_count) * step_s / RISE_S, 0, 1)) ** 2


def _scale_to_rms(unscaled_force: Float[np.ndarray, " samples"], rms_n: float) -> Float[np.ndarray, " samples"]:
    unscaled_rms = np.sqrt(np.mean(unscaled_force**2))
    return unscaled_force * (rms_n / unscaled_rms) if unscaled_rms > 0 else unscaled_force
