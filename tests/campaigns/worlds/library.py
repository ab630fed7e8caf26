"""Every effect that the diagnosis may name, in the terms of the true machine: sizes, places, and what each does."""

import numpy as np
from msgspec.structs import replace

from tests.campaigns.worlds.kinds import Kind, Size, place_of
from tests.campaigns.worlds.laws import StopLaw
from tests.campaigns.worlds.machine import (
    Machine,
    MachineTone,
    Place,
    Shaking,
    with_beams,
    with_bodies,
    with_laws,
    with_link,
    with_sensors,
)
from tests.campaigns.worlds.truth import EffectTruth

BOTH = (1, -1)
UNSEEN = ("asymmetric_clearance",)
"""Effects that accelerometers on a floating barrel cannot see: they are not drawn."""


def _contact(truth: EffectTruth) -> str:
    return str(truth.place["contact"])


def _force_shift(machine: Machine, truth: EffectTruth) -> Machine:
    late = truth.parameters["shift_s"]  # the true force comes late: the measured one is early
    return replace(machine, cell=replace(machine.cell, delay_s=machine.cell.delay_s - late))


def _force_gain(machine: Machine, truth: EffectTruth) -> Machine:
    return replace(machine, cell=replace(machine.cell, gain=machine.cell.gain * truth.parameters["factor"]))


def _added_mass(machine: Machine, truth: EffectTruth) -> Machine:
    one = (place_of(truth).position_m, truth.parameters["mass_kg"])
    return with_bodies(machine, place_of(truth).body, lambda b: replace(b, masses=(*b.masses, one)))


def _linear_spring(machine: Machine, truth: EffectTruth) -> Machine:
    one = (place_of(truth).position_m, truth.parameters["stiffness_n_per_m"])
    return with_bodies(machine, place_of(truth).body, lambda b: replace(b, springs=(*b.springs, one)))


def _asymmetric_clearance(machine: Machine, truth: EffectTruth) -> Machine:
    shift_m = truth.parameters["shift_m"]
    return with_laws(machine, _contact(truth), lambda law: replace(law, offset_m=law.offset_m + shift_m))


def _base_motion(machine: Machine, truth: EffectTruth) -> Machine:
    return replace(machine, shaking=Shaking(**truth.parameters))


def _clamp_compliance(machine: Machine, truth: EffectTruth) -> Machine:
    share = truth.parameters["compliance"]
    return with_beams(
        machine,
        str(truth.place["beam"]),
        lambda b: replace(b, clamp_n_m_per_rad=b.bending_stiffness_n_m2 / b.length_m / share),
    )


def _clearance_wear(machine: Machine, truth: EffectTruth) -> Machine:
    growth = truth.parameters["growth_per_minute"] / 60
    return with_laws(
        machine, _contact(truth), lambda law: replace(law, wear_m_per_s=growth * (law.lower_m + law.upper_m) / 2)
    )


def _contact_clearance(machine: Machine, truth: EffectTruth) -> Machine:
    factor = truth.parameters["factor"]
    return with_laws(
        machine,
        _contact(truth),
        lambda law: replace(law, lower_m=law.lower_m * factor, upper_m=law.upper_m * factor),
    )


def _contact_damping(machine: Machine, truth: EffectTruth) -> Machine:
    damping = truth.parameters["damping_n_s_per_m"]
    return with_laws(
        machine, _contact(truth), lambda law: replace(law, damping_n_s_per_m=law.damping_n_s_per_m + damping)
    )


def _contact_position(machine: Machine, truth: EffectTruth) -> Machine:
    """A contact at an end of one beam stays there and moves along the other."""
    shift_m = truth.parameters["shift_m"]
    contacts = []
    for contact in machine.contacts:
        against = contact.against
        if against is None:
            contacts.append(contact)
        elif against.position_m in (0.0, machine.beam(against.body).length_m):
            contacts.append(replace(contact, at=Place(contact.at.body, contact.at.position_m - shift_m)))
        else:
            contacts.append(replace(contact, against=Place(against.body, against.position_m + shift_m)))
    return replace(machine, contacts=tuple(contacts))


def _contact_stiffness(machine: Machine, truth: EffectTruth) -> Machine:
    factor = truth.parameters["factor"]
    return with_laws(machine, _contact(truth), lambda law: _stiffened(law, factor, factor))


