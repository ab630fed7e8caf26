"""An unmeasured force as a model of a gap: where it acts, when, and by what law."""

from identify.gaps.unknown.force import Sought, UnknownForce, likeliest_force
from identify.gaps.unknown.wording import sentence

__all__ = ["Sought", "UnknownForce", "likeliest_force", "sentence"]
