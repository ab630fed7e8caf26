"""The drawing of a rig on a page: what touches stands one above the other, and no text lies over another."""

import math
import re
from itertools import combinations
from xml.etree import ElementTree

import pytest
from msgspec.structs import replace

from identify.pages import page
from identify.pages.drawing import drawing_html
from identify.pages.drawing_texts import (
    BOLD_LETTER_WIDTH,
    LETTER_WIDTH,
    NARROW_WIDTH,
    RULER_LETTER_WIDTH,
    WIDTH,
    TextSpans,
    mark_texts,
)
from identify.pages.machine import DrawnMark, rig_drawing_svg
from rig.model.description import Station, Support
from rig.simulation.reference import BarrelCradle, Sdof
from tests.campaigns.topologies import RIGS

DRAWN = {"mass": Sdof().rig(), "beams": BarrelCradle().rig(), **{name: case.rig for name, case in RIGS.items()}}
NUMBER = "[0-9.]+( m)?"
WORDS = "5.003 ± 0.024 mm", "100100 ± 1000 N/m"


def drawing(rig, *marks, width_px=WIDTH):
    return ElementTree.fromstring(rig_drawing_svg(rig, {c.name: WORDS for c in rig.contacts}, marks, width_px))


def boxes(svg):
    """Left, right and baseline of every text but the names of masses, which lie in their blocks."""
    for text in svg.iter("text"):
        letter_px = RULER_LETTER_WIDTH if text.get("class") == "ruler" else LETTER_WIDTH
        x, y, half = float(text.get("x")), float(text.get("y")), letter_px * len(text.text) / 2
        middle = x + {"start": half, "middle": 0.0, "end": -half}[text.get("text-anchor")]
        yield text.text, middle - half, middle + half, y


@pytest.mark.parametrize("width_px", [WIDTH, NARROW_WIDTH])
@pytest.mark.parametrize("name", DRAWN)
def test_every_contact_has_its_values_and_no_text_lies_over_another(name, width_px):
    rig = DRAWN[name]
    last = rig.bodies[-1]
    marks = [DrawnMark(Station(last.name, share * last.length_m), f"effect at {share}") for share in (0.3, 0.4, 0.9)]
    texts = list(boxes(drawing(rig, *marks, width_px=width_px)))
    written = [text for text, *_ in texts]
    all_words = " ".join(written).replace("\u00a0", " ")
    assert {c.name for c in rig.contacts} | {b.name for b in rig.bodies} | {m.words for m in marks} <= set(written)
    assert [all_words.count(word) for word in WORDS] == [len(rig.contacts)] * 2
    for (one, left, right, y), (other, other_left, other_right, other_y) in combinations(texts, 2):
        assert abs(y - other_y) > 12 or right < other_left + 2 or other_right < left + 2, (one, other)
    assert all(left > -2 and right < width_px + 2 for _, left, right, _ in texts)


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
            is_on_body = text in {body.name for body in rig.bodies} or re.fullmatch(
                NUMBER, text
            )  # which hides the post
            assert is_on_body or not (left < x + wide < right and top < y < foot), text


def test_an_effect_of_a_whole_body_is_a_frame_around_it():
    rig = BarrelCradle().rig()
    svg = drawing(rig, DrawnMark(Station("cradle", 0.5), "a softer cradle", of_whole_body=True))
    cradle = max(svg.iter("rect"), key=lambda rect: float(rect.get("y")))
    left, top, wide, high = (float(cradle.get(key)) for key in ("x", "y", "width", "height"))
    frame = f"M{left:g},{top:g}h{wide:g}v{high:g}h{-wide:g}z"
    assert frame in [path.get("d") for path in svg.iter("path") if path.get("class") == "mark"]
    assert not [circle for circle in svg.iter("circle") if circle.get("class") == "mark"]


@pytest.mark.parametrize("touched_from", ["below", "above"])
def test_a_stop_that_is_not_there_is_not_drawn(touched_from):
    """The upper stop is touched as `at` moves up: it stands above `at`, and below the body that `at` lies under."""
    rig = BarrelCradle().rig()
    (contact, _), law = rig.contacts, replace(rig.contacts[0].law, lower_clearance_m=math.inf)
    swapped = {"at": contact.against, "against": contact.at} if touched_from == "below" else {}
    one_sided = replace(rig, contacts=(replace(contact, law=law, **swapped),))
    svg = drawing(one_sided)
    barrel_px = min(float(rect.get("y")) for rect in svg.iter("rect"))
    stops_px = [
        float(re.match(r"M[-0-9.]+,([-0-9.]+)h", path.get("d"))[1])
        for path in svg.iter("path")
        if path.get("class") == "found"
    ]
    assert [stop_px < barrel_px for stop_px in stops_px] == [touched_from == "above"]
    assert "contact, one stop" in drawing_html(one_sided, {})


