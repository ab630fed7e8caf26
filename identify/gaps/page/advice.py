"""Advice: the next steps after a diagnosis, in concrete sentences, by its verdict."""

import math
from collections.abc import Sequence

from identify.gaps.decision_table import USUAL_P_VALUE, Verdict
from identify.gaps.results import Band, Gap
from identify.gaps.wording import (
    MIN_DESCRIPTION_SHARE,
    MIN_HINT_SHARE,
    capitalised,
    is_effective,
    named_effects_with_look_alikes,
    spoken_effect,
    stays_unexplained_words,
    unexplained_words,
)
from identify.pages.wording import joined, number, percent, record_length_words
from rig.model.unmeasured_force import UnmeasuredForce

MAX_RANGES = 3
"""Frequency ranges that are named at most."""
BROADBAND_SHARE = 0.8
"""Share of the band from which an unexplained range counts as all frequencies."""
BRIDGED_HZ = 10.0
"""Distance below which two frequency ranges count as one."""
LOG_MILLION = 13.8
"""Natural logarithm of the odds above which no number is written."""

_STEP_BY_ARGUMENT = {
    "displacement": "The force follows the displacement: pull and push there with known forces, small "
    "ones first, and measure the deflection.",
    "clearance": "The force acts beyond a clearance: push there until something touches, and measure the deflection.",
    "velocity": "The force grows with the velocity: record a free decay, or record at two levels of force.",
    "velocity squared": "The force grows with the square of the velocity: record at two levels of force.",
    "acceleration": "The force grows with the acceleration: fix a known mass there and record again.",
}


def next_steps(gap: Gap) -> list[str]:
    """Next steps after a diagnosis, most useful first."""
    steps_by_verdict = {
        Verdict.CONSISTENT: _consistent_steps,
        Verdict.CANNOT_TELL: _cannot_tell_steps,
        Verdict.SMALL: _small_steps,
        Verdict.EXPLAINED: _explained_steps,
        Verdict.PARTLY_EXPLAINED: _partly_explained_steps,
        Verdict.UNEXPLAINED: _unexplained_verdict_steps,
    }
    return [*_record_difference_steps(gap), *steps_by_verdict[gap.verdict](gap)]


def _record_difference_steps(gap: Gap) -> list[str]:
    if gap.between is None or not gap.between.differing:
        return []
    if gap.between.level_dependence:
        return [
            "The records differ as their levels do: look for a joint that slides or opens. Repeat the lowest level at "
            "the end: a joint then gives the first values again, wear does not. What follows holds for the validation "
            "record."
        ]
    effects = joined(list(dict.fromkeys(comparison.parameter.split(".")[0] for comparison in gap.between.differing)))
    return [
        f"The machine was not the same in all records ({effects}): find out what changed, and diagnose the records of "
        "one state by themselves; what follows holds for the validation record."
    ]


def unexplained_ranges_hz(gap: Gap) -> list[tuple[float, float]]:
    """Frequency ranges, widest first, whose bands all leave more than null simulations do and together a share of the
    whole motion that matters; none where the whole rest does not matter or is at noise level."""
    is_motion_left = gap.after.share > gap.matters.motion and gap.evidence.p_value_after < USUAL_P_VALUE
    bands_by_range: list[list[Band]] = []
    for band in gap.bands if is_motion_left else ():
        if band.after <= band.usual:
            continue
        if bands_by_range and band.low_hz - bands_by_range[-1][-1].high_hz < BRIDGED_HZ:
            bands_by_range[-1].append(band)
        else:
            bands_by_range.append([band])
    ranges_hz = [
        (bands[0].low_hz, bands[-1].high_hz)
        for bands in bands_by_range
        if math.hypot(*(band.after * band.motion_share for band in bands)) > gap.matters.motion
    ]
    return sorted(ranges_hz, key=lambda range_hz: range_hz[0] - range_hz[1])


def range_words(ranges_hz: Sequence[tuple[float, float]]) -> str:
    """Frequency ranges in words, the lowest first: "2 to 10 Hz and 40 to 50 Hz"."""
    return joined([f"{low_hz:g} to {high_hz:g} Hz" for low_hz, high_hz in sorted(ranges_hz)])


SENSITIVITY_ADVICE = (
    "To find smaller differences, state tighter tolerances where you have measured them (--tolerances), record for "
    "longer, or excite more strongly."
)


UNKNOWN_ADVICE = (
    "Check gains, places and mounting of the sensors, then record at another level of force: what changes with the "
    "level lies in contacts and joints."
)