def _one_stop(machine: Machine, truth: EffectTruth) -> Machine:
    factor = truth.parameters["factor"]
    below, above = (factor, 1.0) if truth.place["side"] == "lower" else (1.0, factor)
    return with_laws(machine, _contact(truth), lambda law: _stiffened(law, below, above))


def _stiffened(law: StopLaw, below: float, above: float) -> StopLaw:
    return replace(
        law,
        stiffness_below_n_per_m=law.stiffness_below_n_per_m * below,
        stiffness_above_n_per_m=law.stiffness_above_n_per_m * above,
    )


def _coulomb_friction(machine: Machine, truth: EffectTruth) -> Machine:
    friction_n = truth.parameters["force_n"]
    return with_laws(machine, _contact(truth), lambda law: replace(law, friction_n=law.friction_n + friction_n))


def _hertz_stop(machine: Machine, truth: EffectTruth) -> Machine:
    """The stiffness k is the secant's at reference_force_n: f = k d (depth / d)^exponent, k d = reference_force_n."""
    exponent, force_n = truth.parameters["exponent"], truth.parameters["reference_force_n"]
    return with_laws(
        machine,
        _contact(truth),
        lambda law: replace(law, exponent=exponent, reference_depth_m=force_n / law.stiffness_above_n_per_m),
    )


def _nonlinear_contact(machine: Machine, truth: EffectTruth) -> Machine:
    cubic = truth.parameters["cubic_n_per_m3"]
    return with_laws(machine, _contact(truth), lambda law: replace(law, cubic_stop_n_per_m3=cubic))


def _hardening_spring(machine: Machine, truth: EffectTruth) -> Machine:
    """Below zero the spring softens."""
    law = StopLaw(cubic_spring_n_per_m3=truth.parameters["cubic_n_per_m3"])
    return with_link(machine, truth.name, place_of(truth), law)


def _ground_damper(machine: Machine, truth: EffectTruth) -> Machine:
    law = StopLaw(dashpot_n_s_per_m=truth.parameters["damping_n_s_per_m"])
    return with_link(machine, truth.name, place_of(truth), law)


def _ground_friction(machine: Machine, truth: EffectTruth) -> Machine:
    return with_link(machine, truth.name, place_of(truth), StopLaw(friction_n=truth.parameters["force_n"]))


def _preload(machine: Machine, truth: EffectTruth) -> Machine:
    return replace(machine, loads=(*machine.loads, (place_of(truth), truth.parameters["force_n"])))


def _tone(machine: Machine, truth: EffectTruth) -> Machine:
    numbers = {field: truth.parameters[field] for field in ("cosine_n", "sine_n", "frequency_hz")}
    return replace(machine, tones=(*machine.tones, MachineTone(at=place_of(truth), **numbers)))


def _sensor_delay(machine: Machine, truth: EffectTruth) -> Machine:
    late_s = truth.parameters["delay_s"]
    return with_sensors(machine, str(truth.place["sensor"]), lambda s: replace(s, delay_s=s.delay_s + late_s))


def _sensor_gain(machine: Machine, truth: EffectTruth) -> Machine:
    factor = truth.parameters["factor"]
    return with_sensors(machine, str(truth.place["sensor"]), lambda s: replace(s, gain=s.gain * factor))


def _common_gain(machine: Machine, truth: EffectTruth) -> Machine:
    factor = truth.parameters["factor"]
    return with_sensors(machine, "all", lambda s: replace(s, gain=s.gain * factor))


def _structural_damping(machine: Machine, truth: EffectTruth) -> Machine:
    factor = truth.parameters["factor"]
    return with_bodies(machine, str(truth.place["body"]), lambda b: replace(b, damping_ratio=b.damping_ratio * factor))


def _youngs_modulus(machine: Machine, truth: EffectTruth) -> Machine:
    factor = truth.parameters["factor"]
    return with_beams(
        machine, str(truth.place["beam"]), lambda b: replace(b, youngs_modulus_pa=b.youngs_modulus_pa * factor)
    )


