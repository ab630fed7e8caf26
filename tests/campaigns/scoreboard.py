"""What a diagnosis found against the sealed answers: shares of right answers with their intervals.

Every case counts. One whose diagnosis was refused, or crashed, has a wrong verdict, and its visible effects are missed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
from scipy.stats import binomtest, chi2

from identify.gaps.decision_table import Verdict
from identify.gaps.results import Gap
from tests.campaigns.blind_diagnosis import Found, Refused
from tests.campaigns.score_effects import TrueOne
from tests.campaigns.score_names import named_classes
from tests.campaigns.score_places import description_right
from tests.campaigns.score_sets import SetScore, not_answered, score_set, true_ones
from tests.campaigns.true_effect import Best
from tests.campaigns.worlds.truth import Case

QUIET = (Verdict.CONSISTENT, Verdict.CANNOT_TELL)
"""The verdicts that claim no difference."""
ROWS = ("null", "below the limit", "one of the library", "several", "outside the library")
"""What is true of a case, by the effects above their limits."""


class Rate(msgspec.Struct, frozen=True):
    """So many of so many, with a 95 % interval of the quotient."""

    name: str
    count: int
    of: int
    interval_95: tuple[float, float]


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """The scoreboard. rates are shares, with Wilson's interval; of false names there may be several a case (Garwood's).

    limits are the detection limits, the median over an effect's cases, in default magnitudes. The costs: a case without
    its null references, a null reference where one was made, and the largest memory of either; None where there is
    none.
    """

    cases: int
    rates: tuple[Rate, ...]
    false_names: Rate
    cpu_s_median: float | None
    cpu_s_largest: float | None
    null_reference_cpu_s_median: float | None
    null_reference_cpu_s_largest: float | None
    memory_mib_largest: float | None
    limits: dict[str, float]


@dataclass(frozen=True)
class ScoredCase:
    """What is true beside what was found; `best` is what the truth achieves, `usual` the gap that nulls of the world
    leave (median)."""

    truth: Case
    answer: Found | Refused
    best: Best
    usual: float

    @property
    def gap(self) -> Gap | None:
        """None where the diagnosis was refused."""
        return self.answer.gap if isinstance(self.answer, Found) else None

    @property
    def contacts(self) -> tuple[str, ...]:
        return tuple(contact.name for contact in self.truth.nominal.contacts)

    @cached_property
    def truths(self) -> tuple[TrueOne, ...]:
        """Outside the library, an effect is above its limit if it leaves more than nulls, by what matters.

        None is where the records allow no limits.
        """
        above = [effect.above for effect in self.best.effects]
        if self.truth.kind == "outside" or not above:
            above = [self.truth.kind == "outside" and self.best.before - self.usual > 1] * len(self.truth.effects)
        return true_ones(self.truth, above)

    @cached_property
    def score(self) -> SetScore:
        if self.gap is None:
            return not_answered(self.truths)
        return score_set(self.truths, named_classes(self.gap), self.gap.verdict, self.contacts)

    @property
    def row(self) -> str:
        """Which of `ROWS` it is."""
        visible = [t for t in self.truths if t.above]
        if not visible:
            return ROWS[0] if self.truth.kind == "null" else ROWS[1]
        if not all(t.library for t in visible):
            return ROWS[4]
        return ROWS[3] if len(visible) > 1 else ROWS[2]

    @property
    def false_alarm(self) -> bool:
        """Of a null: any verdict but consistent or cannot_tell; of one with cables, unless they alone are named."""
        loud = self.gap is not None and self.gap.verdict not in QUIET
        return self.truth.kind == "null" and loud and not self.score.true_alone

    @property
    def described(self) -> bool:
        """Of an effect outside the library: whether it is told where it is and by what law."""
        return self.gap is not None and description_right(self.truth.expected, self.gap.unknown)


def compared_cases(rows: Sequence[tuple[Case, Found | Refused, Best]]) -> list[ScoredCase]:
    """Of one world: every answer with what was found and what the truth achieves."""
    nulls = [best.before for case, _, best in rows if case.kind == "null" and not best.refusal]
    usual = float(np.median(nulls)) if nulls else 0.0
    return [ScoredCase(*row, usual) for row in rows]


def scored(compared: Sequence[ScoredCase]) -> Score:
    """The scoreboard of all cases."""
    found = [c.answer for c in compared if isinstance(c.answer, Found)]
    made = {key: cpu_s for one in found for key, cpu_s in one.null_references_cpu_s.items() if cpu_s > 0}
    cpu_s_median, cpu_s_largest = _median_and_largest([one.cpu_s for one in found])
    made_median, made_largest = _median_and_largest([*made.values()])
    return Score(
        cases=len(compared),
        rates=rates(compared),
        false_names=false_names(compared),
        cpu_s_median=cpu_s_median,
        cpu_s_largest=cpu_s_largest,
        null_reference_cpu_s_median=made_median,
        null_reference_cpu_s_largest=made_largest,
        memory_mib_largest=max((one.memory_mib for one in found), default=None),
        limits=detection_limits(compared),
    )


def _median_and_largest(values: Sequence[float]) -> tuple[float | None, float | None]:
    return (float(np.median(values)), max(values)) if values else (None, None)


def rates(compared: Sequence[ScoredCase]) -> tuple[Rate, ...]:
    """Of right answers, by what is true."""
    scores = [c.score for c in compared]
    outside = [c for c in compared if c.truth.kind == "outside"]
    refused = [c.answer for c in compared if isinstance(c.answer, Refused)]
    return (
        _rate("visible effects named", sum(s.recalled for s in scores), sum(s.visible for s in scores)),
        _rate("effects of all sizes named", sum(s.named_of_all for s in scores), sum(s.true_effects for s in scores)),
        _share("verdict right", (s.verdict_right for s in scores)),
        _share("null: false alarm", (c.false_alarm for c in compared if c.truth.kind == "null")),
        _rate("parameter in its 95 % interval", sum(s.covered for s in scores), sum(s.parameters for s in scores)),
        _share("outside: description right", (c.described for c in outside)),
        _share("outside: that, above its limit", (c.described for c in outside if c.row == ROWS[4])),
        _rate("refused", sum(not r.crashed for r in refused), len(compared)),
        _rate("crashed", sum(r.crashed for r in refused), len(compared)),
        _share("limits not known", (bool(c.best.refusal) for c in compared)),
    )


def false_names(compared: Sequence[ScoredCase]) -> Rate:
    """So many a case; the interval is of a Poisson count (Garwood, Biometrika 28, 1936)."""
    count, of = sum(c.score.false_names for c in compared), len(compared)
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    high = chi2.ppf(0.975, 2 * count + 2) / 2
    return Rate("false names a case", count, of, (float(low) / of, float(high) / of))


def detection_limits(compared: Iterable[ScoredCase]) -> dict[str, float]:
    """Of every effect of the library, the median over its cases of the strength that what it achieves asks for."""
    found: dict[str, list[float]] = {}
    for c in compared:
        for effect, best in zip(c.truth.effects, c.best.effects, strict=False):
            found.setdefault(effect.name, []).append(best.limit(effect.strength))
    medians = {name: float(np.median(limits)) for name, limits in sorted(found.items())}
    return {name: limit for name, limit in medians.items() if np.isfinite(limit)}


def wilson(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share; all of it where nothing was counted."""
    if not of:
        return 0.0, 1.0
    between = binomtest(count, of).proportion_ci(0.95, method="wilson")
    return float(between.low), float(between.high)


def _share(name: str, answers: Iterable[bool]) -> Rate:
    known = list(answers)
    return _rate(name, sum(known), len(known))


def _rate(name: str, count: int, of: int) -> Rate:
    return Rate(name, count, of, wilson(count, of))
