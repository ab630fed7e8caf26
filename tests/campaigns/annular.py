"""Rigs in space drawn at random, simulated by `tests.campaigns.space_simulator` as a laboratory builds them, identified
by accelerometers alone: errors of radial clearance, stiffness, damping and friction, and coverage of their intervals.

python -m tests.campaigns.annular --rigs 20 --seed 1 --out out/annular

With `--ancf-every 5` Exudyn simulates every fifth, built as `scenarios.jitter` says.
"""

import csv
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from msgspec.structs import replace as msgspec_replace

import identify
from identify.contacts.results import ContactEstimate
from rig.commands.command_line import run
from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws.annular import Annular
from rig.model.description import Contact, Direction, Rig, Station
from rig.model.sensing import named_sensor
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import channel_groups, truth_path, writing
from rig.simulation.excitation import excitation_of
from rig.simulation.plants import plant_named
from rig.simulation.record import record
from scenarios.jitter import jittered
from tests.campaigns.space_simulator import (
    BAND_HZ,
    GRAVITY_M_PER_S2,
    Accelerometer,
    Ring,
    SpaceMachine,
    SpaceRecord,
    Tube,
    simulated,
)
from tests.campaigns.worlds.machine import MODES
from tests.campaigns.worlds.tolerances import ONSETS_M

app = typer.Typer(pretty_exceptions_enable=False)
RATE_HZ = 4096.0
OPEN_SHARE = (0.15, 0.75)
"""Shares of the time in which each ring is open, between which the level of the forces is sought."""
LEVEL_S, LEVELS = 6.0, 8
EXUDYN_STEP_S = 2.0**-15
DIRECTIONS: tuple[Direction, ...] = ("y", "z")
QUANTITIES = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m", "friction_coefficient")


def drawn_machine(rng: np.random.Generator) -> SpaceMachine:
    """Tubes of 0.8 to 1.3 m; clearances 0.5 to 3 mm, 1e5 to 2e6 N/m, friction 0 to 0.3 in two rings; weight or none."""
    length_m, outer_m = float(rng.uniform(0.8, 1.3)), float(rng.uniform(0.04, 0.07))
    start_m = length_m * float(rng.uniform(0.38, 0.52))
    barrel = Tube("barrel", False, length_m, outer_m, outer_m - 2 * float(rng.uniform(0.006, 0.012)))
    hole_m = outer_m + 0.006
    cradle = Tube("cradle", True, length_m, hole_m + 2 * float(rng.uniform(0.006, 0.012)), hole_m)
    rings = []
    for k, (barrel_m, cradle_m) in enumerate(((0.0, start_m), (length_m - start_m, length_m)), 1):
        stiffness = float(1e5 * 20 ** rng.uniform())
        rings.append(
            Ring(
                name=f"contact_{k}",
                barrel_m=barrel_m,
                cradle_m=cradle_m,
                clearance_m=float(rng.uniform(0.5e-3, 3e-3)),
                stiffness_n_per_m=stiffness,
                damping_n_s_per_m=stiffness * float(rng.uniform(1e-4, 6e-4)),
                friction=float(rng.uniform(0.0, 0.3)),
                sliding_speed_m_per_s=float(0.005 * 4 ** rng.uniform()),
            )
        )
    places = [("cradle", x) for x in (0.25 * length_m, start_m, 0.75 * length_m, length_m)]
    places += [("barrel", x) for x in (0.0, 0.25 * length_m, length_m - start_m, length_m)]
    sensors = tuple(Accelerometer(body, position_m) for body, position_m in places)
    gravity = bool(rng.uniform() < 0.5)
    return SpaceMachine(barrel, cradle, tuple(rings), sensors, force_m=length_m, gravity=gravity)


