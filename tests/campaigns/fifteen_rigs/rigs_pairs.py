"""Two bodies: cradle and barrel of other dimensions, a stepped barrel by its modes, a free decay, strain gauges."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns.fifteen_rigs.bodies import ModalBody, Section, element_beam, uniform_beam
from tests.campaigns.fifteen_rigs.field_rig import (
    ACCELERATION,
    DISPLACEMENT,
    NOISE,
    STRAIN,
    FieldRig,
    contact,
    import_map,
    sensors,
)
from tests.campaigns.fifteen_rigs.laboratory import Assembly, Grid, Instrument, Measured, TrueContact, built, recorded
from tests.campaigns.fifteen_rigs.rigs_lumped import excited
from tests.campaigns.fifteen_rigs.session import UserSession, write_record
from tests.campaigns.newcomer_machine import write_mode_shapes

GRID = Grid(2048.0, 15.0, 16)
MODES, RATIO = 16, 0.01
BAND_HZ = (1.0, 100.0)
REFERENCE = Section(0.05, 0.01)
DECAY_NOISE = 50e-9
"""Of the displacement sensors in the free decay, m/sqrt(Hz)."""
REFERENCE_WORDS = (
    "rig init beams --cradle-length-m 1 --cradle-width-m 0.05 --cradle-thickness-m 0.01 --barrel-length-m 1 "
    "--barrel-width-m 0.05 --barrel-thickness-m 0.01 --overlap-start-m 0.45 --clearance-m 5e-3 "
    "--stiffness-n-per-m 1e5 --sample-rate-hz 2048 "
)


def pair(
    cradle: ModalBody,
    barrel: ModalBody,
    rng: np.random.Generator,
    overlap_m: tuple[float, float],
    law: tuple[float, float, float],
    lengths_m: tuple[float, float],
) -> Assembly:
    """Contacts at both ends of the overlap (places on the cradle), the force at the barrel's right end."""
    start_m, end_m = overlap_m
    contacts = [
        contact(f"contact_{k}", ("barrel", x - start_m), rng, *law, ("cradle", x))
        for k, x in enumerate((start_m, end_m), start=1)
    ]
    bodies = {"cradle": built(cradle, rng), "barrel": built(barrel, rng)}
    lengths = {"cradle": lengths_m[0], "barrel": lengths_m[1]}
    return Assembly(bodies, contacts, [("barrel", lengths_m[1])], lengths)


def reference_pair(rng: np.random.Generator) -> Assembly:
    cradle, barrel = (uniform_beam(1.0, REFERENCE, MODES, RATIO, clamped) for clamped in (True, False))
    return pair(cradle, barrel, rng, (0.45, 1.0), (5e-3, 1e5, 10.0), (1.0, 1.0))


def stations(cradle_m: Sequence[float], barrel_m: Sequence[float]) -> list[tuple[str, float]]:
    return [*(("cradle", x) for x in cradle_m), *(("barrel", x) for x in barrel_m)]


