"""Initial guesses of a contact's law, of the drift of its relative displacement, and of the modes' initial states.

The law of one contact is regressed on the samples at which it is clearly closed. The force of several dead zones that
share a relative displacement has a knee at each stop, as of a soft bumper with a hard stop behind it. A spring beside
stops is subtracted first; its stiffness is the one of a scan that leaves least.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from operator import itemgetter

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import spsolve

from identify.contacts.contact_record import CLOSED_FORCE_SHARE, ContactRecord, clearly_closed, touched_stops
from identify.contacts.law_form import (
    LAW,
    LawForm,
    LawParameters,
    NominalLaws,
    TouchedStops,
    dead_zone_or_spring_form,
    unit_forces,
)
from identify.contacts.linearization import LawGuess, ground_n_per_m
from identify.contacts.refusals import ContactRefusedError, RefusalCode, refused
from identify.signals.drift import DriftSpline
from identify.signals.refit import refit_until_settled

StopSides = tuple[bool, bool]
"""(lower, upper): True where that stop is touched."""
REGRESSION_STAGES = ((0.5, 30.0), (0.2, 30.0), (0.1, 10.0), (0.03, 3.0), (0.01, 1.0))
"""Error of the displacement where the contact is clearly closed, as a share of its standard deviation, and weight of
the drift's curvature, stage by stage: at first so stiff that no drift can follow the closures."""
OUTLIER_SCALE = 3.0
"""Scale of the weights of the next stage, in those errors: samples that ring are outliers (Geman and McClure)."""
UNTOUCHED_CLEARANCE_RATIO = 1.1
"""Clearance of a stop that is never touched over the largest relative displacement."""
KNEE_FORCE_COUNT = 12
"""Forces that are tried for each knee, spaced evenly in their logarithm."""
SOFT_STOP_SHARE = 0.01
"""A soft stop is closed where the force exceeds this share of its 99.5 % quantile."""
MOST_GUESSES = 4
"""Guesses that are fitted by Gauss-Newton."""
SPRING_STIFFNESS_SHARES = np.geomspace(1e-3, 1.0, 16)
"""Stiffnesses that are tried for a spring beside stops, over the secant of the largest forces."""
REWEIGHTING_ROUNDS = 30
LEAST_DEVIATION_SHARE = 1e-3
"""Deviations below this share of the median deviation weigh as much as that share."""


def regressed_guess(record: ContactRecord, sides: StopSides | None = None) -> LawGuess:
    """Law and drift b by the regression eta + b = +-clearance + force / k, linear in clearance, 1 / k and b, over the
    samples at which a stop on these sides, or else on the touched ones, is clearly closed.

    A spring s on the drift adds s b to the measured force. Then b = 0 is tried first; if that gives no law, as where a
    record begins in motion, (1 + s / k) b is solved for.

    Raises ContactRefusedError as `touched_stops` does, and if no force grows with the relative displacement.
    """
    touched_sides = touched_stops(record) if sides is None else sides
    for with_drift in (False, True) if record.spring_n_per_m else (True,):
        *knots, clearance_m, compliance_m_per_n = compliance_regression(record, with_drift, sides=touched_sides)
        if np.isfinite(clearance_m) and compliance_m_per_n > 0:
            untouched_m = UNTOUCHED_CLEARANCE_RATIO * float(np.max(np.abs(record.eta_m)))
            lower_m, upper_m = (max(clearance_m, 0.0) if is_touched else untouched_m for is_touched in touched_sides)
            drift_ratio = 1 + record.spring_n_per_m * compliance_m_per_n * with_drift
            return np.array([lower_m, upper_m, 1 / compliance_m_per_n, 0.0]), np.array(knots) / drift_ratio
    raise refused(RefusalCode.NO_STIFFNESS)


