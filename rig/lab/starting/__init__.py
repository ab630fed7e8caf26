"""First rigs from a few numbers: the rig.json and the import map that `rig init` writes."""

from pathlib import Path

from rig.files import make_folder, write_bytes
from rig.lab.starting.analytic import BeamsRig, CantileverRig, MassRig
from rig.lab.starting.base import Start, StartWithStops
from rig.lab.starting.masses import ChainRig, TwoMassesRig
from rig.lab.starting.measured import MeasuredRig
from rig.lab.starting.structure import StructureRig
from rig.model.description import Rig, to_brief_json
from rig.recording import RIG_NAME

__all__ = ["KINDS", "MAP_NAME", "Start", "StartWithStops", "write_rig_and_map"]

MAP_NAME = "map.toml"
KINDS: dict[str, type[Start]] = {
    "mass": MassRig,
    "two_masses": TwoMassesRig,
    "chain": ChainRig,
    "cantilever": CantileverRig,
    "beams": BeamsRig,
    "structure": StructureRig,
    "measured": MeasuredRig,
}
_HEAD = """# Which column of a measured file is which sensor, for `rig import FILE --map {name}`; see rig/lab/README.md.
# Each column by its name (or number) in the file, each unit as the file has it: change what does not fit.
"""


def write_rig_and_map(rig: Rig, map_text: str, folder: Path, keep_map: bool = False) -> tuple[Path, Path]:
    """Write rig.json, without fields at their defaults, and the import map; return both paths.

    With keep_map a map that is there, such as the one that `rig import` proposed, stays.
    """
    make_folder(folder)
    rig_path, map_path = folder / RIG_NAME, folder / MAP_NAME
    write_bytes(to_brief_json(rig) + b"\n", rig_path)
    if not (keep_map and map_path.exists()):
        write_bytes((_HEAD.format(name=MAP_NAME) + map_text).encode(), map_path)
    return rig_path, map_path
