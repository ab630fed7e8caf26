"""A file of measured data looked at without a map: what it holds, and the map that imports it."""

from rig.lab.looking.proposal import Proposal, proposed_import_map

__all__ = ["Proposal", "proposed_import_map"]
