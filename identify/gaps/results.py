"""Structure of gap.json: the result of a diagnosis."""

import math
from collections import Counter
from collections.abc import Iterable
from typing import Literal

import msgspec

from identify.gaps.decision_table import Bounded, Evidence, Strength, Verdict
from identify.gaps.rollout.results import Rollout
from rig.model.unmeasured_force import UnmeasuredForce, Value

AGAIN = "record the same again"
"""The experiment beside which others are judged."""


class Left(msgspec.Struct, frozen=True, kw_only=True):
    """Shares of the validation record that a rig leaves, beyond the sensors' noise.

    share is the unexplained share of the acceleration's root mean square, contact_shares that of each contact force's;
    p_value how often tolerances and noise alone leave as much; largest_pull by how many of its stated standard
    deviations a tolerance is off at most.
    """

    share: float
    contact_shares: dict[str, float]
    p_value: float
    largest_pull: float = 0.0


class Cause(msgspec.Struct, frozen=True, kw_only=True):
    """Effects that together explain the difference, wholly or in part. parameters and places are named EFFECT.FIELD; of
    a second effect of one kind EFFECT_2.FIELD.

    words tell each effect with value and place, strengths how probable each is. explained is the share of the
    difference that they close on the validation record: 1 - size with them / size without, of what `Matters` measures,
    with the nuisance parameters as they are with them. log_prior and minus_two_log are what the probability is made of.
    """

    effects: tuple[str, ...]
    words: tuple[str, ...]
    strengths: tuple[Strength, ...]
    probability: float
    parameters: dict[str, Value]
    places: dict[str, str]
    explained: float
    interval_95: tuple[float, float]
    left: Left
    log_prior: float
    minus_two_log: float

    @property
    def labels(self) -> tuple[str, ...]:
        """The names by which parameters and places tell the effects apart."""
        return labels_of(self.effects)

    @property
    def named(self) -> tuple[str, ...]:
        """The words of the effects that may be named."""
        return tuple(w for w, strength in zip(self.words, self.strengths, strict=True) if strength.is_named)


def labels_of(effects: Iterable[str]) -> tuple[str, ...]:
    """The names of effects, each once: "added_mass", "added_mass_2"."""
    counts = Counter[str]()
    found = []
    for name in effects:
        counts[name] += 1
        found.append(name if counts[name] == 1 else f"{name}_{counts[name]}")
    return tuple(found)


class Criteria(msgspec.Struct, frozen=True):
    """The row of the decision table: whether there is a difference, all that matters is bounded, effects are named (as
    EFFECT:PLACE), and what they leave is bounded or usual."""

    differs: bool
    bounded: bool
    named: tuple[str, ...]
    enough: bool


class Share(msgspec.Struct, frozen=True):
    """The share of the gap that lies in an interval."""

    begin: float
    end: float
    share: float


class Band(msgspec.Struct, frozen=True, kw_only=True):
    """A band of frequencies: the unexplained share of the acceleration there with the believed rig, with the likeliest
    cause in it, and as nineteen of twenty null simulations stay below."""

    low_hz: float
    high_hz: float
    before: float
    after: float
    usual: float


class ResidualMap(msgspec.Struct, frozen=True):
    """Shares of the gap over relative displacement (rows) and velocity (columns) of a contact; edges of the cells."""

    eta_m: tuple[float, ...]
    rate_m_per_s: tuple[float, ...]
    share: tuple[tuple[float, ...], ...]


class Attribution(msgspec.Struct, frozen=True, kw_only=True):
    """Location of the mismatch: each list sums to one. surface is the share by cells of (relative displacement,
    velocity) of each contact; without contacts, of displacement and velocity of each single mass.
    """

    channels: dict[str, float] = {}
    modal_equations: dict[str, float] = {}
    positions_m: dict[str, dict[float, float]] = {}
    """By body: the station, metres from its left end, and its share."""
    band_hz: tuple[Share, ...] = ()
    contact_state: dict[str, float] = {}
    time_s: tuple[Share, ...] = ()
    surface: dict[str, ResidualMap] = {}
    parts: dict[str, float] = {}
    """Of the linear residual, and of each contact's law."""


class Figure(msgspec.Struct, frozen=True):
    """A figure that people know, of the measured record and of simulations with its force: believed and corrected."""

    name: str
    unit: str
    measured: float
    believed: float
    corrected: float
    by_chance: float
    """So far nineteen of twenty records of the believed rig lie from their mean, shaken by another such force."""


class Curve(msgspec.Struct, frozen=True):
    """A curve of the measured record beside those of simulations: believed and corrected."""

    name: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    measured: tuple[float, ...]
    believed: tuple[float, ...]
    corrected: tuple[float, ...]
    logarithmic: bool = False
    """Whether y is best drawn over decades."""


