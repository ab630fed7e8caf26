"""Structures from measurements: the UFF file of a modal analysis (`uff`), or a force and its responses (`record`)."""

from rig.lab.modal.uff import Axis, UffSelection, structure_from_uff

__all__ = ["Axis", "UffSelection", "structure_from_uff"]
