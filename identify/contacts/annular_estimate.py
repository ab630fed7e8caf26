"""Estimate of an annular contact: values with their covariances, and what motion there was in the ring."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from identify.contacts.annular_fit import LAW_PULL_COUNT, LAW_PULLS, AnnularFit, annular_fit
from identify.contacts.annular_law import CENTER, CLEARANCE, REST, RING, STIFFNESS, RingValues, ring_motion
from identify.contacts.annular_record import DIRECTIONS, AnnularRecord, closed_samples
from identify.contacts.joint_fit import (
    check_drift_curvature,
    check_wander,
    small_sample_factor,
    split_half_z,
    unexplained_share,
)
from identify.contacts.law_fit import LEAST_HALF_SAMPLES, halves_difference_and_t2_excess
from identify.contacts.linearization import Jacobian
from identify.signals.scores import cluster_scores, equal_information_starts

CENTER_ERROR_SHARE = 0.05
"""Largest standard error of the centre over the clearance for which the centre is known."""
CENTER_AND_REST = slice(CENTER.start, REST.stop)
NEWTON_STEPS = 20
"""Steps of Newton's method for the force at rest. Effort."""
LEAST_REST_ERRORS = 5.0
"""Least force at rest over its standard error, for which the contact certainly rests in its ring."""

RingCovariance = Float[np.ndarray, "10 10"]


@dataclass(frozen=True)
class AnnularEstimate:
    """Estimate of an annular contact: values of the parameters `RING`, and covariances by the sources of a
    `JointEstimate`.

    center_known: the record determines the centre against the relative displacement at rest (by accelerometers), or
    against the sensors' zero (zero_known). eta_m and rate_m_per_s are with the slow motion, less the centre; force_n is
    the separated force with the force at rest, at every `decimation`-th sample. pulls are those of `parameters` of the
    record. widening_factor is that of a `JointEstimate`.
    """

    values: RingValues
    covariances: Mapping[str, RingCovariance]
    sides_known: bool
    center_known: bool
    pulls: Float[np.ndarray, " nuisances"]
    eta_m: Float[np.ndarray, "2 samples"]
    rate_m_per_s: Float[np.ndarray, "2 samples"]
    force_n: Float[np.ndarray, "2 fewer"]
    unexplained_share: float
    split_half_z: tuple[float, float]
    widening_factor: float = 1.0

    @property
    def covariance(self) -> RingCovariance:
        """Covariance of the parameters by all sources."""
        return np.asarray(sum(self.covariances.values()))

    @property
    def errors(self) -> RingValues:
        """Standard error of every parameter."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def own_errors(self) -> RingValues:
        """Standard errors by the record's own scatter and slow motion, which differ in other records."""
        return np.asarray(np.sqrt(np.diag(self.covariances["scatter"] + self.covariances["drift"])))


