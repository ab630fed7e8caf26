"""Draws a case: everything is a function of the world, the seed and the case's number alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import msgspec
import numpy as np

from rig.model.description import Rig
from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.bench import BENCHES
from tests.campaigns.worlds.describing import described
from tests.campaigns.worlds.forces import Excitation, Gaussian
from tests.campaigns.worlds.kinds import Kind
from tests.campaigns.worlds.library import EFFECTS, UNSEEN
from tests.campaigns.worlds.machine import Machine
from tests.campaigns.worlds.outside import OUTSIDE
from tests.campaigns.worlds.stated import built_as_stated
from tests.campaigns.worlds.tolerances import built, perturbed, with_cables, with_onsets
from tests.campaigns.worlds.truth import BENCHES_OF, WORLDS, CaseKind, EffectTruth, Expected, World
from tests.campaigns.worlds.whole import with_wholes

DECK: tuple[CaseKind, ...] = ("null",) * 2 + ("single",) * 3 + ("pair",) * 2 + ("outside",) * 2
"""Every nine cases in a row have these kinds, shuffled."""
BENCH_DECK: tuple[CaseKind, ...] = ("null",) * 3 + ("single",) * 4 + ("pair",) * 3 + ("outside",) * 2
DECKS: dict[World, tuple[CaseKind, ...]] = {
    "counted": ("null",) + ("several",) * 3,
    "bench": BENCH_DECK,
    "stated": BENCH_DECK,
}
"""Of the worlds that have others."""
DRAWABLE = tuple(name for name in EFFECTS if name not in UNSEEN)
AT_ONCE = (2, 3, 4)
"""So many effects at once, each about as often."""
REPEATED = (
    "added_mass",
    "contact_clearance",
    "contact_damping",
    "ground_damper",
    "linear_spring",
    "sensor_gain",
    "tone",
)
"""Effects of which a machine may have several, at different places."""
AGAIN = 0.3
"""The probability that a further effect is one more of those."""
APART_M = 0.15
"""Two of one kind on a body are no closer."""
PAIRS_FROM = 0.35
"""Effects that are not alone leave out so much of the lower end of the logarithmic range."""
TRIES = 200


class Drawn(msgspec.Struct, frozen=True, kw_only=True):
    """The numbers of one case: what is believed and true, and each record's excitation and seed."""

    kind: CaseKind
    rig: Rig
    nominal: Machine
    drawn: Machine
    true: Machine
    effects: tuple[EffectTruth, ...]
    expected: Expected | None
    hung: bool
    machine: str
    excitations: tuple[Excitation, Excitation]
    seeds: tuple[int, int]


@dataclass(frozen=True)
class Setting:
    """What is believed of a case, how it is excited, and every effect that it may have."""

    rig: Rig
    nominal: Machine
    excitations: tuple[Excitation, Excitation]
    kinds: Mapping[str, Kind]
    machine: str = ""


def drawn_case(world: World, seed: int, number: int, draw: int = 0, nulls_only: bool = False) -> Drawn:
    """A case of a world; another `draw` gives other numbers of the same kind."""
    of_rig, of_tolerances, of_effects, of_records, of_onsets = _rng(world, seed, number, draw).spawn(5)
    kind, names = ("null", ()) if nulls_only else kind_and_names(world, seed, number)
    on_a_bench = world in BENCHES_OF
    setting = _on_a_bench(seed, number, of_rig, of_records) if on_a_bench else _two_beams(world, of_rig, of_records)
    nominal = setting.nominal
    drawn = _built(nominal, world, of_tolerances)
    if world != "own":
        drawn = with_onsets(drawn, of_onsets)
    kinds = [setting.kinds[name] for name in names]
    effects = _effects(kinds, nominal, setting.excitations[0].level_n, of_effects)
    cables: tuple[EffectTruth, ...] = ()
    if world == "counted":
        drawn, cables = with_cables(drawn, of_tolerances)
    true = with_effects(drawn, effects, kinds)
    first, second = (int(s) for s in of_records.integers(1, 2**31, 2))
    return Drawn(
        kind=kind,
        rig=setting.rig,
        nominal=nominal,
        drawn=drawn,
        true=true,
        effects=with_wholes((*effects, *cables), nominal, true),
        expected=_expected(effects, kinds),
        hung=bool(drawn.masses),
        machine=setting.machine,
        excitations=setting.excitations,
        seeds=(first, second),
    )


def _built(nominal: Machine, world: World, rng: np.random.Generator) -> Machine:
    """The machine as a laboratory of this world builds it."""
    if world == "stated":
        return built_as_stated(nominal, rng)
    return built(nominal, rng) if world == "bench" else perturbed(nominal, world, rng)


def _two_beams(world: World, of_rig: np.random.Generator, of_records: np.random.Generator) -> Setting:
    rig = believed_rig(world, of_rig)
    return Setting(rig, nominal_machine(rig), _levels(world, of_records), EFFECTS | OUTSIDE)


