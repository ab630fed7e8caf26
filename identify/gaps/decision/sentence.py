"""The verdict in sentences, made from what gap.json says alone."""

from identify.gaps.decision_table import USUAL, Bounded, Verdict
from identify.gaps.results import Cause, Diagnosis
from identify.gaps.wording import LEAST, MOST, alternatives, between_records, capital, chance, joined, leaves, quantity
from identify.pages.wording import number, percent

UNSCALED = (
    "No force was measured: a common factor of mass and stiffnesses, which rest on the mass in rig.json, does not "
    "show, nor one of clearances and gains of the sensors; faults of channels are not looked for."
)
WORSE = {
    "worse": "With that the rig predicts the measured motion worse than without.",
    "no_improvement": "With that the rig predicts the measured motion no better, as it would if that were all.",
}
"""By the code of the rollout that vetoes."""
STRAINED = 3.0
"""Standard deviations by which a tolerance is told to be off."""


def sentence(diagnosis: Diagnosis) -> str:
    """The diagnosis in words: the verdict, what stands in the place of names, what was not seen."""
    said = [*_VERDICTS[diagnosis.verdict](diagnosis), *_alternatives(diagnosis), *_limits(diagnosis)]
    said += [] if diagnosis.verdict == Verdict.CANNOT_TELL else _not_seen(diagnosis)
    said += _ruled_out(diagnosis)
    said += [UNSCALED] if diagnosis.free_decay else []
    said += [between_records(diagnosis.between)] if diagnosis.between else []
    said += [f"Channel {name} is {what} and was left out." for name, what in diagnosis.channel_faults.items()]
    return " ".join(said)


def _consistent(gap: Diagnosis) -> list[str]:
    return [
        f"The machine is as rig.json says, as far as it matters: at most {_bounds(gap.evidence.quantities)} may be "
        f"otherwise, and what is left is what tolerances and noise leave ({chance(gap.evidence.p_value)})."
    ]


def _cannot_tell(gap: Diagnosis) -> list[str]:
    begin = (
        f"These records do not tell whether rig.json is right: no difference is certain ({chance(gap.before.p_value)})"
    )
    exceeding = [q for q in gap.evidence.quantities if not q.holds and not q.not_seen]
    if exceeding:
        begin += f", though {joined([quantity(q) for q in exceeding])}"
    said = [f"{begin}."]
    if named := _named(gap):
        said.append(f"{capital(joined(named.named))} would explain what is left, as tolerances and noise do.")
    return said + _not_seen(gap)


def _small(gap: Diagnosis) -> list[str]:
    small = f"at most {_bounds(gap.evidence.quantities)}, less than what matters"
    if named := _named(gap):
        return [f"{capital(joined(named.named))} {_is(named)} certain, and too small to matter: {small}."]
    return [
        f"The machine differs from rig.json ({chance(gap.before.p_value)}), by too little to matter: {small}. No "
        "effect of the library is named for it."
    ]


def _explained(gap: Diagnosis) -> list[str]:
    named = gap.causes[0]
    explain = "explains" if len(named.named) == 1 else "explain"
    if not gap.evidence.held_back_shows:
        return [
            f"{capital(joined(named.named))} {explain} the difference ({chance(gap.evidence.p_value)}), by all records "
            "together: the one that was not fitted shows too little of it."
        ]
    rest = "" if gap.after.p_value < USUAL else f", as tolerances and noise do ({chance(gap.after.p_value)})"
    return [
        f"{capital(joined(named.named))} {explain} the difference: with {_them(named)} rig.json leaves "
        f"{leaves(gap.after)} unexplained{rest}; without {_them(named)} {leaves(gap.before)}"
        f"{_strained(gap)}."
    ]


def _strained(gap: Diagnosis) -> str:
    """The tolerance that is off by most without the named effects, where what is left does not tell that they lack."""
    shares_hold = all(one.holds for one in gap.evidence.quantities if one.unit == "1")
    return _strained_by(gap) if shares_hold else ""


def _strained_by(gap: Diagnosis) -> str:
    if gap.before.largest_pull < STRAINED:
        return ""
    return f", with a tolerance off by {number(gap.before.largest_pull, 2)} of its standard deviations"


def _partly_explained(gap: Diagnosis) -> list[str]:
    named = gap.causes[0]
    explain = "explains" if len(named.named) == 1 else "explain"
    return [
        f"{capital(joined(named.named))} {explain} the difference in part: "
        f"{'it' if len(named.named) == 1 else 'they'} {_removes(gap)}, and {leaves(gap.after)} "
        "stay unexplained.",
        *_veto(gap),
        _looks(gap, "The rest"),
    ]


