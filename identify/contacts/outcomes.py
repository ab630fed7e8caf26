"""Outcomes of contacts: the joint estimate of each, or why the record does not determine it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import STIFFNESS_GRADIENT
from identify.contacts.refusals import Refusal, RefusalCode, RemedyCode, refused

UNCERTAIN_SHARE = 0.1
"""Standard error over the value, of clearance and of stiffness, from which an estimate is refused."""


@dataclass(frozen=True)
class Outcomes:
    """Outcome of every contact by its name: its joint estimate where the record determines it, else the refusal."""

    estimates: Mapping[str, JointEstimate]
    refusals: Mapping[str, Refusal]

    @staticmethod
    def refused(names: Sequence[str], refusal: Refusal) -> "Outcomes":
        """Outcomes of contacts that are all refused for one reason."""
        return Outcomes({}, dict.fromkeys(names, refusal))

    def __or__(self, further: "Outcomes") -> "Outcomes":
        """Outcomes with those of further contacts."""
        return Outcomes({**self.estimates, **further.estimates}, {**self.refusals, **further.refusals})


NO_OUTCOMES = Outcomes({}, {})


def check_certain(estimate: JointEstimate, lacks_slow_motion: bool) -> None:
    """Raises ContactRefusedError if clearance or stiffness is too uncertain, misfit of the law's form not counted.
    Displacement sensors would help where the record lacks the contact's slow motion."""
    estimate_without_misfit = replace(estimate, covariances={**estimate.covariances, "law": 0 * estimate.covariance})
    quantities = [("stiffness", estimate.stiffness_n_per_m, estimate_without_misfit.error(STIFFNESS_GRADIENT))]
    if not estimate.is_spring:
        quantities.insert(0, ("clearance", estimate.clearance_m, estimate_without_misfit.clearance_error_m))
    for quantity, value, error in quantities:
        if not error < UNCERTAIN_SHARE * value:
            error_percent = min(100 * error / max(value, 1e-12), 100)
            remedy = None if lacks_slow_motion else RemedyCode.RECORD_LONGER_OR_EXCITE_MORE
            raise refused(RefusalCode.UNCERTAIN, remedy, quantity=quantity, uncertain_percent=error_percent)
