"""Whether what is unmeasured is described as the effect outside the library is."""

from rig.model.unmeasured_force import UnmeasuredForce
from tests.campaigns.score_sets import WITHIN_M
from tests.campaigns.worlds.truth import Expected

WITHIN_HZ = 0.2
SQUARE = (1.5, 2.5)
"""A power of the velocity in between is a drag by its square."""


def description_right(expected: Expected | None, unknown: UnmeasuredForce | None) -> bool:
    """Whether what is unknown is described as the effect outside the library is: where, and by what law or frequency.

    Of a sensor that is right no frequency is asked for: its resonance may lie beyond the band. Of a contact whose
    clearance does not swing it has to be the contact, and none that swings.
    """
    if unknown is None or expected is None or not _where_right(expected, unknown):
        return False
    if expected.frequency_hz is not None and unknown.frequency_hz is not None:
        return abs(expected.frequency_hz - unknown.frequency_hz) <= WITHIN_HZ
    if expected.contact is not None:
        return expected.frequency_hz is None and unknown.frequency_hz is None
    return law_right(expected.law, unknown)


def law_right(law: str, unknown: UnmeasuredForce) -> bool:
    """Where no short formula holds (a rattling mass), none must be given; of what stands elsewhere any may be."""
    numbers = unknown.law_parameters
    if law == "drag":
        by_power = unknown.law_name == "power of the velocity" and SQUARE[0] <= numbers["p"].value <= SQUARE[1]
        return unknown.against == "velocity squared" or by_power
    if law == "softening":
        softer = unknown.law_name == "cubic spring" and numbers["cubic"].value < 0
        return unknown.law_name == "softening spring" or softer
    if law == "stop":
        return unknown.against == "clearance"
    return law == "moved" or not unknown.law


def _where_right(expected: Expected, unknown: UnmeasuredForce) -> bool:
    if expected.where == "contact pair":
        return unknown.contact == expected.contact
    if unknown.kind != expected.where:
        return False
    if expected.sensor is not None:
        return unknown.sensor == expected.sensor
    if expected.where == "distributed":
        return True
    if unknown.body != expected.body or expected.position_m is None:
        return unknown.body == expected.body
    return unknown.position_m is not None and abs(unknown.position_m - expected.position_m) <= WITHIN_M
