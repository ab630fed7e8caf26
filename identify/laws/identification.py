"""Identification of contact laws without assuming one: symbolic regression of the separated force."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.contacts.acceptance import AcceptedContacts, checked_contacts
from identify.contacts.contact_record import ContactRecord
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import LawForm
from identify.contacts.refusals import Refusal
from identify.contacts.results import Estimate, unanswered
from identify.laws.fitted_laws import (
    ERROR_RESOLUTION,
    ForceSamples,
    PiecewiseLinear,
    Signal,
    SlidingFriction,
    force_without_low_pass,
    hysteresis_share,
    mean_slopes,
    polynomial,
    sliding_friction,
    slope_jumps,
    straight_pieces,
)
from identify.laws.results import (
    CUBIC,
    DEAD_ZONE,
    FORMULA,
    PIECEWISE,
    SLIDING,
    ContactLawEstimate,
    LawReport,
    TriedLaw,
    sliding_estimates,
    verdict_sentence,
)
from identify.laws.symbolic import Formula, pyoperon, search
from identify.linear.joined import ContactGroup
from identify.signals.kinematics import MotionQuantity
from rig.errors import RigError
from rig.model.tolerances import Tolerances
from rig.recording import Recording

POINT_COUNT = 4000
CELL_COUNT = 100
FALLBACK_KNEE_COUNT = 4
"""Count of evenly spaced knees from which straight pieces start where those of the formula fit badly."""
EDGE_SAMPLE_COUNT = 64
"""Samples of the force at either end of the record that the low-pass falsifies."""
MIN_SAMPLE_COUNT = 500
EQUAL_ERROR_RATIO = 1.05
"""An error counts as equal to the smallest up to this multiple of it."""


@dataclass(frozen=True)
class ContactLawFit:
    """Law of one contact with the points that the formula was searched on, and the record for figures.

    sliding is None unless friction is the best law.
    """

    result: ContactLawEstimate
    eta_m: Float[np.ndarray, " points"]
    force_n: Float[np.ndarray, " points"]
    formula: Formula
    pieces: PiecewiseLinear
    sliding: SlidingFriction | None
    record: ForceSamples
    time_s: Float[np.ndarray, " samples"]
    """Times of the force's samples."""

    @property
    def plotted_law(self) -> str:
        """Name of the law that is drawn over time."""
        return SLIDING if self.sliding else "straight pieces"

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
    contact_names = [contact.name for contact in recording.rig.contacts]
    if contact is not None and contact not in contact_names:
        raise RigError(f"no contact {contact!r} in the recording; there are {', '.join(contact_names)}")
    pyoperon()  # raises before the long computation if it is missing
    contacts = checked_contacts(recording, use, tolerances)
    progress(0.1)
    separation, refusals = contacts.separation, contacts.outcomes.refusals
    groups_and_records = zip(separation.contact_groups, separation.records, strict=True)
    chosen = [
        (contact_group, contact_record)
        for contact_group, contact_record in groups_and_records
        if contact in (None, *(contact_names[contact_index] for contact_index in contact_group.contact_indices))
    ]
    laws: list[ContactLawFit] = []
    refusal_by_name: dict[str, Refusal] = {}
    for number, (contact_group, contact_record) in enumerate(chosen, start=1):
        member_names = [contact_names[contact_index] for contact_index in contact_group.contact_indices]
        if set(member_names) <= refusals.keys() and (
            contact_record.drift is not None or not np.ptp(contact_record.eta_m)
        ):
            refusal_by_name |= {name: refusals[name] for name in member_names}
        else:
            laws.append(_identify_contact(contacts, contact_group, contact_record, seconds / len(chosen), seed))
        progress(0.1 + 0.9 * number / len(chosen))
    report = LawReport(
        rig=recording.rig.name,
        laws=tuple(law.result for law in laws),
        unanswered=unanswered(refusal_by_name),
        findings=contacts.findings,
    )
    return Laws(report, tuple(laws))


@dataclass(frozen=True)
class _ContactSamples:
    """Force and complete relative displacement of a contact, with its joint estimates.

    Laws are fitted to the rows `training_rows`, the first half of the excited ones, and compared on `held_out_rows`,
    the second; the best is fitted again to all `excited_rows`.
    """

    record: ForceSamples
    velocity_m_per_s: Float[np.ndarray, " more"]
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
    def law_values(self) -> Float[np.ndarray, " laws"]:
        """Values of the laws of all joint estimates, end to end."""
        return np.array([estimate.values for estimate in self.estimates]).ravel()


@dataclass(frozen=True)
class _FormulaFit:
    """Formula with the points that it was searched on, and the least error (N) of all formulas of the search."""

    formula: Formula
    least_error_n: float
    eta_m: Float[np.ndarray, " points"]
    force_n: Float[np.ndarray, " points"]
    out_of_time: bool


