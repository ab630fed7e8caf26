"""Identification of contact laws without assuming one: symbolic regression of the separated force."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.contacts.acceptance import AcceptedContacts, contacts_after_recording_check
from identify.contacts.contact_record import ContactRecord
from identify.contacts.joint_fit import JointEstimate, unexplained_share
from identify.contacts.law_form import LawForm
from identify.contacts.refusals import Refusal
from identify.contacts.results import Estimate, unanswered
from identify.laws.fitted_laws import (
    ERROR_RESOLUTION,
    AnyLaw,
    ForceSamples,
    Friction,
    FrictionFit,
    Part,
    PiecewiseLinear,
    Signal,
    fitted_friction,
    fitted_piecewise_linear,
    force_without_low_pass,
    hysteresis_share,
    law_knees_m,
    mean_slopes_n_per_m,
    polynomial,
)
from identify.laws.results import (
    CUBIC,
    DEAD_ZONE,
    FORMULA,
    LINEAR,
    PIECEWISE,
    SLIDING,
    SMOOTH_SLIDING,
    ContactLawEstimate,
    LawReport,
    TriedLaw,
    sliding_estimates,
    verdict_sentence,
)
from identify.laws.symbolic import Formula, pyoperon, search
from identify.linear.joined import ContactGroup
from identify.pages.wording import record_length_words
from identify.signals.kinematics import MotionQuantity
from rig.errors import RigError
from rig.model.tolerances import Tolerances
from rig.recording import Recording

SEARCH_POINT_COUNT = 4000
ETA_CELL_COUNT = 100
FALLBACK_KNEE_COUNT = 4
"""Count of evenly spaced knees from which straight pieces start where those of the formula fit badly."""
EDGE_SAMPLE_COUNT = 64
"""Samples of the force at either end of the record that the low-pass falsifies."""
MIN_SAMPLE_COUNT = 500
REFINED_ERROR_RATIO = 3.0
"""Friction that roughly leaves more than this multiple of what straight pieces leave is not refined, to save time."""
EQUAL_ERROR_RATIO = 1.05
"""An error counts as equal to the smallest up to this multiple of it."""


@dataclass(frozen=True)
class ContactLawFit:
    """Law of one contact with the points that the formula was searched on, and the record for figures.

    sliding is None unless friction is the best law.
    """

    result: ContactLawEstimate
    searched_eta_m: Float[np.ndarray, " points"]
    searched_force_n: Float[np.ndarray, " points"]
    formula: Formula
    pieces: PiecewiseLinear
    sliding: Friction | None
    record: ForceSamples
    time_s: Float[np.ndarray, " samples"]
    """Times of the force's samples."""

    @property
    def plotted_law(self) -> str:
        """Name of the law that is drawn over time."""
        return self.result.best if self.sliding else "straight pieces"

    @property
    def plotted_force_n(self) -> Float[np.ndarray, " samples"]:
        """Force of that law, low-passed as the separated one is."""
        return self.record.low_passed(self.sliding or self.pieces)


@dataclass(frozen=True)
class Laws:
    """Laws of the contacts that were identified, with the report on all."""

    report: LawReport
    fits: tuple[ContactLawFit, ...]


