"""Joint fit of clearances, stiffness and damping of one contact, or of several that share a relative displacement, with
the drift of that displacement and the nuisance parameters of rig.json; estimates with their covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import norm, t

from identify.contacts.contact_record import LEAST_CLOSED_SHARE, ContactRecord, clearly_closed
from identify.contacts.initial_guess import guesses, initial_state_pulls, without_nuisances
from identify.contacts.law_fit import LawFit, first_fit, fit_of_chosen_form, free_to_law_map, is_open, misfit_covariance
from identify.contacts.law_form import (
    DEAD_ZONE,
    LAW,
    SPRING,
    STIFFNESS_GRADIENT,
    FormName,
    LawForm,
    LawParameters,
    NominalLaws,
    Signal,
    TouchedStops,
    dead_zone_or_spring_form,
)
from identify.contacts.linearization import FitState, drift_and_nuisance_motion, state_at
from identify.contacts.refusals import ContactRefusedError, RefusalCode, refused
from identify.pages.wording import COVERED
from identify.signals.drift import DriftSpline
from identify.signals.scores import PART_COUNT, cluster_scores, equal_information_starts, quiet_interval_std
from identify.signals.spectra import at_force_rate
from rig.model.contact_laws.dead_zone import FRICTION_SPEED_M_PER_S

DRIFT_PULL_LIMIT = 25.0
"""Largest mean square of the drift's curvature less the measured one, in standard deviations."""
WANDER_LIMIT = 3.0
"""Noise, integrated twice between two closures, over the median penetration: beyond it the closures cannot be
placed."""
NOISE_RATIO_LIMIT = 1.5
"""Largest noise of a separated force over that of the sensors in it."""
PAUSE_SHARE = 0.05
"""Share of the times between closures, the longest, that `WANDER_LIMIT` spares: a pause splits the record in two."""

FRICTION_SHARE, FRICTION_ERRORS = 0.01, 5.0
"""Friction is clear from this share of the force's root mean square on, and so many standard errors."""

Covariance = Float[np.ndarray, "4 4"]
"""Covariance of the parameters of `LAW`."""


