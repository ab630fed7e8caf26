"""Differences between the records of one rig, and what they share.

Tolerances are one draw that all records share; a cause's parameters, and every effect of the library at every place,
are in turn each record's own. With their values v, covariance C and contrasts A between the records,

    chi2 = (Av)' (A C A')^-1 (Av) / TEMPERATURE

(Wald's test of homogeneity, tempered as hypotheses are). The smallest p-value, times the number of effects looked at
(Bonferroni), must be below `USUAL`; that effect then stands in the rig with each record's value, and the library is
looked through once more, and again with what was found second taken first.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2

from identify.gaps.decision.comparison import TEMPERATURE, Judged, of_this_record
from identify.gaps.decision.level_dependence import have_levels, level_dependence
from identify.gaps.decision_table import USUAL
from identify.gaps.residual.fit import Values
from identify.gaps.residual.likelihood import Reference
from identify.gaps.residual.record import Record
from identify.gaps.results import Between, Compared, Trend
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import applied, parameters_of, steps_of
from identify.gaps.search.pooled import Information, Linearised, Pooled, linearised, pooled
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.unmeasured_force import Value

LOOKED_AT = 3
"""Effects that promise most are fitted to every record."""
ROUNDS = 2
"""Linearisations of such a fit."""
APART = 2.0
"""Standard errors of its difference by which a value grows or falls from one record to the next."""


@dataclass(frozen=True)
class Standing:
    """Effects in the rigs of all records: values are each record's, `rigs` what they are put into."""

    rigs: tuple[Rig, ...]
    parts: tuple[Candidate, ...]
    values: Float[np.ndarray, "records parameters"]

    def rig(self, record: int) -> Rig:
        return applied(self.rigs[record], self.parts, self.values[record])

    @property
    def names(self) -> list[str]:
        return [p.name for p in self.parts]

    def columns(self, name: str) -> list[int]:
        """Columns of an effect's parameters."""
        return parameters_of(self.parts).places_of(name)

    def strong(self, name: str) -> list[int]:
        """Columns of an effect's strengths."""
        return [self.columns(name)[i] for i in self.parts[self.names.index(name)].parameters.strengths]

    def with_effect(self, part: Candidate, values: Float[np.ndarray, "records own"]) -> "Standing":
        """Standing effects with these values of one, which is there already or is added."""
        if part.name in self.names:
            return self.put(slice(None), self.columns(part.name), values)
        return replace(self, parts=(*self.parts, part), values=np.concatenate([self.values, values], axis=1))

    def put(self, record: int | slice, columns: Sequence[int], values: Float[np.ndarray, "*records own"]) -> "Standing":
        """Standing effects with other values in some columns of one record, or of all."""
        every = self.values.copy()
        every[record, columns] = values
        return replace(self, values=every)


@dataclass(frozen=True)
class Varied:
    """Parameters of standing effects, by their columns, that every record may have its own of."""

    standing: Standing
    columns: list[int]

    @property
    def own(self) -> Float[np.ndarray, "records varied"]:
        return self.standing.values[:, self.columns]

    @property
    def steps(self) -> Values:
        return steps_of(self.standing.parts)[self.columns]

    @property
    def bounds(self) -> tuple[Values, Values]:
        low, high = parameters_of(self.standing.parts).bounds
        return low[self.columns], high[self.columns]

    def said(self, record: int, looked: Linearised) -> Information:
        def build(values: Values) -> Rig:
            return self.standing.put(record, self.columns, values).rig(record)

        return looked.with_parameters(build, self.own[record], self.steps, self.bounds[1])

    def pooled(self, said: Sequence[Information]) -> Pooled:
        return pooled(said, self.steps, self.bounds, self.own[0], own=True)

    def moved(self, together: Pooled) -> "Varied":
        """Parameters at the pooled estimate, within the bounds."""
        values = np.clip(together.values.reshape(self.own.shape), *self.bounds)
        return Varied(self.standing.put(slice(None), self.columns, values), self.columns)


@dataclass(frozen=True)
class Test:
    """An effect with each record's own strength, fitted: log_p is the logarithm of the p-value of one for all."""

    part: Candidate
    varied: Varied
    cost: float
    log_p: float

    @property
    def values(self) -> Float[np.ndarray, "records own"]:
        return self.varied.standing.values[:, self.varied.standing.columns(self.part.name)]


