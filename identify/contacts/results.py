"""What an identification says: the structure of contact.json."""

import msgspec

from identify.checks.findings import Finding
from identify.contacts.refusals import RefusalCode, RemedyCode


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
    given where the zero of eta is known."""

    name: str
    clearance_m: Estimate
    stiffness_n_per_m: Estimate
    damping_n_s_per_m: Estimate
    lower_clearance_m: Estimate | None = None
    upper_clearance_m: Estimate | None = None


class Unanswered(msgspec.Struct, frozen=True, omit_defaults=True):
    """A contact that this record does not determine: the reason in words, and by code with its evidence and remedy."""

    name: str
    reason: str
    code: RefusalCode | None = None
    """None in files of before there were codes."""
    remedy: RemedyCode | None = None
    evidence: dict[str, float | int | str] = {}


class Mode(msgspec.Struct, frozen=True):
    """A linear mode as the FRF of its modal equation shows it."""

    beam: str
    index: int
    frequency_hz: float
    damping_ratio: float


class Stiffness(msgspec.Struct, frozen=True):
    """A contact's stiffness over frequency in one modal equation: spectral mean of the real part, rms deviation."""

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
    """A contact's clearance by one method."""

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
    """How well the stations of a body give its modal coordinates."""

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
    """What a segment of a long record says by itself."""

    start_s: float
    end_s: float
    report: ContactReport


class Segments(msgspec.Struct, frozen=True):
    """segments.json."""

    segments: tuple[Segment, ...]
