"""Sentences of a diagnosis, made from the content of gap.json alone."""

from identify.gaps.decision_table import USUAL_P_VALUE, Bounded, Verdict
from identify.gaps.results import Cause, Diagnosis
from identify.gaps.wording import (
    DESCRIPTION_EXPLAINED,
    HINT_EXPLAINED,
    SMALLEST_SHARE,
    between_records_sentence,
    bound_words,
    capitalised,
    joined,
    look_alikes_of,
    p_value_words,
    stays_unexplained_words,
    unexplained_words,
)
from identify.pages.wording import number, percent

UNSCALED = (
    "No force was measured, so that all forces rest on the mass in rig.json: an error that scales mass and stiffnesses "
    "alike does not show, nor does one that scales clearances and sensor gains alike. Channels were not checked for "
    "faults."
)
RING_FRICTION = (
    "The friction of rings was not compared with rig.json, as no tolerance states it; identify contact gives it with "
    "its interval."
)
VETO_SENTENCES = {
    "worse": "With that the rig predicts the measured motion worse than without.",
    "no_improvement": "With that the rig predicts the measured motion no better, as it would if that were all.",
}
"""Sentences by the code of the rollout that vetoes."""
STRAINED_DEVIATIONS = 3.0
"""Standard deviations from which a strained tolerance is mentioned."""


def sentence(diagnosis: Diagnosis) -> str:
    """Diagnosis in words, as one text."""
    return " ".join(sentences(diagnosis))


def sentences(diagnosis: Diagnosis) -> list[str]:
    """Diagnosis in words: the verdict, look-alikes, parameters at their limits, what was not seen."""
    all_sentences = [
        *_VERDICTS[diagnosis.verdict](diagnosis),
        *_look_alike_words(diagnosis),
        *_parameters_at_limit(diagnosis),
    ]
    all_sentences += [] if diagnosis.verdict == Verdict.CANNOT_TELL else _not_seen_sentences(diagnosis)
    all_sentences += _ruled_out_sentence(diagnosis)
    all_sentences += [UNSCALED] if diagnosis.free_decay else []
    all_sentences += [RING_FRICTION] if any(note.analysis == "ring_friction" for note in diagnosis.notes) else []
    all_sentences += [between_records_sentence(diagnosis.between)] if diagnosis.between else []
    return all_sentences + [
        f"Channel {channel_name} is {fault} and was left out."
        for channel_name, fault in diagnosis.channel_faults.items()
    ]


def _consistent_sentences(gap: Diagnosis) -> list[str]:
    return [
        "The machine is as rig.json says, as far as it matters: "
        f"{_upper_bound_words(gap.evidence.quantities)}. What is left is no more than tolerances and "
        f"noise leave ({p_value_words(gap.evidence.p_value)})."
    ]


def _cannot_tell_sentences(gap: Diagnosis) -> list[str]:
    p_words = p_value_words(gap.before.p_value)
    first_clause = f"These records do not tell whether rig.json is right: no difference stands out ({p_words})"
    exceeding_bounds = [bound for bound in gap.evidence.quantities if not bound.holds and not bound.not_seen]
    if exceeding_bounds:
        bounds_text = joined([bound_words(bound) for bound in exceeding_bounds])
        first_clause += f", though the best value is beyond what matters for {bounds_text}"
    verdict_sentences = [f"{first_clause}."]
    if named_cause := _named_cause(gap):
        verdict_sentences.append(
            f"{capitalised(joined(named_cause.named))} would explain what is left{_taken_up_words(gap)}."
        )
    return verdict_sentences + _not_seen_sentences(gap)


def _small_sentences(gap: Diagnosis) -> list[str]:
    bounds = _upper_bound_words(gap.evidence.quantities)
    if cause := _named_cause(gap):
        return [f"{capitalised(joined(cause.named))} {_verb_be(cause)} there, too small to matter: {bounds}."]
    return [
        f"The machine differs from rig.json ({p_value_words(gap.before.p_value)}), by too little to matter: {bounds}. "
        "No effect of the library is named for it.",
        *([_force_description(gap, "The difference")] if gap.unknown else []),
    ]


