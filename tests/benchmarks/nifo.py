"""NIFO on 16 channels of 2 million samples, 159 blocks: against its own FFTs, and against two ways to write it plainly.

A modal coordinate, its force and 14 penetrations; every channel is the sum of a common signal and of a small one of its
own, so that the inputs are conditioned as badly as 1e4.
"""

import tracemalloc
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import csd

from identify.linear.modal import ModalEquation
from identify.paper.nifo import nifo
from identify.signals.spectra import Averaging, Blocks, blocks, window_derivatives
from tests.benchmarks.measuring import Figure, least_cpu_s

CONTACTS, SAMPLES, AVERAGES, RATE_HZ = 14, 2_000_000, 159, 4096.0
OWN = 1 / 1500
SIMPLE_LINES = 500
"""The loop over lines is run for so many, and its time scaled up: each line costs the same."""


def figures() -> Iterator[Figure]:
    equation, force_n, penetration_m = _record()
    cut = blocks(SAMPLES, RATE_HZ, Averaging(averages=AVERAGES), (0.0, 0.499 * RATE_HZ))
    channels = [force_n, *penetration_m, equation.displacement]
    yield Figure("blocks", len(cut.starts))

    def estimate(form: str = "paper") -> Complex[np.ndarray, "lines contacts"]:
        found = nifo(equation, force_n, penetration_m, cut, form)
        return np.concatenate([found.frf[None], found.stiffness_n_per_m]).T

    own_s = least_cpu_s(estimate)
    yield Figure("CPU s", own_s)
    fft_s = least_cpu_s(lambda: [_transform_all(channel, cut) for channel in channels])
    yield Figure("CPU over that of its FFTs, one by one", own_s / fft_s, at_most=3)
    yield Figure("memory beyond the data", _beyond(estimate) / 1e6, "MB", at_most=200)

    held_s = least_cpu_s(lambda: np.array([_spectra(c, cut) for c in channels]), times=2)
    spectra = np.array([_spectra(c, cut) for c in channels])
    some = range(0, spectra.shape[2], spectra.shape[2] // SIMPLE_LINES)
    loop_s = least_cpu_s(lambda: _loop(spectra, some)) * spectra.shape[2] / len(some) + held_s
    yield Figure("times faster than a loop of lstsq over the lines", loop_s / own_s, at_least=4)
    yield Figure("CPU of that loop over that of its FFTs", loop_s / fft_s)
    plain = _loop(spectra, some)
    plain[:, 1:] = -plain[:, 1:] / plain[:, :1]
    found = estimate()[some]
    yield Figure(
        "largest condition number of a line", float(np.linalg.cond(spectra[:-1, :, some].transpose(2, 1, 0)).max())
    )
    yield Figure("largest difference from it", float(np.abs(found / plain - 1).max()), at_most=1e-6)
    pair_s = least_cpu_s(lambda: csd(force_n, penetration_m[0], RATE_HZ, "hann", cut.block_samples), times=3)
    pairs = len(channels) * (len(channels) + 1) // 2
    yield Figure("times faster than scipy's csd pair by pair", pairs * pair_s / own_s, at_least=10)


def _record() -> tuple[ModalEquation, Float[np.ndarray, " samples"], Float[np.ndarray, "contacts samples"]]:
    rng = np.random.default_rng(1)
    common = rng.standard_normal(SAMPLES)
    force_n = common + rng.standard_normal(SAMPLES) * OWN
    penetration_m = common + rng.standard_normal((CONTACTS, SAMPLES)) * OWN
    displacement = force_n - 0.1 * penetration_m.sum(axis=0) + 0.1 * rng.standard_normal(SAMPLES) * OWN
    equation = ModalEquation(
        body="b",
        mode_number=1,
        frequency_hz=50.0,
        damping_ratio=0.01,
        shape_at_force=1.0,
        shape_at_contacts=np.ones(CONTACTS),
        visibility=(1.0,) * CONTACTS,
        displacement=displacement,
        velocity=displacement,
        acceleration=displacement,
    )
    return equation, force_n, penetration_m


def _transform_all(signal: Float[np.ndarray, " samples"], cut: Blocks) -> None:
    weights = window_derivatives(cut.window, cut.block_samples, RATE_HZ)[0]
    for start in cut.starts:
        np.fft.rfft(weights * signal[start : start + cut.block_samples])


def _spectra(signal: Float[np.ndarray, " samples"], cut: Blocks) -> Complex[np.ndarray, "blocks lines"]:
    weights = window_derivatives(cut.window, cut.block_samples, RATE_HZ)[0]
    return np.array([np.fft.rfft(weights * signal[s : s + cut.block_samples])[cut.lines] for s in cut.starts])


def _loop(spectra: Complex[np.ndarray, "channels blocks lines"], some: range) -> Complex[np.ndarray, "some inputs"]:
    return np.array([np.linalg.lstsq(spectra[:-1, :, k].T, spectra[-1, :, k], rcond=None)[0] for k in some])


def _beyond(work: Callable[[], object]) -> int:
    """The largest number of bytes that numpy held at once for it."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
