"""Rigs other than the reference rigs, each recorded, identified and, with one effect, diagnosed.

python -m tests.campaigns.topologies --out out/topologies
"""

from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from msgspec.structs import replace
from rich.console import Console
from rich.progress import track
from rich.table import Table

import identify
from identify.contacts.results import Estimate
from identify.pages.wording import COVERED
from rig import RigError
from rig.commands.command_line import run
from rig.effects import effect_named
from rig.model.contact_laws import DeadZone
from rig.model.description import Body, Contact, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.model.structure import ShapeRow, Structure
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle

RATE_HZ = 2048.0
NOISE = {"acceleration": 1e-4, "displacement": 1e-8}
"""One-sided, m/s^2/sqrt(Hz) and m/sqrt(Hz)."""
STOPS = ("bumper", "hard stop")
BEHIND = "contact_clearance:factor=1.2,contact=hard stop"
app = typer.Typer(pretty_exceptions_enable=False)


@dataclass(frozen=True)
class Topology:
    """A rig, the force that excites it (N rms) and an effect that it may have."""

    rig: Rig
    rms_n: float
    effect: str


def rig_of(
    name: str,
    bodies: tuple[Body, ...],
    contacts: tuple[Contact, ...],
    stations: list[Station],
    force_at: Station,
    quantity: str = "acceleration",
) -> Rig:
    sensors = tuple(
        Sensor(
            name=f"{s.body}_{round(1e3 * s.position_m):04d}",
            station=s,
            quantity=quantity,
            noise_density=NOISE[quantity],
        )
        for s in stations
    )
    return Rig(name=name, bodies=bodies, contacts=contacts, force_at=force_at, sensors=sensors, sample_rate_hz=RATE_HZ)


def stop(name: str, at: Station, against: Station | None, clearance_m: float, stiffness: float) -> Contact:
    law = DeadZone(
        lower_clearance_m=clearance_m,
        upper_clearance_m=clearance_m,
        stiffness_n_per_m=stiffness,
        damping_n_s_per_m=10.0,
    )
    return Contact(name=name, at=at, against=against, law=law)


def cantilever(quantity: str) -> Rig:
    """A clamped beam whose tip knocks against two stops on the ground."""
    beam = replace(next(b for b in BarrelCradle().rig().beams if b.clamped), name="beam")
    stations = [Station("beam", x) for x in (0.2, 0.4, 0.6, 0.8, 0.9, 1.0)]
    tip = stop("tip", stations[-1], None, 1e-3, 5e4)
    return rig_of("cantilever", (beam,), (tip,), stations, stations[2], quantity)


def chain(masses: int, quantity: str, ground: bool) -> Rig:
    """Masses on springs of their own; each knocks against the next, the last also against the ground."""
    bodies = tuple(
        Oscillator(name=f"mass {k + 1}", mass_kg=1.0 + k, frequency_hz=4.0 + k, damping_ratio=0.02)
        for k in range(masses)
    )
    places = [Station(b.name) for b in bodies]
    ends = [*places[1:], *([None] if ground else [])]
    contacts = tuple(stop(f"contact_{k + 1}", places[k], end, 4e-4, 2e4) for k, end in enumerate(ends))
    return rig_of("chain", bodies, contacts, places, places[0], quantity)


def frame(support_hz: float) -> Rig:
    """Four plates of 6.5 kg on leaf springs (30.7, 56.7, 74.1 Hz), a bumper between the upper two."""
    mass_kg, places = 6.5, [0.3 * k for k in range(4)]
    between = 2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    between[0, 0] = between[3, 3] = 1.0
    squares, shapes = np.linalg.eigh(between)
    natural_hz = 30.7 * np.sqrt(np.maximum(squares, 0.0) / squares[1])
    natural_hz[0] = support_hz
    rows = zip(places, shapes / np.sqrt(mass_kg), strict=True)
    body = Structure(
        name="frame",
        length_m=0.9,
        natural_hz=tuple(natural_hz.tolist()),
        ratios=(0.02 if support_hz else 0.0, 0.01, 0.01, 0.01),
        rows=tuple(ShapeRow(at, tuple(values.tolist())) for at, values in rows),
    )
    floors = [Station("frame", at) for at in places]
    return rig_of("frame", (body,), (stop("bumper", floors[3], floors[2], 1e-4, 1e6),), floors, floors[0])


def one_mass(
    clearance_m: float,
    frequency_hz: float = 12.0,
    damping_ratio: float = 0.02,
    one_sided: bool = False,
    quantity: str = "displacement",
) -> Rig:
    """A mass between stops; of a one-sided stop the lower one is out of reach."""
    body = Oscillator(name="mass", mass_kg=1.0, frequency_hz=frequency_hz, damping_ratio=damping_ratio)
    at = Station("mass")
    contact = stop("stop_1", at, None, clearance_m, 2e4)
    if one_sided:
        contact = replace(contact, law=replace(contact.law, lower_clearance_m=1.0))
    return rig_of("mass", (body,), (contact,), [at], at, quantity)


def progressive_stop(quantity: str, *stops: tuple[float, float]) -> Rig:
    """The mass between stops of these clearances (m) and stiffnesses (N/m), one behind the other; two if none are
    given, a soft bumper and a hard stop."""
    rig = one_mass(1e-3, quantity=quantity)
    laws = stops or ((5e-4, 8e3), (1e-3, 1e5))
    return replace(
        rig, contacts=tuple(stop(name, rig.forces[0], None, *law) for name, law in zip(STOPS, laws, strict=False))
    )