def _identify_contact(
    contacts: AcceptedContacts, contact_group: ContactGroup, contact_record: ContactRecord, search_s: float, seed: int
) -> ContactLawFit:
    """Law of one contact: formula, straight pieces, friction and cubic, compared on the held-out half."""
    samples = _contact_samples(contacts, contact_group, contact_record)
    force_samples, error_resolution_n = samples.record, samples.error_resolution_n
    formula_fit = _search_formula(samples, search_s, seed)
    formula, low_m, high_m = formula_fit.formula, float(formula_fit.eta_m.min()), float(formula_fit.eta_m.max())
    knees_m = slope_jumps(formula, low_m, high_m)
    pieces = _fit_straight_pieces(samples, formula_fit, knees_m)
    candidate_laws: dict[str, Callable[[np.ndarray], np.ndarray]] = {PIECEWISE: pieces}
    if samples.estimates:
        candidate_laws[DEAD_ZONE] = lambda eta_m: LawForm().force_n(samples.law_values, eta_m, np.zeros_like(eta_m))
    candidate_laws[SLIDING] = sliding_friction(force_samples, samples.training_rows)
    candidate_laws |= {CUBIC: polynomial(force_samples, samples.training_rows, 3), FORMULA: formula}
    candidates = tuple(
        TriedLaw(name, force_samples.error_n(law, samples.held_out_rows)) for name, law in candidate_laws.items()
    )
    errors_n = [candidate.held_out_error_n for candidate in candidates]
    best_law = candidates[_simplest_equivalent_index(errors_n, error_resolution_n)]
    # the final fit takes all excited rows
    pieces = straight_pieces(force_samples, samples.excited_rows, pieces.knees_m)
    friction = sliding_friction(force_samples, samples.excited_rows) if best_law.law == SLIDING else None
    formula_text = f"f = {formula.scaled(1e3, 1.0).text('eta')} (N, eta in mm)"
    law_estimate = ContactLawEstimate(
        contact=contact_group.contact.name,
        verdict=verdict_sentence(pieces, formula_text, candidates, best_law, contact_record.sides_known, friction),
        best=best_law.law,
        formula=formula_text,
        knees_m=tuple(float(k) for k in knees_m),
        slopes_n_per_m=mean_slopes(formula, knees_m, low_m, high_m),
        fitted_knees_m=_estimates(pieces.knees_m, pieces.knee_errors_m),
        fitted_slopes_n_per_m=_estimates(pieces.slopes_n_per_m, pieces.slope_errors_n_per_m),
        sliding=None if friction is None else sliding_estimates(friction),
        candidates=candidates,
        force_rms_n=float(np.std(force_samples.force_n[samples.excited_rows])),
        hysteresis_share=hysteresis_share(force_samples, samples.velocity_m_per_s, pieces, samples.held_out_rows),
        sides_known=contact_record.sides_known,
        points=formula_fit.eta_m.size,
        repeatable=not formula_fit.out_of_time,
    )
    time_s = contacts.separation.motion.time_s(force_samples.force_n.size, contact_record.decimation)
    return ContactLawFit(
        law_estimate, formula_fit.eta_m, formula_fit.force_n, formula, pieces, friction, force_samples, time_s
    )


def _contact_samples(
    contacts: AcceptedContacts, contact_group: ContactGroup, contact_record: ContactRecord
) -> _ContactSamples:
    """Samples of a contact, split into training and held-out rows.

    Of several contacts between the same places the estimated damping is subtracted: it would hide the knee of a soft
    stop before a hard one.

    Raises RigError if too little of the record is excited.
    """
    separation, estimates_by_name = contacts.separation, contacts.outcomes.estimates
    member_names = [separation.rig.contacts[contact_index].name for contact_index in contact_group.contact_indices]
    estimates = tuple(
        estimates_by_name[name] if sign > 0 else estimates_by_name[name].reversed
        for sign, name in zip(contact_group.signs, member_names, strict=True)
        if name in estimates_by_name
    )
    force_samples, velocity_m_per_s = _add_drift(contact_record, estimates[:1])
    if len(estimates) > 1:
        damping_n = force_samples.low_passed(partial(_damping_force_n, estimates), velocity_m_per_s)
        force_samples = replace(force_samples, force_n=force_samples.force_n - damping_n)
    first_row = separation.motion.excited_from // contact_record.decimation + EDGE_SAMPLE_COUNT
    stop_row = force_samples.force_n.size - EDGE_SAMPLE_COUNT
    if stop_row - first_row < MIN_SAMPLE_COUNT:
        raise RigError(
            f"the excited part of the record holds {max(stop_row - first_row, 0)} samples of the contact force; "
            "record longer"
        )
    middle_row = (first_row + stop_row) // 2
    return _ContactSamples(
        force_samples, velocity_m_per_s, estimates, slice(first_row, middle_row), slice(middle_row, stop_row)
    )