@dataclass(frozen=True)
class _Compared:
    """Data that all comparisons of the same records share."""

    records: Sequence[Record]
    seen: Sequence[Reference]
    known: Sequence[Candidate]

    def linearised(self, standing: Standing, record: int) -> Linearised:
        return linearised(self.records[record], self.seen[record], standing.rig(record))

    def screened(self, standing: Standing, found: Sequence[str]) -> list[Test]:
        """Every effect but those found, linearised, the likeliest first; each at its best place."""
        tried = [(p, Varied(standing, standing.strong(p.name))) for p in standing.parts if p.name not in found]
        for part in self.known:
            for start in part.starts() if part.name not in standing.names else ():
                there = standing.with_effect(part, np.tile(start, (len(self.records), 1)))
                tried.append((part, Varied(there, there.strong(part.name))))
        said: list[list[Information]] = [[] for _ in tried]
        for k in range(len(self.records)):
            looked = self.linearised(standing, k)
            for rows, (_, one) in zip(said, tried, strict=True):
                with suppress(RigError):
                    rows.append(one.said(k, looked))
        best: dict[str, Test] = {}
        for rows, (part, one) in zip(said, tried, strict=True):
            if len(rows) == len(self.records):
                together = one.pooled(rows)
                if part.name not in best or together.cost < best[part.name].cost:
                    best[part.name] = Test(part, one.moved(together), together.cost, _log_p(together, one.own.shape))
        return sorted(best.values(), key=lambda t: t.cost)

    def fitted(self, one: Varied) -> tuple[Varied, Pooled]:
        """Each record's own values, linearised about themselves."""

        def refit(varied: Varied) -> tuple[Varied, Pooled]:
            together = self.pooled(varied)
            return varied.moved(together), together

        return refit_until_settled(refit(one), lambda estimate: refit(estimate[0]), rounds=ROUNDS - 1)

    def pooled(self, one: Varied) -> Pooled:
        """Pooled information of all records on these values, each linearised about its own."""
        return one.pooled([one.said(k, self.linearised(one.standing, k)) for k in range(len(self.records))])

    def most_different(self, standing: Standing, found: Sequence[str]) -> tuple[Test | None, int]:
        """The likeliest effect of those that differ beyond chance, and the number looked at."""
        tests = self.screened(standing, found)
        least = float(np.log(USUAL / max(1, len(tests))))
        different = []
        for test in [t for t in tests if t.log_p < least][:LOOKED_AT]:
            with suppress(RigError):
                varied, together = self.fitted(test.varied)
                different.append(Test(test.part, varied, together.cost, _log_p(together, varied.own.shape)))
        return min((t for t in different if t.log_p < least), key=lambda t: t.cost, default=None), len(tests)


def differences(
    records: Sequence[Record],
    seen: Sequence[Reference],
    cause: Judged | None,
    known: Sequence[Candidate],
    names: Sequence[str],
    levels_n: Sequence[float],
    progress: Callable[[float], None] = lambda _: None,
) -> Between:
    """Differences between records beside a cause, or the nominal rig; `known` are the effects at all places,
    `names` and `levels_n` those of the records, the latter by the root mean square of the force.

    Left out are effects that only a spectrum tells, and those that every record has its own of (a tone's phase).
    """
    compared = _Compared(records, seen, [c for c in known if not (c.kind.stochastic or c.kind.of_a_record)])
    begun = _standing(records, cause)
    tests, looked_at = _different(compared, begun, progress)
    order = np.argsort(levels_n) if have_levels(levels_n) else None
    varied, differing = _values_apart(compared, begun, tests, looked_at, order)
    shared = _values_shared(compared, varied.standing, [p.name for p in begun.parts], [t.part.name for t in tests])
    progress(1.0)
    rigs = [varied.standing.rig(k) for k in range(len(records))]
    highest_hz = max(record.highest_hz for record in records)
    return Between(
        records=tuple(names),
        cause=tuple(_rows(shared[0], shared[1], 0)) if shared else (),
        cause_p_value=float(np.exp(_log_p(shared[1], shared[0].own.shape))) if shared else None,
        differing=tuple(differing),
        looked_at=looked_at,
        level_dependence=level_dependence(rigs, levels_n, differing, highest_hz),
    )


