"""Structure of gap.json: the result of a diagnosis."""

import math
from collections import Counter
from collections.abc import Iterable
from typing import Literal

import msgspec

from identify.gaps.decision_table import (
    DIFFERENCE_P_VALUE,
    NAMED_PROBABILITY,
    USUAL_P_VALUE,
    Bounded,
    Evidence,
    Strength,
    Verdict,
)
from identify.gaps.rollout.results import Rollout
from rig.limits import SCHEMA_VERSION
from rig.model.unmeasured_force import UnmeasuredForce, Value

SAME_EXPERIMENT = "record the same again"
"""Words of the reference experiment, with which others are compared."""


class UnexplainedShares(msgspec.Struct, frozen=True, kw_only=True):
    """Shares of the validation record that a rig does not explain, beyond the sensors' noise.

    share is the unexplained share of the acceleration's root mean square, contact_shares that of each contact force's;
    p_value is the probability that tolerances and noise alone leave as much on this record, that of all records being
    in `Evidence`; largest_pull is the largest deviation of a toleranced quantity, in its stated standard deviations.
    """

    share: float
    contact_shares: dict[str, float]
    p_value: float
    largest_pull: float = 0.0


class Cause(msgspec.Struct, frozen=True, kw_only=True):
    """Set of effects that together explain the difference, wholly or in part.

    words state each effect with value and place; strengths hold the probability of each. parameters and places are
    named EFFECT.FIELD, those of a second effect of one kind EFFECT_2.FIELD. explained is the share of the difference
    that the set removes on the validation record: 1 - size with it / size without it, with size as `Matters.times` has
    it and the nuisance parameters of the fit with the set. The probability follows from log_prior and minus_two_log.
    """

    effects: tuple[str, ...]
    words: tuple[str, ...]
    strengths: tuple[Strength, ...]
    probability: float
    parameters: dict[str, Value]
    places: dict[str, str]
    explained: float
    interval_95: tuple[float, float]
    left: UnexplainedShares
    log_prior: float
    minus_two_log: float

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the effects in the keys of parameters and places."""
        return unique_effect_labels(self.effects)

    @property
    def named(self) -> tuple[str, ...]:
        """Words of the effects that may be named."""
        return tuple(words for words, strength in zip(self.words, self.strengths, strict=True) if strength.is_named)


def unique_effect_labels(effects: Iterable[str]) -> tuple[str, ...]:
    """Unique names of effects: "added_mass", "added_mass_2"."""
    counts = Counter[str]()
    labels = []
    for effect in effects:
        counts[effect] += 1
        labels.append(effect if counts[effect] == 1 else f"{effect}_{counts[effect]}")
    return tuple(labels)


class Criteria(msgspec.Struct, frozen=True):
    """Row of the decision table: a difference is certain; all that matters is bounded; the named effects (as
    EFFECT:PLACE); what these leave is bounded or usual."""

    differs: bool
    bounded: bool
    named: tuple[str, ...]
    enough: bool


class Share(msgspec.Struct, frozen=True):
    """Share of the mismatch in an interval of time or frequency."""

    begin: float
    end: float
    share: float


class Band(msgspec.Struct, frozen=True, kw_only=True):
    """Unexplained shares of the acceleration's root mean square in a frequency band: with the nominal rig, with the
    likeliest cause, and the upper 95 % limit of the null simulations.

    motion_share is the root mean square of the acceleration in the band over that of the whole motion.
    """

    low_hz: float
    high_hz: float
    before: float
    after: float
    usual: float
    motion_share: float = 1.0


class ResidualMap(msgspec.Struct, frozen=True):
    """Shares of the mismatch over relative displacement (rows) and velocity (columns) of a contact, with cell edges."""

    eta_m: tuple[float, ...]
    rate_m_per_s: tuple[float, ...]
    share: tuple[tuple[float, ...], ...]


class Attribution(msgspec.Struct, frozen=True, kw_only=True):
    """Location of the mismatch, as shares of a mean square; those of each field sum to one.

    surface is the share by cells of relative displacement and velocity of each contact; without contacts, by those of
    displacement and velocity of each single mass.
    """

    channels: dict[str, float] = {}
    modal_equations: dict[str, float] = {}
    positions_m: dict[str, dict[float, float]] = {}
    """Share by body and station, metres from the left end of the body."""
    band_hz: tuple[Share, ...] = ()
    contact_state: dict[str, float] = {}
    time_s: tuple[Share, ...] = ()
    surface: dict[str, ResidualMap] = {}
    parts: dict[str, float] = {}
    """Share of the linear residual and of the law of each contact."""


class Matters(msgspec.Struct, frozen=True):
    """Thresholds, set by the user, below which a difference does not matter: shares of the root mean square of the
    acceleration and of a contact force.
    """

    motion: float = 5e-3
    contact: float = 3e-2

    def times(self, share: float, contact_shares: Iterable[float]) -> float:
        """Size of a mismatch, sqrt((share / motion)^2 + sum over contacts (share / contact)^2); it matters from 1."""
        return math.hypot(share / self.motion, *(contact_share / self.contact for contact_share in contact_shares))


Trend = Literal["grows", "falls", "differs", "none"]


class ParameterByRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Estimates of a parameter (EFFECT.FIELD, at a place) from each record by itself, in the order of the records.

    Standard errors are those of a value's deviation from the mean, without the tolerances that all records share.
    p_value tests one value for all records; trend is "none" where the values differ by chance; by_level is the trend in
    the order of the records' forces, "none" where they are of one level.
    """

    parameter: str
    place: str
    values: tuple[Value, ...]
    p_value: float
    trend: Trend
    by_level: Trend = "none"


