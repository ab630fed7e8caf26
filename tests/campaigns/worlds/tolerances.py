"""The machine as a laboratory builds it: everything that nobody knows exactly, drawn."""

import numpy as np
from msgspec.structs import replace

from tests.campaigns.worlds.kinds import SHARES_OF_BODIES
from tests.campaigns.worlds.laws import StopLaw
from tests.campaigns.worlds.library import EFFECTS
from tests.campaigns.worlds.machine import (
    MODES,
    Link,
    Lumped,
    Machine,
    MotionSensor,
    Place,
    TrueBeam,
    with_hung,
)
from tests.campaigns.worlds.truth import EffectTruth, World

HUNG = 1 / 3
"""The share of the cases with a small mass or a cable as a tolerance."""
FORCE_NOISE = 5e-4
"""N/sqrt(Hz)"""
HIGHPASS_HZ = (0.05, 0.3)
"""The corners of the accelerometers' amplifiers, log-uniform."""
HIGHPASS_BENCH_HZ = (0.05, 0.15)
"""Of machines that are slower."""
CABLES, CABLE_KG = 2, (3e-3, 12e-3)
"""On every beam of the world "counted", and how heavy they are."""
ONSETS_M = (1e-7, 4e-5)
"""Penetrations over which the damping of a stop sets in, log-uniform: at once for the shortest."""
CROSSTALK = 5e-3
APART_M = 0.02
"""No two cables of a beam are closer."""


def perturbed(machine: Machine, world: World, rng: np.random.Generator) -> Machine:
    """The machine as a laboratory builds it.

    own: E +-0.3 %, one damping factor a beam +-20 %, stations +-1 mm, gains +-0.2 %. wide and other: every mode's
    damping by its own factor 0.75 to 1.3 and frequency +-0.3 %, the force's gain +-0.3 % and noise about 5e-4
    N/sqrt(Hz), every sensor's high-pass at 0.05 to 0.3 Hz, cross-axis share up to 0.5 % and noise, each contact's rest
    position within 5 % of its clearance, clearance and stiffness within 1 %, and in a third a small mass or a cable.
    counted: cross-talk of neighbouring channels up to 0.5 % instead of that mass.
    """
    wide = world != "own"
    machine = replace(
        machine,
        beams=tuple(_beam(b, wide, rng) for b in machine.beams),
        sensors=tuple(_sensor(s, machine.beam(s.at.body).length_m, wide, rng) for s in machine.sensors),
    )
    if not wide:
        return machine
    cell = replace(machine.cell, gain=1 + rng.uniform(-3e-3, 3e-3), noise_density=FORCE_NOISE * 2 ** rng.uniform(-1, 1))
    machine = replace(machine, cell=cell, contacts=tuple(_contact(c, rng) for c in machine.contacts))
    if world == "counted":
        return replace(machine, sensors=tuple(_leaking(s, rng) for s in machine.sensors))
    return _with_something_hung(machine, rng) if rng.uniform() < HUNG else machine


def _beam(beam: TrueBeam, wide: bool, rng: np.random.Generator) -> TrueBeam:
    stiffer = 1 + rng.uniform(-3e-3, 3e-3)
    beam = replace(beam, youngs_modulus_pa=beam.youngs_modulus_pa * stiffer)
    if not wide:
        return replace(beam, damping_ratio=beam.damping_ratio * (1 + rng.uniform(-0.2, 0.2)))
    return replace(
        beam,
        frequency_factors=tuple((1 + rng.uniform(-3e-3, 3e-3, MODES)).tolist()),
        damping_factors=tuple(rng.uniform(0.75, 1.3, MODES).tolist()),
    )


def _sensor(sensor: MotionSensor, length_m: float, wide: bool, rng: np.random.Generator) -> MotionSensor:
    position_m = float(np.clip(sensor.at.position_m + rng.uniform(-1e-3, 1e-3), 0.0, length_m))
    sensor = replace(sensor, at=Place(sensor.at.body, position_m), gain=1 + rng.uniform(-2e-3, 2e-3))
    if not wide:
        return sensor
    return replace(
        sensor,
        highpass_hz=float(HIGHPASS_HZ[0] * (HIGHPASS_HZ[1] / HIGHPASS_HZ[0]) ** rng.uniform()),
        lateral_share=float(rng.uniform(-5e-3, 5e-3)),
        noise_density=sensor.noise_density * float(rng.uniform(0.8, 1.25)),
    )


def _contact(contact: Link, rng: np.random.Generator) -> Link:
    law = contact.law
    wider, stiffer = 1 + rng.uniform(-0.01, 0.01, 2)
    return replace(contact, law=_near(law, float(wider), float(stiffer), float(rng.uniform(-0.05, 0.05))))


def with_onsets(machine: Machine, rng: np.random.Generator) -> Machine:
    """The machine whose dampers set in over penetrations of their own, where rig.json has 10 um."""
    return replace(
        machine,
        contacts=tuple(
            replace(contact, law=replace(contact.law, onset_m=float(np.exp(rng.uniform(*np.log(ONSETS_M))))))
            for contact in machine.contacts
        ),
    )


