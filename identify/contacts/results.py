"""Structure of contact.json, and the rig with the identified contacts."""

from collections.abc import Mapping

import msgspec
import numpy as np
from msgspec.structs import replace

from identify.checks.findings import Finding
from identify.contacts.law_form import EXPONENT_RANGE, FormName
from identify.contacts.refusals import Refusal, RefusalCode, RemedyCode
from identify.contacts.ring_shares import RingShares
from identify.pages.wording import interval, number
from rig.limits import SCHEMA_VERSION
from rig.model.contact_laws import AnyLaw, DeadZone
from rig.model.contact_laws.annular import Annular
from rig.model.description import Rig
from rig.model.tolerances import LABORATORY


class Estimate(msgspec.Struct, frozen=True, omit_defaults=True):
    """Value and standard error of an estimate, both in the unit in the name of its field.

    own_error is the standard error by this record's scatter and noise alone. The rest comes from errors of rig.json, is
    the same in all records of a machine, and does not count when these are compared.
    """

    value: float
    standard_error: float
    own_error: float | None = None


class ContactEstimate(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Estimates of a contact. clearance_m is half the total play, or the clearance of the only touched stop; the two
    sides are given where the zero of eta is known. A spring has none: zero.

    law is the form that the record supports. A power law k depth |depth / d|^(p - 1) also has its exponent p and its
    reference depth d, and its stiffness k is the force over the depth at d. The clearance of an annular contact is its
    radial one.
    """

    name: str
    clearance_m: Estimate
    stiffness_n_per_m: Estimate
    damping_n_s_per_m: Estimate
    lower_clearance_m: Estimate | None = None
    upper_clearance_m: Estimate | None = None
    closed_share: float | None = None
    """Share of the used time; None where the stops' errors leave more than five percentage points of doubt."""
    law: FormName = "dead zone"
    exponent: Estimate | None = None
    reference_depth_m: float | None = None
    friction_coefficient: Estimate | None = None
    """Of an annular contact, as are all that follow."""
    sliding_speed_m_per_s: Estimate | None = None
    """Speed along the wall at which friction turns round, v_0."""
    center_y_m: Estimate | None = None
    """Centre against the relative displacement at rest, or by sensors of displacement against their zero; None where
    neither is known."""
    center_z_m: Estimate | None = None
    rest_force_y_n: Estimate | None = None
    """Contact force before the record begins."""
    rest_force_z_n: Estimate | None = None
    ring: RingShares | None = None
    """Shares of free, sliding, sticking and whirling motion."""

    @property
    def is_spring(self) -> bool:
        """True of a spring without stops, whose clearance is zero by its description."""
        return self.law == "spring"

    @property
    def law_sentence(self) -> str:
        """Sentence on a law that is no dead zone, without a full stop; else empty."""
        if self.ring is not None:
            return f"{self.name} is annular: {self._annular_words}; {self.ring.sentence}"
        bias_words = "clearance, stiffness and damping of a dead zone would be biased"
        if self.exponent is not None and self.reference_depth_m is not None:
            depth_mm = number(1e3 * self.reference_depth_m)
            return (
                f"{self.name} follows a power law, k depth |depth / {depth_mm} mm|^(p - 1) with p = "
                f"{interval(self.exponent.value, self.exponent.standard_error, '1')}; its stiffness is the force over "
                f"the depth at {depth_mm} mm; {bias_words}"
            )
        if self.law == "cannot pull":
            return f"{self.name} cannot pull: its stops let go where damping would turn their force; {bias_words}"
        return ""

    @property
    def _annular_words(self) -> str:
        """Friction and centre of an annular contact in words."""
        clauses, friction, sliding_speed = [], self.friction_coefficient, self.sliding_speed_m_per_s
        if friction is not None and sliding_speed is not None:
            clauses.append(
                f"friction coefficient {interval(friction.value, friction.standard_error, '1')}, sliding speed "
                f"{interval(1e3 * sliding_speed.value, 1e3 * sliding_speed.standard_error, 'mm/s')}"
            )
        if self.center_y_m is None or self.center_z_m is None:
            return "; ".join([*clauses, "its centre is not known, as it does not rest in the ring"])
        y, z = (interval(1e3 * c.value, 1e3 * c.standard_error, "mm") for c in (self.center_y_m, self.center_z_m))
        return "; ".join([*clauses, f"its centre lies at y = {y}, z = {z} from the rest position"])


class Unanswered(msgspec.Struct, frozen=True, omit_defaults=True):
    """Contact that this record does not determine: the reason as a sentence, and as a code with evidence and remedy."""

    name: str
    reason: str
    code: RefusalCode | None = None
    """None in files of versions without codes."""
    remedy: RemedyCode | None = None
    evidence: dict[str, float | int | str] = {}


class Mode(msgspec.Struct, frozen=True, omit_defaults=True):
    """Linear mode by the FRF of its modal equation, without a known error.

    Undetermined contacts that act on its body are in that response: the mode is that of the body with them.
    """

    beam: str
    index: int
    frequency_hz: float
    damping_ratio: float
    undetermined: tuple[str, ...] = ()

    @property
    def flag(self) -> str:
        """Note on undetermined contacts; empty if there are none."""
        names = " and ".join(self.undetermined)
        return f"with {names} in it, not determined" if self.undetermined else ""


class Stiffness(msgspec.Struct, frozen=True):
    """Stiffness of a contact over frequency in one modal equation: spectral mean of the real part, rms deviation.

    The standard error is the scatter of the blocks alone. It does not cover errors of rig.json or omitted modes, and
    gives no interval of the stiffness.
    """

    contact: str
    mean_n_per_m: Estimate
    rms_deviation_n_per_m: float


class NifoResult(msgspec.Struct, frozen=True):
    """Result of NIFO on one modal equation."""

    equation: str
    band_hz: tuple[float, float]
    resolution_hz: float
    averages: int
    stiffness: tuple[Stiffness, ...]
    nearly_invisible: tuple[str, ...]
    """Contacts near a node of this mode, of which the equation shows little or nothing."""


class Clearance(msgspec.Struct, frozen=True):
    """Clearance of a contact by one method. The standard error is the scatter alone, no interval of the clearance."""

    contact: str
    clearance_m: Estimate


class SurfaceResult(msgspec.Struct, frozen=True):
    """Clearances by the restoring force surface of one modal equation."""

    equation: str
    clearances: tuple[Clearance, ...]


class Surfaces(msgspec.Struct, frozen=True):
    """Clearances by the restoring force surfaces and by the histogram of the relative displacements."""

    surfaces: tuple[SurfaceResult, ...]
    histogram: tuple[Clearance, ...]


class TransformationResult(msgspec.Struct, frozen=True):
    """Quality of the transformation from a body's stations to its modal coordinates."""

    body: str
    stations: int
    modes: int
    condition_number: float
    lost_to_higher_modes: tuple[float, ...]
    """Error of each modal coordinate by the modes beyond the fitted ones, were they not subtracted, as an rms share."""


class ContactReport(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of contact.json. With findings against record, rig.json or fit, no value is to be relied on."""

    rig: str
    contacts: tuple[ContactEstimate, ...]
    unanswered: tuple[Unanswered, ...]
    main_equation: str
    modes: tuple[Mode, ...]
    nifo: tuple[NifoResult, ...]
    surface: Surfaces
    transformation: tuple[TransformationResult, ...]
    trusted_hz: tuple[float, float]
    channels_used: tuple[str, ...]
    findings: tuple[Finding, ...] = ()
    noise_from: str = ""
    """Source of the accelerations' noise."""
    notes: tuple[str, ...] = ()
    """Methods and figures of the paper that could not be computed, and why."""
    schema_version: int = SCHEMA_VERSION


class Segment(msgspec.Struct, frozen=True):
    """Result of one segment of a long record."""

    start_s: float
    end_s: float
    report: ContactReport


class Segments(msgspec.Struct, frozen=True):
    """Contents of segments.json."""

    segments: tuple[Segment, ...]


def identified_rig(rig: Rig, report: ContactReport) -> Rig:
    """Rig with clearance, stiffness, damping and exponent of every identified contact; all else is nominal.

    Where only half the total play is known, the clearances are placed about the nominal middle of the play. Contacts
    that were unknown are known, with the usual tolerances, once each of them is identified.
    """
    estimate_by_name = {contact.name: contact for contact in report.contacts}
    contacts = tuple(
        replace(contact, law=_identified_law(contact.law, estimate_by_name[contact.name]))
        if contact.name in estimate_by_name
        else contact
        for contact in rig.contacts
    )
    tolerances = rig.tolerances
    if tolerances is not None and not tolerances.contacts_known and len(estimate_by_name) == len(rig.contacts):
        tolerances = replace(tolerances, clearance=LABORATORY.clearance, stiffness=LABORATORY.stiffness)
    return replace(rig, contacts=contacts, tolerances=tolerances)


def _identified_law(law: AnyLaw, estimate: ContactEstimate) -> AnyLaw:
    if isinstance(law, Annular):
        return _identified_annular_law(law, estimate)
    lower_m, upper_m = law.lower_clearance_m, law.upper_clearance_m
    if estimate.lower_clearance_m is None and estimate.upper_clearance_m is None:
        change_m = estimate.clearance_m.value - law.clearance_m  # a stop that is not there stays infinitely far away
        lower_m, upper_m = lower_m + change_m, upper_m + change_m
    if estimate.lower_clearance_m is not None:
        lower_m = estimate.lower_clearance_m.value
    if estimate.upper_clearance_m is not None:
        upper_m = estimate.upper_clearance_m.value
    if isinstance(law, DeadZone):
        exponent = 1.0 if estimate.exponent is None else float(np.clip(estimate.exponent.value, *EXPONENT_RANGE))
        depth_m = estimate.reference_depth_m or law.reference_depth_m
        law = replace(law, exponent=exponent, reference_depth_m=depth_m, pulls=estimate.law != "cannot pull")
    return replace(
        law,
        lower_clearance_m=max(0.0, lower_m),
        upper_clearance_m=max(0.0, upper_m),
        stiffness_n_per_m=max(0.0, estimate.stiffness_n_per_m.value),
        damping_n_s_per_m=max(0.0, estimate.damping_n_s_per_m.value),  # an estimate may lie below zero
    )


def _identified_annular_law(law: Annular, estimate: ContactEstimate) -> Annular:
    """Law with the identified numbers. The centre stays as in rig.json: where a record tells it, it is against the rest
    position."""
    friction, sliding_speed = estimate.friction_coefficient, estimate.sliding_speed_m_per_s
    return replace(
        law,
        clearance_m=estimate.clearance_m.value,
        stiffness_n_per_m=estimate.stiffness_n_per_m.value,
        damping_n_s_per_m=max(0.0, estimate.damping_n_s_per_m.value),
        friction_coefficient=law.friction_coefficient if friction is None else max(0.0, friction.value),
        sliding_speed_m_per_s=law.sliding_speed_m_per_s if sliding_speed is None else sliding_speed.value,
    )


def unanswered(refusals: Mapping[str, Refusal]) -> tuple[Unanswered, ...]:
    """Refusals as entries of a report."""
    return tuple(
        Unanswered(name, refusal.sentence, refusal.code, refusal.remedy, dict(refusal.evidence))
        for name, refusal in refusals.items()
    )
