"""Next steps, in concrete sentences by verdict."""

import math

from identify.gaps.decision_table import USUAL, Verdict
from identify.gaps.results import Gap
from identify.gaps.wording import LEAST, MOST, alternatives, capital, closes_some, joined, leaves
from identify.pages.wording import number, percent
from rig.model.unmeasured_force import UnmeasuredForce

WIDEST = 3
"""Ranges of frequency that are named."""

EVERYWHERE = 0.8
"""Of the band: what is left there is left everywhere."""
BRIDGED_HZ = 10.0
"""Ranges closer than this are one."""
MILLION = 13.8
"""Its logarithm."""

_BY_DEPENDENCE = {
    "displacement": "The force grows with the displacement: push there with known weights and measure the way.",
    "clearance": "The force acts beyond a clearance: push there until something touches, and measure the way.",
    "velocity": "The force grows with the velocity: record a free decay, or record at two levels of force.",
    "velocity squared": "The force grows with the square of the velocity: record at two levels of force.",
    "acceleration": "The force grows with the acceleration: fix a known mass there and record again.",
}


def next_steps(gap: Gap) -> list[str]:
    """Next steps of a reader of the diagnosis, most useful first."""
    by_verdict = {
        Verdict.CONSISTENT: _consistent,
        Verdict.CANNOT_TELL: _cannot_tell,
        Verdict.SMALL: _small,
        Verdict.EXPLAINED: _explained,
        Verdict.PARTLY_EXPLAINED: _partly,
        Verdict.UNEXPLAINED: _unexplained,
    }
    return [*_between(gap), *by_verdict[gap.verdict](gap)]


def _between(gap: Gap) -> list[str]:
    if gap.between is None or not gap.between.differing:
        return []
    if gap.between.level_dependence:
        return [
            "The records differ as their levels do: look for a joint that slides or opens. Repeat the lowest level at "
            "the end: a joint then gives the first values again, wear does not. What follows holds for the validation "
            "record."
        ]
    names = joined(list(dict.fromkeys(one.parameter.split(".")[0] for one in gap.between.differing)))
    return [
        f"The machine was not the same in all records ({names}): find out what changed, and diagnose the records of "
        "one state by themselves; what follows holds for the validation record."
    ]


def rest_hz(gap: Gap) -> list[tuple[float, float]]:
    """Ranges of frequency, widest first, in which what is left exceeds what matters and what null simulations leave."""
    ranges: list[tuple[float, float]] = []
    for band in gap.bands:
        if band.after <= max(band.usual, gap.matters.motion):
            continue
        near = ranges and band.low_hz - ranges[-1][1] < BRIDGED_HZ
        ranges.append((ranges.pop()[0] if near else band.low_hz, band.high_hz))
    return sorted(ranges, key=lambda r: r[0] - r[1])


SMALLER = (
    "To find smaller differences, state tighter tolerances where you have measured them (--tolerances), record for "
    "longer, or excite more strongly."
)


def _as_it_is(gap: Gap) -> list[str]:
    same = not (gap.between and gap.between.differing)
    return ["Nothing needs to be done: simulate with rig.json as it is."] if same else []


def _consistent(gap: Gap) -> list[str]:
    return [*_as_it_is(gap), SMALLER, *_proposed(gap)]


def _cannot_tell(gap: Gap) -> list[str]:
    """Steps that would show what was not seen."""
    remedies = dict.fromkeys(capital(one.remedy) for one in gap.not_seen if one.remedy)
    steps = [f"{remedy}, and diagnose again." for remedy in remedies]
    return [
        "Do not rely on rig.json yet.",
        *(steps or ["Record for longer or excite more strongly, and diagnose again."]),
        *_proposed(gap),
    ]


def _small(gap: Gap) -> list[str]:
    if gap.causes and gap.causes[0].named:
        step = "Simulate with rig.json as it is; the corrected rig.json (--out writes it) is closer to the machine."
        return [step, *_tell_apart(gap)]
    return [*_as_it_is(gap), "To see its cause, lower --matters and --matters-contact and diagnose again."]


def _explained(gap: Gap) -> list[str]:
    best = gap.causes[0]
    steps = [f"Simulate with the corrected rig.json (--out writes it): it holds {joined(best.named)}."]
    if gap.after.p_value < USUAL:
        steps.append(
            f"What is left is {leaves(gap.after)}: more than tolerances and noise leave, too little to matter."
        )
    else:
        steps.append("Look for no further cause: what is left is what tolerances and noise leave.")
    return steps + _tell_apart(gap)


def _partly(gap: Gap) -> list[str]:
    best = gap.causes[0]
    steps = [
        "Take the corrected rig.json (--out writes it) as the better rig, not as the right one: with "
        f"{joined(best.named)} it still leaves {leaves(gap.after)} unexplained."
    ]
    return steps + _rest(gap) + (_where_to_look(gap.unknown) if gap.unknown else []) + _tell_apart(gap)


