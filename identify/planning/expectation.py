"""Expected standard errors of a planned test: those of `identify contact` on simulated records of it.

Notes for maintainers
1. The rig is simulated as described, under drawn forces, with the noise, range and filters of its sensors. The
   separation and joint fit of `identify contact` then state their standard errors, tolerances included.
2. A record is simulated up to a length. A longer test leaves the variance by tolerances and by the law's form as it
   is, and divides the rest (scatter and slow motion) by the ratio of the lengths.
3. `identify contact` widens its intervals by the pulls of body and force parameters, which chance moves from record to
   record. The factor is kept apart: it counts in what is expected, and not where tests are compared.
4. The median over several drawn forces is expected; their spread says how far a single test may lie from it.
"""

from collections.abc import Callable, Sequence
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from identify.contacts.acceptance import accept
from identify.contacts.determination import determine
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_fit import FORMS
from identify.contacts.law_form import DAMPING_GRADIENT, STIFFNESS_GRADIENT, parameters_of_law
from identify.contacts.refusals import ContactRefusedError, Refusal, RefusalCode, RemedyCode
from identify.contacts.separation import separate_described
from identify.planning.planned_test import PlannedTest, drawn_forces_n
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig
from rig.recording import Recording

Source = Literal["scatter", "slow motion", "tolerances", "law"]
"""Source of the larger part of a variance."""
QUANTITIES = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m")
MAX_MISS_ERRORS = 3.5
"""Standard errors by which an estimate may miss the value that was simulated before it is noted."""

Simulate = Callable[[Rig, Rig, Float[np.ndarray, "forces samples"], int], Recording]
"""Recording of the actual rig (second) in the channels of the nominal one (first) under forces; the seed is of the
noise."""


class ErrorParts(msgspec.Struct, frozen=True, kw_only=True):
    """Simulated value, estimate, and parts of its variance, in squares of the quantity's unit; widening_factor is that
    of the standard error by the pulls of nuisance parameters."""

    simulated_value: float
    estimate: float
    scatter_variance: float
    slow_motion_variance: float
    tolerance_variance: float
    law_variance: float
    widening_factor: float

    @property
    def stated_error(self) -> float:
        """Standard error that is stated, with its factor."""
        return self.widening_factor * self.standard_error

    @property
    def standard_error(self) -> float:
        """Standard error without its factor."""
        return float(
            np.sqrt(self.scatter_variance + self.slow_motion_variance + self.tolerance_variance + self.law_variance)
        )

    @property
    def source(self) -> Source:
        """Largest part of the variance."""
        variances: dict[Source, float] = {
            "scatter": self.scatter_variance,
            "slow motion": self.slow_motion_variance,
            "tolerances": self.tolerance_variance,
            "law": self.law_variance,
        }
        return max(variances, key=lambda source: variances[source])

    def for_longer_record(self, length_ratio: float) -> "ErrorParts":
        """Parts for a record that is longer by a ratio."""
        return msgspec.structs.replace(
            self,
            scatter_variance=self.scatter_variance / length_ratio,
            slow_motion_variance=self.slow_motion_variance / length_ratio,
        )


class RefusedContact(msgspec.Struct, frozen=True):
    """Contact that a simulated record does not determine: why, and what would help."""

    cause: str
    advice: str
    code: RefusalCode
    remedy: RemedyCode


class SimulatedTest(msgspec.Struct, frozen=True):
    """Outcome of one simulated record: errors of the three `QUANTITIES` of each contact, and refused contacts."""

    error_parts: dict[str, tuple[ErrorParts, ...]]
    refused_contacts: dict[str, RefusedContact]


class ExpectedQuantity(msgspec.Struct, frozen=True, kw_only=True):
    """Believed value and expected standard error of a quantity, in the unit of its name; the factor by which the
    standard error of a single record may lie above or below (one standard deviation over the simulated records); the
    largest part of its variance."""

    value: float
    standard_error: float
    spread_factor: float
    limited_by: Source


class ExpectedContact(msgspec.Struct, frozen=True, kw_only=True):
    """Expected estimates of a contact, and the share of the simulated records that determine it. Clearance is half the
    total play, or that of the one stop that is touched."""

    name: str
    determined_share: float
    clearance_m: ExpectedQuantity
    stiffness_n_per_m: ExpectedQuantity
    damping_n_s_per_m: ExpectedQuantity

    @property
    def quantities(self) -> tuple[ExpectedQuantity, ...]:
        return (self.clearance_m, self.stiffness_n_per_m, self.damping_n_s_per_m)


class Undetermined(msgspec.Struct, frozen=True, kw_only=True):
    """Contact that no simulated record, or fewer than half of them, determine."""

    name: str
    determined_share: float
    reason: str
    remedy: str
    code: RefusalCode


