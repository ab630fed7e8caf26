"""Clearance, stiffness and damping of every contact of a rig, from a recording of its motion."""

from identify.contacts.identification import Identification, identify_contact

__all__ = ["Identification", "identify_contact"]
