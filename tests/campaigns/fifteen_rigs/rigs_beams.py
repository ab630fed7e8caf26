"""One beam: between stops at its tip, on one side by hammer, on a roller, on a shaken base; a plate by its modes."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns.fifteen_rigs.bodies import Section, SupportedPlate, element_beam, uniform_beam
from tests.campaigns.fifteen_rigs.field_rig import (
    ACCELERATION,
    DISPLACEMENT,
    FieldRig,
    contact,
    import_map,
    sensors,
)
from tests.campaigns.fifteen_rigs.laboratory import Assembly, Grid, TrueContact, blows, built, recorded
from tests.campaigns.fifteen_rigs.rigs_lumped import excited, ground_sensor, on_the_ground, shaken
from tests.campaigns.fifteen_rigs.session import UserSession, write_record

GRID = Grid(2048.0, 20.0, 16)
MODES, RATIO = 40, 0.01
"""Modes of a beam, as many as `rig init` gives it: without the higher ones it lacks compliance where a stop acts."""
BOTH = f"{ACCELERATION},{DISPLACEMENT}"
PLATE = SupportedPlate(0.6, 0.4, 0.004)
PLATE_POINTS = [(0.15, 0.1), (0.15, 0.2), (0.3, 0.3), (0.38, 0.13), (0.47, 0.28), (0.5, 0.2)]
PLATE_MODES, PLATE_KNOWN = 80, 60
PLATE_GRID, FAST_PLATE_GRID = Grid(1024.0, 25.0, 16), Grid(4096.0, 12.0, 4)


def beam_stations(places_m: Sequence[float]) -> list[tuple[str, float]]:
    return [("beam", x) for x in places_m]


def cantilever(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    body = built(uniform_beam(0.6, Section(0.03, 0.008), MODES, RATIO, True), rng)
    stop = contact("contact_1", ("beam", 0.6), rng, 5e-4, 5e4, 5.0)
    assembly = Assembly({"beam": body}, [stop], [("beam", 0.4)], {"beam": 0.6})
    return excited(folder, rng, assembly, sensors(beam_stations((0.2, 0.4, 0.6)), BOTH), (5.0, 300.0), 3.0, GRID)


def describe_cantilever(session: UserSession) -> None:
    session.run(
        "rig init cantilever --length-m 0.6 --width-m 0.03 --thickness-m 0.008 --force-m 0.4 --clearance-m 5e-4 "
        f"--stiffness-n-per-m 5e4 --stations-m 0.2,0.4,0.6 --quantity {BOTH} --sample-rate-hz 2048 --out lab --force"
    )
    import_map(session)


def hammered(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    body = built(uniform_beam(0.5, Section(0.04, 0.01), MODES, RATIO, True), rng)
    stop = contact("contact_1", ("beam", 0.5), rng, 3e-4, 1e5, 5.0, stops="upper")
    assembly = Assembly({"beam": body}, [stop], [("beam", 0.3)], {"beam": 0.5})
    force = blows(600.0, 1.5e-3, 2.0, GRID, rng)
    record = recorded(assembly, sensors(beam_stations((0.1, 0.3, 0.5)), BOTH), force[None], GRID, rng)
    write_record(folder / "run.csv", record, GRID.rate_hz)
    print(f"  closed {record.closed_share}", flush=True)
    return [stop]


def describe_hammered(session: UserSession) -> None:
    session.run(
        "rig init cantilever --length-m 0.5 --width-m 0.04 --thickness-m 0.01 --force-m 0.3 --stops upper "
        "--clearance-m 3e-4 --stiffness-n-per-m 1e5 --stations-m 0.1,0.3,0.5 "
        f"--quantity {BOTH} --sample-rate-hz 2048 --out lab --force"
    )
    import_map(session)


def roller(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    nodes_m = np.linspace(0, 0.8, 65)
    section = [Section(0.04, 0.008)] * 64
    body = built(element_beam(nodes_m, section, MODES, RATIO, True, roller_m=0.5), rng)
    stop = contact("contact_1", ("beam", 0.8), rng, 4e-4, 5e4, 5.0)
    assembly = Assembly({"beam": body}, [stop], [("beam", 0.3)], {"beam": 0.8})
    places = beam_stations((0.15, 0.3, 0.65, 0.8))
    return excited(folder, rng, assembly, sensors(places, BOTH), (10.0, 400.0), 3.0, GRID)


def describe_roller(session: UserSession) -> None:
    session.run(
        "rig init cantilever --length-m 0.8 --width-m 0.04 --thickness-m 0.008 --force-m 0.3 --clearance-m 4e-4 "
        "--stiffness-n-per-m 5e4 --stations-m 0.15,0.3,0.65,0.8 "
        f"--quantity {BOTH} --sample-rate-hz 2048 --out lab --force"
    )

    def on_a_roller(rig: dict[str, Any]) -> None:
        rig["supports"] = [{"station": {"body": "beam", "position_m": 0.5}}]

    session.edit_rig("lab/rig.json", on_a_roller)
    import_map(session)


def shaken_cantilever(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    body = built(uniform_beam(0.5, Section(0.03, 0.006), MODES, RATIO, True), rng)
    stop = contact("contact_1", ("beam", 0.5), rng, 4e-4, 3e4, 3.0)
    assembly = Assembly({"beam": body}, [stop], lengths_m={"beam": 0.5})
    instruments = [
        *sensors(beam_stations((0.15, 0.3, 0.5)), BOTH),
        ground_sensor(ACCELERATION),
        ground_sensor(DISPLACEMENT),
    ]
    return shaken(folder, rng, assembly, instruments, (15.0, 250.0), 25.0, GRID)


def describe_shaken_cantilever(session: UserSession) -> None:
    session.run(
        "rig init cantilever --length-m 0.5 --width-m 0.03 --thickness-m 0.006 --clearance-m 4e-4 "
        f"--stiffness-n-per-m 3e4 --stations-m 0.15,0.3,0.5 --quantity {BOTH} "
        "--sample-rate-hz 2048 --out lab --force"
    )

    def shaken_rig(rig: dict[str, Any]) -> None:
        on_the_ground(rig, ACCELERATION)
        on_the_ground(rig, DISPLACEMENT)

    session.edit_rig("lab/rig.json", shaken_rig)
    import_map(session)


def plate(folder: Path, rng: np.random.Generator, grid: Grid = PLATE_GRID) -> Sequence[TrueContact]:
    modal = PLATE.body(PLATE_MODES, RATIO, PLATE_POINTS)
    shapes = np.array([modal.shapes(k) for k in range(len(PLATE_POINTS))])[:, :PLATE_KNOWN]
    analysis = {
        "frequencies_hz": modal.frequencies_hz[:PLATE_KNOWN].tolist(),
        "shapes": shapes.tolist(),
        "damping_ratios": [RATIO] * PLATE_KNOWN,
    }
    (folder / "analysis.json").write_text(json.dumps(analysis))
    stops = [contact(f"stop_{k}", ("plate", float(k)), rng, 1e-4, 1e5, 10.0) for k in (1, 3)]
    places = [("plate", float(k)) for k in range(len(PLATE_POINTS))]
    instruments = [*sensors(places, ACCELERATION), *sensors([places[1], places[3]], DISPLACEMENT)]
    assembly = Assembly({"plate": built(modal, rng)}, stops, [places[0], places[4]])
    return excited(folder, rng, assembly, instruments, (20.0, 400.0), 1.5, grid)


def describe_plate(session: UserSession, grid: Grid = PLATE_GRID) -> None:
    """Written by hand from the modal analysis, as rig/model/README.md has it: nodes by name, no positions."""
    analysis = json.loads((session.folder / "analysis.json").read_bytes())
    nodes = [{"node": str(k), "values": values} for k, values in enumerate(analysis.pop("shapes"))]
    body = {"type": "structure", "name": "plate", "has_axis": False, "length_m": 0.6, **analysis, "shapes": nodes}
    law = {"lower_clearance_m": 1e-4, "upper_clearance_m": 1e-4, "stiffness_n_per_m": 1e5}

    def at(node: int) -> dict[str, str]:
        return {"body": "plate", "node": str(node)}

    rig = {
        "name": "plate",
        "bodies": [body],
        "contacts": [{"name": f"stop_{k}", "at": at(k), "law": {"type": "dead_zone", **law}} for k in (1, 3)],
        "force_at": [at(0), at(4)],
        "sensors": [
            {"name": f"plate_{1000 * k:04d}mm_{quantity}", "station": at(k), "quantity": quantity}
            for quantity, nodes in ((ACCELERATION, range(6)), (DISPLACEMENT, (1, 3)))
            for k in nodes
        ],
        "sample_rate_hz": grid.rate_hz,
    }
    session.write("lab/rig.json", json.dumps(rig))
    import_map(session)


BY_DISPLACEMENTS = f"--use {DISPLACEMENT}"
RIGS = {
    "cantilever": FieldRig(cantilever, describe_cantilever, BY_DISPLACEMENTS),
    "one_sided_hammer": FieldRig(hammered, describe_hammered, BY_DISPLACEMENTS),
    "roller": FieldRig(roller, describe_roller, BY_DISPLACEMENTS),
    "shaken_cantilever": FieldRig(shaken_cantilever, describe_shaken_cantilever, BY_DISPLACEMENTS),
    "plate": FieldRig(plate, describe_plate),
    "plate_4096hz": FieldRig(partial(plate, grid=FAST_PLATE_GRID), partial(describe_plate, grid=FAST_PLATE_GRID)),
}