def _unchanged_rig_steps(gap: Gap) -> list[str]:
    is_changed = gap.between and gap.between.differing
    return [] if is_changed else ["Nothing needs to be done: simulate with rig.json as it is."]


def _consistent_steps(gap: Gap) -> list[str]:
    return [*_unchanged_rig_steps(gap), SENSITIVITY_ADVICE, *_experiment_steps(gap)]


def _cannot_tell_steps(gap: Gap) -> list[str]:
    """Steps that would show the quantities that were not seen."""
    remedies = dict.fromkeys(capitalised(quantity.remedy) for quantity in gap.not_seen if quantity.remedy)
    steps = [f"{remedy}, and diagnose again." for remedy in remedies]
    return [
        "Do not rely on rig.json yet.",
        *(
            steps
            or [f"Record {record_length_words(_needed_length_ratio(gap))} or excite more strongly, and diagnose again."]
        ),
        *_experiment_steps(gap),
    ]


def _needed_length_ratio(gap: Gap) -> float | None:
    """Length over that of these records at which every bound would hold if nothing else changed; None if unknown.

    The bound u of a share v holds below its threshold t, and u^2 - v^2, some standard errors of a mean over the
    seconds, falls as 1 / sqrt(length): the ratio is ((u^2 - v^2) / (t^2 - v^2))^2. Bounds of other quantities rest on
    tolerances, too.
    """
    ratios = [0.0]
    for bound in (quantity for quantity in gap.evidence.quantities if not quantity.holds):
        value, upper, limit = bound.value, bound.upper, bound.threshold
        if bound.unit != "1" or value is None or upper is None or value >= limit:
            return None
        ratios.append(((upper**2 - value**2) / (limit**2 - value**2)) ** 2)
    return max(ratios)


def _small_steps(gap: Gap) -> list[str]:
    if gap.causes and gap.causes[0].named:
        return [
            "Simulate with rig.json as it is; the corrected rig.json (--out writes it) is closer to the machine.",
            *_discriminating_steps(gap),
        ]
    return [*_unchanged_rig_steps(gap), "To see its cause, lower --matters and --matters-contact and diagnose again."]


def _explained_steps(gap: Gap) -> list[str]:
    effects = "effect" if len(gap.causes[0].named) == 1 else "effects"
    remainder = "Nothing else needs an explanation: the remaining error is at noise level."
    if gap.evidence.p_value_after < USUAL_P_VALUE:
        remainder = (
            f"What is left is {unexplained_words(gap.after)}: more than tolerances and noise leave, but too little to "
            "matter."
        )
    return [
        f"Simulate with the corrected rig.json (--out writes it): it holds the {effects} named above.",
        remainder,
        *_discriminating_steps(gap),
    ]


def _partly_explained_steps(gap: Gap) -> list[str]:
    return [
        "Take the corrected rig.json (--out writes it) as the better rig, not as the right one: "
        f"{stays_unexplained_words(gap)}.",
        *_unexplained_range_steps(gap),
        *(_inspection_steps(gap.unknown) if gap.unknown else []),
        *_discriminating_steps(gap),
    ]


def _unexplained_verdict_steps(gap: Gap) -> list[str]:
    steps = ["Do not rely on rig.json: no effect of the library would make it right."]
    steps += (
        (_inspection_steps(gap.unknown) if gap.unknown else []) or _unexplained_range_steps(gap) or [UNKNOWN_ADVICE]
    )
    is_described = gap.unknown is not None and gap.unknown.explained >= MIN_DESCRIPTION_SHARE
    if gap.causes and is_effective(gap.causes[0]) and not is_described:
        return steps + _discriminating_steps(gap)
    return steps + _experiment_steps(gap)


def _unexplained_range_steps(gap: Gap) -> list[str]:
    ranges_hz = unexplained_ranges_hz(gap)[:MAX_RANGES]
    if not ranges_hz:
        name, share = max(gap.after.contact_shares.items(), key=lambda contact: contact[1], default=("", 0.0))
        if share <= gap.matters.contact:
            return []
        return [
            f"Look at {name}: the rest lies in its force, of which {percent(share)} is unexplained. Sideways motion "
            "that leaks into the sensors may do the same at stiff stops: if there is any, state its share (tolerance "
            "lateral_motion)."
        ]
    width_hz = gap.bands[-1].high_hz - gap.bands[0].low_hz
    if sum(high_hz - low_hz for low_hz, high_hz in ranges_hz) > BROADBAND_SHARE * width_hz:
        return [
            "What is left is spread over all frequencies: check what acts on all of them, such as gains, stations, "
            "cables and cross-axis sensitivity."
        ]
    words = range_words(ranges_hz)
    return [f"Look for something that acts from {words}: there the rest exceeds what noise leaves, and it matters."]


