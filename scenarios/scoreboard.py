"""What a diagnosis found against the sealed answers: shares of right answers with their intervals."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Literal

import msgspec
import numpy as np
from scipy.stats import binomtest, quantile_test

from scenarios.worlds.drawing import DRAWABLE
from scenarios.worlds.outside import OUTSIDE
from scenarios.worlds.truth import Case, EffectTruth

PLACES = ("contact", "body", "beam", "sensor")
WITHIN = 0.1
"""A place on a body is right within this share of its length."""
OVERLAP = 0.5
"""A band is right if what it shares with the true one is this much of what both cover."""


class Value(msgspec.Struct, frozen=True):
    """A fitted parameter."""

    value: float
    standard_error: float
    unit: str = "1"


class Cause(msgspec.Struct, frozen=True):
    """Effects that together explain the gap; parameters and places are named EFFECT.FIELD."""

    effects: tuple[str, ...]
    probability: float
    parameters: dict[str, Value] = {}
    places: dict[str, str] = {}


class Closure(msgspec.Struct, frozen=True):
    """The gap on the validation recording; no fraction where the gap was at the floor before."""

    before: float
    floor: float
    after: float
    closed_fraction: float | None = None
    interval_95: tuple[float, float] | None = None


class Where(msgspec.Struct, frozen=True):
    """Each with its share of the gap."""

    channels: dict[str, float] = {}
    positions_m: Any = None
    contact_state: Any = None
    band_hz: Any = None


class Diagnosis(msgspec.Struct, frozen=True):
    """One case diagnosed; causes likeliest first, `equivalent` classes of effects that cannot be told apart."""

    verdict: Literal["no_gap", "effect", "none_of_these"]
    causes: tuple[Cause, ...] = ()
    equivalent: tuple[tuple[str, ...], ...] = ()
    where: Where = Where()
    closure: Closure | None = None
    cpu_s: float = 0.0


class Rate(msgspec.Struct, frozen=True):
    """So many of so many, with the 95 % interval of Wilson."""

    name: str
    count: int
    of: int
    interval_95: tuple[float, float]


class Score(msgspec.Struct, frozen=True):
    """The scoreboard; limits are the detection limits, the median over an effect's cases, in default magnitudes."""

    rates: tuple[Rate, ...]
    median_closed_fraction: float | None
    closed_interval_95: tuple[float, float] | None
    closed_cases: int
    share_of_true_closure: float | None
    cpu_s_median: float
    cpu_s_largest: float
    limits: dict[str, float]


@dataclass(frozen=True)
class Compared:
    """An answer beside what was found."""

    truth: Case
    found: Diagnosis

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(effect.name for effect in self.truth.effects)

    @property
    def label(self) -> str:
        """What is true, in one word."""
        return self.truth.kind if self.truth.kind in ("null", "pair") else self.names[0]

    @property
    def named(self) -> tuple[str, ...]:
        """The effects of the likeliest cause, none unless the verdict is an effect."""
        return self.found.causes[0].effects if self.found.verdict == "effect" and self.found.causes else ()

    @property
    def exact(self) -> bool:
        return self.truth.kind != "outside" and bool(self.names) and sorted(self.named) == sorted(self.names)

    @property
    def right(self) -> bool:
        """Whether the named effects are the true ones, or each shares a class of `equivalent` with one of them."""
        return self.truth.kind != "outside" and bool(self.names) and self._alike(self.named, self.names)

    def _alike(self, named: Sequence[str], true: Sequence[str]) -> bool:
        def same(one: str, other: str) -> bool:
            return one == other or any(one in c and other in c for c in self.found.equivalent)

        return len(named) == len(true) and any(
            all(same(n, t) for n, t in zip(order, true, strict=True)) for order in permutations(named)
        )


class Best(msgspec.Struct, frozen=True):
    """What the true effects of a case achieve: the size of the gap on the validation record without and with them.

    gain is by how much they lower the cost on the fit record. `needed` is what it must exceed to be no null's: below it
    an effect is below its detection limit.
    """

    before: float
    after: float
    gain: float
    needed: float

    @property
    def detectable(self) -> bool:
        return self.gain > self.needed

    def limit(self, strength: float) -> float:
        """The strength of the limit, by that of the case: a gain grows with its square."""
        return float(strength * np.sqrt(self.needed / self.gain)) if self.gain > 0 else np.inf