def _guess_by_open_contact(record: ContactRecord, sides: StopSides) -> list[LawGuess]:
    """Drift by the open contact, and the law regressed on the closed samples then; none without a spring."""
    if not record.spring_n_per_m:
        return []
    ground_matrix = ground_n_per_m(record)
    knots = drift_knots_by_open_contact(record.force_n, ~clearly_closed(record), ground_matrix, record.drift_spline)
    moved_eta_m, moved_force_n = (
        record.eta_m + record.drift_spline.value @ knots,
        record.force_n - ground_matrix @ knots,
    )
    try:
        law_parameters, _ = regressed_guess(replace(record, eta_m=moved_eta_m, force_n=moved_force_n), sides)
    except ContactRefusedError:
        return []
    return [(law_parameters, knots)]


def drift_knots_by_open_contact(
    force_n: Float[np.ndarray, " fewer"],
    is_open: Bool[np.ndarray, " fewer"],
    ground_matrix: csr_matrix,
    drift_spline: DriftSpline,
) -> Float[np.ndarray, " knots"]:
    """Knots of the drift b and the slow force z by the force s b + z = ground_matrix @ knots of an open contact, under
    their priors; zero of a contact that never opens."""
    if not np.any(force_n[is_open]):
        return np.zeros(drift_spline.knot_count)
    no_law_columns = np.zeros((np.count_nonzero(is_open), 0))
    return robust_regression(force_n[is_open], ground_matrix[is_open], no_law_columns, drift_spline)[0]


def compliance_regression(
    record: ContactRecord,
    with_drift: bool,
    force_share: float = CLOSED_FORCE_SHARE,
    knee_excess_n: Sequence[Float[np.ndarray, " fewer"]] = (),
    sides: StopSides = (True, True),
) -> Float[np.ndarray, " unknowns"]:
    """Regression on closed samples: drift's knots, clearance, 1 / stiffness, and the decrease of it beyond each
    knee."""
    drift_spline, force_n, sign = record.drift_spline, record.force_n, np.sign(record.force_n)
    is_closed = clearly_closed(record, force_share) & np.where(force_n < 0, *sides)
    closed_splines = record.at_force_samples(drift_spline.value)[is_closed]
    closed_eta_m = record.at_force_samples(record.eta_m)[is_closed]
    law_columns = np.stack([sign, force_n, *(-sign * excess_n for excess_n in knee_excess_n)], axis=1)[is_closed]
    drift_columns = -closed_splines if with_drift else csr_matrix(closed_splines.shape)
    return np.concatenate(robust_regression(closed_eta_m, drift_columns, law_columns, drift_spline))


def robust_regression(
    eta_m: Float[np.ndarray, " samples"],
    drift_columns: csr_matrix,
    law_columns: Float[np.ndarray, "samples laws"],
    drift_spline: DriftSpline,
) -> tuple[Float[np.ndarray, " knots"], Float[np.ndarray, " laws"]]:
    """Knots of the drift and coefficients of the law, by least squares reweighted through `REGRESSION_STAGES`."""
    columns = hstack([drift_columns, law_columns]).tocsr()
    no_law_columns = csr_matrix((drift_spline.curvature_target.size, law_columns.shape[1]))
    curvature_rows = hstack([drift_spline.curvature, no_law_columns])
    weights, knot_count = np.ones(eta_m.size), drift_columns.shape[1]
    for residual_share, curvature_weight in REGRESSION_STAGES:
        error_m = residual_share * float(np.std(eta_m))
        weighted_rows = vstack([diags(weights / error_m) @ columns, curvature_weight * curvature_rows]).tocsc()
        normal_matrix = weighted_rows.T @ weighted_rows
        right_side = np.concatenate([weights * eta_m / error_m, curvature_weight * drift_spline.curvature_target])
        knot_ridge = np.full(knot_count, 1e-12 * normal_matrix.diagonal().max())
        ridge = diags(np.r_[knot_ridge, np.zeros(law_columns.shape[1])])
        coefficients = spsolve((normal_matrix + ridge).tocsc(), weighted_rows.T @ right_side)
        weights = 1 / (1 + ((eta_m - columns @ coefficients) / (OUTLIER_SCALE * error_m)) ** 2)
    return coefficients[:knot_count], coefficients[knot_count:]


