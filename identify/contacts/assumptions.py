"""Assumptions behind an identification, the sources of its errors, and what would make it surer, in sentences."""

from collections.abc import Iterator

import numpy as np

from identify.contacts.identification import Identification
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import STIFFNESS_GRADIENT
from identify.contacts.separation import is_unforced
from identify.pages.wording import percent
from identify.signals.measured_base import body_force_count
from rig.model.description import Station
from rig.model.modes import with_attachments_merged
from rig.model.tolerances import EXACT, Tolerances

SHORTEST_QUIET_S = 0.3
"""Time before the force that is needed to measure the noise."""
DOMINANT_VARIANCE_SHARE = 0.5
"""Share of an estimate's variance from which its source is named."""
_VARIANCE_REMEDIES = {
    "tolerances": "the tolerances of rig.json (gains, positions, frequencies, damping): calibrate the sensors, measure "
    "their positions and fit the modes; a longer record would not help",
    "drift": "the slow motion that accelerometers miss: add displacement sensors at the contact, or take quieter "
    "accelerometers",
    "law": "the contact's law, which does not fit loading and unloading, or deep and shallow contacts, by the same "
    "numbers: look at the force over the relative displacement, and run identify law",
    "scatter": "the record's own scatter: record longer (four times as long halves it) or excite more strongly",
}


def assumptions(result: Identification) -> Iterator[str]:
    """Sentences on the law's form, the bodies, the tolerances of rig.json, and the sensors and bands used."""
    report, motion, rig, tolerances = result.report, result.motion, result.rig, result.tolerances
    yield (
        "The contact law: no force within the gap; beyond it stiffness times penetration plus damping times relative "
        "velocity, which may set in at once or over 10 um. Where one contact alone acts between its places, a power "
        "of the penetration and a stop that cannot pull were tried too; they are taken only if the record demands "
        "them. Both stops of a contact are equally stiff, and nothing wears during the record."
    )
    body_texts = (
        f"{body.name}, {_frequencies_text(body.frequencies_hz(min(4 + body.rigid_modes, body.max_modes)))}"
        for body in with_attachments_merged(rig).bodies
    )
    yield f"The bodies are those of rig.json, linear: {'; '.join(body_texts)}."
    yield tolerances_sentence(tolerances)
    stations_text = "; ".join(station_positions_text(body.name, motion.stations) for body in rig.bodies)
    yield f"Stations used: {stations_text}. Channels: {', '.join(report.channels_used)}."
    if unused_channels := [sensor.name for sensor in rig.sensors if sensor.name not in report.channels_used]:
        yield f"Channels not used: {', '.join(unused_channels)}."
    low_hz, high_hz = report.trusted_hz
    yield (
        f"Frequencies: the motion is trusted from {low_hz:g} to {high_hz:.4g} Hz, the contact forces are separated "
        f"up to {motion.sample_rate_hz / 2 / result.decimation:.4g} Hz"
        + (", and the slow motion below is solved for within the noise of the accelerometers." if low_hz else ".")
    )
    if motion.slow_by_gauges:
        yield (
            "Strain gauges carry the slow motion: the contact forces that they show, and the exciting forces, give the "
            "slow displacements of the linear bodies."
        )
    for group in result.contact_groups:
        if len(group.contact_indices) > 1:
            stop_count = sum(rig.contacts[contact_index].law.has_stops for contact_index in group.contact_indices)
            rules = ["the slope within the gap is the spring's"] if stop_count < len(group.contact_indices) else []
            if stop_count > 1:
                rules.append("each stop has the knee that comes nearest to its clearance and stiffness in rig.json")
            yield (
                f"{group.joined_contact.name} act between the same places: the record tells the sum of their forces; "
                f"{' and '.join(rules)}."
            )
    if is_unforced(motion):
        yield (
            "No force was recorded: none acts during the record but those of the contacts, whose size rests on the "
            "masses of rig.json."
        )
    if motion.base:
        note = "" if body_force_count(rig) else "; as no force was measured, stiffnesses rest on the masses of rig.json"
        yield f"The base shakes, which {motion.base.sensor.name} measures: all motion is taken relative to it{note}."
    yield f"The accelerations' noise is taken from {report.noise_from}."
    if result.outcomes.refusals or not _sides_known(result):
        yield "The zero of the relative displacement is not known: the two stops stand equally far from it."


