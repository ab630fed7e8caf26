"""Probabilities of hypotheses judged on the validation record, the names that follow, what they leave, the verdict."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identify.gaps.decision.bounds import Difference, share_bounds
from identify.gaps.decision.comparison import PRIOR_UNKNOWN, TEMPERATURE, Judged, probabilities, removed
from identify.gaps.decision.null_reference import NullReference, p_value
from identify.gaps.decision_table import DIFFERS, USUAL, Evidence, Strength, Verdict
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import Matters
from identify.gaps.search.attached import ATTACHED
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis
from identify.gaps.unmeasured_force.force import SAME_M
from identify.gaps.unmeasured_force.location import ForcePlace
from identify.pages.wording import COVERED
from rig.model.description import Rig

UNKNOWN_PLACES = 100
"""An unknown force may act at so many places that a record tells apart (bodies of some metres, 20 mm each)."""
ALIKE = 0.05
"""Hypotheses that are likelier than this beside the best one cannot be told apart from it."""
HELPS = (Verdict.SMALL, Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED)
"""Verdicts with which named effects correct the rig."""


@dataclass(frozen=True)
class Weighed:
    """A hypothesis judged on the validation record, and its probability."""

    judged: Judged
    probability: float


@dataclass(frozen=True)
class Rivals:
    """-2 ln p of the validation record with the unmeasured force that explains it best in the nominal rig; of the
    hypothesis `accompanied`, with the one that explains best what it leaves. None where none was looked for."""

    in_nominal: float | None = None
    accompanied: Judged | None = None
    in_accompanied: float | None = None


def nominal_of(ranked: Sequence[Judged]) -> Judged:
    """The nominal rig among hypotheses."""
    return next(j for j in ranked if not j.hypothesis.parts)


@dataclass(frozen=True)
class Decision:
    """The evidence with its verdict, the hypotheses, likeliest first, and the probability of something unmeasured.

    named is the hypothesis of the named effects alone, if it was judged, else the likeliest one with effects.
    """

    evidence: Evidence
    weighed: tuple[Weighed, ...]
    unknown: float
    named: Judged | None

    @property
    def verdict(self) -> Verdict:
        return self.evidence.verdict

    @property
    def nothing(self) -> Judged:
        """The nominal rig."""
        return nominal_of([w.judged for w in self.weighed])

    @property
    def probability_nothing(self) -> float:
        return next(w.probability for w in self.weighed if w.judged is self.nothing)

    @property
    def helps(self) -> bool:
        """True if effects are named that correct the rig."""
        return self.verdict in HELPS and bool(self.evidence.named) and not self.evidence.vetoed

    @property
    def likeliest_rig(self) -> Rig | None:
        """Rig with the named effects and what was fitted beside them, whatever the verdict."""
        return self.named.corrected if self.named else None

    @property
    def corrected_rig(self) -> Rig | None:
        return self.likeliest_rig if self.helps else None

    @property
    def after(self) -> Misfit:
        """Misfit with the named effects."""
        return self.named.misfit if self.named else self.nothing.misfit

    @property
    def left_to_describe(self) -> Misfit:
        """Misfit of the named effects if they explain a part, else of the nominal rig."""
        return self.after if self.verdict == Verdict.PARTLY_EXPLAINED else self.nothing.misfit


def decided(
    ranked: Sequence[Judged],
    difference: Difference,
    null_reference: NullReference,
    matters: Matters,
    rivals: Rivals | None = None,
    vetoed: bool = False,
) -> Decision:
    """Decision by hypotheses judged on the validation record, likeliest first.

    Something unmeasured is a rival of effects; as their companion, it makes them as likely as they are alone or with
    it. Where the records differ from the nominal rig and the one that validates alone does not show it, it tells too
    little to judge by: then the record that was fitted counts too.
    """
    rivals, nominal = rivals or Rivals(), nominal_of(ranked)
    held_back_shows = difference.p_value >= DIFFERS or p_value(null_reference, nominal.misfit) < USUAL
    scores = [j.log_posterior if held_back_shows else j.log_posterior_of_both for j in ranked]
    for k, judged in enumerate(ranked):
        if judged is rivals.accompanied:
            with_force = _log_posterior(judged.log_prior, rivals.in_accompanied)
            scores[k] = float(np.logaddexp(scores[k], with_force))
    scores.append(_log_posterior(0.0, rivals.in_nominal))
    *shares, unknown = (float(p) for p in probabilities(np.array(scores)))
    weighed = tuple(Weighed(*pair) for pair in sorted(zip(ranked, shares, strict=True), key=lambda pair: -pair[1]))
    likeliest = next((w.judged for w in weighed if w.judged.hypothesis.parts), None)
    strengths = strengths_of(likeliest.hypothesis, weighed) if likeliest else ()
    named = _named(likeliest, strengths, ranked) if likeliest else None
    after = named or nominal
    contacts = [quantity.name for quantity in difference.contacts]
    evidence = Evidence(
        p_value=difference.p_value,
        quantities=difference.quantities,
        strengths=strengths,
        p_value_after=p_value(null_reference, after.misfit),
        quantities_after=share_bounds(after.misfit, contacts, matters),
        removed=removed(nominal.misfit, after.without, after.misfit, matters),
        vetoed=vetoed,
        held_back_shows=held_back_shows,
    )
    return Decision(evidence, weighed, unknown, named)


def strengths_of(hypothesis: Hypothesis, weighed: Sequence[Weighed]) -> tuple[Strength, ...]:
    """The strength of every effect of a hypothesis, and how probably it, or a look-alike in its place, is there.

    Of several strengths the one that is off its neutral value by most standard errors.
    """
    strengths, first = [], 0
    errors = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    for part in hypothesis.parts:
        columns = range(first, first := first + len(part.parameters))
        look_alikes = _look_alikes(hypothesis, part, weighed)
        neutral_values = {k: p.neutral for k, p in zip(columns, part.parameters, strict=True) if p.neutral is not None}
        significance = {k: abs(hypothesis.values[k] - x) / max(errors[k], 1e-300) for k, x in neutral_values.items()}
        k = max(significance, key=lambda column: float(significance[column]))
        value, half = float(hypothesis.values[k]), float(COVERED * errors[k])
        names = {part.name, *look_alikes}
        probability = sum(w.probability for w in weighed if names & set(w.judged.hypothesis.key))
        interval = (value - half, value + half)
        strengths.append(Strength(part.name, probability, interval, float(neutral_values[k]), look_alikes))
    return tuple(strengths)


def strengths_exclude_neutral(hypothesis: Hypothesis) -> bool:
    """True if a hypothesis has effects, and the 95 % interval of every strength excludes its neutral value."""
    strengths = strengths_of(hypothesis, ())
    return bool(strengths) and all(not s.interval_95[0] <= s.neutral <= s.interval_95[1] for s in strengths)


def _look_alikes(hypothesis: Hypothesis, part: Candidate, weighed: Sequence[Weighed]) -> tuple[str, ...]:
    """Candidates that stand in an effect's place in other hypotheses that are likely too, by their names."""
    key = Counter(hypothesis.key)
    look_alikes: list[str] = []
    for other in (w.judged.hypothesis for w in weighed if w.probability > ALIKE):
        more, less = Counter(other.key) - key, key - Counter(other.key)
        if less == Counter([part.name]) and more.total() == 1:
            look_alikes += more
    return tuple(dict.fromkeys(look_alikes))


