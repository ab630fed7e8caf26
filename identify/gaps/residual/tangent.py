"""Tangent of a contact's law: change of its low-passed force with small changes of relative displacement.

    df(t) = LP[ T(t) deta(t) ]        T = d law / d eta along the present motion, N/m

T jumps as a contact opens and closes, and deta may move within one closure, so that the product is low-passed as a
whole: LP[T] deta is wrong by more than a tenth (`test_tangent`), also where the contact is open and weighs most. To the
band of the force, f_c, only the part of T below f_c + f_deta <= 2 f_c contributes, so T is kept at a low multiple of
the force's rate, at which the product is exact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.fft import irfft, next_fast_len, rfft
from scipy.sparse import csc_matrix, csr_matrix

from identify.signals.spectra import decimated

MARGIN_SAMPLE_COUNT = 32
"""Samples of the force on either side of a spline's support that its column keeps; the low-pass rings on beyond, as
1/n. Set by hand: the changes are then right within 2 % (`test_tangent`)."""


@dataclass(frozen=True)
class LawTangent:
    """Tangent stiffness T of a law, N/m, at `rate_multiple` times the rate of the force."""

    stiffness_n_per_m: Float[np.ndarray, " finer"]
    rate_multiple: int

    def force_change_n(self, eta_change_m: Float[np.ndarray, "*rows finer"]) -> Float[np.ndarray, "*rows times"]:
        """Change of the force, N, with changes of relative displacement at the rate of T."""
        return decimated(self.stiffness_n_per_m * eta_change_m, self.rate_multiple)

    def spline_columns(self, spline_values: csr_matrix) -> csc_matrix:
        """Change of the force, N/m, with each coefficient of a spline, whose value is spline_values @ coefficients."""
        columns = spline_values.tocsc()
        moving_columns = np.flatnonzero(np.diff(columns.indptr))
        selection_shape = moving_columns.size, columns.shape[1]
        rows = np.arange(moving_columns.size)
        selection = csc_matrix((np.ones(moving_columns.size), (rows, moving_columns)), shape=selection_shape)
        return self._moving_columns(columns[:, moving_columns]) @ selection

    def _moving_columns(self, spline_values: csc_matrix) -> csc_matrix:
        """Columns of a spline that moves the contact."""
        if not spline_values.shape[1]:
            return csc_matrix(spline_values.shape)
        first_samples, splines = _windows(spline_values)
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


def _windows(columns: csc_matrix) -> tuple[Int[np.ndarray, " splines"], Float[np.ndarray, "splines length"]]:
    """First sample of each spline's window, MARGIN_SAMPLE_COUNT before its support, and the spline's values in it."""
    support = np.diff(columns.indptr)
    first_samples = columns.indices[columns.indptr[:-1]] - MARGIN_SAMPLE_COUNT
    splines = np.zeros((len(support), next_fast_len(int(support.max()) + 2 * MARGIN_SAMPLE_COUNT, real=True)))
    spline_of_entry = np.repeat(np.arange(len(support)), support)
    splines[spline_of_entry, columns.indices - first_samples[spline_of_entry]] = columns.data
    return first_samples, splines