def tolerances_sentence(tolerances: Tolerances) -> str:
    """Sentence on the tolerances of rig.json."""
    if tolerances == EXACT:
        return "rig.json is believed exactly: no tolerances."
    return (
        "Tolerances of rig.json, as standard deviations, fitted along: sensor gains "
        f"{100 * tolerances.gain:.2g} %, their positions {1e3 * tolerances.position_m:.2g} mm, delays "
        f"{1e3 * tolerances.delay_s:.2g} ms and high-pass {tolerances.high_pass_hz:.2g} Hz, each force's gain "
        f"{100 * tolerances.force_gain:.2g} %, masses {100 * tolerances.mass:.2g} %, natural frequencies "
        f"{100 * tolerances.frequency:.2g} %, damping {100 * tolerances.damping:.2g} %."
    )


def recommendations(result: Identification) -> Iterator[str]:
    """Sentences on remedies: of refusals, of the dominant source of error of each estimate, and general ones."""
    for name, refusal in result.outcomes.refusals.items():
        yield f"{name}: {refusal.advice}."
    quantities_by_source: dict[str, list[str]] = {}
    for name, estimate in result.outcomes.estimates.items():
        for quantity, shares in variance_shares(estimate).items():
            for source, share in shares.items():
                if share >= DOMINANT_VARIANCE_SHARE:
                    quantities_by_source.setdefault(source, []).append(f"{name}'s {quantity} ({percent(share)})")
    for source, quantities in quantities_by_source.items():
        yield f"Most of the variance of {_enumeration(quantities)} comes from {_VARIANCE_REMEDIES[source]}."
    if not _sides_known(result):
        yield (
            "The mean of a contact's two clearances is known, not each of them: for that, measure the displacement on "
            "both sides of the contact, by sensors that also show a constant one."
        )
    if not is_unforced(result.motion) and result.motion.excited_from < SHORTEST_QUIET_S * result.motion.sample_rate_hz:
        yield (
            f"The sensors' noise is taken from {result.report.noise_from}: let the record begin with a second or more "
            "without force to measure it."
        )
    if result.outcomes.estimates:
        yield (
            "Simulate with the identified rig.json, which stands beside this page. These intervals assume that its "
            "masses and stiffnesses are right: test that with identify gap."
        )


def variance_shares(estimate: JointEstimate) -> dict[str, dict[str, float]]:
    """Shares of the variance of clearance and stiffness by source, which sum to one."""
    shares_by_quantity = {}
    for quantity, gradient in (("clearance", estimate.clearance_gradient), ("stiffness", STIFFNESS_GRADIENT)):
        variances = {source: float(gradient @ part @ gradient) for source, part in estimate.covariances.items()}
        total = sum(variances.values())
        shares = {source: variance / total for source, variance in variances.items()} if total > 0 else {"scatter": 1.0}
        shares_by_quantity[quantity] = shares
    return shares_by_quantity


def _sides_known(result: Identification) -> bool:
    """True if all estimates tell the two sides of their contacts apart."""
    return all(estimate.sides_known for estimate in result.outcomes.estimates.values())


def station_positions_text(body: str, stations: tuple[Station, ...]) -> str:
    """Positions of a body's stations in words."""
    return f"{body} at " + ", ".join(f"{station.position_m:g}" for station in stations if station.body == body) + " m"


def _frequencies_text(frequencies_hz: np.ndarray) -> str:
    return ", ".join(f"{frequency_hz:.4g}" for frequency_hz in frequencies_hz if frequency_hz > 0) + " Hz"


def _enumeration(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
