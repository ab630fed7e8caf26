"""Sections of gap.html as HTML: texts and tables."""

from collections.abc import Mapping, Sequence
from html import escape

from msgspec.structs import replace

from identify.gaps import wording
from identify.gaps.decision_table import (
    DIFFERENCE_P_VALUE,
    NAMED_PROBABILITY,
    USUAL_P_VALUE,
    Bounded,
    Evidence,
    are_all_below_threshold,
)
from identify.gaps.page.advice import MAX_RANGES, next_steps, place, range_words, unexplained_ranges_hz
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
    probability,
    remaining_probabilities,
    removed_share_words,
)
from identify.pages import page
from identify.pages.wording import number, p_value_words, percent
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
    contact_names = list(gap.before.contact_shares)
    signal_names = ["the motion", *(f"the force of {name}" for name in contact_names)]
    limits = [percent(share) for share in (gap.matters.motion, *[gap.matters.contact] * len(contact_names))]
    header, columns = ["error of", "the model as it is"], [_share_words(gap.before)]
    is_explained = bool(gap.causes) and is_effective(gap.causes[0])
    if is_explained:
        header.append("with the likeliest cause")
        columns.append(_share_words(gap.after))
    html = (
        "<p>Error: the share of a signal's rms that the model does not explain, beyond sensor noise, on the record "
        "held back, to which no parameter was fitted.</p>"
    )
    html += page.table((*header, "what matters"), zip(signal_names, *columns, limits, strict=True))
    if ranges_hz := unexplained_ranges_hz(gap)[:MAX_RANGES]:
        words = range_words(ranges_hz)
        html += f"<p>From {words} the rest is more than tolerances and noise leave, and enough to matter.</p>"
    if gap.channel_faults:
        html += "<h3>Channels left out</h3>" + page.table(("channel", "fault"), gap.channel_faults.items())
    return html


def cause_tables_html(gap: Gap) -> str:
    """Tables of the causes: probabilities, removed and unexplained shares, parameters and places."""
    top_causes, further_causes = gap.causes[:MAX_CAUSES], gap.causes[MAX_CAUSES:]
    contact_names = list(gap.before.contact_shares)
    leaves = ("leaves of the motion", *(f"leaves of {name}" for name in contact_names))
    header = ("cause", "probability", "removes", *leaves)
    remaining = remaining_probabilities(gap, MAX_CAUSES)
    remaining_rows = [(words, probability(p), *[""] * (2 + len(contact_names))) for words, p in remaining]
    html = (
        "<p>Each row is a set of effects from the library, or no effect, or something unmeasured; the probabilities "
        "sum to one. A cause removes the share by which its effects make the difference on the validation record "
        "smaller while what the tolerances leave open stays as it is (95 % interval in brackets).</p>"
    )
    html += page.table(header, [*map(_cause_row, top_causes), *remaining_rows])
    if alternatives := wording.named_effects_with_look_alikes(gap):
        html += "<h3>What these records can hardly tell apart</h3>"
        html += page.list_html(" / ".join([effect, *look_alikes]) for effect, look_alikes in alternatives)
    if effective := [cause for cause in top_causes if is_effective(cause)]:
        html += "<h3>Parameters and places</h3><p>± is the half-width of the 95 % interval.</p>"
        html += "".join(map(_parameter_table, effective))
    if judged := (*(cause for cause in top_causes if not is_effective(cause)), *further_causes):
        further_table = page.table(header, map(_cause_row, further_causes)) if further_causes else ""
        tables = further_table + "".join(map(_parameter_table, judged))
        html += f"<details><summary>Other causes that were judged</summary>{tables}</details>"
    return html


