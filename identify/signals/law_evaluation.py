"""Contact laws evaluated on band-limited signals without aliasing: interpolate, evaluate, low-pass, decimate.

The force of a law with a kink has a spectrum that falls as 1/f^2, with a damper that sets in at contact as 1/f. Sampled
at the rate of a recording, it folds back into the band of the motion. The signals themselves are smooth: they are
interpolated to LAW_RATE_HZ without new frequencies, and the law's results are low-passed before they are decimated.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, next_fast_len, rfft
from scipy.sparse import csc_matrix, csr_matrix

from identify.signals.spectra import at_force_rate, decimated, oversampled
from rig.model.contact_laws import penetration_m

LAW_RATE_HZ, MAX_OVERSAMPLING = 16384.0, 8
"""Laws are evaluated at the multiple of a recording's rate nearest to LAW_RATE_HZ, or at most at MAX_OVERSAMPLING times
its rate, as slow recordings are of slow motion.

Errors against 131 kHz on the reference rig of 4096 Hz with contact damping: clearance within 0.0003 %, stiffness within
0.0025 %; at 8192 Hz 0.0008 and 0.006 %, at 4096 Hz 0.0026 and 0.023 %. On that of 512 Hz 0.0001 and 0.0002 %."""
BLOCK_SAMPLES, MARGIN_SAMPLES = 5120, 256
"""Samples of a block, and of each of two margins on either side: the signals rise from zero in the outer ones, the
law's results in the inner ones."""
PADDED_SAMPLES = BLOCK_SAMPLES + 4 * MARGIN_SAMPLES
BATCH_VALUES = 1 << 16
"""Values of one signal at the finer rate in memory at once."""
TANGENT_MARGIN_SAMPLES = 32
"""Samples of the force on either side of a spline's support that its column keeps; the low-pass rings on beyond, as
1/n. Set by hand: the changes are then right within 2 % (`test_tangent`)."""

Law = Callable[..., Float[np.ndarray, "*results blocks fine"]]


def oversampling(sample_rate_hz: float) -> int:
    """Factor of the rate at which a law is evaluated, over a recording's."""
    return min(max(1, round(LAW_RATE_HZ / sample_rate_hz)), MAX_OVERSAMPLING)


def law_step_s(sample_rate_hz: float) -> float:
    """Time between the samples at which a law is evaluated, s."""
    return 1 / (sample_rate_hz * oversampling(sample_rate_hz))


def product_rate_multiple(sample_rate_hz: float, decimation: int) -> int:
    """Multiple of the rate of every `decimation`-th sample at which products of two signals of that rate are exact.

    It divides the decimation, or the factor of the rate at which a law is evaluated; 1 where both are 1.
    """
    factor = oversampling(sample_rate_hz)
    multiples = range(2, max(decimation, factor) + 1)
    return next((multiple for multiple in multiples if not decimation % multiple or not factor % multiple), 1)


def evaluated_law(
    law: Law, signals: Float[np.ndarray, "rows samples"], sample_rate_hz: float, decimation: int = 1
) -> Float[np.ndarray, "*results fewer"]:
    """law(*signals), for a law without memory, low-passed as by `at_force_rate`.

    A law may return several results along leading axes. It is evaluated block by block, which bounds the memory. Each
    block is resampled by Fourier transforms under tapers that are one inside the block, so that it need not be
    periodic.
    """
    batches = finer_signal_batches(signals, sample_rate_hz)
    return at_force_rate(evaluated_on_batches(law, batches, signals.shape[1], sample_rate_hz), decimation)


