"""A rig as a value: JSON round trip, and a sentence for each value that cannot be."""

import re

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from rig.errors import RigError, has_no_control_characters
from rig.limits import SCHEMA_VERSION
from rig.model.beam import Beam
from rig.model.contact_laws import LAWS, DeadZone
from rig.model.contact_laws.hunt_crossley import HuntCrossley
from rig.model.description import (
    ON_GROUND,
    Contact,
    Rig,
    Sensor,
    Station,
    from_json,
    rig_stations,
    to_json,
)
from rig.model.oscillator import Oscillator
from rig.model.quantities import QUANTITIES
from rig.simulation.reference import BarrelCradle, Sdof

LAW = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e4)


def small_rig(**changes):
    good = {
        "name": "small",
        "bodies": (
            Beam(name="beam", ends="clamped-free", length_m=2.0, width_m=0.05, thickness_m=0.01),
            Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01),
        ),
        "contacts": (Contact(name="stop", at=Station("mass"), against=Station("beam", 1.5), law=LAW),),
        "force_at": Station("mass"),
        "sensors": (Sensor(name="tip", station=Station("beam", 2.0), quantity="velocity"),),
        "sample_rate_hz": 1000.0,
    }
    return Rig(**good | changes)


positive = st.floats(1e-6, 1e6)
names = st.text(min_size=1, max_size=8).filter(has_no_control_characters)
sensors = st.builds(
    Sensor,
    name=names,
    station=st.builds(Station, st.just("beam"), st.floats(0, 2)),
    quantity=st.sampled_from(["displacement", "velocity", "acceleration"]),
    gain=positive,
    delay_s=st.floats(-1e-2, 1e-2),
    noise_density=positive,
    measuring_range=positive,
    bits=st.none() | st.integers(2, 32),
)
contacts = st.builds(
    Contact,
    name=names,
    at=st.just(Station("mass")),
    against=st.none() | st.builds(Station, st.just("beam"), st.floats(0, 2)),
    law=st.builds(
        DeadZone,
        lower_clearance_m=positive,
        upper_clearance_m=positive,
        stiffness_n_per_m=positive,
        damping_n_s_per_m=positive,
    ),
)


@given(
    name=names,
    sensors=st.lists(sensors, max_size=4, unique_by=lambda s: s.name).map(tuple),
    contacts=st.lists(contacts, max_size=3, unique_by=lambda c: c.name).map(tuple),
    sample_rate_hz=positive,
)
def test_a_rig_survives_json(**changes):
    rig = small_rig(**changes)
    assert from_json(to_json(rig), "text") == rig


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"sample_rate_hz": 0.0}, "sample_rate_hz is 0.0; give a value above zero"),
        ({"sample_rate_hz": float("nan")}, "sample_rate_hz is nan; give"),
        ({"sample_rate_hz": 1e-300}, "sample_rate_hz is 1e-300; give"),
        ({"bodies": (small_rig().bodies[1],) * 2}, "more than one body is named 'mass'; names must differ"),
        ({"contacts": small_rig().contacts * 2}, "more than one contact is named 'stop'"),
        ({"sensors": small_rig().sensors * 2}, "more than one sensor is named 'tip'"),
        ({"force_at": Station("nose")}, "rig 'small' has no body 'nose'; it has beam, mass"),
        ({"force_at": Station("beam", 2.5)}, "the force stands at 2.5 m, off 'beam'; give 0 to 2.0 m"),
        ({"force_at": Station("beam", float("nan"))}, "the force stands at nan m"),
        ({"force_at": (Station("mass"),)}, "force_at is a list of 1; give the place of one force by itself"),
        ({"force_at": (Station("mass"), Station("beam", 2.5))}, "the force_2 stands at 2.5 m, off 'beam'"),
        (
            {
                "force_at": (Station("mass"), Station("mass")),
                "sensors": (Sensor(name="force_2", station=Station("mass"), quantity="velocity"),),
            },
            "more than one channel is named 'force_2'",
        ),
        ({"sensors": (Sensor(name="s", station=Station("beam", -0.1), quantity="velocity"),)}, "sensor 's' stands at"),
        (
            {"contacts": (Contact(name="c", at=Station("mass"), against=Station("beam", 3.0), law=LAW),)},
            "contact 'c' stands at 3.0 m",
        ),
    ],
)
def test_a_rig_that_cannot_be_is_refused(changes, sentence):
    with pytest.raises(RigError) as caught:
        small_rig(**changes)
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"gain": 0.0}, "gain is 0.0; give a finite value other than zero"),
        ({"gain": float("nan")}, "gain is nan"),
        ({"gain": 1e-320}, "gain is 1e-320"),
        ({"delay_s": 1000.0}, "delay_s is 1000.0; give a finite value, -1 to 1 s"),
        ({"delay_s": float("inf")}, "delay_s is inf; give a finite value"),
        ({"noise_density": -1.0}, "noise_density is -1.0; give zero or above"),
        ({"measuring_range": 0.0}, "measuring_range is 0.0; give a finite value above zero"),
        ({"measuring_range": float("inf")}, "measuring_range is inf; give a finite value above zero"),
        ({"bits": 12}, "bits is 12; give 2 to 32, together with a measuring_range"),
        ({"bits": 1, "measuring_range": 1.0}, "bits is 1; give 2 to 32"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(changes, sentence):
    with pytest.raises(RigError) as caught:
        Sensor(name="s", station=Station("mass"), quantity="velocity", **changes)
    assert "sensor 's': " + sentence in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        (b'"sample_rate_hz"', b'"rate"', "rate"),
        (b'"velocity"', b'"speed"', "sensors[0].quantity is 'speed'; give 'acceleration' or"),
        (b'"oscillator"', b'"wheel"', "bodies[1].type is 'wheel'; give 'beam' or 'oscillator'"),
        (b"2.0", b'"two"', "bodies[0].length_m is text; give a number"),
        (b"2.0", b"-2.0", "length_m is -2.0"),
        (b"}", b"", "malformed"),
        (b"{", b"", "malformed"),
        (b'"small"', b'"\xff"', "utf-8"),
    ],
)
def test_a_text_that_is_no_rig_is_refused_with_its_place(old, new, place):
    text = to_json(small_rig())
    assert old in text
    with pytest.raises(RigError) as caught:
        from_json(text.replace(old, new, 1), "rig.json of x")
    assert str(caught.value).startswith("rig.json of x: not a rig description: ")
    assert place in str(caught.value)