def scored(compared: Sequence[Compared], best: Mapping[str, Best]) -> Score:
    """The scoreboard of all cases; `best` is what the truth achieves, by case."""
    by_kind = {kind: [c for c in compared if c.truth.kind == kind] for kind in ("null", "single", "pair", "outside")}
    singles, pairs = by_kind["single"], by_kind["pair"]
    placed = [c for c in singles if c.exact and place_fields(c.truth.effects[0])]
    sensors = [c for c in singles if c.names[0].startswith("sensor_") and c.found.where.channels]
    rates = (
        _rate("single effect right", (c.right for c in singles)),
        _rate(
            "single effect right, above its limit",
            (c.right for c in singles if c.truth.case in best and best[c.truth.case].detectable),
        ),
        _rate("single effect named itself", (c.exact for c in singles)),
        _rate("false alarm without effect", (c.found.verdict != "no_gap" for c in by_kind["null"])),
        _rate("outside the library rejected", (c.found.verdict == "none_of_these" for c in by_kind["outside"])),
        _rate("outside the library mislabelled", (c.found.verdict == "effect" for c in by_kind["outside"])),
        _rate("both effects of a pair", (c.right for c in pairs)),
        _rate("at least one effect of a pair", (bool({*c.named} & {*c.names}) for c in pairs)),
        _rate("place right, of those named", (place_right(c) for c in placed)),
        _rate("faulty sensor first among channels", (_first_channel_right(c) for c in sensors)),
        _rate("parameter within its 95 % interval", (abs(z) < 1.96 for _, z in parameter_errors(compared))),
    )
    right = [(c, c.found.closure) for c in compared if c.right and c.found.closure]
    closed = [f.closed_fraction for _, f in right if f.closed_fraction is not None]
    shares = [
        (f.before - f.after) / (f.before - best[c.truth.case].after)
        for c, f in right
        if f.closed_fraction is not None and c.truth.case in best
    ]
    between = quantile_test(closed, p=0.5).confidence_interval(0.95) if len(closed) > 1 else None
    return Score(
        rates=rates,
        median_closed_fraction=float(np.median(closed)) if closed else None,
        closed_interval_95=(float(between.low), float(between.high)) if between else None,
        closed_cases=len(closed),
        share_of_true_closure=float(np.median(shares)) if shares else None,
        cpu_s_median=float(np.median([c.found.cpu_s for c in compared])),
        cpu_s_largest=max(c.found.cpu_s for c in compared),
        limits=detection_limits(singles, best),
    )


def detection_limits(singles: Sequence[Compared], best: Mapping[str, Best]) -> dict[str, float]:
    """Of every effect the median over its cases of which is known what the truth achieves."""
    known = [c for c in singles if c.truth.case in best]
    names = sorted({c.label for c in known})
    by_name = {n: [best[c.truth.case].limit(c.truth.strengths[0]) for c in known if c.label == n] for n in names}
    return {name: float(np.median(limits)) for name, limits in by_name.items()}


def parameter_errors(compared: Iterable[Compared]) -> list[tuple[str, float]]:
    """Of every effect that was named itself: EFFECT.PARAMETER and its error in standard errors."""
    errors = []
    for c in compared:
        if not c.exact:
            continue
        for effect in c.truth.effects:
            for field, true in effect.parameters.items():
                name = f"{effect.name}.{field}"
                if found := c.found.causes[0].parameters.get(name):
                    errors.append((name, (found.value - true) / found.standard_error))
    return errors


def place_fields(effect: EffectTruth) -> tuple[str, ...]:
    """The fields that say where the effect acts; a clamp and all bodies at once have no choice."""
    if effect.name == "clamp_compliance":
        return ()
    chosen = [field for field in PLACES if effect.place.get(field, "all") != "all"]
    return (*chosen, *(field for field in ("relative_position", "low_hz") if field in effect.parameters))


def place_right(c: Compared) -> bool:
    """Whether the likeliest cause of a single effect acts where the truth does, in every field that says so."""
    effect, cause = c.truth.effects[0], c.found.causes[0]

    def found(field: str) -> float:
        value = cause.parameters.get(f"{effect.name}.{field}")
        return value.value if value else float("nan")

    def field_right(field: str) -> bool:
        if field == "low_hz":
            low, high = (effect.parameters[f] for f in ("low_hz", "high_hz"))
            shared = min(high, found("high_hz")) - max(low, found("low_hz"))
            return shared / (max(high, found("high_hz")) - min(low, found("low_hz"))) >= OVERLAP
        if field == "relative_position":
            return abs(found(field) - effect.parameters[field]) <= WITHIN
        return cause.places.get(f"{effect.name}.{field}") == effect.place[field]

    return all(field_right(field) for field in place_fields(effect))


def confusion(compared: Iterable[Compared]) -> tuple[list[str], list[str], np.ndarray]:
    """Rows: what is true (pairs left out); columns: what was named; and how often."""
    rows = [*DRAWABLE, *OUTSIDE, "null"]
    columns = [*DRAWABLE, "two effects", "none_of_these", "no_gap"]
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for c in compared:
        if c.truth.kind != "pair":
            said = c.found.verdict if not c.named else c.named[0] if len(c.named) == 1 else "two effects"
            counts[rows.index(c.label), columns.index(said)] += 1
    return rows, columns, counts


def wilson(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share; all of it where nothing was counted."""
    if not of:
        return 0.0, 1.0
    between = binomtest(count, of).proportion_ci(0.95, method="wilson")
    return float(between.low), float(between.high)


def _first_channel_right(c: Compared) -> bool:
    channels = c.found.where.channels
    return max(channels, key=lambda name: channels[name]) == c.truth.effects[0].place.get("sensor")


def _rate(name: str, answers: Iterable[bool]) -> Rate:
    known = list(answers)
    return Rate(name, sum(known), len(known), wilson(sum(known), len(known)))
