"""The sections of gap.html, as HTML: texts and tables."""

from collections.abc import Mapping, Sequence
from html import escape

from identify.gaps import wording
from identify.gaps.decision_table import USUAL
from identify.gaps.page.advice import next_steps, place, rest_hz
from identify.gaps.results import Attribution, Between, Cause, Compared, Figure, Gap, Left, Share
from identify.gaps.wording import WHEN, cause_name, closes, closes_some, interval, joined, others, probability
from identify.pages import page
from identify.pages.wording import number, percent
from rig.model.quantities import printed_unit
from rig.model.unmeasured_force import UnmeasuredForce, Value

MOST = 5
"""Causes that are shown at once; the others are folded away."""
_KINDS = {
    "force": "a force on one body",
    "pair": "a pair of opposite forces between two bodies",
    "sensor": "a fault of a sensor",
    "distributed": "a stiffness that changes over the record",
    "contact": "a clearance that swings",
}


def what_next(gap: Gap) -> str:
    """Concrete steps, in order."""
    return "<ol>" + "".join(f"<li>{escape(step)}</li>" for step in next_steps(gap)) + "</ol>"


def how_large(gap: Gap) -> str:
    """Unexplained shares before and after, beside what matters; the p-values."""
    names = ["the motion", *(f"the force of {name}" for name in gap.before.contact_shares)]
    limits = [gap.matters.motion, *([gap.matters.contact] * len(gap.before.contact_shares))]
    columns = [_shares(gap.before)]
    head = ["unexplained share of", "believed rig"]
    if _helps(gap):
        head.append("with the likeliest cause")
        columns.append(_shares(gap.after))
    rows = list(zip(names, *columns, [percent(limit) for limit in limits], strict=True))
    text = (
        "<p>The share of a signal's rms that the rig does not explain, beyond sensor noise, on the validation record: "
        "a recording that no parameter was fitted to.</p>"
    )
    text += page.table((*head, "what matters"), rows)
    text += f"<p>{escape(_chance('The believed rig', gap.before))}"
    text += f" {escape(_chance('With the likeliest cause, the rig', gap.after))}</p>" if _helps(gap) else "</p>"
    if ranges := rest_hz(gap)[:3]:
        said = joined([f"{low:g} to {high:g} Hz" for low, high in sorted(ranges)])
        rest = "What is left" if _helps(gap) else "It"
        text += f"<p>{rest} is more than what matters, and than null simulations leave, from {said}.</p>"
    if gap.channel_faults:
        text += "<h3>Channels left out</h3>" + page.table(("channel", "fault"), gap.channel_faults.items())
    return text


def causes(gap: Gap) -> str:
    """Probabilities, what each cause closes and leaves, its parameters and places."""
    shown, further = gap.causes[:MOST], gap.causes[MOST:]
    contacts = list(gap.before.contact_shares)
    head = ("cause", "probability", "closes", "leaves of the motion", *(f"leaves of {name}" for name in contacts))
    rest = [(name, probability(p), *[""] * (2 + len(contacts))) for name, p in others(gap)]
    folded = sum(c.probability for c in further)
    if further:
        rest.insert(0, (f"{len(further)} further causes", probability(folded), *[""] * (2 + len(contacts))))
    text = (
        "<p>Sets of effects of the library, beside no effect and something unmeasured. The probabilities of "
        "sets sum to one. A cause closes the share by which its effects alone make the difference smaller on the "
        "validation record, what the tolerances leave open held (95 % interval in brackets).</p>"
    )
    text += page.table(head, [*(_cause_row(c) for c in shown), *rest])
    if look_alikes := wording.alternatives(gap):
        text += "<h3>What this recording hardly tells apart</h3>"
        text += page.listed(" / ".join([words, *others]) for words, others in look_alikes)
    closing = [c for c in shown if closes_some(c)]
    if closing:
        text += "<h3>Parameters and places</h3><p>Value ± 1.96 standard errors: the 95 % interval.</p>"
        text += "".join(_parameters(c) for c in closing)
    idle = [c for c in shown if not closes_some(c)]
    if idle or further:
        table = page.table(head, [_cause_row(c) for c in further]) if further else ""
        every = "".join(_parameters(c) for c in (*idle, *further))
        text += f"<details><summary>Other causes that were judged</summary>{table}{every}</details>"
    return text


def between_records(between: Between) -> str:
    """Each record's own values of what differs, and of the likeliest cause."""
    text = f"<p>{escape(wording.between_records(between))}</p>"
    rows = [*between.differing, *between.cause]
    if rows:
        head = ("parameter", "place", *(f"record {name}" for name in between.records), "", "p-value")
        text += page.table(head, [_compared_row(one) for one in rows])
        text += (
            "<p>Each record's own value ± 1.96 standard errors beside the mean of all records: tolerances of the rig "
            "are shared and not in them. p-value: how often records of an unchanged machine differ as much; of what "
            f"differs, times the {between.looked_at} effects looked at.</p>"
        )
    if between.cause_p_value is not None:
        agree = "agree" if between.cause_p_value >= USUAL else "do not agree"
        text += f"<p>The records {agree} on the likeliest cause (p-value {percent(between.cause_p_value)}).</p>"
    return text


