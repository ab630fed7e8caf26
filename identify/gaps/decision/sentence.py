"""Sentences of a diagnosis, made from the content of gap.json alone."""

from identify.gaps.decision_table import NAMED_PROBABILITY, USUAL_P_VALUE, Bounded, Verdict
from identify.gaps.results import Cause, Diagnosis
from identify.gaps.wording import (
    MIN_DESCRIPTION_SHARE,
    MIN_HINT_SHARE,
    between_records_sentence,
    bound_words,
    capitalised,
    error_change_words,
    model_p_value_words,
    named_effects_with_look_alikes,
    probability,
    share_words,
    stays_unexplained_words,
    unexplained_words,
    unsettled_sentence,
)
from identify.pages.wording import joined, number, p_value_words, percent

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
    is_ring_friction_left_out = any(note.analysis == "ring_friction" for note in diagnosis.notes)
    return [
        *_VERDICTS[diagnosis.verdict](diagnosis),
        *_look_alike_words(diagnosis),
        *_parameters_at_limit(diagnosis),
        *([] if diagnosis.verdict == Verdict.CANNOT_TELL else _undetermined_quantity_sentences(diagnosis)),
        *_ruled_out_sentence(diagnosis),
        *([UNSCALED] if diagnosis.free_decay else []),
        *([RING_FRICTION] if is_ring_friction_left_out else []),
        *([between_records_sentence(diagnosis.between)] if diagnosis.between else []),
        *(f"Channel {name} is {fault} and was left out." for name, fault in diagnosis.channel_faults.items()),
    ]


def _consistent_sentences(gap: Diagnosis) -> list[str]:
    return [
        "The machine is as rig.json says, as far as it matters: "
        f"{_upper_bound_words(gap.evidence.quantities)}. The remaining error is at noise level "
        f"({model_p_value_words(gap.evidence.p_value)})."
    ]


def _cannot_tell_sentences(gap: Diagnosis) -> list[str]:
    p_words = model_p_value_words(gap.evidence.p_value)
    quantities = gap.evidence.quantities
    unsettled_count = sum(not bound.holds for bound in quantities)
    clause = (
        f"No difference from rig.json stands out ({p_words}), but these records do not settle {unsettled_count} of "
    )
    clause += f"the {len(quantities)} quantities that matter"
    exceeding = [bound_words(bound) for bound in quantities if not bound.holds and not bound.not_seen]
    if exceeding:
        clause += f", and the best value is beyond what matters for {joined(exceeding)}"
    verdict_sentences = [f"{clause}."]
    if cause := _named_cause(gap):
        verdict_sentences.append(f"{_subject(cause)} would explain what is left{_tolerance_absorption_words(gap)}.")
    return verdict_sentences + _undetermined_quantity_sentences(gap)


def _small_sentences(gap: Diagnosis) -> list[str]:
    bounds = _upper_bound_words(gap.evidence.quantities)
    if cause := _named_cause(gap):
        return [f"{_subject(cause)} {_inflected(cause, 'is', 'are')} there, too small to matter: {bounds}."]
    clause = f"The machine differs from rig.json ({model_p_value_words(gap.evidence.p_value)}), by too little to matter"
    return [
        f"{clause}: {bounds}. {_no_named_effect_sentence(gap)}",
        *([_force_description(gap, "The difference")] if gap.unknown else []),
    ]


def _explained_sentences(gap: Diagnosis) -> list[str]:
    cause = gap.causes[0]
    explained, them = f"{_subject(cause)} {_inflected(cause, 'explains', 'explain')} the difference", _pronoun(cause)
    p_words = model_p_value_words(gap.evidence.p_value)
    if not gap.evidence.held_back_shows:
        return [
            f"{explained} ({p_words}), by all records together: the one that was not fitted shows too little of it."
        ]
    if _is_mismatch_below_noise(gap) and gap.before.largest_pull >= STRAINED_DEVIATIONS:
        pull_words = number(gap.before.largest_pull, 2)
        return [
            f"{explained}, which a tolerance would have to take up without {them}: it would be off by {pull_words} "
            "standard deviations."
        ]
    if (
        beyond := _deviating_parameters_sentence(gap)
    ) and not gap.before.contact_shares:  # rings, by their contact fit alone
        return [f"{explained} ({p_words}).", *beyond]
    p_value_after = gap.evidence.p_value_after
    level = "noise level" if p_value_after >= USUAL_P_VALUE else "too little to matter"
    shares_hold = all(bound.holds for bound in gap.evidence.quantities if bound.unit == "1")
    strain_words = _strained_tolerance_words(gap) if shares_hold else ""
    return [
        f"{explained}: with {them} {error_change_words(gap.before, gap.after)}, {level} "
        f"({p_value_words(p_value_after)} of what is left){strain_words}{_tolerance_absorption_words(gap)}."
    ]


