"""Where an unmeasured force is the rival of an effect, and where its companion."""

import pytest

from identify.gaps.decision.verdict import acts_where_they_do
from identify.gaps.unmeasured_force.location import ForcePlace
from rig.effects import effect_named
from rig.model.description import Station
from rig.simulation.reference import BarrelCradle

RIG = BarrelCradle(sensors="acceleration", noise_density=1e-3).rig()


@pytest.mark.parametrize(
    ("effect", "force", "same"),
    [
        ("linear_spring:relative_position=0.8,body=cradle", ForcePlace("force", (Station("cradle", 0.82),)), True),
        ("linear_spring:relative_position=0.8,body=cradle", ForcePlace("force", (Station("cradle", 0.5),)), False),
        ("linear_spring:relative_position=0.8,body=cradle", ForcePlace("force", (Station("barrel", 0.8),)), False),
        ("sensor_gain:sensor={sensor},factor=1.1", ForcePlace("sensor", sensor="{sensor}"), True),
        ("common_gain:factor=1.1", ForcePlace("sensor", sensor="{sensor}"), False),
        ("youngs_modulus:factor=1.1", ForcePlace("distributed", bodies=("cradle",)), False),
    ],
)
def test_a_force_at_the_place_of_an_effect_is_its_rival(effect, force, same):
    sensor = RIG.sensors[3].name
    rig = effect_named(effect.format(sensor=sensor)).applied_to(RIG)
    if force.sensor:
        force = ForcePlace("sensor", sensor=sensor)
    assert acts_where_they_do(force, RIG, rig) is same


def test_a_pair_of_forces_at_a_contact_is_the_rival_of_another_law():
    rig = effect_named("contact_clearance:factor=1.1,contact=contact_1").applied_to(RIG)
    first, second = RIG.contacts
    assert acts_where_they_do(ForcePlace("pair", (first.at, first.against)), RIG, rig)
    assert not acts_where_they_do(ForcePlace("pair", (second.at, second.against)), RIG, rig)
