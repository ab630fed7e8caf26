"""Assumptions of an identification, and recommendations that would narrow its intervals, as sentences."""

from collections.abc import Iterator

import numpy as np

from identify.contacts.contact_record import STIFFNESS
from identify.contacts.identification import Identification
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.separation import is_unforced
from identify.pages.wording import percent
from rig.model.description import Station
from rig.model.tolerances import EXACT

QUIET_S = 0.3
"""A record whose force begins earlier does not tell its noise."""
HEAVY = 0.5
"""A source of error is named that makes at least this share of an estimate's variance."""
_REMEDY = {
    "tolerances": "what rig.json may have wrong (gains, positions, frequencies, damping): calibrate the sensors, "
    "measure their positions and fit the modes; a longer record would not help",
    "drift": "the slow motion that accelerometers miss: add displacement sensors at the contact, or take quieter "
    "accelerometers",
    "law": "what the contact's law leaves: forces that press in and let go, or deep and shallow ones, ask for other "
    "numbers; look at the force over the relative displacement, and take identify law",
    "scatter": "the record's own scatter: record longer (four times as long halves it) or excite more strongly",
}


def assumed(found: Identification) -> Iterator[str]:
    """The law's form, the sensors and bands used, and what of rig.json was believed how exactly."""
    report, motion, rig, believed = found.report, found.motion, found.rig, found.tolerances
    yield (
        "The contact law: no force within the gap; beyond it stiffness times penetration plus damping times relative "
        "velocity. Beside it, of a contact that is alone between its places, a power of the penetration and a stop "
        "that cannot pull were tried: the record has to ask for them. Both stops of a contact are equally stiff, and "
        "nothing wears during the record."
    )
    yield (
        "The bodies are those of rig.json, linear: "
        + "; ".join(
            f"{b.name}, {_frequencies(b.frequencies_hz(min(4 + b.rigid_modes, b.max_modes)))}" for b in rig.bodies
        )
        + "."
    )
    if believed != EXACT:
        yield (
            "Tolerances of rig.json, as standard deviations, fitted along: sensor gains "
            f"{100 * believed.gain:.2g} %, their positions {1e3 * believed.position_m:.2g} mm, delays "
            f"{1e3 * believed.delay_s:.2g} ms and high-pass {believed.high_pass_hz:.2g} Hz, each force's gain "
            f"{100 * believed.force_gain:.2g} %, masses {100 * believed.mass:.2g} %, natural frequencies "
            f"{100 * believed.frequency:.2g} %, damping {100 * believed.damping:.2g} %."
        )
    else:
        yield "rig.json is believed exactly: no tolerances."
    places = "; ".join(_places(body.name, motion.stations) for body in rig.bodies)
    yield f"Stations used: {places}. Channels: {', '.join(report.channels_used)}."
    if idle := [s.name for s in rig.sensors if s.name not in report.channels_used]:
        yield f"Channels not used: {', '.join(idle)}."
    low, high = report.trusted_hz
    yield (
        f"Frequencies: the motion is trusted from {low:g} to {high:.4g} Hz, the contact forces are separated up to "
        f"{motion.sample_rate_hz / 2 / found.factor:.4g} Hz"
        + (", and the slow motion below is solved for within the noise of the accelerometers." if low else ".")
    )
    for place in found.same_place:
        if len(place.members) > 1:
            yield (
                f"{place.contact.name} act between the same places: the record tells the sum of their forces; each "
                "has the knee that comes nearest to its clearance and stiffness in rig.json."
            )
    if is_unforced(motion):
        yield (
            "No force was recorded: none acts during the record but those of the contacts, whose size rests on the "
            "masses of rig.json."
        )
    yield f"The accelerations' noise is taken from {report.noise_from}."
    if found.outcomes.refusals or not _sides_known(found):
        yield "The zero of the relative displacement is not known: the two stops stand equally far from it."


def recommendations(found: Identification) -> Iterator[str]:
    """Per source of error the estimates that it rules, and what would lessen it; then what else would help."""
    for name, refusal in found.outcomes.refusals.items():
        yield f"{name}: {refusal.advice}."
    ruled: dict[str, list[str]] = {}
    for name, estimate in found.outcomes.estimates.items():
        for quantity, shares in variance_shares(estimate).items():
            for source, share in shares.items():
                if share >= HEAVY:
                    ruled.setdefault(source, []).append(f"{name}'s {quantity} ({percent(share)})")
    for source, estimates in ruled.items():
        yield f"Most of the variance of {_joined(estimates)} comes from {_REMEDY[source]}."
    if not _sides_known(found):
        yield (
            "Only half the total play can be told: displacement sensors that show a standing displacement too, at both "
            "sides of a contact, would tell its two sides apart."
        )
    if not is_unforced(found.motion) and found.motion.excited_from < QUIET_S * found.motion.sample_rate_hz:
        yield (
            f"The sensors' noise is taken from {found.report.noise_from}: let the record begin with a second or more "
            "without force to measure it."
        )
    yield "These intervals believe in the linear bodies of rig.json: identify gap asks whether they are right."


def variance_shares(answer: JointEstimate) -> dict[str, dict[str, float]]:
    """Shares of the variance of clearance and stiffness by source; each sums to one."""
    parts = {"tolerances": answer.of_tolerances, "drift": answer.of_drift, "law": answer.of_misfit}
    found = {}
    for quantity, along in (("clearance", answer.clearance), ("stiffness", STIFFNESS)):
        whole = float(along @ answer.covariance @ along)
        shares = {source: float(along @ part @ along) / whole for source, part in parts.items()} if whole > 0 else {}
        found[quantity] = shares | {"scatter": 1.0 - sum(shares.values())}
    return found


def _sides_known(found: Identification) -> bool:
    """True if every estimate tells the two sides of its contact apart."""
    return all(estimate.sides_known for estimate in found.outcomes.estimates.values())


def _places(body: str, stations: tuple[Station, ...]) -> str:
    return f"{body} at " + ", ".join(f"{s.position_m:g}" for s in stations if s.body == body) + " m"


def _frequencies(hz: np.ndarray) -> str:
    return ", ".join(f"{f:.4g}" for f in hz if f > 0) + " Hz"


def _joined(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