def _explained_sentences(gap: Diagnosis) -> list[str]:
    named = gap.causes[0]
    explain = "explains" if len(named.named) == 1 else "explain"
    if not gap.evidence.held_back_shows:
        return [
            f"{capitalised(joined(named.named))} {explain} the difference ({p_value_words(gap.evidence.p_value)}), by "
            "all records together: the one that was not fitted shows too little of it."
        ]
    if _is_hidden(gap) and gap.before.largest_pull >= STRAINED_DEVIATIONS:
        pull_words = number(gap.before.largest_pull, 2)
        return [
            f"{capitalised(joined(named.named))} {explain} the difference, which a tolerance would have to take up "
            f"without {_pronoun(named)}: it would be off by {pull_words} standard deviations."
        ]
    if (beyond := _parameters_beyond(gap)) and not gap.before.contact_shares:  # rings, by their contact fit alone
        p_words = p_value_words(gap.evidence.p_value)
        return [f"{capitalised(joined(named.named))} {explain} the difference ({p_words}).", *beyond]
    chance_words = (
        ""
        if gap.after.p_value < USUAL_P_VALUE
        else f", no more than tolerances and noise leave ({p_value_words(gap.after.p_value)})"
    )
    return [
        f"{capitalised(joined(named.named))} {explain} the difference: with {_pronoun(named)} the model leaves "
        f"{unexplained_words(gap.after)} unexplained{chance_words}; without {_pronoun(named)} "
        f"{unexplained_words(gap.before)}{_strain_words_if_bounded(gap)}{_taken_up_words(gap)}."
    ]


def _taken_up_words(gap: Diagnosis) -> str:
    """Clause on what the named effects change, where tolerances take that up without them."""
    if not gap.evidence.taken_up:
        return ""
    changed_quantities = [
        f"the {percent(bound.value)} of the {bound.name}"
        for bound in gap.evidence.quantities_beside
        if bound.value is not None and not bound.holds
    ]
    change_verb = "it changes" if len(gap.causes[0].named) == 1 else "they change"
    return f"; tolerances take up the rest of {joined(changed_quantities)} that {change_verb}"


def _strain_words_if_bounded(gap: Diagnosis) -> str:
    """Clause on the most strained tolerance, where all shares without the named effects are bounded."""
    shares_hold = all(bound.holds for bound in gap.evidence.quantities if bound.unit == "1")
    return _strain_words(gap) if shares_hold else ""


def _strain_words(gap: Diagnosis) -> str:
    if gap.before.largest_pull < STRAINED_DEVIATIONS:
        return ""
    return f", with a tolerance off by {number(gap.before.largest_pull, 2)} standard deviations"


def _partly_explained_sentences(gap: Diagnosis) -> list[str]:
    cause = gap.causes[0]
    explain = "explains" if len(cause.named) == 1 else "explain"
    return [
        f"{capitalised(joined(cause.named))} {explain} the difference in part: "
        f"{'it' if len(cause.named) == 1 else 'they'} {_removal_words(gap, '')}, and "
        f"{stays_unexplained_words(gap.after)}.",
        *_veto_sentence(gap),
        _force_description(gap, "The rest"),
    ]


def _unexplained_sentences(gap: Diagnosis) -> list[str]:
    differs_clause = f"The machine differs from rig.json ({p_value_words(gap.evidence.p_value)})"
    verdict_sentences = [
        f"{differs_clause}, but noise hides by how much: no motion is left beyond it{_strain_words(gap)}."
        if _is_hidden(gap)
        else f"{differs_clause}, which leaves {unexplained_words(gap.before)} unexplained."
    ]
    if named_cause := _named_cause(gap):
        removal_clause = _removal_words(gap, " of the difference")
        verdict_sentences.append(
            f"{capitalised(joined(named_cause.named))} {_verb_be(named_cause)} likely, and {removal_clause}."
        )
        verdict_sentences += _veto_sentence(gap)
    else:
        verdict_sentences.append("No effect of the library is named for it.")
    return [*verdict_sentences, *_parameters_beyond(gap), _force_description(gap, "The difference")]


def _parameters_beyond(gap: Diagnosis) -> list[str]:
    """Sentence on contact parameters that are off in rig.json by more than matters."""
    beyond = [bound for bound in gap.evidence.quantities if bound.unit != "1" and not (bound.holds or bound.not_seen)]
    return [f"Off by more than matters: {joined([bound_words(bound) for bound in beyond])}."] if beyond else []


