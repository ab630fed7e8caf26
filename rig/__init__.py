"""A virtual test rig: machines whose parts meet through clearances, described, simulated, recorded and shown.

    import rig

    machine = rig.BarrelCradle(sensors="acceleration", noise_density=1e-3)
    recording = rig.record(machine.rig(), "barrel.mcap", force=machine.force(), duration_s=60)
    tip = recording["barrel_1000mm_acceleration"]
    print(tip.unit, tip.time_s[-1], tip.values.std())

Everything is in SI units. A `Rig` describes the machine as its owner believes it; a `Recording` holds what its sensors
delivered. What is wrong with a file or a value is a `RigError` of one sentence.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig.api import read, record
    from rig.errors import RigError
    from rig.model.description import Rig
    from rig.recording import Channel, Recording
    from rig.simulation.excitation import Excitation
    from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof

__all__ = [
    "BarrelCradle",
    "BarrelCradleAnnular",
    "Channel",
    "Excitation",
    "Recording",
    "Rig",
    "RigError",
    "Sdof",
    "read",
    "record",
]
__version__ = version("rig-identify")

_MODULES = {
    "BarrelCradle": "rig.simulation.reference",
    "BarrelCradleAnnular": "rig.simulation.reference",
    "Channel": "rig.recording",
    "Excitation": "rig.simulation.excitation",
    "Recording": "rig.recording",
    "Rig": "rig.model.description",
    "RigError": "rig.errors",
    "Sdof": "rig.simulation.reference",
    "read": "rig.api",
    "record": "rig.api",
}
"""Where each name is, loaded when it is first asked for (PEP 562): the command's first lines then take signals."""


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
