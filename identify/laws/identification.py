"""The law of every contact found rather than assumed: symbolic regression of its force on its displacement."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.contacts.acceptance import Contacts, checked_contacts
from identify.contacts.contact_record import ContactRecord, Law
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import LawForm
from identify.contacts.refusals import Refusal
from identify.contacts.results import Estimate
from identify.contacts.summary import unanswered
from identify.laws.piecewise import FINEST, PiecewiseLinear, Sampled, Signal, polynomial, slope_jumps, straight_pieces
from identify.laws.piecewise import unfiltered as without_low_pass
from identify.laws.results import ContactLawEstimate, LawReport, SlidingLaw, TriedLaw
from identify.laws.sliding import SlidingFriction, sliding_friction
from identify.laws.symbolic import Formula, pyoperon, search
from identify.linear.joined import Joined
from identify.pages.wording import interval
from identify.signals.kinematics import Use
from rig.errors import RigError
from rig.model.tolerances import Tolerances
from rig.recording import Recording

POINTS = 4000
CELLS = 100
UNTOLD = 4
"""How many evenly spread knees straight pieces start from where those of the formula do not serve."""
ENDS = 64
"""Samples of the force at either end of the record that the low-pass falsifies."""
LEAST_SAMPLES = 500
AS_GOOD = 1.05
"""An error is no larger than another if it is at most this multiple of it."""
FLAT = 0.01
"""A piece counts as flat, the gap of a dead zone, if its slope is a smaller share of the steepest."""

PIECEWISE, FORMULA, DEAD_ZONE, CUBIC, SLIDING = (
    "piecewise-linear law",
    "formula found",
    "dead zone of the joint estimate",
    "cubic polynomial",
    "friction behind a backlash",
)


@dataclass(frozen=True)
class FoundLaw:
    """A contact's law with the points that the formula was searched on, for figures.

    sliding is there where it is the best law; record is the course of eta that it needs.
    """

    result: ContactLawEstimate
    eta_m: Float[np.ndarray, " points"]
    force_n: Float[np.ndarray, " points"]
    formula: Formula
    pieces: PiecewiseLinear
    sliding: SlidingFriction | None
    record: Sampled
    time_s: Float[np.ndarray, " samples"]
    """Of the force's samples."""

    @property
    def drawn(self) -> str:
        """The law that stands beside the force over time."""
        return SLIDING if self.sliding else "straight pieces"

    @property
    def drawn_n(self) -> Float[np.ndarray, " samples"]:
        """Its force, low-passed as the separated one is."""
        return self.record.low_passed(self.sliding or self.pieces)


@dataclass(frozen=True)
class Laws:
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
    """The law f(eta) of every contact, or of the named one, and how it stands against laws that one would assume. Of
    contacts between the same places it is that of their sum, without the damping that the joint estimate found.

    The force is separated without a law. The relative displacement is the measured one; where it comes from
    accelerations, with the slow drift that the joint estimate found, which has assumed a dead zone. `seconds` of search
    are shared by the contacts.

    Raises RigError if the record does not allow it, the contact is unknown, or pyoperon is not installed.
    """
    if not (np.isfinite(seconds) and seconds >= 1):
        raise RigError(f"seconds is {seconds}; give 1 or more")
    names = [c.name for c in recording.rig.contacts]
    if contact is not None and contact not in names:
        raise RigError(f"no contact {contact!r} in the recording; there are {', '.join(names)}")
    pyoperon()  # whose lack had better be known before the work
    contacts = checked_contacts(recording, use, tolerances)
    progress(0.1)
    separation, refusals = contacts.separation, contacts.outcomes.refusals
    pairs = zip(separation.same_place, separation.records, strict=True)
    chosen = [(place, one) for place, one in pairs if contact in (None, *(names[j] for j in place.members))]
    found: list[FoundLaw] = []
    silent: dict[str, Refusal] = {}
    for done, (place, one) in enumerate(chosen, start=1):
        members = [names[j] for j in place.members]
        if set(members) <= refusals.keys() and (one.drift is not None or not np.ptp(one.eta_m)):
            silent |= {name: refusals[name] for name in members}
        else:
            found.append(_law(contacts, place, one, seconds / len(chosen), seed))
        progress(0.1 + 0.9 * done / len(chosen))
    report = LawReport(
        rig=recording.rig.name,
        laws=tuple(law.result for law in found),
        unanswered=unanswered(silent),
        findings=contacts.findings,
    )
    return Laws(report, tuple(found))