_VERDICTS = {
    Verdict.CONSISTENT: _consistent_sentences,
    Verdict.CANNOT_TELL: _cannot_tell_sentences,
    Verdict.SMALL: _small_sentences,
    Verdict.EXPLAINED: _explained_sentences,
    Verdict.PARTLY_EXPLAINED: _partly_explained_sentences,
    Verdict.UNEXPLAINED: _unexplained_sentences,
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
    removes_verb = "removes" if len(cause.named) == 1 else "remove"
    if _is_hidden(gap):
        removed_share = max(gap.evidence.removed, 0.0)
        return (
            f"{removes_verb} {percent(removed_share)} of what strains its tolerances"
            if removed_share
            else f"{removes_verb} nothing that is seen"
        )
    return f"{removes_verb} {percent(cause.explained) if cause.explained > 0 else 'nothing'}{of_what}"


def _is_hidden(gap: Diagnosis) -> bool:
    """True if no motion and no contact force is unexplained beyond noise, whatever the p-value says."""
    return gap.before.share == 0 and not any(gap.before.contact_shares.values())


def _veto_sentence(gap: Diagnosis) -> list[str]:
    return [VETO_SENTENCES[gap.rollout.code]] if gap.rollout and gap.rollout.vetoed else []


def _ruled_out_sentence(gap: Diagnosis) -> list[str]:
    """Sentence on the likeliest hypothesis that prediction rules out."""
    if not gap.ruled_out:
        return []
    effects = gap.ruled_out[0]
    return [
        f"By the spectra, {joined(effects)} would be likelier; with {'it' if len(effects) == 1 else 'them'} alone "
        "the rig predicts the measured motion no better."
    ]


def _upper_bound_words(quantities: tuple[Bounded, ...]) -> str:
    """Upper bounds: "at most 0.3 % of the motion and less than 0.1 % of the force of contact_1 differ"."""
    share_bounds = [bound for bound in quantities if bound.unit == "1"]
    names_by_share: dict[str, list[str]] = {}
    for bound in share_bounds:
        if bound.upper is not None:
            upper_share = percent(max(bound.upper, SMALLEST_SHARE))
            names_by_share.setdefault(upper_share, []).append(f"of the {bound.name}")
    share_words = joined([f"at most {share_text} {joined(names)}" for share_text, names in names_by_share.items()])
    parameter_clause = ", and no clearance, stiffness or damping by more than three tolerances"
    return f"{share_words} differ{parameter_clause * (len(quantities) > len(share_bounds))}".replace(
        "at most < ", "less than "
    )


def _not_seen_sentences(gap: Diagnosis) -> list[str]:
    """Sentences on quantities that the records neither bound nor show, and on what would show them."""
    not_seen_sentences = []
    for bound in gap.not_seen:
        quantity_words = bound_words(bound)
        not_seen_sentences.append(f"Not settled: {quantity_words}{f'; {bound.remedy}' if bound.remedy else ''}.")
    return not_seen_sentences


def _force_description(gap: Diagnosis, subject: str) -> str:
    """Sentence on an unmeasured force that describes the difference, or its rest, with its share if that is small."""
    if any(note.analysis == "unmeasured_force" for note in gap.notes):
        return f"{subject} was not compared with unmeasured forces."
    if gap.unknown is None or gap.unknown.explained < HINT_EXPLAINED:
        return f"{subject} looks like no single force that is known here."
    if gap.unknown.explained >= DESCRIPTION_EXPLAINED:
        return f"{subject} looks like {gap.unknown.sentence}."
    share_text = percent(gap.unknown.explained)
    return (
        f"{subject} has no simple form; the nearest explains {share_text} of its mean square: {gap.unknown.sentence}."
    )


def _look_alike_words(gap: Diagnosis) -> list[str]:
    """Sentences on candidates that may replace a named effect."""
    return [
        f"Instead of {effect_words} it may be {joined(look_alikes, 'or')}: these records hardly tell them apart."
        for effect_words, look_alikes in look_alikes_of(gap)
    ]


def _parameters_at_limit(gap: Diagnosis) -> list[str]:
    """Sentence on parameters at the limit of their range: their true value or their effect may be another."""
    named_cause = _named_cause(gap)
    if not named_cause:
        return []
    names_at_limit = [parameter_name for parameter_name, value in named_cause.parameters.items() if value.at_limit]
    if not names_at_limit:
        return []
    range_words = "is the end of its range" if len(names_at_limit) == 1 else "are the ends of their ranges"
    return [
        f"The best {joined(names_at_limit)} {range_words}: the true value may lie beyond, or the effect is another."
    ]