def _near(law: StopLaw, wider: float, stiffer: float, off_centre: float) -> StopLaw:
    return replace(
        law,
        lower_m=law.lower_m * wider,
        upper_m=law.upper_m * wider,
        stiffness_below_n_per_m=law.stiffness_below_n_per_m * stiffer,
        stiffness_above_n_per_m=law.stiffness_above_n_per_m * stiffer,
        offset_m=off_centre * (law.lower_m + law.upper_m) / 2,
    )


def _with_something_hung(machine: Machine, rng: np.random.Generator) -> Machine:
    """0.5 to 2 g at 80 to 400 Hz, with 5 to 30 % of critical damping, anywhere on a beam."""
    beam = machine.beams[int(rng.integers(len(machine.beams)))]
    mass_kg, omega = float(rng.uniform(0.5e-3, 2e-3)), 2 * np.pi * float(80 * 5 ** rng.uniform())
    damping = 2 * float(rng.uniform(0.05, 0.3)) * omega * mass_kg
    law = StopLaw(spring_n_per_m=mass_kg * omega**2, dashpot_n_s_per_m=damping)
    return with_hung(machine, "hung", Place(beam.name, float(rng.uniform(0.1, 1.0)) * beam.length_m), mass_kg, law)


def _leaking(sensor: MotionSensor, rng: np.random.Generator) -> MotionSensor:
    before, after = (float(share) for share in rng.uniform(-CROSSTALK, CROSSTALK, 2))
    return replace(sensor, crosstalk=(before, after))


def with_cables(machine: Machine, rng: np.random.Generator) -> tuple[Machine, tuple[EffectTruth, ...]]:
    """The machine with cables that nobody counted, and each as the added mass that it is."""
    cables = []
    for beam in machine.beams:
        places_m = np.zeros(CABLES)
        while np.diff(np.sort(places_m)).min() < APART_M:
            places_m = rng.uniform(*SHARES_OF_BODIES, CABLES) * beam.length_m
        for place_m in places_m.tolist():
            mass_kg = float(rng.uniform(*CABLE_KG))
            cable = EffectTruth(
                name="added_mass",
                parameters={"mass_kg": mass_kg, "relative_position": place_m / beam.length_m},
                place={"body": beam.name, "position_m": place_m},
                strength=mass_kg / EFFECTS["added_mass"].size.default,
                uncounted=True,
            )
            machine = EFFECTS["added_mass"].change(machine, cable)
            cables.append(cable)
    return machine, tuple(cables)


def built(machine: Machine, rng: np.random.Generator) -> Machine:
    """A machine of the world "bench" as it is built.

    Moduli, springs and masses +-0.2 %, every mode's frequency by +-0.1 % more and its damping by its own factor 0.8 to
    1.25, stations of beams +-1 mm, gains and the force's +-0.2 %, clearances and stiffnesses +-0.7 % (not their zero,
    which displacement sensors know), noise of sensors by 0.8 to 1.25, accelerometers' high-passes at 0.05 to 0.15 Hz.
    """

    def share(most: float) -> float:
        return 1 + float(rng.uniform(-most, most))

    def factors(count: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return tuple((1 + rng.uniform(-1e-3, 1e-3, count)).tolist()), tuple(
            (0.8 * 1.5625 ** rng.uniform(size=count)).tolist()
        )

    def beam(b: TrueBeam) -> TrueBeam:
        frequency, damping = factors(MODES)
        stiffer = share(2e-3)
        return replace(
            b, youngs_modulus_pa=b.youngs_modulus_pa * stiffer, frequency_factors=frequency, damping_factors=damping
        )

    def row(b: Lumped) -> Lumped:
        frequency, damping = factors(len(b.masses_kg))
        heavier, stiffer = share(2e-3), share(2e-3)  # of all alike, so that the shapes are those of rig.json
        return replace(
            b,
            masses_kg=tuple(m * heavier for m in b.masses_kg),
            grounded_n_per_m=tuple(k * stiffer for k in b.grounded_n_per_m),
            between_n_per_m=tuple(k * stiffer for k in b.between_n_per_m),
            frequency_factors=frequency,
            damping_factors=damping,
        )

    def sensor(s: MotionSensor) -> MotionSensor:
        body = machine.body(s.at.body)
        moved_m = float(rng.uniform(-1e-3, 1e-3)) if isinstance(body, TrueBeam) else 0.0
        at = Place(body.name, float(np.clip(s.at.position_m + moved_m, 0.0, body.length_m)))
        low, high = HIGHPASS_BENCH_HZ
        corner_hz = float(low * (high / low) ** rng.uniform()) if s.quantity == "acceleration" else 0.0
        noise = s.noise_density * float(rng.uniform(0.8, 1.25))
        return replace(s, at=at, gain=share(2e-3), highpass_hz=corner_hz, noise_density=noise)

    def contact(c: Link) -> Link:
        return replace(c, law=_near(c.law, share(7e-3), share(7e-3), 0.0))

    return replace(
        machine,
        beams=tuple(beam(b) for b in machine.beams),
        lumped=tuple(row(b) for b in machine.lumped),
        sensors=tuple(sensor(s) for s in machine.sensors),
        contacts=tuple(contact(c) for c in machine.contacts),
        cell=replace(machine.cell, gain=share(2e-3)),
    )
