"""The identification of the contacts: separated forces, joint estimate, and the paper's surface and NIFO beside it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from identify.drift import Drift
from identify.forces import ContactForces, separated_forces
from identify.joint import Joint, Observed, fit_joint
from identify.kinematics import Kinematics, Use, acceleration_noise, kinematics, slow_acceleration
from identify.modal import (
    modal_equations,
    relative_displacements,
    relative_velocities,
    transformation,
    without_higher_modes,
)
from identify.nifo import Nifo, nifo
from identify.results import ContactReport
from identify.spectra import Averaging, blocks, force_band, penetration
from identify.summary import Answer, contact_report
from identify.surface import Stops, Surface, clearance_from_occurrence, fit_surface
from identify.tolerances import LABORATORY, Tolerances
from rig.contact import DeadZone
from rig.description import Rig, contact_stations
from rig.errors import RigError
from rig.recording import Recording

LOWEST_HZ = 0.5
"""Lines below are not looked at: a free body's response there is drift."""
CLEAR_OF_CORNER = 4.0
"""NIFO on integrated accelerations begins at this multiple of the corner, clear of what the blocks leak over it."""
EQUATIONS = 4
SEPARATED_TO = 4.0
"""Contact forces are separated up to this multiple of the force's highest frequency."""
LOOSE = 0.1
"""An estimate whose standard error is a larger share of it is no answer."""


@dataclass(frozen=True)
class Identification:
    """The report, and what it was drawn from, for figures and for further work.

    eta_m is complete with its drift; answers has one entry a contact.
    """

    report: ContactReport
    rig: Rig
    motion: Kinematics
    eta_m: Float[np.ndarray, "contacts samples"]
    separated: ContactForces
    answers: tuple[Answer, ...]
    surface: Surface
    weak: Nifo
    paper: Nifo

    @property
    def stops(self) -> tuple[Stops | None, ...]:
        return tuple(_stops(a) for a in self.answers)


def identify_contact(
    recording: Recording,
    *,
    use: Use = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances = LABORATORY,
    progress: Callable[[float], None] = lambda _: None,
) -> Identification:
    """Clearance, stiffness and damping of every contact of a recording's rig.

    The contact forces are separated without a law, then each is fitted together with the slow drift of its relative
    displacement: these are the answers. With the law found, the modes beyond the fitted ones are taken off the
    motion, and the paper's methods are applied to every modal equation: the restoring force surface and NIFO. The main
    equation, which the figures show, is the one whose stiffness varies least over frequency, unless it is named
    ("barrel 3").

    Raises RigError if the record does not allow it: too short, too few stations, no force.
    """
    rig, averaging = recording.rig, averaging or Averaging()
    if not rig.contacts:
        raise RigError(f"rig {rig.name!r} has no contacts; describe them in rig.json")
    motion = kinematics(recording, use)
    low, high = force_band(motion.force_n, motion.sample_rate_hz)
    band = averaging.band_hz or (
        max(low, CLEAR_OF_CORNER * motion.trusted_hz[0], LOWEST_HZ),
        min(high, motion.trusted_hz[1]),
    )
    factor = max(1, int(motion.sample_rate_hz / 2 / min(SEPARATED_TO * high, motion.trusted_hz[1])))
    noise = acceleration_noise(motion, rig)
    separated = separated_forces(rig, motion, factor, noise, tolerances)
    progress(0.2)
    observed = _observed(rig, motion, noise, separated)
    answers = tuple(_answer(o, separated, j) for j, o in enumerate(observed))
    progress(0.5)
    eta, force, depth = _with_law(observed, answers)
    samples = eta.shape[1]
    cleaned = without_higher_modes(rig, _cut(motion, samples), force)
    eta, depth = eta[:, : cleaned.force_n.size], depth[:, : cleaned.force_n.size]
    stops = tuple(_stops(a) for a in answers)
    cut = blocks(cleaned.force_n.size, motion.sample_rate_hz, averaging, band)
    equations = [e for body in rig.bodies for e in modal_equations(rig, cleaned, body, EQUATIONS)]
    spectra = [nifo(e, cleaned.force_n, depth, cut) for e in equations if e.shape_at_force != 0]
    progress(0.7)
    coarse = _decimation(rig, motion)
    surfaces = [fit_surface(e, cleaned.force_n, eta, coarse, stops) for e in equations]
    progress(0.95)
    weak = _main(spectra, equation)
    return Identification(
        report=contact_report(
            rig,
            motion,
            answers=answers,
            transformations=[transformation(rig, body, motion) for body in rig.bodies],
            surfaces=surfaces,
            occurrence=[
                None if s is None else clearance_from_occurrence(e[motion.excited_from :])
                for e, s in zip(eta, stops, strict=True)
            ],
            weak=weak,
            spectra=spectra,
        ),
        rig=rig,
        motion=cleaned,
        eta_m=eta,
        separated=separated,
        answers=answers,
        surface=next(s for s in surfaces if s.equation.name == weak.equation.name),
        weak=weak,
        paper=nifo(weak.equation, cleaned.force_n, depth, cut, "paper"),
    )


