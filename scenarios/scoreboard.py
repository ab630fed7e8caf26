"""What a diagnosis found against the sealed answers: shares of right answers with their intervals."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
from scipy.stats import binomtest

from identify.gaps.decision_table import Verdict
from identify.gaps.results import Gap
from identify.pages.wording import COVERED
from scenarios.blind_diagnosis import Found
from scenarios.score_places import description_right, place_fields, place_right
from scenarios.true_effect import Best, named_now
from scenarios.worlds.drawing import DRAWABLE
from scenarios.worlds.outside import OUTSIDE
from scenarios.worlds.truth import Case, EffectTruth

NAMING = (Verdict.SMALL, Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED)
"""The verdicts that name a cause."""
QUIET = (Verdict.CONSISTENT, Verdict.CANNOT_TELL)
"""The verdicts that claim no difference."""
KINDS = ("null", "single", "pair", "outside")


class Rate(msgspec.Struct, frozen=True):
    """So many of so many, with the 95 % interval of Wilson."""

    name: str
    count: int
    of: int
    interval_95: tuple[float, float]


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """The scoreboard; limits are the detection limits, the median over an effect's cases, in default magnitudes.

    share_of_true_closure is the median over causes that are right and above their limit. The costs: a case without its
    null reference, a null reference where one was made, and the largest memory of either.
    """

    cases: int
    rates: tuple[Rate, ...]
    share_of_true_closure: float | None
    closures: int
    cpu_s_median: float
    cpu_s_largest: float
    null_reference_cpu_s_median: float | None
    null_reference_cpu_s_largest: float | None
    memory_mib_largest: float
    limits: dict[str, float]


@dataclass(frozen=True)
class ScoredCase:
    """An answer beside what was found, what the truth achieves, and the gap that nulls of the world leave (median)."""

    truth: Case
    found: Found
    best: Best
    usual: float

    @property
    def gap(self) -> Gap:
        return self.found.gap

    @cached_property
    def effects(self) -> tuple[EffectTruth, ...]:
        return tuple(named_now(effect) for effect in self.truth.effects)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(effect.name for effect in self.effects)

    @property
    def label(self) -> str:
        """What is true, in one word."""
        return self.truth.kind if self.truth.kind in ("null", "pair") else self.names[0]

    @property
    def named(self) -> tuple[str, ...]:
        """The effects that the verdict names."""
        if self.gap.verdict not in NAMING or not self.gap.causes:
            return ()
        first = self.gap.causes[0]
        return tuple(e for e, strength in zip(first.effects, first.strengths, strict=True) if strength.is_named)

    def is_truth(self, effects: Sequence[str]) -> bool:
        """Whether these are the true effects, all of the library."""
        return self.truth.kind in ("single", "pair") and sorted(effects) == sorted(self.names)

    def holds(self, effects: Sequence[str]) -> bool:
        """Whether these are the true effects, but for such as are below their limits."""
        shown = {name for name, best in zip(self.names, self.best.effects, strict=False) if best.above}
        return self.truth.kind in ("single", "pair") and bool(effects) and shown <= {*effects} <= {*self.names}

    @property
    def right(self) -> bool:
        return self.is_truth(self.named)

    @property
    def first_right(self) -> bool:
        """Whether the likeliest cause is right, whatever the verdict."""
        return bool(self.gap.causes) and self.is_truth(self.gap.causes[0].effects)

    @property
    def above(self) -> bool:
        """Whether the truth is above its limit: for outside the library, whether it leaves more than nulls, by what
        matters."""
        return self.best.before - self.usual > 1 if self.truth.kind == "outside" else self.best.above

    @property
    def nothing_right(self) -> bool:
        """No gap is the right answer to a null, and to what is below its limit: of a pair, to two such effects."""
        if self.truth.kind == "pair":
            return not any(effect.above for effect in self.best.effects)
        return self.truth.kind == "null" or not self.above

    @property
    def unknown_right(self) -> bool:
        return self.truth.kind == "outside"


def compared_cases(rows: Sequence[tuple[Case, Found, Best]]) -> list[ScoredCase]:
    """Of one world: every answer with what was found and what the truth achieves."""
    nulls = [best.before for case, _, best in rows if case.kind == "null"]
    usual = float(np.median(nulls)) if nulls else 0.0
    return [ScoredCase(*row, usual) for row in rows]


def scored(compared: Sequence[ScoredCase]) -> Score:
    """The scoreboard of all cases."""
    closures = [c.gap.causes[0].explained / c.best.closes for c in compared if c.right and c.above]
    made = list(
        {c.found.key: c.found.null_reference_cpu_s for c in compared if c.found.null_reference_cpu_s > 0}.values()
    )
    cpu_s = [c.found.cpu_s for c in compared]
    return Score(
        cases=len(compared),
        rates=rates(compared),
        share_of_true_closure=float(np.median(closures)) if closures else None,
        closures=len(closures),
        cpu_s_median=float(np.median(cpu_s)),
        cpu_s_largest=max(cpu_s),
        null_reference_cpu_s_median=float(np.median(made)) if made else None,
        null_reference_cpu_s_largest=max(made) if made else None,
        memory_mib_largest=max(c.found.memory_mib for c in compared),
        limits=detection_limits(compared),
    )


def rates(compared: Sequence[ScoredCase]) -> tuple[Rate, ...]:
    """Of right answers, by what is true."""
    of_kind = {kind: [c for c in compared if c.truth.kind == kind] for kind in KINDS}
    placed = [c for c in of_kind["single"] if c.right and place_fields(c.effects[0])]
    return (
        *_single_rates(of_kind["single"]),
        *_pair_rates(of_kind["pair"]),
        *_outside_rates(of_kind["outside"]),
        *_null_rates(of_kind["null"]),
        _rate("place right, of single effects right", (place_right(c.effects[0], c.gap.causes[0]) for c in placed)),
        _rate("parameter in its 95 % interval", (abs(z) < COVERED for _, z in parameter_errors(compared))),
    )


def _above(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    return [c for c in cases if c.above]


def _single_rates(singles: Sequence[ScoredCase]) -> tuple[Rate, ...]:
    return (
        _rate("single effect right", (c.right for c in singles)),
        _rate("single effect right, above its limit", (c.right for c in _above(singles))),
        _rate("single effect likeliest, by any verdict", (c.first_right for c in singles)),
        _rate("single effect likeliest, above its limit", (c.first_right for c in _above(singles))),
    )


def _pair_rates(pairs: Sequence[ScoredCase]) -> tuple[Rate, ...]:
    return (
        _rate("both of a pair", (c.right for c in pairs)),
        _rate("both of a pair, both above their limit", (c.right for c in _above(pairs))),
        _rate("at least one of a pair", (bool({*c.named} & {*c.names}) for c in pairs)),
    )


def _outside_rates(outside: Sequence[ScoredCase]) -> tuple[Rate, ...]:
    return (
        _rate("outside: unexplained or partly explained", (_not_mistaken(c) for c in outside)),
        _rate("outside: that, above its limit", (_not_mistaken(c) for c in _above(outside))),
        _rate("outside: description right", (_described_right(c) for c in outside)),
        _rate("outside: description right, above its limit", (_described_right(c) for c in _above(outside))),
    )


def _null_rates(nulls: Sequence[ScoredCase]) -> tuple[Rate, ...]:
    return (
        _rate("null: an effect named", (c.gap.verdict in NAMING for c in nulls)),
        _rate("null: a difference claimed", (c.gap.verdict not in QUIET for c in nulls)),
    )


def detection_limits(compared: Iterable[ScoredCase]) -> dict[str, float]:
    """Of every single effect, the median over its cases of the strength that what it achieves asks for."""
    found: dict[str, list[float]] = {}
    for c in compared:
        if c.truth.kind == "single":
            found.setdefault(c.label, []).append(c.best.effects[0].limit(c.effects[0].strength))
    medians = {name: float(np.median(limits)) for name, limits in sorted(found.items())}
    return {name: limit for name, limit in medians.items() if np.isfinite(limit)}


def parameter_errors(compared: Iterable[ScoredCase]) -> list[tuple[str, float]]:
    """Of all effects that were named rightly: EFFECT.PARAMETER and its error in standard errors."""
    errors = []
    for c in compared:
        if not c.right:
            continue
        for effect in c.effects:
            for field, true in effect.parameters.items():
                name = f"{effect.name}.{field}"
                if (found := c.gap.causes[0].parameters.get(name)) and found.standard_error > 0:
                    errors.append((name, (found.value - true) / found.standard_error))
    return errors


def confusion(compared: Iterable[ScoredCase]) -> tuple[list[str], list[str], np.ndarray]:
    """Rows: what is true (pairs left out); columns: what was named; and how often."""
    rows = [*DRAWABLE, *OUTSIDE, "null"]
    columns = [*DRAWABLE, "several effects", *Verdict]
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for c in compared:
        if c.truth.kind != "pair":
            said = c.gap.verdict if not c.named else c.named[0] if len(c.named) == 1 else "several effects"
            counts[rows.index(c.label), columns.index(said)] += 1
    return rows, columns, counts


def wilson(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share; all of it where nothing was counted."""
    if not of:
        return 0.0, 1.0
    between = binomtest(count, of).proportion_ci(0.95, method="wilson")
    return float(between.low), float(between.high)


def _not_mistaken(c: ScoredCase) -> bool:
    return c.gap.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED)


def _described_right(c: ScoredCase) -> bool:
    return description_right(c.truth.expected, c.gap.unknown)


def _rate(name: str, answers: Iterable[bool]) -> Rate:
    known = list(answers)
    return Rate(name, sum(known), len(known), wilson(sum(known), len(known)))
