"""What an identification found, as contact.json says it: the contacts' laws, to be drawn over those of a rig."""

from pathlib import Path

import msgspec

from rig.errors import RigError
from rig.files import contents
from rig.model.contact_laws import DeadZone
from rig.model.description import Rig


class _Value(msgspec.Struct, frozen=True):
    value: float


class _Contact(msgspec.Struct, frozen=True):
    name: str
    clearance_m: _Value
    stiffness_n_per_m: _Value
    damping_n_s_per_m: _Value
    lower_clearance_m: _Value | None = None
    upper_clearance_m: _Value | None = None


class _Report(msgspec.Struct, frozen=True):
    contacts: tuple[_Contact, ...]


def identified_laws(path: Path, rig: Rig) -> dict[str, DeadZone]:
    """The laws in a contact.json, by contact; both sides are the clearance where they are not told apart.

    Raises RigError if the file cannot be read, is no contact.json, or names a contact that the rig does not have.
    """
    try:
        report = msgspec.json.decode(contents(path), type=_Report)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RigError(f"{path}: is no contact.json ({error}); make one by `identify contact`") from error
    names = [c.name for c in rig.contacts]
    for found in report.contacts:
        if found.name not in names:
            raise RigError(f"{path}: has a contact {found.name!r}, the rig has {', '.join(names)}; take another file")
    try:
        return {c.name: _law(c) for c in report.contacts}
    except RigError as error:
        raise RigError(f"{path}: {error}") from error


def _law(found: _Contact) -> DeadZone:
    return DeadZone(
        lower_clearance_m=(found.lower_clearance_m or found.clearance_m).value,
        upper_clearance_m=(found.upper_clearance_m or found.clearance_m).value,
        stiffness_n_per_m=found.stiffness_n_per_m.value,
        damping_n_s_per_m=max(0.0, found.damping_n_s_per_m.value),  # an estimate may lie below zero
    )
