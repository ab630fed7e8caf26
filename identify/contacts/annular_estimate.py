"""Estimate of an annular contact: values with their covariances, and what motion there was in the ring."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from identify.contacts.annular_fit import AnnularFit, annular_fit
from identify.contacts.annular_law import (
    CENTER,
    CLEARANCE,
    LOG_SPEED,
    REST,
    RING,
    STIFFNESS,
    RingValues,
    ring_motion,
)
from identify.contacts.annular_record import DIRECTIONS, AnnularRecord, closed_samples
from identify.contacts.joint_fit import (
    check_bridged,
    check_drift,
    half_differences,
    small_sample_factor,
    unexplained_share,
)
from identify.contacts.law_fit import LEAST_HALF_SAMPLES, misfit_excess
from identify.contacts.linearization import Jacobian
from identify.signals.scores import informative_parts, part_scores

CENTER_SHARE = 0.05
"""Largest standard error of the centre over the clearance for which the centre is known."""
REST_ERRORS = 5.0
"""Least force at rest over its standard error, for which the contact certainly rests in its ring."""

RingCovariance = Float[np.ndarray, "9 9"]


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
    half_differences: tuple[float, float]
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
    falling depths ask otherwise (`law_fit.misfit_covariance`). By accelerometers the centre
    against the rest position is -(d + |f_0| / k) f_0 / |f_0| with the force f_0 at rest, which the wall bears alone.

    Raises ContactRefusedError as the fit does, or if the slow motion is larger than the accelerometers' noise allows or
    is not bridged from closure to closure.
    """
    fit = annular_fit(record, sliding_speed_m_per_s)
    state, curve = fit.state, fit.record.drift_spline
    _check_slow_motion(fit)
    derivatives, equations = fit.linearized()
    pull_count, to_law = state.pulls.size, fit.to_law
    eta, rate = fit.motion(state.knots, state.pulls)
    ring_by_knots = np.zeros((curve.knots, len(RING)))
    ring_by_dense = np.zeros((pull_count + to_law.shape[1], len(RING)))
    ring_by_dense[pull_count:] = to_law.T
    ring_by_dense[pull_count - 1, LOG_SPEED] = 1.0
    values, by_rest = state.values.copy(), not record.zero_known and record.quiet_samples > 0
    values[LOG_SPEED] = fit.log_speed + state.pulls[-1]
    if by_rest:
        values[CENTER], by_values = _center_by_rest(values)
        ring_by_dense[pull_count:, CENTER] = (by_values @ to_law).T
    knots_per_gradient, dense_per_gradient = equations.solved(ring_by_knots, ring_by_dense)
    pulls_and_laws_per_gradient = np.concatenate(
        [dense_per_gradient[:pull_count], to_law @ dense_per_gradient[pull_count:]]
    )
    influence = derivatives.columns(knots_per_gradient, pulls_and_laws_per_gradient) * fit.weights[:, None] ** 2
    planes, residuals = influence.reshape(DIRECTIONS, -1, len(RING)), state.residual_n.reshape(DIRECTIONS, -1)
    starts = informative_parts(np.hypot(*planes[:, :, STIFFNESS]))
    by_parts = np.sum([part_scores(*rows, starts) for rows in zip(planes, residuals, strict=True)], axis=0)
    rows = (
        small_sample_factor(to_law.shape[1]) * by_parts,
        record.samples_per_error * dense_per_gradient[:pull_count],
        curve.curvature @ knots_per_gradient,
    )
    covariances = {source: x.T @ x for source, x in zip(("scatter", "tolerances", "drift"), rows, strict=True)}
    covariances["law"] = _misfit_covariance(fit, derivatives, starts)
    covariance = np.asarray(sum(covariances.values()))
    center_error_m = np.sqrt(np.diag(covariance)[CENTER].max())
    rest_error_n = float(np.sqrt(np.diag(covariance)[REST].max()))
    closed_at_rest = by_rest and float(np.hypot(*values[REST])) > REST_ERRORS * rest_error_n
    return AnnularEstimate(
        values=values,
        covariances=covariances,
        sides_known=record.zero_known or record.planes[0].spring_n_per_m > 0,
        center_known=bool((closed_at_rest or record.zero_known) and center_error_m < CENTER_SHARE * values[CLEARANCE]),
        pulls=state.pulls[:-1],
        eta_m=eta - state.values[CENTER][:, None],
        rate_m_per_s=rate,
        force_n=record.force_n + values[-DIRECTIONS:, None],
        unexplained_share=unexplained_share(
            [
                (residual[record.used], plane.force_n[record.used], plane.noise_n)
                for residual, plane in zip(residuals, record.planes, strict=True)
            ]
        ),
        half_differences=half_differences(by_parts[:, [CLEARANCE, STIFFNESS]]),
    )


