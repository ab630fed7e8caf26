"""Single masses, of which no other channel tells: while its contacts are open, a mass on a spring obeys

    m a + c v + k x = F

with the measured force, or 0 where none acts. Fitted to the samples in the middle of the gaps, each passage with a
constant of its own (slow motion that accelerometers miss), m, c and k are compared with rig.json. What is left of the
force is noise of the acceleration, or passages that are mixed with closed contacts: both lower the mass by about its
share, and closed contacts raise the spring.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from identify.checks.findings import Finding
from identify.checks.relations import usual_factor
from identify.linear.joined import joined_contacts
from identify.signals.kinematics import Kinematics
from identify.signals.spectra import decimated, force_band
from rig.errors import RigError
from rig.model.description import Body, Rig
from rig.model.tolerances import Tolerances

OPEN, CLEAN = (0.4, 0.2, 0.1), 0.95
"""The middle of a gap: relative displacements below this quantile; below the next one, where less of the force is
explained, as closed contacts are among them."""
WELL_INSIDE = 0.5
"""Of several contacts between the same places, of which a soft one hides in what the force explains, relative
displacements also below this share of the smallest clearance that is believed."""
SHORTEST = 8
TO_FORCE = 3.0
FAR, LEAST = 4.0, 2e-3
"""So many standard deviations of tolerances and errors are too many; no tolerance is believed to be less."""
UNRELATED = 0.3
"""Force and motion are of different records where less of the force is explained."""
CLOCK, BESIDE, MOST_FAST = 3.5, 2.0, 0.03
"""A clock is asked for by so many standard deviations at least, and leaves no more of mass and frequency; none is off
by more than that share."""
LATEST_S = 0.02
DAMPED = 0.5
LEAST_DRIVEN = 0.05
"""Of the force's root mean square: less is no force, as after a single blow."""


@dataclass(frozen=True)
class MassFit:
    """Estimates by the open passages: force per acceleration, damping and spring, with standard errors; the delay of
    the force against the sensor at which they fit best, and the share of the force that is then explained.
    """

    values: Float[np.ndarray, "3"]
    errors: Float[np.ndarray, "3"]
    delay_s: float
    explained: float


def mass_findings(rig: Rig, motion: Kinematics, tolerances: Tolerances) -> list[Finding]:
    """Findings on the mass on which the force acts, or all forces together."""
    body, row = _driven(rig, motion)
    if not body.is_mass or row is None:
        return []
    fit = open_fit(rig, motion, row)
    if fit is None:
        return []
    sensor = motion.sensors[row]
    clock = _clock(body, sensor.measures.order, fit, tolerances)
    return [clock] if clock else list(_compared(body, (*rig.force_names, sensor.name), fit, tolerances))


def _driven(rig: Rig, motion: Kinematics) -> tuple[Body, int | None]:
    """The body on which the (first) force acts, and the row of its station; none if others act elsewhere."""
    at = rig.forces[0]
    return rig.body(at.body), motion.row(at) if set(rig.forces) == {at} else None


def mass_pull(rig: Rig, motion: Kinematics, tolerances: Tolerances) -> float:
    """Pull: by how many standard deviations of tolerances and errors mass and frequency of the mass on which the force
    acts are off, or the clock with them, whichever is most; 0 where nothing tells, or other bodies' channels tell more.
    """
    body, row = _driven(rig, motion)
    if row is None or len(rig.bodies) > 1 or not body.is_mass or not np.any(motion.forces_n):
        return 0.0
    fit = open_fit(rig, motion, row)
    if fit is None or fit.explained < UNRELATED:
        return 0.0
    off, deviation, by_clock = _off(body, motion.sensors[row].measures.order, fit, tolerances)
    along = abs(by_clock / deviation @ (off / deviation)) / float(np.linalg.norm(by_clock / deviation))
    return float(max(along, *np.abs(off / deviation)))


def open_fit(rig: Rig, motion: Kinematics, row: int) -> MassFit | None:
    """None where there are too few samples with open contacts, or no force acts in them."""
    best: MassFit | None = None
    for share in OPEN:
        fit = _fit_below(share, rig, motion, row)
        if fit is None or (best and fit.explained < best.explained):
            break
        best = fit
        if best.explained > CLEAN:
            break
    return best