def _unexplained(gap: Diagnosis) -> list[str]:
    differs = f"The machine differs from rig.json ({chance(gap.evidence.p_value)})"
    said = [
        f"{differs}, by what noise hides: no share of the motion is left beyond it{_strained_by(gap)}."
        if _is_hidden(gap)
        else f"{differs}, which leaves {leaves(gap.before)} unexplained."
    ]
    if named := _named(gap):
        said.append(f"{capital(joined(named.named))} {_is(named)} likely, and {_removes(gap)}.")
        said += _veto(gap)
    else:
        said.append("No effect of the library is named for it.")
    return [*said, _looks(gap, "It")]


_VERDICTS = {
    Verdict.CONSISTENT: _consistent,
    Verdict.CANNOT_TELL: _cannot_tell,
    Verdict.SMALL: _small,
    Verdict.EXPLAINED: _explained,
    Verdict.PARTLY_EXPLAINED: _partly_explained,
    Verdict.UNEXPLAINED: _unexplained,
}


def _named(gap: Diagnosis) -> Cause | None:
    """The first cause, if an effect of it is named."""
    return gap.causes[0] if gap.causes and gap.causes[0].named else None


def _is(cause: Cause) -> str:
    return "is" if len(cause.named) == 1 else "are"


def _them(cause: Cause) -> str:
    return "it" if len(cause.named) == 1 else "them"


def _removes(gap: Diagnosis) -> str:
    """Clause on what the named effects remove of the mismatch."""
    cause = gap.causes[0]
    verb = "removes" if len(cause.named) == 1 else "remove"
    if _is_hidden(gap):
        share = max(gap.evidence.removed, 0.0)
        return f"{verb} {percent(share)} of what strains its tolerances" if share else f"{verb} nothing that is seen"
    return f"{verb} {percent(cause.explained)} of it" if cause.explained > 0 else f"{verb} nothing of it"


def _is_hidden(gap: Diagnosis) -> bool:
    """True if nothing beyond noise is left of the motion and of any contact force, whatever the p-value says."""
    return gap.before.share == 0 and not any(gap.before.contact_shares.values())


def _veto(gap: Diagnosis) -> list[str]:
    return [WORSE[gap.rollout.code]] if gap.rollout and gap.rollout.vetoed else []


def _ruled_out(gap: Diagnosis) -> list[str]:
    """The likeliest of the hypotheses that prediction rules out."""
    if not gap.ruled_out:
        return []
    words = gap.ruled_out[0]
    return [
        f"By the spectra, {joined(words)} would be likelier; with {'it' if len(words) == 1 else 'them'} alone the rig "
        "predicts the measured motion no better."
    ]


def _bounds(quantities: tuple[Bounded, ...]) -> str:
    """Upper bounds of the shares: "0.3 % of the motion and 1.2 % of the force of contact_1"."""
    shares = [q for q in quantities if q.unit == "1"]
    text = joined([f"{percent(q.upper)} of the {q.name}" for q in shares if q.upper is not None])
    further = (
        " and every clearance, stiffness and damping within three tolerances" if len(quantities) > len(shares) else ""
    )
    return text + further


def _not_seen(gap: Diagnosis) -> list[str]:
    """Clause on what the records neither bound nor show, and on what would show it."""
    said = []
    for one in gap.not_seen:
        what = quantity(one)
        said.append(f"Not seen: {what}{f'; {one.remedy}' if one.remedy else ''}.")
    return said


def _looks(gap: Diagnosis, what: str) -> str:
    """Clause on an unmeasured force that describes the difference, or its rest, and its share if that is small."""
    if gap.unknown is None or gap.unknown.explained < LEAST:
        return f"{what} has no form that was recognised."
    if gap.unknown.explained >= MOST:
        return f"{what} looks like {gap.unknown.sentence}."
    share = percent(gap.unknown.explained)
    return f"{what} has no simple form; the nearest explains {share} of its mean square: {gap.unknown.sentence}."


def _alternatives(gap: Diagnosis) -> list[str]:
    """Clause on what may stand in the place of a named effect."""
    return [f"These records hardly tell {words} from {joined(others, 'or')}." for words, others in alternatives(gap)]


def _limits(gap: Diagnosis) -> list[str]:
    """A parameter that stands at the end of what was searched may be larger, or its effect wrong."""
    named = _named(gap)
    if not named:
        return []
    at_limit = [name for name, value in named.parameters.items() if value.at_limit]
    if not at_limit:
        return []
    stand = "stands at the limit of its range" if len(at_limit) == 1 else "stand at the limits of their ranges"
    return [f"{joined(at_limit)} {stand}: the true value may lie beyond, or the effect is another."]
