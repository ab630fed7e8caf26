"""Contact residual: separated contact force less the rig's law at the relative displacement, in standard deviations.

    r = W (f - law(eta + b, eta' + b') - k b - z)

W are the weights of the observation, b the slow motion that integration loses, k the stiffness of the bodies against
it, z a slow error of the force beside that (`signals.drift`). A law is evaluated without aliasing and low-passed to the
band of the force.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace as changed
from scipy.sparse import block_diag, csc_matrix, csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import SuperLU, splu

from identify.contacts.contact_record import CLOSED_FORCE_SHARE, ContactRecord
from identify.contacts.initial_guess import drift_knots_by_open_contact, regressed_guess
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.observation import ContactObservation, ContactSignals, ForceAndEta, LawValues, Signal
from identify.linear.joined import GroupLaw
from identify.signals.law_evaluation import LawTangent
from identify.signals.spectra import decimated
from rig.errors import RigError
from rig.model.contact_laws import ContactLaw

PULL_EXCESS_WEIGHT = 100.0
"""Extra weight of a contact tolerance's excess beyond `PULL_LIMIT` standard deviations: something else is wrong. Set by
hand: a soft bound."""
LEAST_CLEARANCE_FACTOR = 1e-9
"""Least factor on a clearance, in place of zero: a stop that is not there stays infinitely far away. Set by hand."""
DEPTH_REACH, DEPTH_COUNT = 3.0, 2000
"""Grid of penetrations on which a law is inverted: its end, in penetrations of a linear stop, and its size."""

PullSides = Float[np.ndarray, " pulls"]
"""Sides of a contact's pulls: 0 within `PULL_LIMIT`, -1 or 1 beyond it."""


def initial_unknowns(
    contact_signals: ContactSignals, observation: ContactObservation, law: GroupLaw, force_rate_hz: float
) -> Float[np.ndarray, " unknowns"]:
    """Initial unknowns of a contact: zero tolerances, and the drift by the open contact where a spring holds the
    bodies, else regressed on clearly closed samples, or zero.

    Clearance and stiffness are regressed together with the drift; the law provides its other terms.
    """
    drift_spline, first_law, (lower_m, upper_m) = observation.drift_spline, law.laws[0], law.clearances_m
    unknowns = np.zeros(observation.unknown_count(law))
    eta_m, velocity_m_per_s, time_s = (
        signal[:: contact_signals.decimation]
        for signal in (contact_signals.eta_m, contact_signals.eta_rate_m_per_s, contact_signals.time_s)
    )
    # less what acts in the open contact too
    elastic_force_n = contact_signals.force_n - law.force_n(np.zeros_like(eta_m), velocity_m_per_s)
    slow_n_per_m = contact_signals.slow_stiffness_n_per_m
    if drift_spline.knot_count and slow_n_per_m:
        ground_matrix, is_open = slow_n_per_m * drift_spline.value + drift_spline.force_n, observation.closed_mask == 0
        knots = drift_knots_by_open_contact(elastic_force_n, is_open, ground_matrix, drift_spline)
        unknowns[: drift_spline.knot_count] = knots
        return unknowns
    off_centre_m = (upper_m - lower_m) / 2 if np.isfinite(upper_m - lower_m) else 0.0
    clearance_middle_m = off_centre_m + np.sign(elastic_force_n) * first_law.wear_m_per_s * time_s
    penetration_m = _penetration_m(law, elastic_force_n)
    if len(law.laws) > 1:  # ringing of an open contact would penetrate a soft one deeply
        penetration_m *= np.abs(elastic_force_n) > CLOSED_FORCE_SHARE * np.quantile(np.abs(elastic_force_n), 0.995)
    contact_record = ContactRecord(
        eta_m=eta_m - clearance_middle_m,
        velocity_m_per_s=velocity_m_per_s,
        sample_rate_hz=force_rate_hz,
        force_n=first_law.stiffness_n_per_m * penetration_m,
        decimation=1,
        quiet_deviation_n=0.0,
        noise_n=0.0,
        unmodelled_share=0.0,
        drift=None,
        drift_spline=drift_spline,
        nuisance_n=np.zeros((0, elastic_force_n.size)),
        force_noise_multiple=np.zeros(0),
        shifts_eta=np.zeros(0, dtype=bool),
        eta_noise_multiple=np.zeros(0),
        nuisance_m=np.zeros((0, elastic_force_n.size)),
        is_initial_state=np.zeros(0, dtype=bool),
    )
    if drift_spline.knot_count:
        with suppress(RigError):
            unknowns[: drift_spline.knot_count] = regressed_guess(contact_record)[1]
    return unknowns


