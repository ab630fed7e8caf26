"""The drawing of a rig on a page: what touches stands one above the other, and no text lies over another."""

import re
from itertools import combinations
from xml.etree import ElementTree

import pytest
from msgspec.structs import replace

from identify.pages.drawing_texts import BOLD_LETTER_WIDTH, LETTER_WIDTH, WIDTH, TextSpans, mark_text
from identify.pages.machine import DrawnMark, rig_drawing
from rig.model.description import Station, Support
from rig.simulation.reference import BarrelCradle, Sdof
from tests.campaigns.topologies import RIGS

DRAWN = {"mass": Sdof().rig(), "beams": BarrelCradle().rig(), **{name: case.rig for name, case in RIGS.items()}}
WORDS = "5.003 ± 0.024 mm", "100100 ± 1000 N/m"


def drawing(rig, *marks):
    return ElementTree.fromstring(rig_drawing(rig, {c.name: WORDS for c in rig.contacts}, marks))


def boxes(svg):
    """Left, right and baseline of every text but the names of masses, which lie in their blocks."""
    for text in svg.iter("text"):
        x, y, half = float(text.get("x")), float(text.get("y")), LETTER_WIDTH * len(text.text) / 2
        middle = x + {"start": half, "middle": 0.0, "end": -half}[text.get("text-anchor")]
        yield text.text, middle - half, middle + half, y


@pytest.mark.parametrize("name", DRAWN)
def test_every_contact_has_its_values_and_no_text_lies_over_another(name):
    rig = DRAWN[name]
    last = rig.bodies[-1]
    marks = [DrawnMark(Station(last.name, share * last.length_m), f"effect at {share}") for share in (0.3, 0.4, 0.9)]
    texts = list(boxes(drawing(rig, *marks)))
    written = [text for text, *_ in texts]
    assert {c.name for c in rig.contacts} | {b.name for b in rig.bodies} | {m.words for m in marks} <= set(written)
    assert [written.count(word) for word in WORDS] == [len(rig.contacts)] * 2
    for (one, left, right, y), (other, other_left, other_right, other_y) in combinations(texts, 2):
        assert abs(y - other_y) > 12 or right < other_left + 2 or other_right < left + 2, (one, other)
    assert all(left > -2 and right < WIDTH + 2 for _, left, right, _ in texts)


@pytest.mark.parametrize("name", DRAWN)
def test_no_text_of_a_contact_lies_on_the_post_of_another(name):
    rig = DRAWN[name]
    svg = drawing(rig)
    posts = [
        re.match(r"M([-0-9.]+),([-0-9.]+)h([0-9.]+)V([-0-9.]+)", path.get("d"))
        for path in svg.iter("path")
        if path.get("class") == "found"
    ]
    for post in filter(None, posts):
        x, top, wide, foot = map(float, post.groups())
        for text, left, right, y in boxes(svg):
            is_name = text in {body.name for body in rig.bodies}  # on its block, with a halo
            assert is_name or not (left < x + wide < right and top < y < foot), text


def test_the_words_of_a_mark_end_before_the_line_of_the_next():
    rig = BarrelCradle().rig()
    words = "a damper of 59.5 N s/m between the barrel and the ground"
    svg = drawing(rig, *(DrawnMark(Station("barrel", x_m), words) for x_m in (0.78, 0.80)))
    lines_px = sorted(
        float(re.match(r"M([-0-9.]+)", p.get("d"))[1]) for p in svg.iter("path") if p.get("class") == "mark"
    )
    halves = [len(t.text) * BOLD_LETTER_WIDTH / 2 for t in svg.iter("text") if t.get("class") == "mark-words"]
    middles = [float(t.get("x")) for t in svg.iter("text") if t.get("class") == "mark-words"]
    ends = [middle + half for middle, half in zip(middles, halves, strict=True)]
    assert len(ends) >= 4
    assert max(ends[: len(ends) // 2]) < lines_px[1]


def test_the_lowest_body_is_marked_below_where_no_contact_stands():
    rig = BarrelCradle().rig()
    svg = drawing(rig, *(DrawnMark(Station(body.name, 0.5), body.name + " marked") for body in rig.bodies))
    tops = [float(block.get("y")) for block in svg.iter("rect")]
    (cradle, barrel) = (float(t.get("y")) for t in svg.iter("text") if t.text.endswith(" marked"))
    assert cradle > tops[0] > tops[1] > barrel


def test_stops_stand_at_the_places_of_the_contacts():
    rig = BarrelCradle().rig()
    svg = drawing(rig)
    cradle, barrel = ((float(b.get("x")), float(b.get("width"))) for b in svg.iter("rect"))
    assert barrel[1] == pytest.approx(cradle[1], abs=0.1)  # both 1 m
    assert barrel[0] - cradle[0] == pytest.approx(0.45 * cradle[1], abs=0.1)
    forks = [float(re.match(r"M([-0-9.]+)", p.get("d"))[1]) for p in svg.iter("path") if p.get("class") == "found"]
    assert max(forks) - min(forks) == pytest.approx(0.55 * cradle[1], abs=0.1)


def test_a_support_stands_at_its_place_and_is_named_under_the_pointer():
    svg = drawing(replace(BarrelCradle().rig(), supports=(Support(station=Station("cradle", 0.25)),)))
    cradle, _ = ((float(b.get("x")), float(b.get("width"))) for b in svg.iter("rect"))
    (triangle,) = (p for p in svg.iter("path") if p.get("class") == "support")
    assert float(re.match(r"M([-0-9.]+)", triangle.get("d"))[1]) == pytest.approx(cradle[0] + cradle[1] / 4, abs=0.1)
    assert triangle.findtext("title") == "support at 0.25 m"


def test_every_sensor_is_named_under_the_pointer():
    rig = BarrelCradle().rig()
    names = ", ".join(title.text for title in drawing(rig).iter("title")).split(", ")
    assert sorted(names) == sorted(sensor.name for sensor in rig.sensors)


def test_names_cannot_break_the_drawing():
    rig = Sdof().rig()
    odd = replace(rig, contacts=(replace(rig.contacts[0], name="</text><b>&"),))
    assert "</text><b>&" in [text.text for text in drawing(odd).iter("text")]


def test_no_name_is_broken_in_the_words_of_a_mark():
    words = "a hint (explains 14.7 %): cradle_1000mm_acceleration: fault of the sensor"
    for x_px in (5.0, WIDTH / 2, WIDTH - 5.0):
        text = mark_text(x_px, words, TextSpans(), [x_px, x_px + 40.0])
        assert " ".join(text.lines).replace("\N{NO-BREAK SPACE}", " ") == words
