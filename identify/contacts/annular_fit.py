"""Joint fit of an annular contact over both directions: radial clearance, stiffness, damping, friction, sliding speed,
force at rest, and the slow motion and the nuisance parameters of both.

The residual of each direction is that of `joint_fit`, with the component of one vector law of both relative
displacements. A common factor on the sliding speed has a prior of one in its logarithm, as without friction it means
nothing. Accelerometers show neither the force at rest, which follows from the open contact, whose force is zero, nor
the centre: where the contact is closed at rest, as under gravity, that force tells the rest position against it.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d
from scipy.sparse import csr_matrix, diags, vstack

from identify.contacts.annular_law import (
    CENTER,
    CLEARANCE,
    DAMPING,
    FRICTION,
    LOG_SPEED,
    ONSET,
    REST,
    RING,
    STIFFNESS,
    RingDerivatives,
    RingValues,
    ring_derivatives,
    ring_force_n,
)
from identify.contacts.annular_record import DIRECTIONS, AnnularRecord, annular_guess, interleaved
from identify.contacts.law_fit import COST_TOLERANCE, MOST_STEPS, SETTLED_COST_FALL, WEIGHT_ROUNDS
from identify.contacts.linearization import (
    BorderedEquations,
    Jacobian,
    corrected_motion,
    ground_n_per_m,
    normal_equations,
)
from identify.signals.gauss_newton import Step, gauss_newton
from identify.signals.law_evaluation import evaluated_law, law_step_s
from identify.signals.refit import refit_until_settled
from identify.signals.spectra import at_force_rate

ROUGH_RESIDUAL_SHARE = 0.02
"""Standard deviation of the residual over that of the force, before any is known."""
FRICTION_SCALE = 0.1
LAW_PULLS = [LOG_SPEED, ONSET]
"""Parameters of the law that have a prior; their pulls are the last ones."""
LAW_PULL_COUNT = len(LAW_PULLS)
OPEN_MARGIN_SAMPLES = 3
"""Samples before and after an open one that are open too."""


@dataclass(frozen=True)
class AnnularState:
    """Parameters of a fit with residual and cost there, those of y before those of z.

    The last of the pulls are the logarithm of the sliding speed over its start and the onset of the damping; knots of y
    and z take turns.
    """

    values: RingValues
    knots: Float[np.ndarray, " knots"]
    pulls: Float[np.ndarray, " nuisances"]
    residual_n: Float[np.ndarray, " twice"]
    cost: float = np.inf


@dataclass(frozen=True)
class AnnularFit:
    """Fit of a record: its state and weights. free_indices are those of the fitted parameters beside the pulls."""

    record: AnnularRecord
    free_indices: tuple[int, ...]
    start_log_speed: float
    state: AnnularState
    weights: Float[np.ndarray, " twice"]

    def values_with_speed_and_onset(self, values: RingValues, pulls: Float[np.ndarray, " nuisances"]) -> RingValues:
        """Values with the sliding speed and the onset of the last pulls."""
        changed_values = values.copy()
        changed_values[LAW_PULLS] = np.array([self.start_log_speed, 0.0]) + pulls[-LAW_PULL_COUNT:]
        return changed_values

    def state_at(
        self, values: RingValues, knots: Float[np.ndarray, " knots"], pulls: Float[np.ndarray, " nuisances"]
    ) -> AnnularState:
        """State at some parameters, with its cost for the weights."""
        record, values = self.record, self.values_with_speed_and_onset(values, pulls)
        motion = np.concatenate(self.motion(knots, pulls))
        law = partial(ring_force_n, values, step_s=law_step_s(record.sample_rate_hz))
        law_force_n = evaluated_law(law, motion, record.sample_rate_hz, record.decimation)
        law_force_n = law_force_n[:, : record.force_n.shape[1]]
        plane_residuals = []
        for k, plane in enumerate(record.planes):
            plane_pulls = pulls[record.pull_indices[k]]
            unexplained_n = plane.force_n + values[REST][k] - plane_pulls @ plane.nuisance_n - law_force_n[k]
            ground_force_n = ground_n_per_m(plane) @ knots[k::DIRECTIONS]
            plane_residuals.append(unexplained_n / (1 - plane_pulls @ plane.force_noise_multiple) - ground_force_n)
        state = AnnularState(values, knots, pulls, np.concatenate(plane_residuals))
        prior_residual = record.drift_spline.curvature @ knots - record.drift_spline.curvature_target
        cost = np.sum((self.weights * state.residual_n) ** 2) + np.sum(prior_residual**2)
        return replace(state, cost=float(cost + record.samples_per_error * np.sum(pulls**2)))

    def motion(
        self, knots: Float[np.ndarray, " knots"], pulls: Float[np.ndarray, " nuisances"]
    ) -> tuple[Float[np.ndarray, "2 samples"], Float[np.ndarray, "2 samples"]]:
        """Relative displacements with slow motion and nuisance signals, m, and their rates, m/s."""
        pull_indices = self.record.pull_indices
        plane_motions = [
            corrected_motion(plane, knots[k::DIRECTIONS], pulls[pull_indices[k]])
            for k, plane in enumerate(self.record.planes)
        ]
        eta, rate = zip(*plane_motions, strict=True)
        return np.stack(eta), np.stack(rate)

    @property
    def free_to_law(self) -> Float[np.ndarray, "10 free"]:
        """Matrix from the free parameters, scaled to condition the normal equations, to all."""
        value_sizes, force_n = np.abs(self.state.values), float(np.std(self.record.force_n))
        clearance, stiffness = value_sizes[[CLEARANCE, STIFFNESS]].tolist()
        law_sizes = [clearance, stiffness, 1e-3 * stiffness, FRICTION_SCALE, 1.0, 1.0]
        return np.diag([*law_sizes, clearance, clearance, force_n, force_n])[:, list(self.free_indices)]

    @property
    def law_derivatives(self) -> RingDerivatives:
        """Derivatives of the law along the motion."""
        motion = self.motion(self.state.knots, self.state.pulls)
        return ring_derivatives(self.state.values, *motion, 1 / self.record.sample_rate_hz)

    def jacobian(self) -> Jacobian:
        """Jacobian of the fitted force by knots, pulls and law, rows of y before those of z."""
        record, slopes = self.record, self.law_derivatives
        by_eta, by_rate = _low_passed(record, slopes.by_eta), _low_passed(record, slopes.by_rate)
        by_law = np.zeros((DIRECTIONS, record.force_n.shape[1], len(RING)))
        by_law[:, :, : len(slopes.by_law)] = np.moveaxis(_low_passed(record, slopes.by_law), 0, -1)
        by_law[:, :, REST] = -np.eye(DIRECTIONS)[:, None]
        by_knots, by_pulls = [], self._jacobian_by_pulls(slopes, by_eta)
        for k, plane in enumerate(record.planes):
            force_gain = self._force_noise_gain(k)
            by_law[k] /= force_gain
            knot_blocks = []
            for i, moved_plane in enumerate(record.planes):
                spline = moved_plane.drift_spline
                knot_values, knot_rates = plane.at_force_samples(spline.value), plane.at_force_samples(spline.rate)
                knot_block = diags(by_eta[k, i]) @ knot_values + diags(by_rate[k, i]) @ knot_rates
                knot_block = self._eta_noise_gain(i) / force_gain * knot_block
                knot_blocks.append(interleaved(knot_block + ground_n_per_m(plane) if k == i else knot_block, i))
            by_knots.append(knot_blocks[0] + knot_blocks[1])
        by_pulls[:, -LAW_PULL_COUNT:] = np.concatenate(by_law[:, :, LAW_PULLS])
        return Jacobian(csr_matrix(vstack(by_knots)), by_pulls, np.concatenate(by_law))

    def _force_noise_gain(self, direction: int) -> float:
        plane = self.record.planes[direction]
        return float(1 - self.state.pulls[self.record.pull_indices[direction]] @ plane.force_noise_multiple)

    def _eta_noise_gain(self, direction: int) -> float:
        plane, pulls = self.record.planes[direction], self.state.pulls[self.record.pull_indices[direction]]
        return float(1 - pulls[plane.shifts_eta] @ plane.eta_noise_multiple)

    def _jacobian_by_pulls(
        self, slopes: RingDerivatives, by_eta: Float[np.ndarray, "2 2 fewer"]
    ) -> Float[np.ndarray, "twice nuisances"]:
        """Derivatives by the nuisance parameters: forces of its direction, and through its displacement both."""
        record, state = self.record, self.state
        by_pulls = np.zeros((state.pulls.size, DIRECTIONS, record.force_n.shape[1]), np.float32)
        for k, plane in enumerate(record.planes):
            indices, knots = record.pull_indices[k], state.knots[k::DIRECTIONS]
            force_residual_n = state.residual_n.reshape(DIRECTIONS, -1)[k] + ground_n_per_m(plane) @ knots
            for index, signal_n, multiple in zip(indices, plane.nuisance_n, plane.force_noise_multiple, strict=True):
                by_pulls[index, k] += signal_n - multiple * force_residual_n
            drift_m = record.at_force_samples((plane.drift_spline.value @ knots)[None])[0]
            for index, signal_m, multiple in zip(
                indices[plane.shifts_eta], plane.nuisance_m, plane.eta_noise_multiple, strict=True
            ):
                force_change_n = slopes.by_eta[:, k] * signal_m + slopes.by_rate[:, k] * plane.velocity_of(signal_m)
                by_pulls[index] -= _low_passed(record, force_change_n) + multiple * by_eta[:, k] * drift_m
        for k in range(DIRECTIONS):
            by_pulls[:, k] /= np.float32(self._force_noise_gain(k))
        return by_pulls.reshape(state.pulls.size, -1).T

    def linearized(self) -> tuple[Jacobian, BorderedEquations]:
        """Jacobian and normal equations at the state."""
        jacobian, to_law = self.jacobian(), self.free_to_law
        equations = normal_equations(self.record, self.state, jacobian, to_law, self.weights)
        return jacobian, equations

    @property
    def minimum_cost_fit(self) -> "AnnularFit":
        """Fit at the state of least cost for these weights, by Gauss-Newton."""

        def step_from(current: AnnularState) -> Step[AnnularState]:
            fit = replace(self, state=current)
            _, equations = fit.linearized()
            knot_step, free_step = equations.solved(equations.knot_gradient, equations.free_gradient)
            cost_decrease = np.sum(equations.knot_gradient * knot_step) + np.sum(equations.free_gradient * free_step)
            free_to_law, pull_count = fit.free_to_law, current.pulls.size

            def state_after(step_share: float) -> AnnularState | None:
                ring_values = current.values + step_share * free_to_law @ free_step[pull_count:, 0]
                if not (ring_values[CLEARANCE] > 0 and ring_values[STIFFNESS] > 0):
                    return None
                pulls = current.pulls + step_share * free_step[:pull_count, 0]
                return self.state_at(ring_values, current.knots + step_share * knot_step[:, 0], pulls)

            return Step(state_after, float(cost_decrease))

        def negligible_decrease(current: AnnularState) -> float:
            return max(SETTLED_COST_FALL * self.record.samples_per_error, COST_TOLERANCE * current.cost)

        start_state = self.state_at(self.state.values, self.state.knots, self.state.pulls)
        state, _ = gauss_newton(start_state, step_from, negligible_decrease, MOST_STEPS)
        return replace(self, state=state)

    @property
    def is_open(self) -> Bool[np.ndarray, " fewer"]:
        """Mask of the samples around which the fitted contact is open."""
        state = self.state
        eta_m = self.motion(state.knots, state.pulls)[0] - state.values[CENTER][:, None]
        is_closed = np.hypot(*self.record.at_force_samples(eta_m)) > state.values[CLEARANCE]
        return np.asarray(maximum_filter1d(is_closed, 2 * OPEN_MARGIN_SAMPLES + 1) == 0) & self.record.is_fitted

    @property
    def reweighted(self) -> "AnnularFit":
        """Fit with weights from its residual: 1 / standard deviation by the force while open, the share of it that no
        law explains, and the displacement's noise times the stiffness."""
        state, record = self.state, self.record
        residual_n, is_open = state.residual_n.reshape(DIRECTIONS, -1), self.is_open
        force_size_n, force_by_eta = np.hypot(*record.force_n), _low_passed(record, self.law_derivatives.by_eta)
        weights = []
        for k, plane in enumerate(record.planes):
            unfollowed_m = np.hypot(
                plane.eta_noise_m, 0.0 if plane.drift is None else plane.drift.noise_above_knot_band_m
            )
            open_deviation_n = np.std(residual_n[k, is_open] if np.any(residual_n[k, is_open]) else residual_n[k])
            unmodelled_n = plane.unmodelled_share * np.hypot(force_size_n, np.std(record.force_n))
            stiffness_n_per_m = np.hypot(*force_by_eta[k])
            deviation_n = np.sqrt(open_deviation_n**2 + (stiffness_n_per_m * unfollowed_m) ** 2 + unmodelled_n**2)
            weights.append(record.is_fitted / deviation_n)
        return replace(self, weights=np.concatenate(weights))

    @property
    def settled(self) -> "AnnularFit":
        """Fit with weights renewed until they settle."""

        def weights_agree(before: "AnnularFit", after: "AnnularFit") -> bool:
            return np.allclose(after.weights, before.weights, rtol=0.1)

        return refit_until_settled(
            self.reweighted, lambda fit: fit.minimum_cost_fit.reweighted, weights_agree, max_rounds=WEIGHT_ROUNDS
        )


