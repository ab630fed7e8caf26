"""Sound recordings: what `identify check` and `identify contact` find wrong with them, which is false.

python -m tests.campaigns.sound --seed 1 --out out/sound

Each is of a machine off by what its tolerances state, by simulators that share no line with the product, or by the
plant `modal`. Records that were checked are kept in sound.jsonl, and not made again.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace as with_values
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from jaxtyping import Float
from rich.console import Console
from rich.progress import track
from rich.table import Table

from identify.checks import Finding, check_recording
from identify.contacts.acceptance import estimated_contacts
from rig import RigError
from rig.commands.command_line import run
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import Contact, Rig, Station
from rig.model.oscillator import Oscillator
from rig.model.sensing import named_sensor
from rig.model.tolerances import LABORATORY
from rig.recording import Recording, channel_groups, read, writing
from tests.campaigns import annular, space_simulator
from tests.campaigns.laboratory_tests import TESTS, recorded
from tests.campaigns.spoilt import MASSES
from tests.campaigns.spoilt import recorded as of_the_plant
from tests.campaigns.worlds.drawing import drawn_case
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.making import write
from tests.campaigns.worlds.truth import World

SECONDS, SPACE_SECONDS = 14.0, 10.0
RATE_HZ, STEPS_A_SAMPLE = 1024.0, 16
TURN_DEGREES = 0.5
"""Standard deviation of the angle about the tube's axis at which a sensor stands; `cross_axis` states 0.57 degrees."""
DECAYS = ("one mass, free decay, displacement", "two beams, free decay, displacements", "one mass, no quiet start")
app = typer.Typer(pretty_exceptions_enable=False)


class Checked(msgspec.Struct, frozen=True, kw_only=True):
    """What was found in one record; refused says why `identify contact` gave no answer, if it gave none."""

    kind: str
    number: int
    bits: int
    findings: tuple[str, ...]
    refused: str = ""


