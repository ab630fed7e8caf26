"""Contacts between the same two places are one, whichever way round they are counted."""

import numpy as np
from msgspec.structs import replace

from identify.linear.joined import contact_groups, group_laws, rig_with_joined_contacts
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, Station
from tests.campaigns.topologies import chain

ONE, OTHER = Station("mass 1"), Station("mass 2")
SOFT = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=2e-3, stiffness_n_per_m=1e3)
HARD = DeadZone(lower_clearance_m=5e-3, upper_clearance_m=3e-3, stiffness_n_per_m=1e4)
RIG = replace(
    chain(2, "displacement", ground=True),
    contacts=(
        Contact(name="soft", at=ONE, against=OTHER, law=SOFT),
        Contact(name="wall", at=OTHER, against=None, law=SOFT),
        Contact(name="hard", at=OTHER, against=ONE, law=HARD),
    ),
)


def test_contacts_of_one_pair_of_places_are_one():
    assert [(j.contact_indices, j.signs) for j in contact_groups(RIG)] == [((0, 2), (1, -1)), ((1,), (1,))]
    assert [(c.name, c.at, c.against) for c in rig_with_joined_contacts(RIG).contacts] == [
        ("soft + hard", ONE, OTHER),
        ("wall", OTHER, None),
    ]


def test_the_law_of_one_that_is_counted_the_other_way_round_is_turned():
    """By hand: seen from mass 1 the hard stops stand 3 mm below and 5 mm above."""
    law, _ = group_laws(RIG)
    eta_m = 1e-3 * np.array([-4.0, -2.0, 0.0, 1.9, 4.0, 6.0])
    assert np.allclose(law.force_n(eta_m), [-3.0 - 10.0, -1.0, 0.0, 0.0, 2.0, 4.0 + 10.0])
    assert law.clearances_m == (1e-3, 2e-3)
