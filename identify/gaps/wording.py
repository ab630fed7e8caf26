"""Words and numbers of a diagnosis, alike in its sentence, on the page, in the pictures and on the screen."""

import math

from identify.gaps.decision_table import Bounded, Verdict
from identify.gaps.results import (
    Cause,
    Diagnosis,
    Gap,
    LevelDependence,
    ParameterByRecord,
    RecordDifferences,
    UnexplainedShares,
)
from identify.pages import wording
from identify.pages.wording import change_words, joined, number, p_value_words, percent
from rig.effects import effects
from rig.model.unmeasured_force import Value

VERDICT_WORDS = {
    Verdict.CONSISTENT: "consistent with rig.json",
    Verdict.CANNOT_TELL: "cannot tell",
    Verdict.SMALL: "a difference too small to matter",
    Verdict.EXPLAINED: "explained",
    Verdict.PARTLY_EXPLAINED: "explained in part",
    Verdict.UNEXPLAINED: "not explained",
}

WHEN_WORDS = {
    "always": "throughout the record",
    "in contact": "while contacts are closed",
    "growing with time": "growing with time",
}
ANALYSIS_WORDS = {
    "unmeasured_force": "an unmeasured force",
    "clearance_modulation": "a clearance that swings",
    "force_description": "the description of the unmeasured force",
    "between_records": "what differs between the records",
    "next_experiment": "the next experiment",
    "attribution": "where the difference lies",
    "rollout": "prediction from measured states",
    "ring_friction": "whether the friction of rings is as in rig.json",
    "strain_gauges": "what the strain gauges show",
}
"""Side analyses that a note may name."""
PREDICTION_WORDS = {
    "not_vetoed": "with the named effects the motion is predicted no worse than by rig.json within its tolerances",
    "worse": "the corrected rig predicts worse: no explanation",
    "no_improvement": "the prediction would improve if this were all, and does not: no explanation",
    "no_horizon": "null simulations cannot be predicted either",
    "too_short": "the record has too few seconds",
    "not_simulated": "the simulator cannot start from measured states",
}
"""Result of the prediction in words, by its code."""
RATIO_WORDS = {"relative_position": "of the length of the body", "factor": "times the value in rig.json"}
"""What a parameter without a unit is a ratio to, by its name."""
UNIT_WORDS = {"n", "m", "s", "s2", "m2", "m3", "kg", "hz", "pa", "rad", "per", "minute"}
"""Words of a parameter's name that are its unit."""
MIN_HINT_SHARE = 0.1
"""Explained share below which an unmeasured force is no hint: null simulations explain as much."""
MIN_DESCRIPTION_SHARE = 0.5
"""Explained share below which a description of an unmeasured force is a hint only."""
LARGEST_PROBABILITY = 1 - 1e-9
"""Largest probability that is written: none is one. Display."""
NEGLIGIBLE_SHARE = 0.01
"""Lower end of the interval below which a cause is said to close nothing."""
SMALLEST_SHARE = 1e-9
"""Smallest share in words, "< 0.1 %": no record bounds a share by zero. Display."""
NOMINAL_WORDS = {Verdict.CONSISTENT: "rig.json as it is", Verdict.CANNOT_TELL: "no effect that stands out"}
"""Words for no cause at all by the verdict, where no difference is certain."""
SMALLEST_FREQUENCY_CHANGE = 5e-4
"""Relative change of a frequency below which a mode neither softens nor stiffens."""


def verdict_words(gap: Gap) -> str:
    """Verdict in a few words, with what keeps an explanation from being used as it is."""
    return ", but ".join(filter(None, (VERDICT_WORDS[gap.verdict], reservation_words(gap))))


def reservation_words(gap: Gap) -> str:
    """Reason not to use an explanation as it is: a machine that changed, or look-alikes; empty if there is none."""
    if gap.verdict not in (Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED):
        return ""
    if gap.between and gap.between.differing:
        return "the records differ"
    return "another cause fits as well" if named_effects_with_look_alikes(gap) else ""


def capitalised(text: str) -> str:
    return text[:1].upper() + text[1:]


