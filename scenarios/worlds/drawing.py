"""Draws a case: everything is a function of the world, the seed and the case's number alone."""

from collections.abc import Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from rig.model.description import Rig
from scenarios.worlds.believed import believed_rig, nominal_machine
from scenarios.worlds.kinds import Kind
from scenarios.worlds.laws import StopLaw
from scenarios.worlds.library import EFFECTS, UNSEEN
from scenarios.worlds.machine import MODES, Accelerometer, Link, Machine, Place, TrueBeam, with_hung
from scenarios.worlds.outside import OUTSIDE
from scenarios.worlds.truth import WORLDS, CaseKind, EffectTruth, Expected, World

DECK: tuple[CaseKind, ...] = ("null",) * 2 + ("single",) * 3 + ("pair",) * 2 + ("outside",) * 2
"""Every nine cases in a row have these kinds, shuffled."""
DRAWABLE = tuple(name for name in EFFECTS if name not in UNSEEN)
PAIRS_FROM = 0.35
"""Effects of pairs leave out so much of the lower end of the logarithmic range."""
HUNG = 1 / 3
"""The share of the cases with a small mass or a cable as a tolerance."""
FORCE_NOISE = 5e-4
"""N/sqrt(Hz)"""
HIGHPASS_HZ = (0.05, 0.3)
"""The corners of the accelerometers' amplifiers, log-uniform."""


class Drawn(msgspec.Struct, frozen=True, kw_only=True):
    """The numbers of one case: what is believed and true, and each record's level, seed and begin of the force."""

    kind: CaseKind
    rig: Rig
    nominal: Machine
    drawn: Machine
    true: Machine
    effects: tuple[EffectTruth, ...]
    expected: Expected | None
    hung: bool
    rms_n: tuple[float, float]
    seeds: tuple[int, int]
    quiet_s: float


def drawn_case(world: World, seed: int, number: int, draw: int = 0, nulls_only: bool = False) -> Drawn:
    """A case of a world; another `draw` gives other numbers of the same kind."""
    of_rig, of_tolerances, of_effects, of_records = _rng(world, seed, number, draw).spawn(4)
    kind, names = ("null", ()) if nulls_only else kind_and_names(world, seed, number)
    rig = believed_rig(world, of_rig)
    nominal = nominal_machine(rig)
    drawn = perturbed(nominal, world, of_tolerances)
    rms_n, quiet_s = _levels(world, of_records)
    table = OUTSIDE if kind == "outside" else EFFECTS
    kinds = [table[name] for name in names]
    least = PAIRS_FROM if kind == "pair" else 0.0
    effects = tuple(k.drawn(nominal, rms_n[0], of_effects, least) for k in kinds)
    first, second = (int(s) for s in of_records.integers(1, 2**31, 2))
    return Drawn(
        kind=kind,
        rig=rig,
        nominal=nominal,
        drawn=drawn,
        true=with_effects(drawn, effects, kinds),
        effects=effects,
        expected=_expected(effects, kinds),
        hung=bool(drawn.masses),
        rms_n=rms_n,
        seeds=(first, second),
        quiet_s=quiet_s,
    )


def with_effects(machine: Machine, effects: Sequence[EffectTruth], kinds: Sequence[Kind]) -> Machine:
    """The machine with every effect, one after another."""
    for truth, kind in zip(effects, kinds, strict=True):
        machine = kind.change(machine, truth)
    return machine


def kind_and_names(world: World, seed: int, number: int) -> tuple[CaseKind, tuple[str, ...]]:
    """The kind of a case and the names of its effects, every name about as often."""
    deck, place = divmod(number, len(DECK))
    order = _rng(world, seed, deck, 1001).permutation(len(DECK))
    kinds = [DECK[k] for k in order]
    kind = kinds[place]
    before = deck * DECK.count(kind) + kinds[:place].count(kind)
    if kind == "single":
        return kind, (_dealt(DRAWABLE, before, world, seed, 1002),)
    if kind == "outside":
        return kind, (_dealt(tuple(OUTSIDE), before, world, seed, 1003),)
    if kind == "pair":
        return kind, _pair(before, world, seed)
    return kind, ()


def _dealt(names: tuple[str, ...], number: int, world: World, seed: int, stream: int) -> str:
    """The name of that number where all names are dealt round after round, each in random order."""
    turn, place = divmod(number, len(names))
    return names[_rng(world, seed, turn, stream).permutation(len(names))[place]]


def _pair(number: int, world: World, seed: int) -> tuple[str, str]:
    """Two names that differ."""
    first = _dealt(DRAWABLE, number, world, seed, 1004)
    rng = _rng(world, seed, number, 1005)
    return first, str(rng.choice([n for n in DRAWABLE if n != first]))


def perturbed(machine: Machine, world: World, rng: np.random.Generator) -> Machine:
    """The machine as a laboratory builds it.

    own: E +-0.3 %, one damping factor a beam +-20 %, stations +-1 mm, gains +-0.2 %. wide and other: every mode's
    damping by its own factor 0.75 to 1.3 and frequency +-0.3 %, the force's gain +-0.3 % and noise about 5e-4
    N/sqrt(Hz), every sensor's high-pass at 0.05 to 0.3 Hz, cross-axis share up to 0.5 % and noise, each contact's rest
    position within 5 % of its clearance, clearance and stiffness within 1 %, and in a third a small mass or a cable.
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


def _sensor(sensor: Accelerometer, length_m: float, wide: bool, rng: np.random.Generator) -> Accelerometer:
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


def _levels(world: World, rng: np.random.Generator) -> tuple[tuple[float, float], float]:
    """The levels of both records, N rms, and when the force begins."""
    louder = float(rng.uniform(1.3, 1.7))
    if world == "other":
        fit_n = float(8 * (40 / louder / 8) ** rng.uniform())
        return (fit_n, fit_n * louder), float(rng.integers(2))
    fit_n = float(rng.uniform(12, 18))
    return (fit_n, fit_n * louder), 1.0


def _expected(effects: Sequence[EffectTruth], kinds: Sequence[Kind]) -> Expected | None:
    told = [kind.expected(truth) for truth, kind in zip(effects, kinds, strict=True) if kind.expected]
    return told[0] if told else None


def _rng(world: World, *numbers: int) -> np.random.Generator:
    return np.random.default_rng([WORLDS.index(world), *numbers])
