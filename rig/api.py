"""Functions of the virtual test rig: read a recording, and record a rig."""

from collections.abc import Callable
from pathlib import Path

from rig.model.description import Rig
from rig.recording import Recording
from rig.recording import read as read_recording
from rig.simulation.excitation import Excitation
from rig.simulation.plants import plant_named
from rig.simulation.record import record as record_rig


def read(path: str | Path) -> Recording:
    """Recording in an MCAP file; raises RigError if the file is no recording, or damaged."""
    return read_recording(Path(path))


def record(
    machine: Rig,
    path: str | Path,
    *,
    force: Excitation,
    duration_s: float = 60.0,
    plant: str = "modal",
    step_s: float = 2.0**-14,
    actual: Rig | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Recording:
    """Simulate a rig, write its recording to an MCAP file, and the simulated truth to a file beside it.

    plant is `modal` (fast) or `ancf` (Exudyn's finite elements). With `actual`, that rig is simulated and the recording
    says that it was `machine`. Raises RigError where the rig cannot be simulated so or the file not written.
    """
    record_rig(
        machine,
        force,
        plant=plant_named(plant),
        duration_s=duration_s,
        step_s=step_s,
        path=Path(path),
        progress=progress,
        actual=actual,
    )
    return read(path)
