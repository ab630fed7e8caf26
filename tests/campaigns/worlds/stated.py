"""The world "stated": machines of the world "bench" that are off by just what the tolerances state, and so test
p-values: those of machines that are closer to the belief lie near 1.

Every value is off by its standard deviation in `Tolerances` times a normal draw; the common and each mode's frequency
and damping have draws of their own.
"""

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from tests.campaigns.worlds.machine import Link, Lumped, Machine, MotionSensor, Place, TrueBeam


@dataclass(frozen=True)
class Stated:
    """Standard deviations, by the names that `rig.model.tolerances` has; a test holds them against its defaults."""

    gain: float = 2e-3
    position_m: float = 1e-3
    delay_s: float = 1e-5
    high_pass_hz: float = 0.1
    crosstalk: float = 2e-3
    lateral_motion: float = 1e-3
    force_gain: float = 3e-3
    mass: float = 3e-3
    frequency: float = 2e-3
    damping: float = 0.3
    clearance: float = 0.01
    stiffness: float = 0.01
    contact_damping_s: float = 1e-5


STATED = Stated()


def built_as_stated(machine: Machine, rng: np.random.Generator) -> Machine:
    """A machine of the bench whose deviations are those that `STATED` states."""
    return replace(
        machine,
        beams=tuple(_beam(beam, rng) for beam in machine.beams),
        lumped=tuple(_lumped(row, rng) for row in machine.lumped),
        sensors=tuple(_sensor(sensor, machine, rng) for sensor in machine.sensors),
        contacts=tuple(_contact(contact, rng) for contact in machine.contacts),
        cell=replace(machine.cell, gain=_factor(STATED.force_gain, rng)),
    )


def _factor(deviation: float, rng: np.random.Generator) -> float:
    return 1 + deviation * float(rng.standard_normal())


def _modes(count: int, rng: np.random.Generator) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Factors of every mode's frequency and damping ratio."""
    frequencies = 1 + STATED.frequency * rng.standard_normal(count)
    damping = np.exp(STATED.damping * (rng.standard_normal() + rng.standard_normal(count)))
    return tuple(frequencies.tolist()), tuple(damping.tolist())


def _beam(beam: TrueBeam, rng: np.random.Generator) -> TrueBeam:
    heavier, faster = _factor(STATED.mass, rng), _factor(STATED.frequency, rng)
    frequencies, damping = _modes(len(beam.frequency_factors), rng)
    return replace(
        beam,
        density_kg_per_m3=beam.density_kg_per_m3 * heavier,
        youngs_modulus_pa=beam.youngs_modulus_pa * heavier * faster**2,
        frequency_factors=frequencies,
        damping_factors=damping,
    )


def _lumped(row: Lumped, rng: np.random.Generator) -> Lumped:
    heavier, faster = _factor(STATED.mass, rng), _factor(STATED.frequency, rng)
    frequencies, damping = _modes(len(row.masses_kg), rng)
    stiffer = heavier * faster**2  # of all alike, so that the shapes are those of rig.json
    return replace(
        row,
        masses_kg=tuple(mass * heavier for mass in row.masses_kg),
        grounded_n_per_m=tuple(spring * stiffer for spring in row.grounded_n_per_m),
        between_n_per_m=tuple(spring * stiffer for spring in row.between_n_per_m),
        frequency_factors=frequencies,
        damping_factors=damping,
    )


def _sensor(sensor: MotionSensor, machine: Machine, rng: np.random.Generator) -> MotionSensor:
    body = machine.body(sensor.at.body)
    moved_m = STATED.position_m * float(rng.standard_normal()) if isinstance(body, TrueBeam) else 0.0
    corner_hz = abs(STATED.high_pass_hz * float(rng.standard_normal()))
    lateral_share = STATED.lateral_motion * float(rng.standard_normal())
    before, after = (STATED.crosstalk * rng.standard_normal(2)).tolist()
    return replace(
        sensor,
        at=Place(body.name, float(np.clip(sensor.at.position_m + moved_m, 0.0, body.length_m))),
        gain=_factor(STATED.gain, rng),
        delay_s=STATED.delay_s * float(rng.standard_normal()),
        highpass_hz=corner_hz if sensor.quantity == "acceleration" else 0.0,
        crosstalk=(before, after),
        lateral_share=lateral_share if sensor.quantity == "acceleration" else 0.0,
    )


def _contact(contact: Link, rng: np.random.Generator) -> Link:
    law = contact.law
    wider, stiffer = _factor(STATED.clearance, rng), _factor(STATED.stiffness, rng)
    stiffness_n_per_m = max(law.stiffness_below_n_per_m, law.stiffness_above_n_per_m)
    damping_n_s_per_m = STATED.contact_damping_s * stiffness_n_per_m * abs(float(rng.standard_normal()))
    changed = replace(
        law,
        lower_m=law.lower_m * wider,
        upper_m=law.upper_m * wider,
        stiffness_below_n_per_m=law.stiffness_below_n_per_m * stiffer,
        stiffness_above_n_per_m=law.stiffness_above_n_per_m * stiffer,
        damping_n_s_per_m=law.damping_n_s_per_m + damping_n_s_per_m,
    )
    return replace(contact, law=changed)
