"""Contacts between the same two places: sensors show only the sum of their forces, over one relative displacement."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from rig.model.contact_laws import ContactLaw
from rig.model.description import Contact, Rig, Station

Values = Float[np.ndarray, "*shape"]


@dataclass(frozen=True)
class ContactGroup:
    """Contacts of one pair of places, by their indices in the rig.

    signs are -1 where `at` and `against` are exchanged: the relative displacement is then minus that of the first
    contact.
    """

    joined_contact: Contact
    contact_indices: tuple[int, ...]
    signs: tuple[int, ...]


def contact_groups(rig: Rig) -> tuple[ContactGroup, ...]:
    """Contacts joined by pair of places, in the order of the first contact of each pair."""
    contacts = rig.contacts
    indices_by_places: dict[frozenset[Station | None], list[int]] = {}
    for j, contact in enumerate(contacts):
        indices_by_places.setdefault(frozenset({contact.at, contact.against}), []).append(j)
    groups = []
    for contact_indices in indices_by_places.values():
        first_contact = contacts[contact_indices[0]]
        joined_contact = replace(first_contact, name=" + ".join(contacts[j].name for j in contact_indices))
        signs = tuple(1 if contacts[j].at == first_contact.at else -1 for j in contact_indices)
        groups.append(ContactGroup(joined_contact, tuple(contact_indices), signs))
    return tuple(groups)


def rig_with_joined_contacts(rig: Rig) -> Rig:
    """Rig with one contact for each pair of places, which has the names of all and the law of the first."""
    return replace(rig, contacts=tuple(group.joined_contact for group in contact_groups(rig)))


@dataclass(frozen=True)
class GroupLaw:
    """Sum of the laws of the contacts of one pair of places, over the relative displacement of the first."""

    laws: tuple[ContactLaw, ...]
    signs: tuple[int, ...]

    @property
    def clearances_m(self) -> tuple[float, float]:
        """Clearances of the nearest stops below and above, m."""
        law_sign_pairs = zip(self.laws, self.signs, strict=True)
        clearance_pairs_m = [(law.lower_clearance_m, law.upper_clearance_m)[::sign] for law, sign in law_sign_pairs]
        lower_m, upper_m = zip(*clearance_pairs_m, strict=True)
        return min(lower_m), min(upper_m)

    def force_n(self, eta_m: Values, rate_m_per_s: Values | float = 0.0, time_s: Values | float = 0.0) -> Values:
        """Sum of the contact forces, N."""
        sign_laws = zip(self.signs, self.laws, strict=True)
        return np.asarray(sum(sign * law.force_n(sign * eta_m, sign * rate_m_per_s, time_s) for sign, law in sign_laws))


def group_laws(rig: Rig) -> tuple[GroupLaw, ...]:
    """Laws of every pair of places."""
    groups, contacts = contact_groups(rig), rig.contacts
    return tuple(GroupLaw(tuple(contacts[j].law for j in group.contact_indices), group.signs) for group in groups)
