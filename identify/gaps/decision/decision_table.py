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

from dataclasses import dataclass
from enum import StrEnum
from math import isfinite

DIFFERS = 0.01
"""p-value below which a difference is certain: one null in a hundred."""
USUAL = 0.05
"""p-value from which tolerances and noise explain what is left: convention."""
NAMED = 0.95
"""Inclusion probability from which an effect is named: convention, as of 95 % intervals."""
HALF = 0.5
"""Removed share of the mismatch from which it is explained in part: more than is left."""


class Verdict(StrEnum):
    """What the diagnosis concludes."""

    CONSISTENT = "consistent"
    CANNOT_TELL = "cannot_tell"
    SMALL = "small"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Bounded:
    """A quantity that matters: its estimate, the upper end of its one-sided 97.5 % interval, and the threshold.

    All three in `unit`. hidden: noise hides the quantity, so that the record bounds it by nothing.
    """

    name: str
    unit: str
    value: float
    upper: float
    threshold: float
    hidden: bool = False

    @property
    def holds(self) -> bool:
        """Whether it certainly lies below what matters; what is no number bounds nothing."""
        return not self.hidden and isfinite(self.upper) and self.upper < self.threshold


@dataclass(frozen=True)
class Strength:
    """An effect's strength (or that of a class of look-alikes) and how probably it is there."""

    effect: str
    inclusion_probability: float
    interval_95: tuple[float, float]
    neutral: float

    @property
    def is_named(self) -> bool:
        low, high = self.interval_95
        return self.inclusion_probability >= NAMED and not low <= self.neutral <= high


@dataclass(frozen=True)
class Evidence:
    """All that decides. `after` is what the named set leaves; without a name it is what the nominal rig leaves.

    removed is the share of the mismatch that the named set removes, vetoed whether the rollout forbids `explained`.
    """

    p_value: float
    quantities: tuple[Bounded, ...]
    strengths: tuple[Strength, ...]
    p_value_after: float
    quantities_after: tuple[Bounded, ...]
    removed: float
    vetoed: bool = False

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