def model_p_value_words(p_value: float) -> str:
    """P-value with its meaning: "p = 0.016: a correct model would look this bad in 1.6 % of tests"."""
    rate = "fewer than 0.1 %" if p_value < 1e-3 else f"{number(100 * p_value, 2)} %"
    return f"{p_value_words(p_value)}: a correct model would look this bad in {rate} of tests"


def share_words(share: float) -> str:
    """Unexplained share in per cent; "< 0.1 %" where noise hides it, as no record bounds a share by zero."""
    return percent(max(share, SMALLEST_SHARE))


def bound_words(bound: Bounded) -> str:
    """Quantity that is not bounded, in words: its value, upper bound and limit, or the reason why there are none."""
    if bound.why or bound.value is None:
        return f"the {bound.name} ({bound.why})"
    value, upper, limit = value_bound_and_limit_texts(bound)
    at_most = "with no upper bound" if bound.upper is None else f"at most {upper}"
    if bound.unit == "1":
        return f"the {bound.name} ({value} unexplained, {at_most}; {limit} matters)"
    return f"the {bound.name} ({value} off, {at_most}; three tolerances are {limit})"


def unsettled_sentence(bound: Bounded) -> str:
    """Sentence on a quantity that the records neither bound nor show, and on what would show it."""
    remedy = f"; {bound.remedy}" if bound.remedy else ""
    if bound.unit != "1" or bound.upper is None or bound.why or bound.value is None:
        return f"Not settled: {bound_words(bound)}{remedy}."
    _, upper, limit = value_bound_and_limit_texts(bound)
    return f"Not tested to your limit: the error of the {bound.name} is at most {upper}, you asked for {limit}{remedy}."


def value_bound_and_limit_texts(bound: Bounded) -> list[str]:
    """Value, upper bound and limit of a quantity in words, lengths in mm; more digits where a bound would else read as
    the limit that it exceeds."""
    unit_scale, unit = (1e3, "mm") if bound.unit == "m" else (1.0, bound.unit)

    def words(value: float | None, digits: int = 0) -> str:
        if value is None:
            return "no bound"
        if unit == "1":
            return f"{100 * value:.{digits}g} %" if digits else share_words(value)
        return f"{number(unit_scale * value, digits or 3)} {unit}"

    texts = [words(bound.value), words(bound.upper), words(bound.threshold)]
    if bound.upper is not None and texts[1] == texts[2] and bound.upper > bound.threshold:
        texts[1] = words(bound.upper, math.ceil(-math.log10(bound.upper / bound.threshold - 1)) + 1)
    return texts


def named_effects_with_look_alikes(gap: Diagnosis) -> list[tuple[str, list[str]]]:
    """Named effects of the likeliest cause that have look-alikes, each with these, in words."""
    words_by_effect = {
        strength.effect: words
        for cause in reversed(gap.causes)
        for strength, words in zip(cause.strengths, cause.words, strict=True)
    }
    return [
        (words, [words_by_effect.get(look_alike) or _label_words(look_alike) for look_alike in strength.instead])
        for cause in gap.causes[:1]
        for words, strength in zip(cause.words, cause.strengths, strict=True)
        if strength.is_named and strength.instead
    ]


def _label_words(label: str) -> str:
    """Label of an effect in words: "added mass of the barrel" of added_mass:barrel."""
    effect, _, place = label.partition(":")
    return spoken_effect(effect) + (f" of the {place}" if place not in ("", "all") else "")


def spoken_effect(effect_name: str) -> str:
    """Name of an effect in words: "added mass"."""
    return effect_name.replace("_", " ").replace("youngs", "Young's")


_UNMEASURED_WORDS = {"distributed": "changing stiffness", "contact": "swinging clearance"}
"""Words for what is not measured, by its kind, where that is no force."""


def check_findings_introduction(gap: Diagnosis) -> str:
    """Sentence that introduces the findings of the check, which knows no force or motion that was not measured."""
    unmeasured = [
        words
        for cause in gap.causes[:1]
        for effect, words, strength in zip(cause.effects, cause.words, cause.strengths, strict=True)
        if strength.is_named and (effects()[effect].stochastic or effects()[effect].of_a_record)
    ]
    if gap.unknown and gap.unknown.kind != "sensor" and gap.unknown.explained >= MIN_DESCRIPTION_SHARE:
        unmeasured.append(f"the {_UNMEASURED_WORDS.get(gap.unknown.kind, 'unmeasured force')} described above")
    reservation = f", which does not know {joined(unmeasured)}," if unmeasured else ""
    cause_words = (
        ", perhaps because of the difference above (mend no channel before that is explained)"
        * gap.evidence.difference_matters
    )
    return f"The check of the recordings{reservation} says{cause_words}:"