def finer_signal_batches(
    signals: Float[np.ndarray, "rows samples"], sample_rate_hz: float
) -> Iterator[Float[np.ndarray, "..."]]:
    """Signals at the rate at which laws are evaluated, for `evaluated_on_batches`: some blocks at a time, rows x blocks
    x samples, or as they are if that is their rate."""
    factor, sample_count = oversampling(sample_rate_hz), signals.shape[1]
    if factor == 1:
        yield signals
        return
    block_count = -(-sample_count // BLOCK_SAMPLES)
    padding = 2 * MARGIN_SAMPLES, block_count * BLOCK_SAMPLES + 2 * MARGIN_SAMPLES - sample_count
    padded_signals = np.pad(signals, [(0, 0), padding], mode="edge")
    blocks = sliding_window_view(padded_signals, PADDED_SAMPLES, axis=1)[:, ::BLOCK_SAMPLES]
    taper, batch_blocks = _taper(PADDED_SAMPLES, 0, MARGIN_SAMPLES), max(1, BATCH_VALUES // (PADDED_SAMPLES * factor))
    for first_block in range(0, block_count, batch_blocks):
        yield _upsampled_blocks(blocks[:, first_block : first_block + batch_blocks] * taper, factor)


def evaluated_on_batches(
    law: Law,
    batches: Iterable[Float[np.ndarray, "..."]],
    sample_count: int,
    sample_rate_hz: float,
    decimation: int = 1,
    multiple: int = 1,
) -> Float[np.ndarray, "*results fewer"]:
    """Law of signals of so many samples at the finer rate, low-passed to every `decimation`-th sample.

    `multiple`, of `product_rate_multiple`, gives so many results for each of these.
    """
    factor = oversampling(sample_rate_hz)
    if not decimation % multiple:
        decimation, multiple = decimation // multiple, 1
    if factor == 1:
        (signals,) = batches
        return decimated(law(*signals), decimation)
    result_taper = _taper(PADDED_SAMPLES * factor, MARGIN_SAMPLES * factor, MARGIN_SAMPLES * factor)
    inner_samples = slice(2 * MARGIN_SAMPLES * multiple, (2 * MARGIN_SAMPLES + BLOCK_SAMPLES) * multiple)
    results = [
        _resampled_results(law(*signals) * result_taper, factor, multiple)[..., inner_samples] for signals in batches
    ]
    blocks = np.concatenate(results, axis=-2)
    return decimated(blocks.reshape(*blocks.shape[:-2], -1)[..., : sample_count * multiple], decimation)


def interpolated(signal: Float[np.ndarray, " samples"], sample_rate_hz: float) -> Float[np.ndarray, " fine"]:
    """Signal at the finer rate, for a law with memory; `low_passed` takes its results back."""
    return oversampled(signal, oversampling(sample_rate_hz))


def low_passed(fine: Float[np.ndarray, " fine"], sample_rate_hz: float, decimation: int) -> Float[np.ndarray, " fewer"]:
    """Signals low-passed from the finer rate to every `decimation`-th sample of the recording, as `at_force_rate`."""
    return at_force_rate(decimated(fine, oversampling(sample_rate_hz)), decimation)


def penetration(
    eta_m: Float[np.ndarray, " samples"], lower_m: float, upper_m: float, sample_rate_hz: float
) -> Float[np.ndarray, " samples"]:
    """Dead zone of a band-limited relative displacement, up to half its rate."""
    batches = finer_signal_batches(eta_m[None], sample_rate_hz)
    law = partial(penetration_m, lower_clearance_m=lower_m, upper_clearance_m=upper_m)
    return evaluated_on_batches(law, batches, eta_m.size, sample_rate_hz)


def _upsampled_blocks(
    blocks: Float[np.ndarray, "rows blocks length"], factor: int
) -> Float[np.ndarray, "rows blocks fine"]:
    """Blocks at `factor` times their rate."""
    fine_spectra = rfft(blocks) * factor
    fine_spectra[..., -1] /= 2  # half the rate stands for both signs
    return np.asarray(irfft(fine_spectra, PADDED_SAMPLES * factor))


def _resampled_results(
    fine_results: Float[np.ndarray, "*results fine"], factor: int, multiple: int
) -> Float[np.ndarray, "*results length"]:
    """Results at multiple / factor times the rate."""
    padded_length = PADDED_SAMPLES * multiple
    spectra = rfft(fine_results)[..., : padded_length // 2 + 1] * (multiple / factor)
    if multiple < factor:
        spectra[..., -1] *= 2
    return np.asarray(irfft(spectra, padded_length))


def _taper(length: int, zero_samples: int, rise_samples: int) -> Float[np.ndarray, " length"]:
    """Taper of `zero_samples` zeros and a rise to one over `rise_samples`, and the same backwards at the end."""
    rising_taper = np.sin(np.pi / 2 * np.clip((np.arange(length) + 0.5 - zero_samples) / rise_samples, 0, 1)) ** 2
    return np.asarray(rising_taper * rising_taper[::-1])


@dataclass(frozen=True)
class LawTangent:
    """Tangent stiffness T of a law, N/m, at `rate_multiple` times the rate of the force: the change of the low-passed
    force with small changes of relative displacement,

        df(t) = LP[ T(t) deta(t) ]        T = d law / d eta along the present motion

    T jumps as a contact opens and closes, and deta may move within one closure, so that the product is low-passed as a
    whole: LP[T] deta is wrong by more than a tenth (`test_tangent`), also where the contact is open and weighs most. To
    the band of the force, f_c, only the part of T below f_c + f_deta <= 2 f_c contributes, so T is kept at a low
    multiple of the force's rate, at which the product is exact.
    """

    stiffness_n_per_m: Float[np.ndarray, " finer"]
    rate_multiple: int

    def force_change_n(self, eta_change_m: Float[np.ndarray, "*rows finer"]) -> Float[np.ndarray, "*rows times"]:
        """Change of the force, N, with changes of relative displacement at the rate of T."""
        return decimated(self.stiffness_n_per_m * eta_change_m, self.rate_multiple)

    def force_change_by_coefficient(self, spline_values: csr_matrix) -> csc_matrix:
        """Change of the force, N/m, with each coefficient of a spline, whose value is spline_values @ coefficients."""
        columns = spline_values.tocsc()
        moving_columns = np.flatnonzero(np.diff(columns.indptr))
        selection_shape = moving_columns.size, columns.shape[1]
        rows = np.arange(moving_columns.size)
        selection = csc_matrix((np.ones(moving_columns.size), (rows, moving_columns)), shape=selection_shape)
        return self._force_columns_in_windows(columns[:, moving_columns]) @ selection

    def _force_columns_in_windows(self, spline_values: csc_matrix) -> csc_matrix:
        """Columns of a spline that moves the contact."""
        if not spline_values.shape[1]:
            return csc_matrix(spline_values.shape)
        first_samples, splines = _spline_windows(spline_values)
        window_sample_count, rate_multiple = splines.shape[1], self.rate_multiple
        spline_increments = np.append(splines[:, 1:], np.zeros((len(splines), 1)), axis=1) - splines
        finer_splines = splines[..., None] + spline_increments[..., None] * (np.arange(rate_multiple) / rate_multiple)
        finer_samples = window_sample_count * rate_multiple
        padded_stiffness = np.pad(self.stiffness_n_per_m, finer_samples)
        first_finer = finer_samples + rate_multiple * first_samples[:, None]
        products = padded_stiffness[first_finer + np.arange(finer_samples)] * finer_splines.reshape(len(splines), -1)
        forces = irfft(rfft(products)[:, : window_sample_count // 2 + 1] / rate_multiple, window_sample_count)
        sample_indices = first_samples[:, None] + np.arange(window_sample_count)
        is_inside = (sample_indices >= 0) & (sample_indices < spline_values.shape[0])
        column_starts = np.append(0, np.cumsum(np.count_nonzero(is_inside, axis=1)))
        return csc_matrix((forces[is_inside], sample_indices[is_inside], column_starts), shape=spline_values.shape)


def _spline_windows(columns: csc_matrix) -> tuple[Int[np.ndarray, " splines"], Float[np.ndarray, "splines length"]]:
    """First sample of each spline's window, a margin before its support, and the spline's values in it."""
    support = np.diff(columns.indptr)
    first_samples = columns.indices[columns.indptr[:-1]] - TANGENT_MARGIN_SAMPLES
    splines = np.zeros((len(support), next_fast_len(int(support.max()) + 2 * TANGENT_MARGIN_SAMPLES, real=True)))
    spline_of_entry = np.repeat(np.arange(len(support)), support)
    splines[spline_of_entry, columns.indices - first_samples[spline_of_entry]] = columns.data
    return first_samples, splines
