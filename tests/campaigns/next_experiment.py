"""Does the proposed next experiment decide between two causes that one record leaves alike?

python -m tests.campaigns.next_experiment --out out/next

Weak, short records of the world `wide`. A pair counts if both causes, fitted to the first record, are likelier than
0.05, the other left out. Then the proposed experiment, and the first one again, are made with the true cause by the
simulator of the blind worlds; the odds of both records decide if the true cause is likelier than 0.95.
"""

from collections.abc import Sequence
from dataclasses import replace as fields
from importlib import import_module
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from jaxtyping import Float
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table

from identify.gaps.decision.comparison import TEMPERATURE
from identify.gaps.decision.experiment import (
    Experiment,
    common_fit_start,
    experiments,
    next_experiments,
    refit_hypothesis,
)
from identify.gaps.decision.verdict import RIVAL_PROBABILITY
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import SAME_EXPERIMENT, NextExperiment
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Hypothesis, Search
from identify.gaps.search.screening import grid_screening, rao_score_screening
from identify.signals.spectra import force_band_hz
from rig.commands.command_line import run
from rig.commands.tasks import Dask, run_tasks
from rig.errors import RigError
from rig.files import write_json
from rig.model.description import Rig
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.replay import modal
from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.forces import Gaussian
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.library import EFFECTS
from tests.campaigns.worlds.machine import Machine, Place
from tests.campaigns.worlds.tolerances import perturbed
from tests.campaigns.worlds.truth import EffectTruth

DURATION_S, QUIET_S, LEVEL_N = 12.0, 1.0, 5.0
"""Of the first record."""
STRENGTHS = (0.5, 0.25, 0.12)
"""Of the true cause, in defaults of the worlds: the strongest that the first record leaves alike."""
DECIDED = 0.95
WANTED = 10
TIP = "barrel_1000mm_acceleration"


class Pair(msgspec.Struct, frozen=True):
    """The true cause and the other one, as the diagnosis names a candidate (none: the believed rig).

    sign is that of the true one's size, position_m where it stands on its body.
    """

    true: str
    other: str
    sign: int = 1
    position_m: float | None = None


PAIRS = (
    Pair("youngs_modulus:cradle", "clamp_compliance:cradle", -1),
    Pair("hertz_stop:contact_1", "contact_stiffness:contact_1"),
    Pair("nonlinear_contact:contact_2", "contact_stiffness:contact_2"),
    Pair("contact_damping:contact_2", "coulomb_friction:contact_2"),
    Pair("coulomb_friction:contact_1", "contact_damping:contact_1"),
    Pair("clearance_wear:contact_1", "contact_clearance:contact_1"),
    Pair("ground_damper:cradle", "structural_damping:cradle", 1, 0.9),
    Pair("hardening_spring:cradle", "linear_spring:cradle", 1, 0.9),
    Pair("force_gain", "common_gain"),
    Pair("one_stop:contact_2:upper", "contact_stiffness:contact_2"),
    Pair("contact_clearance:contact_2", "contact_stiffness:contact_2"),
    Pair("contact_stiffness:contact_1", ""),
    Pair("clamp_compliance:cradle", "youngs_modulus:cradle"),
    Pair(f"sensor_gain:{TIP}", "added_mass:barrel", -1),
)


class ToAsk(msgspec.Struct, frozen=True, kw_only=True):
    """A pair with the true one in some strength; seed is that of the machine and of its records."""

    pair: Pair
    strength: float
    seed: int


class First(msgspec.Struct, frozen=True):
    """The probability of the true one of the two after one record."""

    probability: float


class Second(msgspec.Struct, frozen=True, kw_only=True):
    """The experiments computed, and the probability of the true one after a second record: as the first of them
    proposes, and at the first record's setting."""

    first: float
    proposed: float
    same: float
    computed: tuple[NextExperiment, ...]


app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def main(
    out: Annotated[Path, typer.Option(help="Folder for every result, and the table as next.json.")],
    dask: Dask = None,
) -> None:
    """Ten pairs of causes that one record leaves alike: what a second record decides."""
    asked = _left_alike(out / "tasks", dask)
    told = run_tasks(after_two, asked, Second, out / "tasks", dask)
    write_json({"asked": asked, "told": told}, out / "next.json")
    Console(width=170).print(_table(asked, told))