def reach_m(record: ContactRecord) -> Float[np.ndarray, "2"]:
    """Largest relative displacement to either side, m.

    Raises ContactRefusedError as `regressed_guess` does.
    """
    eta_m = record.eta_m + record.drift_spline.value @ regressed_guess(record)[1]
    return np.array([-eta_m.min(), eta_m.max()])


def guesses(record: ContactRecord, nominal_laws: NominalLaws, touched: TouchedStops) -> list[LawGuess]:
    """Initial guesses, each with and without the drift of its regression, and that by the open contact; of a spring
    alone, by least squares. A spring beside stops has its nominal stiffness and damping, which `spring_guess` gives.

    For several contacts, the guesses of least misfit among the nominal clearances and the regressions, for some forces
    F_m at the knees, over the closed samples, on

        eta + b = +-(c_1 + |f| / k_1 - sum_m (1 / K_m - 1 / K_m+1) max(|f| - F_m, 0)),    K_m = k_1 + ... + k_m
    """
    is_side_touched, form = np.any(touched, axis=0), dead_zone_or_spring_form(touched)
    if not is_side_touched.any():
        unit_spring, zero_knots = LAW.vector({"stiffness_n_per_m": 1.0}), np.zeros(record.drift_spline.knot_count)
        return [_misfit_and_refined_guess(record, unit_spring, zero_knots, form)[1]]
    if form.spring_indices:
        are_stops = touched.any(axis=1)
        (spring_law,) = nominal_laws[~are_stops]
        stop_guesses = guesses(without_spring(record, spring_law), nominal_laws[are_stops], touched[are_stops])
        return _guesses_with_spring(record, nominal_laws, form, stop_guesses)
    sides = bool(is_side_touched[0]), bool(is_side_touched[1])
    law_parameters, knots = regressed_guess(record, sides)
    candidates = [(law_parameters, knots)]
    if len(nominal_laws) > 1:
        untouched_m = UNTOUCHED_CLEARANCE_RATIO * float(np.max(np.abs(record.eta_m)))
        nominal_laws = np.column_stack([np.where(touched, nominal_laws[:, :2], untouched_m), nominal_laws[:, 2:]])
        candidates = [(nominal_laws.ravel(), knots), *_knee_guesses(record, nominal_laws, touched)]
    candidates += [(law_parameters, np.zeros_like(knots)) for law_parameters, knots in candidates if knots.size]
    if len(nominal_laws) == 1:
        return [*candidates, *_guess_by_open_contact(record, sides)]
    return _best_guesses(record, candidates, form)


def _guesses_with_spring(
    record: ContactRecord,
    nominal_laws: NominalLaws,
    form: LawForm,
    stop_guesses: Sequence[tuple[Float[np.ndarray, " stop_laws"], Float[np.ndarray, " knots"]]],
) -> list[LawGuess]:
    """Guesses of stops with the spring of `nominal_laws` beside them."""
    candidates: list[LawGuess] = []
    for stop_parameters, knots in stop_guesses:
        laws = nominal_laws.copy()
        laws[np.isin(np.arange(len(laws)), form.spring_indices, invert=True)] = stop_parameters.reshape(-1, len(LAW))
        candidates.append((laws.ravel(), knots))
    return _best_guesses(record, candidates, form)


def _best_guesses(record: ContactRecord, candidates: Sequence[LawGuess], form: LawForm) -> list[LawGuess]:
    """Refined guesses of least misfit."""
    misfits_and_guesses = sorted(
        (_misfit_and_refined_guess(record, *guess, form) for guess in candidates), key=itemgetter(0)
    )
    return [guess for misfit, guess in misfits_and_guesses[:MOST_GUESSES] if np.isfinite(misfit)]


