"""Plants that simulate a rig (protocol `rig.simulation.motion.Plant`), imported when they are requested."""

from importlib import import_module

from rig.errors import RigError
from rig.simulation.motion import Plant

PLANTS = ("ancf", "modal")


def plant_named(name: str) -> Plant:
    """Plant of that name; raises RigError if there is none."""
    if name not in PLANTS:
        raise RigError(f"no plant {name!r}; there are {', '.join(PLANTS)}")
    plant: Plant = import_module(f"rig.simulation.plants.{name}").simulate
    return plant