def _band(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    low_hz = float(3 * 20 ** rng.uniform())
    return {"low_hz": low_hz, "high_hz": low_hz * float(rng.uniform(1.2, 1.6))}


def _oscillation(rng: np.random.Generator, amplitude_n: float, _rms_n: float) -> dict[str, float]:
    phase = rng.uniform(0, 2 * np.pi)
    turned = amplitude_n * np.array([np.cos(phase), np.sin(phase)])
    return {"cosine_n": float(turned[0]), "sine_n": float(turned[1]), "frequency_hz": float(rng.uniform(20, 90))}


def _working_force(_rng: np.random.Generator, _value: float, rms_n: float) -> dict[str, float]:
    """A stop's stiffness is measured at the forces it sees: twice the level of the excitation."""
    return {"reference_force_n": 2 * rms_n}


EFFECTS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("added_mass", Size("mass_kg", 0.02, 0.6, 0.2), "body", _added_mass),
        Kind("asymmetric_clearance", Size("shift_m", 5e-5, 1.5e-3, 5e-4, BOTH), "contact", _asymmetric_clearance),
        Kind("base_motion", Size("acceleration_rms_m_per_s2", 0.05, 1.5, 0.5), "", _base_motion, _band),
        Kind("clamp_compliance", Size("compliance", 3e-3, 0.09, 0.03), "clamped", _clamp_compliance),
        Kind("clearance_wear", Size("growth_per_minute", 0.01, 0.3, 0.1), "contact", _clearance_wear),
        Kind("common_gain", Size("factor", 5e-3, 0.15, 0.05, BOTH, factor=True), "", _common_gain),
        Kind("contact_clearance", Size("factor", 0.01, 0.3, 0.1, BOTH, factor=True), "contact", _contact_clearance),
        Kind("contact_damping", Size("damping_n_s_per_m", 2.0, 200.0, 20.0), "contact", _contact_damping),
        Kind("contact_position", Size("shift_m", 1e-3, 0.03, 0.01, BOTH), "", _contact_position),
        Kind("contact_stiffness", Size("factor", 0.03, 0.9, 0.3, BOTH, factor=True), "contact", _contact_stiffness),
        Kind("coulomb_friction", Size("force_n", 0.2, 12.0, 2.0), "contact", _coulomb_friction),
        Kind("force_gain", Size("factor", 5e-3, 0.3, 0.05, BOTH, factor=True), "", _force_gain),
        Kind("force_shift", Size("shift_s", 5e-5, 1.5e-3, 5e-4, BOTH), "", _force_shift),
        Kind("ground_damper", Size("damping_n_s_per_m", 0.3, 10.0, 3.0), "moving", _ground_damper),
        Kind("ground_friction", Size("force_n", 0.1, 6.0, 1.0), "moving", _ground_friction),
        Kind("hardening_spring", Size("cubic_n_per_m3", 1e5, 3e6, 1e6, BOTH, below=0.1), "moving", _hardening_spring),
        Kind("hertz_stop", Size("exponent", 0.2, 0.8, 0.5, neutral=1.0), "contact", _hertz_stop, _working_force),
        Kind("linear_spring", Size("stiffness_n_per_m", 30.0, 3e3, 500.0), "moving", _linear_spring),
        Kind("nonlinear_contact", Size("cubic_n_per_m3", 3e9, 9e10, 3e10), "contact", _nonlinear_contact),
        Kind(
            "one_stop",
            Size("factor", 0.1, 2.0, 0.5, BOTH, factor=True),
            "contact",
            _one_stop,
            sides=("lower", "upper"),
        ),
        Kind("preload", Size("force_n", 0.2, 6.0, 2.0, BOTH), "body", _preload),
        Kind("sensor_delay", Size("delay_s", 5e-5, 1.5e-3, 5e-4, BOTH), "sensor", _sensor_delay),
        Kind("sensor_gain", Size("factor", 5e-3, 0.15, 0.05, BOTH, factor=True), "sensor", _sensor_gain),
        Kind("structural_damping", Size("factor", 0.2, 6.0, 2.0, BOTH, factor=True), "beams", _structural_damping),
        Kind("tone", Size("amplitude_n", 0.03, 3.0, 0.5), "moving", _tone, _oscillation, told=False),
        Kind("youngs_modulus", Size("factor", 5e-3, 0.15, 0.05, BOTH, factor=True), "beam", _youngs_modulus),
    )
}
"""By name, in alphabetical order; sizes run from a tenth to three times a default, of some beyond."""
