"""Sections of gap.html as HTML: texts and tables."""

from collections.abc import Mapping, Sequence
from html import escape

from msgspec.structs import replace

from identify.gaps import wording
from identify.gaps.decision_table import DIFFERENCE_P_VALUE, NAMED_PROBABILITY, USUAL_P_VALUE, Bounded
from identify.gaps.page.advice import next_steps, place, unexplained_ranges_hz
from identify.gaps.results import (
    Attribution,
    Cause,
    Gap,
    ParameterByRecord,
    RecordDifferences,
    Share,
    UnexplainedShares,
)
from identify.gaps.rollout.results import Rollout
from identify.gaps.wording import (
    VERDICT_WORDS,
    WHEN_WORDS,
    capitalised,
    cause_name,
    interval,
    is_effective,
    joined,
    p_value_words,
    probability,
    remaining_probabilities,
    removed_share_words,
)
from identify.pages import page
from identify.pages.wording import number, percent
from rig.model.unmeasured_force import UnmeasuredForce, Value

MAX_CAUSES = 5
"""Causes shown at once; the others are folded away."""
_KINDS = {
    "force": "a force on one body",
    "pair": "a pair of opposite forces between two bodies",
    "sensor": "a fault of a sensor",
    "distributed": "a stiffness that changes over the record",
    "contact": "a clearance that swings",
}


def next_steps_list(gap: Gap) -> str:
    """Numbered list of the next steps."""
    return "<ol>" + "".join(f"<li>{page.unbroken_html(escape(step))}</li>" for step in next_steps(gap)) + "</ol>"


def mismatch_size_html(gap: Gap) -> str:
    """Unexplained shares before and after, the thresholds of what matters, and the p-values."""
    signal_names = ["the motion", *(f"the force of {name}" for name in gap.before.contact_shares)]
    share_limits = [gap.matters.motion, *([gap.matters.contact] * len(gap.before.contact_shares))]
    share_columns = [_share_words(gap.before)]
    header = ["unexplained share of", "the model as it is"]
    is_explained = bool(gap.causes) and is_effective(gap.causes[0])
    if is_explained:
        header.append("with the likeliest cause")
        share_columns.append(_share_words(gap.after))
    rows = list(zip(signal_names, *share_columns, [percent(share_limit) for share_limit in share_limits], strict=True))
    section_html = (
        "<p>The share of a signal's rms that the model does not explain, beyond sensor noise, on the validation "
        "record: no parameter was fitted to it.</p>"
    )
    section_html += page.table((*header, "what matters"), rows)
    section_html += f"<p>{escape(_p_value_sentence('The model as it is', gap.before))}"
    section_html += (
        f" {escape(_p_value_sentence('With the likeliest cause, it', gap.after))}</p>" if is_explained else "</p>"
    )
    if ranges_hz := unexplained_ranges_hz(gap)[:3]:
        band_words = joined([f"{low_hz:g} to {high_hz:g} Hz" for low_hz, high_hz in sorted(ranges_hz)])
        section_html += f"<p>From {band_words} the rest is more than null simulations leave, and enough to matter.</p>"
    if gap.channel_faults:
        section_html += "<h3>Channels left out</h3>" + page.table(("channel", "fault"), gap.channel_faults.items())
    return section_html


