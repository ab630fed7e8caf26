"""The contact law as a formula, from a recording, without a law assumed."""

from identify.laws.identification import ContactLawFit, Laws, identify_law
from identify.laws.results import CUBIC, FORMULA, PIECEWISE, SLIDING

__all__ = ["CUBIC", "FORMULA", "PIECEWISE", "SLIDING", "ContactLawFit", "Laws", "identify_law"]
