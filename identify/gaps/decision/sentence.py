"""Sentences of a diagnosis, made from the content of gap.json alone."""

from identify.gaps.decision_table import USUAL_P_VALUE, Bounded, Verdict
from identify.gaps.results import Cause, Diagnosis
from identify.gaps.wording import (
    DESCRIPTION_EXPLAINED,
    HINT_EXPLAINED,
    between_records,
    bound_words,
    capitalised,
    joined,
    look_alikes_of,
    p_value_words,
    unexplained_words,
)
from identify.pages.wording import number, percent

UNSCALED = (
    "No force was measured: a common factor of mass and stiffnesses, which rest on the mass in rig.json, does not "
    "show, nor one of clearances and gains of the sensors; faults of channels are not looked for."
)
VETO_SENTENCES = {
    "worse": "With that the rig predicts the measured motion worse than without.",
    "no_improvement": "With that the rig predicts the measured motion no better, as it would if that were all.",
}
"""Sentences by the code of the rollout that vetoes."""
SMALLEST_SHARE = 1e-9
"""Smallest upper bound in words, "< 0.1 %": no record bounds a share by zero."""
STRAINED_DEVIATIONS = 3.0
"""Standard deviations from which a strained tolerance is mentioned."""


def sentence(diagnosis: Diagnosis) -> str:
    """Diagnosis in words, as one text."""
    return " ".join(sentences(diagnosis))


def sentences(diagnosis: Diagnosis) -> list[str]:
    """Diagnosis in words: the verdict, look-alikes, parameters at their limits, what was not seen."""
    words = [
        *_VERDICTS[diagnosis.verdict](diagnosis),
        *_look_alike_words(diagnosis),
        *_parameters_at_limit(diagnosis),
    ]
    words += [] if diagnosis.verdict == Verdict.CANNOT_TELL else _not_seen(diagnosis)
    words += _ruled_out(diagnosis)
    words += [UNSCALED] if diagnosis.free_decay else []
    words += [between_records(diagnosis.between)] if diagnosis.between else []
    return words + [f"Channel {name} is {fault} and was left out." for name, fault in diagnosis.channel_faults.items()]


def _consistent(gap: Diagnosis) -> list[str]:
    return [
        "The machine is as rig.json says, as far as it matters: "
        f"{_upper_bound_words(gap.evidence.quantities)}. What is left is no more than tolerances and "
        f"noise leave ({p_value_words(gap.evidence.p_value)})."
    ]


def _cannot_tell(gap: Diagnosis) -> list[str]:
    p_value = p_value_words(gap.before.p_value)
    clause = f"These records do not tell whether rig.json is right: no difference stands out ({p_value})"
    exceeding = [bound for bound in gap.evidence.quantities if not bound.holds and not bound.not_seen]
    if exceeding:
        clause += f", though {joined([bound_words(bound) for bound in exceeding])}"
    sentences = [f"{clause}."]
    if named := _named_cause(gap):
        sentences.append(f"{capitalised(joined(named.named))} would explain what is left.")
    return sentences + _not_seen(gap)


def _small(gap: Diagnosis) -> list[str]:
    small = _upper_bound_words(gap.evidence.quantities)
    if named := _named_cause(gap):
        return [f"{capitalised(joined(named.named))} {_verb_be(named)} there, too small to matter: {small}."]
    return [
        f"The machine differs from rig.json ({p_value_words(gap.before.p_value)}), by too little to matter: {small}. "
        "No effect of the library is named for it."
    ]


def _explained(gap: Diagnosis) -> list[str]:
    named = gap.causes[0]
    explain = "explains" if len(named.named) == 1 else "explain"
    if not gap.evidence.held_back_shows:
        return [
            f"{capitalised(joined(named.named))} {explain} the difference ({p_value_words(gap.evidence.p_value)}), by "
            "all records together: the one that was not fitted shows too little of it."
        ]
    if _is_hidden(gap) and gap.before.largest_pull >= STRAINED_DEVIATIONS:
        pull = number(gap.before.largest_pull, 2)
        return [
            f"{capitalised(joined(named.named))} {explain} the difference, which a tolerance would have to take up "
            f"without {_pronoun(named)}: it would be off by {pull} of its standard deviations."
        ]
    chance_words = (
        ""
        if gap.after.p_value < USUAL_P_VALUE
        else f", no more than tolerances and noise leave ({p_value_words(gap.after.p_value)})"
    )
    return [
        f"{capitalised(joined(named.named))} {explain} the difference: with {_pronoun(named)} the model leaves "
        f"{unexplained_words(gap.after)} unexplained{chance_words}; without {_pronoun(named)} "
        f"{unexplained_words(gap.before)}{_strain_if_bounded(gap)}."
    ]


def _strain_if_bounded(gap: Diagnosis) -> str:
    """Clause on the most strained tolerance, where all shares without the named effects are bounded."""
    shares_hold = all(bound.holds for bound in gap.evidence.quantities if bound.unit == "1")
    return _strain_words(gap) if shares_hold else ""


def _strain_words(gap: Diagnosis) -> str:
    if gap.before.largest_pull < STRAINED_DEVIATIONS:
        return ""
    return f", with a tolerance off by {number(gap.before.largest_pull, 2)} of its standard deviations"