def _fit_below(share: float, rig: Rig, motion: Kinematics, row: int) -> MassFit | None:
    high_hz = force_band(motion.forces_n, motion.sample_rate_hz)[1]
    factor = max(1, int(motion.sample_rate_hz / 2 / (TO_FORCE * high_hz)))
    rate = motion.sample_rate_hz / factor
    rows = (motion.acceleration_m_per_s2[row], motion.velocity_m_per_s[row], motion.displacement_m[row])
    signals = decimated(np.stack([motion.forces_n.sum(axis=0), *rows]), factor)
    begun = motion.excited_from // factor + 1
    passages = _passages(_open(rig, motion, factor, share), begun)
    if sum(p.stop - p.start for p in passages) < 50:
        return None
    if np.concatenate([signals[0, p] for p in passages]).std() < LEAST_DRIVEN * signals[0].std():
        return None

    def fitted(delay_s: float) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        force = np.interp(np.arange(signals.shape[1]) + delay_s * rate, np.arange(signals.shape[1]), signals[0])
        parts = [np.stack([force[p], *signals[1:, p]]) for p in passages]
        centred = [p - p.mean(axis=1, keepdims=True) for p in parts]
        every = np.concatenate(centred, axis=1)
        sizes = every[1:].std(axis=1)
        scaled = every[1:] / sizes[:, None]
        if not np.isfinite(scaled).all():
            raise RigError("while contacts are open nothing moves, or by more than any machine")
        inverse = np.linalg.pinv(scaled.T)
        values = inverse @ every[0] / sizes
        left = every[0] - values @ every[1:]
        ends = np.cumsum([p.shape[1] for p in centred])[:-1]
        scores = [i @ r for i, r in zip(np.split(inverse, ends, axis=1), np.split(left, ends), strict=True)]
        errors = np.sqrt(np.sum(np.square(scores), axis=0)) / sizes
        return 1 - float(np.mean(left**2) / np.mean(every[0] ** 2)), values, errors, left

    delays = np.arange(-LATEST_S, LATEST_S + 1e-9, 0.5 / rate)
    best = float(delays[int(np.argmax([fitted(d)[0] for d in delays]))])
    near = best + np.linspace(-0.5, 0.5, 21) / rate
    best = float(near[int(np.argmax([fitted(d)[0] for d in near]))])
    at_once = fitted(0.0)
    if fitted(best)[0] - at_once[0] < 0.2 * (1 - at_once[0]):
        best = 0.0
    explained, values, errors, _ = fitted(best)
    return MassFit(values, errors, best, explained)