def as_built(machine: SpaceMachine, rng: np.random.Generator, crossing: float = 0.0) -> SpaceMachine:
    """The machine as a laboratory builds it: frequencies +-0.15 %, of each mode +-0.2 % more, density +-0.3 %, damping
    of each mode by a factor of 0.75 to 1.3, stations +-1 mm, gains +-0.2 %, forces' gains +-0.3 %, delays +-10 us,
    high-pass 0.05 to 0.15 Hz, noise by a factor of 0.8 to 1.25, the other axis up to `crossing`; dampers of the rings
    set in over 0.1 um (at once) to 40 um, log-uniform."""

    def share(most: float) -> float:
        return 1 + float(rng.uniform(-most, most))

    def tube(nominal: Tube) -> Tube:
        stiffer = share(1.5e-3)  # of all frequencies
        return replace(
            nominal,
            density_kg_per_m3=nominal.density_kg_per_m3 * (heavier := share(3e-3)),
            frequency_factors=stiffer * np.sqrt(heavier) * (1 + rng.uniform(-2e-3, 2e-3, (2, MODES))),
            damping_factors=rng.uniform(0.75, 1.3, (2, MODES)),
        )

    def pair(low: float, high: float) -> tuple[float, float]:
        first, second = rng.uniform(low, high, 2)
        return float(first), float(second)

    def ring(nominal: Ring) -> Ring:
        return replace(nominal, onset_m=float(np.exp(rng.uniform(*np.log(ONSETS_M)))))

    def sensor(nominal: Accelerometer) -> Accelerometer:
        length_m = (machine.barrel if nominal.body == "barrel" else machine.cradle).length_m
        return replace(
            nominal,
            position_m=float(np.clip(nominal.position_m + rng.uniform(-1e-3, 1e-3), 0.0, length_m)),
            gain=pair(1 - 2e-3, 1 + 2e-3),
            delay_s=pair(-1e-5, 1e-5),
            highpass_hz=pair(0.05, 0.15),
            crossing=pair(-crossing, crossing),
            noise_density=nominal.noise_density * float(rng.uniform(0.8, 1.25)),
        )

    return replace(
        machine,
        barrel=tube(machine.barrel),
        cradle=tube(machine.cradle),
        sensors=tuple(map(sensor, machine.sensors)),
        force_gain=pair(1 - 3e-3, 1 + 3e-3),
        rings=tuple(map(ring, machine.rings)),
    )


def believed_rig(machine: SpaceMachine) -> Rig:
    """The machine as rig.json describes it, with laws that are 10 % off."""
    beams = tuple(
        Beam(
            name=tube.name,
            ends="clamped-free" if tube.clamped else "free-free",
            length_m=tube.length_m,
            outer_diameter_m=tube.outer_m,
            inner_diameter_m=tube.inner_m,
            damping_ratio=tube.damping_ratio,
        )
        for tube in (machine.cradle, machine.barrel)
    )
    contacts = tuple(
        Contact(
            name=ring.name,
            at=Station("barrel", ring.barrel_m),
            against=Station("cradle", ring.cradle_m),
            law=Annular(
                clearance_m=1.1 * ring.clearance_m,
                stiffness_n_per_m=0.9 * ring.stiffness_n_per_m,
                friction_coefficient=0.1,
            ),
        )
        for ring in machine.rings
    )
    sensors = tuple(
        named_sensor(Station(s.body, s.position_m, direction), "acceleration", s.noise_density)
        for direction in DIRECTIONS
        for s in machine.sensors
    )
    return Rig(
        name="annular",
        bodies=beams,
        contacts=contacts,
        force_at=tuple(Station("barrel", machine.force_m, direction) for direction in DIRECTIONS),
        sensors=sensors,
        sample_rate_hz=RATE_HZ,
        gravity_m_per_s2=GRAVITY_M_PER_S2 if machine.gravity else 0.0,
    )