class LevelDependence(msgspec.Struct, frozen=True, kw_only=True):
    """Change of the mode that changes most between the lowest and the highest level of force (root mean square, N).

    Given where every difference between the records follows the level; changes are relative to the lowest level.
    Standard errors are zero where the change is at the end of what the rig allows.
    """

    lowest_n: float
    highest_n: float
    body: str
    frequency_hz: float
    frequency_change: float
    damping_change: float
    frequency_change_standard_error: float = 0.0
    damping_change_standard_error: float = 0.0


class RecordDifferences(msgspec.Struct, frozen=True, kw_only=True):
    """Differences between the records, the validation record among them.

    cause holds the parameters of the likeliest cause that do not differ, with the p-value of one value for all;
    differing those of at most two effects, at all places, that differ beyond chance, with p-values times the number
    of effects tested, looked_at (Bonferroni).
    """

    records: tuple[str, ...]
    """Number and force (root mean square) of each record, and which of them validates."""
    cause: tuple[ParameterByRecord, ...]
    cause_p_value: float | None
    differing: tuple[ParameterByRecord, ...]
    looked_at: int
    level_dependence: LevelDependence | None = None


class NextExperiment(msgspec.Struct, frozen=True):
    """Further recording, with the expected gain in the log odds (natural) of the true one of the two likeliest causes,
    or of the likeliest cause and the nominal rig, against the other."""

    words: str
    log_odds: float


Analysis = Literal[
    "unmeasured_force",
    "clearance_modulation",
    "force_description",
    "between_records",
    "next_experiment",
    "attribution",
    "rollout",
    "ring_friction",
    "strain_gauges",
]


class FailedAnalysis(msgspec.Struct, frozen=True):
    """Side analysis that could not be made, and the reason. The verdict does not rest on it."""

    analysis: Analysis
    reason: str


class Conventions(msgspec.Struct, frozen=True):
    """Probabilities by which every diagnosis decides, those of its intervals and one-sided bounds, and the share of its
    power that the band of an unmeasured force holds."""

    difference_p_value: float = DIFFERENCE_P_VALUE
    usual_p_value: float = USUAL_P_VALUE
    named_probability: float = NAMED_PROBABILITY
    interval: float = 0.95
    bound: float = 0.975
    force_band: float = 0.9


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """Difference between the nominal rig and the records, judged on the record that was not fitted.

    causes are the named effects, then the likeliest sets; the rest of probability one is that of the nominal rig and of
    something unmeasured. The rollout is that of the first cause. not_seen holds the quantities that the records neither
    bound nor show; channel_faults the dead and clipped channels, which were left out.
    """

    verdict: Verdict
    criteria: Criteria
    evidence: Evidence
    """Numbers from which the verdict follows."""
    not_seen: tuple[Bounded, ...]
    rollout: Rollout | None = None
    """Comparison of predictions with and without the named effects; None where none is named."""
    ruled_out: tuple[tuple[str, ...], ...] = ()
    """Effects of likelier hypotheses, in words, that were set aside because they do not improve the prediction."""
    free_decay: bool = False
    """True if no force was measured."""
    before: UnexplainedShares
    after: UnexplainedShares
    """Shares with the first cause in the rig; equal to `before` where there is none."""
    matters: Matters
    conventions: Conventions = Conventions()
    causes: tuple[Cause, ...]
    probability_nothing: float
    probability_unknown: float
    nothing_minus_two_log: float
    """-2 ln p of the nominal rig."""
    unknown_gain: float | None
    """Decrease of -2 ln p by an unmeasured force; None where none was looked for."""
    unknown: UnmeasuredForce | None
    bands: tuple[Band, ...]
    separate_by: tuple[str, ...]
    """Experiments that confirm or refute the likeliest effects, as "EFFECT: what to do"."""
    next_experiments: tuple[NextExperiment, ...] = ()
    """Proposed recordings, largest expected gain first, where two causes stay alike and proposals were asked for."""
    next_between: tuple[str, ...] = ()
    """The two causes that these recordings tell apart."""
    attribution: Attribution
    between: RecordDifferences | None = None
    """Given with more than two records."""
    channel_faults: dict[str, str] = {}
    notes: tuple[FailedAnalysis, ...] = ()


class Gap(Diagnosis, frozen=True, kw_only=True):
    """Diagnosis with its sentence: the content of gap.json."""

    sentence: str
    schema_version: int = SCHEMA_VERSION
