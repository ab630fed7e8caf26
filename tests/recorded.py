"""Recordings of the reference rigs by the modal plant."""

from pathlib import Path

from rig.model.description import Rig
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof


def recorded(settings: Sdof | BarrelCradle, path: Path, believed: Rig | None = None, actual: Rig | None = None) -> Path:
    """Path of a recording under its own force; rig.json may state another rig (`believed`), another move (`actual`)."""
    record(
        believed or settings.rig(),
        settings.force(),
        plant=modal.simulate,
        duration_s=settings.duration_s,
        step_s=settings.step_s,
        path=path,
        progress=lambda _: None,
        actual=actual,
    )
    return path