def _different(compared: _Compared, begun: Standing, progress: Callable[[float], None]) -> tuple[tuple[Test, ...], int]:
    """Effects, two at most, that differ between the records, and the number looked at.

    What is found first may be another effect beside what is found second: then it is looked for again.
    """
    first, looked_at = compared.most_different(begun, ())
    progress(0.3)
    if first is None:
        return (), looked_at
    second, _ = compared.most_different(first.varied.standing, [first.part.name])
    progress(0.6)
    if second is None:
        return (first,), looked_at
    alone = begun.with_effect(second.part, second.values)
    again, _ = compared.most_different(alone, [second.part.name])
    return (second, again) if again and again.cost < second.cost else (first, second), looked_at


def _values_apart(
    compared: _Compared,
    begun: Standing,
    tests: Sequence[Test],
    looked_at: int,
    order: Int[np.ndarray, " records"] | None,
) -> tuple[Varied, list[Compared]]:
    """Each record's own strengths of the effects that differ, fitted together, and their rows of the answer; `order` is
    that of the records' levels, if they have several."""
    standing = begun
    for test in tests:
        standing = standing.with_effect(test.part, test.values)
    varied = Varied(standing, [c for test in tests for c in standing.strong(test.part.name)])
    if not tests:
        return varied, []
    varied, together = compared.fitted(varied)
    return varied, _rows(varied, together, looked_at, order)


def _values_shared(
    compared: _Compared, standing: Standing, of_cause: Sequence[str], differing: Sequence[str]
) -> tuple[Varied, Pooled] | None:
    """Each record's own values of the cause's effects that do not differ; None if there are none."""
    names = [name for name in of_cause if name not in differing]
    varied = Varied(standing, [c for name in names for c in standing.columns(name)])
    return (varied, compared.pooled(varied)) if varied.columns else None


def _standing(records: Sequence[Record], cause: Judged | None) -> Standing:
    """The cause's effects, if each record can have its own values of them; else they are in the rigs as they are."""
    parts = cause.hypothesis.parts if cause else ()
    if cause and not any(p.kind.stochastic or p.kind.of_a_record for p in parts):
        return Standing(tuple(r.rig for r in records), parts, np.tile(cause.hypothesis.values, (len(records), 1)))
    rigs = tuple(of_this_record(r, cause.hypothesis) if cause else r.rig for r in records)
    return Standing(rigs, (), np.zeros((len(records), 0)))


def _log_p(together: Pooled, shape: tuple[int, ...], parameter: int | None = None) -> float:
    """The logarithm of the p-value that the records have one value: of all parameters varied, or of one."""
    records, size = shape
    keep = np.eye(size) if parameter is None else np.eye(size)[[parameter]]
    contrast = np.kron(np.diff(np.eye(records), axis=0), keep)
    apart = contrast @ together.values
    square = apart @ np.linalg.solve(contrast @ together.covariance @ contrast.T, apart)
    return float(chi2.logsf(square / TEMPERATURE, len(contrast)))


def _rows(
    one: Varied, together: Pooled, among: int, order: Int[np.ndarray, " records"] | None = None
) -> list[Compared]:
    """Rows of the answer; `among`: the number of effects looked at, or 0; `order`: that of the levels."""
    records, size = one.own.shape
    every = [(part, p) for part in one.standing.parts for p in part.parameters]
    rows = []
    for i, column in enumerate(one.columns):
        part, about = every[column]
        own = np.arange(records) * size + i
        covariance = TEMPERATURE * together.covariance[np.ix_(own, own)]
        values = together.values[own]
        centred = np.eye(records) - 1 / records
        errors = np.sqrt(np.maximum(np.diag(centred @ covariance @ centred), 0.0))
        rows.append(
            Compared(
                parameter=f"{part.kind.name}.{about.name}",
                place=", ".join(target or "all" for target in part.place.values()),
                values=tuple(Value(float(v), float(e), about.unit) for v, e in zip(values, errors, strict=True)),
                p_value=min(1.0, max(1, among) * float(np.exp(_log_p(together, one.own.shape, i)))),
                trend=_trend(values, covariance) if among else "none",
                by_level="none" if order is None else _trend(values[order], covariance[np.ix_(order, order)]),
            )
        )
    return rows


def _trend(values: Float[np.ndarray, " records"], covariance: Float[np.ndarray, "records records"]) -> Trend:
    """Over the records in their order; a step within its error is neither up nor down."""
    steps = np.diff(values)
    errors = np.sqrt(np.diag(np.diff(np.diff(covariance, axis=0), axis=1)))
    clear = steps[np.abs(steps) > APART * errors]
    if clear.size and np.all(clear > 0):
        return "grows"
    return "falls" if clear.size and np.all(clear < 0) else "differs"