@dataclass(frozen=True)
class JointEstimate:
    """Estimate of one contact: values of the parameters of `LAW` with their covariance.

    covariances are the parts of the covariance by source: "scatter" of the record, "tolerances" of rig.json, "drift",
    the slow motion that accelerometers miss, and "law", the misfit of the law's form and how its damping sets in.
    sides_known: lower and upper clearance are distinguished; touched: the record determines (lower, upper). drift_m and
    drift_m_per_s were added to the relative displacement and velocity. pulls are the nuisance parameters in standard
    deviations. unexplained_share is the share of the contact force's root mean square that the fit leaves beyond the
    sensors' noise; split_half_z are those of clearance and stiffness between the record's halves in standard errors.
    The stiffness of a power law is the force over the depth at the reference depth of its form. open_friction_n is
    friction that rig.json lacks, zero where none is clear. widening_factor is that of the standard errors by pulls,
    which the covariances hold (`with_errors_widened_by_pulls`).
    """

    values: LawParameters
    covariances: Mapping[str, Covariance]
    sides_known: bool
    touched: tuple[bool, bool]
    drift_m: Float[np.ndarray, " samples"]
    drift_m_per_s: Float[np.ndarray, " samples"]
    pulls: Float[np.ndarray, " nuisances"]
    unexplained_share: float = 0.0
    split_half_z: tuple[float, float] = (0.0, 0.0)
    form: LawForm = DEAD_ZONE
    exponent: float = 1.0
    exponent_error: float = 0.0
    open_friction_n: float = 0.0
    widening_factor: float = 1.0

    @property
    def covariance(self) -> Covariance:
        return sum(self.covariances.values(), np.zeros((len(LAW), len(LAW))))

    @property
    def law_parameters(self) -> LawParameters:
        """Parameters as the form takes them: values, then the exponent of a power law."""
        return np.concatenate([self.values, np.full(self.form.exponent_count, self.exponent)])

    def force_n(self, eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        return self.form.force_n(self.law_parameters, eta_m, rate_m_per_s)

    def spring_force_over_stiffness_m(self, eta_m: Signal) -> Signal:
        """Force over stiffness, m: the depth, or for a power law depth |depth / d|^(p - 1)."""
        unit_parameters = np.concatenate([self.values[:2], [1.0, 0.0], self.law_parameters[len(LAW) :]])
        return self.form.force_n(unit_parameters, eta_m, np.zeros_like(eta_m))

    @property
    def clearance_gradient(self) -> LawParameters:
        """Clearance as a linear function of the parameters: half the total play, or that of the only touched stop."""
        return _clearance_gradient(self.touched)

    @property
    def is_spring(self) -> bool:
        """True of a spring without stops: neither side is fitted, both clearances are zero."""
        return not any(self.touched)

    @property
    def clearance_m(self) -> float:
        return float(self.clearance_gradient @ self.values)

    @property
    def clearance_error_m(self) -> float:
        return self.error(self.clearance_gradient)

    @property
    def stiffness_n_per_m(self) -> float:
        return float(STIFFNESS_GRADIENT @ self.values)

    @property
    def errors(self) -> LawParameters:
        """Standard error of every parameter."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def error(self, gradient: LawParameters) -> float:
        """Standard error of a linear function of the parameters, such as `STIFFNESS_GRADIENT`."""
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    def own_error(self, gradient: LawParameters) -> float:
        """Standard error of a linear function by the record's own scatter and drift, which differ in other records."""
        return float(np.sqrt(gradient @ (self.covariances["scatter"] + self.covariances["drift"]) @ gradient))

    @property
    def reversed(self) -> "JointEstimate":
        """Estimate with the relative displacement counted in the other direction."""
        swap_matrix = np.eye(len(LAW))[[1, 0, 2, 3]]
        lower_touched, upper_touched = self.touched
        return replace(
            self,
            values=swap_matrix @ self.values,
            covariances={source: swap_matrix @ part @ swap_matrix for source, part in self.covariances.items()},
            touched=(upper_touched, lower_touched),
            drift_m=-self.drift_m,
            drift_m_per_s=-self.drift_m_per_s,
        )


def _clearance_gradient(touched: tuple[bool, bool]) -> LawParameters:
    lower_weight, upper_weight = np.array(touched) / max(sum(touched), 1)
    return LAW.vector({"lower_clearance_m": lower_weight, "upper_clearance_m": upper_weight})


def fit_joint(
    record: ContactRecord, nominal_laws: NominalLaws, touched: TouchedStops, forms: Sequence[FormName] = ()
) -> tuple[JointEstimate, ...]:
    """Joint estimates of all contacts of a record by one fit.

    Gauss-Newton on the low-passed residual, with a cubic spline b(t) for the drift, a spring to the ground, and
    nuisance parameters theta with a prior of one:

        residual = (force - theta' nuisance_n
                    - low-pass[sum of k dz(eta + h b - theta' nuisance_m; lower, upper) + c (eta' + h b') beyond the
                    gap, over the contacts]) / g
                   - spring b - damper b',  g = 1 - theta' n, h = 1 - theta' m

    with the force_noise_multiple n and the eta_noise_multiple m.

    The prior of b'' is the measured slow acceleration, within the noise of the accelerometers. Where the zero of the
    relative displacement is unknown, lower = upper = half the total play. A contact of which neither side is touched is
    a spring: its clearances stay zero, and beside stops it fixes the zero of the relative displacement. g and h keep
    gains from being fitted to the noise, which shrinks with the signals. The fit starts from `guesses`. For a single
    contact the form of the law is then chosen among the dead zone and `forms`.

    How fast the damping sets in as a stop closes is not known, and where sensors may be late nothing else tells their
    delay from the damping. A further nuisance parameter with the same prior allows for it (the onset of `LawForm`).

    The covariance is a sandwich estimate over sixteenths of the record, as residuals may be coloured, plus the effect
    of a unit error in each row of the priors, and with `forms` the `misfit_covariance`; it holds for any weights.

    Raises ContactRefusedError if the contact is hardly ever closed, the fit does not converge, or several contacts
    cannot be told apart.
    """
    drift_spline, form = record.drift_spline, dead_zone_or_spring_form(touched)
    sides_known = record.sides_known or bool(form.spring_indices)
    free_to_laws, start_pulls = free_to_law_map(touched, sides_known), initial_state_pulls(record)
    initial_guesses = guesses(without_nuisances(record, start_pulls), nominal_laws, touched)
    fit = first_fit(record, free_to_laws, initial_guesses, start_pulls, form)
    check_drift_curvature(drift_spline, fit.state.knots)
    _check_wander_without_spring(record, fit.state)
    is_single = len(touched) == 1
    forms = forms if is_single and touched.any() else ()
    fit = fit_of_chosen_form(with_significant_friction(fit), forms)
    state, scaled_to_laws, (jacobian, normal_equations) = fit.state, fit.scaled_to_laws, fit.linearized
    pull_count, free_count = state.pulls.size, scaled_to_laws.shape[1]
    knot_columns, pull_free_columns = normal_equations.solved(
        np.zeros((drift_spline.knot_count, free_count)), np.eye(pull_count + free_count, free_count, -pull_count)
    )
    pull_law_columns = np.concatenate([pull_free_columns[:pull_count], scaled_to_laws @ pull_free_columns[pull_count:]])
    influence = jacobian.times_columns(knot_columns, pull_law_columns) * fit.weights[:, None] ** 2
    part_starts = equal_information_starts(influence @ scaled_to_laws[LAW.names.index("stiffness_n_per_m")])
    scores = cluster_scores(influence, state.residual_n, part_starts)
    error_rows = {
        "scatter": small_sample_factor(free_count) * scores,
        "tolerances": record.samples_per_error * pull_free_columns[: pull_count - 1],
        "law": record.samples_per_error * pull_free_columns[pull_count - 1 : pull_count],
        "drift": drift_spline.curvature @ knot_columns,
    }
    covariances = {source: scaled_to_laws @ (rows.T @ rows) @ scaled_to_laws.T for source, rows in error_rows.items()}
    if forms:
        covariances["law"] += misfit_covariance(fit, jacobian, part_starts)
    covariance = np.asarray(sum(covariances.values()))
    record_pulls, friction_pulls = np.split(state.nuisance_pulls, [len(record.nuisance_n)])
    drift_m, drift_m_per_s = drift_and_nuisance_motion(record, state.knots, record_pulls)
    if not is_single:
        _check_separable(state.law_parameters, covariance, touched, record.eta_m + drift_m)

    def estimate_at(first_parameter: int, lower_touched: bool, upper_touched: bool) -> JointEstimate:
        law_slice = slice(first_parameter, first_parameter + len(LAW))
        gradients = np.stack([_clearance_gradient((lower_touched, upper_touched)), STIFFNESS_GRADIENT], axis=1)
        return JointEstimate(
            values=state.law_parameters[law_slice],
            covariances={source: part[law_slice, law_slice] for source, part in covariances.items()},
            sides_known=sides_known,
            touched=(lower_touched, upper_touched),
            drift_m=drift_m,
            drift_m_per_s=drift_m_per_s,
            pulls=record_pulls,
            unexplained_share=unexplained_share([(state.residual_n, record.force_n, record.noise_n)]),
            split_half_z=split_half_z(scores @ scaled_to_laws[law_slice].T @ gradients),
            form=SPRING if not (lower_touched or upper_touched) else replace(state.form, spring_indices=(), step_s=0.0),
            open_friction_n=float(np.std(record.force_n) * friction_pulls.sum()),
            exponent=state.form.exponent(state.law_parameters),
            exponent_error=float(np.sqrt(covariance[-1, -1])) if state.form.exponent_count else 0.0,
        )

    return tuple(estimate_at(len(LAW) * contact_index, *sides) for contact_index, sides in enumerate(touched.tolist()))


def with_significant_friction(fit: LawFit) -> LawFit:
    """Fit with friction of the contact's places as a further nuisance parameter, in root mean squares of the force,
    where the residual of the open contact shows it clearly; else the fit, which would take friction for damping."""
    (friction_n, error_n, direction), record, state = _open_friction_and_error(fit), fit.record, fit.state
    force_rms_n = float(np.std(record.force_n))
    if friction_n < max(FRICTION_ERRORS * error_n, FRICTION_SHARE * force_rms_n):
        return fit
    record = replace(
        record,
        nuisance_n=np.vstack([record.nuisance_n, force_rms_n * direction]).astype(np.float32),
        force_noise_multiple=np.append(record.force_noise_multiple, 0.0),
        shifts_eta=np.append(record.shifts_eta, False),
        is_initial_state=np.append(record.is_initial_state, False),
    )
    pulls = np.insert(state.pulls, -1, friction_n / force_rms_n)
    start_state = state_at(record, state.form, state.law_parameters, state.knots, pulls)
    try:
        return replace(fit, record=record, state=start_state).settled
    except ContactRefusedError:
        return fit


def _open_friction_and_error(fit: LawFit) -> tuple[float, float, Signal]:
    """Friction, N, in the residual of the open contact, its standard error, and its derivative at all samples."""
    _, rate_m_per_s = fit.motion
    residual_n, fine_direction = fit.state.residual_n, np.tanh(rate_m_per_s / FRICTION_SPEED_M_PER_S)
    direction = at_force_rate(fine_direction, fit.record.decimation)[: residual_n.size]
    open_direction = direction * is_open(fit.state)
    information = max(float(open_direction @ open_direction), 1e-300)
    friction_n = float(open_direction @ residual_n) / information
    score_norm = np.linalg.norm(cluster_scores(open_direction[:, None], residual_n - friction_n * open_direction))
    return friction_n, float(score_norm) / information, direction


def small_sample_factor(free_count: int) -> float:
    """Factor of the scatter of few parts, less the free parameters: Student's t, so that 1.96 standard errors cover
    95 %."""
    degrees_of_freedom = PART_COUNT - free_count
    return float(np.sqrt(PART_COUNT / degrees_of_freedom) * t.ppf(0.975, degrees_of_freedom) / norm.ppf(0.975))


def unexplained_share(residual_force_noise_n: Sequence[tuple[Signal, Signal, float]]) -> float:
    """Root mean square of the residuals (first) beyond the sensors' noise (third), as a share of the forces' (second).

    The noise is that of the quietest parts, at most `NOISE_RATIO_LIMIT` times the sensors', and three standard
    deviations of its variance in a part of n samples, sqrt(2 / n) of it.
    """
    residual_power, force_power = 0.0, 0.0
    for residual_n, force_n, sensor_noise_n in residual_force_noise_n:
        noise_n = min(float(quiet_interval_std(residual_n)), NOISE_RATIO_LIMIT * sensor_noise_n)
        noise_power = noise_n**2 * (1 + 3 * np.sqrt(2 * PART_COUNT / residual_n.size))
        residual_power += max(float(np.var(residual_n)) - noise_power, 0.0)
        force_power += max(float(np.var(force_n)) - noise_power, 0.0)
    return float(np.sqrt(residual_power / force_power)) if force_power > 0 else 0.0


def split_half_z(influence_by_part: Float[np.ndarray, "parts 2"]) -> tuple[float, float]:
    """Influence of the record's first half on clearance and stiffness less that of its second, over their scatter."""
    scatter = np.maximum(np.sqrt(np.sum(influence_by_part**2, axis=0)), 1e-300)
    middle = len(influence_by_part) // 2
    half_difference = influence_by_part[:middle].sum(axis=0) - influence_by_part[middle:].sum(axis=0)
    clearance_difference, stiffness_difference = half_difference / scatter
    return float(clearance_difference), float(stiffness_difference)


def check_drift_curvature(drift_spline: DriftSpline, knots: Float[np.ndarray, " knots"]) -> None:
    """Raises ContactRefusedError if the drift's curvature less the measured one exceeds `DRIFT_PULL_LIMIT`; its mean
    square is usually 1 to 2 squared standard deviations."""
    prior_residual = drift_spline.curvature @ knots - drift_spline.curvature_target
    if drift_spline.knot_count and np.mean(prior_residual**2) > DRIFT_PULL_LIMIT:
        raise refused(RefusalCode.DRIFT_TOO_LARGE)


def _check_wander_without_spring(record: ContactRecord, state: FitState) -> None:
    """Raises ContactRefusedError as `check_wander`, unless a spring tells the slow motion."""
    if record.drift is None or record.drift.spring_n_per_m > 0 or state.form.spring_indices:
        return
    is_closed = clearly_closed(record)
    depth_m = float(np.median(np.abs(record.force_n[is_closed]))) / state.stiffness_n_per_m
    check_wander(is_closed, record.decimation / record.sample_rate_hz, record.drift.noise_density, depth_m)


def check_wander(is_closed: Bool[np.ndarray, " fewer"], step_s: float, noise_density: float, depth_m: float) -> None:
    """Raises ContactRefusedError if the noise, integrated twice between closures, exceeds `WANDER_LIMIT`
    penetrations."""
    closure_intervals_s = np.sort(np.diff(np.flatnonzero(np.diff(is_closed.astype(int)) == 1)) * step_s)
    closure_intervals_s = closure_intervals_s[: round((1 - PAUSE_SHARE) * closure_intervals_s.size)]
    wander_m = noise_density * np.sqrt(np.mean(closure_intervals_s**3) / 6) if closure_intervals_s.size else np.inf
    if wander_m > WANDER_LIMIT * depth_m:
        raise refused(RefusalCode.DRIFT_NOT_BRIDGED, wander_um=float(1e6 * wander_m), penetration_um=1e6 * depth_m)


def _check_separable(
    law_parameters: LawParameters,
    covariance: Float[np.ndarray, "laws laws"],
    touched: TouchedStops,
    eta_m: Float[np.ndarray, " samples"],
) -> None:
    """Raises ContactRefusedError if a stop is hardly ever reached, or two knees differ by less than their 95 %
    interval."""
    laws = law_parameters.reshape(-1, len(LAW))
    for side, sign in enumerate((-1, 1)):
        contact_indices = np.flatnonzero(touched[:, side])
        if any(np.mean(sign * eta_m > laws[contact, side]) < LEAST_CLOSED_SHARE for contact in contact_indices):
            raise refused(RefusalCode.NOT_SEPARABLE)
        for first_contact, second_contact in combinations(contact_indices, 2):
            gradient = np.zeros_like(law_parameters)
            gradient[[len(LAW) * first_contact + side, len(LAW) * second_contact + side]] = 1, -1
            if abs(gradient @ law_parameters) < COVERED * np.sqrt(gradient @ covariance @ gradient):
                raise refused(RefusalCode.NOT_SEPARABLE)