def without_spring(record: ContactRecord, spring_law: LawParameters) -> ContactRecord:
    """Record with the force of a spring subtracted. What the drift of the relative displacement adds to that force
    remains, as of a spring to the ground."""
    *_, stiffness_n_per_m, damping_n_s_per_m = spring_law.tolist()
    eta, velocity = (record.at_force_samples(signal) for signal in (record.eta_m, record.velocity_m_per_s))
    drift = record.drift and replace(
        record.drift,
        spring_n_per_m=record.drift.spring_n_per_m + stiffness_n_per_m,
        damper_n_s_per_m=record.drift.damper_n_s_per_m + damping_n_s_per_m,
    )
    return replace(record, force_n=record.force_n - stiffness_n_per_m * eta - damping_n_s_per_m * velocity, drift=drift)


def spring_guess(record: ContactRecord) -> tuple[LawParameters, Float[np.ndarray, " samples"]]:
    """Spring beside stops, and the relative displacement with its drift, m: of the stiffnesses by
    `SPRING_STIFFNESS_SHARES`, the one that leaves least of the force beside one stop, then the spring of that
    least-squares solution once more.

    Raises ContactRefusedError if no force grows with the relative displacement beyond that of a spring.
    """
    form = LawForm(spring_indices=(1,))
    large_force_n, large_eta_m = (float(np.quantile(np.abs(x), 0.995)) for x in (record.force_n, record.eta_m))
    stiffnesses_n_per_m = large_force_n / max(large_eta_m, 1e-300) * SPRING_STIFFNESS_SHARES
    spring_laws = [LAW.vector({"stiffness_n_per_m": float(stiffness)}) for stiffness in stiffnesses_n_per_m]
    least_misfit, best_guess = np.inf, None
    for attempt in range(len(spring_laws) + 1):
        if attempt < len(spring_laws):
            spring_law = spring_laws[attempt]
        elif best_guess is not None:
            spring_law = best_guess[0][len(LAW) :]
        try:
            stop_law, knots = regressed_guess(without_spring(record, spring_law))
        except ContactRefusedError:
            continue
        for drift_knots in (knots, np.zeros_like(knots)):
            misfit, guess = _misfit_and_refined_guess(record, np.concatenate([stop_law, spring_law]), drift_knots, form)
            if misfit < least_misfit:
                least_misfit, best_guess = misfit, guess
    if best_guess is None:
        raise refused(RefusalCode.NO_STIFFNESS)
    return best_guess[0][len(LAW) :], record.eta_m + record.drift_spline.value @ best_guess[1]


def _misfit_and_refined_guess(
    record: ContactRecord, law_parameters: LawParameters, knots: Float[np.ndarray, " knots"], form: LawForm
) -> tuple[float, LawGuess]:
    """Misfit, and the law with stiffnesses and dampings by least squares. The misfit is infinite if they are not
    determined, or a stiffness is negative."""
    drift_spline, laws = record.drift_spline, law_parameters.reshape(-1, len(LAW)).copy()
    eta = record.at_force_samples(record.eta_m + drift_spline.value @ knots)
    velocity = record.at_force_samples(record.velocity_m_per_s + drift_spline.rate @ knots)
    unit_force_columns = np.stack(unit_forces(form, laws.ravel(), eta, velocity), axis=1)
    law_force_n = record.force_n - ground_n_per_m(record) @ knots
    coefficients, _, column_rank, _ = np.linalg.lstsq(unit_force_columns, law_force_n, rcond=None)
    laws[:, 2:] = coefficients.reshape(-1, 2)
    is_determined = column_rank == unit_force_columns.shape[1] and np.all(laws[:, 2] > 0)
    misfit = float(np.sum((law_force_n - unit_force_columns @ coefficients) ** 2)) if is_determined else np.inf
    return misfit, (laws.ravel(), knots)


