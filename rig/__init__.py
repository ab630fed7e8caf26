"""A virtual test rig: machines whose parts meet through clearances, described, simulated, recorded and shown.

    import rig

    machine = rig.BarrelCradle(sensors="acceleration", noise_density=1e-3)
    recording = rig.record(machine.rig(), "barrel.mcap", force=machine.force(), duration_s=60)
    tip = recording["barrel_1000mm_acceleration"]
    print(tip.unit, tip.time_s[-1], tip.values.std())

Everything is in SI units. A `Rig` describes the machine as its owner believes it; a `Recording` holds what its sensors
delivered. What is wrong with a file or a value is a `RigError` of one sentence.
"""

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from rig.errors import RigError
from rig.model.description import Rig
from rig.recording import Channel, Recording
from rig.recording import read as _read
from rig.simulation.excitation import Excitation
from rig.simulation.reference import BarrelCradle, Sdof

__all__ = ["BarrelCradle", "Channel", "Excitation", "Recording", "Rig", "RigError", "Sdof", "read", "record"]
__version__ = version("rig-identify")


def read(path: str | Path) -> Recording:
    """The recording in an MCAP file; raises RigError if it is none, or damaged."""
    return _read(Path(path))


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
    """Simulates a rig, writes its recording to an MCAP file, and what only a simulator knows to a truth file beside.

    plant is `modal` (fast) or `ancf` (Exudyn's finite elements). With `actual`, that rig is simulated and the recording
    says that it was `machine`. Raises RigError where the rig cannot be simulated so or the file not written.
    """
    from rig.simulation.plants import plant_named
    from rig.simulation.record import record as recorded

    recorded(
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