def _observed(
    rig: Rig, motion: Kinematics, noise: Float[np.ndarray, " stations"], separated: ContactForces
) -> list[Observed]:
    samples = separated.force_n.shape[1] * separated.factor
    samples = min(samples, motion.force_n.size)
    eta, velocity = relative_displacements(rig, motion), relative_velocities(rig, motion)
    found = []
    for j, contact in enumerate(rig.contacts):
        drift = None
        if not motion.zero_known:
            stations = contact_stations(contact)
            missing = [s for s in stations if motion.row(s) is None]
            if missing:
                raise RigError(
                    f"contact {contact.name!r} has no sensor at {missing[0].position_m} m of {missing[0].body!r}; "
                    "its drift cannot be told: put an accelerometer there"
                )
            slow = [slow_acceleration(motion, s) for s in stations]
            of_both = np.hypot.reduce([noise[motion.stations.index(s)] for s in stations])
            drift = Drift(
                acceleration_m_per_s2=(slow[0] - (slow[1] if len(slow) > 1 else 0.0))[:samples],
                noise_density=max(float(of_both) / np.sqrt(motion.sample_rate_hz / 2), 1e-7),
                spring_n_per_m=separated.spring_n_per_m,
            )
        found.append(
            Observed(
                eta_m=eta[j, :samples],
                velocity_m_per_s=velocity[j, :samples],
                sample_rate_hz=motion.sample_rate_hz,
                force_n=separated.force_n[j],
                factor=separated.factor,
                drift=drift,
            )
        )
    return found


def _answer(observed: Observed, separated: ContactForces, contact: int) -> Answer:
    """The joint estimate, or the reason why there is none."""
    samples = observed.eta_m.size
    try:
        found = fit_joint(observed, [(force[contact], eta[contact, :samples]) for force, eta in separated.doubts])
    except RigError as error:
        return str(error)
    for what, value, error_of in (
        ("clearance", found.clearance_m, found.clearance_error_m),
        ("stiffness", found.parameters[2], np.sqrt(found.covariance[2, 2])),
    ):
        if not error_of < LOOSE * value:
            share = 100 * error_of / max(value, 1e-12)
            return f"its {what} is uncertain by {share:.0f} %; record longer or change the force"
    return found


def _with_law(
    observed: list[Observed], answers: tuple[Answer, ...]
) -> tuple[
    Float[np.ndarray, "contacts samples"], Float[np.ndarray, "contacts samples"], Float[np.ndarray, "contacts samples"]
]:
    """Relative displacement with its drift; contact force and penetration by the law found, zero where none was."""
    eta = np.stack([o.eta_m for o in observed])
    force, depth = np.zeros_like(eta), np.zeros_like(eta)
    for j, (seen, found) in enumerate(zip(observed, answers, strict=True)):
        if isinstance(found, Joint):
            lower, upper, stiffness, damping = (float(p) for p in found.parameters)
            eta[j] += found.drift_m
            depth[j] = penetration(eta[j], lower, upper)
            law = DeadZone(lower_clearance_m=lower, upper_clearance_m=upper, stiffness_n_per_m=0.0)
            outside = law.penetration_m(eta[j]) != 0
            force[j] = stiffness * depth[j] + damping * outside * (seen.velocity_m_per_s + found.drift_m_per_s)
    return eta, force, depth


def _stops(found: Answer) -> Stops | None:
    if not isinstance(found, Joint):
        return None
    errors = np.sqrt(np.diag(found.covariance))
    return Stops(*(float(x) for x in (*found.parameters[:2], *errors[:2], found.clearance_error_m)))


def _cut(motion: Kinematics, samples: int) -> Kinematics:
    return replace(
        motion,
        force_n=motion.force_n[:samples],
        displacement_m=motion.displacement_m[:, :samples],
        velocity_m_per_s=motion.velocity_m_per_s[:, :samples],
        acceleration_m_per_s2=motion.acceleration_m_per_s2[:, :samples],
    )


def _decimation(rig: Rig, motion: Kinematics) -> int:
    """So that a surface is fitted below four fifths of the first frequency that the stations cannot resolve."""
    limits = [motion.trusted_hz[1]]
    for body in rig.bodies:
        stations = sum(s.body == body.name for s in motion.stations)
        if body.length_m > 0 and stations < 40:
            limits.append(0.8 * float(body.frequencies_hz(stations + 1)[-1]))
    return max(1, int(motion.sample_rate_hz / 2 / min(limits)))


def _main(spectra: list[Nifo], wanted: str | None) -> Nifo:
    """The equation that is wanted, or the one with the least spread of the stiffnesses over frequency."""
    names = [n.equation.name for n in spectra]
    if wanted is not None and wanted not in names:
        raise RigError(f"no modal equation {wanted!r} with a measured force; there are {', '.join(names)}")

    def spread(result: Nifo) -> tuple[int, float]:
        return -len(result.contacts), float(np.max(result.spread_n_per_m / np.abs(result.mean_n_per_m), initial=0.0))

    return min((n for n in spectra if wanted in (None, n.equation.name)), key=spread)
