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
    quantities = [("stiffness", STIFFNESS_GRADIENT)]
    if not estimate.is_spring:
        quantities.insert(0, ("clearance", estimate.clearance_gradient))
    for quantity, gradient in quantities:
        value, error = float(gradient @ estimate.values), estimate_without_misfit.error(gradient)
        if not error < UNCERTAIN_SHARE * value:
            error_percent = min(100 * error / max(value, 1e-12), 100)
            remedy = None if lacks_slow_motion else RemedyCode.RECORD_LONGER_OR_EXCITE_MORE
            ratio = length_ratio(float(gradient @ estimate.covariances["scatter"] @ gradient), error**2, value)
            raise refused(RefusalCode.UNCERTAIN, remedy, ratio, quantity=quantity, uncertain_percent=error_percent)


def length_ratio(scatter_variance: float, variance: float, value: float) -> float | None:
    """Length over that of this record from which a value is certain enough: a longer record makes the scatter's part of
    the variance smaller, as 1 / length, and leaves the rest. None where the rest alone is too large."""
    excess = max(UNCERTAIN_SHARE * value, 0.0) ** 2 - (variance - scatter_variance)
    return scatter_variance / excess if excess > 0 else None