def cause_tables_html(gap: Gap) -> str:
    """Tables of the causes: probabilities, removed and unexplained shares, parameters and places."""
    top_causes, remaining_causes = gap.causes[:MAX_CAUSES], gap.causes[MAX_CAUSES:]
    contact_names = list(gap.before.contact_shares)
    header = (
        "cause",
        "probability",
        "closes",
        "leaves of the motion",
        *(f"leaves of {row_name}" for row_name in contact_names),
    )
    remaining = remaining_probabilities(gap)
    if remaining_causes:
        remaining.insert(
            0, (f"{len(remaining_causes)} further causes", sum(cause.probability for cause in remaining_causes))
        )
    remaining_rows = [(row_name, probability(p), *[""] * (2 + len(contact_names))) for row_name, p in remaining]
    section_html = (
        "<p>Each row is a set of effects from the library, or no effect, or something unmeasured; the probabilities "
        "sum to one. A cause closes the share by which its effects make the difference on the validation record "
        "smaller while what the tolerances leave open stays as it is (95 % interval in brackets).</p>"
    )
    section_html += page.table(header, [*(_cause_row(cause) for cause in top_causes), *remaining_rows])
    if alternatives := wording.look_alikes_of(gap):
        section_html += "<h3>What these records can hardly tell apart</h3>"
        section_html += page.list_html(
            " / ".join([effect_words, *look_alikes]) for effect_words, look_alikes in alternatives
        )
    effective_causes = [cause for cause in top_causes if is_effective(cause)]
    if effective_causes:
        section_html += "<h3>Parameters and places</h3><p>Value ± 1.96 standard errors: the 95 % interval.</p>"
        section_html += "".join(_parameter_table(cause) for cause in effective_causes)
    ineffective_causes = [cause for cause in top_causes if not is_effective(cause)]
    if ineffective_causes or remaining_causes:
        remaining_table = (
            page.table(header, [_cause_row(cause) for cause in remaining_causes]) if remaining_causes else ""
        )
        parameter_tables = "".join(_parameter_table(cause) for cause in (*ineffective_causes, *remaining_causes))
        section_html += (
            f"<details><summary>Other causes that were judged</summary>{remaining_table}{parameter_tables}</details>"
        )
    return section_html


def decision_html(gap: Gap) -> str:
    """Decision: four questions with their answers, and the numbers from which these follow."""
    evidence, criteria = gap.evidence, gap.criteria
    question_rows = [
        (
            "Is there a difference?",
            _yes_no(criteria.differs),
            f"{p_value_words(evidence.p_value)}: yes below {DIFFERENCE_P_VALUE:g}",
        ),
        (
            "Is it certainly too small to matter?",
            _yes_no(criteria.bounded),
            "yes if every upper bound is below its limit",
        ),
        (
            "Is an effect named?",
            _yes_no(bool(criteria.named)),
            f"yes if its probability is at least {percent(NAMED_PROBABILITY)} and its interval excludes its absence",
        ),
        (
            "Does it explain enough?",
            _yes_no(criteria.enough) if criteria.named else "",
            f"what is left has {p_value_words(evidence.p_value_after)}: yes from {USUAL_P_VALUE:g} on, or if it is "
            "certainly too small to matter",
        ),
    ]
    section_html = (
        f"<p>Four questions decide. Their answers give the verdict: {escape(VERDICT_WORDS[gap.verdict])}.</p>"
        + page.table(("", "", ""), question_rows)
    )
    quantity_rows = [_quantity_row(quantity) for quantity in evidence.quantities]
    for quantity in evidence.quantities_beside * evidence.taken_up:
        quantity_rows.append(_quantity_row(replace(quantity, name=f"{quantity.name}, by the named effects")))
    section_html += "<h3>What matters</h3>"
    section_html += page.table(("quantity", "found", "at most (97.5 %)", "limit", ""), quantity_rows)
    if gap.causes:
        likeliest = gap.causes[0]
        words_and_strengths = zip(likeliest.words, likeliest.strengths, strict=True)
        effect_rows = [
            (w, probability(s.inclusion_probability), "named" if s.is_named else "") for w, s in words_and_strengths
        ]
        section_html += "<h3>Effects</h3>" + page.table(("effect", "probability", ""), effect_rows)
    return section_html


def _yes_no(answer: bool) -> str:
    return "yes" if answer else "no"


def _quantity_row(quantity: Bounded) -> tuple[str, ...]:
    if quantity.why or quantity.value is None:
        return quantity.name, "", "", "", f"not settled: {quantity.why}"
    mark_words = "" if quantity.holds else "not settled" if quantity.not_seen else "beyond"
    return quantity.name, *wording.bound_numbers(quantity), mark_words


