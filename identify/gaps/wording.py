"""Numbers of a diagnosis as they are written in its sentence, on the page, in the pictures and on the screen."""

from collections.abc import Sequence

from identify.gaps.decision_table import Bounded, Verdict
from identify.gaps.results import Between, Cause, Compared, Diagnosis, Gap, Left, LevelDependence
from identify.pages import wording
from identify.pages.wording import number, percent
from rig.model.unmeasured_force import Value

VERDICTS = {
    Verdict.CONSISTENT: "consistent with rig.json",
    Verdict.CANNOT_TELL: "cannot tell",
    Verdict.SMALL: "a difference too small to matter",
    Verdict.EXPLAINED: "explained",
    Verdict.PARTLY_EXPLAINED: "explained in part",
    Verdict.UNEXPLAINED: "not explained",
}

WHEN = {
    "always": "throughout the record",
    "in contact": "while contacts are closed",
    "growing with time": "growing with time",
}
ANALYSES = {
    "unmeasured_force": "an unmeasured force",
    "clearance_modulation": "a clearance that swings",
    "force_description": "the description of the unmeasured force",
    "between_records": "what differs between the records",
    "response_comparison": "simulated beside measured",
    "next_experiment": "the next experiment",
    "attribution": "where the difference lies",
    "rollout": "prediction from measured states",
}
"""Side analyses, which a note names."""
LEAST = 0.1
"""An unmeasured force that explains less is no hint: null simulations explain as much."""
MOST = 0.5
"""A description of something unknown that explains less of it is a hint, not what it looks like."""
CERTAIN = 1 - 1e-9
NOTHING = 0.01
"""A cause whose interval begins below this share is said to close nothing."""


LEAST_CHANCE = 1e-12
"""No p-value below this is told as a number: the tails of no distribution are known so far out."""


def verdict(gap: Gap) -> str:
    return VERDICTS[gap.verdict]


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def chance(p_value: float) -> str:
    """Words such as "p = 0.43"."""
    return f"p < {LEAST_CHANCE:g}" if p_value < LEAST_CHANCE else f"p = {number(p_value, 2)}"


def quantity(one: Bounded) -> str:
    """Words on a quantity that is not bounded: its reason, or its value and upper bound."""
    if one.value is None or one.upper is None:
        return f"the {one.name} ({one.why})"
    if one.unit == "1":
        return f"the {one.name}, of which {percent(one.value)} and at most {percent(one.upper)} are unexplained"
    value, upper, limit = (number(x, 3) for x in (one.value, one.upper, one.threshold))
    return f"the {one.name}, {value} and at most {upper} {one.unit} off, where {limit} {one.unit} are three tolerances"


def alternatives(gap: Diagnosis) -> list[tuple[str, list[str]]]:
    """Each named effect of the first cause that has look-alikes, in words, with those."""
    if not gap.causes:
        return []
    told = {s.effect: w for c in reversed(gap.causes) for s, w in zip(c.strengths, c.words, strict=True)}
    first = gap.causes[0]
    return [
        (words, [told.get(name, name) for name in strength.instead])
        for words, strength in zip(first.words, first.strengths, strict=True)
        if strength.is_named and strength.instead
    ]


def interval(found: Value) -> str:
    """value ± 1.96 standard errors, to two digits of the latter; with a word where the range ends there.

    Of a number that the record does not tell: what it tells instead.
    """
    if found.instead:
        return found.instead
    said = wording.interval(found.value, found.standard_error, found.unit)
    return f"{said} (at the limit of its range)" if found.at_limit else said


def cause_name(cause: Cause) -> str:
    """Its effects with the places that they act at: "added_mass (barrel) + preload"."""
    named = []
    for effect, label in zip(cause.effects, cause.labels, strict=True):
        places = [place for field, place in cause.places.items() if field.split(".")[0] == label]
        named.append(f"{effect} ({', '.join(places)})" if places else effect)
    return " + ".join(named)


