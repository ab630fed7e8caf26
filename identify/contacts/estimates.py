"""The answers: contact forces separated without a law, then each contact fitted together with its drift."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from identify.checks.masses import mass_pull
from identify.contacts.beginning import settled_s
from identify.contacts.forces import RING_S, ContactForces, separated_forces
from identify.contacts.joint import Joint
from identify.contacts.quality import widened
from identify.contacts.start import ContactRecord
from identify.contacts.told import ContactFit, told_contacts
from identify.contacts.unforced import driven_to_hz, free_fits, is_unforced
from identify.linear.joined import Joined, joined, joined_contacts
from identify.linear.modal import relative_displacements, relative_velocities
from identify.signals.drift import KNOT_S, Drift
from identify.signals.kinematics import Kinematics, Use, kinematics
from identify.signals.noise import acceleration_noise
from identify.signals.refit import refit_until_settled
from identify.signals.spectra import decimated, oversampled
from rig.errors import RigError
from rig.model.description import ForceSensor, Rig, Station, contact_stations
from rig.model.tolerances import Tolerances
from rig.recording import Recording

SEPARATED_TO = 4.0
"""Contact forces are separated up to this multiple of the force's highest frequency."""
QUIETEST = 1e-5
"""No accelerometer is believed to be quieter, m/s^2/sqrt(Hz): then other errors than noise make the drift."""

LEAST_S = 1.0
"""A record of which less can be used is refused."""
ROUNDS = 3
"""Of the fits of contacts whose slow motions are coupled: a coupling is a small share of the forces."""
ROUNDING = 1e-7
"""No contact force is believed to be quieter, of the exciting force: what a record without noise leaves is rounding."""


@dataclass(frozen=True)
class Contacts:
    """What was found of every contact of a recording, and from what: a separated force, and what was observed of it,
    for every pair of places."""

    rig: Rig
    motion: Kinematics
    separated: ContactForces
    same_place: tuple[Joined, ...]
    observed: tuple[ContactRecord, ...]
    estimates: tuple[ContactFit, ...]


def find_contacts(recording: Recording, use: Use, tolerances: Tolerances) -> Contacts:
    """Clearance, stiffness and damping of every contact, or the reason why the record does not tell them.

    Of a segment of a longer record the first seconds, in which the beams ring of what was before, tell nothing.

    Raises RigError if the record allows nothing: too short, too few stations, no force, no contacts described.
    """
    rig = recording.rig
    if not rig.contacts:
        raise RigError(f"rig {rig.name!r} has no contacts; describe them in rig.json")
    _check_known(rig)
    motion = kinematics(recording, use)
    high_hz = min(SEPARATED_TO * driven_to_hz(motion), motion.trusted_hz[1])
    factor = max(1, int(motion.sample_rate_hz / 2 / high_hz))
    if motion.zero_known:
        _check_displacements(rig, motion)
    noise = acceleration_noise(motion, rig)
    in_gaps = mass_pull(rig, motion, tolerances)
    places = joined(rig)
    from_rest = recording.start_s > 0 or motion.excited_from > 0
    separated = separated_forces(places, motion, factor, noise, tolerances, from_rest)
    if recording.start_s > 0 or not from_rest:
        without_s = RING_S if from_rest else settled_s(places, separated.slow_n_per_m)
        fewer = round(without_s * motion.sample_rate_hz / factor)
        left = separated.force_n.shape[1] - fewer
        if left * factor < LEAST_S * motion.sample_rate_hz:
            raise RigError(_too_short(recording, without_s, fewer + left, factor, motion))
        motion, separated = motion.part(slice(fewer * factor, None)), separated.after(fewer)
    observed, same_place = _observed(places, motion, noise, separated, tolerances), joined_contacts(rig)
    parameters = separated.nuisances.parameters
    estimates = tuple(
        widened(e, parameters, in_gaps) if isinstance(e, Joint) else e
        for e in _estimates(rig, observed, same_place, separated.slow_n_per_m)
    )
    if is_unforced(motion):
        estimates = free_fits([c.name for c in rig.contacts], estimates)
    return Contacts(rig, motion, separated, same_place, tuple(observed), estimates)


