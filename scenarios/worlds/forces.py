"""Known forces over time at the simulator's rate: Gaussian in a band, tones, the ground's acceleration."""

import numpy as np
from jaxtyping import Float
from scipy.fft import next_fast_len

from scenarios.worlds.machine import Machine

LEAD_S = 1.0
"""Simulated before the record begins, so that what runs already has settled."""
RISE_S = 0.05
BAND_HZ = (0.5, 100.0)


def gaussian(
    steps: int, step_s: float, band_hz: tuple[float, float], rms: float, rng: np.random.Generator
) -> Float[np.ndarray, " steps"]:
    """Gaussian noise with a flat spectrum in the band and none outside: a sum of cosines of random size and phase."""
    period = next_fast_len(steps, real=True)
    lines_hz = np.fft.rfftfreq(period, step_s)
    inside = (lines_hz >= max(band_hz[0], 1e-9)) & (lines_hz <= band_hz[1])
    spectrum = np.zeros(lines_hz.size, dtype=complex)
    spectrum[inside] = rng.rayleigh(size=inside.sum()) * np.exp(2j * np.pi * rng.uniform(size=inside.sum()))
    values = np.fft.irfft(spectrum, period)[:steps]
    return values * (rms / np.sqrt(np.mean(values**2)))


def rise(time_s: Float[np.ndarray, " steps"], over_s: float) -> Float[np.ndarray, " steps"]:
    """From 0 at time 0 to 1 after `over_s`, smoothly."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(time_s / over_s, 0.0, 1.0))


def inputs_of(
    machine: Machine,
    rms_n: float,
    quiet_s: float,
    duration_s: float,
    steps: int,
    step_s: float,
    rng: np.random.Generator,
    excited_hz: tuple[float, float] = BAND_HZ,
) -> Float[np.ndarray, "steps inputs"]:
    """The exciting force, every tone, the loads' level 1 and the ground's acceleration, from -LEAD_S on.

    The force begins at quiet_s; its level is the root mean square from there to duration_s. Tones and the ground are
    under way before the record begins.
    """
    time_s = -LEAD_S + np.arange(steps) * step_s
    force = gaussian(steps, step_s, excited_hz, 1.0, rng) * rise(time_s - quiet_s, RISE_S)
    excited = (time_s >= quiet_s) & (time_s < duration_s)
    columns = [force * (rms_n / np.sqrt(np.mean(force[excited] ** 2)))]
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