def decision_html(gap: Gap) -> str:
    """Decision: four questions with their answers, and the numbers from which these follow."""
    evidence, criteria = gap.evidence, gap.criteria
    questions = [
        (
            "Is there a difference?",
            _yes_no(criteria.differs),
            f"{p_value_words(evidence.p_value)} of all records; yes below {DIFFERENCE_P_VALUE:g}",
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
            _enough_words(evidence) if criteria.named else "",
        ),
    ]
    verdict = escape(VERDICT_WORDS[gap.verdict])
    html = f"<p>Four questions decide. Their answers give the verdict: {verdict}.</p>"
    html += page.table(("", "", ""), questions)
    quantities = [_quantity_row(quantity) for quantity in evidence.quantities]
    for quantity in evidence.quantities_beside * evidence.is_absorbed_by_tolerances:
        quantities.append(_quantity_row(replace(quantity, name=f"{quantity.name}, by the named effects")))
    html += "<h3>What matters</h3>" + page.table(("quantity", "found", "at most (97.5 %)", "limit", ""), quantities)
    for cause in gap.causes[:1]:
        effects = [
            (words, probability(strength.inclusion_probability), "named" if strength.is_named else "")
            for words, strength in zip(cause.words, cause.strengths, strict=True)
        ]
        html += "<h3>Effects</h3>" + page.table(("effect", "probability", ""), effects)
    return html


def _enough_words(evidence: Evidence) -> str:
    """What decides whether the named effects explain enough: a certainly small rest, else its p-value."""
    p_words = f"{p_value_words(evidence.p_value_after)} of what is left"
    if are_all_below_threshold(evidence.quantities_after):
        return f"yes, as every upper bound of what is left is below its limit ({p_words})"
    return f"{p_words}; yes from {USUAL_P_VALUE:g} on, or if every upper bound of what is left is below its limit"


def _yes_no(answer: bool) -> str:
    return "yes" if answer else "no"


def _quantity_row(quantity: Bounded) -> tuple[str, ...]:
    if quantity.why or quantity.value is None:
        return quantity.name, "", "", "", f"not settled: {quantity.why}"
    mark_words = "" if quantity.holds else "not settled" if quantity.not_seen else "beyond"
    return quantity.name, *wording.value_bound_and_limit_texts(quantity), mark_words


def prediction_html(rollout: Rollout) -> str:
    """Errors of predictions from measured states, and what they decided."""
    html = f"<p>{escape(capitalised(wording.PREDICTION_WORDS[rollout.code]))}.</p>"
    errors = rollout.whole
    if errors is None:
        return html
    floor_words = (
        "rig.json errs no more than null simulations do"
        if errors.is_within_null_errors
        else f"the corrected rig removes {percent(errors.shrunk or 0.0)} of the mean square beyond null simulations"
    )
    rows = [
        ("rig.json", percent(errors.nominal)),
        ("rig.json within its tolerances", percent(rollout.within or 0.0)),
        ("corrected rig", percent(errors.corrected)),
        ("null simulations, median and 95 %", f"{percent(errors.null_median)}, {percent(errors.null_95)}"),
    ]
    html += f"<p>Median error over {rollout.windows} windows of {rollout.horizon_s:.3g} s, as a share of the motion: "
    return html + f"{floor_words}.</p>" + page.table(("predicted by", "error"), rows)


def record_differences_html(between: RecordDifferences) -> str:
    """Estimates of each record for the parameters that differ and for those of the likeliest cause."""
    html = f"<p>{escape(wording.between_records_sentence(between))}</p>"
    if comparisons := [*between.differing, *between.cause]:
        header = ("parameter", "place", *(f"record {title}" for title in between.records), "", "p-value")
        html += page.table(header, map(_comparison_row, comparisons))
        html += (
            "<p>Each record's own value with the half-width of its 95 % interval beside the mean of all records: "
            "tolerances of the rig are shared and not in it. p-value: how often records of an unchanged machine differ "
            f"as much; of what differs, times the {between.looked_at} effects looked at.</p>"
        )
    if between.cause_p_value is not None:
        agree = "agree" if between.cause_p_value >= USUAL_P_VALUE else "do not agree"
        p_words = escape(p_value_words(between.cause_p_value))
        html += f"<p>The records {agree} on the likeliest cause ({p_words}).</p>"
    return html