def _inspection_steps(unknown: UnmeasuredForce) -> list[str]:
    """Steps that inspect the place of an unmeasured force."""
    if unknown.explained < MIN_HINT_SHARE:
        return []
    if unknown.explained < MIN_DESCRIPTION_SHARE:
        share = percent(unknown.explained)
        hint_words = f"Take this as a hint, as it explains only {share} of the mean square of what is left: "
        return [f"{hint_words}look at {_suspect_words(unknown)}."]
    if unknown.kind == "sensor":
        return [f"Look at sensor {unknown.sensor}, its mounting and its cable; exchange it and record again."]
    if unknown.kind == "contact":
        frequency = number(unknown.frequency_hz or 0.0)
        return [
            f"Look at the stops of {unknown.contact}: what turns or shakes at {frequency} Hz?",
            "Measure the clearance while the machine stands still, in several positions of what turns.",
        ]
    if unknown.kind == "distributed":
        body_words = joined([f"the {body}" for body in unknown.growth])
        return [f"Measure the temperature of {body_words} along the record, and record again after it has settled."]
    steps = [f"Look at {place(unknown)}: what touches it, hangs on it or drives it there is not in rig.json."]
    if not unknown.same_place:
        steps.append("Doubt this place: the second record alone shows another. Record again at another level of force.")
    if unknown.frequency_hz is not None:
        steps.append(
            f"Record without the exciting force and switch motors and mains supplies off one by one: find what runs at "
            f"{number(unknown.frequency_hz)} Hz."
        )
    elif unknown.against in _STEP_BY_ARGUMENT:
        steps.append(_STEP_BY_ARGUMENT[unknown.against])
    elif unknown.when == "in contact":
        steps.append("Look at the surfaces that touch: it acts only while contacts are closed.")
    elif unknown.when == "growing with time":
        steps.append("Record for longer and note the temperature: it grows with time.")
    else:
        steps.append("Record without the exciting force: what remains comes from outside.")
    steps.append("Put a further sensor there, or measure this force, and diagnose again.")
    return steps


def _suspect_words(unknown: UnmeasuredForce) -> str:
    if unknown.kind == "sensor":
        return f"sensor {unknown.sensor}"
    if unknown.kind == "distributed":
        return f"the stiffness of {joined([f'the {body}' for body in unknown.growth])}"
    return place(unknown)


def place(unknown: UnmeasuredForce) -> str:
    """Place of an unmeasured force in words, "the barrel near 0.89 m"; a mass has no length."""
    position_words = f"the {unknown.body}"
    if unknown.position_error_m is not None:
        position_words += f" near {unknown.position_m or 0.0:.2f} m"
    if unknown.against_body:
        position_words += f" and the {unknown.against_body}"
        if unknown.position_error_m is not None or unknown.against_position_m:
            position_words += f" near {unknown.against_position_m or 0.0:.2f} m"
    return position_words


def _discriminating_steps(gap: Gap) -> list[str]:
    test_parts = (test.partition(": ") for test in gap.separate_by)
    return [
        *(
            f"Before anything is changed, find out whether it is {joined([effect, *look_alikes], 'or')}."
            for effect, look_alikes in named_effects_with_look_alikes(gap)
        ),
        *_experiment_steps(gap),
        *(f"To test for {spoken_effect(name)}: {test}." for name, _, test in test_parts),
    ]


def _experiment_steps(gap: Gap) -> list[str]:
    """Proposed recordings: the best, and the two next best."""
    if not gap.next_experiments:
        return []
    best, *alternatives = gap.next_experiments
    step = (
        f"To tell {joined(gap.next_between, 'from')}, {best.words}: that is expected to raise the odds of the true one "
        f"by a factor of {_odds_factor_words(best.log_odds)}."
    )
    for experiment in alternatives[:2]:
        step += f" {capitalised(experiment.words)}: {_odds_factor_words(experiment.log_odds)}."
    return [step]


def _odds_factor_words(log_odds: float) -> str:
    """Factor of the odds in words, "a million or more" at most."""
    return "a million or more" if log_odds > LOG_MILLION else number(math.exp(max(log_odds, 0.0)), 2)
