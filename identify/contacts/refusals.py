"""Refusals: codes for why a record does not determine a contact, their evidence and remedies, and their sentences."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from identify.pages.wording import record_length_words
from rig.errors import RigError

Evidence = Mapping[str, float | int | str]
"""Numbers and words by their names in the sentence of a code."""


class RemedyCode(StrEnum):
    """Remedies of refusals."""

    DESCRIBE_CONTACTS = "describe_contacts"
    LEAVE_OUT_ATTACHMENTS = "leave_out_attachments"
    MEASURE_BASE = "measure_base"
    MEASURE_BOTH_DIRECTIONS = "measure_both_directions"
    ADD_SENSOR = "add_sensor"
    ADD_ACCELEROMETER = "add_accelerometer"
    RECORD_LONGER_OR_FROM_REST = "record_longer_or_from_rest"
    RECORD_LONGER_FROM_REST_OR_DISPLACEMENTS = "record_longer_from_rest_or_displacements"
    CHECK_CHANNELS = "check_channels"
    RECORD_FORCE_OR_RELEASE = "record_force_or_release"
    DESCRIBE_FEWER_CONTACTS = "describe_fewer_contacts"
    CHECK_DISPLACEMENT_SENSOR = "check_displacement_sensor"
    EXCITE_MORE = "excite_more"
    EXCITE_MORE_OR_QUIETER = "excite_more_or_quieter"
    EXCITE_MORE_OR_DISPLACEMENTS = "excite_more_or_displacements"
    EXCITE_MORE_OR_CHECK_RIG = "excite_more_or_check_rig"
    CHECK_NOISE_OR_EXCITE_MORE = "check_noise_or_excite_more"
    RECORD_LONGER_OR_OTHER_FORCE = "record_longer_or_other_force"
    RECORD_LONGER_OR_EXCITE_MORE = "record_longer_or_excite_more"
    EXCITE_MORE_OR_SEPARATE_STOPS = "excite_more_or_separate_stops"
    SEPARATE_STOPS = "separate_stops"
    DESCRIBE_SPRING = "describe_spring"


class RefusalCode(StrEnum):
    """Causes for which a contact, or all contacts of a record, cannot be determined."""

    NO_CONTACTS = "no_contacts"
    NOT_MODELLED = "not_modelled"
    BASE_MOTION = "base_motion"
    ONE_DIRECTION = "one_direction"
    NO_SENSOR = "no_sensor"
    NO_ACCELEROMETER = "no_accelerometer"
    TOO_SHORT = "too_short"
    ALL_ZERO = "all_zero"
    FORCE_NOT_RECORDED = "force_not_recorded"
    TOO_MANY_CONTACTS = "too_many_contacts"
    STANDS_STILL = "stands_still"
    HARDLY_CLOSES = "hardly_closes"
    ONE_STOP_TOUCHED = "one_stop_touched"
    NOT_REACHED = "not_reached"
    NO_STIFFNESS = "no_stiffness"
    NO_LAW = "no_law"
    DRIFT_TOO_LARGE = "drift_too_large"
    DRIFT_NOT_BRIDGED = "drift_not_bridged"
    UNCERTAIN = "uncertain"
    NOT_SEPARABLE = "not_separable"
    INTERCHANGEABLE = "interchangeable"
    NO_GAP = "no_gap"


REMEDIES: Mapping[RemedyCode, str] = {
    RemedyCode.DESCRIBE_CONTACTS: "describe them in rig.json",
    RemedyCode.LEAVE_OUT_ATTACHMENTS: "leave it out: it takes beams, structures and masses "
    "with point masses, linear springs, supports and clamps; identify gap takes the others",
    RemedyCode.MEASURE_BASE: "measure how the base shakes by a sensor on the ground, or hold it still and "
    "measure an exciting force",
    RemedyCode.MEASURE_BOTH_DIRECTIONS: "measure both directions at both sides of the contact, by two-axis sensors; or "
    "describe it as a dead zone, if the bodies move in one direction alone",
    RemedyCode.ADD_SENSOR: "put a sensor there",
    RemedyCode.ADD_ACCELEROMETER: "put an accelerometer there",
    RemedyCode.RECORD_LONGER_OR_FROM_REST: "record longer, or begin with a quarter second at rest without force",
    RemedyCode.RECORD_LONGER_FROM_REST_OR_DISPLACEMENTS: "record longer, or begin with a quarter second at rest "
    "without force, or measure displacements",
    RemedyCode.CHECK_CHANNELS: "look at their channels",
    RemedyCode.RECORD_FORCE_OR_RELEASE: "record the force that moves the rig (of a base that shakes its motion, by a "
    "sensor on the ground), or let the record begin when the rig has been released",
    RemedyCode.DESCRIBE_FEWER_CONTACTS: "describe them as fewer",
    RemedyCode.CHECK_DISPLACEMENT_SENSOR: "look for a dead displacement sensor",
    RemedyCode.EXCITE_MORE: "excite the rig more strongly",
    RemedyCode.EXCITE_MORE_OR_QUIETER: "excite the rig more strongly, or take quieter sensors",
    RemedyCode.EXCITE_MORE_OR_DISPLACEMENTS: "excite the rig more strongly, or measure displacements",
    RemedyCode.EXCITE_MORE_OR_CHECK_RIG: "excite the rig more strongly, or check rig.json",
    RemedyCode.CHECK_NOISE_OR_EXCITE_MORE: "check their noise and gains, or excite the rig more strongly",
    RemedyCode.RECORD_LONGER_OR_OTHER_FORCE: "record longer, excite the rig more strongly, or measure displacements at "
    "its places; if it never opens, give it the law of a spring",
    RemedyCode.RECORD_LONGER_OR_EXCITE_MORE: "record longer, or excite the rig more strongly; if it never opens, give "
    "it the law of a spring",
    RemedyCode.EXCITE_MORE_OR_SEPARATE_STOPS: "excite the rig more strongly, use stops that differ more, or measure "
    "the force at one of them",
    RemedyCode.SEPARATE_STOPS: "let clearances or stiffnesses in rig.json differ as theirs do, use stops that differ "
    "more, or measure the force at one of them",
    RemedyCode.DESCRIBE_SPRING: 'if it is a spring, give it that law, "law": {"type": "spring", "stiffness_n_per_m": '
    "...}; if it is a stop, its clearance",
}

CAUSES: Mapping[RefusalCode, tuple[str, RemedyCode]] = {
    RefusalCode.NO_CONTACTS: ("rig {rig!r} has no contacts", RemedyCode.DESCRIBE_CONTACTS),
    RefusalCode.NOT_MODELLED: (
        "rig.json of {rig!r} has {what}, which the identification does not know",
        RemedyCode.LEAVE_OUT_ATTACHMENTS,
    ),
    RefusalCode.BASE_MOTION: (
        "rig.json of {rig!r} has base_motion, and no sensor on the ground measures it",
        RemedyCode.MEASURE_BASE,
    ),
    RefusalCode.ONE_DIRECTION: (
        "contact {contact!r} is annular, and {body!r} has no sensor in {direction}: where in its ring the contact is "
        "touched cannot be told",
        RemedyCode.MEASURE_BOTH_DIRECTIONS,
    ),
    RefusalCode.NO_SENSOR: (
        "contact {contact!r} has no sensor at {position_m} m of {body!r}, and the body has more modes than stations "
        "({stations}): its displacement there cannot be told",
        RemedyCode.ADD_SENSOR,
    ),
    RefusalCode.NO_ACCELEROMETER: (
        "contact {contact!r} has no sensor at {position_m} m of {body!r}: its drift cannot be told",
        RemedyCode.ADD_ACCELEROMETER,
    ),
    RefusalCode.TOO_SHORT: (
        "the record lasts {duration_s:.3g} s and does not begin at rest: {at_start_s:.3g} s at its start and "
        "{at_end_s:.3g} s at its end cannot be used",
        RemedyCode.RECORD_LONGER_OR_FROM_REST,
    ),
    RefusalCode.ALL_ZERO: ("the force and all sensors are zero throughout", RemedyCode.CHECK_CHANNELS),
    RefusalCode.FORCE_NOT_RECORDED: (
        "the exciting force is zero throughout, and this is no free decay: {unexplained_percent:.2g} % of {contact}'s "
        "force follow from no clearance and stiffness",
        RemedyCode.RECORD_FORCE_OR_RELEASE,
    ),
    RefusalCode.TOO_MANY_CONTACTS: (
        "{contacts} stand between the same places, of which a record tells {at_most} at most",
        RemedyCode.DESCRIBE_FEWER_CONTACTS,
    ),
    RefusalCode.STANDS_STILL: ("its relative displacement stands still", RemedyCode.CHECK_DISPLACEMENT_SENSOR),
    RefusalCode.HARDLY_CLOSES: (
        "it hardly ever closes in this record, or not visibly above the noise",
        RemedyCode.EXCITE_MORE_OR_QUIETER,
    ),
    RefusalCode.ONE_STOP_TOUCHED: (
        "only one of its stops is clearly touched, so its play cannot be told",
        RemedyCode.EXCITE_MORE_OR_DISPLACEMENTS,
    ),
    RefusalCode.NOT_REACHED: (
        "its stops, by rig.json {stop_mm:.3g} mm away, are not reached: the relative displacement goes to "
        "{reach_mm:.3g} mm",
        RemedyCode.EXCITE_MORE,
    ),
    RefusalCode.NO_STIFFNESS: ("no force grows with this relative displacement", RemedyCode.EXCITE_MORE_OR_CHECK_RIG),
    RefusalCode.NO_LAW: ("its closures tell no law of it", RemedyCode.EXCITE_MORE),
    RefusalCode.DRIFT_TOO_LARGE: (
        "the drift that would explain it is larger than the noise of the accelerometers allows",
        RemedyCode.CHECK_NOISE_OR_EXCITE_MORE,
    ),
    RefusalCode.DRIFT_NOT_BRIDGED: (
        "it closes too rarely for accelerometers to bridge the time between (their noise wanders by {wander_um:.0f} "
        "um, the penetration is {penetration_um:.0f} um)",
        RemedyCode.EXCITE_MORE_OR_DISPLACEMENTS,
    ),
    RefusalCode.UNCERTAIN: (
        "its {quantity} is uncertain by {uncertain_percent:.0f} % or more",
        RemedyCode.RECORD_LONGER_OR_OTHER_FORCE,
    ),
    RefusalCode.NOT_SEPARABLE: (
        "its force and that of another contact between the same places cannot be told apart: their knees coincide, or "
        "not all of their stops are reached",
        RemedyCode.EXCITE_MORE_OR_SEPARATE_STOPS,
    ),
    RefusalCode.INTERCHANGEABLE: (
        "the record does not tell which of the knees is its own and which that of another contact between the same "
        "places: by rig.json, of which clearances are taken to be sure to 20 % and stiffnesses to a factor of two, "
        "they may as well be exchanged",
        RemedyCode.SEPARATE_STOPS,
    ),
    RefusalCode.NO_GAP: (
        "rig.json gives it stops with clearances of zero, and the record shows no gap either",
        RemedyCode.DESCRIBE_SPRING,
    ),
}
"""Cause, with its evidence in braces, and usual remedy by code."""
PERHAPS_UNRECORDED = "the exciting force is zero throughout: unless this is a free decay, record it"


@dataclass(frozen=True)
class Refusal:
    """Refusal to determine a contact, or all contacts of a record.

    unforced: the record's force is zero throughout, which may be the cause. length_ratio is the length over that of
    this record from which it determines the contact, where that is known.
    """

    code: RefusalCode
    evidence: Evidence
    remedy: RemedyCode
    unforced: bool = field(default=False, kw_only=True)
    length_ratio: float | None = field(default=None, kw_only=True)

    @property
    def advice(self) -> str:
        """Remedy as a part of a sentence."""
        return REMEDIES[self.remedy].replace("record longer", f"record {record_length_words(self.length_ratio)}")

    @property
    def cause(self) -> str:
        """Cause as a part of a sentence."""
        return CAUSES[self.code][0].format_map(self.evidence)

    @property
    def sentence(self) -> str:
        """Cause and remedy, without a full stop."""
        return "; ".join([*([PERHAPS_UNRECORDED] if self.unforced else []), self.cause, self.advice])


class ContactRefusedError(RigError):
    """Error of a record that does not determine its contacts; `refusal` says why."""

    def __init__(self, refusal: Refusal, note: str = "") -> None:
        super().__init__(f"{refusal.sentence} {note}".rstrip())
        self.refusal = refusal

    def with_note(self, note: str) -> "ContactRefusedError":
        """Error with a note behind its sentence."""
        return ContactRefusedError(self.refusal, note)


def refused(
    code: RefusalCode,
    remedy: RemedyCode | None = None,
    length_ratio: float | None = None,
    **evidence: float | int | str,
) -> ContactRefusedError:
    """Error to raise for a code, with its usual remedy if none is given."""
    return ContactRefusedError(Refusal(code, evidence, remedy or CAUSES[code][1], length_ratio=length_ratio))
