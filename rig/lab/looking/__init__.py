"""A file of measured data looked at without a map: what it holds, and the map that imports it."""

from rig.lab.looking.proposal import Proposal, look_at

__all__ = ["Proposal", "look_at"]