def test_laws_and_quantities_are_those_of_the_schema_version():
    """A file with a law or a quantity that an earlier program does not know has a later version."""
    laws = {law.__struct_config__.tag for law in LAWS.values()}
    assert SCHEMA_VERSION == 2
    assert laws == {"annular", "dead_zone", "hunt_crossley", "spring"}
    assert set(QUANTITIES) == {"acceleration", "displacement", "strain", "velocity"}


def test_a_rig_of_a_later_version_is_refused_by_its_version():
    text = to_json(small_rig())
    field = b'"schema_version": 2'
    assert field in text
    earlier = msgspec.json.decode(text)
    del earlier["schema_version"]
    assert from_json(msgspec.json.encode(earlier), "rig.json") == small_rig()
    assert from_json(text.replace(field, b'"schema_version": 1'), "rig.json").contacts == small_rig().contacts
    with pytest.raises(
        RigError, match=r"^rig\.json of x: schema_version is 3, and this program reads 1 to 2; install a "
    ):
        from_json(text.replace(field, b'"schema_version": 3, "new": 0'), "rig.json of x")


@pytest.mark.parametrize("number", [b"2e200", b"-2" + 200 * b"0"])
def test_a_number_that_nothing_is_is_refused_with_its_place(number):
    with pytest.raises(RigError, match=r"^rig\.json of x: bodies\[0\]\.length_m is about 1e200, which nothing is"):
        from_json(to_json(small_rig()).replace(b"2.0", number, 1), "rig.json of x")


def test_a_sensor_that_passes_nothing_below_half_its_rate_is_refused():
    rig = Sdof().rig()
    sensor = msgspec.structs.replace(rig.sensors[0], high_pass_hz=rig.sample_rate_hz / 2)
    with pytest.raises(RigError, match=r"high_pass_hz is 256.0; give less than half the sample_rate_hz of 512"):
        msgspec.structs.replace(rig, sensors=(sensor,))


def test_stations_are_distinct_and_ordered_along_each_body():
    rig = BarrelCradle(stations=4).rig()
    stations = rig_stations(rig)
    assert len(set(stations)) == len(stations)
    assert set(stations) == {s.station for s in rig.sensors}  # its contacts stand among its sensors
    for body in rig.bodies:
        positions = [s.position_m for s in stations if s.body == body.name]
        assert positions == sorted(positions)
    assert [s.body for s in stations] == ["cradle"] * 4 + ["barrel"] * 4


def test_a_body_and_a_contact_are_found_by_name():
    rig = small_rig()
    assert rig.body("mass") is rig.bodies[1]
    assert rig.contact("stop") is rig.contacts[0]
    with pytest.raises(RigError, match="has no body 'nose'; it has beam, mass"):
        rig.body("nose")


def test_several_forces_come_back_from_json_and_one_stands_there_as_ever():
    single_force = small_rig()
    assert (single_force.forces, single_force.force_names) == ((Station("mass"),), ("force",))
    assert b'"force_at": {\n' in to_json(single_force)
    two_forces = small_rig(force_at=(Station("beam", 2.0), Station("mass")))
    assert (two_forces.forces, two_forces.force_names) == (two_forces.force_at, ("force_1", "force_2"))
    assert from_json(to_json(two_forces), "rig.json of x") == two_forces