def interval(estimate: Value) -> str:
    """Interval "value ± 1.96 standard errors", to two digits of the latter, marked where the range ends there.

    Where the record does not determine the number: what it determines instead.
    """
    if estimate.instead:
        return estimate.instead
    words = wording.interval(estimate.value, estimate.standard_error, estimate.unit)
    return f"{words} (at the limit of its range)" if estimate.at_limit else words


def cause_name(cause: Cause) -> str:
    """Effects of a cause with the places at which they act: "added_mass (barrel) + preload"."""
    labelled_effects = []
    for effect, label in zip(cause.effects, cause.labels, strict=True):
        places = [place for key, place in cause.places.items() if key.split(".")[0] == label]
        labelled_effects.append(f"{effect} ({', '.join(places)})" if places else effect)
    return " + ".join(labelled_effects)


def removed_share_words(cause: Cause) -> str:
    """Removed share of the mismatch with its 95 % interval: "97.0 % (95.1 to 98.2 %)"; "nothing" if negligible."""
    if cause.interval_95[0] <= NEGLIGIBLE_SHARE and cause.explained < MIN_DESCRIPTION_SHARE:
        return "nothing"
    lower, upper = (percent(share).removesuffix(" %") for share in cause.interval_95)
    return f"{percent(cause.explained)} ({lower} to {upper} %)"


def is_effective(cause: Cause) -> bool:
    """True if effects are named, or if the interval of the removed share excludes that the cause removes nothing."""
    return bool(cause.named) or cause.interval_95[0] > NEGLIGIBLE_SHARE


def unexplained_words(unexplained: UnexplainedShares) -> str:
    """Unexplained shares: "0.3 % of the motion, 1.2 % of the force of contact_1 and 0.9 % of that of contact_2".

    Without what noise hides, whose share is zero; "< 0.1 % of the motion" if noise hides all.
    """
    words = [f"{share_words(unexplained.share)} of the motion"] if unexplained.share > 0 else []
    forces = [(name, share) for name, share in unexplained.contact_shares.items() if share > 0]
    for index, (name, share) in enumerate(forces):
        words.append(f"{percent(share)} of {'that' if index else 'the force'} of {name}")
    return joined(words or [f"{share_words(0.0)} of the motion"])


def error_change_words(before: UnexplainedShares, after: UnexplainedShares) -> str:
    """Unexplained shares before and after a correction: "the error of the motion falls from 1.6 % to < 0.1 % and that
    of the force of contact_1 from 2.1 % to 1.8 %"; without those that noise hides in both."""
    changes = {"the motion": (before.share, after.share)}
    changes |= {
        f"the force of {name}": (share, after.contact_shares[name]) for name, share in before.contact_shares.items()
    }
    clauses, last_verb = list[str](), ""
    for name, shares in changes.items():
        first, last = map(share_words, shares)
        verb = "stays" if first == last else "falls" if shares[1] < shares[0] else "rises"
        if any(shares):
            course = f"at {last}" if first == last else f"from {first} to {last}"
            said_verb = "" if verb == last_verb else f"{verb} "
            clauses.append(f"{'that' if clauses else 'the error'} of {name} {said_verb}{course}")
            last_verb = verb
    return joined(clauses or ["no error is seen"])