def _too_short(recording: Recording, without_s: float, until: int, factor: int, motion: Kinematics) -> str:
    at_end_s = recording.duration_s - until * factor / recording.rig.sample_rate_hz
    return (
        f"the record lasts {recording.duration_s:.3g} s and does not begin at rest: {without_s:.3g} s at its start and "
        f"{at_end_s:.3g} s at its end cannot be used; record longer, or begin with a quarter second at rest without "
        "force" + ("" if motion.zero_known else ", or measure displacements")
    )


_INSTEAD = {
    "base_motion": "of one mass give its motion against the base, and minus its mass times the base's acceleration as "
    "the force; of other bodies hold the base still and measure an exciting force"
}


def _check_known(rig: Rig) -> None:
    """Raises RigError if the description holds something that the linear model of the identification leaves out."""
    for what in ("masses", "springs", "clamps", "loads", "base_motion", "force_sensor", "dampers", "tones"):
        if getattr(rig, what) not in ((), None, ForceSensor()):
            raise RigError(
                f"rig.json of {rig.name!r} has {what}, which the identification does not know; "
                + _INSTEAD.get(what, "it takes beams, structures and masses on springs, without attachments")
            )


def _check_displacements(rig: Rig, motion: Kinematics) -> None:
    """Raises RigError if a contact has no sensor, and its body fewer stations than modes: its displacement there does
    not follow from that at the stations."""
    for contact in rig.contacts:
        for station in (s for s in contact_stations(contact) if motion.row(s) is None):
            stations = sum(s.body == station.body for s in motion.stations)
            if stations < rig.body(station.body).max_modes:
                raise RigError(
                    f"contact {contact.name!r} has no sensor at {station.position_m} m of {station.body!r}, and the "
                    f"body has more modes than stations ({stations}): its displacement there cannot be told; put a "
                    "sensor there"
                )


