"""Cases for a blind check of the diagnosis: what is wrong with each rig is drawn, simulated, sealed and hashed."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from identify.tolerances import jittered
from rig.beam import Beam
from rig.description import Rig
from rig.effect import Effect, Parameter, parameters_of
from rig.effects import effects
from rig.errors import CutOffError, RigError
from rig.record import record
from rig.recording import truth_path
from rig.reference import BarrelCradle
from scenarios.outside import OUTSIDE, Outside, described, outside_drawn, plant, strength_of

SINGLE_STRENGTHS, PAIR_STRENGTHS = (0.25, 2.5), (0.7, 2.5)
SHARE_OF_A_KIND = 0.22
UNSEEN = ("asymmetric_clearance",)
"""Effects that accelerometers on a floating barrel cannot see."""
DRAWS = 20
BELIEVED = BarrelCradle(sensors="acceleration", noise_density=1e-3)


class Planned(msgspec.Struct, frozen=True):
    """One case before its numbers are drawn; the folder is where everything goes."""

    folder: str
    case: str
    seed: tuple[int, int]
    kind: str
    names: tuple[str, ...]
    duration_s: float
    step_s: float
    elements: int


class Case(msgspec.Struct, frozen=True):
    """The answer to one case; `draw` counts from 0 and is above if earlier draws could not be simulated.

    Effects are texts that `rig.effects.effect_named` or, of the kind "outside", `scenarios.outside.outside_named`
    reads. A strength is the distance from neutral in that of the default magnitude; outside the library 0 to 1.
    """

    case: str
    kind: str
    effects: tuple[str, ...]
    strengths: tuple[float, ...]
    jitter_seed: int
    draw: int
    refused: tuple[str, ...]
    sha256: dict[str, str]


class Key(msgspec.Struct, frozen=True):
    """The sealed answers."""

    seed: int
    cases: tuple[Case, ...]


class Drawn(msgspec.Struct, frozen=True):
    """The numbers of one case."""

    effects: tuple[Effect, ...]
    outside: Outside | None
    strengths: tuple[float, ...]
    jitter_seed: int
    force_seeds: tuple[int, int]
    rms_n: tuple[float, float]


def usable_effects() -> tuple[str, ...]:
    return tuple(name for name in effects() if name not in UNSEEN)


def planned(cases: int, seed: int, folder: Path, duration_s: float, step_s: float, elements: int) -> list[Planned]:
    """Nulls, effects outside the library and pairs 22 % each, singles the rest, every effect as often; shuffled."""
    rng = np.random.default_rng(seed)
    each = round(SHARE_OF_A_KIND * cases)
    library = usable_effects()
    kinds: list[tuple[str, tuple[str, ...]]] = [("null", ())] * each
    kinds += [("outside", (name,)) for name in _spread(tuple(OUTSIDE), each, rng)]
    kinds += [("pair", pair) for pair in _pairs(library, each, rng)]
    kinds += [("single", (name,)) for name in _spread(library, cases - len(kinds), rng)]
    order = rng.permutation(len(kinds))
    return [
        Planned(str(folder), f"case_{i:03d}", (seed, i), kind, names, duration_s, step_s, elements)
        for i, (kind, names) in enumerate(kinds[k] for k in order)
    ]


def made(plan: Planned) -> Case:
    """Draws and records one case; a draw that cannot be simulated is drawn again and counted.

    Raises RigError if no draw can be simulated.
    """
    refused: list[str] = []
    for draw in range(DRAWS):
        drawn = drawn_of(plan, draw)
        try:
            hashes = _recorded(plan, drawn)
        except CutOffError as error:  # the disk's fault, not the draw's; this error does not pass between processes
            raise RigError(str(error)) from error
        except RigError as error:
            refused.append(f"{', '.join(_texts(drawn))}: {error}")
            continue
        return Case(
            plan.case, plan.kind, _texts(drawn), drawn.strengths, drawn.jitter_seed, draw, tuple(refused), hashes
        )
    raise RigError(f"{plan.case}: none of {DRAWS} draws could be simulated, the last: {refused[-1]}")


def drawn_of(plan: Planned, draw: int) -> Drawn:
    """The numbers of a case, from its seed and the number of the draw alone."""
    rng = np.random.default_rng([*plan.seed, draw])
    rig = BELIEVED.rig()
    jitter_seed, *force_seeds = (int(s) for s in rng.integers(1, 2**31, 3))
    fit_n = float(rng.uniform(12, 18))
    rms_n = (fit_n, fit_n * float(rng.uniform(1.3, 1.7)))
    outside = outside_drawn(plan.names[0], rig, plan.duration_s, rng) if plan.kind == "outside" else None
    strengths: tuple[float, ...] = ()
    chosen: tuple[Effect, ...] = ()
    if outside:
        strengths = (strength_of(outside),)
    elif plan.names:
        between = PAIR_STRENGTHS if plan.kind == "pair" else SINGLE_STRENGTHS
        both = [effect_drawn(name, rig, between, rng) for name in plan.names]
        chosen, strengths = tuple(e for e, _ in both), tuple(s for _, s in both)
    return Drawn(chosen, outside, strengths, jitter_seed, (force_seeds[0], force_seeds[1]), rms_n)


def reality(drawn: Drawn) -> Rig:
    """The believed rig with the effects and then with the jitter, the same for both records of a case."""
    rig = BELIEVED.rig()
    for effect in drawn.effects:
        rig = effect.applied_to(rig)
    return jittered(rig, np.random.default_rng(drawn.jitter_seed))


def effect_drawn(name: str, rig: Rig, between: tuple[float, float], rng: np.random.Generator) -> tuple[Effect, float]:
    """An effect of random strength, sign and place, and its strength.

    The strength s is log-uniform: neutral + s (default - neutral), on either side where the plausible range allows,
    and cut to that range. Places are uniform, a band's lower end log-uniform from 3 to 60 Hz.
    """
    kind = effects()[name]
    strength = float(between[0] * (between[1] / between[0]) ** rng.uniform())
    given: dict[str, float | str | int] = {}
    for field, parameter in parameters_of(kind).items():
        if field == "relative_position":
            given[field] = float(rng.uniform(0.1, 1.0))
        elif field == "low_hz":
            low_hz = float(3 * 20 ** rng.uniform())
            given.update(low_hz=low_hz, high_hz=float(low_hz * rng.uniform(1.2, 1.6)))
        elif parameter.neutral is None and field != "high_hz":
            given[field] = float(rng.uniform(parameter.low, parameter.high))
        elif field != "high_hz":
            default = getattr(kind(), field)
            given[field], strength = _magnitude(parameter, default, strength, rng)
    for field in kind.__struct_fields__:
        if field == "seed":
            given[field] = int(rng.integers(1, 2**31))
        elif names := _targets(field, name, rig):
            given[field] = str(rng.choice(names))
    return kind(**given), strength


def _magnitude(parameter: Parameter, default: float, strength: float, rng: np.random.Generator) -> tuple[float, float]:
    neutral = parameter.neutral or 0.0
    span = default - neutral
    values = [neutral + sign * strength * span for sign in (1, -1)]
    inside = [v for v in values if parameter.low <= v <= parameter.high]
    value = float(np.clip(rng.choice(inside or values[:1]), parameter.low, parameter.high))
    return value, abs((value - neutral) / span)


def _targets(field: str, effect: str, rig: Rig) -> Sequence[str]:
    if effect == "clamp_compliance" and field == "beam":
        return [b.name for b in rig.bodies if isinstance(b, Beam) and b.ends == "clamped-free"]
    named = {"contact": rig.contacts, "body": rig.bodies, "beam": rig.bodies, "sensor": rig.sensors}
    return [one.name for one in named.get(field, ())]


def _spread(names: tuple[str, ...], count: int, rng: np.random.Generator) -> list[str]:
    """So many names, each as often as the others up to one, in random order."""
    rounds = [rng.permutation(names) for _ in range(-(-count // len(names)))]
    return [str(name) for one in rounds for name in one][:count]


def _pairs(names: tuple[str, ...], count: int, rng: np.random.Generator) -> list[tuple[str, str]]:
    """Pairs of different names, each name about as often."""
    found: list[tuple[str, str]] = []
    while len(found) < count:
        order = [str(name) for name in rng.permutation(names)]
        found += list(zip(order[0::2], order[1::2], strict=False))
    return found[:count]


def _recorded(plan: Planned, drawn: Drawn) -> dict[str, str]:
    """Writes both recordings without their truth; their hashes by name."""
    work = Path(plan.folder, "sealed", "work")
    actual = reality(drawn)
    written = {}
    names = (f"{plan.case}.mcap", f"{plan.case}_validate.mcap")
    for name, seed, rms_n in zip(names, drawn.force_seeds, drawn.rms_n, strict=True):
        path = work / name
        try:
            record(
                BELIEVED.rig(),
                msgspec.structs.replace(BELIEVED, rms_n=rms_n, seed=seed).force(),
                plant=plant(drawn.outside, plan.elements),
                duration_s=plan.duration_s,
                step_s=plan.step_s,
                path=path,
                progress=lambda _: None,
                actual=actual,
            )
        finally:
            truth_path(path).unlink(missing_ok=True)
        written[name] = path
    for name, path in written.items():
        path.replace(Path(plan.folder, "recordings", name))
    return {name: sha256_of(Path(plan.folder, "recordings", name)) for name in names}


def _texts(drawn: Drawn) -> tuple[str, ...]:
    everything: tuple[Effect | Outside, ...] = (*drawn.effects, *([drawn.outside] if drawn.outside else []))
    return tuple(described(effect, effect.name) for effect in everything)


def sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