def _tolerance_absorption_words(gap: Diagnosis) -> str:
    """Clause on what the named effects change, where tolerances take that up without them."""
    if not gap.evidence.is_absorbed_by_tolerances:
        return ""
    changed = [
        f"the {percent(bound.value)} of the {bound.name}"
        for bound in gap.evidence.quantities_beside
        if bound.value is not None and not bound.holds
    ]
    change = _inflected(gap.causes[0], "it changes", "they change")
    return f"; tolerances take up the rest of {joined(changed)} that {change}"


def _strained_tolerance_words(gap: Diagnosis) -> str:
    if gap.before.largest_pull < STRAINED_DEVIATIONS:
        return ""
    return f"; without it a tolerance would be off by {number(gap.before.largest_pull, 2)} standard deviations"


def _partly_explained_sentences(gap: Diagnosis) -> list[str]:
    cause = gap.causes[0]
    return [
        f"{_subject(cause)} {_inflected(cause, 'explains', 'explain')} the difference in part: "
        f"{_inflected(cause, 'it', 'they')} {_removal_words(gap, '')}, and {stays_unexplained_words(gap)}.",
        *_veto_sentence(gap),
        *_fuller_cause_sentence(gap),
        _force_description(gap, "The rest"),
    ]


def _unexplained_sentences(gap: Diagnosis) -> list[str]:
    clause = f"The machine differs from rig.json ({model_p_value_words(gap.evidence.p_value)})"
    verdict_sentences = [
        f"{clause}, but noise hides by how much: no motion is left beyond it{_strained_tolerance_words(gap)}."
        if _is_mismatch_below_noise(gap)
        else f"{clause}, which leaves {unexplained_words(gap.before)} unexplained."
    ]
    if cause := _named_cause(gap):
        are, removal = _inflected(cause, "is", "are"), _removal_words(gap, " of the difference")
        verdict_sentences += [f"{_subject(cause)} {are} likely, and {removal}.", *_veto_sentence(gap)]
        verdict_sentences += _fuller_cause_sentence(gap)
    else:
        verdict_sentences.append(_no_named_effect_sentence(gap))
    return [*verdict_sentences, *_deviating_parameters_sentence(gap), _force_description(gap, "The difference")]


def _deviating_parameters_sentence(gap: Diagnosis) -> list[str]:
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


def _no_named_effect_sentence(gap: Diagnosis) -> str:
    """Sentence that nothing is named, with the likeliest cause where it is likelier than all else together."""
    if gap.causes and gap.causes[0].probability > 0.5:
        is_size_uncertain = any(
            strength.inclusion_probability >= NAMED_PROBABILITY and not strength.is_named
            for strength in gap.causes[0].strengths
        )
        cause_words, probability_words = joined(gap.causes[0].words), probability(gap.causes[0].probability)
        doubt = f"has a probability of {probability_words}"
        if is_size_uncertain:
            doubt = "may be nothing: its interval includes no change"
        return f"No effect of the library is certain enough to be named; the likeliest, {cause_words}, {doubt}."
    return "No effect of the library is named for it."


def _fuller_cause_sentence(gap: Diagnosis) -> list[str]:
    """Sentence on a likelier cause with the named effects and further ones, whose intervals do not exclude that they
    are nothing."""
    named_effects = {strength.effect for strength in gap.causes[0].strengths}
    for cause in gap.causes[1:]:
        words_by_effect = {s.effect: words for s, words in zip(cause.strengths, cause.words, strict=True)}
        if cause.probability > 0.5 and named_effects < words_by_effect.keys():
            further_words = [words for effect, words in words_by_effect.items() if effect not in named_effects]
            return [
                f"Beside {_pronoun(gap.causes[0])} there may be {joined(further_words)}, of uncertain size "
                f"({probability(cause.probability)}): together they remove {percent(cause.explained)}."
            ]
    return []


