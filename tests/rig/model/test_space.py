"""Rigs in space: their description, the plane rigs of it, the law of a ring, and what refuses them."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.contact_laws.annular import Annular
from rig.model.description import (
    BaseMotion,
    Contact,
    PointMass,
    PointSpring,
    Sensor,
    Station,
    contact_rows,
    from_json,
    rig_stations,
    to_json,
)
from rig.model.force_level import rattling_level
from rig.model.space import check_plane, in_plane, plane_rigs
from rig.simulation.plants.compiled_laws import law_records, vector_force_n
from rig.simulation.plants.stepwise import Stepwise
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof

RIG = BarrelCradleAnnular(sensors="acceleration").rig()
RING = Annular(
    clearance_m=1e-3,
    stiffness_n_per_m=1e5,
    damping_n_s_per_m=30.0,
    friction_coefficient=0.2,
    center_y_m=2e-4,
    center_z_m=-1e-4,
    wear_m_per_s=1e-5,
)
components = st.floats(-5e-3, 5e-3)
speeds = st.floats(-1, 1)


def test_old_descriptions_are_written_as_they_were():
    """Without directions, gravity and diameters: the keys of each object are those of before."""
    for rig in (BarrelCradle().rig(), Sdof().rig()):
        text = to_json(rig)
        decoded = json.loads(text)
        assert {*decoded["sensors"][0]["station"]} == {*decoded["force_at"]} == {"body", "position_m"}
        assert not {"gravity_m_per_s2", "outer_diameter_m"} & {*decoded, *decoded["bodies"][0]}
        assert from_json(text, "rig.json") == rig


def test_a_rig_in_space_comes_back_from_its_text():
    text = to_json(RIG)
    assert from_json(text, "rig.json") == RIG
    assert RIG.directions == ("y", "z")
    decoded = json.loads(text)
    assert decoded["force_at"][1] == {"body": "barrel", "position_m": 1.0, "direction": "z"}
    assert decoded["gravity_m_per_s2"] == 9.81
    assert not {"width_m", "thickness_m"} & {*decoded["bodies"][0]}


def test_the_plane_rigs_share_bodies_and_have_the_sensors_and_forces_of_their_direction():
    planes = plane_rigs(RIG)
    assert {s.name for plane in planes.values() for s in plane.sensors} == {s.name for s in RIG.sensors}
    for direction, plane in planes.items():
        assert not plane.in_space
        assert plane.bodies == RIG.bodies
        assert plane.force_at == Station("barrel", 1.0)
        assert [s.name for s in plane.sensors] == [s.name for s in RIG.sensors if s.station.direction == direction]
        assert [(c.name, c.at, c.against) for c in plane.contacts] == [(c.name, c.at, c.against) for c in RIG.contacts]
        assert plane.gravity_m_per_s2 == (9.81 if direction == "y" else 0.0)
        assert in_plane(plane, "y") is plane


def test_a_plane_contact_spring_and_flat_beam_belong_to_their_direction():
    flat = Beam(name="barrel", ends="free-free", length_m=1.0, width_m=0.05, thickness_m=0.01)
    zone = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e5)
    rig = replace(
        RIG,
        bodies=(RIG.bodies[0], flat),
        contacts=(Contact(name="stop", at=Station("barrel", 0.5, "z"), law=zone),),
        springs=(PointSpring(station=Station("barrel", 0.2, "z"), stiffness_n_per_m=7.0),),
        force_at=Station("barrel", 1.0, "z"),
    )
    side, above = plane_rigs(rig).values()
    assert (side.contacts, side.springs) == ((), ())
    assert (above.contacts[0].law, above.springs[0].station) == (zone, Station("barrel", 0.2))
    ratio = above.body("barrel").bending_stiffness_n_m2 / side.body("barrel").bending_stiffness_n_m2
    assert ratio == pytest.approx(25.0)
    assert above.body("barrel").mass_kg == pytest.approx(side.body("barrel").mass_kg)


def test_a_contact_has_a_row_in_each_direction_it_acts_in():
    assert [c.name for c in contact_rows(RIG)] == ["contact_1_y", "contact_1_z", "contact_2_y", "contact_2_z"]
    assert contact_rows(BarrelCradle().rig()) == BarrelCradle().rig().contacts
    labels = [s.label for s in rig_stations(RIG)]
    assert labels[:2] == ["cradle_0250mm", "cradle_0250mm_z"]
    assert len(labels) == 16


@given(components, components, speeds, speeds, st.floats(0, 5))
def test_the_derivatives_of_a_ring_belong_to_its_force(y, z, y_rate, z_rate, time_s):
    """Off the kinks, where the force has no derivative: first touch, full damping, and where pulling would begin."""
    eta, rate = np.array([y, z]), np.array([y_rate, z_rate])
    depth_m = np.hypot(y - 2e-4, z + 1e-4) - 1e-3 - 1e-5 * time_s
    size_n = np.hypot(*RING.force_n(eta, rate, time_s))
    if min(abs(depth_m), abs(depth_m - 1e-5)) < 1e-7 or (depth_m > 0 and size_n < 1):
        return
    by_eta, by_rate = RING.tangent(eta, rate, time_s)
    for k in range(2):
        step = np.eye(2)[k]
        slopes = [
            (
                RING.force_n(eta + a * step, rate + b * step, time_s)
                - RING.force_n(eta - a * step, rate - b * step, time_s)
            )
            / (2 * (a + b))
            for a, b in ((1e-9, 0.0), (0.0, 1e-7))
        ]
        np.testing.assert_allclose(by_eta[:, k], slopes[0], rtol=1e-4, atol=1e-5 * np.abs(by_eta).max() + 1e-6)
        np.testing.assert_allclose(by_rate[:, k], slopes[1], rtol=1e-4, atol=1e-5 * np.abs(by_rate).max() + 1e-6)


@given(components, components, speeds, speeds)
def test_a_ring_pushes_outwards_alone_and_rubs_against_the_sliding(y, z, y_rate, z_rate):
    force_y, force_z = RING.force_n(np.array([y, z]), np.array([y_rate, z_rate]))
    out_y, out_z = y - 2e-4, z + 1e-4
    r = np.hypot(out_y, out_z)
    if r <= 1e-3:
        assert (force_y, force_z) == (0, 0)
        return
    normal_n, friction_n = (force_y * out_y + force_z * out_z) / r, (force_z * out_y - force_y * out_z) / r
    sliding = (z_rate * out_y - y_rate * out_z) / r
    assert normal_n >= -1e-9 * abs(friction_n)
    assert abs(friction_n) <= 0.2 * normal_n * (1 + 1e-9) + 1e-12
    assert friction_n * sliding >= -1e-12


@given(components, speeds)
def test_a_ring_is_a_dead_zone_that_does_not_pull_along_a_line_through_its_centre(y, rate):
    ring = replace(RING, center_y_m=0.0, center_z_m=0.0)
    zone = DeadZone(
        lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e5, damping_n_s_per_m=30.0, pulls=False
    )
    force_y, force_z = ring.force_n(np.array([y, 0.0]), np.array([rate, 0.0]))
    assert force_y == pytest.approx(float(zone.force_n(y, rate)), rel=1e-9, abs=1e-9)
    assert force_z == 0


@given(components, components)
def test_the_energy_of_a_ring_is_the_work_of_its_force_at_rest(y, z):
    eta = np.array([y, z])
    if abs(RING.penetration_m(eta)) < 1e-7:
        return
    slopes = [(RING.energy_j(eta + d) - RING.energy_j(eta - d)) / 2e-8 for d in 1e-8 * np.eye(2)]
    np.testing.assert_allclose(slopes, RING.force_n(eta), rtol=1e-5, atol=1e-6)


@given(components, components, speeds, speeds, st.floats(0, 5))
def test_the_compiled_ring_is_the_same(y, z, y_rate, z_rate, time_s):
    rows = law_records([RING, RING])
    compiled = vector_force_n(rows[0], (y, z), (y_rate, z_rate), time_s)
    expected = RING.force_n(np.array([y, z]), np.array([y_rate, z_rate]), time_s)
    np.testing.assert_allclose(compiled, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"clearance_m": -1.0}, "clearance_m is -1.0; give a finite value, zero or above"),
        ({"clearance_m": np.inf}, "clearance_m is inf; give a finite value"),
        ({"sliding_speed_m_per_s": 0.0}, "sliding_speed_m_per_s 0.0; give a finite clearance and a speed above zero"),
        ({"friction_coefficient": -0.1}, "friction_coefficient is -0.1; give"),
        ({"center_z_m": np.nan}, "center_z_m is nan; give"),
    ],
)
def test_a_bad_ring_is_named(changes, sentence):
    with pytest.raises(RigError, match=sentence):
        replace(RING, **changes)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"width_m": 0.01}, "has a width or thickness and a diameter; give width_m and thickness_m of a rectangle, or"),
        ({"inner_diameter_m": 0.08}, r"inner_diameter_m is 0.08 and outer_diameter_m 0.08; give 0 <= inner < outer"),
        ({"outer_diameter_m": np.inf}, "outer_diameter_m is inf; give a value from"),
        ({"outer_diameter_m": 0.0, "inner_diameter_m": 0.0}, "width_m is 0.0; give a value from"),
    ],
)
def test_a_bad_tube_is_named(changes, sentence):
    with pytest.raises(RigError, match=sentence):
        replace(RIG.bodies[0], **changes)


def contact_with(**changes):
    return {"contacts": (replace(RIG.contacts[0], **changes),)}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (contact_with(at=Station("barrel", 0.0, "z")), "'contact_1' is annular, in both directions; give its stations"),
        (
            contact_with(at=Station("barrel", 0.0, "z"), law=RING.in_plane),
            "contact 'contact_1' has stations in y and in z; give both the same direction",
        ),
        ({"masses": (PointMass(station=Station("barrel", 0.1, "z"), mass_kg=1.0),)}, "a mass or support is in both"),
        ({"base_motion": BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=1.0, high_hz=9.0)}, "no base may shake"),
        (
            {"sensors": (Sensor(name="table", station=Station("ground"), quantity="acceleration"),)},
            "moves in y and z, where no base may shake; leave base_motion and sensors on the ground out",
        ),
        ({"gravity_m_per_s2": np.inf}, "gravity_m_per_s2 is inf; give a finite value"),
    ],
)
def test_what_no_rig_in_space_has_is_named(changes, sentence):
    with pytest.raises(RigError, match=sentence):
        replace(RIG, **changes)


def test_another_direction_than_y_and_z_is_named():
    with pytest.raises(RigError, match=r"force_at.*direction is 'x'; give 'y' or 'z'"):
        from_json(to_json(RIG).replace(b'"direction": "z"', b'"direction": "x"', 1), "rig.json")


def test_what_takes_plane_rigs_alone_says_why_not():
    plane = BarrelCradle().rig()
    check_plane(plane, "this")
    tail = "and this takes rigs that move in one direction, without gravity; describe the motion in y alone"
    in_z = replace(plane, force_at=Station("barrel", 1.0, "z"))
    sensor_z = replace(plane, sensors=(replace(plane.sensors[0], station=Station("cradle", 0.2, "z")),))
    for rig, reason in (
        (RIG, "contact 'contact_1' is annular"),
        (sensor_z, f"sensor '{plane.sensors[0].name}' has the direction z"),
        (in_z, "something in it has the direction z"),
        (replace(plane, gravity_m_per_s2=9.81), "it has gravity"),
    ):
        with pytest.raises(RigError, match=f"{reason}, {tail}"):
            check_plane(rig, "this")
    with pytest.raises(RigError, match="contact 'contact_1' is annular, and a run step by step, as in an FMU, takes"):
        Stepwise(RIG, 2.0**-14)


def test_the_level_of_the_force_is_the_larger_one_of_both_directions():
    """A spring in z holds the barrel there, so that more is needed."""
    hold = PointSpring(station=Station("barrel", 1.0, "z"), stiffness_n_per_m=1e6)
    free, held = (rattling_level(replace(RIG, springs=s), 0.5, 100.0).rms_n for s in ((), (hold,)))
    assert free == rattling_level(in_plane(RIG, "y"), 0.5, 100.0).rms_n
    assert held > free
    y_alone = replace(RIG, springs=(hold,), force_at=RIG.forces[0])
    assert rattling_level(y_alone, 0.5, 100.0).rms_n == free