def prediction_html(rollout: Rollout) -> str:
    """Errors of predictions from measured states, and what they decided."""
    section_html = f"<p>{escape(capitalised(wording.PREDICTION_WORDS[rollout.code]))}.</p>"
    overall_errors = rollout.whole
    if overall_errors is None:
        return section_html
    floor_words = (
        "rig.json errs no more than null simulations do"
        if overall_errors.at_floor
        else f"the corrected rig closes {percent(overall_errors.shrunk or 0.0)} of what exceeds null simulations"
    )
    error_rows = [
        ("rig.json", percent(overall_errors.nominal)),
        ("rig.json within its tolerances", percent(rollout.within or 0.0)),
        ("corrected rig", percent(overall_errors.corrected)),
        (
            "null simulations, median and 95 %",
            f"{percent(overall_errors.null_median)}, {percent(overall_errors.null_95)}",
        ),
    ]
    return section_html + (
        f"<p>Median error over {rollout.windows} windows of {rollout.horizon_s:.3g} s, as a share of the motion: "
        f"{floor_words}.</p>" + page.table(("predicted by", "error"), error_rows)
    )


def record_differences_html(between: RecordDifferences) -> str:
    """Estimates of each record for the parameters that differ and for those of the likeliest cause."""
    section_html = f"<p>{escape(wording.between_records_sentence(between))}</p>"
    comparisons = [*between.differing, *between.cause]
    if comparisons:
        header = ("parameter", "place", *(f"record {record_title}" for record_title in between.records), "", "p-value")
        section_html += page.table(header, [_comparison_row(comparison) for comparison in comparisons])
        section_html += (
            "<p>Each record's own value ± 1.96 standard errors beside the mean of all records: tolerances of the rig "
            "are shared and not in them. p-value: how often records of an unchanged machine differ as much; of what "
            f"differs, times the {between.looked_at} effects looked at.</p>"
        )
    if between.cause_p_value is not None:
        agree_verb = "agree" if between.cause_p_value >= USUAL_P_VALUE else "do not agree"
        section_html += (
            f"<p>The records {agree_verb} on the likeliest cause (p-value {percent(between.cause_p_value)}).</p>"
        )
    return section_html


def unknown_force_html(unknown: UnmeasuredForce) -> str:
    """Unmeasured force: a sentence and a table."""
    description = unknown.sentence[:1].upper() + unknown.sentence[1:]
    rows: list[tuple[str, str]] = [("what", _KINDS[unknown.kind])]
    if unknown.body is not None:
        rows.append(("where", place(unknown)))
    if unknown.position_m is not None and unknown.position_error_m is not None:
        rows.append(("from the left end", interval(Value(unknown.position_m, unknown.position_error_m, "m"))))
        rows.append(("second record alone", "the same place" if unknown.same_place else "another place: doubt it"))
    rows += [
        (f"stiffness of the {body_name}, change", _growth_percent(modulus_growth))
        for body_name, modulus_growth in unknown.growth.items()
    ]
    force_unit = "m/s²" if unknown.kind == "sensor" else "N"
    if unknown.frequency_hz is not None:
        rows.append(("frequency", f"{number(unknown.frequency_hz)} Hz"))
    low_hz, high_hz = unknown.band_hz
    rows.append(("90 % of its power lies from", f"{low_hz:.3g} to {high_hz:.3g} Hz"))
    rows.append(("size", f"{number(unknown.rms_n, 3)} {force_unit} rms"))
    if unknown.amplitude_n is not None:
        rows.append(("amplitude", f"{number(unknown.amplitude_n, 3)} {force_unit}"))
    rows.append(("when", WHEN_WORDS[unknown.when]))
    if unknown.against != "none":
        rows.append(("grows with", unknown.against))
    if unknown.law:
        rows.append(("formula", unknown.law))
    rows.append(("explains, of the linear residual's mean square", percent(unknown.explained)))
    if unknown.explained < wording.DESCRIPTION_EXPLAINED:
        description = f"It has no simple form. The nearest is {unknown.sentence}"
    section_html = f"<p>{escape(description)}.</p>" + page.table(("", ""), rows)
    if unknown.law:
        section_html += (
            '<p class="dim">The formula gives the force against the motion at that place: w is its displacement in m, '
            "v its velocity in m/s.</p>"
        )
    return section_html