@dataclass(frozen=True)
class _Samples:
    """A contact's force and complete relative displacement, its joint estimates, and the rows that laws are fitted to
    (the first half of what is excited), judged by (the other half), and fitted to once judged."""

    record: Sampled
    velocity_m_per_s: Float[np.ndarray, " more"]
    estimates: tuple[JointEstimate, ...]
    taught: slice
    held_out: slice

    @property
    def whole(self) -> slice:
        return slice(self.taught.start, self.held_out.stop)

    @property
    def finest_n(self) -> float:
        """Errors that differ by less are alike."""
        return FINEST * float(np.std(self.record.force_n[self.whole]))

    @property
    def values(self) -> Float[np.ndarray, " laws"]:
        """Values of the joint estimates' laws."""
        return np.array([estimate.values for estimate in self.estimates]).ravel()


@dataclass(frozen=True)
class _Searched:
    """The formula with the points that it was searched on."""

    formula: Formula
    least_error_n: float
    eta_m: Float[np.ndarray, " points"]
    force_n: Float[np.ndarray, " points"]
    out_of_time: bool


def _law(contacts: Contacts, place: Joined, seen: ContactRecord, seconds: float, seed: int) -> FoundLaw:
    samples = _samples(contacts, place, seen)
    record, finest = samples.record, samples.finest_n
    searched = _searched(samples, seconds, seed)
    formula, low, high = searched.formula, float(searched.eta_m.min()), float(searched.eta_m.max())
    knees = slope_jumps(formula, low, high)
    pieces = _straight(samples, searched, knees)
    laws: dict[str, Callable[[np.ndarray], np.ndarray]] = {PIECEWISE: pieces}
    if samples.estimates:
        laws[DEAD_ZONE] = lambda e: LawForm().force_n(samples.values, e, np.zeros_like(e))
    laws[SLIDING] = sliding_friction(record, samples.taught)
    laws |= {CUBIC: polynomial(record, samples.taught, 3), FORMULA: formula}
    candidates = tuple(TriedLaw(name, record.error_n(law, samples.held_out)) for name, law in laws.items())
    best = candidates[_first_as_good([c.held_out_error_n for c in candidates], finest)]
    pieces = straight_pieces(record, samples.whole, pieces.knees_m)  # once judged, from all there is
    sliding = sliding_friction(record, samples.whole) if best.law == SLIDING else None
    shown = f"f = {formula.scaled(1e3, 1.0).text('eta')} (N, eta in mm)"
    result = ContactLawEstimate(
        contact=place.contact.name,
        verdict=_verdict(pieces, shown, candidates, best, seen.sides_known, sliding),
        best=best.law,
        formula=shown,
        knees_m=tuple(float(k) for k in knees),
        slopes_n_per_m=_slopes(formula, knees, low, high),
        fitted_knees_m=_estimates(pieces.knees_m, pieces.knee_errors_m),
        fitted_slopes_n_per_m=_estimates(pieces.slopes_n_per_m, pieces.slope_errors_n_per_m),
        sliding=None if sliding is None else _sliding(sliding),
        candidates=candidates,
        force_rms_n=float(np.std(record.force_n[samples.whole])),
        hysteresis_share=_hysteresis(record, samples.velocity_m_per_s, pieces, samples.held_out),
        sides_known=seen.sides_known,
        points=searched.eta_m.size,
        repeatable=not searched.out_of_time,
    )
    time_s = contacts.separation.motion.time_s(record.force_n.size, seen.factor)
    return FoundLaw(result, searched.eta_m, searched.force_n, formula, pieces, sliding, record, time_s)