def _observed(
    rig: Rig,
    motion: Kinematics,
    noise: Float[np.ndarray, " stations"],
    separated: ContactForces,
    tolerances: Tolerances,
) -> list[ContactRecord]:
    samples = separated.force_n.shape[1] * separated.factor
    samples = min(samples, motion.samples)
    eta, velocity = relative_displacements(rig, motion), relative_velocities(rig, motion)
    found = []
    quiet = separated.force_n[:, : motion.excited_from // separated.factor]
    quiet_n = quiet.std(axis=1) if quiet.shape[1] else np.zeros(len(rig.contacts))
    quiet_n = np.maximum(quiet_n, ROUNDING * motion.forces_n.std(axis=1).max())
    for j in range(len(rig.contacts)):
        displaced = separated.nuisances.eta_m[:, j]
        moving = np.any(displaced, axis=1)
        drift = drift_of(rig, motion, j, noise, tolerances, samples)
        nuisance_m = oversampled(displaced[moving], separated.factor)[:, :samples].astype(np.float32)
        found.append(
            ContactRecord(
                eta_m=eta[j, :samples],
                velocity_m_per_s=velocity[j, :samples],
                sample_rate_hz=motion.sample_rate_hz,
                force_n=separated.force_n[j],
                factor=separated.factor,
                quiet_n=float(quiet_n[j]),
                unmodelled=tolerances.unmodelled_contact,
                drift=drift
                and replace(
                    drift,
                    spring_n_per_m=float(separated.slow_n_per_m[j, j]),
                    damper_n_s_per_m=float(separated.slow_n_s_per_m[j, j]),
                ),
                nuisance_n=separated.nuisances.force_n[:, j],
                noise_in_n=separated.nuisances.noise_in_n[:, j],
                noise_in_m=separated.nuisances.noise_in_m[moving, j],
                moving=moving,
                nuisance_m=nuisance_m,
                initial=np.array([p.kind == "initial state" for p in separated.nuisances.parameters], dtype=bool),
            )
        )
    return found


def drift_of(
    rig: Rig,
    motion: Kinematics,
    contact: int,
    noise: Float[np.ndarray, " stations"],
    tolerances: Tolerances,
    samples: int,
) -> Drift | None:
    """What is known of the slow part of a contact's relative displacement; None where nothing of it is lost.

    Raises RigError if no sensor stands at the contact.
    """
    if motion.zero_known:
        return None
    stations = contact_stations(rig.contacts[contact])
    missing = [s for s in stations if motion.row(s) is None]
    if missing:
        raise RigError(
            f"contact {rig.contacts[contact].name!r} has no sensor at {missing[0].position_m} m of "
            f"{missing[0].body!r}; its drift cannot be told: put an accelerometer there"
        )
    slow = [motion.lost_m_per_s2[motion.stations.index(s)] for s in stations]
    densities = [_density(motion, s, noise, tolerances) for s in stations]
    return Drift(
        acceleration_m_per_s2=(slow[0] - (slow[1] if len(slow) > 1 else 0.0))[:samples],
        noise_density=max(float(np.hypot.reduce(densities)), QUIETEST),
        spring_n_per_m=0.0,
    )


def _density(
    motion: Kinematics, station: Station, noise: Float[np.ndarray, " stations"], tolerances: Tolerances
) -> float:
    """One-sided density of a station's acceleration error where the drift follows it, m/s^2/sqrt(Hz).

    The sensor's noise, and what the tolerances of its gain and of its position make of the slow acceleration there.
    """
    row = motion.stations.index(station)
    own = [i for i, s in enumerate(motion.stations) if s.body == station.body]
    own.sort(key=lambda i: motion.stations[i].position_m)
    followed_hz = 0.5 / KNOT_S
    factor = max(1, int(motion.sample_rate_hz / (2 * followed_hz)))
    slow = np.stack([decimated(acceleration, factor) for acceleration in motion.acceleration_m_per_s2[own]])
    error = tolerances.gain**2 * np.mean(slow[own.index(row)] ** 2)
    if len(own) > 1:
        slope = np.gradient(slow, [motion.stations[i].position_m for i in own], axis=0)[own.index(row)]
        error += tolerances.position_m**2 * np.mean(slope**2)
    return float(np.sqrt(2 * noise[row] ** 2 / motion.sample_rate_hz + error / followed_hz))


def _estimates(
    rig: Rig,
    observed: Sequence[ContactRecord],
    same_place: Sequence[Joined],
    slow_n_per_m: Float[np.ndarray, "forces forces"],
) -> tuple[ContactFit, ...]:
    """Of every contact, each force by itself; where springs couple their slow motion, again with that of the others."""
    others = slow_n_per_m - np.diag(np.diag(slow_n_per_m))

    def refit(found: list[tuple[ContactFit, ...]]) -> list[tuple[ContactFit, ...]]:
        slow_m = np.zeros((len(found), len(observed[0].force_n)))
        for row, one, seen, fits in zip(slow_m, same_place, observed, found, strict=True):
            for sign, fit in zip(one.signs, fits, strict=True):
                if isinstance(fit, Joint):
                    whole = sign * fit.drift_m + fit.pulls[seen.moving] @ seen.nuisance_m
                    row[:] = whole[:: seen.factor][: row.size]
        return [
            told_contacts(rig, one, replace(seen, force_n=seen.force_n - more))
            for one, seen, more in zip(same_place, observed, others @ slow_m, strict=True)
        ]

    alone = [told_contacts(rig, one, seen) for one, seen in zip(same_place, observed, strict=True)]
    found = refit_until_settled(alone, refit, rounds=ROUNDS if np.any(others) else 0)
    each: dict[int, ContactFit] = {}
    for one, told in zip(same_place, found, strict=True):
        each |= dict(zip(one.members, told, strict=True))
    return tuple(each[j] for j in range(len(rig.contacts)))