def _penetration_m(law: GroupLaw, force_n: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """Penetration at which the law's force at rest equals a force; zero for laws without stiffness."""
    slopes_n_per_m = [slope for slope, _ in (single_law.largest_slopes for single_law in law.laws) if slope]
    penetration_m = np.zeros_like(force_n)
    if slopes_n_per_m:
        deepest_m = DEPTH_REACH * np.max(np.abs(force_n)) / np.array(slopes_n_per_m)
        depth_grid_m = np.sort(np.linspace(0.0, deepest_m, DEPTH_COUNT).ravel())
        for sign, clearance_m in zip((-1, 1), law.clearances_m, strict=True):
            if not np.isfinite(clearance_m):
                continue
            force_grid_n = np.maximum.accumulate(sign * law.force_n(sign * (clearance_m + depth_grid_m)))
            penetration_m += sign * np.interp(np.maximum(sign * force_n, 0.0), force_grid_n, depth_grid_m)
    return penetration_m


@dataclass(frozen=True)
class ContactResidual:
    """Residual of a contact force against its law, with the drift and the law's tolerances as unknowns.

    unknowns are the drift's knots (m), then clearance, stiffness and damping in tolerances, for every contact between
    the same places. adjusted_law has the first two of these. residual is the force less the law at a motion, in
    standard deviations, followed by the residuals of the priors, those of the pulls' excess beyond `PULL_LIMIT` last.
    """

    observation: ContactObservation
    signals: ContactSignals
    law: GroupLaw
    adjusted_law: GroupLaw
    unknowns: Float[np.ndarray, " unknowns"]
    motion: ForceAndEta
    residual: Float[np.ndarray, " rows"]

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)

    @cached_property
    def _finer_slopes(self) -> Float[np.ndarray, "4 laws finer"]:
        """Derivatives of each law at the rate of `tangent`; see `slopes`."""
        laws, signs = self.adjusted_law.laws, self.adjusted_law.signs

        def slope_rows(eta: Signal, eta_rate: Signal, *time_s: Signal) -> LawValues:
            by_eta, by_stiffness, by_damping = [], [], []
            for law, sign in zip(laws, signs, strict=True):
                undamped_law, signed_rate_m_per_s = changed(law, damping_n_s_per_m=0.0), sign * eta_rate
                by_eta.append(law.by_eta_n_per_m(sign * eta, *time_s))
                stiffness_slope = force_increase_by_fields_n(
                    undamped_law, sign * eta, 0.0, *time_s, stiffness_n_per_m=1.0
                )
                by_stiffness.append(sign * stiffness_slope)
                damping_slope = force_increase_by_fields_n(
                    law, sign * eta, signed_rate_m_per_s, *time_s, damping_n_s_per_m=1.0
                )
                by_damping.append(sign * damping_slope)
            return np.stack([by_eta, np.stack(by_eta) * np.sign(eta), by_stiffness, by_damping])

        depends_on_time = _depends_on_time(self.adjusted_law)
        return self.signals.low_passed(slope_rows, self.motion, depends_on_time, self.signals.slope_rate_multiple)

    @cached_property
    def slopes(self) -> Float[np.ndarray, "4 laws times"]:
        """Derivatives of each law: by eta (N/m), by clearance, i.e. times the sign of eta (N/m), and the force at rest
        per stiffness (m), and per damping (m/s)."""
        return decimated(self._finer_slopes, self.signals.slope_rate_multiple)

    @cached_property
    def tangent(self) -> LawTangent:
        """Tangent stiffness of all laws together."""
        return LawTangent(self._finer_slopes[0].sum(axis=0), self.signals.slope_rate_multiple)

    @property
    def pulls(self) -> Float[np.ndarray, " pulls"]:
        """Pulls of clearance, stiffness and damping of each law, in tolerances."""
        return self.unknowns[self.observation.tolerance_slice]

    @property
    def unknowns_without_pulls(self) -> Float[np.ndarray, " unknowns"]:
        """Unknowns with the drift as fitted and all pulls of the law zero."""
        unknowns = self.unknowns.copy()
        unknowns[self.observation.tolerance_slice] = 0.0
        return unknowns

    @property
    def fitted_laws(self) -> tuple[ContactLaw, ...]:
        """Laws with clearance, stiffness and damping as fitted within their tolerances."""
        *_, damping_deviation_s = self.observation.law_prior_deviations
        fitted_laws = []
        for law, adjusted_law, pull in zip(self.law.laws, self.adjusted_law.laws, self.pulls[2::3], strict=True):
            damping_n_s_per_m = float(law.damping_n_s_per_m + pull * damping_deviation_s * law.stiffness_n_per_m)
            fitted_laws.append(changed(adjusted_law, damping_n_s_per_m=max(0.0, damping_n_s_per_m)))
        return tuple(fitted_laws)

    @property
    def drift_m(self) -> Float[np.ndarray, " times"]:
        """Slow part of the relative displacement that integration loses, m."""
        return self.observation.drift_m(self.unknowns)

    def pull_limit_sides_after(self, step: Float[np.ndarray, " unknowns"] | float = 0.0) -> PullSides:
        """Sides of the pulls, after a step of the unknowns."""
        return np.sign(_pull_limit_excess((self.unknowns + step)[self.observation.tolerance_slice]))

    @cached_property
    def columns_by_unknown(self) -> csr_matrix:
        """Decrease of the residual per unit of each unknown, rows x unknowns."""
        return self.columns_on_limit_sides(self.pull_limit_sides_after())

    def columns_on_limit_sides(self, sides: PullSides) -> csr_matrix:
        """Columns where the pulls' excess is straight, as on given sides."""
        prior_diagonal = np.diag(self.observation.pull_prior_weight * np.ones(sides.size))
        prior_rows = np.concatenate([prior_diagonal, PULL_EXCESS_WEIGHT * prior_diagonal * (sides != 0)])
        prior_matrix = block_diag([self.observation.drift_spline.curvature, prior_rows], "csr")
        return vstack([self._force_columns, prior_matrix], "csr")

    def residual_on_limit_sides(self, sides: PullSides) -> Float[np.ndarray, " rows"]:
        """Residual where the pulls' excess is straight, as on given sides."""
        residual = self.residual.copy()
        straight_excess = np.where(sides != 0, self.pulls - sides * PULL_LIMIT, 0.0)
        residual[residual.size - sides.size :] = (
            -self.observation.pull_prior_weight * PULL_EXCESS_WEIGHT * straight_excess
        )
        return residual

    @cached_property
    def _force_columns(self) -> csr_matrix:
        """Rows of `columns` of the force, without those of the priors."""
        drift_values = self.observation.drift_spline.value
        clearance_deviation, stiffness_deviation, damping_deviation_s = self.observation.law_prior_deviations
        pull_columns = []
        for law, signed_slope, per_stiffness, per_damping in zip(self.law.laws, *self.slopes[1:], strict=True):
            pull_columns += [
                -clearance_deviation * law.clearance_m * signed_slope,
                stiffness_deviation * law.stiffness_n_per_m * per_stiffness,
                damping_deviation_s * law.stiffness_n_per_m * per_damping,
            ]
        drift_columns = (
            self.tangent.force_change_by_coefficient(drift_values) + self.signals.slow_stiffness_n_per_m * drift_values
        )
        drift_columns += self.observation.drift_spline.force_n
        return diags(self.observation.force_weights) @ hstack([drift_columns, np.stack(pull_columns, axis=1)], "csr")

    @cached_property
    def drift_columns(self) -> csr_matrix:
        """Columns of the drift's knots alone."""
        return self.columns_by_unknown[:, : self.observation.drift_spline.knot_count]

    @cached_property
    def drift_solver(self) -> SuperLU:
        """Factorised normal matrix of the drift's knots."""
        return splu(csc_matrix(self.drift_columns.T @ self.drift_columns))


