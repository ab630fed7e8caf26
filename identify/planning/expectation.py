"""Expected standard errors of a planned test: those of `identify contact` on simulated records of it.

Notes for maintainers
1. The rig is simulated as described, under drawn forces, with the noise, range and filters of its sensors. The
   separation and fits of `identify contact`, of a rig in space those of its rings, then state their standard errors,
   tolerances included.
2. A record is simulated up to a length. A longer test leaves the variance by tolerances and by the law's form as it
   is, and divides the rest (scatter and slow motion) by the ratio of the lengths.
3. `identify contact` widens its intervals by the pulls of body and force parameters, which chance moves from record to
   record. The factor is kept apart: it counts in what is expected, and not where tests are compared.
4. The median over several drawn forces is expected; their spread says how far a single test may lie from it.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from identify.contacts.acceptance import estimated_contacts
from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_law import RING
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_fit import FORMS_BESIDE_DEAD_ZONE
from identify.contacts.law_form import DAMPING_GRADIENT, STIFFNESS_GRADIENT, parameters_of_law
from identify.contacts.refusals import ContactRefusedError, Refusal, RefusalCode, RemedyCode
from identify.contacts.space_contacts import check_both_directions_measured, space_contacts
from identify.planning.planned_test import PlannedTest, simulated_recording
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig
from rig.model.tolerances import Tolerances
from rig.recording import Recording
from rig.recording.interfaces import Simulate

VarianceSource = Literal["scatter", "slow motion", "tolerances", "law"]
"""Source of the larger part of a variance."""
QUANTITIES = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m")
RING_QUANTITIES = (*QUANTITIES, "friction_coefficient")
CENTER_QUANTITIES = ("center_y_m", "center_z_m")
"""Quantities of every contact, of an annular one, and of one whose centre the record tells."""
MAX_MISS_STANDARD_ERRORS = 3.5
"""Standard errors by which an estimate may miss the value that was simulated before it is noted."""


class ErrorParts(msgspec.Struct, frozen=True, kw_only=True):
    """Simulated value, estimate, and parts of its variance, in squares of the quantity's unit; widening_factor is that
    of the standard error by the pulls of nuisance parameters. The simulated value of a centre against the rest
    position, which rig.json does not say, is its estimate."""

    simulated_value: float
    estimate: float
    scatter_variance: float
    slow_motion_variance: float
    tolerance_variance: float
    law_variance: float
    widening_factor: float

    @property
    def widened_standard_error(self) -> float:
        """Standard error that is stated, with its factor."""
        return self.widening_factor * self.standard_error

    @property
    def standard_error(self) -> float:
        """Standard error without its factor."""
        return float(
            np.sqrt(self.scatter_variance + self.slow_motion_variance + self.tolerance_variance + self.law_variance)
        )

    @property
    def source(self) -> VarianceSource:
        """Largest part of the variance."""
        variances: dict[VarianceSource, float] = {
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
    """Outcome of one simulated record: errors by contact and quantity, and refused contacts."""

    error_parts: dict[str, dict[str, ErrorParts]]
    refused_contacts: dict[str, RefusedContact]


class ExpectedQuantity(msgspec.Struct, frozen=True, kw_only=True):
    """Believed value and expected standard error of a quantity, in the unit of its name; the factor by which the
    standard error of a single record may lie above or below (one standard deviation over the simulated records); the
    largest part of its variance."""

    value: float
    standard_error: float
    spread_factor: float
    limited_by: VarianceSource


class ExpectedContact(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Expected estimates of a contact, and the share of the simulated records that determine it. Clearance is half the
    total play, that of the one stop that is touched, or the radial one of an annular contact."""

    name: str
    determined_share: float
    clearance_m: ExpectedQuantity
    stiffness_n_per_m: ExpectedQuantity
    damping_n_s_per_m: ExpectedQuantity
    friction_coefficient: ExpectedQuantity | None = None
    """Of an annular contact, as are all that follow."""
    center_y_m: ExpectedQuantity | None = None
    """Centre as in contact.json, None where it will not be known; its value is an estimate of a simulated record."""
    center_z_m: ExpectedQuantity | None = None

    @property
    def quantities(self) -> dict[str, ExpectedQuantity]:
        """Expected quantities by name, without those that are not told."""
        quantities = ((name, getattr(self, name)) for name in (*RING_QUANTITIES, *CENTER_QUANTITIES))
        return {name: quantity for name, quantity in quantities if quantity is not None}


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
        recording = simulated_recording(short_test, rig, simulate, seed)
        try:
            estimates, refusals = _estimates_and_refusals(recording, test.tolerances)
        except ContactRefusedError as error:
            return SimulatedTest({}, {contact.name: _refused_contact(error.refusal) for contact in rig.contacts})
    length_ratio = test.duration_s / simulated_s
    laws = {contact.name: contact.law for contact in rig.contacts}
    return SimulatedTest(
        {
            name: {
                quantity: _error_parts(laws[name], quantity, gradient, estimate).for_longer_record(length_ratio)
                for quantity, gradient in _gradient_by_quantity(estimate).items()
            }
            for name, estimate in estimates.items()
        },
        {name: _refused_contact(refusal) for name, refusal in refusals.items()},
    )