@pytest.mark.parametrize("width_px", [WIDTH, NARROW_WIDTH])
def test_each_body_is_a_ruler_from_its_own_left_end(width_px):
    """The place of a mark is found by the numbers on its body, none of which lies under the ring."""
    rig, at_m = BarrelCradle().rig(), 0.8
    svg = drawing(rig, DrawnMark(Station("barrel", at_m), "a mass"), width_px=width_px)
    (ring,) = (float(c.get("cx")) for c in svg.iter("circle") if c.get("class") == "mark")
    dots = {float(c.get("cx")) for c in svg.iter("circle") if c.get("class") == "origin"}
    for body, block in zip(rig.bodies, svg.iter("rect"), strict=True):
        left, top, wide = (float(block.get(key)) for key in ("x", "y", "width"))
        assert left in dots
        rows = [(t, r) for t, _, r, y in boxes(svg) if top < y < top + 20 and re.fullmatch(NUMBER, t)]
        ticks = [
            float(re.match(r"M([-0-9.]+)", p.get("d"))[1])
            for p in svg.iter("path")
            if p.get("class") == "thin" and f",{top:g}v3" in p.get("d")
        ]
        places_m = [float(text.removesuffix(" m")) for text, _ in rows]
        assert len(places_m) > 1
        assert ticks == pytest.approx([left + wide * place_m / body.length_m for place_m in places_m], abs=0.1)
        if body.name == "barrel":
            assert ring == pytest.approx(left + wide * at_m, abs=0.1)
            half_px = RULER_LETTER_WIDTH / 2
            assert all(abs(right - half_px * len(text) - ring) > 9 + half_px * len(text) for text, right in rows)
        else:
            assert "1 m" in [text for text, _ in rows]


@pytest.mark.parametrize("name", DRAWN)
def test_the_key_has_each_symbol_that_occurs_and_no_other(name):
    rig = DRAWN[name]
    station = rig.forces[0] if rig.forces else Station(rig.bodies[0].name)
    for marks in ((), (DrawnMark(station, "a mass"),), (DrawnMark(station, "?", True),)):
        lines = {c.name: WORDS for c in rig.contacts[:1]}
        html = ElementTree.fromstring(f"<div>{drawing_html(rig, lines, marks)}</div>")
        drawn, key = (
            {element.get("class") for element in part.iter() if element.tag in ("path", "rect", "circle")}
            for part in (html.find(".//div/svg"), html.find(".//ul"))
        )
        assert key | {"thin", "ink"} == drawn | {"thin", "ink"}  # hatches, springs and ticks
        words = [item.find("svg").tail for item in html.find(".//ul")]
        assert len(set(words)) == len(words)
        assert ("mass" in words) == any(body.is_mass for body in rig.bodies)
        assert ("clamp" in words) == any(body.clamped for body in rig.bodies)
        assert ("contact, two stops, with its values" in words) == rig.contacts[0].law.has_stops


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


@pytest.mark.parametrize("width_px", [WIDTH, NARROW_WIDTH])
def test_no_line_to_a_ring_passes_through_words(width_px):
    """The words at the right end reach far to the left, over the lines of other marks."""
    rig = BarrelCradle().rig()
    words = {
        0.295: "a spring of unknown strength between the f16 at 0.354 ± 0.049 m and the ground",
        0.5: "a damping of the f16 that is 76.9 ± 6.8 % larger",
        0.73: "unmeasured force, 10.4 N rms, near 0.877 ± 0.019 m",
        1.0: "a signal of sensor f16_1200mm_acceleration that comes 0.89 ± 0.16 ms too early",
    }
    svg = drawing(rig, *(DrawnMark(Station("barrel", x_m), text) for x_m, text in words.items()), width_px=width_px)
    paths = [path.get("d") for path in svg.iter("path") if path.get("class") == "mark"]
    leaders = [map(float, re.fullmatch(r"M([-0-9.]+),([-0-9.]+)V([-0-9.]+)", path).groups()) for path in paths]
    assert len(leaders) == len(words)
    written = [box for box in boxes(svg) if box[0] in " ".join(words.values())]
    for x, begin, end in leaders:
        crossed = [
            text for text, left, right, y in written if left < x < right and min(begin, end) < y < max(begin, end)
        ]
        assert not crossed


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
        text = mark_texts([(x_px, words), (x_px + 40.0, words)], TextSpans())[0]
        assert " ".join(text.lines).replace("\N{NO-BREAK SPACE}", " ") == words


_TEXTS = """
const page = this.contentDocument;
const texts = [...page.querySelectorAll("svg text")].filter(text => text.getClientRects().length);
const boxes = texts.map(text => text.getBoundingClientRect());
const heights = texts.map(text => parseFloat(getComputedStyle(text).fontSize) * text.getScreenCTM().a);
const overlaps = [];
boxes.forEach((a, i) => boxes.slice(i + 1).forEach((b, k) => {
  const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
  const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
  if (wide > 1 && high > 4) overlaps.push(texts[i].textContent + " / " + texts[i + 1 + k].textContent);
}));
this.title = JSON.stringify([texts.length, Math.min(...heights), Math.max(...boxes.map(box => box.right)), overlaps]);
"""


@pytest.mark.parametrize("width_px", [390, 1280])
@pytest.mark.parametrize("name", ["beams", "mass", "three masses in a chain", "two beams, two stops at one place"])
def test_a_browser_draws_texts_that_can_be_read(framed, tmp_path, name, width_px):
    """Letters of 11 px at least, none beyond the window and none over another, as the browser's own font makes them."""
    rig = DRAWN[name]
    words = "an added mass of 0.1498 ± 0.0026 kg on the barrel at 0.7999 ± 0.0014 m"
    mark = DrawnMark(Station(rig.bodies[-1].name, 0.8 * rig.bodies[-1].length_m), words)
    html = f"<figure>{drawing_html(rig, {c.name: WORDS for c in rig.contacts}, (mark,))}</figure>"
    answer = page.Answer("green", "so", "")
    page.write(tmp_path / "p.html", title="", answer=answer, sections=[], foot_text="", top_blocks=[html, "beside"])
    (count, least_px, right_px, overlaps), _ = framed((tmp_path / "p.html").read_text(), width_px, _TEXTS)
    assert count >= 4 + 3 * len(rig.contacts)
    assert least_px >= 11
    assert right_px <= width_px - 10
    assert overlaps == []
