"""Transverse displacement: laser triangulation, eddy current, LVDT."""

from rig.model.quantities.base import LENGTHS, Quantity

DISPLACEMENT = Quantity("displacement", "m", LENGTHS, order=0, uff_kind=8, largest=100.0)