def expected_contacts(rig: Rig, tests: Sequence[SimulatedTest]) -> tuple[ExpectedContact | Undetermined, ...]:
    """Expectation of every contact over several simulated records."""
    return tuple(_expected_contact(contact.name, tests) for contact in rig.contacts)


def largest_error_z_and_contact(tests: Sequence[SimulatedTest]) -> tuple[float, str]:
    """Largest difference between an estimate and the simulated value in standard errors, and the contact's name."""
    misses_and_contacts = [
        (abs(error_parts.estimate - error_parts.simulated_value) / error_parts.widened_standard_error, name)
        for test in tests
        for name, parts_by_quantity in test.error_parts.items()
        for error_parts in parts_by_quantity.values()
        if error_parts.widened_standard_error > 0
    ]
    return max(misses_and_contacts, default=(0.0, ""))


def _refused_contact(refusal: Refusal) -> RefusedContact:
    return RefusedContact(refusal.cause, refusal.advice, refusal.code, refusal.remedy)


def _estimates_and_refusals(
    recording: Recording, tolerances: Tolerances
) -> tuple[Mapping[str, JointEstimate | AnnularEstimate], Mapping[str, Refusal]]:
    """Estimates and refusals of `identify contact` by contact, of a plane rig or of one in space."""
    if not recording.rig.in_space:
        outcomes = estimated_contacts(recording, "auto", tolerances, FORMS_BESIDE_DEAD_ZONE).outcomes
        return outcomes.estimates, outcomes.refusals
    check_both_directions_measured(recording.rig, "auto")
    identified = space_contacts(recording, "auto", tolerances)
    return {**identified.annular, **identified.plane.estimates}, {**identified.refusals, **identified.plane.refusals}


def _gradient_by_quantity(estimate: JointEstimate | AnnularEstimate) -> dict[str, Float[np.ndarray, " parameters"]]:
    """Every quantity that an estimate tells, as a linear function of its parameters."""
    if isinstance(estimate, JointEstimate):
        gradients = (estimate.clearance_gradient, STIFFNESS_GRADIENT, DAMPING_GRADIENT)
        return dict(zip(QUANTITIES, gradients, strict=True))
    quantity_names = (*RING_QUANTITIES, *CENTER_QUANTITIES) if estimate.center_known else RING_QUANTITIES
    return {quantity: np.eye(len(RING))[RING.index(quantity)] for quantity in quantity_names}


def _error_parts(
    law: ContactLaw,
    quantity: str,
    gradient: Float[np.ndarray, " parameters"],
    estimate: JointEstimate | AnnularEstimate,
) -> ErrorParts:
    estimated_value = float(gradient @ estimate.values)
    if isinstance(estimate, JointEstimate):
        simulated_value = float(gradient @ parameters_of_law(law))
    else:
        simulated_value = estimated_value if quantity in CENTER_QUANTITIES else getattr(law, quantity)
    scatter_variance, slow_motion_variance, tolerance_variance, law_variance = (
        float(gradient @ estimate.covariances[source] @ gradient) / estimate.widening_factor**2
        for source in ("scatter", "drift", "tolerances", "law")
    )
    return ErrorParts(
        simulated_value=simulated_value,
        estimate=estimated_value,
        scatter_variance=scatter_variance,
        slow_motion_variance=slow_motion_variance,
        tolerance_variance=tolerance_variance,
        law_variance=law_variance,
        widening_factor=estimate.widening_factor,
    )


def _expected_contact(name: str, tests: Sequence[SimulatedTest]) -> ExpectedContact | Undetermined:
    parts_by_record = [test.error_parts[name] for test in tests if name in test.error_parts]
    determined_share = len(parts_by_record) / len(tests)
    if determined_share < 0.5:
        refusal = next(test.refused_contacts[name] for test in tests if name in test.refused_contacts)
        return Undetermined(
            name=name, determined_share=determined_share, reason=refusal.cause, remedy=refusal.advice, code=refusal.code
        )
    parts_by_quantity: dict[str, list[ErrorParts]] = {}
    for parts_of_record in parts_by_record:
        for quantity, parts in parts_of_record.items():
            parts_by_quantity.setdefault(quantity, []).append(parts)
    expected_quantities = {
        quantity: _expected_quantity(quantity_parts)
        for quantity, quantity_parts in parts_by_quantity.items()
        if len(quantity_parts) >= len(parts_by_record) / 2
    }
    return ExpectedContact(name=name, determined_share=determined_share, **expected_quantities)


def _expected_quantity(record_parts: Sequence[ErrorParts]) -> ExpectedQuantity:
    log_stated_errors = np.log(
        [max(error_parts.widened_standard_error, np.finfo(float).tiny) for error_parts in record_parts]
    )
    median_parts = sorted(record_parts, key=lambda error_parts: error_parts.widened_standard_error)[
        len(record_parts) // 2
    ]
    return ExpectedQuantity(
        value=record_parts[0].simulated_value,
        standard_error=float(np.exp(np.median(log_stated_errors))) if median_parts.widened_standard_error else 0.0,
        spread_factor=float(np.exp(np.std(log_stated_errors, ddof=1))) if len(record_parts) > 1 else 1.0,
        limited_by=median_parts.source,
    )
