"""How the numbers of a diagnosis are written, on the page, in the pictures and on the screen."""

from identify import wording
from identify.gap.results import Cause, Gap, Value

VERDICTS = {
    "no_gap": "no gap that matters",
    "explained": "explained",
    "partly_explained": "explained in part",
    "unknown": "unknown cause",
}


def interval(found: Value) -> str:
    """value ± 1.96 standard errors, to two digits of the latter; with a word where the range ends there."""
    said = wording.interval(found.value, found.standard_error, found.unit)
    return f"{said} (at the limit of its range)" if found.at_limit else said


def cause_name(cause: Cause) -> str:
    """Its effects with the places that they act at: "added_mass (barrel) + preload"."""
    named = []
    for effect in cause.effects:
        places = [place for field, place in cause.places.items() if field.split(".")[0] == effect]
        named.append(f"{effect} ({', '.join(places)})" if places else effect)
    return " + ".join(named)


def others(gap: Gap) -> list[tuple[str, float]]:
    """What the causes leave of probability one: no gap, and something unknown."""
    return [("no gap", gap.probability_nothing), ("something unknown", gap.probability_unknown)]