def _samples(contacts: Contacts, place: Joined, seen: ContactRecord) -> _Samples:
    """Samples of several contacts without their estimates' damping, which hides a soft stop's knee before a hard one.

    Raises RigError if too little of the record is excited.
    """
    separation, known = contacts.separation, contacts.outcomes.estimates
    signed = zip(place.signs, (separation.rig.contacts[j].name for j in place.members), strict=True)
    estimates = tuple(known[name] if sign > 0 else known[name].reversed for sign, name in signed if name in known)
    record, velocity = _complete(seen, estimates[:1])
    if len(estimates) > 1:
        values = np.array([estimate.values for estimate in estimates]).ravel()
        damped_n = record.low_passed(partial(_damping_force_n, values), velocity)
        record = replace(record, force_n=record.force_n - damped_n)
    first = separation.motion.excited_from // seen.factor + ENDS
    last = record.force_n.size - ENDS
    if last - first < LEAST_SAMPLES:
        raise RigError(
            f"the excited part of the record holds {max(last - first, 0)} samples of the contact force; record longer"
        )
    middle = (first + last) // 2
    return _Samples(record, velocity, estimates, slice(first, middle), slice(middle, last))


def _searched(samples: _Samples, seconds: float, seed: int) -> _Searched:
    """The plainest formula that leaves as little as the best."""
    record, taught = samples.record, samples.taught
    eta, force = record.at_force_m[taught], without_low_pass(record, taught)
    drawn = _evenly(eta, np.random.default_rng(seed))
    eta, force = eta[drawn], force[drawn]
    eta_unit, force_unit = float(np.abs(eta).max()), float(np.abs(force).max())
    searched = search(eta / eta_unit, force / force_unit, seconds, seed)
    formulas = [f.scaled(eta_unit, force_unit) for f in searched.formulas]
    errors = [record.error_n(f, taught) for f in formulas]
    formula = formulas[_first_as_good(errors, samples.finest_n)]
    return _Searched(formula, min(errors), eta, force, searched.out_of_time)


def _straight(samples: _Samples, searched: _Searched, knees: Float[np.ndarray, " knees"]) -> PiecewiseLinear:
    """Straight pieces from the knees of the formula; from others too, where those do not serve or stops are several."""
    record, taught = samples.record, samples.taught
    low, high = float(searched.eta_m.min()), float(searched.eta_m.max())
    tried = [straight_pieces(record, taught, knees)]
    if record.error_n(tried[0], taught) > AS_GOOD * searched.least_error_n + samples.finest_n:
        tried.append(straight_pieces(record, taught, np.linspace(low, high, UNTOLD + 2)[1:-1]))
    if len(samples.estimates) > 1:  # soft stops before a hard one
        stops = np.array([side * one.values[k] for one in samples.estimates for k, side in enumerate((-1, 1))])
        tried.append(straight_pieces(record, taught, stops[(stops > low) & (stops < high)]))
    return min(tried, key=lambda law: record.error_n(law, taught))


def _complete(seen: ContactRecord, estimates: tuple[JointEstimate, ...]) -> tuple[Sampled, Float[np.ndarray, " more"]]:
    """Force and relative displacement with the drift put right; the relative velocity (m/s)."""
    eta, force, velocity = seen.eta_m, seen.force_n, seen.velocity_m_per_s
    for estimate in estimates if seen.drift is not None else ():
        eta, velocity = eta + estimate.drift_m, velocity + estimate.drift_m_per_s
        force = force - seen.spring_n_per_m * estimate.drift_m[:: seen.factor][: force.size]
    return Sampled(eta, force, seen.sample_rate_hz, seen.factor), velocity


def _damping_force_n(law: Law, eta_m: Signal, rate_m_per_s: Signal) -> Signal:
    form = LawForm()
    return form.force_n(law, eta_m, rate_m_per_s) - form.force_n(law, eta_m, np.zeros_like(rate_m_per_s))