def estimate_annular(record: AnnularRecord, sliding_speed_m_per_s: float) -> AnnularEstimate:
    """Estimate of an annular contact by `annular_fit`, from a sliding speed of rig.json.

    The covariance is that of `joint_fit.fit_joint`: a sandwich over sixteenths of the record, both directions of one
    together, plus the effect of a unit error in each row of the priors, plus what deep and shallow, and growing and
    falling depths ask otherwise (`law_fit.misfit_covariance`). By accelerometers the centre against the rest position
    is -(d + |f_0| / k) f_0 / |f_0| with the wall's force f_0 at rest.

    Raises ContactRefusedError as the fit does, or if the slow motion is larger than the accelerometers' noise allows or
    is not bridged from closure to closure.
    """
    fit = annular_fit(record, sliding_speed_m_per_s)
    state, drift_spline = fit.state, fit.record.drift_spline
    _check_slow_motion(fit)
    jacobian, normal_equations = fit.linearized()
    pull_count, free_to_law = state.pulls.size, fit.free_to_law
    eta_m, rate_m_per_s = fit.motion(state.knots, state.pulls)
    ring_by_knots = np.zeros((drift_spline.knot_count, len(RING)))
    ring_by_free = np.zeros((pull_count + free_to_law.shape[1], len(RING)))
    ring_by_free[pull_count:] = free_to_law.T
    ring_by_free[pull_count - LAW_PULL_COUNT : pull_count, LAW_PULLS] = np.eye(LAW_PULL_COUNT)
    ring_values, is_center_by_rest = state.values.copy(), not record.zero_known and record.quiet_sample_count > 0
    if is_center_by_rest:
        springs_n_per_m = np.array([plane.spring_n_per_m for plane in record.planes])
        ring_values[CENTER_AND_REST], rest_by_ring = _center_and_rest_force(ring_values, springs_n_per_m)
        ring_by_free[pull_count:, CENTER_AND_REST] = (rest_by_ring @ free_to_law).T
    knot_columns, pull_free_columns = normal_equations.solved(ring_by_knots, ring_by_free)
    pull_law_columns = np.concatenate([pull_free_columns[:pull_count], free_to_law @ pull_free_columns[pull_count:]])
    influence = jacobian.times_columns(knot_columns, pull_law_columns) * fit.weights[:, None] ** 2
    influences, residuals_n = influence.reshape(DIRECTIONS, -1, len(RING)), state.residual_n.reshape(DIRECTIONS, -1)
    part_starts = equal_information_starts(np.hypot(*influences[:, :, STIFFNESS]))
    influences_and_residuals = zip(influences, residuals_n, strict=True)
    scores = np.sum([cluster_scores(*plane, part_starts) for plane in influences_and_residuals], axis=0)
    error_rows_by_source = {
        "scatter": small_sample_factor(free_to_law.shape[1]) * scores,
        "tolerances": record.samples_per_error * pull_free_columns[: pull_count - 1],
        "law": record.samples_per_error * pull_free_columns[pull_count - 1 : pull_count],
        "drift": drift_spline.curvature @ knot_columns,
    }
    covariances = {source: rows.T @ rows for source, rows in error_rows_by_source.items()}
    covariances["law"] += _misfit_covariance(fit, jacobian, part_starts)
    covariance = np.asarray(sum(covariances.values()))
    center_error_m = np.sqrt(np.diag(covariance)[CENTER].max())
    rest_error_n = float(np.sqrt(np.diag(covariance)[REST].max()))
    is_closed_at_rest = is_center_by_rest and float(np.hypot(*ring_values[REST])) > LEAST_REST_ERRORS * rest_error_n
    is_center_certain = center_error_m < CENTER_ERROR_SHARE * ring_values[CLEARANCE]
    residual_force_noise_n = [
        (residual_n[record.is_fitted], plane.force_n[record.is_fitted], plane.noise_n)
        for residual_n, plane in zip(residuals_n, record.planes, strict=True)
    ]
    return AnnularEstimate(
        values=ring_values,
        covariances=covariances,
        sides_known=record.zero_known or record.planes[0].spring_n_per_m > 0,
        center_known=bool((is_closed_at_rest or record.zero_known) and is_center_certain),
        pulls=state.pulls[:-LAW_PULL_COUNT],
        eta_m=eta_m - state.values[CENTER][:, None],
        rate_m_per_s=rate_m_per_s,
        force_n=record.force_n + state.values[REST][:, None],
        unexplained_share=unexplained_share(residual_force_noise_n),
        split_half_z=split_half_z(scores[:, [CLEARANCE, STIFFNESS]]),
    )