def force_and_drifted_eta(
    signals: ContactSignals,
    observation: ContactObservation,
    unknowns: Float[np.ndarray, " unknowns"],
    added_force_n: float | Float[np.ndarray, " times"] = 0.0,
    added_eta_m: float | Float[np.ndarray, " samples"] = 0.0,
) -> ForceAndEta:
    """Motion with the drift; added_force_n and added_eta_m come on top of force and relative displacement."""
    drift_spline, knots_m = observation.drift_spline, unknowns[: observation.drift_spline.knot_count]
    drift_m, drift_m_per_s = drift_spline.value @ knots_m, drift_spline.rate @ knots_m
    return ForceAndEta(
        signals.force_n + added_force_n,
        signals.eta_m + _at_sample_rate(drift_m, signals.decimation) + added_eta_m,
        signals.eta_rate_m_per_s + _at_sample_rate(drift_m_per_s, signals.decimation),
    )


def contact_residual(
    signals: ContactSignals,
    observation: ContactObservation,
    law: GroupLaw,
    unknowns: Float[np.ndarray, " unknowns"],
    motion: ForceAndEta,
) -> ContactResidual:
    """Residual at given unknowns and at the motion that they cause."""
    drift_spline, knots_m = observation.drift_spline, unknowns[: observation.drift_spline.knot_count]
    pulls, prior_deviations = unknowns[observation.tolerance_slice], observation.law_prior_deviations
    adjusted_laws, damping_increases_n_s_per_m = [], []
    for nominal_law, law_pulls in zip(law.laws, pulls.reshape(-1, len(prior_deviations)), strict=True):
        clearance_change, stiffness_change, _ = (law_pulls * prior_deviations).tolist()
        clearance_factor = max(LEAST_CLEARANCE_FACTOR, 1 + clearance_change)
        damping_increases_n_s_per_m.append(float(law_pulls[2] * prior_deviations[2] * nominal_law.stiffness_n_per_m))
        adjusted_laws.append(
            changed(
                nominal_law,
                lower_clearance_m=nominal_law.lower_clearance_m * clearance_factor,
                upper_clearance_m=nominal_law.upper_clearance_m * clearance_factor,
                stiffness_n_per_m=nominal_law.stiffness_n_per_m * max(0.01, 1 + stiffness_change),
            )
        )
    adjusted_law = GroupLaw(tuple(adjusted_laws), law.signs)

    def force_n(eta: Signal, eta_rate: Signal, *time_s: Signal) -> Signal:
        laws = zip(adjusted_law.signs, adjusted_law.laws, damping_increases_n_s_per_m, strict=True)
        forces_n = (
            sign * force_with_added_damping_n(adjusted, increase, sign * eta, sign * eta_rate, *time_s)
            for sign, adjusted, increase in laws
        )
        return np.asarray(sum(forces_n))

    law_force_n = signals.low_passed(force_n, motion, _depends_on_time(adjusted_law))
    slow_force_n = signals.slow_stiffness_n_per_m * (drift_spline.value @ knots_m) + drift_spline.force_n @ knots_m
    residual_n = motion.force_n - law_force_n - slow_force_n
    drift_rows = drift_spline.curvature_target - drift_spline.curvature @ knots_m
    prior_rows = -observation.pull_prior_weight * np.concatenate(
        [pulls, PULL_EXCESS_WEIGHT * _pull_limit_excess(pulls)]
    )
    residual = np.concatenate([observation.force_weights * residual_n, drift_rows, prior_rows])
    return ContactResidual(observation, signals, law, adjusted_law, unknowns, motion, residual)