def off_centre(seed: int, number: int, path: Path) -> None:
    """A mass on a spring between stops that is let go off centre and driven from 1 s on, by semi-implicit Euler steps.

    The believed rig is off by the tolerances; noise is as stated.
    """
    rng = np.random.default_rng([seed, number])
    mass_kg, natural_hz, ratio = float(rng.uniform(0.5, 3)), float(rng.uniform(3, 12)), float(rng.uniform(0.005, 0.05))
    clearance_m, stiffness = float(rng.uniform(3e-4, 2e-3)), mass_kg * (2 * np.pi * float(rng.uniform(20, 40))) ** 2
    quantity = ("displacement", "acceleration")[number % 2]
    noise = {"displacement": 1e-8, "acceleration": 1e-3}[quantity]
    rig = Rig(
        name="off_centre",
        bodies=(Oscillator(name="mass", mass_kg=mass_kg, frequency_hz=natural_hz, damping_ratio=ratio),),
        contacts=(
            Contact(name="stop", at=Station("mass"), law=symmetric_dead_zone(1.1 * clearance_m, 0.9 * stiffness, 0.0)),
        ),
        force_at=Station("mass"),
        sensors=(named_sensor(Station("mass"), quantity, noise),),
        sample_rate_hz=RATE_HZ,
    )
    count, step_s = round(SECONDS * RATE_HZ) * STEPS_A_SAMPLE, 1 / (RATE_HZ * STEPS_A_SAMPLE)
    time_s = np.arange(count) * step_s
    lines = np.zeros(count // 2 + 1, complex)
    in_band = slice(round(0.5 * SECONDS), round(2.5 * natural_hz * SECONDS))
    lines[in_band] = rng.standard_normal((2, lines[in_band].size)).T @ np.array([1, 1j])
    force_n = np.fft.irfft(lines, count) * (time_s > 1.0)
    omega = 2 * np.pi * natural_hz
    force_n *= mass_kg * omega**2 * 1.5 * clearance_m * np.sqrt(ratio * 8) / force_n[time_s > 1.0].std()
    moved = _mass_between_stops(force_n / mass_kg, step_s, omega, ratio, clearance_m, stiffness / mass_kg)
    sensed = moved[0 if quantity == "displacement" else 1, ::STEPS_A_SAMPLE]
    sensed = sensed * (1 + LABORATORY.gain * rng.standard_normal())
    sensed = sensed + noise * np.sqrt(RATE_HZ / 2) * rng.standard_normal(sensed.size)
    with writing(path, rig, channel_groups(rig), {"made_by": "tests.campaigns.sound"}) as recording:
        recording.append_all({"force": force_n[None, ::STEPS_A_SAMPLE], quantity: sensed[None]})


def _mass_between_stops(
    drive: Float[np.ndarray, " steps"], step_s: float, omega: float, ratio: float, clearance_m: float, stop: float
) -> Float[np.ndarray, "2 steps"]:
    """Displacement and acceleration from 0.8 clearances off centre, at rest; forces over the mass."""
    moved = np.empty((2, drive.size))
    position, speed = 0.8 * clearance_m, 0.0
    for k, pushed in enumerate(drive.tolist()):
        beyond = position - min(max(position, -clearance_m), clearance_m)
        acceleration = pushed - omega**2 * position - 2 * ratio * omega * speed - stop * beyond
        moved[:, k] = position, acceleration
        speed += step_s * acceleration
        position += step_s * speed
    return moved


def of_a_world(world: World, seed: int, number: int, path: Path) -> None:
    """A machine without an effect of a world of the blind checks."""
    drawn = drawn_case(world, 7000 + seed, number, nulls_only=True)
    samples = round(SECONDS * drawn.rig.sample_rate_hz)
    write(
        path, drawn.rig, measured(drawn.true, drawn.excitations[0], samples, drawn.rig.sample_rate_hz, drawn.seeds[0])
    )


def of_a_tube_in_rings(seed: int, number: int, path: Path) -> None:
    """Two tubes with rings, whose sensors are turned about the axis within their tolerance."""
    rng, of_building, of_turns = np.random.default_rng([seed, number]).spawn(3)
    machine = annular.drawn_machine(rng)
    level_n = annular.level_n(machine, number)
    samples = round(SPACE_SECONDS * annular.RATE_HZ)
    built = annular.as_built(machine, of_building, 0.005)
    record = space_simulator.simulated(built, level_n, samples, annular.RATE_HZ, number)
    angles = np.radians(TURN_DEGREES * of_turns.standard_normal(len(machine.sensors)))[:, None]
    in_y, in_z = record.accelerations
    turned = np.stack([np.cos(angles) * in_y + np.sin(angles) * in_z, np.cos(angles) * in_z - np.sin(angles) * in_y])
    annular.write(path, annular.believed_rig(machine), with_values(record, accelerations=turned))


def of_a_laboratory(seed: int, number: int, path: Path) -> None:
    """Decays, and records that begin in motion under a force, by the plant `modal`."""
    whole = recorded(
        TESTS[DECAYS[number % len(DECAYS)]], path.with_suffix(".whole"), SECONDS, jitter=1000 * seed + number
    )
    path.with_suffix(".whole").unlink()
    rows = {group: signals.values for group, signals in whole.signals.items()}
    with writing(path, whole.rig, channel_groups(whole.rig), {"made_by": "tests.campaigns.sound"}) as recording:
        recording.append_all(rows)


def of_a_topology(seed: int, number: int, path: Path) -> None:
    name = tuple(MASSES)[number % len(MASSES)]
    of_the_plant(name, path.parent, 100 * seed + 7, number, SECONDS, path)


MAKERS: dict[str, tuple[int, Callable[[int, int, Path], None]]] = {
    "off centre, then driven (own steps)": (12, off_centre),
    "benches as stated (independent)": (16, partial(of_a_world, "stated")),
    "two beams, world `wide` (independent)": (8, partial(of_a_world, "wide")),
    "tubes in rings, sensors turned (independent)": (8, of_a_tube_in_rings),
    "masses and a frame (plant modal)": (12, of_a_topology),
    "decays, no quiet start (plant modal)": (6, of_a_laboratory),
}


def through_a_converter(recording: Recording, bits: int, of_range: float) -> Recording:
    """Every channel in steps of a converter of so many bits; its range is a multiple of the channel's largest value."""
    signals = {}
    for group, own in recording.signals.items():
        steps = 2 * of_range * np.maximum(np.abs(own.values).max(axis=1, keepdims=True), 1e-30) / 2**bits
        signals[group] = with_values(own, values=np.round(own.values / steps) * steps)
    return with_values(recording, signals=signals)


def checked(kind: str, number: int, recording: Recording, bits: int) -> Checked:
    """Findings of both commands, each of which is false, but that a record without a quiet start begins in motion."""
    findings, refused = [f"check: {f.cause}: {f.sentence}" for f in _false(kind, check_recording(recording))], ""
    try:
        fitted = _false(kind, estimated_contacts(recording, "auto", LABORATORY).findings)
        findings += [
            f"contact: {f.cause}: {f.sentence}" for f in fitted if f"check: {f.cause}: {f.sentence}" not in findings
        ]
    except RigError as error:
        refused = str(error)
    return Checked(kind=kind, number=number, bits=bits, findings=tuple(findings), refused=refused)


def _false(kind: str, findings: tuple[Finding, ...]) -> list[Finding]:
    return [finding for finding in findings if finding.cause != "not at rest" or not kind.startswith("decays")]


def planned() -> Iterator[tuple[str, int]]:
    for kind, (count, _) in MAKERS.items():
        yield from ((kind, number) for number in range(count))


@app.command()
def sound(
    out: Annotated[Path, typer.Option(help="Folder for sound.jsonl.")] = Path("out/sound"),
    seed: Annotated[int, typer.Option(help="Of machines, records and converters.")] = 1,
) -> None:
    """Checks and identifies sound recordings, half of them through a converter of 10 to 12 bits."""
    out.mkdir(parents=True, exist_ok=True)
    kept = out / f"sound_{seed}.jsonl"
    done = [msgspec.json.decode(line, type=Checked) for line in kept.read_text().splitlines()] if kept.exists() else []
    missing = [key for key in planned() if key not in {(case.kind, case.number) for case in done}]
    console = Console(stderr=True)
    for kind, number in track(missing, console=console):
        path = out / "record.mcap"
        path.unlink(missing_ok=True)
        MAKERS[kind][1](seed, number, path)
        rng = np.random.default_rng([seed, number, 5])
        bits = int(rng.choice([10, 11, 12])) if rng.uniform() < 0.5 else 0
        recording = read(path)
        if bits:
            recording = through_a_converter(recording, bits, float(rng.uniform(1.1, 2.0)))
        case = checked(kind, number, recording, bits)
        done.append(case)
        with kept.open("ab") as file:
            file.write(msgspec.json.encode(case) + b"\n")
        for sentence in case.findings:
            console.print(f"{kind} {number} ({bits} bits): {sentence}", highlight=False, soft_wrap=True)
    Console().print(table(done))


def table(cases: list[Checked]) -> Table:
    """A row a kind of record."""
    rows = Table(title="Sound recordings")
    for heading in (
        "kind",
        "records",
        "through a converter",
        "refused by contact",
        "with a false finding",
        "false findings",
    ):
        rows.add_column(heading, justify="left" if heading == "kind" else "right")
    for kind in (*MAKERS, "all"):
        own = [case for case in cases if kind in (case.kind, "all")]
        counts = (
            len(own),
            sum(case.bits > 0 for case in own),
            sum(bool(case.refused) for case in own),
            sum(bool(case.findings) for case in own),
            sum(len(case.findings) for case in own),
        )
        rows.add_row(kind, *map(str, counts))
    return rows


if __name__ == "__main__":
    run(import_module("tests.campaigns.sound").app, "tests.campaigns.sound")
