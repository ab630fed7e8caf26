"""Structure of law.json: the results on contact laws."""

import msgspec

from identify.checks.findings import Finding
from identify.contacts.results import Estimate, Unanswered


class TriedLaw(msgspec.Struct, frozen=True):
    """A law and the rms of what it leaves of the force in the held-out half of the record."""

    law: str
    held_out_error_n: float


class SlidingLaw(msgspec.Struct, frozen=True, kw_only=True):
    """Dry friction reached through a backlash by a spring: sliding forces both ways, the whole backlash, the stiffness.

    Standard errors are of the scatter alone.
    """

    upper_n: Estimate
    lower_n: Estimate
    backlash_m: Estimate
    stiffness_n_per_m: Estimate


class ContactLawEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """Law of one contact; eta is its relative displacement.

    knees_m and slopes_n_per_m are those of the formula; fitted_knees_m and fitted_slopes_n_per_m those of the
    piecewise-linear law fitted from them, with standard errors of the scatter alone: not of the drift, nor of what
    rig.json may have wrong, for which see contact.json. hysteresis_share is the share of
    the scatter's variance that a damper in the closed contact explains. repeatable says whether the same seed gives the
    same formula: not if time ended the search.
    """

    contact: str
    verdict: str
    best: str
    formula: str
    knees_m: tuple[float, ...]
    slopes_n_per_m: tuple[float, ...]
    fitted_knees_m: tuple[Estimate, ...]
    fitted_slopes_n_per_m: tuple[Estimate, ...]
    candidates: tuple[TriedLaw, ...]
    force_rms_n: float
    hysteresis_share: float
    sides_known: bool
    points: int
    repeatable: bool
    sliding: SlidingLaw | None = None
    """Where it is the best law."""


class LawReport(msgspec.Struct, frozen=True, kw_only=True):
    """law.json."""

    rig: str
    laws: tuple[ContactLawEstimate, ...]
    unanswered: tuple[Unanswered, ...]
    findings: tuple[Finding, ...] = ()