def closes(cause: Cause) -> str:
    """The fraction of the gap that it closes, with its interval: "97.0 % (95.1 to 98.2 %)"."""
    if not closes_some(cause) and cause.explained < MOST:
        return "nothing"
    low, high = (percent(end).removesuffix(" %") for end in cause.interval_95)
    return f"{percent(cause.explained)} ({low} to {high} %)"


def closes_some(cause: Cause) -> bool:
    """True if its interval excludes that it removes nothing."""
    return cause.interval_95[0] > NOTHING


def leaves(left: Left) -> str:
    """Shares: "0.3 % of the motion, 1.2 % of the force of contact_1 and 0.9 % of that of contact_2"."""
    shares = [f"{percent(left.share)} of the motion"]
    for i, (name, share) in enumerate((n, s) for n, s in left.contact_shares.items() if s > 0):
        shares.append(f"{percent(share)} of {'that' if i else 'the force'} of {name}")
    return joined(shares)


def joined(words: Sequence[str], last: str = "and") -> str:
    """ "a, b and c"."""
    *first, end = words
    return f"{', '.join(first)} {last} {end}" if first else end


def between_records(between: Between) -> str:
    """Sentence on what differs between the records."""
    if not between.differing:
        return "Nothing differs between the records beyond what tolerances and noise explain."
    said = f"Between the records, {joined([differs(one) for one in between.differing])}."
    return f"{level_words(between.level_dependence)} {said}" if between.level_dependence else said


SHIFTED = 5e-4
"""A mode whose frequency changes by a smaller share neither softens nor stiffens."""


def level_words(one: LevelDependence) -> str:
    """Sentence such as "The machine softens with the motion: the mode of the wing at 7.3 Hz changes by -1.3 % ..."."""
    shift, damping = (f"{100 * x:+.2g} %" for x in (one.frequency_change, one.damping_change))
    if abs(one.frequency_change) < SHIFTED:
        kind = f"is damped {'more' if one.damping_change > 0 else 'less'}"
    else:
        kind = "softens" if one.frequency_change < 0 else "stiffens"
    joint = "a stop or a hardening spring" if kind == "stiffens" else "friction or clearance in a joint"
    return (
        f"The machine {kind} with the motion: from {number(one.lowest_n, 2)} to {number(one.highest_n, 2)} N rms the "
        f"mode of the {one.body} at {number(one.frequency_hz)} Hz changes by {shift} and its damping by {damping}, as "
        f"{joint} makes it; a changed mass or linear stiffness would be the same at every level."
    )


def differs(one: Compared) -> str:
    """Words such as "contact_clearance.factor (contact_2) grows (1.006, 1.006, 1.087)"."""
    values = ", ".join(number(v.value) for v in one.values)
    unit = "" if one.values[0].unit == "1" else f" {one.values[0].unit}"
    place = f" ({one.place})" if one.place else ""
    return f"{one.parameter}{place} {one.trend} ({values}{unit})"


def not_computed(gap: Gap) -> list[str]:
    """Side analyses that could not be made, each with its reason."""
    return [f"Not computed: {ANALYSES[note.analysis]} ({note.reason})." for note in gap.notes]


def others(gap: Gap) -> list[tuple[str, float]]:
    """Rest of probability one beside the causes: no effect of the library, and something unmeasured, if it was looked
    for. Where the records differ from it, rig.json is not likely to be right, yet no effect may be likelier."""
    sought = gap.unknown is not None or gap.probability_unknown > 0
    unknown = "something unmeasured" if sought else "something unmeasured (not looked for)"
    nothing = "no effect of the library" if gap.evidence.differs else "rig.json as it is"
    return [(nothing, gap.probability_nothing), (unknown, gap.probability_unknown)]


def probability(value: float) -> str:
    """Probability in per cent; nothing is certain."""
    return percent(min(value, CERTAIN))
