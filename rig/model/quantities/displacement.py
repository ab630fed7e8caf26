"""Transverse displacement: laser triangulation, eddy current, LVDT."""

from rig.model.quantities.base import METRES_BY_UNIT, Quantity

DISPLACEMENT = Quantity("displacement", "m", METRES_BY_UNIT, order=0, uff_kind=8, largest=100.0)
