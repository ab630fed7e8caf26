"""Is a planned test as good as `identify plan` says? python -m tests.campaigns.planned_tests.

Each test: a rig of a kind, described by `rig init` with the noise of its sensors, and `identify plan` with a level, a
band and a length. Then a machine that its tolerances and its owner's beliefs leave open is simulated by the simulator
of `fifteen_rigs` and identified. Every `--advised-every`th plan also tries changes; its first advice is followed on the
same machine. Reported and predicted standard errors, errors over predictions and shortened intervals are compared.
"""

import argparse
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.campaigns.fifteen_rigs.bodies import Section, masses_in_a_row, point_mass, uniform_beam
from tests.campaigns.fifteen_rigs.field_rig import ACCELERATION, DISPLACEMENT, TAIL, contact, import_map, sensors
from tests.campaigns.fifteen_rigs.laboratory import Assembly, Grid, Instrument, built, gaussian, recorded
from tests.campaigns.fifteen_rigs.piecewise_linear import linear_rms_m
from tests.campaigns.fifteen_rigs.rigs_pairs import REFERENCE_WORDS, reference_pair, stations
from tests.campaigns.fifteen_rigs.session import COVERED, UserSession, answers, write_record

QUANTITIES = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m")
RANKED = QUANTITIES[:2]
"""Quantities whose intervals an advice shortens."""
DURATIONS_S = (12.0, 20.0, 40.0)
LEVEL_CLEARANCES = (2.0, 6.0)
"""Range of the rms motion, were the contact open, in its clearances."""
NOISE_FACTORS = (0.3, 4.0)
"""Range of the noise densities over those of usual sensors."""
LABORATORY_NOISE = {ACCELERATION: 1e-3, DISPLACEMENT: 1e-7}
PLACE = re.compile(r"([\d.]+) m of (\w+)")


@dataclass(frozen=True)
class PlannedKind:
    """Words of `rig init` without sensors' quantity, the machine that is built, places of its sensors, the force's
    band, Hz, sampling rate, Hz, and the quantities that are measured."""

    words: str
    assembly: Callable[[np.random.Generator], Assembly]
    places: Sequence[tuple[str, float]]
    band_hz: tuple[float, float]
    rate_hz: float
    quantities: tuple[str, ...]


@dataclass(frozen=True)
class TestSettings:
    """Sensors, level of the force (N rms), its place and band (Hz), and length (s) of a test."""

    instruments: tuple[Instrument, ...]
    force_rms_n: float
    force_place: tuple[str, float]
    band_hz: tuple[float, float]
    duration_s: float


def mass(rng: np.random.Generator) -> Assembly:
    stops = contact("contact_1", ("mass", 0.0), rng, 8e-4, 3e4, 8.0)
    return Assembly({"mass": built(point_mass(1.2, 8.0, 0.02), rng)}, [stops], [("mass", 0.0)])


def two_masses(rng: np.random.Generator) -> Assembly:
    bodies = {"first": built(point_mass(1.5, 6.0, 0.01), rng), "second": built(point_mass(2.5, 9.0, 0.01), rng)}
    bumper = contact("contact_1", ("first", 0.0), rng, 5e-4, 2e4, 5.0, ("second", 0.0))
    return Assembly(bodies, [bumper], [("first", 0.0)])


def chain(rng: np.random.Generator) -> Assembly:
    body = built(masses_in_a_row([3.0, 2.0, 1.0], [4e4, 3e4, 2e4], 0.01), rng)
    stop = contact("contact_1", ("chain", 3.0), rng, 3e-4, 1e5, 10.0, ("chain", 2.0))
    return Assembly({"chain": body}, [stop], [("chain", 3.0)])


def cantilever(rng: np.random.Generator) -> Assembly:
    body = built(uniform_beam(0.6, Section(0.03, 0.008), 14, 0.01, True), rng)
    stop = contact("contact_1", ("beam", 0.6), rng, 5e-4, 5e4, 5.0)
    return Assembly({"beam": body}, [stop], [("beam", 0.4)], {"beam": 0.6})