def annular_fit(record: AnnularRecord, sliding_speed_m_per_s: float) -> AnnularFit:
    """Settled fit of a record, from `annular_guess`: first without nuisance parameters, then with them.

    Raises ContactRefusedError as the guess does, or if the normal equations are singular.
    """
    without_nuisances = record.without_nuisances
    ring_values, knots = annular_guess(without_nuisances, sliding_speed_m_per_s)
    center_indices = tuple(range(len(RING))[CENTER]) if record.zero_known else ()
    free_indices = (CLEARANCE, STIFFNESS, DAMPING, FRICTION, *center_indices, *range(len(RING))[REST])
    weights = np.tile(record.is_fitted / (ROUGH_RESIDUAL_SHARE * float(np.std(record.force_n))), DIRECTIONS)
    start_state = AnnularState(ring_values, knots, np.zeros(LAW_PULL_COUNT), np.zeros(record.force_n.size))
    rough_fit = AnnularFit(
        without_nuisances, free_indices, ring_values[LOG_SPEED], start_state, weights
    ).minimum_cost_fit
    pulls = np.r_[record.initial_state_pulls, rough_fit.state.pulls]
    return replace(rough_fit, record=record, state=replace(rough_fit.state, pulls=pulls)).settled


def _low_passed(record: AnnularRecord, signals: Float[np.ndarray, "*rows samples"]) -> Float[np.ndarray, "*rows fewer"]:
    """Signals low-passed and decimated like the separated forces."""
    return at_force_rate(signals, record.decimation)[..., : record.force_n.shape[1]]
