"""The drawing of a rig: everything is named, and stands where it is."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.description import (
    BaseMotion,
    Clamp,
    PointDamper,
    PointMass,
    PointSpring,
    StaticLoad,
    Station,
    Tone,
    contact_stations,
)
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof
from rig.viewer.palette import BELIEVED_INK, SENSOR_INK
from rig.viewer.schematic import draw
from tests.rig.lab.starting.test_starting import structure_rig

SVG = "{http://www.w3.org/2000/svg}"


def drawn(rig, tmp_path):
    draw(rig, tmp_path / "rig.svg")
    return ET.parse(tmp_path / "rig.svg").getroot()


def texts(root):
    return [(node.text, float(node.get("x")), float(node.get("y"))) for node in root.iter(f"{SVG}text")]


def corners(root, kind, colour):
    shapes = (node for node in root.iter(SVG + kind) if node.get("stroke") == colour)
    return [np.array([p.split(",") for p in node.get("points").split()], dtype=float) for node in shapes]


def attached(body, low_m, high_m):
    low, high = Station(body, low_m), Station(body, high_m)
    return {
        "masses": (PointMass(station=low, mass_kg=0.123),),
        "springs": (PointSpring(station=high, stiffness_n_per_m=456.0, cubic_n_per_m3=7e8),),
        "dampers": (PointDamper(station=low, damping_n_s_per_m=8.9),),
        "loads": (StaticLoad(station=high, force_n=-3.21),),
        "tones": (Tone(station=low, frequency_hz=54.3, cosine_n=1.0),),
    }


def test_a_rig_in_space_is_drawn_from_two_sides_with_the_forces_and_sensors_of_each(tmp_path):
    rig = BarrelCradleAnnular(sensors="acceleration").rig()
    said = texts(drawn(rig, tmp_path))
    side_y, below_y = (next(y for words, _, y in said if words.endswith(end)) for end in ("y up", "z up"))
    assert side_y < next(y for words, _, y in said if words == "F1") < below_y
    assert below_y < next(y for words, _, y in said if words == "F2")
    words = [word for word, _, _ in said]
    assert words.count("annular") == words.count("friction 0.1") == 4
    assert words.count("barrel: free-free, 1 m, tube of 60 and 40 mm") == 2
    assert words.count("gravity 9.81 m/s\u00b2 downwards") == 1
    y_alone = [word for word, _, _ in texts(drawn(replace(rig, force_at=rig.forces[0]), tmp_path))]
    assert y_alone.count("force F") == 1


SAID = ("0.123 kg", "456 N/m", "7e+08 N/m\u00b3", "8.9 N s/m", "3.21 N", "tone 54.3 Hz")


@pytest.mark.parametrize("kind", ["mass", "beams", "structure"])
def test_everything_is_named_with_its_numbers(tmp_path, kind):
    bodies = {"mass": Sdof().rig(), "beams": BarrelCradle().rig(), "structure": structure_rig(tmp_path).rig()}
    rig = bodies[kind]
    name, length_m = rig.force_at.body, rig.body(rig.force_at.body).length_m
    base = BaseMotion(acceleration_rms_m_per_s2=0.11, low_hz=1.5, high_hz=29.0)
    rig = replace(rig, name="<a> & b", base_motion=base, **attached(name, 0.2 * length_m, 0.8 * length_m))
    if kind == "beams":
        rig = replace(rig, clamps=(Clamp(body="cradle", rotational_n_m_per_rad=5432.0),))
    words = [text for text, _, _ in texts(drawn(rig, tmp_path))]
    expected = ["<a> & b", "force F", "base motion 0.11 m/s\u00b2 rms, 1.5 to 29 Hz", *SAID]
    expected += [c.name for c in rig.contacts] + ["5432 N m/rad"] * len(rig.clamps)
    expected += [f"+{1e3 * c.law.upper_clearance_m:g} mm" for c in rig.contacts]
    assert set(expected) <= set(words)
    assert all(any(text.startswith(f"{body.name}: ") for text in words) for body in rig.bodies)


@pytest.mark.parametrize("kind", ["beams", "structure"])
def test_along_the_bodies_it_is_to_scale(tmp_path, kind):
    rig = BarrelCradle(overlap_start_m=0.4).rig() if kind == "beams" else structure_rig(tmp_path).rig()
    root = drawn(rig, tmp_path)
    scale = 800.0 / (1.4 if kind == "beams" else 0.5)
    left_m = {"cradle": 0.0, "barrel": 0.4, "fin": 0.0}

    def x_of(stations):
        return sorted({round(scale * (left_m[s.body] + s.position_m), 1) for s in stations})

    marks = corners(root, "polygon", SENSOR_INK)
    assert len(marks) == len({s.station for s in rig.sensors})
    tips = sorted({float(mark[np.argmax(mark[:, 1]), 0]) for mark in marks})
    np.testing.assert_allclose(tips, x_of(s.station for s in rig.sensors), atol=0.11)
    (force,) = [x for text, x, _ in texts(root) if text == "force F"]
    assert force - 10 == pytest.approx(x_of([rig.force_at])[0], abs=0.1)
    if kind == "beams":
        links = [line for line in corners(root, "polyline", BELIEVED_INK) if len(line) == 4]
        link_ends = sorted({float(x) for line in links for x in line[[0, -1], 0]})
        np.testing.assert_allclose(link_ends, x_of(s for c in rig.contacts for s in contact_stations(c)), atol=0.11)


@pytest.mark.parametrize("make", [lambda: Sdof().rig(), lambda: BarrelCradle().rig()])
def test_nothing_lies_outside_the_picture(tmp_path, make):
    root = drawn(make(), tmp_path)
    left, top, width, height = map(float, root.get("viewBox").split())
    for text, x, y in texts(root):
        assert left < x < left + width, text
        assert top < y < top + height, text


def test_each_of_several_forces_has_its_number(tmp_path):
    rig = BarrelCradle().rig()
    rig = replace(rig, force_at=(rig.force_at, Station("cradle", 0.6), rig.force_at))
    x_of = {text: x - 10 for text, x, _ in texts(drawn(rig, tmp_path)) if text in ("F1, F3", "F2")}
    scale = 800.0 / (rig.contacts[0].against.position_m + 1.0)
    assert x_of == {"F1, F3": pytest.approx(800.0, abs=0.1), "F2": pytest.approx(scale * 0.6, abs=0.1)}


def test_things_on_a_mass_stand_apart(tmp_path):
    rig = replace(Sdof().rig(), **attached("mass", 0.0, 0.0))
    places = [x for text, x, _ in texts(drawn(rig, tmp_path)) if text in ("stop", "force F", "x, a", *SAID)]
    assert np.diff(np.unique(np.round(places))).min() > 50


def test_a_folder_that_is_not_there_is_said(tmp_path):
    with pytest.raises(RigError, match="cannot be written"):
        draw(Sdof().rig(), tmp_path / "none" / "rig.svg")


@pytest.mark.parametrize(("field", "said"), [("lower_clearance_m", "+"), ("upper_clearance_m", "\u2212")])
def test_a_stop_that_is_not_there_is_not_drawn(tmp_path, field, said):
    rig = Sdof().rig()
    (contact,) = rig.contacts
    one_sided = replace(rig, contacts=(replace(contact, law=replace(contact.law, **{field: np.inf})),))
    root = drawn(one_sided, tmp_path)
    assert [text[0] for text, _, _ in texts(root) if text.endswith(" mm")] == [said]
    assert len(list(root.iter())) < len(list(drawn(rig, tmp_path).iter()))
    assert "inf" not in ET.tostring(root, encoding="unicode")