BEAM_PLACES = stations((0.2, 0.45, 0.7, 1.0), (0.0, 0.3, 0.55, 1.0))
DAMPED = "--damping-n-s-per-m"
KINDS = {
    "mass": PlannedKind(
        "rig init mass --mass-kg 1.2 --frequency-hz 8 --damping-ratio 0.02 --clearance-m 8e-4 "
        f"--stiffness-n-per-m 3e4 {DAMPED} 8 --sample-rate-hz 1024",
        mass,
        (("mass", 0.0),),
        (2.0, 50.0),
        1024.0,
        (ACCELERATION, DISPLACEMENT),
    ),
    "two masses": PlannedKind(
        "rig init two_masses --masses-kg 1.5,2.5 --frequencies-hz 6,9 --clearance-m 5e-4 "
        f"--stiffness-n-per-m 2e4 {DAMPED} 5 --sample-rate-hz 1024",
        two_masses,
        (("first", 0.0), ("second", 0.0)),
        (2.0, 40.0),
        1024.0,
        (ACCELERATION, DISPLACEMENT),
    ),
    "chain": PlannedKind(
        "rig init chain --masses-kg 3,2,1 --springs-n-per-m 4e4,3e4,2e4 --contacts 3-2 --clearance-m 3e-4 "
        f"--stiffness-n-per-m 1e5 {DAMPED} 10 --sample-rate-hz 1024",
        chain,
        tuple(("chain", k) for k in (1.0, 2.0, 3.0)),
        (2.0, 60.0),
        1024.0,
        (ACCELERATION, DISPLACEMENT),
    ),
    "cantilever": PlannedKind(
        "rig init cantilever --length-m 0.6 --width-m 0.03 --thickness-m 0.008 --force-m 0.4 --clearance-m 5e-4 "
        f"--stiffness-n-per-m 5e4 {DAMPED} 5 --stations-m 0.2,0.4,0.6 --sample-rate-hz 2048",
        cantilever,
        tuple(("beam", x) for x in (0.2, 0.4, 0.6)),
        (5.0, 300.0),
        2048.0,
        (DISPLACEMENT,),
    ),
    "two beams": PlannedKind(
        f"{REFERENCE_WORDS} {DAMPED} 10 --cradle-stations-m 0.2,0.45,0.7,1 --barrel-stations-m 0,0.3,0.55,1",
        reference_pair,
        BEAM_PLACES,
        (1.0, 100.0),
        2048.0,
        (ACCELERATION,),
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.planned_tests", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/planned_tests"))
    parser.add_argument("--tests", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--advised-every", type=int, default=5, help="how often a plan's first advice is followed")
    parser.add_argument("--workers", type=int, default=1, help="processes of one plan")
    asked = parser.parse_args()
    results = []
    for number in range(asked.tests):
        is_advised = number % asked.advised_every == 0
        folder = asked.out / f"{asked.seed}_{number:03d}"
        results.append(tried(number, asked.seed, folder, is_advised, asked.workers))
        ratios = ", ".join(f"{quantity} {ratio:.2f} {miss:+.2f}" for quantity, ratio, miss in compared(results[-1]))
        said = ratios or results[-1]["told"].get("refused") or str(results[-1]["told"]["unanswered"])
        print(f"{number + 1} of {asked.tests}: {results[-1]['rig']}, {results[-1]['settings']}: {said}", flush=True)
    show(results)


def tried(number: int, seed: int, folder: Path, is_advised: bool, workers: int) -> dict[str, Any]:
    """Kept result, or prediction and outcome of one test."""
    kept = folder / "result.json"
    if kept.exists():
        return dict(json.loads(kept.read_bytes()))
    folder.mkdir(parents=True, exist_ok=True)
    name = list(KINDS)[(number // 5 + number) % len(KINDS)]
    kind, rng = KINDS[name], np.random.default_rng([seed, number])
    settings = drawn_settings(kind, rng)
    machine_seed = int(rng.integers(2**32))
    session = UserSession(folder)
    result: dict[str, Any] = {"rig": name, "settings": f"{settings.force_rms_n:.3g} N, {settings.duration_s:g} s"}
    planned = described_and_planned(session, kind, settings, is_advised, workers)
    result |= {"planned": planned, "told": measured_answers(session, kind, settings, machine_seed)}
    if is_advised and (advice := followed_advice(settings, planned)):
        words, changed, promised = advice
        described_and_planned(session, kind, changed, False, workers)
        told = measured_answers(session, kind, changed, machine_seed)
        result["advice"] = {"words": words, "promised": promised, "told": told}
    failed = [f"{c.words}: {c.said[-200:]}" for c in session.done if c.status]
    result["failed"] = failed
    kept.write_text(json.dumps(result, indent=1), encoding="utf-8")
    return result


def drawn_settings(kind: PlannedKind, rng: np.random.Generator) -> TestSettings:
    """Settings of a test: one quantity of the kind, noise, level and length at random."""
    quantity = str(rng.choice(kind.quantities))
    density = LABORATORY_NOISE[quantity] * np.exp(rng.uniform(*np.log(NOISE_FACTORS)))
    instruments = tuple(replace(s, noise_density=float(density)) for s in sensors(kind.places, quantity))
    assembly = kind.assembly(np.random.default_rng(0))
    machine = assembly.machine()
    moved = min(
        linear_rms_m(machine, k, 0, kind.band_hz) / max(c.lower_m or 0.0, c.upper_m or 0.0)
        for k, c in enumerate(assembly.contacts)
    )
    level_n = float(rng.uniform(*LEVEL_CLEARANCES)) / moved
    return TestSettings(instruments, level_n, assembly.forces[0], kind.band_hz, float(rng.choice(DURATIONS_S)))


def described_and_planned(
    session: UserSession, kind: PlannedKind, settings: TestSettings, is_advised: bool, workers: int
) -> dict[str, Any]:
    """plan.json of the rig as its owner describes it, by the commands."""
    session.run(f"{kind.words} --out lab --force")

    def as_measured(rig: dict[str, Any]) -> None:
        body, position_m = settings.force_place
        rig["force_at"] = {"body": body, "position_m": position_m}
        rig["sensors"] = [
            {
                "name": s.name,
                "station": {"body": s.body, "position_m": s.position_m},
                "quantity": s.quantity,
                "noise_density": s.noise_density,
            }
            for s in settings.instruments
        ]

    session.edit_rig("lab/rig.json", as_measured)
    low_hz, high_hz = settings.band_hz
    ended = session.run(
        f"identify plan lab/rig.json --duration {settings.duration_s:g} --force-rms {settings.force_rms_n:.8g} "
        f"--band {low_hz:g} {high_hz:g} --changes {40 if is_advised else 0} --workers {workers} --out plan --force"
    )
    if ended.status:
        raise RuntimeError(f"{ended.words}: {ended.said}")
    return dict(json.loads((session.folder / "plan" / "plan.json").read_bytes()))


def measured_answers(
    session: UserSession, kind: PlannedKind, settings: TestSettings, machine_seed: int
) -> dict[str, Any]:
    """What `identify contact` says of the machine, simulated, imported and identified."""
    assembly = replace(kind.assembly(np.random.default_rng(machine_seed)), forces=[settings.force_place])
    grid = Grid(kind.rate_hz, settings.duration_s, 16)
    rng = np.random.default_rng([machine_seed, 1])
    force_n = gaussian(settings.force_rms_n, settings.band_hz, grid, rng)
    record = recorded(assembly, settings.instruments, force_n[None], grid, rng)
    write_record(session.folder / "run.csv", record, grid.rate_hz)
    import_map(session)
    session.run(TAIL)
    ended = session.run("identify contact run.mcap --out contact --force")
    if ended.status:
        return {"refused": ended.said[-300:]}
    return answers(session.folder / "contact", list(assembly.contacts))


def followed_advice(settings: TestSettings, planned: dict[str, Any]) -> tuple[str, TestSettings, float] | None:
    """Words, settings and promise of the first advice that a laboratory can follow without a calibration: the factor of
    the widest interval, or, of a contact that is determined with it alone, the widest interval over its value."""
    for change in planned["changes"]:
        helps = not change["lost"] and (change["gained"] or change["widest_factor"] <= 0.9)
        if helps and (changed := changed_settings(settings, change["kind"], change["words"])):
            return change["words"], changed, change["widest_share"] if change["gained"] else change["widest_factor"]
    return None


def changed_settings(settings: TestSettings, kind: str, words: str) -> TestSettings | None:
    """Settings as the words of an advice have them; None where a laboratory would have to calibrate."""
    numbers = [float(text) for text in re.findall(r"[\d.]+(?:e[+-]?\d+)?", words)]
    places = [(body, float(x)) for x, body in PLACE.findall(words)]
    instruments, changes = settings.instruments, dict[str, Any]()
    match kind:
        case "duration":
            changes["duration_s"] = numbers[0]
        case "force":
            changes["force_rms_n"] = float(re.findall(r"\(([\d.]+) times\)", words)[0]) * settings.force_rms_n
        case "band":
            changes["band_hz"] = (numbers[0], numbers[1])
        case "place":
            changes["force_place"] = places[0]
        case "noise":
            changes["instruments"] = tuple(replace(s, noise_density=s.noise_density / 2) for s in instruments)
        case "add sensor":
            quantity = DISPLACEMENT if "displacement" in words else ACCELERATION
            densities = [s.noise_density for s in instruments if s.quantity == quantity == ACCELERATION]
            density = densities[0] if densities else LABORATORY_NOISE[quantity]
            added = [replace(s, noise_density=density) for s in sensors(places, quantity)]
            changes["instruments"] = (*instruments, *added)
    return replace(settings, **changes) if changes else None


def compared(result: dict[str, Any]) -> Iterator[tuple[str, float, float]]:
    """Quantity, reported over predicted standard error, and error over predicted standard error, all of them as shares
    of the value: that of the machine may lie 40 % off the belief that is planned with."""
    for expected in result["planned"]["contacts"]:
        for quantity in QUANTITIES:
            told = result["told"].get("values", {}).get(f"{expected['name']} {quantity}")
            if told:
                value, half, true = told
                predicted_share = expected[quantity]["standard_error"] / expected[quantity]["value"]
                yield quantity, half / COVERED / value / predicted_share, (value / true - 1) / predicted_share


def widest_share(told: dict[str, Any]) -> float:
    """Widest 95 % interval of a clearance or stiffness over its value; 1 where none is told."""
    values = told.get("values", {}).items()
    shares = [half / abs(value) for name, (value, half, _) in values if name.split()[-1] in RANKED]
    return max(shares, default=1.0)


def show(results: list[dict[str, Any]]) -> None:
    """Print how predictions and outcomes agree."""
    headings = "quantity", "values", "reported over predicted: median", "within 1.5", "error over predicted: rms"
    table = Table(*headings, "within reported interval")
    pairs = [item for result in results for item in compared(result)]
    for quantity in (*QUANTITIES, "all"):
        rows = np.array([(ratio, miss) for name, ratio, miss in pairs if quantity in (name, "all")]).reshape(-1, 2)
        if len(rows):
            close = np.abs(np.log(rows[:, 0])) <= np.log(1.5)
            is_covered = np.abs(rows[:, 1]) <= COVERED * rows[:, 0]
            table.add_row(
                quantity,
                str(len(rows)),
                f"{np.median(rows[:, 0]):.2f}",
                f"{np.count_nonzero(close)} of {len(rows)}",
                f"{np.sqrt(np.mean(rows[:, 1] ** 2)):.2f}",
                f"{np.count_nonzero(is_covered)} of {len(rows)}",
            )
    Console(width=120).print(table)
    agreed, contacts = 0, 0
    for result in results:
        expected = {c["name"] for c in result["planned"]["contacts"]}
        named = {name.split()[0] for name in result["told"].get("values", {})}
        every = expected | {u["name"] for u in result["planned"]["undetermined"]}
        agreed += len(every) - len(expected ^ (named & every))
        contacts += len(every)
    print(f"determined or not as predicted: {agreed} of {contacts} contacts")
    for result in results:
        if advice := result.get("advice"):
            if "values" in advice["told"]:
                before = widest_share(result["told"]) if result["planned"]["contacts"] else 1.0
                factor = widest_share(advice["told"]) / before
                print(f"{result['rig']}: {advice['words']}: {advice['promised']:.3g} promised, {factor:.3g} found")
            else:
                print(f"{result['rig']}: {advice['words']}: refused")
    for result in results:
        for failure in result["failed"]:
            print(f"{result['rig']}: {failure}")


if __name__ == "__main__":
    main()