def _partly_explained(gap: Diagnosis) -> list[str]:
    named = gap.causes[0]
    explain = "explains" if len(named.named) == 1 else "explain"
    return [
        f"{capitalised(joined(named.named))} {explain} the difference in part: "
        f"{'it' if len(named.named) == 1 else 'they'} {_removal_words(gap, '')}, and {unexplained_words(gap.after)} "
        "stay unexplained.",
        *_veto(gap),
        _force_description(gap, "The rest"),
    ]


def _unexplained(gap: Diagnosis) -> list[str]:
    differs = f"The machine differs from rig.json ({p_value_words(gap.evidence.p_value)})"
    sentences = [
        f"{differs}, by what noise hides: no share of the motion is left beyond it{_strain_words(gap)}."
        if _is_hidden(gap)
        else f"{differs}, which leaves {unexplained_words(gap.before)} unexplained."
    ]
    if named := _named_cause(gap):
        removal = _removal_words(gap, " of the difference")
        sentences.append(f"{capitalised(joined(named.named))} {_verb_be(named)} likely, and {removal}.")
        sentences += _veto(gap)
    else:
        sentences.append("No effect of the library is named for it.")
    return [*sentences, _force_description(gap, "The difference")]


_VERDICTS = {
    Verdict.CONSISTENT: _consistent,
    Verdict.CANNOT_TELL: _cannot_tell,
    Verdict.SMALL: _small,
    Verdict.EXPLAINED: _explained,
    Verdict.PARTLY_EXPLAINED: _partly_explained,
    Verdict.UNEXPLAINED: _unexplained,
}


def _named_cause(gap: Diagnosis) -> Cause | None:
    """First cause, if an effect of it is named."""
    return gap.causes[0] if gap.causes and gap.causes[0].named else None


def _verb_be(cause: Cause) -> str:
    return "is" if len(cause.named) == 1 else "are"


def _pronoun(cause: Cause) -> str:
    return "it" if len(cause.named) == 1 else "them"


def _removal_words(gap: Diagnosis, of_what: str) -> str:
    """Clause on what the named effects remove of the mismatch."""
    cause = gap.causes[0]
    verb = "removes" if len(cause.named) == 1 else "remove"
    if _is_hidden(gap):
        share = max(gap.evidence.removed, 0.0)
        return f"{verb} {percent(share)} of what strains its tolerances" if share else f"{verb} nothing that is seen"
    return f"{verb} {percent(cause.explained) if cause.explained > 0 else 'nothing'}{of_what}"


def _is_hidden(gap: Diagnosis) -> bool:
    """True if no motion and no contact force is unexplained beyond noise, whatever the p-value says."""
    return gap.before.share == 0 and not any(gap.before.contact_shares.values())


def _veto(gap: Diagnosis) -> list[str]:
    return [VETO_SENTENCES[gap.rollout.code]] if gap.rollout and gap.rollout.vetoed else []


def _ruled_out(gap: Diagnosis) -> list[str]:
    """Sentence on the likeliest hypothesis that prediction rules out."""
    if not gap.ruled_out:
        return []
    words = gap.ruled_out[0]
    return [
        f"By the spectra, {joined(words)} would be likelier; with {'it' if len(words) == 1 else 'them'} alone the rig "
        "predicts the measured motion no better."
    ]


def _upper_bound_words(quantities: tuple[Bounded, ...]) -> str:
    """Upper bounds: "at most 0.3 % of the motion and 1.2 % of the force of contact_1 differ"."""
    shares = [bound for bound in quantities if bound.unit == "1"]
    uppers = [(bound.name, max(bound.upper, SMALLEST_SHARE)) for bound in shares if bound.upper is not None]
    share_words = joined([f"{percent(upper)} of the {name}" for name, upper in uppers])
    parameters = ", and no clearance, stiffness or damping by more than three tolerances"
    return f"at most {share_words} differ{parameters * (len(quantities) > len(shares))}".replace(
        "at most < ", "less than "
    )


def _not_seen(gap: Diagnosis) -> list[str]:
    """Sentences on quantities that the records neither bound nor show, and on what would show them."""
    sentences = []
    for bound in gap.not_seen:
        words = bound_words(bound)
        sentences.append(f"Not seen: {words}{f'; {bound.remedy}' if bound.remedy else ''}.")
    return sentences


def _force_description(gap: Diagnosis, subject: str) -> str:
    """Sentence on an unmeasured force that describes the difference, or its rest, with its share if that is small."""
    if gap.unknown is None or gap.unknown.explained < HINT_EXPLAINED:
        return f"{subject} looks like no single force that is known here."
    if gap.unknown.explained >= DESCRIPTION_EXPLAINED:
        return f"{subject} looks like {gap.unknown.sentence}."
    share = percent(gap.unknown.explained)
    return f"{subject} has no simple form; the nearest explains {share} of its mean square: {gap.unknown.sentence}."


def _look_alike_words(gap: Diagnosis) -> list[str]:
    """Sentences on candidates that may replace a named effect."""
    return [
        f"Instead of {words} it may be {joined(look_alikes, 'or')}: these records hardly tell them apart."
        for words, look_alikes in look_alikes_of(gap)
    ]


def _parameters_at_limit(gap: Diagnosis) -> list[str]:
    """Sentence on parameters at the limit of their range: their true value or their effect may be another."""
    named = _named_cause(gap)
    if not named:
        return []
    at_limit = [name for name, value in named.parameters.items() if value.at_limit]
    if not at_limit:
        return []
    range_words = "is the end of its range" if len(at_limit) == 1 else "are the ends of their ranges"
    return [f"The best {joined(at_limit)} {range_words}: the true value may lie beyond, or the effect is another."]