def other_beams(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    cradle = uniform_beam(1.2, Section(0.06, 0.012), MODES, RATIO, True)
    barrel = uniform_beam(1.5, Section(0.05, 0.012), MODES, RATIO, False)
    assembly = pair(cradle, barrel, rng, (0.5, 1.2), (3e-3, 8e4, 10.0), (1.2, 1.5))
    places = stations((0.3, 0.5, 0.85, 1.2), (0.0, 0.3, 0.7, 1.1, 1.5))
    return excited(folder, rng, assembly, sensors(places, ACCELERATION), BAND_HZ, 2.5, GRID)


def describe_other_beams(session: UserSession) -> None:
    session.run(
        "rig init beams --cradle-length-m 1.2 --cradle-width-m 0.06 --cradle-thickness-m 0.012 --barrel-length-m 1.5 "
        "--barrel-width-m 0.05 --barrel-thickness-m 0.012 --overlap-start-m 0.5 --clearance-m 3e-3 "
        "--stiffness-n-per-m 8e4 --cradle-stations-m 0.3,0.5,0.85,1.2 --barrel-stations-m 0,0.3,0.7,1.1,1.5 "
        f"--noise-density {NOISE[ACCELERATION]} --sample-rate-hz 2048 --out lab --force"
    )
    import_map(session)


def stepped_barrel() -> ModalBody:
    nodes_m = np.linspace(0, 1.0, 81)
    thick = [0.016 if x < 0.4 else 0.012 if x < 0.7 else 0.009 for x in (nodes_m[1:] + nodes_m[:-1]) / 2]
    return element_beam(nodes_m, [Section(0.05, t) for t in thick], 22, RATIO, False)


def stepped(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    barrel = stepped_barrel()
    nodes_m = np.linspace(0, 1.0, 41)
    shapes = np.array([barrel.shapes(x) for x in nodes_m])[:, :18]
    write_mode_shapes(folder / "barrel.uff", nodes_m, barrel.frequencies_hz[:18], RATIO, shapes)
    cradle = uniform_beam(1.0, Section(0.06, 0.012), MODES, RATIO, True)
    assembly = pair(cradle, barrel, rng, (0.45, 1.0), (3e-3, 1e5, 10.0), (1.0, 1.0))
    places = stations((0.25, 0.45, 0.725, 1.0), (0.0, 0.25, 0.55, 0.8, 1.0))
    return excited(folder, rng, assembly, sensors(places, ACCELERATION), BAND_HZ, 2.5, GRID)


def describe_stepped(session: UserSession) -> None:
    """The barrel's object is taken from one rig.json into that of two beams, as rig/model/README.md has it."""
    session.run(
        "rig init structure --from-uff barrel.uff --contacts-m 0,0.55 --force-m 1 --clearance-m 3e-3 "
        "--stiffness-n-per-m 1e5 --sample-rate-hz 2048 --out modes --force"
    )
    session.run(
        "rig init beams --cradle-length-m 1 --cradle-width-m 0.06 --cradle-thickness-m 0.012 --barrel-length-m 1 "
        "--barrel-width-m 0.05 --barrel-thickness-m 0.012 --overlap-start-m 0.45 --clearance-m 3e-3 "
        "--stiffness-n-per-m 1e5 --cradle-stations-m 0.25,0.45,0.725,1 --barrel-stations-m 0,0.25,0.55,0.8,1 "
        f"--noise-density {NOISE[ACCELERATION]} --sample-rate-hz 2048 --out lab --force"
    )

    def by_its_modes(rig: dict[str, Any]) -> None:
        (body,) = json.loads((session.folder / "modes" / "rig.json").read_bytes())["bodies"]
        rig["bodies"][1] = {**body, "name": "barrel"}

    session.edit_rig("lab/rig.json", by_its_modes)
    import_map(session)


def decay(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    """A blow that nobody measured ends a tenth of a second before the record begins."""
    assembly = reference_pair(rng)
    before_s = 0.1
    grid = replace(GRID, duration_s=GRID.duration_s + before_s)
    force = np.where(grid.time_s < 5e-3, 600 * np.sin(np.pi * grid.time_s / 5e-3), 0.0)
    places = stations((0.2, 0.45, 0.6, 0.8, 1.0), (0.0, 0.25, 0.55, 0.8, 1.0))
    instruments = [replace(s, noise_density=DECAY_NOISE) for s in sensors(places, DISPLACEMENT)]
    record = recorded(assembly, instruments, force[None], grid, rng)
    skipped = round(before_s * grid.rate_hz)
    columns = {name: row[skipped:] for name, row in record.columns.items()}
    write_record(folder / "run.csv", Measured(record.forces_n[:, skipped:], columns, {}), grid.rate_hz, ())
    print(f"  closed {record.closed_share}", flush=True)
    return assembly.contacts


def describe_decay(session: UserSession) -> None:
    session.run(
        f"{REFERENCE_WORDS} --cradle-stations-m 0.2,0.45,0.6,0.8,1 --barrel-stations-m 0,0.25,0.55,0.8,1 "
        f"--quantity {DISPLACEMENT} --out lab --force"
    )
    import_map(session)
    session.edit("lab/run.toml", without_force)


def without_force(text: str) -> str:
    return "\n".join('force = "none"' if line.startswith("force =") else line for line in text.splitlines())


GAUGES = [("cradle", 0.1), ("cradle", 0.3), ("cradle", 0.7), ("barrel", 0.3), ("barrel", 0.5), ("barrel", 0.7)]


def gauged(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    assembly = reference_pair(rng)
    places = stations((0.45, 1.0), (0.0, 0.55))
    strain = [Instrument(f"{b}_{1e3 * x:04.0f}mm_{STRAIN}", b, x, STRAIN, NOISE[STRAIN], 0.005) for b, x in GAUGES]
    return excited(folder, rng, assembly, [*sensors(places, ACCELERATION), *strain], BAND_HZ, 2.5, GRID)


def describe_gauged(session: UserSession) -> None:
    session.run(
        f"{REFERENCE_WORDS} --cradle-stations-m 0.45,1 --barrel-stations-m 0,0.55 "
        f"--noise-density {NOISE[ACCELERATION]} --out lab --force"
    )

    def with_gauges(rig: dict[str, Any]) -> None:
        for body, x in GAUGES:
            station = {"body": body, "position_m": x}
            name = f"{body}_{1e3 * x:04.0f}mm_{STRAIN}"
            rig["sensors"].append({"name": name, "station": station, "quantity": STRAIN})

    session.edit_rig("lab/rig.json", with_gauges)
    import_map(session)


RIGS = {
    "other_beams": FieldRig(other_beams, describe_other_beams),
    "stepped_barrel": FieldRig(stepped, describe_stepped),
    "decay": FieldRig(decay, describe_decay),
    "gauges": FieldRig(gauged, describe_gauged),
}
