"""Sections of gap.html as HTML: texts and tables."""

from collections.abc import Mapping, Sequence
from html import escape

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
    VERDICTS,
    WHEN,
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
PREDICTION_WORDS = {
    "not_vetoed": "nothing speaks against it",
    "worse": "the corrected rig predicts worse: no explanation",
    "no_improvement": "the prediction would improve if this were all, and does not: no explanation",
    "no_horizon": "null simulations cannot be predicted either",
    "too_short": "the record has too few seconds",
    "not_simulated": "the simulator cannot start from measured states",
}
"""Result of the prediction in words, by its code."""


def next_steps_list(gap: Gap) -> str:
    """Numbered list of the next steps."""
    return "<ol>" + "".join(f"<li>{page.unbroken_html(escape(step))}</li>" for step in next_steps(gap)) + "</ol>"


def mismatch_size(gap: Gap) -> str:
    """Unexplained shares before and after, the thresholds of what matters, and the p-values."""
    names = ["the motion", *(f"the force of {name}" for name in gap.before.contact_shares)]
    limits = [gap.matters.motion, *([gap.matters.contact] * len(gap.before.contact_shares))]
    columns = [_share_words(gap.before)]
    header = ["unexplained share of", "believed rig"]
    explained = bool(gap.causes) and is_effective(gap.causes[0])
    if explained:
        header.append("with the likeliest cause")
        columns.append(_share_words(gap.after))
    rows = list(zip(names, *columns, [percent(limit) for limit in limits], strict=True))
    text = (
        "<p>The share of a signal's rms that the rig does not explain, beyond sensor noise, on the validation record: "
        "a recording that no parameter was fitted to.</p>"
    )
    text += page.table((*header, "what matters"), rows)
    text += f"<p>{escape(_p_value_sentence('The believed rig', gap.before))}"
    text += f" {escape(_p_value_sentence('With the likeliest cause, the rig', gap.after))}</p>" if explained else "</p>"
    if ranges := unexplained_ranges_hz(gap)[:3]:
        band_words = joined([f"{low:g} to {high:g} Hz" for low, high in sorted(ranges)])
        subject = "What is left" if explained else "It"
        text += f"<p>{subject} is more than what matters, and than null simulations leave, from {band_words}.</p>"
    if gap.channel_faults:
        text += "<h3>Channels left out</h3>" + page.table(("channel", "fault"), gap.channel_faults.items())
    return text


def cause_tables(gap: Gap) -> str:
    """Tables of the causes: probabilities, removed and unexplained shares, parameters and places."""
    top_causes, remaining_causes = gap.causes[:MAX_CAUSES], gap.causes[MAX_CAUSES:]
    contacts = list(gap.before.contact_shares)
    header = ("cause", "probability", "closes", "leaves of the motion", *(f"leaves of {name}" for name in contacts))
    remaining = remaining_probabilities(gap)
    if remaining_causes:
        remaining.insert(0, (f"{len(remaining_causes)} further causes", sum(c.probability for c in remaining_causes)))
    remaining_rows = [(name, probability(p), *[""] * (2 + len(contacts))) for name, p in remaining]
    text = (
        "<p>Sets of effects of the library, beside no effect and something unmeasured. The probabilities of "
        "sets sum to one. A cause closes the share by which its effects alone make the difference smaller on the "
        "validation record, what the tolerances leave open held (95 % interval in brackets).</p>"
    )
    text += page.table(header, [*(_cause_row(c) for c in top_causes), *remaining_rows])
    if alternatives := wording.look_alikes_of(gap):
        text += "<h3>What these records hardly tell apart</h3>"
        text += page.list_html(" / ".join([words, *look_alikes]) for words, look_alikes in alternatives)
    effective_causes = [c for c in top_causes if is_effective(c)]
    if effective_causes:
        text += "<h3>Parameters and places</h3><p>Value ± 1.96 standard errors: the 95 % interval.</p>"
        text += "".join(_parameter_table(c) for c in effective_causes)
    ineffective_causes = [c for c in top_causes if not is_effective(c)]
    if ineffective_causes or remaining_causes:
        table = page.table(header, [_cause_row(c) for c in remaining_causes]) if remaining_causes else ""
        parameter_tables = "".join(_parameter_table(c) for c in (*ineffective_causes, *remaining_causes))
        text += f"<details><summary>Other causes that were judged</summary>{table}{parameter_tables}</details>"
    return text