def unknown_force(unknown: UnmeasuredForce) -> str:
    """Section on an unmeasured force: a sentence and a table."""
    said = unknown.sentence[:1].upper() + unknown.sentence[1:]
    rows: list[tuple[str, str]] = [("what", _KINDS[unknown.kind])]
    if unknown.body is not None:
        rows.append(("where", place(unknown)))
    if unknown.position_m is not None and unknown.position_error_m is not None:
        rows.append(("from the left end", interval(Value(unknown.position_m, unknown.position_error_m, "m"))))
        rows.append(("second record alone", "the same place" if unknown.same_place else "another place: doubt it"))
    rows += [(f"stiffness of the {body}, change", _change(growth)) for body, growth in unknown.growth.items()]
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
    if unknown.explained < wording.MOST:
        said = f"It has no simple form. The nearest is {unknown.sentence}"
    text = f"<p>{escape(said)}.</p>" + page.table(("", ""), rows)
    if unknown.law:
        text += (
            '<p class="dim">The formula gives the force against the motion at that place: w is its displacement in m, '
            "v its velocity in m/s.</p>"
        )
    return text


def where(found: Attribution) -> str:
    """The largest share of every way of cutting the record, and all shares."""
    cuts: dict[str, Mapping[str, float]] = {
        "channel": found.channels,
        "linear or contact": found.parts,
        "modal equation": found.modal_equations,
        "station": {
            f"{body}, {at:g} m": s for body, stations in found.positions_m.items() for at, s in stations.items()
        },
        "band": _by_name(found.band_hz, "Hz"),
        "contact state": found.contact_state,
        "time": _by_name(found.time_s, "s"),
    }
    cuts = {name: shares for name, shares in cuts.items() if any(shares.values())}
    tops = {name: max(shares.items(), key=lambda item: item[1]) for name, shares in cuts.items()}
    largest = [(name, part, percent(share)) for name, (part, share) in tops.items()]
    every = [(name, part, percent(share)) for name, shares in cuts.items() for part, share in shares.items()]
    return (
        "<p>Of what the believed rig leaves unexplained: the largest share by every way of cutting the record. Each "
        "way sums to 100 %.</p>"
        + page.table(("by", "largest", "share"), largest)
        + f"<details><summary>All shares</summary>{page.table(('by', 'part', 'share'), every)}</details>"
    )


def response_comparison(gap: Gap) -> str:
    """Figures that people know, of the measured record and of both simulations."""
    text = (
        "<p>The believed rig, and the rig with the likeliest cause, simulated under the measured force; in brackets "
        "how far off the measured value they are. By chance: so far nineteen of twenty records of the believed rig "
        "lie from their mean, built within its tolerances and shaken by another such force. Nothing is decided by "
        "these figures.</p>"
    )
    rows = [
        (
            f"{f.name}, {printed_unit(f.unit)}",
            number(f.measured),
            _off(f.believed, f),
            _off(f.corrected, f),
            f"± {number(f.by_chance, 2)}",
        )
        for f in gap.figures
    ]
    head = ("figure", "measured", "believed", "with the likeliest cause", "by chance")
    return text + (page.table(head, rows) if rows else "")


def notes(gap: Gap) -> str:
    """Side analyses that are lacking, on which the verdict does not rest."""
    return "".join(f"<p>{escape(note)}</p>" for note in wording.not_computed(gap))


def _off(value: float, figure: Figure) -> str:
    if not figure.measured:
        return number(value)
    return f"{number(value)} ({100 * (value / figure.measured - 1):+.1f} %)"


def _helps(gap: Gap) -> bool:
    return bool(gap.causes) and closes_some(gap.causes[0])


def _shares(left: Left) -> list[str]:
    return [percent(share) for share in (left.share, *left.contact_shares.values())]


def _chance(rig: str, left: Left) -> str:
    """Sentence on the p-value."""
    what = "what" if left.p_value >= USUAL else "more than"
    alone = f"alone they leave as much in {percent(left.p_value)} of all cases (p-value)"
    return f"{rig} leaves {what} tolerances and noise explain: {alone}."


def _cause_row(cause: Cause) -> tuple[str, ...]:
    return cause_name(cause), probability(cause.probability), closes(cause), *_shares(cause.left)


def _compared_row(one: Compared) -> tuple[str, ...]:
    mark = one.trend if one.trend != "none" else ""
    return one.parameter, one.place, *(interval(v) for v in one.values), mark, percent(one.p_value)


def _parameters(cause: Cause) -> str:
    rows = [*((what, interval(value)) for what, value in cause.parameters.items()), *cause.places.items()]
    return page.table((cause_name(cause), ""), rows) if rows else ""


def _change(growth: Value) -> str:
    return interval(Value(100 * growth.value, 100 * growth.standard_error, "%"))


def _by_name(shares: Sequence[Share], unit: str) -> dict[str, float]:
    return {f"{s.begin:.3g} to {s.end:.3g} {unit}": s.share for s in shares}
