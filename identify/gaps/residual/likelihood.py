"""Likelihood of a record under a rig whose model error has an unknown scale: the statistic that compares hypotheses.

With L_bi the mean square of the linear residual of sensor i in band b, L_j that of contact j, both relative to the
variance by noise and the tolerated unmodelled shares, and an inverse-gamma prior of the true variances around that,

    -2 ln p = sum_bi N_b ln((1 + L_bi) / 2) + sum_j N_j ln((1 + L_j) / 2) + pulls^2 + drift + freedom + line_cost

With an unknown variance a residual ten times too large costs N ln 100 / 2, not N * 50: a lasting error (a slightly
wrong shape, a cable) is one error, however many samples show it. N is the number of independent samples. drift is the
prior cost of the slow motion, freedom that of inputs known by their spectrum alone (their squares and the determinant
of their marginal likelihood). line_cost is that of outstanding lines, as no model error is as sharp as one line.
Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001; the Student form is that of Lange et al., J. Am. Stat. Assoc. 84,
1989.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from identify.gaps.residual.law import ContactResidual
from identify.gaps.residual.lines import outstanding_line_cost
from identify.gaps.residual.observation import ContactObservation
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.residual.scales import (
    band_index,
    band_means,
    posterior_variance,
    power_weighted_band_variances,
    residual_mean_squares_by_second,
)

NOISE_SHARE_LIMIT = 0.5
"""Share of noise in the power above which a band is not used to measure shares of the motion. Set by hand:
displacements differentiated twice show noise alone above some hundred Hz."""
SIGNIFICANT_STANDARD_ERRORS = 3.0
"""Excess of a mean over n lines beyond noise, in its standard errors (mean / sqrt(n)), from which it is not due to
chance. Derived: noise exceeds it in less than 1 % of the bands."""


@dataclass(frozen=True)
class NominalVariances:
    """Variances by band and sensor under the nominal rig, shared by all models of a record.

    expected_variance is that by noise and tolerated shares, noise_variance its part by noise, acceleration_power the
    acceleration's mean square, all per line in the sensors' unit; line_counts is the number of lines in each band.
    """

    expected_variance: Float[np.ndarray, "bands sensors"]
    noise_variance: Float[np.ndarray, "bands sensors"]
    acceleration_power: Float[np.ndarray, "bands sensors"]
    line_counts: Float[np.ndarray, " bands"]
    observations: tuple[ContactObservation, ...]

    @property
    def has_signal(self) -> Bool[np.ndarray, "bands sensors"]:
        """Mask of bands and sensors with less than half of their power from noise."""
        return self.noise_variance < NOISE_SHARE_LIMIT * self.acceleration_power


def nominal_variances_of(linearization: Linearization) -> NominalVariances:
    """Variances from a linearisation at the scales of the tolerances."""
    record, error_variance = linearization.record, linearization.model.error_deviation**2
    sample_count = record.counted_slice.stop - record.counted_slice.start
    band_count = residual_mean_squares_by_second(record, np.zeros((len(record.sensors), sample_count))).shape[1]
    return NominalVariances(
        band_means(record, error_variance, band_count),
        band_means(record, record.noise_variance, band_count),
        band_means(record, record.smoothed_power, band_count),
        np.bincount(band_index(record, band_count), minlength=band_count).astype(float),
        linearization.observations,
    )


@dataclass(frozen=True)
class Misfit:
    """Misfit of a rig to a record, second by second.

    variance_by_second is the level of the linear residual times `NominalVariances.expected_variance`;
    variance_correction accounts for variances that change within a band (`scales.power_weighted_band_variances`).
    contact_mean_square_by_second is the mean square of each contact's residual relative to the nominal variance,
    contact_beyond_noise_n2 that beyond noise and contact_force_n2 that of the contact force (N^2). line_cost is
    `lines.outstanding_line_cost`, independent_samples the number of independent samples.
    """

    nominal_variances: NominalVariances
    variance_by_second: Float[np.ndarray, "seconds bands sensors"]
    variance_correction: Float[np.ndarray, "bands sensors"]
    contact_mean_square_by_second: Float[np.ndarray, "seconds contacts"]
    contact_beyond_noise_n2: Float[np.ndarray, "seconds contacts"]
    contact_force_n2: Float[np.ndarray, "seconds contacts"]
    pulls: Float[np.ndarray, " pulls"]
    drift_cost: float
    input_cost: float
    line_cost: float
    independent_sample_count: float

    @property
    def mean_squares(self) -> Float[np.ndarray, "bands sensors"]:
        """Mean squares L_bi of the linear residual: 1 for noise and tolerated shares alone."""
        return np.asarray(self.variance_by_second.mean(axis=0) / self.nominal_variances.expected_variance)

    @property
    def contact_mean_squares(self) -> Float[np.ndarray, " contacts"]:
        """Mean squares L_j of the contacts' residuals: 1 for noise and tolerated shares alone."""
        return np.asarray(self.contact_mean_square_by_second.mean(axis=0))

    @property
    def samples_per_cell(self) -> float:
        """Independent samples N_b of each band and sensor."""
        return self.independent_sample_count / self.variance_by_second.shape[1]

    @cached_property
    def band_cost(self) -> float:
        """Cost of the bands, sum_bi N_b ln((1 + L_bi) / 2)."""
        return float(self.samples_per_cell * np.sum(np.log(posterior_variance(self.mean_squares))))

    @cached_property
    def peak_band_cost(self) -> float:
        """Largest cost of a single band, over all sensors."""
        return float(self.samples_per_cell * np.max(np.sum(np.log(posterior_variance(self.mean_squares)), axis=1)))

    @cached_property
    def contact_cost(self) -> float:
        """Cost of the contacts, sum_j N_j ln((1 + L_j) / 2)."""
        return float(self.independent_sample_count * np.sum(np.log(posterior_variance(self.contact_mean_squares))))

    @property
    def minus_two_log(self) -> float:
        """-2 ln p, up to a constant of the record."""
        pulls_cost = float(self.pulls @ self.pulls)
        return self.band_cost + self.contact_cost + pulls_cost + self.drift_cost + self.input_cost + self.line_cost

    @property
    def excess_cost(self) -> float:
        """Part of -2 ln p above noise and tolerated shares: N ln L over cells and contacts with L > 1, and line_cost.

        Logarithms demand that a mismatch is removed everywhere; a mean square would weigh its peaks alone.
        """
        band_excess = self.samples_per_cell * np.sum(np.log(np.maximum(self.mean_squares, 1.0)))
        contact_excess = self.independent_sample_count * np.sum(np.log(np.maximum(self.contact_mean_squares, 1.0)))
        return float(band_excess + contact_excess) + self.line_cost

    @cached_property
    def residual_variance(self) -> Float[np.ndarray, "bands sensors"]:
        """Mean square of the linear residual per line, in the sensors' unit."""
        return np.asarray(self.variance_by_second.mean(axis=0) * self.variance_correction)

    @cached_property
    def residual_variance_beyond_noise(self) -> Float[np.ndarray, "bands sensors"]:
        """Mean square of the linear residual per line beyond noise; zero where noise dominates."""
        nominal_variances = self.nominal_variances
        return np.asarray((self.residual_variance - nominal_variances.noise_variance) * nominal_variances.has_signal)

    @property
    def share_by_band(self) -> Float[np.ndarray, " bands"]:
        """Unexplained share of the acceleration's root mean square by band, beyond noise."""
        power_by_band = np.maximum(self.nominal_variances.acceleration_power.sum(axis=1), 1e-300)
        return np.asarray(np.sqrt(np.maximum(self.residual_variance_beyond_noise, 0.0).sum(axis=1) / power_by_band))

    @property
    def unexplained_share(self) -> float:
        """Unexplained share of the acceleration's root mean square over all bands, beyond noise.

        Bands and sensors that exceed the noise by chance alone count together with those that fall below it: their
        positive parts add up to per cents where many bands are noisy. Those that exceed it by more count alone, so that
        noise that is estimated too high hides no misfit.
        """
        line_counts, excess = self.nominal_variances.line_counts[:, None], self.residual_variance_beyond_noise
        is_significant = excess > SIGNIFICANT_STANDARD_ERRORS * self.residual_variance / np.sqrt(line_counts)
        significant_power = float(np.sum(line_counts * excess * is_significant))
        insignificant_power = float(np.sum(line_counts * excess * ~is_significant))
        motion_power = max(self.power_by_band.sum(), 1e-300)
        return float(np.sqrt((significant_power + max(insignificant_power, 0.0)) / motion_power))

    @property
    def power_by_band(self) -> Float[np.ndarray, " bands"]:
        """Power of the measured acceleration in each band, over all sensors."""
        return np.asarray(self.nominal_variances.line_counts * self.nominal_variances.acceleration_power.sum(axis=1))

    @property
    def squared_unexplained_share_by_second(self) -> Float[np.ndarray, " seconds"]:
        """Square of `unexplained_share` for each second; negative where a second is quieter than the noise."""
        nominal = self.nominal_variances
        excess_power = self.variance_by_second * self.variance_correction - nominal.noise_variance
        motion_power = max(self.power_by_band.sum(), 1e-300)
        return np.einsum("sbi,b->s", excess_power * nominal.has_signal, nominal.line_counts) / motion_power

    @property
    def unexplained_contact_shares(self) -> Float[np.ndarray, " contacts"]:
        """Unexplained share of each contact force's root mean square, beyond noise."""
        excess_n2 = np.maximum(self.contact_beyond_noise_n2.mean(axis=0), 0.0)
        return np.asarray(np.sqrt(excess_n2 / np.maximum(self.contact_force_n2.mean(axis=0), 1e-300)))

    def resampled(self, second_indices: Int[np.ndarray, " seconds"]) -> "Misfit":
        """Misfit over a selection of seconds, for a bootstrap."""
        return replace(
            self,
            variance_by_second=self.variance_by_second[second_indices],
            contact_mean_square_by_second=self.contact_mean_square_by_second[second_indices],
            contact_beyond_noise_n2=self.contact_beyond_noise_n2[second_indices],
            contact_force_n2=self.contact_force_n2[second_indices],
        )


