"""Forces over time at the simulator's rate: Gaussian in a band, blows, a release; tones, the ground's acceleration."""

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.fft import next_fast_len

from tests.campaigns.worlds.machine import Machine

Times = Float[np.ndarray, " steps"]
LEAD_S = 1.0
"""Simulated before the record begins, so that what runs already has settled."""
RISE_S = 0.05
BAND_HZ = (0.5, 100.0)


class Gaussian(msgspec.Struct, frozen=True, kw_only=True, tag="gaussian"):
    """A Gaussian force in a band; its level is the root mean square from begins_s to the record's end."""

    measured = True

    rms_n: float
    begins_s: float
    band_hz: tuple[float, float] = BAND_HZ

    @property
    def level_n(self) -> float:
        return self.rms_n

    def force_n(self, time_s: Times, duration_s: float, step_s: float, rng: np.random.Generator) -> Times:
        force = gaussian(time_s.size, step_s, self.band_hz, 1.0, rng) * rise(time_s - self.begins_s, RISE_S)
        excited = (time_s >= self.begins_s) & (time_s < duration_s)
        return np.asarray(force * (self.rms_n / np.sqrt(np.mean(force[excited] ** 2))))


class Blows(msgspec.Struct, frozen=True, kw_only=True, tag="blows"):
    """Half-sines of a hammer: when each begins and its peak, all of one width. Before time 0 none is measured."""

    blows: tuple[tuple[float, float], ...]
    width_s: float
    begins_s: float = 0.0

    @property
    def measured(self) -> bool:
        return self.blows[0][0] >= 0

    @property
    def level_n(self) -> float:
        """The largest peak."""
        return max(abs(peak_n) for _, peak_n in self.blows)

    def force_n(self, time_s: Times, _duration_s: float, _step_s: float, _rng: np.random.Generator) -> Times:
        force = np.zeros(time_s.size)
        for at_s, peak_n in self.blows:
            inside = (time_s >= at_s) & (time_s <= at_s + self.width_s)
            force[inside] += peak_n * np.sin(np.pi * (time_s[inside] - at_s) / self.width_s)
        return force


class Release(msgspec.Struct, frozen=True, kw_only=True, tag="release"):
    """A force that holds the machine off its rest, and lets go so long before the record begins; it is not measured."""

    measured = False

    held_n: float
    before_s: float
    begins_s: float = 0.0

    @property
    def level_n(self) -> float:
        return abs(self.held_n)

    def force_n(self, time_s: Times, _duration_s: float, _step_s: float, _rng: np.random.Generator) -> Times:
        return np.where(time_s < -self.before_s, self.held_n, 0.0)


Excitation = Gaussian | Blows | Release


def gaussian(steps: int, step_s: float, band_hz: tuple[float, float], rms: float, rng: np.random.Generator) -> Times:
    """Gaussian noise with a flat spectrum in the band and none outside: a sum of cosines of random size and phase."""
    period = next_fast_len(steps, real=True)
    lines_hz = np.fft.rfftfreq(period, step_s)
    inside = (lines_hz >= max(band_hz[0], 1e-9)) & (lines_hz <= band_hz[1])
    spectrum = np.zeros(lines_hz.size, dtype=complex)
    spectrum[inside] = rng.rayleigh(size=inside.sum()) * np.exp(2j * np.pi * rng.uniform(size=inside.sum()))
    values = np.fft.irfft(spectrum, period)[:steps]
    return values * (rms / np.sqrt(np.mean(values**2)))


def rise(time_s: Times, over_s: float) -> Times:
    """From 0 at time 0 to 1 after `over_s`, smoothly."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(time_s / over_s, 0.0, 1.0))


def inputs_of(
    machine: Machine,
    excitation: Excitation,
    duration_s: float,
    steps: int,
    step_s: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "steps inputs"]:
    """The exciting force, every tone, the loads' level 1 and the ground's acceleration, from -LEAD_S on.

    Tones and the ground are under way before the record begins.
    """
    time_s = -LEAD_S + np.arange(steps) * step_s
    columns = [excitation.force_n(time_s, duration_s, step_s, rng)]
    begun = rise(time_s + LEAD_S, 0.8 * LEAD_S)
    for tone in machine.tones:
        turns = 2 * np.pi * tone.frequency_hz * time_s
        columns.append(begun * (tone.cosine_n * np.cos(turns) + tone.sine_n * np.sin(turns)))
    columns.append(np.ones(steps))
    if machine.shaking is None:
        columns.append(np.zeros(steps))
    else:
        band_hz = (machine.shaking.low_hz, machine.shaking.high_hz)
        columns.append(begun * gaussian(steps, step_s, band_hz, machine.shaking.acceleration_rms_m_per_s2, rng))
    return np.stack(columns, axis=1)
