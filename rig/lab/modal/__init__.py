"""A structure from the UFF file of a modal analysis: mode shapes at nodes (dataset 55), or FRFs (dataset 58)."""

from pathlib import Path

from rig.lab.modal.file import Axis, Choice, read_uff
from rig.lab.modal.frfs import from_frfs
from rig.lab.modal.shapes import ModeShapes
from rig.model.structure import Structure
from rig.model.tolerances import Tolerances

__all__ = ["Axis", "Choice", "structure_from_uff"]


def structure_from_uff(path: Path, choice: Choice) -> tuple[Structure, tuple[str, ...], Tolerances | None]:
    """The structure, named like the file, and sentences on what was taken and how well FRFs are fitted.

    With what FRFs say of how far the modes are to be believed: the share that they leave of them, and their band.

    Mode shapes phi (dataset 55) are divided by sqrt(modal mass), which makes them mass-normalised; FRFs (58) are
    fitted, and their residues give the shapes, r_ok = phi_ok phi_dk with the driving point d. Raises RigError if the
    file cannot be read or does not hold what it takes.
    """
    file = read_uff(path)
    if file.sets.get(55):
        shapes = ModeShapes(file, choice)
        return shapes.structure(), shapes.notes, None
    if file.sets.get(58):
        return from_frfs(file, choice)
    raise file.wrong("holds neither mode shapes (dataset 55) nor FRFs (dataset 58); export either")
