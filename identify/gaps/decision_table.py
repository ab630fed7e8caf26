"""The decision, stated once: from what a record shows to one of six verdicts.

Notes for maintainers
1. D, a difference: p < `DIFFERS` over all records together, against null simulations.
2. B, bounded: the upper 97.5 % bound of every quantity that matters lies below its threshold, and noise hides none.
3. N, a name: at least one effect (or class of look-alikes) with an inclusion probability of `NAMED` or more and a 95 %
   interval that excludes its neutral value.
4. R, enough: what the named set leaves satisfies B, or its p is `USUAL` or more.

    D    B     verdict
    no   yes   consistent
    no   no    cannot_tell
    yes  yes   small
    yes  no    explained if N and R; partly_explained if N and at least half removed; else unexplained

A rollout that predicts worse with the named set than without vetoes `explained`; it licenses nothing.
"""

from enum import StrEnum
from math import isfinite

import msgspec

DIFFERS = 0.01
"""p-value below which a difference is certain: one null in a hundred."""
USUAL = 0.05
"""p-value from which tolerances and noise explain what is left: convention."""
NAMED = 0.95
"""Inclusion probability from which an effect is named: convention, as of 95 % intervals."""
HALF = 0.5
"""Removed share of the mismatch from which it is explained in part: more than is left."""


class Verdict(StrEnum):
    """Verdicts of the diagnosis."""

    CONSISTENT = "consistent"
    CANNOT_TELL = "cannot_tell"
    SMALL = "small"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


class Bounded(msgspec.Struct, frozen=True):
    """A quantity that matters: its estimate, the upper end of its one-sided 97.5 % interval, and the threshold.

    All three in `unit`. upper is None where the records bound it by nothing: `why` then says the reason, `remedy` what
    would show it; value is None where they do not even estimate it.
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
        """True if the records neither bound it nor show that it matters."""
        return not self.holds and (self.upper is None or self.value is None or self.value < self.threshold)

    @property
    def holds(self) -> bool:
        """True if it certainly lies below what matters; what is no number bounds nothing."""
        return self.upper is not None and isfinite(self.upper) and self.upper < self.threshold


class Strength(msgspec.Struct, frozen=True):
    """An effect's strength and how probably it, or one of its look-alikes (`instead`), is there.

    The records do not tell an effect from its look-alikes, so that the class is named.
    """

    effect: str
    inclusion_probability: float
    interval_95: tuple[float, float]
    neutral: float
    instead: tuple[str, ...] = ()

    @property
    def is_named(self) -> bool:
        low, high = self.interval_95
        return self.inclusion_probability >= NAMED and not low <= self.neutral <= high


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """All that decides. `after` is what the named set leaves; without a name it is what the nominal rig leaves.

    removed is the share of the mismatch that the named set removes, vetoed whether the rollout forbids `explained`.
    held_back_shows: whether the record that was not fitted shows the difference by itself; where it does not, strengths
    are those of all records.
    """

    p_value: float
    quantities: tuple[Bounded, ...]
    strengths: tuple[Strength, ...]
    p_value_after: float
    quantities_after: tuple[Bounded, ...]
    removed: float
    vetoed: bool = False
    held_back_shows: bool = True

    @property
    def not_seen(self) -> tuple[Bounded, ...]:
        """Quantities that stand beside every verdict as not seen."""
        return tuple(quantity for quantity in self.quantities if quantity.not_seen)

    @property
    def differs(self) -> bool:
        """D."""
        return self.p_value < DIFFERS

    @property
    def bounded(self) -> bool:
        """B of the nominal rig; nothing is bounded where nothing was looked at."""
        return all_hold(self.quantities)

    @property
    def named(self) -> tuple[str, ...]:
        """N: the effects that may be named."""
        return tuple(s.effect for s in self.strengths if s.is_named)

    @property
    def enough(self) -> bool:
        """R."""
        return all_hold(self.quantities_after) or self.p_value_after >= USUAL

    @property
    def verdict(self) -> Verdict:
        if not self.differs:
            return Verdict.CONSISTENT if self.bounded else Verdict.CANNOT_TELL
        if self.bounded:
            return Verdict.SMALL
        if self.named and self.enough and not self.vetoed:
            return Verdict.EXPLAINED
        return Verdict.PARTLY_EXPLAINED if self.named and self.removed >= HALF else Verdict.UNEXPLAINED


def all_hold(quantities: tuple[Bounded, ...]) -> bool:
    """B of some quantities."""
    return bool(quantities) and all(quantity.holds for quantity in quantities)