def _named(likeliest: Judged, strengths: Sequence[Strength], ranked: Sequence[Judged]) -> Judged:
    """The hypothesis of the named effects alone; the likeliest one where none is named, or that was not judged."""
    key = tuple(sorted(s.effect for s in strengths if s.is_named))
    return next((j for j in ranked if key and j.hypothesis.key == key), likeliest)


def acts_where_they_do(force: ForcePlace, believed: Rig, rig: Rig) -> bool:
    """True if an unmeasured force acts where effects do: at what they attached, at a contact or in a sensor that they
    changed. One force of another law is no companion of theirs, but their rival."""
    if force.kind == "sensor":
        changed = [b.name for a, b in zip(believed.sensors, rig.sensors, strict=True) if a != b]
        return changed == [force.sensor]
    there = [c.at for c, d in zip(rig.contacts, believed.contacts, strict=True) if c.law != d.law]
    for kind in ATTACHED:
        there += [one.station for one in getattr(rig, kind)[len(getattr(believed, kind)) :]]
    return any(
        one.body == other.body and abs(one.position_m - other.position_m) <= SAME_M
        for one in force.stations
        for other in there
    )


def _log_posterior(log_prior: float, cost: float | None) -> float:
    """Log posterior of an unmeasured force, which may be at any of `UNKNOWN_PLACES`; without any: impossible."""
    if cost is None:
        return -np.inf
    return log_prior + float(np.log(PRIOR_UNKNOWN / UNKNOWN_PLACES)) - cost / (2 * TEMPERATURE)