def decision(gap: Gap) -> str:
    """Decision: four questions with their answers, and the numbers from which these follow."""
    evidence, criteria = gap.evidence, gap.criteria
    rows = [
        (
            "Is there a difference?",
            _yes_no(criteria.differs),
            f"{p_value_words(evidence.p_value)}: yes below {DIFFERENCE_P_VALUE:g}",
        ),
        ("Is all that matters bounded?", _yes_no(criteria.bounded), "yes if every upper bound lies below its limit"),
        (
            "Is an effect named?",
            _yes_no(bool(criteria.named)),
            f"yes from a probability of {percent(NAMED_PROBABILITY)} on, if the interval excludes no effect",
        ),
        (
            "Is that enough?",
            _yes_no(criteria.enough) if criteria.named else "",
            f"{p_value_words(evidence.p_value_after)} of what is left: yes from {USUAL_P_VALUE:g} on, or if that is "
            "bounded",
        ),
    ]
    text = f"<p>Four questions decide; their answers give: {escape(VERDICTS[gap.verdict])}.</p>" + page.table(
        ("", "", ""), rows
    )
    text += "<h3>What matters</h3>" + page.table(
        ("quantity", "found", "at most (97.5 %)", "limit", ""), [_quantity_row(q) for q in evidence.quantities]
    )
    if gap.causes:
        likeliest = gap.causes[0]
        strengths = zip(likeliest.words, likeliest.strengths, strict=True)
        names = [(w, probability(s.inclusion_probability), "named" if s.is_named else "") for w, s in strengths]
        text += "<h3>Effects</h3>" + page.table(("effect", "probability", ""), names)
    return text


def _yes_no(answer: bool) -> str:
    return "yes" if answer else "no"


def _quantity_row(quantity: Bounded) -> tuple[str, ...]:
    if quantity.why or quantity.value is None:
        return quantity.name, "", "", "", f"not seen: {quantity.why}"
    mark = "" if quantity.holds else "not seen" if quantity.not_seen else "beyond"
    values = (quantity.value, quantity.upper, quantity.threshold)
    if quantity.unit == "1":
        return quantity.name, *("no bound" if v is None else percent(v) for v in values), mark
    return quantity.name, *("no bound" if v is None else f"{number(v, 3)} {quantity.unit}" for v in values), mark


def prediction(rollout: Rollout) -> str:
    """Errors of predictions from measured states, and what they decided."""
    text = f"<p>{escape(capitalised(PREDICTION_WORDS[rollout.code]))}.</p>"
    overall = rollout.whole
    if overall is None:
        return text
    floor_words = (
        "rig.json is at the floor of what can be predicted"
        if overall.at_floor
        else f"the corrected rig closes {percent(overall.shrunk or 0.0)} of what null simulations do not have"
    )
    rows = [
        ("rig.json", percent(overall.nominal)),
        ("rig.json within its tolerances", percent(rollout.within or 0.0)),
        ("corrected rig", percent(overall.corrected)),
        ("null simulations, median and 95 %", f"{percent(overall.null_median)}, {percent(overall.null_95)}"),
    ]
    return text + (
        f"<p>Median error over {rollout.windows} windows of {rollout.horizon_s:.3g} s, as a share of the motion: "
        f"{floor_words}.</p>" + page.table(("predicted by", "error"), rows)
    )


def record_differences(between: RecordDifferences) -> str:
    """Estimates of each record for the parameters that differ and for those of the likeliest cause."""
    text = f"<p>{escape(wording.between_records(between))}</p>"
    rows = [*between.differing, *between.cause]
    if rows:
        header = ("parameter", "place", *(f"record {name}" for name in between.records), "", "p-value")
        text += page.table(header, [_comparison_row(comparison) for comparison in rows])
        text += (
            "<p>Each record's own value ± 1.96 standard errors beside the mean of all records: tolerances of the rig "
            "are shared and not in them. p-value: how often records of an unchanged machine differ as much; of what "
            f"differs, times the {between.looked_at} effects looked at.</p>"
        )
    if between.cause_p_value is not None:
        verb = "agree" if between.cause_p_value >= USUAL_P_VALUE else "do not agree"
        text += f"<p>The records {verb} on the likeliest cause (p-value {percent(between.cause_p_value)}).</p>"
    return text