class Matters(msgspec.Struct, frozen=True):
    """Thresholds of what is too small to matter, as the user says: shares of the acceleration's and of a contact
    force's root mean square.
    """

    motion: float = 5e-3
    contact: float = 3e-2

    def times(self, share: float, contact_shares: Iterable[float]) -> float:
        """The size of a gap: sqrt((share / motion)^2 + sum over contacts of (share / contact)^2); 1 is what matters."""
        return math.hypot(share / self.motion, *(one / self.contact for one in contact_shares))


Trend = Literal["grows", "falls", "differs", "none"]


class Compared(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter (EFFECT.FIELD, at a place) as each record has it by itself, in the order of the records.

    Standard errors are those of a value beside the mean of all: the tolerances that all records share are not in them.
    p_value is that of one value for all; trend is "none" where nothing more than chance is seen, by_level the trend in
    the order of the records' forces, "none" where these are one level.
    """

    parameter: str
    place: str
    values: tuple[Value, ...]
    p_value: float
    trend: Trend
    by_level: Trend = "none"


class LevelDependence(msgspec.Struct, frozen=True, kw_only=True):
    """The mode that changes most between the lowest and the highest level, where all that differs follows the level.

    The levels are root mean squares of the force, N; the changes are relative to the lowest level.
    """

    lowest_n: float
    highest_n: float
    body: str
    frequency_hz: float
    frequency_change: float
    damping_change: float


class Between(msgspec.Struct, frozen=True, kw_only=True):
    """Differences between records, the validation record among them. cause: the parameters of the likeliest cause that
    do not differ, with the p-value of one value for all; differing: those of at most two effects, at all places, that
    differ beyond chance, with p-values times the number looked at (Bonferroni)."""

    records: tuple[str, ...]
    """Their numbers, forces (root mean square), and which of them validates."""
    cause: tuple[Compared, ...]
    cause_p_value: float | None
    differing: tuple[Compared, ...]
    looked_at: int
    level_dependence: LevelDependence | None = None


class NextExperiment(msgspec.Struct, frozen=True):
    """A further recording, and by how much (natural logarithm) it is expected to raise the odds of the true one of the
    two likeliest causes (or of one, and the believed rig) against the other."""

    words: str
    log_odds: float


Analysis = Literal[
    "unmeasured_force",
    "clearance_modulation",
    "force_description",
    "between_records",
    "response_comparison",
    "next_experiment",
    "attribution",
    "rollout",
]


class Note(msgspec.Struct, frozen=True):
    """A side analysis that could not be made, on which the verdict does not rest, and why."""

    analysis: Analysis
    reason: str


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """Diagnosis: difference of the nominal rig and the records, judged on the one that was not fitted.

    causes: the named effects first, then the likeliest; what their probabilities lack of one is that of the nominal rig
    and of something unmeasured. The response comparison and the rollout are of the first. not_seen is what the records
    neither bound nor show. channel_faults names dead and clipped channels, which were left out.
    """

    verdict: Verdict
    criteria: Criteria
    evidence: Evidence
    """All that the verdict follows from."""
    not_seen: tuple[Bounded, ...]
    rollout: Rollout | None = None
    """Whether the motion is predicted better with the named effects; None where none is named."""
    ruled_out: tuple[tuple[str, ...], ...] = ()
    """Effects of likelier hypotheses, in words, with which it is predicted no better, so that others are named."""
    free_decay: bool = False
    """Whether no force was measured."""
    before: Left
    after: Left
    """With the first cause in the rig; as before where there is none."""
    matters: Matters
    causes: tuple[Cause, ...]
    probability_nothing: float
    probability_unknown: float
    nothing_minus_two_log: float
    """Of the nominal rig."""
    unknown_gain: float | None
    """By how much an unmeasured force lowers it; None where none was looked for."""
    unknown: UnmeasuredForce | None
    bands: tuple[Band, ...]
    separate_by: tuple[str, ...]
    """Experiments that confirm or refute the likeliest effects, as "EFFECT: what to do"."""
    next_experiments: tuple[NextExperiment, ...] = ()
    """The most telling first, where two causes stay alike and the experiments were asked for."""
    next_between: tuple[str, ...] = ()
    """The two that it tells apart."""
    attribution: Attribution
    figures: tuple[Figure, ...] = ()
    curves: tuple[Curve, ...] = ()
    between: Between | None = None
    """With more than two records."""
    channel_faults: dict[str, str] = {}
    notes: tuple[Note, ...] = ()


class Gap(Diagnosis, frozen=True, kw_only=True):
    """A diagnosis with its sentence: the content of gap.json."""

    sentence: str
