"""How a machine really differs from rig.json where an effect acts: the effect and the tolerances drawn, together."""

from collections.abc import Callable, Sequence

import numpy as np
from msgspec.structs import replace

from tests.campaigns.worlds.beams import modes_of
from tests.campaigns.worlds.forces import BAND_HZ
from tests.campaigns.worlds.laws import StopLaw
from tests.campaigns.worlds.lumped import lumped_modes
from tests.campaigns.worlds.machine import Link, Lumped, Machine, TrueBeam
from tests.campaigns.worlds.truth import EffectTruth

NEVER_M = 0.5
"""A stop farther away is out of reach."""
REACH = 1.6
"""Modes up to so many times the highest frequency of the force are seen."""

Others = tuple[EffectTruth, ...]
Whole = Callable[[EffectTruth, Machine, Machine, Others], dict[str, float]]
"""Some parameters, from the effect, the believed and the true machine, and the effects beside it."""


def with_wholes(effects: Sequence[EffectTruth], nominal: Machine, true: Machine) -> tuple[EffectTruth, ...]:
    """The effects, each with its whole deviation; what no tolerance touches is as drawn."""
    found = []
    for effect in effects:
        others = tuple(e for e in effects if e is not effect)
        there = WHOLES[effect.name](effect, nominal, true, others) if effect.name in WHOLES else {}
        found.append(replace(effect, whole=effect.parameters | there))
    return tuple(found)


def _among(effects: Others, name: str) -> bool:
    return any(e.name == name for e in effects)


def _geometric(factors: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(factors))))


def _links(effect: EffectTruth, nominal: Machine, true: Machine) -> list[tuple[StopLaw, StopLaw]]:
    """The believed and the true law of every contact that the effect acts at."""
    chosen = [c for c in true.contacts if effect.place["contact"] in ("all", c.name)]
    return [(nominal.contact(c.name).law, c.law) for c in chosen]


def reached_m(law: StopLaw) -> float:
    """Half the play of two stops; of a single one that is in reach, its distance from the believed zero."""
    below, above = law.lower_m - law.offset_m, law.upper_m + law.offset_m
    if below > NEVER_M or above > NEVER_M:
        return min(below, above)
    return (below + above) / 2


def secant_n_per_m(law: StopLaw, above: bool, force_n: float) -> float:
    """Force over depth of one stop where its power law gives this force."""
    stiffness = law.stiffness_above_n_per_m if above else law.stiffness_below_n_per_m
    if law.exponent == 1.0:
        return stiffness
    depth_m = law.reference_depth_m * (force_n / (stiffness * law.reference_depth_m)) ** (1 / law.exponent)
    return force_n / depth_m


