"""The page of a diagnosis: its numbers, its pictures, its form; and what the screen shows."""

import re
from base64 import b64decode
from html.parser import HTMLParser
from io import BytesIO, StringIO

import pytest
from matplotlib.image import imread
from msgspec.structs import replace
from rich.console import Console

from identify.gap.pictures import pictures
from identify.gap.report import shown, write_page
from identify.gap.results import Closure, Value
from identify.gap.wording import closed, interval
from identify.wording import COVERED, number, percent
from rig.errors import RigError

VOID = {"meta", "img", "br", "link", "hr"}
PHONE_PX = 375


class Page(HTMLParser):
    """Texts, headings, pictures and tags of a page; open tags must be closed in turn."""

    def __init__(self, content):
        super().__init__()
        self.open, self.tags, self.texts, self.headings, self.images = [], [], [], [], []
        self.feed(content)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.texts.append(data.strip())
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


@pytest.fixture(scope="module")
def written(diagnosis, tmp_path_factory):
    """A diagnosis, its pictures, and its page as parsed."""
    figures, path = pictures(diagnosis), tmp_path_factory.mktemp("page") / "gap.html"
    write_page(diagnosis, figures, "Gap of one & two", path)
    return diagnosis, figures, Page(path.read_text(encoding="utf-8")), path


def test_the_page_answers_the_four_questions_below_the_verdict(written):
    gap, _, page, _ = written
    assert page.headings == ["Is there a gap?", "Where?", "Why?", "How far does it shrink?"]
    assert page.texts.index(gap.sentence) < page.texts.index(page.headings[0])
    assert "Gap of one & two" in page.texts


def test_every_number_is_on_the_page(written):
    gap, _, page, _ = written
    said = {number(gap.size, 3), closed(gap.closure)}
    said |= {number(x, 3) for x in (gap.closure.before, gap.closure.floor, gap.closure.after)}
    said.add(percent(1.0 - sum(c.probability for c in gap.causes)))
    for cause in gap.causes:
        said |= {percent(cause.probability), number(cause.left, 3), *cause.places.values(), *cause.parameters}
        said |= {interval(v) for v in cause.parameters.values()}
    for figure in gap.likeness:
        said |= {number(x) for x in (figure.measured, figure.believed, figure.corrected)}
        said.add(f"{figure.name}, {figure.unit}")
    where = gap.where
    for shares in (
        where.channels,
        where.parts,
        where.modal_equations,
        where.contact_state,
        *where.positions_m.values(),
    ):
        said |= {percent(s) for s in shares.values()}
    said |= {percent(s.share) for s in (*where.band_hz, *where.time_s)}
    said |= {" / ".join(names) for names in gap.equivalent} | set(gap.separate_by)
    said |= set(gap.channel_faults) | set(gap.channel_faults.values())
    assert said <= set(page.texts)


def test_the_pictures_are_in_the_page_and_nothing_is_fetched(written):
    _, figures, page, path = written
    assert len(page.images) == len(figures)
    for image in page.images:
        kind, _, content = image["src"].partition(",")
        assert kind == "data:image/png;base64"
        png = b64decode(content, validate=True)
        assert png == figures[image["alt"].replace(" ", "_")]
        assert imread(BytesIO(png)).ndim == 3
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "http" not in re.sub(r'src="data:[^"]*"', "", path.read_text(encoding="utf-8"))


def test_a_cause_is_accepted_only_where_the_verdict_says_so(written):
    gap, _, page, _ = written
    assert ("No cause is accepted. What was tried:" in page.texts) == (gap.verdict != "effect")


def test_names_cannot_break_the_page(gaps, tmp_path):
    gap = gaps["effect"]
    bold = "<b>"
    channels = {bold: 0.6, "\"&amp;'>": 0.4}
    cause = replace(gap.causes[0], places={"added_mass.body": "</table>"})
    odd = replace(
        gap,
        sentence="The gap is <i>here</i>.",
        where=replace(gap.where, channels=channels),
        causes=(cause,),
        channel_faults={bold: "dead"},
        separate_by=("<script>alert(1)</script>",),
    )
    path = tmp_path / "gap.html"
    write_page(odd, {}, "</title>", path)
    page = Page(path.read_text(encoding="utf-8"))
    assert {*channels, "</table>", "</title>", odd.sentence, *odd.separate_by} <= set(page.texts)
    assert page.tags.count("b") == 2  # the verdict and the size
    assert not {"i", "script"} & set(page.tags)


def test_a_page_is_replaced_whole(gaps, tmp_path):
    path = tmp_path / "gap.html"
    path.write_text("old " * 100_000)
    write_page(gaps["null"], {}, "new", path)
    content = path.read_text(encoding="utf-8")
    assert content.startswith("<!DOCTYPE html>")
    assert content.endswith("</html>\n")
    assert "old old" not in content
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_is_not_written_through(gaps, tmp_path):
    target, link = tmp_path / "target", tmp_path / "gap.html"
    target.write_text("kept")
    link.symlink_to(target)
    with pytest.raises(RigError, match="symbolic link"):
        write_page(gaps["null"], {}, "new", link)
    assert target.read_text() == "kept"


def test_the_screen_shows_the_verdict(diagnosis):
    console = Console(width=300, record=True, file=StringIO())
    console.print(shown(diagnosis))
    text = console.export_text()
    assert diagnosis.sentence in text
    assert closed(diagnosis.closure) in text
    for cause in diagnosis.causes:
        assert percent(cause.probability) in text
        for value in cause.parameters.values():
            assert interval(value) in text
    for names in diagnosis.equivalent:
        assert " / ".join(names) in text


def test_an_interval_has_two_digits_of_its_half_width():
    for value, half, unit, said in (
        (0.1414, 0.0021, "kg", "0.1414 ± 0.0021 kg"),
        (1.0, 0.034, "1", "1.000 ± 0.034"),
        (123456.0, 1200.0, "N/m", "123500 ± 1200 N/m"),
        (-0.5, 0.0999, "m", "-0.50 ± 0.10 m"),
        (1.83e-4, 7.8e-6, "s", "(1.830 ± 0.078)e-4 s"),
        (2.96e10, 8e8, "N/m^3", "(2.960 ± 0.080)e10 N/m^3"),
        (0.0, 0.25, "N", "0.00 ± 0.25 N"),
    ):
        assert interval(Value(value, half / COVERED, unit)) == said


@pytest.mark.parametrize("error", [0.0, float("nan"), float("inf")])
def test_no_interval_is_claimed_where_there_is_none(error):
    assert interval(Value(0.25, error, "N")) == "0.2500 N (no interval)"


def test_nothing_is_said_to_be_certain():
    assert percent(0.0004) == "< 0.1 %"
    assert percent(0.99996) == "> 99.9 %"
    assert percent(0.934) == "93.4 %"


def test_near_the_floor_no_fraction_is_given():
    assert closed(Closure(0.94, 0.92, 0.94, None, None)).startswith("no share")
    assert closed(Closure(2.0, 1.0, 1.1, 0.9, (0.8, 1.0))) == "90.0 % (95 % interval 80.0 % to 100.0 %)"


def test_a_browser_shows_all_of_it_on_a_phone(opened, written):
    """Nothing is wider than the window, every picture is there, and the console is silent."""
    _, figures, _, path = written
    seen = opened(path, PHONE_PX)
    assert seen.scroll_px <= PHONE_PX
    assert len(seen.pictures_px) == len(figures)
    assert min(seen.pictures_px) > 0
    assert seen.console == ()
