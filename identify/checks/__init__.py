"""Checks of a recording before every answer: what of its channels, its clock or its rig.json cannot be right."""

from identify.checks.check import check_recording, naming_first_finding, unchecked_notes
from identify.checks.findings import Finding

__all__ = ["Finding", "check_recording", "naming_first_finding", "unchecked_notes"]
