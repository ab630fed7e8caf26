"""Decision table: from the evidence of the records to one of six verdicts.

Notes for maintainers
1. D, a difference: p < `DIFFERENCE_P_VALUE` over all records together, against null simulations.
2. B, bounded: the upper 97.5 % bound of every quantity that matters lies below its threshold, and noise hides none;
   where effects are named, also of what the nominal rig leaves with the tolerances as fitted beside them. Tolerances
   that take up what a named effect does, without it, make no effect small.
3. N, a name: at least one effect (or class of look-alikes) with an inclusion probability of `NAMED_PROBABILITY` or more
   and a 95 % interval that excludes its neutral value.
4. R, enough: the misfit of the named set satisfies B, or its p is `USUAL_P_VALUE` or more.

    D    B     verdict
    no   yes   consistent
    no   no    cannot_tell
    yes  yes   small
    yes  no    explained if N and R; partly_explained if N and at least half removed; else unexplained

A rollout with a worse prediction with the named set than without vetoes `explained`; a better one proves nothing.
"""

from enum import StrEnum
from math import isfinite

import msgspec

DIFFERENCE_P_VALUE = 0.01
"""p-value below which a difference is certain: one null in a hundred. Convention."""
USUAL_P_VALUE = 0.05
"""p-value from which tolerances and noise explain a misfit: convention."""
NAMED_PROBABILITY = 0.95
"""Inclusion probability from which an effect is named: convention, as of 95 % intervals."""
PARTLY_EXPLAINED_SHARE = 0.5
"""Removed share of the mismatch from which it is explained in part: more than remains."""


class Verdict(StrEnum):
    """Verdicts of the diagnosis."""

    CONSISTENT = "consistent"
    CANNOT_TELL = "cannot_tell"
    SMALL = "small"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


class Bounded(msgspec.Struct, frozen=True):
    """Quantity that matters: its estimate, the upper end of its one-sided 97.5 % interval, and its threshold, in
    `unit`.

    upper is None where the records do not bound it. Unless value shows that it matters, `why` then gives the reason,
    and `remedy` what would show it. value is None where they do not even estimate it.
    """

    name: str
    unit: str
    value: float | None
    upper: float | None
    threshold: float
    why: str = ""
    remedy: str = ""

    @property
    def not_seen(self) -> bool:
        """True if the records neither bound it nor show that it matters: there is a reason, or its value is small."""
        return not self.holds and (bool(self.why) or self.value is None or self.value < self.threshold)

    @property
    def holds(self) -> bool:
        """True if it certainly lies below its threshold; a value that is not finite bounds nothing."""
        return self.upper is not None and isfinite(self.upper) and self.upper < self.threshold


class Strength(msgspec.Struct, frozen=True):
    """Strength of an effect, and the inclusion probability of it or its look-alikes (`instead`).

    The records do not distinguish an effect from its look-alikes, so that the class is named.
    """

    effect: str
    inclusion_probability: float
    interval_95: tuple[float, float]
    neutral: float
    instead: tuple[str, ...] = ()

    @property
    def is_named(self) -> bool:
        lower, upper = self.interval_95
        return self.inclusion_probability >= NAMED_PROBABILITY and not lower <= self.neutral <= upper


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """Evidence that decides. `after` refers to the misfit of the named set, or of the nominal rig without a named
    effect. quantities_beside are those of the nominal rig with the tolerances fitted beside the named set: what its
    absence changes; empty without a name.

    removed is the share of the mismatch that the named set removes; vetoed is whether the rollout forbids `explained`.
    held_back_shows tells whether the validation record shows the difference by itself; otherwise strengths are those of
    all records.
    """

    p_value: float
    quantities: tuple[Bounded, ...]
    strengths: tuple[Strength, ...]
    p_value_after: float
    quantities_after: tuple[Bounded, ...]
    removed: float
    vetoed: bool = False
    held_back_shows: bool = True
    quantities_beside: tuple[Bounded, ...] = ()

    @property
    def not_seen(self) -> tuple[Bounded, ...]:
        """Quantities that the records neither bound nor show, stated beside every verdict."""
        return tuple(quantity for quantity in self.quantities if quantity.not_seen)

    @property
    def differs(self) -> bool:
        """Criterion D: a difference between rig.json and the records is certain."""
        return self.p_value < DIFFERENCE_P_VALUE

    @property
    def bounded(self) -> bool:
        """Criterion B of the nominal rig; false where no quantity was compared."""
        return are_all_below_threshold(self.quantities) and not self.is_absorbed_by_tolerances

    @property
    def is_absorbed_by_tolerances(self) -> bool:
        """True if tolerances take up what the named effects change, without which that matters."""
        return are_all_below_threshold(self.quantities) and not all(
            quantity.holds for quantity in self.quantities_beside
        )

    @property
    def named(self) -> tuple[str, ...]:
        """Criterion N: effects that may be named."""
        return tuple(strength.effect for strength in self.strengths if strength.is_named)

    @property
    def enough(self) -> bool:
        """Criterion R: what the named set leaves is bounded, or usual for tolerances and noise."""
        return are_all_below_threshold(self.quantities_after) or self.p_value_after >= USUAL_P_VALUE

    @property
    def difference_matters(self) -> bool:
        """Criteria D and not B: a certain difference that is not bounded."""
        return self.differs and not self.bounded

    @property
    def verdict(self) -> Verdict:
        if not self.differs:
            return Verdict.CONSISTENT if self.bounded else Verdict.CANNOT_TELL
        if self.bounded:
            return Verdict.SMALL
        if self.named and self.enough and not self.vetoed:
            return Verdict.EXPLAINED
        removes_half = self.named and self.removed >= PARTLY_EXPLAINED_SHARE
        return Verdict.PARTLY_EXPLAINED if removes_half else Verdict.UNEXPLAINED


def are_all_below_threshold(quantities: tuple[Bounded, ...]) -> bool:
    """Criterion B: there are quantities, and all are certainly below their thresholds."""
    return bool(quantities) and all(quantity.holds for quantity in quantities)