def _left_alike(folder: Path, dask: str | None) -> list[ToAsk]:
    """The pairs that the first record leaves alike, those with the strongest true ones first."""
    found: dict[int, ToAsk] = {}
    for strength in STRENGTHS:
        left = {k: ToAsk(pair=p, strength=strength, seed=k) for k, p in enumerate(PAIRS) if k not in found}
        firsts = run_tasks(after_one, list(left.values()), First, folder, dask)
        for (k, asked), first in zip(left.items(), firsts, strict=True):
            if RIVAL_PROBABILITY < first.probability < 1 - RIVAL_PROBABILITY:
                found[k] = asked
        if len(found) >= WANTED:
            break
    return list(found.values())[:WANTED]


def after_one(asked: ToAsk) -> First:
    """The first record, and both causes fitted to it."""
    record, _ = _recorded(asked, None)
    true, other = (_fitted(record, name).misfit.minus_two_log for name in (asked.pair.true, asked.pair.other))
    return First(_probability(true, other))


def after_two(asked: ToAsk) -> Second:
    """The experiment that is proposed, made; and the first one made again."""
    record, force_n = _recorded(asked, None)
    true, other = (_fitted(record, name) for name in (asked.pair.true, asked.pair.other))
    computed = next_experiments(record, force_n, (true, other), modal)
    offered = {e.instruction: e for e in experiments(record, force_n)}

    def probability(words: str) -> float:
        again, _ = _recorded(asked, offered[words])
        begun = [_begun(r) for r in (record, again)]
        return _probability(*(_of_both(begun, one) for one in (true, other)))

    return Second(
        first=_probability(true.misfit.minus_two_log, other.misfit.minus_two_log),
        proposed=probability(computed[0].words),
        same=probability(SAME_EXPERIMENT),
        computed=computed,
    )


def _probability(true: float, other: float) -> float:
    """Of the true one of two that were equally likely, from -2 ln p of each."""
    return float(1 / (1 + np.exp(np.clip((true - other) / (2 * TEMPERATURE), -700, 700))))


def _recorded(asked: ToAsk, experiment: Experiment | None) -> tuple[Record, Float[np.ndarray, " samples"]]:
    """What the laboratory records of the true machine: the first record, or one that an experiment asks for."""
    rng = np.random.default_rng([asked.seed, 17])
    rig = believed_rig("wide", rng)
    nominal = nominal_machine(rig)
    truth = _truth(asked)
    machine = EFFECTS[truth.name].change(perturbed(nominal, "wide", rng), truth)
    rate = rig.sample_rate_hz
    if experiment is None:
        made = measured(
            machine, Gaussian(rms_n=LEVEL_N, begins_s=QUIET_S), round(DURATION_S * rate), rate, 100 + asked.seed
        )
        return _record(rig, made.force_n, made.delivered)
    known, (force_n,) = experiment.rig_change(rig), experiment.forces_n
    excitation = Gaussian(
        rms_n=float(np.std(force_n[round(QUIET_S * rate) :])), begins_s=QUIET_S, band_hz=force_band_hz(force_n, rate)
    )
    made = measured(_changed(machine, known), excitation, force_n.size, rate, 200 + asked.seed)
    return _record(known, made.force_n, made.delivered)


def _record(
    rig: Rig, force_n: Float[np.ndarray, " samples"], moved: Float[np.ndarray, "sensors samples"]
) -> tuple[Record, Float[np.ndarray, " samples"]]:
    groups, quantity = channel_groups(rig), rig.sensors[0].quantity
    signals = {"force": Signals(groups["force"], 0.0, force_n[None]), quantity: Signals(groups[quantity], 0.0, moved)}
    return record_of(Recording(rig, signals, {})), force_n


def _truth(asked: ToAsk) -> EffectTruth:
    name, *where = asked.pair.true.split(":")
    kind, size = EFFECTS[name], EFFECTS[name].size
    more = kind.more(np.random.default_rng(0), size.default, LEVEL_N)
    magnitude = asked.strength * size.default
    value = (1 + magnitude) ** asked.pair.sign if size.factor else size.neutral + asked.pair.sign * magnitude
    fields = {"contact": "contact", "sensor": "sensor", "beam": "beam", "clamped": "beam"}
    place: dict[str, str | float] = dict(zip((fields.get(kind.at, "body"), "side"), where, strict=False))
    if asked.pair.position_m is not None:
        place["position_m"] = asked.pair.position_m
    return EffectTruth(name=name, parameters={size.field: value} | more, place=place, strength=asked.strength)


