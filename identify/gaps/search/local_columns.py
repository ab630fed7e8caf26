"""Columns of the local model: each column's spectra by segment and its contact residuals, reduced once it is made."""

import numpy as np
from jaxtyping import Float, Int
from scipy.signal.windows import hann

from identify.gaps.residual.fit import contact_residual_columns
from identify.gaps.residual.likelihood import NominalVariances
from identify.gaps.residual.residual import Linearization, Residual, ResidualColumn
from identify.gaps.residual.scales import band_means, segment_counts


class LocalColumns:
    """Columns as `LocalModel` holds them, each reduced as soon as it is made: over time they take twice the memory.

    They begin with those of the tolerances, and have room for `added_column_count` more. `spectra` and `row_cell` are
    those of `LocalModel`, `inputs` the rows of inputs with a prior, `count` the number of columns so far.
    """

    def __init__(
        self, linearization: Linearization, residual: Residual, variances: NominalVariances, added_column_count: int
    ) -> None:
        self.linearization, self.residual = linearization, residual
        sensor_count, (row_count, time_count) = len(linearization.record.sensors), residual.linear_residual.shape
        self.norms, self.row_cell = _scales_and_cells(linearization, variances, time_count)
        column_capacity = residual.pulls.size + added_column_count
        self.spectra = np.zeros((column_capacity, self.row_cell.size), np.float32)
        self.inputs = np.zeros((column_capacity, (row_count - sensor_count) * time_count), np.float32)
        for nuisance_index, linear_decrease in enumerate(linearization.columns.residual):
            self._set_linear(nuisance_index, linear_decrease)
        self.contacts, self.count = list[list[Float[np.ndarray, " _"]]](), residual.pulls.size

    def append(self, column: ResidualColumn) -> None:
        linear_decrease, contact_decreases = column
        self._set_linear(self.count, linear_decrease)
        self.contacts.append(contact_decreases)
        self.count += 1

    def _set_linear(self, column_index: int, linear_decrease: Float[np.ndarray, "rows times"]) -> None:
        self.spectra[column_index] = self.spectrum(linear_decrease)
        self.inputs[column_index] = linear_decrease[len(self.linearization.record.sensors) :].ravel()

    def spectrum(self, linear_decrease: Float[np.ndarray, "rows times"]) -> Float[np.ndarray, " values"]:
        record = self.linearization.record
        return _spectra(record.residual_rate_hz, linear_decrease[: len(record.sensors)], self.norms)

    def contact_rows(self, contact_index: int) -> Float[np.ndarray, "rows columns"]:
        """Columns of one contact's residual, those of its own tolerances among them."""
        columns_of_contact = contact_residual_columns(self.linearization, self.residual, contact_index, self.count)
        for column_index, contact_decreases in enumerate(self.contacts, self.residual.pulls.size):
            columns_of_contact[:, column_index] = contact_decreases[contact_index]
        return columns_of_contact


def _scales_and_cells(
    linearization: Linearization, nominal_variances: NominalVariances, sample_count: int
) -> tuple[Float[np.ndarray, "sensors bands"], Int[np.ndarray, " rows"]]:
    """Factors that make the squares of spectra in standard deviations add up to L; and the cell of each row."""
    record, sensor_count = linearization.record, len(linearization.record.sensors)
    _, segment_count, lines_per_band, band_count = segment_counts(record.residual_rate_hz, sample_count)
    variances = band_means(record, linearization.model.error_deviation**2, band_count)
    spectrum_scales = np.sqrt((variances / nominal_variances.expected_variance).T / (segment_count * lines_per_band))
    row_shape = (sensor_count, segment_count, band_count, lines_per_band, 2)
    sensor_index = np.arange(sensor_count)[:, None, None, None, None]
    cell_index = np.arange(band_count)[None, None, :, None, None] * sensor_count + sensor_index
    return spectrum_scales, np.ascontiguousarray(np.broadcast_to(cell_index, row_shape)).ravel()


def _spectra(
    rate_hz: float, signal: Float[np.ndarray, "sensors times"], spectrum_scales: Float[np.ndarray, "sensors bands"]
) -> Float[np.ndarray, " values"]:
    """Spectra of the segments under a Hann window, real and imaginary parts, scaled by band and sensor."""
    samples, segment_count, lines, band_count = segment_counts(rate_hz, signal.shape[1])
    window = hann(samples, sym=False)
    window = window / np.sqrt(np.sum(window**2))
    segments = signal[:, : segment_count * samples].reshape(len(signal), segment_count, samples) * window
    spectra = np.fft.rfft(segments, axis=2)[:, :, : band_count * lines]
    spectra = spectra.reshape(len(signal), segment_count, band_count, lines) * spectrum_scales[:, None, :, None]
    return np.stack([spectra.real, spectra.imag], axis=-1).astype(np.float32).ravel()
