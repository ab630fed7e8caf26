"""Results on contact laws: the structure of law.json, and the sentence that sums up a law."""

from collections.abc import Iterable, Iterator

import msgspec
import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.contacts.results import Estimate, Unanswered
from identify.laws.fitted_laws import ForceSamples, FrictionFit, Part, PiecewiseLinear
from identify.pages.wording import COVERED, interval, joined, percent

PIECEWISE = "piecewise-linear law"
FORMULA = "formula found"
DEAD_ZONE = "dead zone of the joint estimate"
CUBIC = "cubic polynomial"
LINEAR = "damper and spring"
SLIDING = "dry friction"
SMOOTH_SLIDING = "dry friction that grows with speed"
MAX_LEFT_SHARE = 0.2
"""Share of the force that a law may leave of held-out data, beyond the sensors' noise; one that leaves more does not
fit."""
MAX_FLAT_SLOPE_SHARE = 0.01
"""Slope over the steepest below which a piece counts as flat, the gap of a dead zone."""


class TriedLaw(msgspec.Struct, frozen=True):
    """Law that was tried, and the rms error of its force in the held-out half of the record; left_share is this error
    over the force's rms, both beyond the sensors' noise."""

    law: str
    held_out_error_n: float
    left_share: float

    @property
    def fits(self) -> bool:
        return self.left_share <= MAX_LEFT_SHARE


class SlidingLaw(msgspec.Struct, frozen=True, kw_only=True):
    """Dry friction beside a constant force, a damper and a spring (`Friction` of `fitted_laws`), as far as the record
    demands them; a part that it does not demand is None. undetermined names the fields that it demands and does not
    tell: their 95 % interval would hold zero."""

    upper_n: Estimate | None = None
    lower_n: Estimate | None = None
    backlash_m: Estimate | None = None
    stiffness_n_per_m: Estimate | None = None
    reversal_speed_m_per_s: Estimate | None = None
    constant_n: Estimate | None = None
    viscous_n_s_per_m: Estimate | None = None
    elastic_n_per_m: Estimate | None = None
    undetermined: tuple[str, ...] = ()

    @property
    def names(self) -> dict[str, str]:
        """Names of the fields in words; one of both sliding forces if they are one."""
        names = {"upper_n": "sliding force"}
        if self.upper_n != self.lower_n:
            names = {"upper_n": "sliding force one way", "lower_n": "sliding force the other way"}
        return names | _NAMES

    @property
    def value_texts(self) -> Iterator[tuple[str, str]]:
        """Names and values with 95 % intervals of what the record tells."""
        for field, name in self.names.items():
            estimate: Estimate | None = getattr(self, field)
            if estimate is not None:
                yield name, estimate_interval(estimate, *_UNIT_BY_FIELD[field])


_NAMES = {
    "backlash_m": "backlash",
    "stiffness_n_per_m": "stiffness of the slider",
    "reversal_speed_m_per_s": "reversal speed",
    "constant_n": "constant force",
    "viscous_n_s_per_m": "damper",
    "elastic_n_per_m": "spring",
}
_UNIT_BY_FIELD = {
    "upper_n": ("N", 1.0),
    "lower_n": ("N", 1.0),
    "backlash_m": ("mm", 1e3),
    "stiffness_n_per_m": ("N/m", 1.0),
    "reversal_speed_m_per_s": ("mm/s", 1e3),
    "constant_n": ("N", 1.0),
    "viscous_n_s_per_m": ("N s/m", 1.0),
    "elastic_n_per_m": ("N/m", 1.0),
}
_POSITIVE_FIELDS = ("upper_n", "lower_n", "backlash_m", "stiffness_n_per_m", "reversal_speed_m_per_s")


class ContactLawEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """Law of one contact; eta is its relative displacement.

    knees_m and slopes_n_per_m are those of the formula; fitted_knees_m and fitted_slopes_n_per_m those of the
    piecewise-linear law fitted from them, with standard errors by scatter, misfit, slow motion and tolerances as those
    of contact.json. fits is false if even the best law leaves too much (`MAX_LEFT_SHARE`). hysteresis_share is the
    share of the unexplained variance that a damper in the closed contact explains. repeatable is false if time ended
    the search, as the same seed may then give another formula.
    """

    contact: str
    verdict: str
    best: str
    fits: bool
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
    """Values of the friction, if it is the best law and fits."""

    def candidate(self, law: str) -> TriedLaw:
        """Law that was tried, by its name."""
        return next(candidate for candidate in self.candidates if candidate.law == law)


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
    sliding: SlidingLaw | None,
) -> str:
    """Sentence on the law of one contact: its kind and values, which law is better than straight pieces, or that none
    fits."""
    if not best.fits:
        return (
            f"none of the laws fits: the best, {best.law}, leaves {percent(best.left_share)} of the force in held-out "
            f"data (limit {100 * MAX_LEFT_SHARE:.3g} %)"
        )
    if sliding is not None:
        values_text = joined([f"{name} {text}" for name, text in sliding.value_texts])
        not_told = [sliding.names[field] for field in sliding.undetermined]
        not_told_text = f"; the record does not tell: {joined(not_told)}" if not_told else ""
        return (
            f"{best.law}: {values_text} (± 95 %){not_told_text}; it leaves {best.held_out_error_n:.3g} N rms of "
            f"held-out data, {percent(best.left_share)} of the force"
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


def sliding_estimates(fit: FrictionFit, changed: Iterable[ForceSamples]) -> SlidingLaw:
    """Values of the friction with their standard errors; changed are the samples with one tolerance each."""
    estimates = {field: Estimate(*value_with_error) for field, value_with_error in fit.estimates(changed).items()}
    unseen = []
    if Part.FRICTION in fit.parts and not fit.is_reversal_seen:
        unseen = ["reversal_speed_m_per_s" if fit.by_speed else "stiffness_n_per_m"]
    undetermined = [
        *unseen,
        *(
            field
            for field, estimate in estimates.items()
            if field in _POSITIVE_FIELDS and field not in unseen and estimate.value <= COVERED * estimate.standard_error
        ),
    ]
    told = {field: estimate for field, estimate in estimates.items() if field not in undetermined}
    return SlidingLaw(**told, undetermined=tuple(undetermined))


def estimate_interval(estimate: Estimate, unit: str, unit_factor: float = 1.0) -> str:
    """95 % interval of an estimate in a unit of that factor."""
    return interval(unit_factor * estimate.value, unit_factor * estimate.standard_error, unit)


def _enumeration(values: Float[np.ndarray, " values"]) -> str:
    *first_texts, last_text = [f"{value:.5g}" for value in values]
    return f"{', '.join(first_texts)} and {last_text}" if first_texts else last_text