def _evenly(eta: Float[np.ndarray, " samples"], rng: np.random.Generator) -> np.ndarray:
    """Indices of at most 4000 samples, as many from each hundredth of the range of eta as there are, up to 40."""
    cell = np.minimum((CELLS * (eta - eta.min()) / np.ptp(eta)).astype(int), CELLS - 1)
    shuffled = rng.permutation(eta.size)
    ordered = shuffled[np.argsort(cell[shuffled], kind="stable")]
    starts = np.searchsorted(cell[ordered], np.arange(1, CELLS))
    return np.sort(np.concatenate([part[: POINTS // CELLS] for part in np.split(ordered, starts)]))


def _first_as_good(errors: list[float], finest: float) -> int:
    """The first, and so the plainest, whose error is as small as the least."""
    least = min(errors)
    return next(i for i, error in enumerate(errors) if error <= AS_GOOD * least + finest)


def _slopes(formula: Formula, knees: Float[np.ndarray, " knees"], low: float, high: float) -> tuple[float, ...]:
    """The mean slope of each piece, clear of the knees."""
    ends = np.concatenate([[low], knees, [high]])
    margin = 0.1 * np.diff(ends)
    left, right = ends[:-1] + margin, ends[1:] - margin
    return tuple(float(s) for s in (formula(right) - formula(left)) / (right - left))


def _estimates(values: Float[np.ndarray, " n"], errors: Float[np.ndarray, " n"]) -> tuple[Estimate, ...]:
    return tuple(Estimate(float(v), float(e)) for v, e in zip(values, errors, strict=True))


def _hysteresis(record: Sampled, velocity: Float[np.ndarray, " more"], law: PiecewiseLinear, rows: slice) -> float:
    """The share of the variance left that a damper explains which acts in proportion to the law's local slope."""
    slopes = np.abs(law.slopes_n_per_m)

    def by_slope(eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        return slopes[np.searchsorted(law.knees_m, eta_m)] / slopes.max() * rate_m_per_s

    damper = record.low_passed(by_slope, velocity)[rows]
    left = (record.force_n - record.low_passed(law))[rows]
    return float((damper @ left) ** 2 / ((damper @ damper) * (left @ left)))


def _verdict(
    pieces: PiecewiseLinear,
    formula: str,
    candidates: tuple[TriedLaw, ...],
    best: TriedLaw,
    sides_known: bool,
    sliding: SlidingFriction | None,
) -> str:
    """One sentence."""
    if sliding is not None:
        one, found = best.held_out_error_n, _sliding(sliding)
        return (
            f"friction behind a backlash: it slides at {_within(found.upper_n, 'N')} one way and at "
            f"{_within(found.lower_n, 'N')} the other, behind a backlash of {_within(found.backlash_m, 'mm', 1e3)} and "
            f"a stiffness of {_within(found.stiffness_n_per_m, 'N/m')} (95 % intervals of the scatter); it leaves "
            f"{one:.3g} N rms of held-out data"
        )
    if best.law != PIECEWISE:
        free = next(c.held_out_error_n for c in candidates if c.law == PIECEWISE)
        shown = f", {formula}" if best.law == FORMULA else ""
        return (
            f"a freely fitted piecewise-linear law is not the best: it leaves {free:.3g} N rms of held-out data, "
            f"the {best.law} {best.held_out_error_n:.3g} N{shown}"
        )
    slopes = pieces.slopes_n_per_m
    if not pieces.knees_m.size:
        return f"straight line with the slope {slopes[0]:.5g} N/m"
    gap = pieces.knees_m.size == 2 and abs(slopes[1]) < FLAT * np.abs(slopes).max()
    kind, shown_slopes = ("dead zone", slopes[[0, 2]]) if gap else ("piecewise-linear law", slopes)
    where = "" if sides_known else ", counted from the middle of the play as no sensor tells its place"
    return f"{kind} with knees at {_listed(1e3 * pieces.knees_m)} mm and slopes {_listed(shown_slopes)} N/m{where}"


def _sliding(found: SlidingFriction) -> SlidingLaw:
    names = SlidingLaw.__struct_fields__
    return SlidingLaw(**{n: Estimate(getattr(found, n), e) for n, e in zip(names, found.errors, strict=True)})


def _within(estimate: Estimate, unit: str, scale: float = 1.0) -> str:
    return interval(scale * estimate.value, scale * estimate.standard_error, unit)


def _listed(values: Float[np.ndarray, " values"]) -> str:
    words = [f"{value:.5g}" for value in values]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
