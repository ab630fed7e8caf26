"""Checks of a recording before every answer: what of its channels, its clock or its rig.json cannot be right."""

from identify.checks.check import adding_first_finding_to_error, check_recording, unchecked_notes
from identify.checks.findings import Finding

__all__ = ["Finding", "adding_first_finding_to_error", "check_recording", "unchecked_notes"]