def force_with_added_damping_n(
    law: ContactLaw, damping_increase_n_s_per_m: float, eta_m: Signal, rate_m_per_s: Signal, *time_s: Signal
) -> Signal:
    """Force of a law with increased damping; linear in the damping, which the increase may make negative."""
    damping_n_s_per_m = law.damping_n_s_per_m + damping_increase_n_s_per_m
    force_n = changed(law, damping_n_s_per_m=abs(damping_n_s_per_m)).force_n(eta_m, rate_m_per_s, *time_s)
    if damping_n_s_per_m >= 0:
        return force_n
    return 2 * changed(law, damping_n_s_per_m=0.0).force_n(eta_m, rate_m_per_s, *time_s) - force_n


def force_increase_by_fields_n(
    law: ContactLaw, eta_m: Signal, rate_m_per_s: Signal | float, time_s: Signal | float = 0.0, **increases: float
) -> Signal:
    """Increase of the force as fields that it is proportional to grow by these amounts."""
    increased_law = changed(law, **{name: getattr(law, name) + increase for name, increase in increases.items()})
    return increased_law.force_n(eta_m, rate_m_per_s, time_s) - law.force_n(eta_m, rate_m_per_s, time_s)


def _depends_on_time(law: GroupLaw) -> bool:
    """True if the law wears, and so depends on the time."""
    return any(single_law.wear_m_per_s for single_law in law.laws)


def _pull_limit_excess(pulls: Float[np.ndarray, " pulls"]) -> Float[np.ndarray, " pulls"]:
    """Excess of pulls beyond `PULL_LIMIT`, zero within it."""
    return np.asarray(pulls - np.clip(pulls, -PULL_LIMIT, PULL_LIMIT))


def _at_sample_rate(slow_motion: Float[np.ndarray, " times"], decimation: int) -> Float[np.ndarray, " samples"]:
    """Slow motion interpolated linearly to the recording's rate."""
    interpolated = slow_motion[:-1, None] + np.diff(slow_motion)[:, None] * (np.arange(decimation) / decimation)
    return np.append(interpolated, slow_motion[-1])
