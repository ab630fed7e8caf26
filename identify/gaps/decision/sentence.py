"""The verdict in a sentence, with the criterion that decided."""

from identify.gaps.results import USUAL, Cause, Diagnosis
from identify.gaps.wording import MOST, between_records, cause_name, closes, closes_some, interval, joined, leaves
from identify.pages.wording import percent

UNSCALED = (
    "No force was measured: a common factor of mass and stiffnesses, which rest on the mass in rig.json, does not "
    "show, nor one of clearances and gains of the sensors; faults of channels are not looked for."
)


def sentence(diagnosis: Diagnosis) -> str:
    """The diagnosis in words, made from what gap.json says."""
    said = [_verdict(diagnosis), *_alternatives(diagnosis), *_limits(diagnosis), f"Criterion: {diagnosis.criterion}."]
    said += [UNSCALED] if diagnosis.free_decay else []
    said += [between_records(diagnosis.between)] if diagnosis.between else []
    said += [f"Channel {name} is {what} and was left out." for name, what in diagnosis.channel_faults.items()]
    return " ".join(said)


def _verdict(gap: Diagnosis) -> str:
    if gap.verdict == "no_gap":
        small = gap.matters.times(gap.before.share, gap.before.contact_shares.values()) <= 1
        usual = gap.before.p_value >= USUAL
        if gap.doubted:
            return _doubt(gap, gap.doubted)
        what = "that matters" if small else "beyond tolerances and noise" if usual else "that surely matters"
        return f"There is no gap {what}: the believed rig leaves {leaves(gap.before)} unexplained."
    if gap.verdict == "unknown":
        found = f"There is a gap that no effect of the library explains. {_looks(gap, 'It')}"
        if not gap.causes or not closes_some(gap.causes[0]):
            return f"{found} The likeliest effects close nothing of it."
        return f"{found} {cause_name(gap.causes[0])}, the likeliest effect, closes only {closes(gap.causes[0])}."
    best = gap.causes[0]
    one = len(best.effects) == 1
    explains, it_closes = ("explains", "it closes") if one else ("explain", "together they close")
    how = f"{it_closes} {closes(best)} and {'leaves' if one else 'leave'} {leaves(gap.after)} unexplained"
    if gap.verdict == "explained":
        return f"{cause_name(best)} {explains} the gap: {how}."
    return f"{cause_name(best)} {explains} the gap in part: {how}. {_looks(gap, 'The rest')}"


def _doubt(gap: Diagnosis, cause: Cause) -> str:
    values = joined([f"{name} {interval(value)}" for name, value in cause.parameters.items()])
    return (
        f"That there is no gap is not sure: {cause_name(cause)} explains what was fitted ({values}), and what "
        f"validates tells too little of it; there the believed rig leaves {leaves(gap.before)} unexplained."
    )


def _looks(gap: Diagnosis, what: str) -> str:
    """What an unmeasured force tells of the gap, or of its rest, and how much of it where that is not most."""
    if gap.unknown is None:
        return f"{what} has no form that was recognised."
    if gap.unknown.explained >= MOST:
        return f"{what} looks like {gap.unknown.sentence}."
    share = percent(gap.unknown.explained)
    return f"{what} has no simple form; the nearest explains {share} of its mean square: {gap.unknown.sentence}."


def _alternatives(gap: Diagnosis) -> list[str]:
    """What may stand in the place of an effect that is named."""
    if gap.verdict not in ("explained", "partly_explained"):
        return []
    return [
        f"In place of {effect} it may be {joined(others, 'or')}: these records hardly tell them apart."
        for effect, *others in gap.equivalent
    ]


def _limits(gap: Diagnosis) -> list[str]:
    """A parameter that stands at the end of what was searched may be larger, or its effect wrong."""
    if gap.verdict not in ("explained", "partly_explained"):
        return []
    at_limit = [name for name, value in gap.causes[0].parameters.items() if value.at_limit]
    if not at_limit:
        return []
    stand = "stands at the limit of its range" if len(at_limit) == 1 else "stand at the limits of their ranges"
    return [f"{joined(at_limit)} {stand}: the true value may lie beyond, or the effect is another."]
