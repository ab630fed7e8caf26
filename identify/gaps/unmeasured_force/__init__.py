"""An unmeasured force as a model of a gap: where it acts, when, and by what law."""

from identify.gaps.unmeasured_force.description import described_force
from identify.gaps.unmeasured_force.force import UnmeasuredForceFit, likeliest_force

__all__ = ["UnmeasuredForceFit", "described_force", "likeliest_force"]
