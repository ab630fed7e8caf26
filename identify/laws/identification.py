"""Identification of contact laws without assuming one: symbolic regression of the separated force."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.contacts.acceptance import Contacts, checked_contacts
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
from identify.linear.joined import Joined
from identify.signals.kinematics import Use
from rig.errors import RigError
from rig.model.tolerances import Tolerances
from rig.recording import Recording

POINTS = 4000
CELLS = 100
FALLBACK_KNEES = 4
"""Count of evenly spaced knees from which straight pieces start where those of the formula fit badly."""
EDGE_SAMPLES = 64
"""Samples of the force at either end of the record that the low-pass falsifies."""
LEAST_SAMPLES = 500
EQUIVALENT_RATIO = 1.05
"""An error counts as equal to the smallest up to this multiple of it."""


@dataclass(frozen=True)
class FoundLaw:
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
    found: tuple[FoundLaw, ...]


def identify_law(
    recording: Recording,
    *,
    contact: str | None = None,
    use: Use = "auto",
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
    contacts = checked_contacts(recording, use, tolerances)
    progress(0.1)
    separation, refusals = contacts.separation, contacts.outcomes.refusals
    places = zip(separation.same_place, separation.records, strict=True)
    chosen = [
        (place, contact_record)
        for place, contact_record in places
        if contact in (None, *(names[j] for j in place.members))
    ]
    laws: list[FoundLaw] = []
    refused: dict[str, Refusal] = {}
    for count, (place, contact_record) in enumerate(chosen, start=1):
        members = [names[j] for j in place.members]
        if set(members) <= refusals.keys() and (contact_record.drift is not None or not np.ptp(contact_record.eta_m)):
            refused |= {name: refusals[name] for name in members}
        else:
            laws.append(_identify_contact(contacts, place, contact_record, seconds / len(chosen), seed))
        progress(0.1 + 0.9 * count / len(chosen))
    report = LawReport(
        rig=recording.rig.name,
        laws=tuple(law.result for law in laws),
        unanswered=unanswered(refused),
        findings=contacts.findings,
    )
    return Laws(report, tuple(laws))


@dataclass(frozen=True)
class _Samples:
    """Force and complete relative displacement of a contact, with its joint estimates.

    Laws are fitted to the rows `training`, the first half of the excited ones, and compared on `held_out`, the second;
    the best is fitted again to all `excited` rows.
    """

    record: ForceSamples
    velocity_m_per_s: Float[np.ndarray, " more"]
    estimates: tuple[JointEstimate, ...]
    training: slice
    held_out: slice

    @property
    def excited(self) -> slice:
        return slice(self.training.start, self.held_out.stop)

    @property
    def error_resolution_n(self) -> float:
        """Difference below which errors count as equal, N."""
        return ERROR_RESOLUTION * float(np.std(self.record.force_n[self.excited]))

    @property
    def values(self) -> Float[np.ndarray, " laws"]:
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
    contacts: Contacts, place: Joined, contact_record: ContactRecord, seconds: float, seed: int
) -> FoundLaw:
    """Law of one contact: formula, straight pieces, friction and cubic, compared on the held-out half."""
    samples = _samples(contacts, place, contact_record)
    record, resolution_n = samples.record, samples.error_resolution_n
    formula_fit = _search_formula(samples, seconds, seed)
    formula, low, high = formula_fit.formula, float(formula_fit.eta_m.min()), float(formula_fit.eta_m.max())
    knees = slope_jumps(formula, low, high)
    pieces = _fit_straight_pieces(samples, formula_fit, knees)
    candidate_laws: dict[str, Callable[[np.ndarray], np.ndarray]] = {PIECEWISE: pieces}
    if samples.estimates:
        candidate_laws[DEAD_ZONE] = lambda eta_m: LawForm().force_n(samples.values, eta_m, np.zeros_like(eta_m))
    candidate_laws[SLIDING] = sliding_friction(record, samples.training)
    candidate_laws |= {CUBIC: polynomial(record, samples.training, 3), FORMULA: formula}
    candidates = tuple(TriedLaw(name, record.error_n(law, samples.held_out)) for name, law in candidate_laws.items())
    best = candidates[_simplest_equivalent([c.held_out_error_n for c in candidates], resolution_n)]
    pieces = straight_pieces(record, samples.excited, pieces.knees_m)  # the final fit takes all excited rows
    sliding = sliding_friction(record, samples.excited) if best.law == SLIDING else None
    formula_text = f"f = {formula.scaled(1e3, 1.0).text('eta')} (N, eta in mm)"
    result = ContactLawEstimate(
        contact=place.contact.name,
        verdict=verdict_sentence(pieces, formula_text, candidates, best, contact_record.sides_known, sliding),
        best=best.law,
        formula=formula_text,
        knees_m=tuple(float(k) for k in knees),
        slopes_n_per_m=mean_slopes(formula, knees, low, high),
        fitted_knees_m=_estimates(pieces.knees_m, pieces.knee_errors_m),
        fitted_slopes_n_per_m=_estimates(pieces.slopes_n_per_m, pieces.slope_errors_n_per_m),
        sliding=None if sliding is None else sliding_estimates(sliding),
        candidates=candidates,
        force_rms_n=float(np.std(record.force_n[samples.excited])),
        hysteresis_share=hysteresis_share(record, samples.velocity_m_per_s, pieces, samples.held_out),
        sides_known=contact_record.sides_known,
        points=formula_fit.eta_m.size,
        repeatable=not formula_fit.out_of_time,
    )
    time_s = contacts.separation.motion.time_s(record.force_n.size, contact_record.factor)
    return FoundLaw(result, formula_fit.eta_m, formula_fit.force_n, formula, pieces, sliding, record, time_s)


def _samples(contacts: Contacts, place: Joined, contact_record: ContactRecord) -> _Samples:
    """Samples of a contact, split into training and held-out rows.

    Of several contacts between the same places the estimated damping is subtracted: it would hide the knee of a soft
    stop before a hard one.

    Raises RigError if too little of the record is excited.
    """
    separation, estimates_by_name = contacts.separation, contacts.outcomes.estimates
    signed = zip(place.signs, (separation.rig.contacts[j].name for j in place.members), strict=True)
    estimates = tuple(
        estimates_by_name[name] if sign > 0 else estimates_by_name[name].reversed
        for sign, name in signed
        if name in estimates_by_name
    )
    record, velocity = _drift_corrected(contact_record, estimates[:1])
    if len(estimates) > 1:
        damping_n = record.low_passed(partial(_damping_force_n, estimates), velocity)
        record = replace(record, force_n=record.force_n - damping_n)
    first = separation.motion.excited_from // contact_record.factor + EDGE_SAMPLES
    last = record.force_n.size - EDGE_SAMPLES
    if last - first < LEAST_SAMPLES:
        raise RigError(
            f"the excited part of the record holds {max(last - first, 0)} samples of the contact force; record longer"
        )
    middle = (first + last) // 2
    return _Samples(record, velocity, estimates, slice(first, middle), slice(middle, last))


def _search_formula(samples: _Samples, seconds: float, seed: int) -> _FormulaFit:
    """Simplest formula whose error equals the least, searched on samples spread evenly over eta."""
    record, training = samples.record, samples.training
    eta, force = record.eta_at_force_m[training], force_without_low_pass(record, training)
    chosen = _evenly_spread(eta, np.random.default_rng(seed))
    eta, force = eta[chosen], force[chosen]
    eta_unit, force_unit = float(np.abs(eta).max()), float(np.abs(force).max())
    formula_search = search(eta / eta_unit, force / force_unit, seconds, seed)
    formulas = [candidate.scaled(eta_unit, force_unit) for candidate in formula_search.formulas]
    errors = [record.error_n(candidate, training) for candidate in formulas]
    formula = formulas[_simplest_equivalent(errors, samples.error_resolution_n)]
    return _FormulaFit(formula, min(errors), eta, force, formula_search.out_of_time)


def _fit_straight_pieces(
    samples: _Samples, formula_fit: _FormulaFit, knees: Float[np.ndarray, " knees"]
) -> PiecewiseLinear:
    """Best straight pieces of several starts: the formula's knees; evenly spaced ones where those fit worse than the
    best formula; the stops of the joint estimates where these are several."""
    record, training = samples.record, samples.training
    low, high = float(formula_fit.eta_m.min()), float(formula_fit.eta_m.max())
    candidates = [straight_pieces(record, training, knees)]
    if (
        record.error_n(candidates[0], training)
        > EQUIVALENT_RATIO * formula_fit.least_error_n + samples.error_resolution_n
    ):
        candidates.append(straight_pieces(record, training, np.linspace(low, high, FALLBACK_KNEES + 2)[1:-1]))
    if len(samples.estimates) > 1:  # soft stops before a hard one
        stops = np.array(
            [side * estimate.values[k] for estimate in samples.estimates for k, side in enumerate((-1, 1))]
        )
        candidates.append(straight_pieces(record, training, stops[(stops > low) & (stops < high)]))
    return min(candidates, key=lambda law: record.error_n(law, training))


def _drift_corrected(
    contact_record: ContactRecord, estimates: tuple[JointEstimate, ...]
) -> tuple[ForceSamples, Float[np.ndarray, " more"]]:
    """Force and relative displacement with the estimated drift added, and the relative velocity (m/s)."""
    eta, force, velocity = contact_record.eta_m, contact_record.force_n, contact_record.velocity_m_per_s
    for estimate in estimates if contact_record.drift is not None else ():
        eta, velocity = eta + estimate.drift_m, velocity + estimate.drift_m_per_s
        force = force - contact_record.spring_n_per_m * estimate.drift_m[:: contact_record.factor][: force.size]
    return ForceSamples(eta, force, contact_record.sample_rate_hz, contact_record.factor), velocity


def _damping_force_n(estimates: Sequence[JointEstimate], eta_m: Signal, rate_m_per_s: Signal) -> Signal:
    """Part of the force of joint estimates that vanishes at rest."""
    at_rest = np.zeros_like(rate_m_per_s)
    parts = [estimate.force_n(eta_m, rate_m_per_s) - estimate.force_n(eta_m, at_rest) for estimate in estimates]
    return np.asarray(np.sum(parts, axis=0))


def _evenly_spread(eta: Float[np.ndarray, " samples"], rng: np.random.Generator) -> np.ndarray:
    """Indices of at most `POINTS` samples, drawn evenly from the `CELLS` cells of the range of eta."""
    cell = np.minimum((CELLS * (eta - eta.min()) / np.ptp(eta)).astype(int), CELLS - 1)
    shuffled = rng.permutation(eta.size)
    ordered = shuffled[np.argsort(cell[shuffled], kind="stable")]
    starts = np.searchsorted(cell[ordered], np.arange(1, CELLS))
    return np.sort(np.concatenate([indices[: POINTS // CELLS] for indices in np.split(ordered, starts)]))


def _simplest_equivalent(errors: list[float], resolution: float) -> int:
    """Index of the first, and so the simplest, law whose error equals the least."""
    least = min(errors)
    return next(i for i, error in enumerate(errors) if error <= EQUIVALENT_RATIO * least + resolution)


def _estimates(values: Float[np.ndarray, " n"], errors: Float[np.ndarray, " n"]) -> tuple[Estimate, ...]:
    return tuple(Estimate(float(v), float(e)) for v, e in zip(values, errors, strict=True))