def simulated_test(test: PlannedTest, simulate: Simulate, seed: int, max_simulated_s: float) -> SimulatedTest:
    """Outcome of the planned test, simulated for at most `max_simulated_s` and scaled to its duration.

    Raises RigError where the rig cannot be simulated.
    """
    simulated_s = min(test.duration_s, max_simulated_s)
    rig, short_test = test.rig, test.with_duration(simulated_s)
    with threadpool_limits(1):  # the matrices are small
        recording = simulate(rig, rig, drawn_forces_n(short_test, seed), seed)
        try:
            separation = separate_described(recording, "auto", test.tolerances)
            determination = determine(separation, FORMS)
            accepted = accept(separation, determination).outcomes
        except ContactRefusedError as error:
            return SimulatedTest({}, {contact.name: _refused_contact(error.refusal) for contact in rig.contacts})
    length_ratio = test.duration_s / simulated_s
    laws = {contact.name: contact.law for contact in rig.contacts}
    return SimulatedTest(
        {
            name: _error_parts(laws[name], estimate, accepted.estimates[name], length_ratio)
            for name, estimate in determination.estimates.items()
        },
        {name: _refused_contact(refusal) for name, refusal in accepted.refusals.items()},
    )


def expected_contacts(rig: Rig, tests: Sequence[SimulatedTest]) -> tuple[ExpectedContact | Undetermined, ...]:
    """Expectation of every contact over several simulated records."""
    return tuple(_expected_contact(contact.name, tests) for contact in rig.contacts)


def largest_miss(tests: Sequence[SimulatedTest]) -> tuple[float, str]:
    """Largest difference between an estimate and the simulated value in standard errors, and the contact's name."""
    misses = [
        (abs(parts.estimate - parts.simulated_value) / parts.stated_error, name)
        for test in tests
        for name, all_parts in test.error_parts.items()
        for parts in all_parts
        if parts.stated_error > 0
    ]
    return max(misses, default=(0.0, ""))


def _refused_contact(refusal: Refusal) -> RefusedContact:
    return RefusedContact(refusal.cause, refusal.advice, refusal.code, refusal.remedy)


def _error_parts(
    law: ContactLaw, estimate: JointEstimate, accepted: JointEstimate, length_ratio: float
) -> tuple[ErrorParts, ...]:
    true_numbers = parameters_of_law(law)
    parts_by_quantity = []
    for gradient in (estimate.clearance_gradient, STIFFNESS_GRADIENT, DAMPING_GRADIENT):
        total_variance, tolerance_variance, slow_motion_variance, law_variance = (
            float(gradient @ covariance @ gradient)
            for covariance in (estimate.covariance, *(estimate.covariances[s] for s in ("tolerances", "drift", "law")))
        )
        record_parts = ErrorParts(
            simulated_value=float(gradient @ true_numbers),
            estimate=float(gradient @ estimate.values),
            scatter_variance=max(0.0, total_variance - tolerance_variance - slow_motion_variance - law_variance),
            slow_motion_variance=slow_motion_variance,
            tolerance_variance=tolerance_variance,
            law_variance=law_variance,
            widening_factor=accepted.error(gradient) / float(np.sqrt(total_variance)) if total_variance > 0 else 1.0,
        )
        parts_by_quantity.append(record_parts.for_longer_record(length_ratio))
    return tuple(parts_by_quantity)


def _expected_contact(name: str, tests: Sequence[SimulatedTest]) -> ExpectedContact | Undetermined:
    parts_by_record = [test.error_parts[name] for test in tests if name in test.error_parts]
    share = len(parts_by_record) / len(tests)
    if share < 0.5:
        refused = next(test.refused_contacts[name] for test in tests if name in test.refused_contacts)
        return Undetermined(
            name=name, determined_share=share, reason=refused.cause, remedy=refused.advice, code=refused.code
        )
    clearance, stiffness, damping = (_expected_quantity(draws) for draws in zip(*parts_by_record, strict=True))
    return ExpectedContact(
        name=name, determined_share=share, clearance_m=clearance, stiffness_n_per_m=stiffness, damping_n_s_per_m=damping
    )


def _expected_quantity(parts_by_record: Sequence[ErrorParts]) -> ExpectedQuantity:
    log_errors = np.log([max(parts.stated_error, np.finfo(float).tiny) for parts in parts_by_record])
    median_parts = sorted(parts_by_record, key=lambda parts: parts.stated_error)[len(parts_by_record) // 2]
    return ExpectedQuantity(
        value=parts_by_record[0].simulated_value,
        standard_error=float(np.exp(np.median(log_errors))) if median_parts.stated_error else 0.0,
        spread_factor=float(np.exp(np.std(log_errors, ddof=1))) if len(parts_by_record) > 1 else 1.0,
        limited_by=median_parts.source,
    )