def identify_law(
    recording: Recording,
    *,
    contact: str | None = None,
    use: MotionQuantity = "auto",
    seconds: float = 60.0,
    seed: int = 0,
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Laws:
    """Law f(eta) of every contact, or of the named one, compared with laws that one would assume.

    Contacts between the same places have one law, that of their sum without the damping of the joint estimate. The
    force is separated without a law. The relative displacement is the measured one; from accelerations it includes the
    slow drift of the joint estimate, which assumes a dead zone. The contacts share the `seconds` of search.

    Raises RigError if the record does not allow it, the contact is unknown, or pyoperon is not installed.
    """
    if not (np.isfinite(seconds) and seconds >= 1):
        raise RigError(f"seconds is {seconds}; give 1 or more")
    names = [c.name for c in recording.rig.contacts]
    if contact is not None and contact not in names:
        raise RigError(f"no contact {contact!r} in the recording; there are {', '.join(names)}")
    pyoperon()  # raises before the long computation if it is missing
    accepted = contacts_after_recording_check(recording, use, tolerances)
    progress(0.1)
    separation, refusals = accepted.separation, accepted.outcomes.refusals
    groups_and_records = zip(separation.contact_groups, separation.records, strict=True)
    named_groups = [({names[i] for i in group.contact_indices}, group, record) for group, record in groups_and_records]
    chosen_groups = [member for member in named_groups if contact is None or contact in member[0]]
    law_fits: list[ContactLawFit] = []
    refused: dict[str, Refusal] = {}
    for contact_number, (group_names, group, record) in enumerate(chosen_groups, start=1):
        if group_names <= refusals.keys() and (record.drift is not None or not np.ptp(record.eta_m)):
            refused |= {name: refusals[name] for name in names if name in group_names}
        else:
            law_fits.append(_contact_law_fit(accepted, group, record, seconds / len(chosen_groups), seed))
        progress(0.1 + 0.9 * contact_number / len(chosen_groups))
    laws = tuple(law_fit.result for law_fit in law_fits)
    report = LawReport(rig=recording.rig.name, laws=laws, unanswered=unanswered(refused), findings=accepted.findings)
    return Laws(report, tuple(law_fits))


@dataclass(frozen=True)
class _ContactSamples:
    """Force and complete relative displacement of a contact, with its joint estimates, and as a contact record.

    Laws are fitted to the rows `training_rows`, the first half of the excited ones, and compared on `held_out_rows`,
    the second; the best is fitted again to all `excited_rows`.
    """

    record: ForceSamples
    contact_record: ContactRecord
    estimates: tuple[JointEstimate, ...]
    training_rows: slice
    held_out_rows: slice

    @property
    def excited_rows(self) -> slice:
        return slice(self.training_rows.start, self.held_out_rows.stop)

    @property
    def error_resolution_n(self) -> float:
        """Difference below which errors count as equal, N."""
        return ERROR_RESOLUTION * float(np.std(self.record.force_n[self.excited_rows]))

    @property
    def changed(self) -> Iterator[ForceSamples]:
        """Samples with each nuisance parameter of the record changed by one standard deviation."""
        record, moving_rows = self.record, iter(self.contact_record.nuisance_m)
        for force_n, shifts_eta, is_initial_state in zip(
            self.contact_record.nuisance_n,
            self.contact_record.shifts_eta,
            self.contact_record.is_initial_state,
            strict=True,
        ):
            eta_m = next(moving_rows) if shifts_eta else np.zeros_like(record.eta_m)
            velocity_m_per_s = record.velocity_m_per_s - self.contact_record.velocity_of(eta_m)
            if not is_initial_state:
                yield replace(
                    record,
                    eta_m=record.eta_m - eta_m,
                    velocity_m_per_s=velocity_m_per_s,
                    force_n=record.force_n - force_n,
                )

    def tried(self, name: str, law: AnyLaw) -> TriedLaw:
        """Law with what it leaves of the held-out rows; all of it where the force is no more than noise."""
        rows, noise_n = self.held_out_rows, self.contact_record.noise_n
        force_n, residual_n = self.record.force_n[rows], self.record.residual_n(law, rows)
        is_above_noise = unexplained_share([(force_n, force_n, noise_n)]) > 0
        left_share = unexplained_share([(residual_n, force_n, noise_n)]) if is_above_noise else 1.0
        return TriedLaw(name, float(np.sqrt(np.mean(residual_n**2))), left_share)

    @property
    def law_values(self) -> Float[np.ndarray, " laws"]:
        """Values of the laws of all joint estimates, end to end."""
        return np.array([estimate.values for estimate in self.estimates]).ravel()


@dataclass(frozen=True)
class _FormulaFit:
    """Formula with the points that it was searched on, and the least error (N) of all formulas of the search."""

    formula: Formula
    least_error_n: float
    searched_eta_m: Float[np.ndarray, " points"]
    searched_force_n: Float[np.ndarray, " points"]
    out_of_time: bool


def _contact_law_fit(
    contacts: AcceptedContacts, group: ContactGroup, contact_record: ContactRecord, search_s: float, seed: int
) -> ContactLawFit:
    """Law of one contact: formula, straight pieces, friction, damper and spring, and cubic, compared on the held-out
    half."""
    samples = _contact_samples(contacts, group, contact_record)
    record = samples.record
    formula_fit = _search_formula(samples, search_s, seed)
    formula, low_m, high_m = (
        formula_fit.formula,
        float(formula_fit.searched_eta_m.min()),
        float(formula_fit.searched_eta_m.max()),
    )
    knees_m = law_knees_m(formula, low_m, high_m)
    pieces = _fit_straight_pieces(samples, formula_fit, knees_m)
    friction_fits = _friction_fits(samples, REFINED_ERROR_RATIO * record.error_n(pieces, samples.training_rows))
    law_by_name: dict[str, AnyLaw] = {PIECEWISE: pieces}
    if samples.estimates:
        law_by_name[DEAD_ZONE] = lambda eta_m: LawForm().force_n(samples.law_values, eta_m, np.zeros_like(eta_m))
    law_by_name |= {name: fit.law for name, fit in friction_fits.items()}
    law_by_name |= {CUBIC: polynomial(record, samples.training_rows, 3), FORMULA: formula}
    tried_laws = tuple(samples.tried(name, law) for name, law in law_by_name.items())
    held_out_errors_n = [tried.held_out_error_n for tried in tried_laws]
    best_tried = tried_laws[_simplest_equivalent_index(held_out_errors_n, samples.error_resolution_n)]
    # the final fit takes all excited rows
    changed = () if samples.estimates else samples.changed
    pieces = fitted_piecewise_linear(record, samples.excited_rows, pieces.knees_m, changed)
    pieces = _with_contact_errors(pieces, samples.estimates)
    friction, sliding = None, None
    if best_tried.fits and best_tried.law in friction_fits:
        training_fit = friction_fits[best_tried.law]
        rows = slice(training_fit.rows.start, samples.excited_rows.stop)
        friction = replace(training_fit, rows=rows).fitted().reduced
        sliding = sliding_estimates(friction, samples.changed)
    formula_text = f"f = {formula.scaled(1e3, 1.0).text('eta')} (N, eta in mm)"
    estimate = ContactLawEstimate(
        contact=group.joined_contact.name,
        verdict=verdict_sentence(pieces, formula_text, tried_laws, best_tried, contact_record.sides_known, sliding),
        best=best_tried.law,
        fits=best_tried.fits,
        formula=formula_text,
        knees_m=tuple(float(k) for k in knees_m),
        slopes_n_per_m=mean_slopes_n_per_m(formula, knees_m, low_m, high_m),
        fitted_knees_m=_estimates(pieces.knees_m, pieces.knee_errors_m),
        fitted_slopes_n_per_m=_estimates(pieces.slopes_n_per_m, pieces.slope_errors_n_per_m),
        sliding=sliding,
        candidates=tried_laws,
        force_rms_n=float(np.std(record.force_n[samples.excited_rows])),
        hysteresis_share=hysteresis_share(record, pieces, samples.held_out_rows),
        sides_known=contact_record.sides_known,
        points=formula_fit.searched_eta_m.size,
        repeatable=not formula_fit.out_of_time,
    )
    time_s = contacts.separation.motion.time_s(record.force_n.size, contact_record.decimation)
    return ContactLawFit(
        result=estimate,
        searched_eta_m=formula_fit.searched_eta_m,
        searched_force_n=formula_fit.searched_force_n,
        formula=formula,
        pieces=pieces,
        sliding=None if friction is None else friction.law,
        record=record,
        time_s=time_s,
    )


def _friction_fits(samples: _ContactSamples, max_refined_error_n: float) -> dict[str, FrictionFit]:
    """Friction by its name: reached by a spring, or what of its parts is left; and growing with speed."""
    by_spring, by_speed = (
        fitted_friction(samples.record, samples.training_rows, by_speed, max_refined_error_n)
        for by_speed in (False, True)
    )
    fits = {SLIDING if Part.FRICTION in by_spring.parts else LINEAR: by_spring}
    return fits | ({SMOOTH_SLIDING: by_speed} if Part.REVERSAL in by_speed.parts else {})


def _with_contact_errors(pieces: PiecewiseLinear, estimates: Sequence[JointEstimate]) -> PiecewiseLinear:
    """Straight pieces with what the intervals of the contact's joint estimates hold beside scatter.

    A knee has that of the clearance on its side, a slope that of the stiffness, in relation to it; of several contacts
    the largest.
    """
    knee_errors_m, slope_shares = [np.zeros_like(pieces.knees_m)], [0.0]
    for estimate in estimates:
        lasting_covariance = estimate.covariance - estimate.covariances["scatter"]
        lower_error_m, upper_error_m, stiffness_error, _ = np.sqrt(np.diag(lasting_covariance))
        knee_errors_m.append(np.where(pieces.knees_m < 0, lower_error_m, upper_error_m))
        slope_shares.append(float(stiffness_error / estimate.stiffness_n_per_m))
    return replace(
        pieces,
        knee_errors_m=np.hypot(pieces.knee_errors_m, np.max(knee_errors_m, axis=0)),
        slope_errors_n_per_m=np.hypot(pieces.slope_errors_n_per_m, max(slope_shares) * pieces.slopes_n_per_m),
    )


def _contact_samples(contacts: AcceptedContacts, group: ContactGroup, contact_record: ContactRecord) -> _ContactSamples:
    """Samples of a contact, split into training and held-out rows.

    Of several contacts between the same places the estimated damping is subtracted: it would hide the knee of a soft
    stop before a hard one.

    Raises RigError if too little of the record is excited.
    """
    separation, estimate_by_name = contacts.separation, contacts.outcomes.estimates
    contact_names = [separation.rig.contacts[i].name for i in group.contact_indices]
    estimates = tuple(
        estimate_by_name[name] if sign > 0 else estimate_by_name[name].reversed
        for sign, name in zip(group.signs, contact_names, strict=True)
        if name in estimate_by_name
    )
    record = _samples_with_drift(contact_record, estimates[:1])
    if len(estimates) > 1:
        damping_n = record.low_passed(partial(_damping_force_n, estimates), record.velocity_m_per_s)
        record = replace(record, force_n=record.force_n - damping_n)
    start = separation.motion.excited_from // contact_record.decimation + EDGE_SAMPLE_COUNT
    stop = record.force_n.size - EDGE_SAMPLE_COUNT
    if stop - start < MIN_SAMPLE_COUNT:
        words = record_length_words((start + MIN_SAMPLE_COUNT + EDGE_SAMPLE_COUNT) / max(record.force_n.size, 1))
        raise RigError(
            f"the excited part of the record holds {max(stop - start, 0)} samples of the contact force; record {words}"
        )
    middle = (start + stop) // 2
    return _ContactSamples(record, contact_record, estimates, slice(start, middle), slice(middle, stop))


def _search_formula(samples: _ContactSamples, search_s: float, seed: int) -> _FormulaFit:
    """Simplest formula whose error equals the least, searched on samples spread evenly over eta."""
    record, training_rows = samples.record, samples.training_rows
    eta_m, force_n = record.eta_at_force_m[training_rows], force_without_low_pass(record, training_rows)
    chosen_indices = _evenly_spread_indices(eta_m, np.random.default_rng(seed))
    eta_m, force_n = eta_m[chosen_indices], force_n[chosen_indices]
    eta_unit_m, force_unit_n = float(np.abs(eta_m).max()), float(np.abs(force_n).max())
    formula_search = search(eta_m / eta_unit_m, force_n / force_unit_n, search_s, seed)
    formulas = [candidate.scaled(eta_unit_m, force_unit_n) for candidate in formula_search.formulas]
    training_errors_n = [record.error_n(candidate, training_rows) for candidate in formulas]
    formula = formulas[_simplest_equivalent_index(training_errors_n, samples.error_resolution_n)]
    return _FormulaFit(formula, min(training_errors_n), eta_m, force_n, formula_search.out_of_time)


def _fit_straight_pieces(
    samples: _ContactSamples, formula_fit: _FormulaFit, knees_m: Float[np.ndarray, " knees"]
) -> PiecewiseLinear:
    """Best straight pieces of several starts: the formula's knees; evenly spaced ones where those fit worse than the
    best formula; the stops of the joint estimates where these are several."""
    record, rows = samples.record, samples.training_rows
    low_m, high_m = float(formula_fit.searched_eta_m.min()), float(formula_fit.searched_eta_m.max())
    piecewise_laws = [fitted_piecewise_linear(record, rows, knees_m)]
    max_good_error_n = EQUAL_ERROR_RATIO * formula_fit.least_error_n + samples.error_resolution_n
    if record.error_n(piecewise_laws[0], rows) > max_good_error_n:
        piecewise_laws.append(
            fitted_piecewise_linear(record, rows, np.linspace(low_m, high_m, FALLBACK_KNEE_COUNT + 2)[1:-1])
        )
    if len(samples.estimates) > 1:  # soft stops before a hard one
        stops_m = np.array(
            [side_sign * estimate.values[k] for estimate in samples.estimates for k, side_sign in ((0, -1), (1, 1))]
        )
        piecewise_laws.append(fitted_piecewise_linear(record, rows, stops_m[(stops_m > low_m) & (stops_m < high_m)]))
    return min(piecewise_laws, key=lambda law: record.error_n(law, rows))


def _samples_with_drift(record: ContactRecord, estimates: tuple[JointEstimate, ...]) -> ForceSamples:
    """Force and relative displacement with the estimated drift added."""
    eta_m, force_n, velocity_m_per_s = record.eta_m, record.force_n, record.velocity_m_per_s
    for estimate in estimates if record.drift is not None else ():
        eta_m, velocity_m_per_s = eta_m + estimate.drift_m, velocity_m_per_s + estimate.drift_m_per_s
        force_n = force_n - record.spring_n_per_m * record.at_force_samples(estimate.drift_m)
    return ForceSamples(eta_m, velocity_m_per_s, force_n, record.sample_rate_hz, record.decimation)


def _damping_force_n(estimates: Sequence[JointEstimate], eta_m: Signal, rate_m_per_s: Signal) -> Signal:
    """Part of the force of joint estimates that vanishes at rest."""
    zero_rate = np.zeros_like(rate_m_per_s)
    forces_n = [estimate.force_n(eta_m, rate_m_per_s) - estimate.force_n(eta_m, zero_rate) for estimate in estimates]
    return np.asarray(np.sum(forces_n, axis=0))


def _evenly_spread_indices(eta_m: Float[np.ndarray, " samples"], rng: np.random.Generator) -> np.ndarray:
    """Indices of at most `SEARCH_POINT_COUNT` samples, drawn evenly from the cells of the range of eta."""
    sample_cell = np.minimum((ETA_CELL_COUNT * (eta_m - eta_m.min()) / np.ptp(eta_m)).astype(int), ETA_CELL_COUNT - 1)
    shuffled_indices = rng.permutation(eta_m.size)
    by_cell = shuffled_indices[np.argsort(sample_cell[shuffled_indices], kind="stable")]
    indices_by_cell = np.split(by_cell, np.searchsorted(sample_cell[by_cell], np.arange(1, ETA_CELL_COUNT)))
    return np.sort(np.concatenate([indices[: SEARCH_POINT_COUNT // ETA_CELL_COUNT] for indices in indices_by_cell]))


def _simplest_equivalent_index(errors_n: list[float], resolution_n: float) -> int:
    """Index of the first, and so the simplest, law whose error equals the least."""
    least_error_n = min(errors_n)
    return next(i for i, error_n in enumerate(errors_n) if error_n <= EQUAL_ERROR_RATIO * least_error_n + resolution_n)


def _estimates(values: Float[np.ndarray, " n"], standard_errors: Float[np.ndarray, " n"]) -> tuple[Estimate, ...]:
    return tuple(Estimate(float(v), float(e)) for v, e in zip(values, standard_errors, strict=True))
