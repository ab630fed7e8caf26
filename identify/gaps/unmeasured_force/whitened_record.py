"""Whitened linear residual of a record with its nuisance columns, in which an unmeasured force is sought.

At every line the sensors' accelerations A, in standard deviations sigma, obey

    N^H (A - G_F F) / sigma = r = D theta + g f + e,   cov(e) = s (I + S_F g_F g_F^H)

N spans the complement of what contact forces (and a base motion) cause, so that these stay free. G are accelerances, F
is the measured force and f the unmeasured one. The noise of the force channel, of variance S_F at each line, is
whitened (of several forces, each; of a measured base that of its sensor); s is free in bands of 2 Hz. The nuisance
columns D are frequency and damping of each mode, gain and place of each sensor and the gain of the force, each by one
tolerance. They are linearised about the measured modal accelerations q'' = Phi^+ (A - Phi_high q''_high): the modelled
ones lack what the unmeasured force does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Complex, Float, Int

from identify.gaps.residual.gauges import without_slow_bending
from identify.gaps.residual.linear import LinearModel, linear_model
from identify.gaps.residual.record import Record
from identify.linear.model import Response, accelerances
from identify.linear.nuisance import Nuisance
from identify.linear.projection import input_complement
from identify.signals.beginning import STD_BY_MEDIAN
from identify.signals.kinematics import taper
from rig.errors import RigError
from rig.model.description import Rig, Station

BAND_WIDTH_HZ = 2.0
"""Width of the bands in which s and S are constant, as `scales.BAND_WIDTH_HZ`."""
GATE_FADE_S = 0.5
"""Length of the fade of the gate. Set by hand."""
LOWEST_LINE_HZ = 0.75
"""Lowest line: below, integration falsifies every motion. Derived: 1.5 times the integration corner."""
OBSERVABILITY_LIMIT = 1e-2
"""Singular value of the mode shapes at the sensors, over the largest, below which the model gives the motion. Set by
hand."""


@dataclass(frozen=True)
class WhitenedRecord:
    """Whitened residual r (lines, rows) and nuisance columns D (columns, lines, rows) of a record.

    complement_basis is N^H, from standardised accelerations to rows. residual_squares, cross_products and column_gram
    are |r|^2, Re D^H r and Re D^H D summed over bands of 2 Hz, which begin at band_first_lines. trace_terms are the
    columns' 2 Re tr(dD/dA). force_noise_modes are the principal directions of the force channels' noise,
    force_noise_shares the part of each that whitening takes off.
    """

    record: Record
    model: LinearModel
    line_slice: slice
    complement_basis: Complex[np.ndarray, "lines rows sensors"]
    force_noise_modes: Complex[np.ndarray, "lines rows modes"]
    force_noise_shares: Float[np.ndarray, "lines modes"]
    whitened_residual: Complex[np.ndarray, "lines rows"]
    nuisance_parameters: tuple[Nuisance, ...]
    nuisance_columns: Complex[np.ndarray, "kept lines rows"]
    modal_accelerations: tuple[Complex[np.ndarray, "_ alllines"], ...]
    band_first_lines: Int[np.ndarray, " bands"]
    residual_squares: Float[np.ndarray, " bands"]
    cross_products: Float[np.ndarray, "bands columns"]
    column_gram: Float[np.ndarray, "bands columns columns"]
    trace_terms: Float[np.ndarray, " columns"]

    @property
    def line_omegas(self) -> Float[np.ndarray, " lines"]:
        return self.record.omega[self.line_slice]

    @property
    def row_count(self) -> int:
        return self.whitened_residual.shape[1]

    @property
    def reals_per_line(self) -> float:
        """Count n of independent real values for each complex line, by the gate's share of the transform."""
        return 2.0 * float(np.sum(self.time_gate**2)) * self.record.decimation / self.record.transform_length

    @cached_property
    def time_gate(self) -> Float[np.ndarray, " alltimes"]:
        """Window: one where the residual counts, with smooth flanks to zero where the record's ends falsify it."""
        counted_slice, record = self.record.counted_slice, self.record
        gate = np.zeros(record.transform_length // record.decimation)
        faded_window = taper(counted_slice.stop - counted_slice.start, round(GATE_FADE_S * record.residual_rate_hz))
        gate[counted_slice] = faded_window if counted_slice.start == 0 else faded_window * faded_window[::-1]
        return gate

    @property
    def band_line_counts(self) -> Int[np.ndarray, " bands"]:
        """Count of lines in each band."""
        return np.diff(np.append(self.band_first_lines, self.whitened_residual.shape[0]))

    def at_each_line(self, band_values: Float[np.ndarray, " bands"]) -> Float[np.ndarray, " lines"]:
        """Value of its band at every line."""
        return np.repeat(band_values, self.band_line_counts)

    def ungated_residual(
        self, accelerations: Complex[np.ndarray, "sensors alllines"]
    ) -> Complex[np.ndarray, "lines rows"]:
        """Whitened residual of accelerations (m/s^2) at the sensors, without the gate."""
        standardised = self.model.sensor_response * accelerations / self.model.error_deviation
        return self.without_force_noise(self.projected_rows(standardised[:, self.line_slice]))

    def gated_residual(
        self, standardised_signals: Complex[np.ndarray, "sensors alllines"]
    ) -> Complex[np.ndarray, "lines rows"]:
        """Whitened residual of the sensors' standardised signals, gated in time."""
        projected = self.projected_rows(standardised_signals[:, self.line_slice])
        back_projected = np.zeros_like(standardised_signals)
        back_projected[:, self.line_slice] = (self.complement_basis.conj().transpose(0, 2, 1) @ projected[:, :, None])[
            :, :, 0
        ].T
        sample_count = self.record.transform_length // self.record.decimation
        gated_signals = np.fft.irfft(back_projected, sample_count) * self.time_gate
        return self.without_force_noise(self.projected_rows(np.fft.rfft(gated_signals)[:, self.line_slice]))

    def projected_rows(
        self, standardised_signals: Complex[np.ndarray, "sensors lines"]
    ) -> Complex[np.ndarray, "lines rows"]:
        """Rows N^H y of standardised signals y, in which contact forces do not show."""
        return np.asarray((self.complement_basis @ standardised_signals.T[:, :, None])[:, :, 0])

    def without_force_noise(self, rows: Complex[np.ndarray, "lines rows"]) -> Complex[np.ndarray, "lines rows"]:
        """Rows with the covariance I + S_F g_F g_F^H of the force channels' noise reduced to I."""
        amplitudes = np.einsum("lrm,lr->lm", self.force_noise_modes.conj(), rows)
        noise_rows = np.einsum("lrm,lm->lr", self.force_noise_modes, self.force_noise_shares * amplitudes)
        return np.asarray(rows - noise_rows)

    def accelerance(self, station: Station) -> Complex[np.ndarray, "sensors alllines"]:
        """Accelerance from a force at a station to the sensors, m/s^2 per N."""
        accelerances, places = np.zeros(self.model.sensor_response.shape, dtype=complex), self.record.sensor_places
        for response in self.model.responses:
            if response.body.name == station.body:
                accelerances += response.transfer(response.shapes(places), response.shapes([station]))[0]
        return accelerances

    def acceleration_at(self, station: Station) -> Complex[np.ndarray, " alllines"]:
        """Acceleration at a station: observed modes as measured, the others as modelled."""
        for response, accelerations in zip(self.model.responses, self.modal_accelerations, strict=True):
            if response.body.name == station.body:
                return np.asarray(response.shapes([station])[0] @ accelerations)
        raise KeyError(station.body)


def whitened_record_without_nuisance(record: Record, rig: Rig) -> WhitenedRecord:
    """Whitened residual of a record against the linear part of a rig, without nuisance columns.

    Raises RigError if the contacts' free forces explain all that the sensors give.
    """
    # the force channels' noise is whitened below; unmeasured responses are windowed
    no_force_noise = np.zeros_like(record.force_noise_variance)
    base_noise_variance = record.base.noise_variance if record.base else no_force_noise
    record = replace(
        record,
        noise_variance=capped_noise_variance(record),
        force_noise_variance=no_force_noise,
        base=record.base and replace(record.base, noise_variance=0 * base_noise_variance),
        responses_windowed=False,
    )
    model = linear_model(record, rig, record.tolerances.unmodelled)
    line_slice = slice(int(np.searchsorted(record.omega, 2 * np.pi * LOWEST_LINE_HZ)), record.omega.size)
    complement_basis = input_complement(model.signal_per_input[..., line_slice])
    line_count, row_count, _ = complement_basis.shape
    if not row_count:
        raise RigError(
            f"{len(record.sensors)} sensors and {len(model.rig.contacts)} contacts leave nothing that could show an "
            "unmeasured force; add a sensor"
        )
    band_first_lines = _band_first_lines(record.omega[line_slice])
    unwhitened_record = WhitenedRecord(
        record=record,
        model=model,
        line_slice=line_slice,
        complement_basis=complement_basis,
        force_noise_modes=np.zeros((line_count, row_count, 0), dtype=complex),
        force_noise_shares=np.zeros((line_count, 0)),
        whitened_residual=np.zeros((line_count, row_count), dtype=complex),
        nuisance_parameters=(),
        nuisance_columns=np.zeros((0, line_count, row_count), dtype=complex),
        modal_accelerations=tuple(
            _measured_modal_accelerations(record, model, response, modelled)
            for response, modelled in zip(model.responses, model.modal_accelerations, strict=True)
        ),
        band_first_lines=band_first_lines,
        residual_squares=np.zeros(band_first_lines.size),
        cross_products=np.zeros((band_first_lines.size, 0)),
        column_gram=np.zeros((band_first_lines.size, 0, 0)),
        trace_terms=np.zeros(0),
    )
    force_responses = np.stack(
        [
            unwhitened_record.ungated_residual(acceleration_per_newton / rig.force_sensor.gain - bool(record.base))
            for acceleration_per_newton in accelerances(model.rig, model.responses, rig.forces, record.sensor_places)[
                : len(rig.forces)
            ]
        ],
        axis=2,
    )
    noise_variance = base_noise_variance[line_slice, None, None] if record.base else force_noise_variance(record)
    noise_modes, singular_values, _ = np.linalg.svd(force_responses * np.sqrt(noise_variance), full_matrices=False)
    noise_shares = 1 - 1 / np.sqrt(1 + singular_values**2)
    whitened = replace(unwhitened_record, force_noise_modes=noise_modes, force_noise_shares=noise_shares)
    return replace(whitened, whitened_residual=whitened.gated_residual(model.residual[: len(record.sensors)]))


def without_nuisance_columns(whitened: WhitenedRecord) -> WhitenedRecord:
    """Record with the band sums of its nuisance columns alone, which are large, where it describes no force."""
    return replace(whitened, nuisance_columns=whitened.nuisance_columns[:0].copy())


def with_columns(
    whitened: WhitenedRecord,
    parameters: tuple[Nuisance, ...],
    column_sets: Sequence[Complex[np.ndarray, "_ lines rows"]],
    trace_terms: Float[np.ndarray, " columns"],
) -> WhitenedRecord:
    """Record with columns of one or more sets, kept in single precision, and their sums over bands."""
    real_residual = np.ascontiguousarray(whitened.whitened_residual).view(float)
    residual_squares, cross_products, column_gram = [], [], []
    for first_line, stop_line in pairwise(np.append(whitened.band_first_lines, real_residual.shape[0])):
        band_sets = [columns[:, first_line:stop_line].astype(complex) for columns in column_sets]
        band_columns = np.concatenate(band_sets).view(float).reshape(len(parameters), -1)
        band_residual = real_residual[first_line:stop_line].ravel()
        residual_squares.append(band_residual @ band_residual)
        cross_products.append(band_columns @ band_residual)
        column_gram.append(band_columns @ band_columns.T)
    return replace(
        whitened,
        nuisance_parameters=parameters,
        nuisance_columns=np.concatenate([columns.astype(np.complex64, copy=False) for columns in column_sets]),
        residual_squares=np.array(residual_squares),
        cross_products=np.array(cross_products),
        column_gram=np.array(column_gram),
        trace_terms=trace_terms,
    )


def capped_noise_variance(record: Record) -> Float[np.ndarray, "sensors lines"]:
    """Noise power of each sensor at each line, at most that of rig.json: a force that acts before the excitation
    is no noise."""
    noise_variance = record.noise_variance.copy()
    for variance, sensor, factor in zip(noise_variance, record.sensors, record.signal_factors, strict=True):
        if sensor.noise_density > 0:
            line_density = factor * sensor.noise_density * record.omega ** (2 - sensor.measures.order)
            variance[:] = np.minimum(variance, record.sample_count * line_density**2 * record.sample_rate_hz / 2)
    return noise_variance


def force_noise_variance(record: Record) -> Float[np.ndarray, " forces"]:
    """Variance of the noise at a line of each force channel (N^2): the lower of what the quiet start and the lines of
    the upper half of the band show."""
    high_band_power = np.abs(record.force_spectra[:, record.omega.size // 2 :]) ** 2
    noise_variance = np.median(high_band_power, axis=1) / np.log(2)
    is_quiet = record.residual_times_s < record.excitation_start_s - 0.05
    if np.count_nonzero(is_quiet) > 0.2 * record.residual_rate_hz:
        quiet_n = STD_BY_MEDIAN * np.median(np.abs(record.in_time(record.force_spectra)[:, is_quiet]), axis=1)
        quiet_variance = record.sample_count * quiet_n**2 * record.sample_rate_hz / record.residual_rate_hz
        noise_variance = np.minimum(noise_variance, quiet_variance)
    return np.asarray(noise_variance)


def modal_inverse(record: Record, response: Response) -> Float[np.ndarray, "low sensors"]:
    """Pseudoinverse from accelerations at the sensors to those of the body's lowest modes, one mode a sensor of
    motion."""
    sensor_indices = record.motion_sensor_indices_on(response.body.name)
    mode_count = min(len(sensor_indices), response.mode_count)
    inverse_shapes = np.zeros((mode_count, len(record.sensors)))
    if mode_count:
        shapes = response.shapes([record.sensor_places[index] for index in sensor_indices])[:, :mode_count]
        inverse_shapes[:, sensor_indices] = np.linalg.pinv(shapes, rcond=OBSERVABILITY_LIMIT)
    return inverse_shapes


def _measured_modal_accelerations(
    record: Record, model: LinearModel, response: Response, modelled: Complex[np.ndarray, "modes lines"]
) -> Complex[np.ndarray, "modes lines"]:
    """Modal accelerations: the lowest as the sensors show them, the others, and what is badly observed, as modelled."""
    inverse_shapes = modal_inverse(record, response)
    observed_count = len(inverse_shapes)
    unexplained = (
        record.acceleration_signals / model.sensor_response
        - model.base_at_sensors
        - response.shapes(record.sensor_places) @ modelled
    )
    correction = without_slow_bending(record, response, inverse_shapes @ unexplained)
    return np.concatenate([modelled[:observed_count] + correction, modelled[observed_count:]])


def _band_first_lines(line_omegas: Float[np.ndarray, " lines"]) -> Int[np.ndarray, " bands"]:
    """First line of each band of `BAND_WIDTH_HZ`."""
    band_numbers = np.floor(line_omegas / (2 * np.pi * BAND_WIDTH_HZ)).astype(int)
    return np.flatnonzero(np.diff(band_numbers, prepend=-1))
