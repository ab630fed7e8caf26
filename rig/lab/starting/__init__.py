"""Rigs from a few numbers: what `rig init` writes as the first rig.json, and the import map beside it."""

from pathlib import Path

from rig.errors import RigError
from rig.files import write_bytes
from rig.lab.starting.base import Start, StartWithStops
from rig.lab.starting.beams import BeamsRig
from rig.lab.starting.mass import MassRig
from rig.lab.starting.measured import MeasuredRig
from rig.lab.starting.structure import StructureRig
from rig.model.description import Rig, to_json
from rig.recording import RIG_NAME

__all__ = ["KINDS", "MAP_NAME", "Start", "StartWithStops", "write_start"]

MAP_NAME = "map.toml"
KINDS: dict[str, type[Start]] = {
    "mass": MassRig,
    "beams": BeamsRig,
    "structure": StructureRig,
    "measured": MeasuredRig,
}
_HEAD = """# Which column of a measured file is which sensor, for `rig import FILE --map {name}`; see rig/lab/README.md.
# Each column by its name (or number) in the file, each unit as the file has it: change what does not fit.
"""


def write_start(rig: Rig, map_text: str, folder: Path) -> tuple[Path, Path]:
    """Writes rig.json and the import map; returns both paths."""
    told = _HEAD.format(name=MAP_NAME) + map_text
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{folder}: cannot be made a folder ({error.strerror}); choose another place") from error
    rig_path, map_path = folder / RIG_NAME, folder / MAP_NAME
    write_bytes(to_json(rig) + b"\n", rig_path)
    write_bytes(told.encode(), map_path)
    return rig_path, map_path