def _center_by_rest(values: RingValues) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 9"]]:
    """Centre against the position at rest, m, and its derivatives by the values."""
    rest_force_n = values[REST]
    force_n, stiffness = max(float(np.hypot(*rest_force_n)), 1e-12), values[STIFFNESS]
    rest_direction = rest_force_n / force_n
    radius_m = values[CLEARANCE] + force_n / stiffness
    by_values = np.zeros((DIRECTIONS, len(RING)))
    by_values[:, CLEARANCE] = -rest_direction
    by_values[:, STIFFNESS] = rest_direction * force_n / stiffness**2
    tangent_projection = np.eye(DIRECTIONS) - np.outer(rest_direction, rest_direction)
    by_values[:, REST] = -(
        np.outer(rest_direction, rest_direction) / stiffness + radius_m / force_n * tangent_projection
    )
    return -radius_m * rest_direction, by_values


def _misfit_covariance(fit: AnnularFit, derivatives: Jacobian, starts: Int[np.ndarray, " parts"]) -> RingCovariance:
    """Covariance of the parameters from the misfit of the law, as `law_fit.misfit_covariance`; the force at rest, which
    the open contact tells, is held."""
    record, state = fit.record, fit.state
    free = [k for k in fit.free if k < REST.start]
    by_law = derivatives.by_law.reshape(DIRECTIONS, -1, len(RING))[:, :, free]
    residual = state.residual_n.reshape(DIRECTIONS, -1)
    squares = fit.weights.reshape(DIRECTIONS, -1) ** 2
    eta, rate = fit.motion(state.knots, state.pulls)
    motion = ring_motion(state.values, record.at_forces(eta), record.at_forces(rate))
    closed, grows = record.used & (motion.depth_m > 0), motion.radial_rate_m_per_s > 0
    deep = motion.depth_m > np.median(motion.depth_m[closed])
    scale = np.max(np.abs(by_law), axis=(0, 1))
    covariance = np.zeros((len(RING), len(RING)))

    def scores(samples: Bool[np.ndarray, " fewer"]) -> Float[np.ndarray, "parts free"]:
        weighted = np.where(samples, squares, 0.0)[:, :, None] * by_law / scale
        normal = np.einsum("pij,pik->jk", weighted, by_law / scale)
        influence = weighted @ np.linalg.pinv(normal, hermitian=True)
        return np.sum([part_scores(*rows, starts) for rows in zip(influence, residual, strict=True)], axis=0)

    for halves in ((closed & deep, closed & ~deep), (closed & grows, closed & ~grows)):
        if min(half.sum() for half in halves) < LEAST_HALF_SAMPLES:
            continue
        parameter_difference, excess = misfit_excess(scores(halves[0]) - scores(halves[1]))
        error = np.zeros(len(RING))
        error[free] = parameter_difference / scale / 2
        covariance += excess * np.outer(error, error)
    return covariance


def _check_slow_motion(fit: AnnularFit) -> None:
    """Raises ContactRefusedError as `estimate_annular` says."""
    record = fit.record
    check_drift(record.drift_spline, fit.state.knots)
    drifts = [plane.drift for plane in record.planes if plane.drift is not None and not plane.spring_n_per_m]
    if drifts:
        force = record.force_n + fit.state.values[-DIRECTIONS:, None]
        closed, density = closed_samples(record, force), max(drift.noise_density for drift in drifts)
        depth_m = float(np.median(np.hypot(*force[:, closed]))) / fit.state.values[STIFFNESS]
        check_bridged(closed, record.decimation / record.sample_rate_hz, density, depth_m)
