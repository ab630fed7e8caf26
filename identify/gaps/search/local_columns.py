"""Columns of the local model: each column's spectra by segment and its contact residuals, reduced once it is made."""

import numpy as np
from jaxtyping import Float, Int
from scipy.signal.windows import hann

from identify.gaps.residual.fit import contact_residual_columns
from identify.gaps.residual.likelihood import NominalVariances
from identify.gaps.residual.residual import Linearization, Residual, ResidualColumn
from identify.gaps.residual.scales import band_means, segment_and_band_counts


class LocalColumns:
    """Columns as `LocalModel` holds them, each reduced as soon as it is made: over time they take twice the memory.

    They begin with those of the tolerances, and have room for `added_column_count` more. `spectra` and `cell_of_row`
    are those of `LocalModel`, `input_rows` rows of inputs with a prior, `column_count` the number of columns so far.
    """

    def __init__(
        self, linearization: Linearization, residual: Residual, variances: NominalVariances, added_column_count: int
    ) -> None:
        self.linearization, self.residual = linearization, residual
        sensor_count, (row_count, time_count) = len(linearization.record.sensors), residual.linear_residual.shape
        self.spectrum_scales, self.cell_of_row = _spectrum_scales_and_cells(linearization, variances, time_count)
        column_capacity = residual.pulls.size + added_column_count
        self.spectra = np.zeros((column_capacity, self.cell_of_row.size), np.float32)
        self.input_rows = np.zeros((column_capacity, (row_count - sensor_count) * time_count), np.float32)
        for nuisance_index, linear_decrease in enumerate(linearization.columns.residual):
            self._set_linear(nuisance_index, linear_decrease)
        self.contact_decreases, self.column_count = list[list[Float[np.ndarray, " _"]]](), residual.pulls.size

    def append(self, column: ResidualColumn) -> None:
        linear_decrease, contact_decreases = column
        self._set_linear(self.column_count, linear_decrease)
        self.contact_decreases.append(contact_decreases)
        self.column_count += 1

    def _set_linear(self, column_index: int, linear_decrease: Float[np.ndarray, "rows times"]) -> None:
        self.spectra[column_index] = self.spectrum(linear_decrease)
        self.input_rows[column_index] = linear_decrease[len(self.linearization.record.sensors) :].ravel()

    def spectrum(self, linear_decrease: Float[np.ndarray, "rows times"]) -> Float[np.ndarray, " values"]:
        record = self.linearization.record
        return _scaled_spectra(record.residual_rate_hz, linear_decrease[: len(record.sensors)], self.spectrum_scales)

    def contact_rows(self, contact_index: int) -> Float[np.ndarray, "rows columns"]:
        """Columns of one contact's residual, those of its own tolerances among them."""
        columns = contact_residual_columns(self.linearization, self.residual, contact_index, self.column_count)
        for column_index, contact_decreases in enumerate(self.contact_decreases, self.residual.pulls.size):
            columns[:, column_index] = contact_decreases[contact_index]
        return columns


def _spectrum_scales_and_cells(
    linearization: Linearization, nominal_variances: NominalVariances, sample_count: int
) -> tuple[Float[np.ndarray, "sensors bands"], Int[np.ndarray, " rows"]]:
    """Factors that make the squares of spectra in standard deviations add up to L; and the cell of each row."""
    record, sensor_count = linearization.record, len(linearization.record.sensors)
    _, segment_count, lines_per_band, band_count = segment_and_band_counts(record.residual_rate_hz, sample_count)
    variances = band_means(record, linearization.model.error_deviation**2, band_count)
    spectrum_scales = np.sqrt((variances / nominal_variances.expected_variance).T / (segment_count * lines_per_band))
    row_shape = (sensor_count, segment_count, band_count, lines_per_band, 2)
    sensor_index = np.arange(sensor_count)[:, None, None, None, None]
    cell_index = np.arange(band_count)[None, None, :, None, None] * sensor_count + sensor_index
    return spectrum_scales, np.ascontiguousarray(np.broadcast_to(cell_index, row_shape)).ravel()


def _scaled_spectra(
    rate_hz: float, signal: Float[np.ndarray, "sensors times"], spectrum_scales: Float[np.ndarray, "sensors bands"]
) -> Float[np.ndarray, " values"]:
    """Spectra of the segments under a Hann window, real and imaginary parts, scaled by band and sensor."""
    samples, segment_count, lines, band_count = segment_and_band_counts(rate_hz, signal.shape[1])
    hann_window = hann(samples, sym=False)
    hann_window = hann_window / np.sqrt(np.sum(hann_window**2))
    segments = signal[:, : segment_count * samples].reshape(len(signal), segment_count, samples) * hann_window
    spectra = np.fft.rfft(segments, axis=2)[:, :, : band_count * lines]
    spectra = spectra.reshape(len(signal), segment_count, band_count, lines) * spectrum_scales[:, None, :, None]
    return np.stack([spectra.real, spectra.imag], axis=-1).astype(np.float32).ravel()