def level_n(machine: SpaceMachine, seed: int) -> float:
    """Root mean square of the forces for which every ring is open for a share of the time within `OPEN_SHARE`; the best
    of the levels that are tried."""
    level, best, least = 60.0, 60.0, np.inf
    for _ in range(LEVELS):
        share = simulated(machine, level, round(LEVEL_S * RATE_HZ), RATE_HZ, seed).open_share
        outside = float(np.sum(np.maximum(OPEN_SHARE[0] - share, 0) + np.maximum(share - OPEN_SHARE[1], 0)))
        if outside < least:
            best, least = level, outside
        if not outside:
            break
        level *= 1.6 if share.min() < OPEN_SHARE[0] else 0.6
    return best


def record_with_exudyn(path: Path, machine: SpaceMachine, rms_n: float, seconds: float, seed: int) -> None:
    """Recording by the plant `ancf` of the machine's jittered rig, whose laws are the true ones."""
    rig = believed_rig(machine)
    true_laws = (
        Annular(
            clearance_m=ring.clearance_m,
            stiffness_n_per_m=ring.stiffness_n_per_m,
            damping_n_s_per_m=ring.damping_n_s_per_m,
            friction_coefficient=ring.friction,
            sliding_speed_m_per_s=ring.sliding_speed_m_per_s,
        )
        for ring in machine.rings
    )
    contacts = tuple(msgspec_replace(c, law=law) for c, law in zip(rig.contacts, true_laws, strict=True))
    record(
        rig,
        excitation_of("gaussian", rms_n=rms_n, seed=seed, low_hz=BAND_HZ[0], high_hz=BAND_HZ[1]),
        plant=plant_named("ancf"),
        duration_s=seconds,
        step_s=EXUDYN_STEP_S,
        path=path,
        progress=lambda _: None,
        actual=jittered(msgspec_replace(rig, contacts=contacts), np.random.default_rng(seed)),
    )
    truth_path(path).unlink()


def write(path: Path, rig: Rig, space_record: SpaceRecord) -> None:
    """Recording of a rig in space."""
    rows = {"force": space_record.forces_n, "acceleration": space_record.accelerations.reshape(len(rig.sensors), -1)}
    with writing(path, rig, channel_groups(rig), {"made_by": "tests.campaigns.annular"}) as recording:
        recording.append_all(rows)


def errors_of(estimate: ContactEstimate, ring: Ring) -> dict[str, float]:
    """Error and half the 95 % interval of every quantity, in percent of the true one; of friction times 100."""
    true = (ring.clearance_m, ring.stiffness_n_per_m, ring.damping_n_s_per_m, 1.0)
    row = {}
    for name, size in zip(QUANTITIES, true, strict=True):
        value = getattr(estimate, name)
        offset = ring.friction if name == "friction_coefficient" else size
        row[f"{name}_error_percent"] = 100 * (value.value - offset) / size
        row[f"{name}_half_percent"] = 196 * value.standard_error / size
    return row


def score(rows: list[dict[str, float | str]]) -> None:
    """Print medians and 95th percentiles of errors and half intervals, and coverage."""
    told = [r for r in rows if not r["reason"]]
    print(f"{len(told)} of {len(rows)} contacts identified, median CPU {np.median([r['cpu_s'] for r in rows]):.1f} s")
    for r in rows:
        if r["reason"]:
            print(f"  rig {r['rig']} {r['contact']}: {r['reason']}")
    for name in QUANTITIES if told else ():
        error, half = (np.array([float(r[f"{name}_{what}_percent"]) for r in told]) for what in ("error", "half"))
        print(
            f"{name:22s} error: median {np.median(np.abs(error)):.3f}, 95 % {np.quantile(np.abs(error), 0.95):.3f}; "
            f"half interval: median {np.median(half):.3f}; inside {np.sum(np.abs(error) <= half)} of {len(told)}"
        )