def _open(rig: Rig, motion: Kinematics, factor: int, share: float) -> Bool[np.ndarray, " fewer"]:
    """Mask of the samples at which every contact of the force's body is in the middle of its clearance."""
    found = np.ones(-(-motion.samples // factor), dtype=bool)
    for one in joined_contacts(rig):
        contact = one.contact
        if rig.forces[0].body not in (contact.at.body, contact.against.body if contact.against else None):
            continue
        sides = [motion.row(s) for s in (contact.at, contact.against) if s is not None]
        if None in sides:
            continue
        eta = motion.displacement_m[sides[0]] - (motion.displacement_m[sides[1]] if len(sides) > 1 else 0.0)
        size = np.abs(eta - np.median(eta))[::factor]
        found &= size < np.quantile(size[motion.excited_from // factor :], share)
        if len(one.members) > 1:
            laws = [rig.contacts[j].law for j in one.members]
            found &= size < WELL_INSIDE * min(x for law in laws for x in (law.lower_clearance_m, law.upper_clearance_m))
    return found


def _passages(is_open: Bool[np.ndarray, " fewer"], begun: int) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.r_[0, is_open.astype(np.int8), 0]))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if a >= begun and b - a >= SHORTEST]


def _compared(body: Body, channels: tuple[str, ...], fit: MassFit, tolerances: Tolerances) -> list[Finding]:
    """The first that is off, of the forces and, last, the sensor: whether the force drives it at all, delay, size,
    frequency, damping."""
    mass, damping, stiffness = fit.values
    if fit.explained < UNRELATED:
        return [
            Finding(
                cause="force",
                channels=channels,
                evidence=f"while its contacts are open, {100 * max(fit.explained, 0):.2g} % of the force shows in "
                f"{channels[-1]}",
                mend="check that both channels are of this record, and the quantity of the sensor",
            )
        ]
    ratio = mass / float(getattr(body, "mass_kg", np.nan)) / fit.explained
    by_chance = fit.delay_s != 0 and not 0.5 < abs(ratio) < 2
    if by_chance:
        return []
    mixed = 1 - fit.explained
    found = []
    if abs(fit.delay_s) > 1e-4:
        found.append(
            Finding(
                cause="delay",
                channels=channels,
                evidence=f"{channels[-1]} comes {1e3 * abs(fit.delay_s):.2g} ms "
                f"{'late' if fit.delay_s < 0 else 'early'} against the force",
                mend="synchronise the two, or set its delay_s in rig.json",
            )
        )
    allowed = FAR * float(np.hypot.reduce([tolerances.mass, tolerances.gain, tolerances.force_gain, LEAST]))
    if abs(ratio - 1) > allowed + FAR * fit.errors[0] / abs(mass):
        found.append(_size(body, channels, ratio))
    natural_hz = _told_hz(body)
    square = stiffness / mass
    if natural_hz:
        shown = float(np.sqrt(max(square, 0.0))) / (2 * np.pi)
        error = 0.5 * float(np.hypot(fit.errors[2] / abs(stiffness), fit.errors[0] / abs(mass)))
        allowed = FAR * float(np.hypot(np.sqrt(2) * tolerances.frequency, LEAST))
        if abs(shown / natural_hz - 1) > allowed + mixed + FAR * error:
            found.append(
                Finding(
                    cause="frequency",
                    of=body.name,
                    evidence=f"while its contacts are open, {body.name} moves as if its frequency were {shown:.4g} Hz, "
                    f"not {natural_hz:g} Hz",
                    mend="correct its spring or frequency in rig.json, or check the sampling rate",
                )
            )
        believed = 2 * float(body.damping_ratios(1)[0]) * 2 * np.pi * natural_hz
        share, wide = damping / mass / believed if believed else 1.0, fit.errors[1] / abs(mass) / (believed or np.inf)
        if (
            not found
            and abs(share - 1) > FAR * float(np.hypot(np.sqrt(2) * tolerances.damping, 10 * LEAST)) + FAR * wide
        ):
            found.append(
                Finding(
                    cause="damping",
                    of=body.name,
                    evidence=f"while its contacts are open, {body.name} is damped {share:.3g} times as much as "
                    "rig.json says",
                    mend="take its damping from a decay or a modal test",
                )
            )
    return found[:1] if found and found[0].cause in ("delay", "polarity", "units") else found


def _clock(body: Body, order: int, fit: MassFit, tolerances: Tolerances) -> Finding | None:
    """Times that are all too short by a factor s show a frequency s times too high, and a mass s^(order - 2) times the
    true one, by a sensor of that derivative: one question, asked of both."""
    mass, _, stiffness = fit.values
    if order > 1 or not _told_hz(body) or mass <= 0 or stiffness <= 0:
        return None
    off, deviation, by_clock = _off(body, order, fit, tolerances)
    along, size = by_clock / deviation @ (off / deviation), float(np.linalg.norm(by_clock / deviation))
    fast = along / size**2
    beside = np.abs(off - fast * by_clock) / deviation
    if fit.delay_s or not CLOCK / size < abs(fast) < MOST_FAST or beside.max() > BESIDE:
        return None
    return Finding(
        cause="clock",
        evidence=f"{body.name} moves as if all times were {100 * abs(fast):.2g} % too "
        f"{'short' if fast > 0 else 'long'}",
        mend="check the sampling rate, and weigh the mass: one that is off by twice that share looks alike",
    )


def _told_hz(body: Body) -> float:
    """The natural frequency, where the middle of a gap tells it: beside a strong damper a spring's force is small."""
    return float(body.frequencies_hz(1)[0]) if body.damping_ratios(1)[0] < DAMPED else 0.0


def _off(
    body: Body, order: int, fit: MassFit, tolerances: Tolerances
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Errors of mass and frequency as logarithms; their standard deviations; what a clock does to them.

    Of a mass without a spring, or where a sign is turned, nothing of the frequency, or of both.
    """
    mass, _, stiffness = fit.values
    natural_hz = _told_hz(body)
    ratio = mass / float(getattr(body, "mass_kg", np.nan)) / fit.explained
    of_fit, of_spring = fit.errors[0] / abs(mass), fit.errors[2] / abs(stiffness)
    own = np.array([of_fit, 0.5 * float(np.hypot(of_fit, of_spring)) + 1 - fit.explained])
    of_mass = float(np.hypot.reduce([tolerances.mass, tolerances.gain, tolerances.force_gain, LEAST]))
    deviation = np.hypot([of_mass, np.hypot(np.sqrt(2) * tolerances.frequency, LEAST)], own)
    known = natural_hz > 0 and stiffness > 0 and mass > 0
    by_frequency = np.log(np.sqrt(stiffness / mass) / (2 * np.pi * natural_hz)) if known else 0.0
    off = np.array([np.log(ratio) if ratio > 0 else 0.0, by_frequency])
    return off, deviation, np.array([order - 2.0, 1.0])


def _size(body: Body, channels: tuple[str, ...], ratio: float) -> Finding:
    """The sensor delivers 1 / ratio times what the force and the mass make."""
    evidence = f"{channels[-1]} delivers {1 / ratio:.4g} times what the force and the mass of {body.name} make"
    if ratio < 0 and 0.5 < -ratio < 2:
        return Finding(
            cause="polarity", channels=channels, evidence=evidence, mend="turn it, or the force, with scale = -1"
        )
    units = usual_factor(1 / ratio)
    if units:
        mend = f"correct the unit of the sensor or of the force in the import map, it looks like {units}"
        return Finding(cause="units", channels=channels, evidence=evidence, mend=mend)
    return Finding(
        cause="gain",
        channels=channels,
        of=body.name,
        evidence=evidence,
        mend="weigh the mass, calibrate the sensor and the load cell",
    )