def location_html(attribution: Attribution) -> str:
    """Location of the mismatch: the largest share by each way of dividing the record, and all shares."""
    divisions: dict[str, Mapping[str, float]] = {
        "channel": attribution.channels,
        "linear or contact": attribution.parts,
        "modal equation": attribution.modal_equations,
        "station": {
            f"{body_name}, {position_m:g} m": station_share
            for body_name, share_by_station in attribution.positions_m.items()
            for position_m, station_share in share_by_station.items()
        },
        "band": _shares_by_range(attribution.band_hz, "Hz"),
        "contact state": attribution.contact_state,
        "time": _shares_by_range(attribution.time_s, "s"),
    }
    divisions = {division: part_shares for division, part_shares in divisions.items() if any(part_shares.values())}
    largest_categories = {
        division: max(part_shares.items(), key=lambda item: item[1]) for division, part_shares in divisions.items()
    }
    largest_rows = [(division, category, percent(share)) for division, (category, share) in largest_categories.items()]
    all_share_rows = [
        (division, category, percent(share))
        for division, part_shares in divisions.items()
        for category, share in part_shares.items()
    ]
    return (
        "<p>What the model as it is leaves unexplained, divided in several ways: the largest share of each. The shares "
        "of one way sum to 100 %.</p>"
        + page.table(("by", "largest", "share"), largest_rows)
        + f"<details><summary>All shares</summary>{page.table(('by', 'part', 'share'), all_share_rows)}</details>"
    )


def failed_analyses_html(gap: Gap) -> str:
    """Side analyses that could not be made; the verdict does not rest on them."""
    return "".join(f"<p>{escape(note)}</p>" for note in wording.failed_analysis_sentences(gap))


def _share_words(unexplained: UnexplainedShares) -> list[str]:
    return [percent(share) for share in (unexplained.share, *unexplained.contact_shares.values())]


def _p_value_sentence(rig_words: str, unexplained: UnexplainedShares) -> str:
    """Sentence on the p-value of the unexplained shares."""
    amount_words = "what" if unexplained.p_value >= USUAL_P_VALUE else "more than"
    frequency_clause = f"they alone would leave as much in {percent(unexplained.p_value)} of all cases (the p-value)"
    return f"{rig_words} leaves {amount_words} tolerances and noise explain: {frequency_clause}."


def _cause_row(cause: Cause) -> tuple[str, ...]:
    return cause_name(cause), probability(cause.probability), removed_share_words(cause), *_share_words(cause.left)


def _comparison_row(comparison: ParameterByRecord) -> tuple[str, ...]:
    record_trend_word = comparison.trend if comparison.trend != "none" else ""
    return (
        comparison.parameter,
        comparison.place,
        *(interval(value) for value in comparison.values),
        record_trend_word,
        percent(comparison.p_value),
    )


def _parameter_table(cause: Cause) -> str:
    rows = [
        *(
            (parameter_name, interval(value), wording.RATIO_WORDS.get(parameter_name.rpartition(".")[2], ""))
            for parameter_name, value in cause.parameters.items()
        ),
        *((place_name, place, "") for place_name, place in cause.places.items()),
    ]
    return page.table((cause_name(cause), "", ""), rows) if rows else ""


def _growth_percent(modulus_growth: Value) -> str:
    return interval(Value(100 * modulus_growth.value, 100 * modulus_growth.standard_error, "%"))


def _shares_by_range(interval_shares: Sequence[Share], range_unit: str) -> dict[str, float]:
    return {f"{share.begin:.3g} to {share.end:.3g} {range_unit}": share.share for share in interval_shares}