def misfit(record: Record, nominal_variances: NominalVariances, residual: Residual) -> Misfit:
    """Misfit of a fitted residual, in the nominal variances whatever the scales of the fit."""
    linear_residual, error_deviation = residual.linear_residual, residual.model.error_deviation
    mean_squares, oversampling = residual_mean_squares_by_second(record, linear_residual), record.oversampling
    second_count, band_count = mean_squares.shape[:2]
    expected_variance = band_means(record, error_deviation**2, band_count)
    contact_misfits = [
        _contact_mean_squares(observation, contact_fit, second_count)
        for contact_fit, observation in zip(residual.contacts, nominal_variances.observations, strict=True)
    ]
    contact_mean_squares = np.array(contact_misfits).reshape(len(contact_misfits), 3, second_count)
    drift_cost = sum(
        float(np.sum(contact_fit.residual[contact_fit.observation.force_weights.size : -contact_fit.pulls.size] ** 2))
        for contact_fit in residual.contacts
    )
    sensor_residual, input_residual = linear_residual[: len(record.sensors)], linear_residual[len(record.sensors) :]
    time_count, line_count = linear_residual.shape[1], error_deviation.shape[1]
    input_cost = float(np.sum(input_residual**2)) + residual.model.prior_input_log_determinant * time_count / line_count
    line_cost = 0.0  # a free decay has lines as sharp as tones
    if record.has_force:
        free_direction_count = len(record.sensors) - len(residual.contacts)
        line_cost = outstanding_line_cost(sensor_residual, free_direction_count, record.repeats_per_sample)
    return Misfit(
        nominal_variances=nominal_variances,
        variance_by_second=mean_squares * expected_variance,
        variance_correction=power_weighted_band_variances(record, linear_residual, error_deviation, band_count)
        / expected_variance,
        contact_mean_square_by_second=contact_mean_squares[:, 0].T,
        contact_beyond_noise_n2=contact_mean_squares[:, 1].T,
        contact_force_n2=contact_mean_squares[:, 2].T,
        pulls=residual.pulls,
        drift_cost=drift_cost / oversampling,
        input_cost=input_cost / oversampling,
        line_cost=line_cost,
        independent_sample_count=time_count / oversampling,
    )


def _contact_mean_squares(
    observation: ContactObservation, contact_fit: ContactResidual, second_count: int
) -> list[list[float]]:
    """Level of a contact's residual, its mean square beyond noise (N^2) and that of the force (N^2), by second."""
    weights, nominal_weights = contact_fit.observation.force_weights, observation.force_weights
    is_moving = weights > 0
    residual_n = np.divide(contact_fit.residual[: weights.size], weights, out=np.zeros(weights.size), where=is_moving)
    deviation_n = np.divide(1.0, nominal_weights, out=np.zeros(weights.size), where=is_moving)
    force_n = contact_fit.signals.force_n
    squares = ((residual_n * nominal_weights) ** 2, residual_n**2 - deviation_n**2, force_n**2)
    return [[float(np.mean(segment)) for segment in np.array_split(square, second_count)] for square in squares]
