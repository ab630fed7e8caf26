"""How the numbers of a diagnosis are written, on the page, in the pictures and on the screen."""

from identify import wording
from identify.gap.results import Cause, Closure, Gap, Value

VERDICTS = {"no_gap": "no gap", "effect": "effect found", "none_of_these": "gap, but none of the known effects"}


def interval(found: Value) -> str:
    """value ± 1.96 standard errors, to two digits of the latter."""
    return wording.interval(found.value, found.standard_error, found.unit)


def cause_name(cause: Cause) -> str:
    """Its effects with the places that they act at: "added_mass (barrel) + preload"."""
    named = []
    for effect in cause.effects:
        places = [place for field, place in cause.places.items() if field.split(".")[0] == effect]
        named.append(f"{effect} ({', '.join(places)})" if places else effect)
    return " + ".join(named)


def none_of_these(gap: Gap) -> tuple[str, float]:
    """What the causes leave of probability one, and its name."""
    name = "none of them" if gap.verdict == "no_gap" else "none of these"
    return name, max(0.0, 1.0 - sum(c.probability for c in gap.causes))


def closed(found: Closure) -> str:
    """The closed fraction with its 95 % interval; where nothing was to be closed, it would mean nothing."""
    if found.closed_fraction is None:
        return "no share (nothing was added, or the gap was at the floor)"
    whole = f"{100 * found.closed_fraction:.1f} %"
    if found.interval_95 is None:
        return whole
    low, high = found.interval_95
    return f"{whole} (95 % interval {100 * low:.1f} % to {100 * high:.1f} %)"