def _on_a_bench(seed: int, number: int, of_rig: np.random.Generator, of_records: np.random.Generator) -> Setting:
    bench = BENCHES[bench_name(seed, number)].drawn(of_rig, of_records)
    rig = described(bench.nominal, bench.name, bench.sample_rate_hz)
    return Setting(rig, bench.nominal, bench.excitations, bench.kinds, bench.name)


def bench_name(seed: int, number: int) -> str:
    """The machine of a case of the world "bench", every one about as often."""
    return _dealt(tuple(BENCHES), number, "bench", seed, 1006)


def _effects(
    kinds: Sequence[Kind], nominal: Machine, level_n: float, rng: np.random.Generator
) -> tuple[EffectTruth, ...]:
    """One of each kind, two of one kind at different places."""
    least = PAIRS_FROM if len(kinds) > 1 else 0.0
    for _ in range(TRIES):
        effects = tuple(kind.drawn(nominal, level_n, rng, least) for kind in kinds)
        if not any(a.name == b.name and _same_place(a, b) for a, b in combinations(effects, 2)):
            break
    return effects


def _same_place(one: EffectTruth, other: EffectTruth) -> bool:
    if "position_m" in one.place and one.place["body"] == other.place["body"]:
        return abs(float(one.place["position_m"]) - float(other.place["position_m"])) < APART_M
    named = [field for field in ("body", "contact", "sensor") if field in one.place]
    return all("all" in (one.place[f], other.place[f]) or one.place[f] == other.place[f] for f in named)


def with_effects(machine: Machine, effects: Sequence[EffectTruth], kinds: Sequence[Kind]) -> Machine:
    """The machine with every effect, one after another."""
    for truth, kind in zip(effects, kinds, strict=True):
        machine = kind.change(machine, truth)
    return machine


def kind_and_names(world: World, seed: int, number: int) -> tuple[CaseKind, tuple[str, ...]]:
    """The kind of a case and the names of its effects, every name about as often."""
    cards = DECKS.get(world, DECK)
    deck, place = divmod(number, len(cards))
    order = _rng(world, seed, deck, 1001).permutation(len(cards))
    kinds = [cards[k] for k in order]
    kind = kinds[place]
    before = deck * cards.count(kind) + kinds[:place].count(kind)
    if kind == "null":
        return kind, ()
    if world in BENCHES_OF:
        return kind, _of_a_bench(kind, seed, number)
    if kind == "single":
        return kind, (_dealt(DRAWABLE, before, world, seed, 1002),)
    if kind == "outside":
        return kind, (_dealt(tuple(OUTSIDE), before, world, seed, 1003),)
    return kind, _several(before, world, seed) if kind == "several" else _pair(before, world, seed)


def _of_a_bench(kind: CaseKind, seed: int, number: int) -> tuple[str, ...]:
    """Names that differ, of the effects that this machine can have."""
    known = BENCHES[bench_name(seed, number)]
    names = known.outside if kind == "outside" else known.effects
    chosen = _rng("bench", seed, number, 1007).choice(len(names), 2 if kind == "pair" else 1, replace=False)
    return tuple(names[k] for k in chosen)


def _several(number: int, world: World, seed: int) -> tuple[str, ...]:
    """Two to four names; some stand there twice."""
    rng = _rng(world, seed, number, 1008)
    names = [_dealt(DRAWABLE, number, world, seed, 1004)]
    for _ in range(AT_ONCE[number % len(AT_ONCE)] - 1):
        again = [n for n in names if n in REPEATED and names.count(n) == 1]
        fresh = [n for n in DRAWABLE if n not in names]
        names.append(str(rng.choice(again if again and rng.uniform() < AGAIN else fresh)))
    return tuple(names)


def _dealt(names: tuple[str, ...], number: int, world: World, seed: int, stream: int) -> str:
    """The name of that number where all names are dealt round after round, each in random order."""
    turn, place = divmod(number, len(names))
    return names[_rng(world, seed, turn, stream).permutation(len(names))[place]]


def _pair(number: int, world: World, seed: int) -> tuple[str, str]:
    """Two names that differ."""
    first = _dealt(DRAWABLE, number, world, seed, 1004)
    rng = _rng(world, seed, number, 1005)
    return first, str(rng.choice([n for n in DRAWABLE if n != first]))


def _levels(world: World, rng: np.random.Generator) -> tuple[Gaussian, Gaussian]:
    """The force of both records: its level and when it begins."""
    louder = float(rng.uniform(1.3, 1.7))
    if world == "other":
        fit_n, begins_s = float(8 * (40 / louder / 8) ** rng.uniform()), float(rng.integers(2))
    else:
        fit_n, begins_s = float(rng.uniform(12, 18)), 1.0
    return Gaussian(rms_n=fit_n, begins_s=begins_s), Gaussian(rms_n=fit_n * louder, begins_s=begins_s)


def _expected(effects: Sequence[EffectTruth], kinds: Sequence[Kind]) -> Expected | None:
    told = [kind.expected(truth) for truth, kind in zip(effects, kinds, strict=True) if kind.expected]
    return told[0] if told else None


def _rng(world: World, *numbers: int) -> np.random.Generator:
    return np.random.default_rng([WORLDS.index(world), *numbers])
