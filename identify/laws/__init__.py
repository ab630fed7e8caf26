"""The contact law as a formula, from a recording, without a law assumed."""

from identify.laws.identification import CUBIC, FORMULA, PIECEWISE, SLIDING, FoundLaw, Laws, identify_law

__all__ = ["CUBIC", "FORMULA", "PIECEWISE", "SLIDING", "FoundLaw", "Laws", "identify_law"]