def one_rig(
    number: int, seed: int, out: Path, *, exact: bool, seconds: float, crossing: float, with_exudyn: bool
) -> list[dict[str, float | str]]:
    """Rows of one rig's contacts. Of a rig on Exudyn, shares of the time and rest are those of `simulated`, too."""
    rng, of_building = np.random.default_rng([seed, number]).spawn(2)
    nominal = drawn_machine(rng)
    rms_n, force_seed = level_n(nominal, number), int(rng.integers(2**31))
    built = nominal if exact else as_built(nominal, of_building, crossing)
    space_record = simulated(built, rms_n, round(seconds * RATE_HZ), RATE_HZ, force_seed)
    path = out / f"rig_{number:03d}.mcap"
    if with_exudyn:
        record_with_exudyn(path, nominal, rms_n, seconds, force_seed)
    else:
        write(path, believed_rig(nominal), space_record)
    start_s, reasons, estimates = time.process_time(), {}, {}
    try:
        report = identify.contact(path, tolerances=EXACT if exact else LABORATORY).report
    except RigError as error:
        reasons = {ring.name: str(error) for ring in nominal.rings}
    else:
        estimates = {c.name: c for c in report.contacts}
        reasons = {u.name: u.reason for u in report.unanswered}
        for finding in report.findings:
            print(f"  rig {number}: not to be relied on: {finding.sentence}")
    rows = []
    for ring, open_share, angle_share, rest_m in zip(
        nominal.rings, space_record.open_share, space_record.angle_share, space_record.rest_m, strict=True
    ):
        row: dict[str, float | str] = {
            "rig": number,
            "plant": "ancf" if with_exudyn else "own",
            "contact": ring.name,
            "gravity": float(nominal.gravity),
            "rms_n": rms_n,
            "open_share": float(open_share),
            "angle_share": float(angle_share),
            "clearance_m": ring.clearance_m,
            "stiffness_n_per_m": ring.stiffness_n_per_m,
            "friction": ring.friction,
            "reason": reasons.get(ring.name, ""),
            "cpu_s": time.process_time() - start_s,
        }
        if ring.name in estimates:
            estimate = estimates[ring.name]
            row |= errors_of(estimate, ring)
            for center, rest in zip((estimate.center_y_m, estimate.center_z_m), -rest_m, strict=True):
                row |= {} if center is None else _center(center, float(rest), len(row))
        rows.append(row)
    path.unlink()
    return rows


def _center(center: identify.contacts.results.Estimate, true_m: float, column: int) -> dict[str, float]:
    name = f"center_{column}"
    return {f"{name}_error_um": 1e6 * (center.value - true_m), f"{name}_half_um": 1.96e6 * center.standard_error}


@app.command()
def annular(
    rigs: Annotated[int, typer.Option(help="Number of rigs.")] = 20,
    first: Annotated[int, typer.Option(help="Number of the first rig.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of all draws.")] = 1,
    seconds: Annotated[float, typer.Option(help="Length of each record, s.")] = 60.0,
    exact: Annotated[bool, typer.Option("--exact", help="Build exactly as described, and believe it.")] = False,
    crossing: Annotated[float, typer.Option(help="Largest share of the other axis in each axis.")] = 0.0,
    ancf_every: Annotated[int, typer.Option(help="Every how manyth rig is simulated with Exudyn; 0 for none.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("out/annular"),
) -> None:
    """Errors and coverage of annular contacts of random rigs."""
    out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, float | str]] = []
    for number in range(first, first + rigs):
        with_exudyn = ancf_every > 0 and number % ancf_every == 0
        rows += one_rig(number, seed, out, exact=exact, seconds=seconds, crossing=crossing, with_exudyn=with_exudyn)
        print(*(f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in rows[-2].items()), flush=True)
        print(*(f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in rows[-1].items()), flush=True)
    names = list(dict.fromkeys(name for row in rows for name in row))
    with (out / "annular.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    score(rows)


if __name__ == "__main__":
    run(app, "tests.campaigns.annular")