def unknown_force_html(unknown: UnmeasuredForce) -> str:
    """Unmeasured force: a sentence and a table."""
    description = capitalised(unknown.sentence)
    rows: list[tuple[str, str]] = [("what", _KINDS[unknown.kind])]
    if unknown.body is not None:
        rows.append(("where", place(unknown)))
    if unknown.position_m is not None and unknown.position_error_m is not None:
        rows.append(("from the left end", interval(Value(unknown.position_m, unknown.position_error_m, "m"))))
        rows.append(("second record alone", "the same place" if unknown.same_place else "another place: doubt it"))
    for body_name, growth in unknown.growth.items():
        growth_percent = Value(100 * growth.value, 100 * growth.standard_error, "%")
        rows.append((f"stiffness of the {body_name}, change", interval(growth_percent)))
    force_unit = "m/s²" if unknown.kind == "sensor" else "N"
    if unknown.frequency_hz is not None:
        frequency = unknown.law_parameters.get("f", Value(unknown.frequency_hz, 0.0, "Hz"))
        rows.append(("frequency", interval(frequency)))
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
    if unknown.explained < wording.MIN_DESCRIPTION_SHARE:
        description = f"It has no simple form. The nearest is {unknown.sentence}"
    html = f"<p>{escape(description)}.</p>" + page.table(("", ""), rows)
    if unknown.law:
        html += (
            '<p class="dim">The formula gives the force against the motion at that place: w is its displacement in m, '
            "v its velocity in m/s.</p>"
        )
    return html


def location_html(attribution: Attribution) -> str:
    """Location of the mismatch: the largest share by each way of dividing the record, and all shares."""
    divisions: dict[str, Mapping[str, float]] = {
        "channel": attribution.channels,
        "linear or contact": attribution.parts,
        "modal equation": attribution.modal_equations,
        "station": {
            f"{body}, {position_m:g} m": share
            for body, station_shares in attribution.positions_m.items()
            for position_m, share in station_shares.items()
        },
        "band": _shares_by_range(attribution.band_hz, "Hz"),
        "contact state": attribution.contact_state,
        "time": _shares_by_range(attribution.time_s, "s"),
    }
    largest_rows, all_rows = [], []
    for division, shares in divisions.items():
        if any(shares.values()):
            largest = max(shares, key=shares.__getitem__)
            largest_rows.append((division, largest, percent(shares[largest])))
            all_rows += [(division, part, percent(share)) for part, share in shares.items()]
    return (
        "<p>The mean square of what the model as it is leaves unexplained, divided in several ways: the largest share "
        "of each. The shares of one way sum to the whole.</p>"
        + page.table(("by", "largest", "share"), largest_rows)
        + f"<details><summary>All shares</summary>{page.table(('by', 'part', 'share'), all_rows)}</details>"
    )


def failed_analyses_html(gap: Gap) -> str:
    """Side analyses that could not be made; the verdict does not rest on them."""
    return "".join(f"<p>{escape(note)}</p>" for note in wording.failed_analysis_sentences(gap))


def _share_words(unexplained: UnexplainedShares) -> list[str]:
    return [wording.share_words(share) for share in (unexplained.share, *unexplained.contact_shares.values())]


def _cause_row(cause: Cause) -> tuple[str, ...]:
    return cause_name(cause), probability(cause.probability), removed_share_words(cause), *_share_words(cause.left)


def _comparison_row(comparison: ParameterByRecord) -> tuple[str, ...]:
    trend = comparison.trend if comparison.trend != "none" else ""
    values = (interval(value) for value in comparison.values)
    return comparison.parameter, comparison.place, *values, trend, p_value_words(comparison.p_value)


def _parameter_table(cause: Cause) -> str:
    rows = [
        (name, interval(value), wording.RATIO_WORDS.get(name.rpartition(".")[2], ""))
        for name, value in cause.parameters.items()
    ]
    rows += [(name, place, "") for name, place in cause.places.items()]
    return page.table((cause_name(cause), "", ""), rows) if rows else ""


def _shares_by_range(shares: Sequence[Share], unit: str) -> dict[str, float]:
    return {f"{share.begin:.3g} to {share.end:.3g} {unit}": share.share for share in shares}
