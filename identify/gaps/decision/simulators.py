"""The simulators that installed packages offer to a diagnosis."""

from importlib.metadata import entry_points

from identify.gaps.decision.prepare import Simulator
from rig.errors import RigError

SIMULATORS = "identify.simulators"
"""The entry points by which packages offer simulators."""


def simulator_named(name: str) -> Simulator:
    """The simulator that an installed package offers under this name; raises RigError if none does."""
    offered = {point.name: point for point in entry_points(group=SIMULATORS)}
    if name not in offered:
        raise RigError(f"no simulator {name!r}; there are {', '.join(sorted(offered))}")
    return Simulator(name, offered[name].load())