def _pronoun(cause: Cause) -> str:
    return _inflected(cause, "it", "them")


def _subject(cause: Cause) -> str:
    return capitalised(joined(cause.named))


def _inflected(cause: Cause, singular: str, plural: str) -> str:
    """Word for one named effect, or for several."""
    return singular if len(cause.named) == 1 else plural


def _removal_words(gap: Diagnosis, of_what: str) -> str:
    """Clause on what the named effects remove of the mismatch."""
    cause = gap.causes[0]
    removes = _inflected(cause, "removes", "remove")
    if _is_mismatch_below_noise(gap):
        removed_share = max(gap.evidence.removed, 0.0)
        strain = f"{percent(removed_share)} of what strains its tolerances"
        return f"{removes} {strain if removed_share else 'nothing that is seen'}"
    return f"{removes} {percent(cause.explained) if cause.explained > 0 else 'nothing'}{of_what}"


def _is_mismatch_below_noise(gap: Diagnosis) -> bool:
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
    """Upper bounds: "the error of the motion is at most 0.3 % and that of the force of contact_1 less than 0.1 %"."""
    share_bounds = [bound for bound in quantities if bound.unit == "1"]
    uppers = [(bound.name, bound.upper) for bound in share_bounds if bound.upper is not None]
    clauses = [f"that of the {name} at most {share_words(upper)}" for name, upper in uppers]
    words = joined(clauses or ["no error is seen"]).replace("that of the motion", "the error of the motion is", 1)
    if len(quantities) > len(share_bounds):
        words += ", and no clearance, stiffness or damping is off by more than three tolerances"
    return words.replace("at most < ", "less than ")


def _undetermined_quantity_sentences(gap: Diagnosis) -> list[str]:
    """Sentences on quantities that the records neither bound nor show, and on what would show them: with the named
    effects where these correct the rig."""
    bounds = gap.not_seen
    if gap.verdict in (Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED):
        parameters = tuple(bound for bound in bounds if bound.unit != "1")
        shares = tuple(bound for bound in gap.evidence.quantities_after if bound.unit == "1" and bound.not_seen)
        # of a part that is left, the verdict's own sentence names the shares
        bounds = parameters if gap.verdict == Verdict.PARTLY_EXPLAINED else (*shares, *parameters)
    return [unsettled_sentence(bound) for bound in bounds]


def _force_description(gap: Diagnosis, subject: str) -> str:
    """Sentence on an unmeasured force that describes the difference, or its rest, with its share if that is small."""
    if any(note.analysis == "unmeasured_force" for note in gap.notes):
        return f"{subject} was not compared with unmeasured forces."
    if gap.unknown is None or gap.unknown.explained < MIN_HINT_SHARE:
        return f"{subject} looks like no single force that is known here."
    force, explained = gap.unknown.sentence, gap.unknown.explained
    if explained >= MIN_DESCRIPTION_SHARE:
        return f"{subject} looks like {force}."
    return f"{subject} has no simple form; the nearest explains {percent(explained)} of its mean square: {force}."


def _look_alike_words(gap: Diagnosis) -> list[str]:
    """Sentences on candidates that may replace a named effect."""
    return [
        f"Instead of {effect_words} it may be {joined(look_alikes, 'or')}: these records hardly tell them apart."
        for effect_words, look_alikes in named_effects_with_look_alikes(gap)
    ]


def _parameters_at_limit(gap: Diagnosis) -> list[str]:
    """Sentence on parameters at the limit of their range: their true value or their effect may be another."""
    cause = _named_cause(gap)
    names = [name for name, value in cause.parameters.items() if value.at_limit] if cause else []
    if not names:
        return []
    range_words = "is the end of its range" if len(names) == 1 else "are the ends of their ranges"
    return [f"The best {joined(names)} {range_words}: the true value may lie beyond, or the effect is another."]