def _knee_guesses(record: ContactRecord, nominal_laws: NominalLaws, touched: TouchedStops) -> Iterator[LawGuess]:
    """Guesses by the regression with knees, knee by knee assigned in the order of the nominal clearances."""
    force_size_n, knot_count = np.abs(record.force_n), record.drift_spline.knot_count
    touched_counts, largest_force_n = touched.sum(axis=0), float(np.quantile(force_size_n, 0.9995))
    stop_counts = np.where(record.force_n < 0, *touched_counts)
    least_closed_n = force_size_n[clearly_closed(record, SOFT_STOP_SHARE)].min()
    knee_forces_n = np.geomspace(least_closed_n, largest_force_n, KNEE_FORCE_COUNT + 2)[1:-1]
    for knees_n in combinations(knee_forces_n, int(touched_counts.max()) - 1):
        excess_n = [np.maximum(force_size_n - knee_n, 0.0) * (stop_counts > k) for k, knee_n in enumerate(knees_n, 1)]
        for with_drift in (False, True) if record.spring_n_per_m else (True,):
            coefficients = compliance_regression(record, with_drift, SOFT_STOP_SHARE, excess_n)
            knots, (clearance, compliance, *decreases) = coefficients[:knot_count], coefficients[knot_count:].tolist()
            summed_n_per_m = 1 / (compliance - np.cumsum([0.0, *decreases]))
            if not (np.isfinite(clearance) and np.all(summed_n_per_m > 0) and np.all(np.diff(summed_n_per_m) > 0)):
                continue
            clearances_m = max(clearance, 0.0) + np.cumsum([0.0, *(np.diff([0.0, *knees_n]) / summed_n_per_m[:-1])])
            stiffnesses_n_per_m, laws = np.diff([0.0, *summed_n_per_m]), nominal_laws.copy()
            for side in range(2):
                contact_indices = np.flatnonzero(touched[:, side])
                contact_indices = contact_indices[np.argsort(nominal_laws[contact_indices, side], kind="stable")]
                laws[contact_indices, side] = clearances_m[: contact_indices.size]
                laws[contact_indices, 2] = stiffnesses_n_per_m[: contact_indices.size]
            drift_ratio = 1 + record.spring_n_per_m * compliance * with_drift
            yield laws.ravel(), knots / drift_ratio


def initial_state_pulls(record: ContactRecord) -> Float[np.ndarray, " nuisances"]:
    """Initial states of the modes of a record that begins in motion; zero for all other nuisance parameters.

    Their free motion may add many times a contact's force. As a contact is open for much of the time, theta of

        force(t) = theta' nuisance_n(t) + contact force(t)

    is estimated by least absolute deviations, with a prior of one on each theta, by iteratively reweighted least
    squares.
    """
    pulls, is_initial = np.zeros(len(record.nuisance_n)), record.is_initial_state
    if not np.any(is_initial):
        return pulls
    state_forces_n = record.nuisance_n[is_initial].astype(float)

    def reweighted_states(theta: Float[np.ndarray, " initial"]) -> Float[np.ndarray, " initial"]:
        deviation_n = np.abs(record.force_n - theta @ state_forces_n)
        median_n = max(float(np.median(deviation_n)), 1e-300)
        weighted_rows = state_forces_n / np.maximum(deviation_n, LEAST_DEVIATION_SHARE * median_n)
        prior_matrix = np.eye(len(state_forces_n)) / median_n
        return np.linalg.solve(weighted_rows @ state_forces_n.T + prior_matrix, weighted_rows @ record.force_n)

    pulls[is_initial] = refit_until_settled(pulls[is_initial], reweighted_states, max_rounds=REWEIGHTING_ROUNDS)
    return pulls


def without_nuisances(record: ContactRecord, pulls: Float[np.ndarray, " nuisances"]) -> ContactRecord:
    """Record with the nuisance signals of these pulls subtracted from its force."""
    return replace(record, force_n=record.force_n - pulls @ record.nuisance_n) if pulls.any() else record
