"""Results on contact laws: the structure of law.json, and the sentence that sums up a law."""

import msgspec
import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.contacts.results import Estimate, Unanswered
from identify.laws.fitted_laws import BacklashFriction, PiecewiseLinear
from identify.pages.wording import interval

PIECEWISE = "piecewise-linear law"
FORMULA = "formula found"
DEAD_ZONE = "dead zone of the joint estimate"
CUBIC = "cubic polynomial"
SLIDING = "friction behind a backlash"
MAX_FLAT_SLOPE_SHARE = 0.01
"""Slope over the steepest below which a piece counts as flat, the gap of a dead zone."""


class TriedLaw(msgspec.Struct, frozen=True):
    """Law that was tried, and the rms error of its force in the held-out half of the record."""

    law: str
    held_out_error_n: float


class SlidingLaw(msgspec.Struct, frozen=True, kw_only=True):
    """Dry friction reached through a backlash by a spring: sliding force in each direction, backlash, stiffness.

    Standard errors are of the scatter alone.
    """

    upper_n: Estimate
    lower_n: Estimate
    backlash_m: Estimate
    stiffness_n_per_m: Estimate


class ContactLawEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """Law of one contact; eta is its relative displacement.

    knees_m and slopes_n_per_m are those of the formula; fitted_knees_m and fitted_slopes_n_per_m those of the
    piecewise-linear law fitted from them, with standard errors of the scatter alone: contact.json has those of drift
    and rig.json. hysteresis_share is the share of the unexplained variance that a damper in the closed contact
    explains. repeatable is false if time ended the search, as the same seed may then give another formula.
    """

    contact: str
    verdict: str
    best: str
    formula: str
    knees_m: tuple[float, ...]
    slopes_n_per_m: tuple[float, ...]
    fitted_knees_m: tuple[Estimate, ...]
    fitted_slopes_n_per_m: tuple[Estimate, ...]
    candidates: tuple[TriedLaw, ...]
    force_rms_n: float
    hysteresis_share: float
    sides_known: bool
    points: int
    repeatable: bool
    sliding: SlidingLaw | None = None
    """Values of the friction, if it is the best law."""


class LawReport(msgspec.Struct, frozen=True, kw_only=True):
    """Laws of the contacts of a recording: the structure of law.json."""

    rig: str
    laws: tuple[ContactLawEstimate, ...]
    unanswered: tuple[Unanswered, ...]
    findings: tuple[Finding, ...] = ()


def verdict_sentence(
    pieces: PiecewiseLinear,
    formula: str,
    candidates: tuple[TriedLaw, ...],
    best: TriedLaw,
    sides_known: bool,
    sliding: BacklashFriction | None,
) -> str:
    """Sentence on the law of one contact: its kind and values, or which law is better than straight pieces."""
    if sliding is not None:
        friction = sliding_estimates(sliding)
        return (
            f"friction behind a backlash: it slides at {estimate_interval(friction.upper_n, 'N')} one way and at "
            f"{estimate_interval(friction.lower_n, 'N')} the other, behind a backlash of "
            f"{estimate_interval(friction.backlash_m, 'mm', 1e3)} and a stiffness of "
            f"{estimate_interval(friction.stiffness_n_per_m, 'N/m')} (95 % intervals of the scatter); it leaves "
            f"{best.held_out_error_n:.3g} N rms of held-out data"
        )
    if best.law != PIECEWISE:
        piecewise_error_n = next(candidate.held_out_error_n for candidate in candidates if candidate.law == PIECEWISE)
        formula_note = f", {formula}" if best.law == FORMULA else ""
        return (
            f"a freely fitted piecewise-linear law is not the best: it leaves {piecewise_error_n:.3g} N rms of "
            f"held-out data, the {best.law} {best.held_out_error_n:.3g} N{formula_note}"
        )
    kind_words, slopes_n_per_m = "piecewise-linear law", pieces.slopes_n_per_m
    if not pieces.knees_m.size:
        return f"straight line with the slope {slopes_n_per_m[0]:.5g} N/m"
    if pieces.knees_m.size == 2 and abs(slopes_n_per_m[1]) < MAX_FLAT_SLOPE_SHARE * np.abs(slopes_n_per_m).max():
        kind_words, slopes_n_per_m = "dead zone", slopes_n_per_m[[0, 2]]
    origin_note = "" if sides_known else ", counted from the middle of the play as no sensor tells its place"
    knees_text, slopes_text = _enumeration(1e3 * pieces.knees_m), _enumeration(slopes_n_per_m)
    return f"{kind_words} with knees at {knees_text} mm and slopes {slopes_text} N/m{origin_note}"


def sliding_estimates(friction: BacklashFriction) -> SlidingLaw:
    """Values of the friction with their standard errors."""
    fields_and_errors = zip(SlidingLaw.__struct_fields__, friction.standard_errors, strict=True)
    return SlidingLaw(**{field: Estimate(getattr(friction, field), error) for field, error in fields_and_errors})


def estimate_interval(estimate: Estimate, unit: str, unit_factor: float = 1.0) -> str:
    """95 % interval of an estimate in a unit of that factor."""
    return interval(unit_factor * estimate.value, unit_factor * estimate.standard_error, unit)


def _enumeration(values: Float[np.ndarray, " values"]) -> str:
    *first_texts, last_text = [f"{value:.5g}" for value in values]
    return f"{', '.join(first_texts)} and {last_text}" if first_texts else last_text
