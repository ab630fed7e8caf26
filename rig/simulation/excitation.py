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
LONG_S = 1024.0
"""Duration beyond which a Gaussian force is generated segment by segment, s."""
SEGMENT_S = 256.0


class _Band(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
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


class BandLimitedGaussian(_Band, frozen=True, tag="gaussian"):
    """Gaussian noise with a flat spectrum in the band and none outside: the paper's excitation.

    Drawn line by line in the frequency domain, so the force does not depend on the time step. One of more than 1024 s
    consists of independent segments of 256 s that overlap by half, under windows whose squares add up to one.
    """

    def excited(self, samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        return _scaled(_noise(samples, step_s, self) * _rise(samples, step_s), self.rms_n)


class BurstRandom(_Band, frozen=True, tag="burst"):
    """The band-limited Gaussian force, on for `on_fraction` of each period and off for the rest."""

    period_s: float = 4.0
    """Period of the bursts, s."""
    on_fraction: float = 0.6
    """Share of each period in which the force is on."""

    def excited(self, samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        noise = _noise(samples, step_s, self)
        phase = np.mod(np.arange(samples) * step_s, self.period_s) / (self.period_s * self.on_fraction)
        edge = np.clip(np.minimum(phase, 1 - phase) * 20, 0, 1)  # smooth edges over a twentieth of the burst
        return _scaled(noise * np.sin(np.pi / 2 * edge) ** 2, self.rms_n)


class Sweep(_Band, frozen=True, tag="sweep"):
    """A linear sine sweep from the lower to the upper end of the band over the whole record."""

    def excited(self, samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        time_s = np.arange(samples) * step_s
        return _scaled(scipy.signal.chirp(time_s, self.low_hz, samples * step_s, self.high_hz, phi=-90), self.rms_n)


class Multisine(_Band, frozen=True, tag="multisine"):
    """A periodic sum of sines of equal amplitude and random phase on every line of 1/period in the band."""

    period_s: float = 8.0
    """Period, s."""

    def excited(self, samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        lines = np.arange(np.ceil(self.low_hz * self.period_s), np.floor(self.high_hz * self.period_s) + 1)
        lines = lines[lines > 0]
        phases = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, len(lines))
        time_s = np.arange(samples) * step_s
        total = np.zeros(samples)
        for line, phase in zip(lines, phases, strict=True):
            total += np.cos(2 * np.pi * line / self.period_s * time_s + phase)
        return total * _rise(samples, step_s) * self.rms_n * np.sqrt(2 / max(len(lines), 1))


class FreeDecay(_Band, frozen=True, tag="free_decay"):
    """One half-sine impact of length 1/(2 high_hz) and peak rms_n * sqrt(2), then free decay."""

    def excited(self, samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        time_s = np.arange(samples) * step_s
        blow = np.sin(2 * np.pi * self.high_hz * time_s)
        return np.where(time_s < 0.5 / self.high_hz, blow, 0.0) * self.rms_n * np.sqrt(2)


class Hammer(_Band, frozen=True, tag="hammer"):
    """Hits of an impact hammer: half-sines of length 1/(2 high_hz), low_hz of them a second, which varies by a fifth
    from hit to hit, as their peaks do. With low_hz = 0 there is one hit.

    The spectrum of a hit is flat within 3 dB up to 1.2 high_hz and first zero at 3 high_hz.
    """

    def excited(self, samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        duration_s, rng = samples * step_s, np.random.default_rng(self.seed)
        count = max(1, int(duration_s * self.low_hz))
        interval_s, peaks = 1 / self.low_hz if self.low_hz else 0.0, rng.uniform(0.8, 1.2, count)
        starts_s = (np.arange(count) + rng.uniform(0.0, 0.2, count)) * interval_s
        time_s, force = np.arange(samples) * step_s, np.zeros(samples)
        for start_s, peak in zip(starts_s, peaks, strict=True):
            hit = slice(int(start_s / step_s), int((start_s + 0.5 / self.high_hz) / step_s) + 2)
            phase = 2 * np.pi * self.high_hz * (time_s[hit] - start_s)
            force[hit] += peak * np.where((phase > 0) & (phase < np.pi), np.sin(phase), 0.0)
        return _scaled(force, self.rms_n)


class SteppedSine(_Band, frozen=True, tag="stepped_sine"):
    """A sine whose frequency rises in equal steps from the lower to the upper end of the band, each held equally long.

    The phase is continuous from step to step.
    """

    steps: int = 20
    """Number of frequencies."""

    def excited(self, samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
        """Force at the steps after the quiet second, N."""
        held_s, time_s = samples * step_s / self.steps, np.arange(samples) * step_s
        step = np.minimum((time_s / held_s).astype(int), self.steps - 1)
        frequency_hz = np.linspace(self.low_hz, self.high_hz, self.steps)
        turns = np.concatenate([[0.0], np.cumsum(frequency_hz[:-1] * held_s)])
        phase = 2 * np.pi * (turns[step] + frequency_hz[step] * (time_s - step * held_s))
        return _scaled(np.sin(phase) * _rise(samples, step_s), self.rms_n)


Excitation = BandLimitedGaussian | BurstRandom | Sweep | SteppedSine | Multisine | Hammer | FreeDecay
_KINDS: dict[str, type[Excitation]] = {
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
    if kind not in _KINDS:
        raise RigError(f"no excitation {kind!r}; there are {', '.join(_KINDS)}")
    return _KINDS[kind](rms_n=rms_n, low_hz=low_hz, high_hz=high_hz, seed=seed)


def force_history(excitation: Excitation, duration_s: float, step_s: float) -> Float[np.ndarray, " samples"]:
    """Force (N) at 0, step, 2 step, ... below the duration: a quiet second, then the excitation.

    Raises RigError if the record is not longer than the quiet second or the band reaches beyond half the step rate.
    """
    _check(excitation, duration_s, step_s)
    quiet = round(QUIET_S / step_s)
    samples = round(duration_s / step_s)
    return np.concatenate([np.zeros(quiet), excitation.excited(samples - quiet, step_s)])


@dataclass(frozen=True)
class LongForce:
    """Long Gaussian force, computed slice by slice."""

    excitation: BandLimitedGaussian
    samples: int
    step_s: float

    def __len__(self) -> int:
        return self.samples

    def __getitem__(self, span: slice) -> Float[np.ndarray, " some"]:
        start, stop, _ = span.indices(self.samples)
        quiet, half = round(QUIET_S / self.step_s), round(SEGMENT_S / 2 / self.step_s)
        force = np.zeros(max(0, stop - start))
        for k in range((max(start, quiet) - quiet) // half, (stop - 1 - quiet) // half + 2):
            segment_start = quiet + (k - 1) * half
            overlap = slice(max(start, segment_start, quiet), min(stop, segment_start + 2 * half))
            force[overlap.start - start : overlap.stop - start] += self._segment(k)[
                overlap.start - segment_start : overlap.stop - segment_start
            ]
        return force

    @cached_property
    def _segment(self) -> Callable[[int], Float[np.ndarray, " samples"]]:
        """Segment by number; the last two are cached."""
        return lru_cache(maxsize=2)(partial(_segment, self.excitation, self.step_s))


def force_signal(excitation: Excitation, duration_s: float, step_s: float) -> ForceSignal:
    """Force of `force_history`; a Gaussian force of more than 1024 s is computed slice by slice."""
    if isinstance(excitation, BandLimitedGaussian) and duration_s > LONG_S:
        _check(excitation, duration_s, step_s)
        return LongForce(excitation, round(duration_s / step_s), step_s)
    return force_history(excitation, duration_s, step_s)


def noise_spectrum(
    samples: int, step_s: float, low_hz: float, high_hz: float, seed: int | Sequence[int]
) -> Complex[np.ndarray, " lines"]:
    """Spectrum with independent Gaussian lines at the multiples of 1/duration in the band, whatever the time step.

    Raises RigError if no line lies in the band.
    """
    period_s = samples * step_s
    first, last = max(int(np.ceil(low_hz * period_s)), 1), int(np.floor(high_hz * period_s))
    if last < first:
        raise RigError(f"excitation: no line of {low_hz} to {high_hz} Hz fits {period_s:.3g} s; record longer")
    lines = np.random.default_rng(seed).standard_normal((last - first + 1, 2))
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[first : last + 1] = lines[:, 0] + 1j * lines[:, 1]
    return spectrum


def _check(excitation: Excitation, duration_s: float, step_s: float) -> None:
    if not duration_s > QUIET_S:
        raise RigError(f"duration is {duration_s} s; give more than {QUIET_S} s, the quiet start of every recording")
    if not step_s > 0 or excitation.high_hz * step_s > 0.25:
        raise RigError(f"step is {step_s} s; {excitation.high_hz} Hz needs a step above 0 and at most 1/(4 high_hz)")


def _segment(band: BandLimitedGaussian, step_s: float, k: int) -> Float[np.ndarray, " samples"]:
    """Segment k under its window; the force rises smoothly from its start, half-way through segment 0."""
    samples = 2 * round(SEGMENT_S / 2 / step_s)
    spectrum = noise_spectrum(samples, step_s, band.low_hz, band.high_hz, (band.seed, k))
    rms = 2 * np.sqrt(np.count_nonzero(spectrum)) / samples
    force = np.fft.irfft(spectrum, samples) * (band.rms_n / rms) * np.sin(np.pi * np.arange(samples) / samples)
    if k < 2:
        force_start = (1 - k) * samples // 2
        force[force_start:] *= _rise(samples - force_start, step_s)
    force.flags.writeable = False
    return np.asarray(force)


def _noise(samples: int, step_s: float, band: _Band) -> Float[np.ndarray, " samples"]:
    return np.fft.irfft(noise_spectrum(samples, step_s, band.low_hz, band.high_hz, band.seed), samples)


def _rise(samples: int, step_s: float) -> Float[np.ndarray, " samples"]:
    return np.sin(np.pi / 2 * np.clip(np.arange(samples) * step_s / RISE_S, 0, 1)) ** 2


def _scaled(force: Float[np.ndarray, " samples"], rms_n: float) -> Float[np.ndarray, " samples"]:
    rms = np.sqrt(np.mean(force**2))
    return force * (rms_n / rms) if rms > 0 else force