def test_a_rig_cannot_be_changed():
    with pytest.raises(AttributeError):
        small_rig().name = "other"
    assert msgspec.structs.replace(small_rig(), name="other").name == "other"


def test_a_list_is_no_rig():
    with pytest.raises(RigError, match="it is a list; give an object"):
        from_json(b"[1]", "rig.json of x")


def test_a_law_without_a_type_is_a_dead_zone_as_in_older_files():
    text = to_json(small_rig())
    older = re.sub(rb'"type": "dead_zone",\s*', b"", text)
    assert older != text
    assert from_json(older, "rig.json of x") == small_rig()


def test_another_law_comes_back_from_json_and_an_unknown_one_is_named():
    law = HuntCrossley(lower_clearance_m=1e-3, upper_clearance_m=2e-3, stiffness_n_per_m=1e5)
    rig = small_rig()
    rig = replace(rig, contacts=tuple(replace(c, law=law) for c in rig.contacts))
    assert from_json(to_json(rig), "rig.json of x") == rig
    with pytest.raises(RigError, match=r"contacts\[0\]\.law\.type is 'rubber'; give 'annular' or 'dead_zone'"):
        from_json(to_json(rig).replace(b"hunt_crossley", b"rubber"), "rig.json of x")


def test_a_stop_that_is_not_there_is_null():
    rig = small_rig(contacts=(replace(small_rig().contacts[0], law=replace(LAW, lower_clearance_m=float("inf"))),))
    decoded = msgspec.json.decode(to_json(rig))
    assert decoded["contacts"][0]["law"]["lower_clearance_m"] is None
    assert from_json(to_json(rig), "rig.json of x") == rig


@pytest.mark.parametrize("words", [{"against": None}, {"against": "ground"}, {}])
def test_the_ground_is_null_a_word_or_left_out(words):
    rig = small_rig()
    decoded = msgspec.json.decode(to_json(rig))
    del decoded["contacts"][0]["against"]
    decoded["contacts"][0] |= words
    grounded = replace(rig, contacts=(replace(rig.contacts[0], against=None),))
    assert from_json(msgspec.json.encode(decoded), "rig.json of x") == grounded


def shaken(**changes):
    """Description, as decoded JSON, of the small rig on a table that shakes, without a force."""
    decoded = msgspec.json.decode(to_json(small_rig()))
    del decoded["force_at"]
    table = {"name": "table", "station": "ground", "quantity": "acceleration"}
    return decoded | {"sensors": [table, *decoded["sensors"]]} | changes


@pytest.mark.parametrize("force_at", [{}, {"force_at": "ground"}])
def test_a_sensor_on_the_ground_measures_how_the_base_shakes(force_at):
    rig = from_json(msgspec.json.encode(shaken(**force_at)), "rig.json of x")
    assert [s.name for s in rig.base_sensors] == ["table"]
    assert rig.forces == rig.inputs == (ON_GROUND,)
    assert rig.force_names == ("force",)
    assert ON_GROUND not in rig_stations(rig)
    assert from_json(to_json(rig), "x") == rig


def test_a_force_and_a_shaken_base_are_two_inputs():
    rig = from_json(msgspec.json.encode(shaken(force_at={"body": "beam", "position_m": 0.5})), "x")
    assert rig.inputs == (Station("beam", 0.5), ON_GROUND)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"sensors": []}, "acts on the ground, where it moves nothing; give force_at the place"),
        ({"force_at": ["ground", "ground"]}, "force_at"),
        ({"sensors": [{"name": "t", "station": "grund", "quantity": "acceleration"}]}, r"did you mean 'ground'\?"),
        ({"sensors": [{"name": "t", "station": "ground", "quantity": "strain"}]}, "strain of the ground; put it on a"),
        (
            {"sensors": [{"name": "t", "station": {"body": "ground", "position_m": 1}, "quantity": "velocity"}]},
            "stands on the ground, which has one place",
        ),
    ],
)
def test_a_shaken_base_that_cannot_be_is_refused(changes, sentence):
    with pytest.raises(RigError, match=sentence):
        from_json(msgspec.json.encode(shaken(**changes)), "x")


def test_a_body_named_ground_is_a_body_as_in_older_files():
    decoded = msgspec.json.decode(to_json(small_rig()).replace(b'"mass"', b'"ground"'))
    rig = from_json(msgspec.json.encode(decoded), "x")
    assert rig.base_sensors == ()
    assert rig.inputs == rig.forces


def test_another_word_than_the_ground_is_refused():
    decoded = msgspec.json.decode(to_json(small_rig()))
    decoded["contacts"][0]["against"] = "grund"
    with pytest.raises(RigError, match=r"contacts\[0\]\.against is 'grund' \(did you mean 'ground'\?\)"):
        from_json(msgspec.json.encode(decoded), "rig.json of x")