def stays_unexplained_words(gap: Diagnosis) -> str:
    """Clause "3.6 % of the force of contact_2 (3.0 % matters) stays unexplained" on what the named effects leave: what
    exceeds its threshold, then what is not bounded by it; all if there is neither."""
    contact_shares, matters = gap.after.contact_shares, gap.matters
    shares = [("the motion", gap.after.share, matters.motion)]
    shares += [(f"the force of {name}", share, matters.contact) for name, share in contact_shares.items()]
    exceeding = [
        f"{percent(share)} of {words} ({percent(limit)} matters)" for words, share, limit in shares if share > limit
    ]
    unbounded = [
        bound_words(bound)
        for bound in gap.evidence.quantities_after
        if bound.unit == "1" and not bound.holds and (bound.value is None or bound.value <= bound.threshold)
    ]
    clauses = [(exceeding, "unexplained"), (unbounded, "unsettled")]
    if not (exceeding or unbounded):
        is_plural = sum(share > 0 for _, share, _ in shares) > 1
        return f"{unexplained_words(gap.after)} {'stay' if is_plural else 'stays'} unexplained"
    return ", and ".join(
        f"{joined(words)} {'stay' if len(words) > 1 else 'stays'} {state}" for words, state in clauses if words
    )


def between_records_sentence(between: RecordDifferences) -> str:
    """Sentence on what differs between the records."""
    if not between.differing:
        return "Nothing differs between the records beyond what tolerances and noise explain."
    sentence = (
        f"Between the records, {joined([parameter_trend_words(comparison) for comparison in between.differing])}."
    )
    return f"{level_dependence_sentence(between.level_dependence)} {sentence}" if between.level_dependence else sentence


def level_dependence_sentence(change: LevelDependence) -> str:
    """Sentence on the change of a mode with the level: "The machine softens with the motion: ..."."""
    frequency = change_words(change.frequency_change, change.frequency_change_standard_error)
    damping = change_words(change.damping_change, change.damping_change_standard_error)
    if abs(change.frequency_change) < SMALLEST_FREQUENCY_CHANGE:
        trend = f"is damped {'more' if change.damping_change > 0 else 'less'}"
    else:
        trend = "softens" if change.frequency_change < 0 else "stiffens"
    joint = "a stop or a hardening spring" if trend == "stiffens" else "friction or clearance in a joint"
    return (
        f"The machine {trend} with the motion: from {number(change.lowest_n, 2)} to {number(change.highest_n, 2)} N "
        f"rms the mode of the {change.body} at {number(change.frequency_hz)} Hz changes by {frequency} and its damping "
        f"by {damping}, as {joint} makes it; a changed mass or linear stiffness would be the same at every level."
    )


def parameter_trend_words(comparison: ParameterByRecord) -> str:
    """Trend of a parameter, with the level of the force if it follows that: "contact_clearance.factor (contact_2) grows
    (1.006 ± 0.004, 1.087 ± 0.004)"."""
    values = ", ".join(map(interval, comparison.values))
    place = f" ({comparison.place})" if comparison.place else ""
    follows_level = comparison.by_level in ("grows", "falls")
    trend = f"{comparison.by_level} with the level" if follows_level else comparison.trend
    return f"{comparison.parameter}{place} {trend} ({values})"


def failed_analysis_sentences(gap: Gap) -> list[str]:
    """Side analyses that could not be made, each with its reason."""
    return [f"Not computed: {ANALYSIS_WORDS[note.analysis]} ({note.reason})." for note in gap.notes]


def remaining_probabilities(gap: Gap, shown_cause_count: int) -> list[tuple[str, float]]:
    """Probabilities of all but the first causes, each with its words: of further causes together, if there are any, of
    no effect, and of something unmeasured.

    Where the records certainly differ from rig.json, no effect is worded as that of no effect of the library, where
    they cannot tell, as that of none that stands out.
    """
    further = gap.causes[shown_cause_count:]
    is_considered = gap.unknown is not None or gap.probability_unknown > 0
    unmeasured = "something unmeasured" if is_considered else "something unmeasured (not looked for)"
    return [
        *([(f"{len(further)} further causes", sum(cause.probability for cause in further))] if further else []),
        (NOMINAL_WORDS.get(gap.verdict, "no effect of the library"), gap.probability_nothing),
        (unmeasured, gap.probability_unknown),
    ]


def parameter_words(name: str) -> str:
    """Name of a parameter without its unit, which its value has: "linear_spring stiffness"."""
    effect, _, parameter = name.partition(".")
    words = parameter.split("_")
    while words[-1] in UNIT_WORDS:
        words.pop()
    return f"{effect} {' '.join(words)}"


def probability(value: float) -> str:
    """Probability in per cent, written as at most `LARGEST_PROBABILITY`."""
    return percent(min(value, LARGEST_PROBABILITY))
