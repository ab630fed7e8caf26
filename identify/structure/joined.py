"""Contacts between the same two places: sensors tell the sum of their forces alone, over one relative displacement."""

from dataclasses import dataclass

from msgspec.structs import replace

from rig.model.description import Contact, Rig


@dataclass(frozen=True)
class Joined:
    """Contacts of one pair of places, by their indices in the rig. signs are -1 where `at` and `against` are exchanged,
    so that the relative displacement is minus that of the first."""

    contact: Contact
    members: tuple[int, ...]
    signs: tuple[int, ...]


def joined_contacts(rig: Rig) -> tuple[Joined, ...]:
    """In the order of the first of each."""
    found: list[list[int]] = []
    contacts = rig.contacts
    for j, contact in enumerate(contacts):
        ends = {contact.at, contact.against}
        same = next((f for f in found if {contacts[f[0]].at, contacts[f[0]].against} == ends), None)
        if same is None:
            found.append([j])
        else:
            same.append(j)
    return tuple(
        Joined(
            replace(contacts[first], name=" + ".join(contacts[j].name for j in (first, *more))),
            (first, *more),
            tuple(1 if contacts[j].at == contacts[first].at else -1 for j in (first, *more)),
        )
        for first, *more in found
    )


def joined(rig: Rig) -> Rig:
    """The rig with one contact for each pair of places, which bears the names of all and the law of the first."""
    return replace(rig, contacts=tuple(j.contact for j in joined_contacts(rig)))
