"""Structure of contact.json: the result of an identification."""

import msgspec

from identify.checks.findings import Finding
from identify.contacts.law_form import FormName
from identify.contacts.refusals import RefusalCode, RemedyCode
from identify.pages.wording import interval, number


class Estimate(msgspec.Struct, frozen=True, omit_defaults=True):
    """A value with the standard error of its estimate, both in the unit that the field's name says.

    own_error is the part of it that is this record's own (scatter and noise); the rest, which comes from what rig.json
    may have wrong, is the same in all records of a machine, and tells nothing of whether the machine changed.
    """

    value: float
    standard_error: float
    own_error: float | None = None


class ContactEstimate(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A contact. clearance_m is half the total play, or that of the one stop that is ever touched; the two sides are
    given where the zero of eta is known.

    law is the form that the record asks for. Of a power law k depth |depth / d|^(p - 1) the exponent p and the
    reference depth d stand beside it, and the stiffness k is the force over the depth at d.
    """

    name: str
    clearance_m: Estimate
    stiffness_n_per_m: Estimate
    damping_n_s_per_m: Estimate
    lower_clearance_m: Estimate | None = None
    upper_clearance_m: Estimate | None = None
    closed_share: float | None = None
    """Of the time of the record that is used; None where the stops' errors leave more than five points of doubt."""
    law: FormName = "dead zone"
    exponent: Estimate | None = None
    reference_depth_m: float | None = None

    @property
    def law_sentence(self) -> str:
        """Sentence on the law that the record asks for in place of a dead zone, without a full stop; else empty."""
        biased = "clearance, stiffness and damping of a dead zone would be biased"
        if self.exponent is not None and self.reference_depth_m is not None:
            depth_mm = number(1e3 * self.reference_depth_m)
            return (
                f"{self.name} follows a power law, k depth |depth / {depth_mm} mm|^(p - 1) with p = "
                f"{interval(self.exponent.value, self.exponent.standard_error, '1')}; its stiffness is the force over "
                f"the depth at {depth_mm} mm; {biased}"
            )
        if self.law == "cannot pull":
            return f"{self.name} cannot pull: its stops let go where damping would turn their force; {biased}"
        return ""


class Unanswered(msgspec.Struct, frozen=True, omit_defaults=True):
    """A contact that this record does not determine: the reason in words, and by code with its evidence and remedy."""

    name: str
    reason: str
    code: RefusalCode | None = None
    """None in files of before there were codes."""
    remedy: RemedyCode | None = None
    evidence: dict[str, float | int | str] = {}


class Mode(msgspec.Struct, frozen=True, omit_defaults=True):
    """A linear mode as the FRF of its modal equation shows it: without a known error.

    Contacts that act on its body and are not determined are in that response: the mode is that of the body with them.
    """

    beam: str
    index: int
    frequency_hz: float
    damping_ratio: float
    undetermined: tuple[str, ...] = ()

    @property
    def flag(self) -> str:
        """Finding in words; empty if there is none."""
        names = " and ".join(self.undetermined)
        return f"with {names} in it, not determined" if self.undetermined else ""


class Stiffness(msgspec.Struct, frozen=True):
    """A contact's stiffness over frequency in one modal equation: spectral mean of the real part, rms deviation.

    The standard error is the scatter of the blocks alone: it knows nothing of rig.json's errors nor of the modes left
    out, and is no interval of the stiffness.
    """

    contact: str
    mean_n_per_m: Estimate
    rms_deviation_n_per_m: float


class NifoResult(msgspec.Struct, frozen=True):
    """NIFO on one modal equation."""

    equation: str
    band_hz: tuple[float, float]
    resolution_hz: float
    averages: int
    stiffness: tuple[Stiffness, ...]
    nearly_invisible: tuple[str, ...]
    """Contacts that lie so near a node of this mode that the equation tells little of them, or nothing."""


class Clearance(msgspec.Struct, frozen=True):
    """A contact's clearance by one method. The standard error is the scatter alone, no interval of the clearance."""

    contact: str
    clearance_m: Estimate


class SurfaceResult(msgspec.Struct, frozen=True):
    """The clearances by the restoring force surface of one modal equation."""

    equation: str
    clearances: tuple[Clearance, ...]


class Surfaces(msgspec.Struct, frozen=True):
    """The clearances by the restoring force surfaces and by the histogram of the relative displacements."""

    surfaces: tuple[SurfaceResult, ...]
    histogram: tuple[Clearance, ...]


class TransformationResult(msgspec.Struct, frozen=True):
    """Quality of the transformation from a body's stations to its modal coordinates."""

    body: str
    stations: int
    modes: int
    condition_number: float
    lost_to_higher_modes: tuple[float, ...]
    """Per mode, the rms share of the coordinate that the modes beyond the fitted would falsify, were they left in."""


class ContactReport(msgspec.Struct, frozen=True, kw_only=True):
    """contact.json. No value is to be relied on where findings say what is wrong with record, rig.json or fit."""

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
    """What the accelerations' noise is taken from."""
    notes: tuple[str, ...] = ()
    """What could not be made beside the answers (NIFO, a surface, a figure), and why."""


class Segment(msgspec.Struct, frozen=True):
    """Result of one segment of a long record."""

    start_s: float
    end_s: float
    report: ContactReport


class Segments(msgspec.Struct, frozen=True):
    """segments.json."""

    segments: tuple[Segment, ...]