def unknown_force(unknown: UnmeasuredForce) -> str:
    """Unmeasured force: a sentence and a table."""
    sentence = unknown.sentence[:1].upper() + unknown.sentence[1:]
    rows: list[tuple[str, str]] = [("what", _KINDS[unknown.kind])]
    if unknown.body is not None:
        rows.append(("where", place(unknown)))
    if unknown.position_m is not None and unknown.position_error_m is not None:
        rows.append(("from the left end", interval(Value(unknown.position_m, unknown.position_error_m, "m"))))
        rows.append(("second record alone", "the same place" if unknown.same_place else "another place: doubt it"))
    rows += [(f"stiffness of the {body}, change", _growth_percent(growth)) for body, growth in unknown.growth.items()]
    unit = "m/s²" if unknown.kind == "sensor" else "N"
    if unknown.frequency_hz is not None:
        rows.append(("frequency", f"{number(unknown.frequency_hz)} Hz"))
    low, high = unknown.band_hz
    rows.append(("90 % of its power lies from", f"{low:.3g} to {high:.3g} Hz"))
    rows.append(("size", f"{number(unknown.rms_n, 3)} {unit} rms"))
    if unknown.amplitude_n is not None:
        rows.append(("amplitude", f"{number(unknown.amplitude_n, 3)} {unit}"))
    rows.append(("when", WHEN[unknown.when]))
    if unknown.against != "none":
        rows.append(("grows with", unknown.against))
    if unknown.law:
        rows.append(("formula", unknown.law))
    rows.append(("explains, of the linear residual's mean square", percent(unknown.explained)))
    if unknown.explained < wording.DESCRIPTION_EXPLAINED:
        sentence = f"It has no simple form. The nearest is {unknown.sentence}"
    text = f"<p>{escape(sentence)}.</p>" + page.table(("", ""), rows)
    if unknown.law:
        text += (
            '<p class="dim">The formula gives the force against the motion at that place: w is its displacement in m, '
            "v its velocity in m/s.</p>"
        )
    return text


def location(attribution: Attribution) -> str:
    """Location of the mismatch: the largest share by each way of dividing the record, and all shares."""
    cuts: dict[str, Mapping[str, float]] = {
        "channel": attribution.channels,
        "linear or contact": attribution.parts,
        "modal equation": attribution.modal_equations,
        "station": {
            f"{body}, {position_m:g} m": s
            for body, stations in attribution.positions_m.items()
            for position_m, s in stations.items()
        },
        "band": _shares_by_range(attribution.band_hz, "Hz"),
        "contact state": attribution.contact_state,
        "time": _shares_by_range(attribution.time_s, "s"),
    }
    cuts = {name: shares for name, shares in cuts.items() if any(shares.values())}
    largest_categories = {name: max(shares.items(), key=lambda item: item[1]) for name, shares in cuts.items()}
    largest = [(name, category, percent(share)) for name, (category, share) in largest_categories.items()]
    all_shares = [
        (name, category, percent(share)) for name, shares in cuts.items() for category, share in shares.items()
    ]
    return (
        "<p>Of what the believed rig leaves unexplained: the largest share by every way of cutting the record. Each "
        "way sums to 100 %.</p>"
        + page.table(("by", "largest", "share"), largest)
        + f"<details><summary>All shares</summary>{page.table(('by', 'part', 'share'), all_shares)}</details>"
    )


def notes(gap: Gap) -> str:
    """Side analyses that could not be made; the verdict does not rest on them."""
    return "".join(f"<p>{escape(note)}</p>" for note in wording.not_computed(gap))


def _share_words(unexplained: UnexplainedShares) -> list[str]:
    return [percent(share) for share in (unexplained.share, *unexplained.contact_shares.values())]


def _p_value_sentence(rig: str, unexplained: UnexplainedShares) -> str:
    """Sentence on the p-value of the unexplained shares."""
    amount = "what" if unexplained.p_value >= USUAL_P_VALUE else "more than"
    frequency = f"alone they leave as much in {percent(unexplained.p_value)} of all cases (p-value)"
    return f"{rig} leaves {amount} tolerances and noise explain: {frequency}."


def _cause_row(cause: Cause) -> tuple[str, ...]:
    return cause_name(cause), probability(cause.probability), removed_share_words(cause), *_share_words(cause.left)


def _comparison_row(comparison: ParameterByRecord) -> tuple[str, ...]:
    trend = comparison.trend if comparison.trend != "none" else ""
    return (
        comparison.parameter,
        comparison.place,
        *(interval(value) for value in comparison.values),
        trend,
        percent(comparison.p_value),
    )


def _parameter_table(cause: Cause) -> str:
    rows = [*((name, interval(value)) for name, value in cause.parameters.items()), *cause.places.items()]
    return page.table((cause_name(cause), ""), rows) if rows else ""


def _growth_percent(growth: Value) -> str:
    return interval(Value(100 * growth.value, 100 * growth.standard_error, "%"))


def _shares_by_range(shares: Sequence[Share], unit: str) -> dict[str, float]:
    return {f"{s.begin:.3g} to {s.end:.3g} {unit}": s.share for s in shares}