def _clearance(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    return {"factor": _geometric([reached_m(law) / reached_m(was) for was, law in _links(effect, nominal, true)])}


def _shift(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    def off_centre_m(law: StopLaw) -> float:
        return law.offset_m + (law.upper_m - law.lower_m) / 2

    shifts_m = [off_centre_m(law) - off_centre_m(was) for was, law in _links(effect, nominal, true)]
    return {"shift_m": float(np.mean(shifts_m))}


def _stiffness(effect: EffectTruth, nominal: Machine, true: Machine, others: Others) -> dict[str, float]:
    """Of both stops, unless another effect says that one differs: then of the other. At the force of a power law's
    reference, if another effect has one."""
    forces_n = [e.parameters["reference_force_n"] for e in others if e.name == "hertz_stop"]
    force_n = forces_n[0] if forces_n else 1.0
    factors = []
    for was, law in _links(effect, nominal, true):
        above, below = (
            secant_n_per_m(law, side, force_n) / secant_n_per_m(was, side, force_n) for side in (True, False)
        )
        ratios = sorted((above, below), key=lambda r: abs(np.log(r / effect.parameters["factor"])))
        factors.append(ratios[0] if _among(others, "one_stop") else _geometric(ratios))
    return {"factor": _geometric(factors)}


def _one_stop(effect: EffectTruth, nominal: Machine, true: Machine, others: Others) -> dict[str, float]:
    """Against what is believed; against the other stop, where another effect speaks of both."""
    factors = []
    for was, law in _links(effect, nominal, true):
        above = law.stiffness_above_n_per_m / was.stiffness_above_n_per_m
        below = law.stiffness_below_n_per_m / was.stiffness_below_n_per_m
        this, that = (above, below) if effect.place["side"] == "upper" else (below, above)
        factors.append(this / that if _among(others, "contact_stiffness") else this)
    return {"factor": _geometric(factors)}


def _of_law(field: str, parameter: str) -> Whole:
    """A number of the law, less what is believed."""

    def more(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
        excess = [getattr(law, field) - getattr(was, field) for was, law in _links(effect, nominal, true)]
        return {parameter: float(np.mean(excess))}

    return more


def _wear(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    """A share of the clearance that is believed."""
    shares = [60 * law.wear_m_per_s / reached_m(was) for was, law in _links(effect, nominal, true)]
    return {"growth_per_minute": float(np.mean(shares))}


def _modulus(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    beam = str(effect.place["beam"])
    return {"factor": true.beam(beam).youngs_modulus_pa / nominal.beam(beam).youngs_modulus_pa}


def _clamp(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    believed, real = (m.beam(str(effect.place["beam"])) for m in (nominal, true))
    assert real.clamp_n_m_per_rad is not None, "the effect gives it a clamp"
    return {"compliance": believed.bending_stiffness_n_m2 / believed.length_m / real.clamp_n_m_per_rad}


def _damping(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    """Of the modes that are seen, in the geometric mean."""
    factors = []
    for body in true.bodies:
        if effect.place["body"] in ("all", body.name):
            ratio = body.damping_ratio / nominal.body(body.name).damping_ratio
            modes = lumped_modes(body) if isinstance(body, Lumped) else modes_of(body)
            seen = (modes.damping_ratio > 0) & (modes.omega_rad_per_s < 2 * np.pi * REACH * BAND_HZ[1])
            factors += [ratio * f for f, is_seen in zip(body.damping_factors, seen, strict=True) if is_seen]
    return {"factor": _geometric(factors)}


def oscillator_of(body: Lumped | TrueBeam) -> tuple[float, float, float] | None:
    """Mass, stiffness (kg, N/m) and damping ratio of a single mass."""
    if not isinstance(body, Lumped) or len(body.masses_kg) > 1:
        return None
    modes = lumped_modes(body)
    mass_kg, omega = float(modes.carried[0] ** 2), float(modes.omega_rad_per_s[0])
    return mass_kg, mass_kg * omega**2, float(modes.damping_ratio[0])


def _of_mass(which: int, parameter: str) -> Whole:
    """Of a single mass: what it has more than is believed. Of other bodies the effect alone."""

    def more(effect: EffectTruth, nominal: Machine, true: Machine, others: Others) -> dict[str, float]:
        name = str(effect.place["body"])
        real, believed = oscillator_of(true.body(name)), oscillator_of(nominal.body(name))
        if real is None or believed is None or _among(others, effect.name):
            return {}
        excess = real[which] - believed[which]
        if parameter == "damping_n_s_per_m":  # the effect is no part of the body, whose ratio differs by a tolerance
            excess *= 2 * float(np.sqrt(real[0] * real[1]))
            excess += _guides(true, name).dashpot_n_s_per_m - _guides(nominal, name).dashpot_n_s_per_m
            excess += effect.parameters[parameter]
        return {parameter: excess}

    return more


def _guides(machine: Machine, body: str) -> StopLaw:
    """What rig.json knows of a body's friction and damping against the ground."""
    known: list[Link] = [link for link in machine.links if link.name == GUIDES and link.at.body == body]
    return known[0].law if known else StopLaw()


def _friction(effect: EffectTruth, nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    real, believed = (_guides(m, str(effect.place["body"])).friction_n for m in (true, nominal))
    return {"force_n": effect.parameters["force_n"] + real - believed}


def _sensor_gain(effect: EffectTruth, _nominal: Machine, true: Machine, others: Others) -> dict[str, float]:
    """Against all sensors together, where another effect speaks of these."""
    gain = true.sensor(str(effect.place["sensor"])).gain
    return {"factor": gain / _geometric([s.gain for s in true.sensors]) if _among(others, "common_gain") else gain}


def _common_gain(_effect: EffectTruth, _nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    """The middling sensor's, which the fault of a single one does not touch."""
    return {"factor": float(np.median([s.gain for s in true.sensors]))}


def _sensor_delay(effect: EffectTruth, _nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    return {"delay_s": true.sensor(str(effect.place["sensor"])).delay_s}


def _force_gain(_effect: EffectTruth, _nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    return {"factor": true.cell.gain}


def _force_shift(_effect: EffectTruth, _nominal: Machine, true: Machine, _others: Others) -> dict[str, float]:
    return {"shift_s": -true.cell.delay_s}


GUIDES = "guides"
"""The link by which a carriage rubs and creeps on its guides."""
WHOLES: dict[str, Whole] = {
    "added_mass": _of_mass(0, "mass_kg"),
    "asymmetric_clearance": _shift,
    "clamp_compliance": _clamp,
    "clearance_wear": _wear,
    "common_gain": _common_gain,
    "contact_clearance": _clearance,
    "contact_damping": _of_law("damping_n_s_per_m", "damping_n_s_per_m"),
    "contact_stiffness": _stiffness,
    "coulomb_friction": _of_law("friction_n", "force_n"),
    "force_gain": _force_gain,
    "force_shift": _force_shift,
    "ground_damper": _of_mass(2, "damping_n_s_per_m"),
    "ground_friction": _friction,
    "linear_spring": _of_mass(1, "stiffness_n_per_m"),
    "nonlinear_contact": _of_law("cubic_stop_n_per_m3", "cubic_n_per_m3"),
    "one_stop": _one_stop,
    "sensor_delay": _sensor_delay,
    "sensor_gain": _sensor_gain,
    "structural_damping": _damping,
    "youngs_modulus": _modulus,
}
"""By effect; loads, tones, base motion, exponents and cubic springs have no tolerance."""