def _changed(machine: Machine, known: Rig) -> Machine:
    """The machine with what an experiment changes of the rig: the force's place, known masses, the sensors' kind."""
    (at,) = known.forces
    machine = replace(machine, force_at=Place(at.body, at.position_m))
    for mass in known.masses:
        hung = ((mass.station.position_m, mass.mass_kg),)
        beams = [replace(b, masses=b.masses + hung * (b.name == mass.station.body)) for b in machine.beams]
        machine = replace(machine, beams=tuple(beams))
    if known.sensors[0].quantity == "displacement":
        noise = known.sensors[0].noise_density
        sensors = tuple(
            replace(s, highpass_hz=0.0, noise_density=noise, quantity="displacement") for s in machine.sensors
        )
        machine = replace(machine, sensors=sensors)
    return machine


def _fitted(record: Record, name: str) -> Hypothesis:
    """A cause fitted from all that the diagnosis's screening offers."""
    begun = _begun(record)
    known = candidates(effect_range_scale(record, record.rig), [s.name for s in record.sensors], record.zero_known)
    parts = [c for c in known if c.name == name]
    nothing = begun[0].nominal_fit().hypothesis
    if not name:
        return _best(begun, nothing)
    if not parts:
        raise RigError(f"no candidate is named {name!r}; there are {', '.join(c.name for c in known)}")
    linearization, at = begun[0].linearization, begun[0].nominal_residual
    offered = [
        s.start_values for s in (*rao_score_screening(linearization, at, parts), *grid_screening(linearization, parts))
    ]
    tried = (_best(begun, fields(nothing, candidates=tuple(parts), values=values)) for values in offered)
    return min(tried, key=lambda one: one.misfit.minus_two_log)


def _begun(record: Record) -> tuple[Search, ...]:
    """Two places to begin a fit: at the believed rig fitted to the record, and with nothing fitted."""
    fitted = common_fit_start(record, record.rig)
    linearization = linearized(record, record.rig)
    return fitted, fields(fitted, linearization=linearization, nominal_residual=residual_of(linearization, record.rig))


def _best(begun: Sequence[Search], one: Hypothesis, held: bool = False) -> Hypothesis:
    return min((refit_hypothesis(b, one, held) for b in begun), key=lambda h: h.misfit.minus_two_log)


def _of_both(begun: Sequence[Sequence[Search]], one: Hypothesis) -> float:
    """-2 ln p of two records under one value of every parameter: the mean of both fits, weighted by their precision."""
    if one.candidates:
        again = _best(begun[1], one)
        first, second = (np.linalg.pinv(h.covariance, hermitian=True) for h in (one, again))
        mean = np.linalg.pinv(first + second, hermitian=True) @ (first @ one.values + second @ again.values)
        low, high = one.parameters.bounds
        one = fields(one, values=np.clip(mean, low, high))
    return sum(_best(b, one, held=True).misfit.minus_two_log for b in begun)


def _table(asked: Sequence[ToAsk], told: Sequence[Second]) -> Table:
    table = Table(title="Probability of the true one of two causes")
    for head in ("true", "other", "strength", "after one record", "proposed", "expected", "after it", "after the same"):
        table.add_column(head)
    for a, t in zip(asked, told, strict=True):
        numbers = (f"{p:.3f}" for p in (t.proposed, t.same))
        best = t.computed[0]
        names = (a.pair.true, a.pair.other or "nothing", f"{a.strength:g}", f"{t.first:.3f}")
        table.add_row(*names, best.words, f"{best.log_odds:.1f}", *numbers)
    decided = (sum(p >= DECIDED for p in column) for column in zip(*((t.proposed, t.same) for t in told), strict=True))
    table.add_row("decided", "", "", "", "", "", *(f"{d} of {len(told)}" for d in decided))
    return table


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("tests.campaigns.next_experiment").app, "tests.campaigns.next_experiment")
