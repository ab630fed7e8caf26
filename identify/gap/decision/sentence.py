"""The verdict in a sentence, with the criterion that decided."""

from msgspec.structs import replace

from identify.gap.results import Gap
from identify.gap.wording import cause_name
from identify.wording import percent


def sentence(gap: Gap, criterion: str) -> Gap:
    """The diagnosis with its sentence."""
    said = _verdict(gap)
    limits = [name for cause in gap.causes[:1] for name, value in cause.parameters.items() if value.at_limit]
    if limits and gap.verdict in ("explained", "partly_explained"):
        said += f" {' and '.join(limits)} stands at the limit of its range: give a wider one, or doubt the effect."
    said += f" Decided by: {criterion}."
    said += "".join(f" Channel {name} is {what} and was left out." for name, what in gap.channel_faults.items())
    return replace(gap, sentence=said)


def _verdict(gap: Gap) -> str:
    left = _left(gap)
    if gap.verdict == "no_gap":
        return f"No gap that matters: the believed rig leaves {percent(gap.before.share)} of the acceleration."
    if gap.verdict == "unknown":
        found = f": {gap.unknown.sentence}" if gap.unknown else ""
        tried = ""
        if gap.causes:
            closest = gap.causes[0]
            tried = f" The likeliest effect, {cause_name(closest)}, closes {percent(max(closest.explained, 0.0))} of it."
        return f"There is a gap that no effect of the library explains{found}.{tried}"
    best = gap.causes[0]
    low, high = best.interval_95
    closes = f"closes {percent(best.explained)} ({percent(low)} to {percent(high)}) of the gap"
    if gap.verdict == "explained":
        return f"{cause_name(best)} explains the gap: it {closes}, and leaves {left}."
    rest = f"; the rest may be {gap.unknown.sentence}" if gap.unknown else ""
    return f"{cause_name(best)} explains the gap in part: it {closes}, and leaves {left}{rest}."


def _left(gap: Gap) -> str:
    contacts = "".join(
        f", {percent(share)} of the force of {name}" for name, share in gap.after.contact_shares.items() if share > 0
    )
    return f"{percent(gap.after.share)} of the acceleration{contacts}"