def _search_formula(samples: _ContactSamples, search_s: float, seed: int) -> _FormulaFit:
    """Simplest formula whose error equals the least, searched on samples spread evenly over eta."""
    force_samples, training_rows = samples.record, samples.training_rows
    eta_m, force_n = force_samples.eta_at_force_m[training_rows], force_without_low_pass(force_samples, training_rows)
    chosen_indices = _evenly_spread_indices(eta_m, np.random.default_rng(seed))
    eta_m, force_n = eta_m[chosen_indices], force_n[chosen_indices]
    eta_unit_m, force_unit_n = float(np.abs(eta_m).max()), float(np.abs(force_n).max())
    formula_search = search(eta_m / eta_unit_m, force_n / force_unit_n, search_s, seed)
    formulas = [candidate.scaled(eta_unit_m, force_unit_n) for candidate in formula_search.formulas]
    errors_n = [force_samples.error_n(candidate, training_rows) for candidate in formulas]
    formula = formulas[_simplest_equivalent_index(errors_n, samples.error_resolution_n)]
    return _FormulaFit(formula, min(errors_n), eta_m, force_n, formula_search.out_of_time)


def _fit_straight_pieces(
    samples: _ContactSamples, formula_fit: _FormulaFit, knees_m: Float[np.ndarray, " knees"]
) -> PiecewiseLinear:
    """Best straight pieces of several starts: the formula's knees; evenly spaced ones where those fit worse than the
    best formula; the stops of the joint estimates where these are several."""
    force_samples, training_rows = samples.record, samples.training_rows
    low_m, high_m = float(formula_fit.eta_m.min()), float(formula_fit.eta_m.max())
    candidate_laws = [straight_pieces(force_samples, training_rows, knees_m)]
    if (
        force_samples.error_n(candidate_laws[0], training_rows)
        > EQUAL_ERROR_RATIO * formula_fit.least_error_n + samples.error_resolution_n
    ):
        candidate_laws.append(
            straight_pieces(force_samples, training_rows, np.linspace(low_m, high_m, FALLBACK_KNEE_COUNT + 2)[1:-1])
        )
    if len(samples.estimates) > 1:  # soft stops before a hard one
        stops_m = np.array(
            [side * estimate.values[k] for estimate in samples.estimates for k, side in enumerate((-1, 1))]
        )
        candidate_laws.append(
            straight_pieces(force_samples, training_rows, stops_m[(stops_m > low_m) & (stops_m < high_m)])
        )
    return min(candidate_laws, key=lambda law: force_samples.error_n(law, training_rows))


def _add_drift(
    contact_record: ContactRecord, estimates: tuple[JointEstimate, ...]
) -> tuple[ForceSamples, Float[np.ndarray, " more"]]:
    """Force and relative displacement with the estimated drift added, and the relative velocity (m/s)."""
    eta_m, force_n, velocity_m_per_s = contact_record.eta_m, contact_record.force_n, contact_record.velocity_m_per_s
    for estimate in estimates if contact_record.drift is not None else ():
        eta_m, velocity_m_per_s = eta_m + estimate.drift_m, velocity_m_per_s + estimate.drift_m_per_s
        force_n = force_n - contact_record.spring_n_per_m * contact_record.at_force_samples(estimate.drift_m)
    return ForceSamples(eta_m, force_n, contact_record.sample_rate_hz, contact_record.decimation), velocity_m_per_s


def _damping_force_n(estimates: Sequence[JointEstimate], eta_m: Signal, rate_m_per_s: Signal) -> Signal:
    """Part of the force of joint estimates that vanishes at rest."""
    at_rest = np.zeros_like(rate_m_per_s)
    damping_forces_n = [
        estimate.force_n(eta_m, rate_m_per_s) - estimate.force_n(eta_m, at_rest) for estimate in estimates
    ]
    return np.asarray(np.sum(damping_forces_n, axis=0))


def _evenly_spread_indices(eta_m: Float[np.ndarray, " samples"], rng: np.random.Generator) -> np.ndarray:
    """Indices of at most `POINT_COUNT` samples, drawn evenly from the `CELL_COUNT` cells of the range of eta."""
    cell_of_sample = np.minimum((CELL_COUNT * (eta_m - eta_m.min()) / np.ptp(eta_m)).astype(int), CELL_COUNT - 1)
    shuffled_indices = rng.permutation(eta_m.size)
    indices_by_cell = shuffled_indices[np.argsort(cell_of_sample[shuffled_indices], kind="stable")]
    cell_starts = np.searchsorted(cell_of_sample[indices_by_cell], np.arange(1, CELL_COUNT))
    return np.sort(
        np.concatenate([indices[: POINT_COUNT // CELL_COUNT] for indices in np.split(indices_by_cell, cell_starts)])
    )


def _simplest_equivalent_index(errors_n: list[float], resolution_n: float) -> int:
    """Index of the first, and so the simplest, law whose error equals the least."""
    least_error_n = min(errors_n)
    return next(i for i, error_n in enumerate(errors_n) if error_n <= EQUAL_ERROR_RATIO * least_error_n + resolution_n)


def _estimates(values: Float[np.ndarray, " n"], standard_errors: Float[np.ndarray, " n"]) -> tuple[Estimate, ...]:
    return tuple(Estimate(float(v), float(e)) for v, e in zip(values, standard_errors, strict=True))
