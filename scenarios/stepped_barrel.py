"""A barrel of two thicknesses, known by its modal basis alone: recorded by Exudyn's finite elements, then identified.

python -m scenarios.stepped_barrel --out out
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from msgspec.structs import replace

from rig.commands.command_line import progress_bar, run
from rig.effects import effect_named
from rig.errors import RigError
from rig.files import write_bytes
from rig.model.beam import Beam
from rig.model.description import Rig, to_json
from rig.simulation.motion import ForceSignal, Motion, Progress
from rig.simulation.plants import ancf
from rig.simulation.plants.basis import modal_basis
from rig.simulation.plants.connectors import Section
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from scenarios.compare import identify_against_truth

BREECH_END_M = 0.4
THICKNESS_RATIO = 1.5
"""Thickness of the breech, from the barrel's left end to BREECH_END_M, over that of the rest."""
MODE_COUNT = 16
POSITIONS_M = np.linspace(0, 1, 41)

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def stepped_barrel(
    out: Annotated[Path, typer.Option(help="Folder for the recording, rig.json, contact.json and the figures.")] = Path(
        "out/stepped_barrel"
    ),
    duration: Annotated[float, typer.Option(help="Length of the record, s.")] = 60.0,
    level: Annotated[float, typer.Option(help="Of the force, N rms.")] = 14.0,
    seed: Annotated[int, typer.Option(help="Of the force and of the noise.")] = 1,
    effect: Annotated[
        str | None, typer.Option(help="An unmodelled effect, as of `rig record`; then nothing is identified.")
    ] = None,
) -> None:
    """Record a stepped barrel in its cradle with finite elements, and identify it from the barrel's modes as data."""
    # the barrel-cradle rig of the paper, with accelerometers alone, 1e-3 m/s2/sqrt(Hz)
    settings = BarrelCradle(sensors="acceleration", noise_density=1e-3, rms_n=level, duration_s=duration, seed=seed)
    believed_rig = with_basis(settings.rig())

    # the record is made by the meshed barrel, which knows nothing of modes
    out.mkdir(parents=True, exist_ok=True)
    recording_path = out / "stepped_barrel.mcap"
    with progress_bar(f"recording {recording_path.name} (ancf)") as progress:
        record(
            believed_rig,
            settings.force(),
            plant=meshed,
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=recording_path,
            progress=progress,
            actual=with_effect(believed_rig, effect) if effect else None,
        )
    write_bytes(to_json(believed_rig), out / "rig.json")

    # the identification has the modal basis in rig.json, and the record
    if not effect:
        comparison = identify_against_truth(recording_path, use="acceleration", out=out)
        comparison.print_estimates("A stepped barrel, its modal basis as data")


def with_basis(rig: Rig) -> Rig:
    """Rig with its barrel replaced by the modes of the stepped one, from a mesh of 60 elements."""
    barrel = rig.body("barrel")
    assert isinstance(barrel, Beam)
    basis_body = modal_basis(barrel, breech(barrel), POSITIONS_M, MODE_COUNT)
    return replace(rig, bodies=tuple(basis_body if body is barrel else body for body in rig.bodies))


def breech(barrel: Beam) -> tuple[Section, ...]:
    """Section of the breech: E I grows with the cube of the thickness, the mass with the thickness."""
    return (Section(barrel.name, 0.0, BREECH_END_M, stiffness_factor=THICKNESS_RATIO**3, mass_factor=THICKNESS_RATIO),)


def meshed(rig: Rig, force_n: ForceSignal, step_s: float, progress: Progress) -> Iterator[Motion]:
    """Plant that simulates a mesh of 20 elements in place of the barrel's modal basis."""
    barrel = BarrelCradle().rig().body("barrel")
    assert isinstance(barrel, Beam)
    meshed_rig = replace(rig, bodies=tuple(barrel if body.name == barrel.name else body for body in rig.bodies))
    return ancf.simulate(meshed_rig, force_n, step_s, progress, extra_physics=breech(barrel))


def with_effect(rig: Rig, effect: str) -> Rig:
    """Rig with an effect; raises RigError if it changes the bodies, which the mesh replaces."""
    actual_rig = effect_named(effect).applied_to(rig)
    if actual_rig.bodies != rig.bodies:
        raise RigError(f"effect {effect}: changes the modes, which the meshed barrel does not have; choose another")
    return actual_rig


if __name__ == "__main__":
    run(app, "scenarios.stepped_barrel")
