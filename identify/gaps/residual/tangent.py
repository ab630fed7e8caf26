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

MARGIN_SAMPLES = 32
"""Samples of the force on either side of a spline's support that its column keeps; the low-pass rings on beyond, as
1/n. Set by hand: the changes are then right within 2 % (`test_tangent`)."""


@dataclass(frozen=True)
class Tangent:
    """Tangent stiffness T of a law, N/m, at `multiple` times the rate of the force."""

    stiffness_n_per_m: Float[np.ndarray, " finer"]
    multiple: int

    def force_change_n(self, change_m: Float[np.ndarray, "*rows finer"]) -> Float[np.ndarray, "*rows times"]:
        """Change of the force, N, with changes of relative displacement at the rate of T."""
        return decimated(self.stiffness_n_per_m * change_m, self.multiple)

    def spline_columns(self, value: csr_matrix) -> csc_matrix:
        """Change of the force, N/m, with each coefficient of a spline, whose value is `value` @ coefficients."""
        if not value.shape[1]:
            return csc_matrix(value.shape)
        first, splines = _windows(value)
        length = splines.shape[1]
        following = np.append(splines[:, 1:], np.zeros((len(splines), 1)), axis=1)
        steps = np.arange(self.multiple) / self.multiple
        finer = (splines[..., None] + (following - splines)[..., None] * steps).reshape(len(splines), -1)
        padding = length * self.multiple
        stiffness = np.pad(self.stiffness_n_per_m, padding)
        windows = stiffness[padding + self.multiple * first[:, None] + np.arange(padding)]
        lines = rfft(windows * finer)[:, : length // 2 + 1] / self.multiple
        columns = irfft(lines, length)
        rows = first[:, None] + np.arange(length)
        is_inside = (rows >= 0) & (rows < value.shape[0])
        starts = np.append(0, np.cumsum(np.count_nonzero(is_inside, axis=1)))
        return csc_matrix((columns[is_inside], rows[is_inside], starts), shape=value.shape)


def _windows(value: csr_matrix) -> tuple[Int[np.ndarray, " splines"], Float[np.ndarray, "splines length"]]:
    """First sample of each spline's window, which reaches MARGIN_SAMPLES beyond its support, and its values there."""
    columns = value.tocsc()
    counts = np.diff(columns.indptr)
    first = columns.indices[columns.indptr[:-1]] - MARGIN_SAMPLES
    length = next_fast_len(int(counts.max()) + 2 * MARGIN_SAMPLES, real=True)
    splines = np.zeros((len(counts), length))
    spline_of = np.repeat(np.arange(len(counts)), counts)
    splines[spline_of, columns.indices - first[spline_of]] = columns.data
    return first, splines
