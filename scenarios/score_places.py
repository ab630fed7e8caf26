"""Whether what was found acts where the truth does, and is described as it is."""

from identify.gaps.results import Cause
from rig.model.unmeasured_force import UnmeasuredForce
from scenarios.worlds.truth import EffectTruth, Expected

FIELDS = ("contact", "body", "beam", "sensor", "side")
WITHIN_M = 0.05
WITHIN_HZ = 0.2
OVERLAP = 0.5
"""A band is right if what it shares with the true one is this much of what both cover."""
SQUARE = (1.5, 2.5)
"""A power of the velocity in between is a drag by its square."""


def place_fields(effect: EffectTruth) -> tuple[str, ...]:
    """The fields that say where the effect acts; a clamp and all bodies at once have no choice."""
    if effect.name == "clamp_compliance":
        return ()
    chosen = [field for field in FIELDS if effect.place.get(field, "all") != "all"]
    return (*chosen, *(field for field in ("relative_position", "low_hz") if field in effect.parameters))


def place_right(effect: EffectTruth, cause: Cause) -> bool:
    """Whether a cause has the effect where the truth has it, in every field that says so: within 0.05 m of a body."""

    def found(field: str) -> float:
        value = cause.parameters.get(f"{effect.name}.{field}")
        return value.value if value else float("nan")

    def field_right(field: str) -> bool:
        if field == "low_hz":
            low, high = (effect.parameters[f] for f in ("low_hz", "high_hz"))
            shared = min(high, found("high_hz")) - max(low, found("low_hz"))
            return shared / (max(high, found("high_hz")) - min(low, found("low_hz"))) >= OVERLAP
        if field == "relative_position":
            share = effect.parameters[field]
            length_m = float(effect.place["position_m"]) / share
            return abs(found(field) - share) * length_m <= WITHIN_M
        return cause.places.get(f"{effect.name}.{field}") == effect.place[field]

    return all(field_right(field) for field in place_fields(effect))


def description_right(expected: Expected | None, unknown: UnmeasuredForce | None) -> bool:
    """Whether what is unknown is described as the effect outside the library is: where, and by what law or frequency.

    Of a sensor that is right no frequency is asked for: its resonance may lie beyond the band.
    """
    if unknown is None or expected is None or not _where_right(expected, unknown):
        return False
    if expected.frequency_hz is not None and unknown.frequency_hz is not None:
        return abs(expected.frequency_hz - unknown.frequency_hz) <= WITHIN_HZ
    return expected.contact is None and law_right(expected.law, unknown)


def law_right(law: str, unknown: UnmeasuredForce) -> bool:
    """Where no short formula holds (a rattling mass), none must be given."""
    numbers = unknown.law_parameters
    if law == "drag":
        by_power = unknown.law_name == "power of the velocity" and SQUARE[0] <= numbers["p"].value <= SQUARE[1]
        return unknown.against == "velocity squared" or by_power
    if law == "softening":
        softer = unknown.law_name == "cubic spring" and numbers["cubic"].value < 0
        return unknown.law_name == "softening spring" or softer
    if law == "stop":
        return unknown.against == "clearance"
    return not unknown.law


def _where_right(expected: Expected, unknown: UnmeasuredForce) -> bool:
    if expected.where == "contact pair":
        return unknown.contact == expected.contact
    if unknown.kind != expected.where:
        return False
    if expected.sensor is not None:
        return unknown.sensor == expected.sensor
    if expected.body is None or expected.position_m is None:
        return True
    if unknown.body != expected.body or unknown.position_m is None:
        return False
    return abs(unknown.position_m - expected.position_m) <= WITHIN_M