def _unexplained(gap: Gap) -> list[str]:
    steps = ["Keep rig.json as it is for now: no effect of the library would make it right."]
    steps += (_where_to_look(gap.unknown) if gap.unknown else []) or _rest(gap)
    if gap.causes and closes_some(gap.causes[0]):
        return steps + _tell_apart(gap)
    return steps + _proposed(gap)


def _rest(gap: Gap) -> list[str]:
    ranges = rest_hz(gap)[:WIDEST]
    if not ranges:
        share = max(gap.after.contact_shares.items(), key=lambda item: item[1], default=("", 0.0))
        if share[1] <= gap.matters.contact:
            return []
        return [f"Look at {share[0]}: the rest lies in its force, of which {percent(share[1])} is unexplained."]
    if sum(high - low for low, high in ranges) > EVERYWHERE * (gap.bands[-1].high_hz - gap.bands[0].low_hz):
        return [
            "What is left is spread over all frequencies: check what acts on all of them, such as gains, stations, "
            "cables and cross-axis sensitivity."
        ]
    said = joined([f"{low:g} to {high:g} Hz" for low, high in sorted(ranges)])
    return [f"Look for something that acts from {said}: there more is left than what matters and what noise leaves."]


def _where_to_look(unknown: UnmeasuredForce) -> list[str]:
    """Place, and what to measure there."""
    if unknown.explained < LEAST:
        return []
    if unknown.explained < MOST:
        hint = f"Take this as a hint, as it explains only {percent(unknown.explained)} of what is left: "
        return [f"{hint}look at {_what(unknown)}."]
    if unknown.kind == "sensor":
        return [f"Look at sensor {unknown.sensor}, its mounting and its cable; exchange it and record again."]
    if unknown.kind == "contact":
        return [
            f"Look at the stops of {unknown.contact}: what turns or shakes at {unknown.frequency_hz or 0.0:.1f} Hz?",
            "Measure the clearance while the machine stands still, in several positions of what turns.",
        ]
    if unknown.kind == "distributed":
        bodies = joined([f"the {body}" for body in unknown.growth])
        return [f"Measure the temperature of {bodies} along the record, and record again after it has settled."]
    steps = [f"Look at {place(unknown)}: what touches it, hangs on it or drives it there is not in rig.json."]
    if not unknown.same_place:
        steps.append("Doubt this place: the second record alone shows another. Record again at another level of force.")
    if unknown.frequency_hz is not None:
        steps.append(
            f"Record without the exciting force and switch motors and mains supplies off one by one: find what runs at "
            f"{unknown.frequency_hz:.1f} Hz."
        )
    elif unknown.against in _BY_DEPENDENCE:
        steps.append(_BY_DEPENDENCE[unknown.against])
    elif unknown.when == "in contact":
        steps.append("Look at the surfaces that touch: it acts only while contacts are closed.")
    elif unknown.when == "growing with time":
        steps.append("Record for longer and note the temperature: it grows with time.")
    else:
        steps.append("Record without the exciting force: what remains comes from outside.")
    steps.append("Put a further sensor there, or measure this force, and diagnose again.")
    return steps


def _what(unknown: UnmeasuredForce) -> str:
    if unknown.kind == "sensor":
        return f"sensor {unknown.sensor}"
    if unknown.kind == "distributed":
        return f"the stiffness of {joined([f'the {body}' for body in unknown.growth])}"
    return place(unknown)


def place(unknown: UnmeasuredForce) -> str:
    """Place in words, such as "the barrel near 0.89 m"."""
    at = f"the {unknown.body} near {unknown.position_m or 0.0:.2f} m"
    if unknown.against_body:
        return f"{at} and the {unknown.against_body} near {unknown.against_position_m or 0.0:.2f} m"
    return at


def _tell_apart(gap: Gap) -> list[str]:
    steps = [f"This record hardly tells {joined([words, *others], 'from')}." for words, others in alternatives(gap)]
    return steps + _proposed(gap) + [f"To test {experiment}." for experiment in gap.separate_by]


def _proposed(gap: Gap) -> list[str]:
    """The experiment that was computed, and the next best."""
    if not gap.next_experiments:
        return []
    best, *others = gap.next_experiments
    return [
        f"To tell {joined(gap.next_between, 'from')}, {best.words}: that is expected to raise the odds of the true one "
        f"by a factor of {_odds(best.log_odds)}."
        + "".join(f" {one.words[:1].upper()}{one.words[1:]}: {_odds(one.log_odds)}." for one in others[:2])
    ]


def _odds(logarithm: float) -> str:
    """The factor; what is beyond a million is no more than that."""
    return "a million or more" if logarithm > MILLION else number(math.exp(max(logarithm, 0.0)), 2)