def _center_and_rest_force(
    values: RingValues, springs_n_per_m: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4 10"]]:
    """Centre against the position at rest, m, and the wall's force at rest, N, in both directions, with their
    derivatives by the values.

    At rest the wall's force f_0 along the unit vector r holds the body at d + |f_0| / k from the centre, where springs
    to the ground take their part of the fitted constant force: f_0 + K (d + |f_0| / k) r = f. Solved by Newton's method
    from f_0 = f. Where the springs alone hold the body within its clearance, f_0 is zero.
    """
    clearance_m, stiffness_n_per_m, spring_matrix = values[CLEARANCE], values[STIFFNESS], np.diag(springs_n_per_m)
    if springs_n_per_m.all() and np.hypot(*(values[REST] / springs_n_per_m)) < clearance_m:
        by_values = np.zeros((2 * DIRECTIONS, len(RING)))
        by_values[:DIRECTIONS, REST] = -np.diag(1 / springs_n_per_m)
        return by_values @ values, by_values
    wall_force_n, identity = np.where(values[REST].any(), values[REST], 1e-12), np.eye(DIRECTIONS)
    for _ in range(NEWTON_STEPS):
        force_size_n = float(np.hypot(*wall_force_n))
        radial_projection = np.outer(wall_force_n, wall_force_n) / force_size_n**2
        m_per_n = clearance_m / force_size_n + 1 / stiffness_n_per_m
        position_m = m_per_n * wall_force_n
        position_by_wall = radial_projection / stiffness_n_per_m + m_per_n * (identity - radial_projection)
        wall_by_fitted = np.linalg.inv(identity + spring_matrix @ position_by_wall)
        wall_force_n = wall_force_n - wall_by_fitted @ (wall_force_n + spring_matrix @ position_m - values[REST])
    position_by_values = np.zeros((DIRECTIONS, len(RING)))
    position_by_values[:, CLEARANCE] = wall_force_n / force_size_n
    position_by_values[:, STIFFNESS] = -wall_force_n / stiffness_n_per_m**2
    wall_by_values = -wall_by_fitted @ spring_matrix @ position_by_values
    wall_by_values[:, REST] = wall_by_fitted
    position_by_values += position_by_wall @ wall_by_values
    return np.concatenate([-position_m, wall_force_n]), np.concatenate([-position_by_values, wall_by_values])


def _misfit_covariance(fit: AnnularFit, jacobian: Jacobian, part_starts: Int[np.ndarray, " parts"]) -> RingCovariance:
    """Covariance of the parameters from the misfit of the law, as `law_fit.misfit_covariance`; the force at rest, which
    the open contact tells, is held."""
    record, state = fit.record, fit.state
    free_indices = [parameter for parameter in fit.free_indices if parameter < REST.start]
    force_by_law = jacobian.by_law.reshape(DIRECTIONS, -1, len(RING))[:, :, free_indices]
    residual_n = state.residual_n.reshape(DIRECTIONS, -1)
    squared_weights = fit.weights.reshape(DIRECTIONS, -1) ** 2
    eta_m, rate_m_per_s = fit.motion(state.knots, state.pulls)
    polar_motion = ring_motion(state.values, record.at_force_samples(eta_m), record.at_force_samples(rate_m_per_s))
    is_closed, is_growing = record.is_fitted & (polar_motion.depth_m > 0), polar_motion.radial_rate_m_per_s > 0
    is_deep = polar_motion.depth_m > np.median(polar_motion.depth_m[is_closed])
    largest_slopes, covariance = np.max(np.abs(force_by_law), axis=(0, 1)), np.zeros((len(RING), len(RING)))

    def half_scores(is_in_half: Bool[np.ndarray, " fewer"]) -> Float[np.ndarray, "parts free"]:
        weighted_slopes = np.where(is_in_half, squared_weights, 0.0)[:, :, None] * force_by_law / largest_slopes
        normal_matrix = np.einsum("pij,pik->jk", weighted_slopes, force_by_law / largest_slopes)
        influence = weighted_slopes @ np.linalg.pinv(normal_matrix, hermitian=True)
        return np.sum([cluster_scores(*rows, part_starts) for rows in zip(influence, residual_n, strict=True)], axis=0)

    for is_first in (is_deep, is_growing):
        in_first, in_second = is_closed & is_first, is_closed & ~is_first
        if min(in_first.sum(), in_second.sum()) < LEAST_HALF_SAMPLES:
            continue
        law_difference, excess_share = halves_difference_and_t2_excess(half_scores(in_first) - half_scores(in_second))
        law_error = np.zeros(len(RING))
        law_error[free_indices] = law_difference / largest_slopes / 2
        covariance += excess_share * np.outer(law_error, law_error)
    return covariance


def _check_slow_motion(fit: AnnularFit) -> None:
    """Raises ContactRefusedError as `estimate_annular` says."""
    record = fit.record
    check_drift_curvature(record.drift_spline, fit.state.knots)
    free_drifts = [plane.drift for plane in record.planes if plane.drift is not None and not plane.spring_n_per_m]
    if free_drifts:
        force_n = record.force_n + fit.state.values[-DIRECTIONS:, None]
        is_closed, noise_density = closed_samples(record, force_n), max(drift.noise_density for drift in free_drifts)
        depth_m = float(np.median(np.hypot(*force_n[:, is_closed]))) / fit.state.values[STIFFNESS]
        check_wander(is_closed, record.decimation / record.sample_rate_hz, noise_density, depth_m)