def beams_with_inner_stop() -> Rig:
    """The barrel in its cradle with a further stop behind contact 1."""
    rig = BarrelCradle(sensors="acceleration").rig()
    first, second = rig.contacts
    behind = stop("inner stop", first.at, first.against, 7e-3, 1e5)
    return replace(rig, name="beams", contacts=(first, behind, second), sample_rate_hz=RATE_HZ)


RIGS = {
    "cantilever with a stop at its tip": Topology(cantilever("acceleration"), 10.0, "contact_stiffness:factor=1.5"),
    "cantilever, displacements": Topology(cantilever("displacement"), 10.0, "contact_clearance:factor=0.5"),
    "two masses": Topology(chain(2, "acceleration", False), 8.0, "contact_clearance:factor=1.2"),
    "three masses in a chain": Topology(
        chain(3, "acceleration", True), 8.0, "contact_stiffness:factor=1.5,contact=contact_2"
    ),
    "three masses, displacements": Topology(
        chain(3, "displacement", True), 8.0, "contact_clearance:factor=0.5,contact=contact_1"
    ),
    "frame, free": Topology(frame(0.0), 60.0, "contact_clearance:factor=0.5"),
    "frame on soft supports": Topology(frame(3.0), 60.0, "contact_clearance:factor=0.5"),
    "mass with a stop on one side": Topology(one_mass(5e-4, one_sided=True), 6.0, "contact_stiffness:factor=1.5"),
    "free mass with friction": Topology(
        one_mass(1e-3, frequency_hz=0.0, damping_ratio=0.0, quantity="acceleration"), 6.0, "ground_friction:force_n=1"
    ),
    "overdamped mass": Topology(
        one_mass(1e-3, frequency_hz=3.0, damping_ratio=3.0, quantity="acceleration"),
        60.0,
        "contact_clearance:factor=0.5",
    ),
    "bumper and hard stop on one mass": Topology(progressive_stop("displacement"), 12.0, BEHIND),
    "bumper and hard stop, accelerometer": Topology(progressive_stop("acceleration"), 12.0, BEHIND),
    "two beams, two stops at one place": Topology(
        beams_with_inner_stop(), 20.0, "contact_clearance:factor=0.8,contact=inner stop"
    ),
}


def recorded(
    case: Topology,
    path: Path,
    *,
    duration_s: float = 30.0,
    seed: int = 1,
    level: float = 1.0,
    effect: str = "",
    actual: Rig | None = None,
) -> Path:
    """A recording of the case by the plant `modal`; of another rig than rig.json has if one is given, or an effect."""
    record(
        case.rig,
        replace(BarrelCradle(rms_n=level * case.rms_n, duration_s=duration_s).force(), seed=seed),
        plant=partial(modal.simulate, modes_per_beam=20),
        duration_s=duration_s,
        step_s=2.0**-15,
        path=path,
        progress=lambda _: None,
        actual=effect_named(effect).applied_to(case.rig) if effect else actual,
    )
    return path


@app.command()
def topologies(
    out: Annotated[Path, typer.Option(help="Folder for the recordings.")] = Path("out/topologies"),
    diagnose: Annotated[bool, typer.Option(help="Also diagnose one effect of each rig.")] = True,
) -> None:
    """Identifies the contacts of every rig from 30 s, and diagnoses an effect from two records of 30 s."""
    out.mkdir(parents=True, exist_ok=True)
    table = Table(title="Rigs other than the reference rigs: found, with 95 % intervals (true value)")
    for heading in ("rig", "clearance, mm", "stiffness, N/mm", "effect", "found"):
        table.add_column(heading)
    for number, (name, case) in enumerate(track(RIGS.items(), console=Console(stderr=True))):
        row = [name]
        try:
            row += _contacts(case, out / f"{number}.mcap")
            row += [case.effect, _gap(case, out, number) if diagnose else ""]
        except RigError as error:
            row.append(str(error))
        table.add_row(*row)
    Console().print(table)


def _contacts(case: Topology, path: Path) -> tuple[str, str]:
    """Found and true clearances, and stiffnesses. Raises RigError if the record allows none."""
    rows = identify.contact(recorded(case, path)).report.contacts
    laws = {c.name: c.law for c in case.rig.contacts}
    smaller = {name: min(law.lower_clearance_m, law.upper_clearance_m) for name, law in laws.items()}
    return (
        "\n".join(interval(c.clearance_m, 1e3, smaller[c.name]) for c in rows),
        "\n".join(interval(c.stiffness_n_per_m, 1e-3, laws[c.name].stiffness_n_per_m) for c in rows),
    )


def interval(found: Estimate, factor: float, true: float) -> str:
    """In another unit, with the true value in brackets."""
    return f"{factor * found.value:.4g} ± {COVERED * factor * found.standard_error:.2g} ({factor * true:.4g})"


def _gap(case: Topology, out: Path, number: int) -> str:
    """What the diagnosis says of the case's effect. Raises RigError if the records allow none."""
    fit, validation = (
        recorded(case, out / f"{number}_{seed}.mcap", seed=seed, level=level, effect=case.effect)
        for seed, level in ((2, 1.0), (3, 1.5))
    )
    found = identify.gap(fit, validation).report
    if not found.causes:
        return found.verdict
    best = found.causes[0]
    numbers = "; ".join(f"{v.value:.4g} ± {COVERED * v.standard_error:.2g}" for v in best.parameters.values())
    return f"{' + '.join(best.effects)} {numbers}"


if __name__ == "__main__":
    run(import_module("tests.campaigns.topologies").app, "tests.campaigns.topologies")
