"""The page of a diagnosis: its numbers, its pictures, its form; and what the screen and the other files show."""

import re
from base64 import b64decode
from html import escape
from html.parser import HTMLParser
from io import BytesIO, StringIO

import msgspec
import numpy as np
import pytest
from matplotlib.image import imread
from msgspec.structs import replace
from rich.console import Console

from identify.gaps.decision.sentence import sentences
from identify.gaps.decision_table import Bounded
from identify.gaps.page.advice import next_steps
from identify.gaps.page.pictures import pictures
from identify.gaps.page.report import CAPTION_BY_FIGURE, captioned_drawing, curves, marks, write_all, write_page
from identify.gaps.page.screen import screen_view
from identify.gaps.results import Attribution, FailedAnalysis, Gap
from identify.gaps.wording import (
    check_findings_introduction,
    interval,
    named_effects_with_look_alikes,
    probability,
    removed_share_words,
    share_words,
    unexplained_words,
)
from identify.pages.drawing import drawing_html
from identify.pages.drawing_texts import HELD_WORDS
from identify.pages.page import unbroken_html
from identify.pages.style import picture
from identify.pages.wording import number, p_value_words, percent
from rig.errors import RigError
from rig.model.components import Support
from rig.model.description import Station, from_json
from rig.model.unmeasured_force import MeanForce, Value
from tests.identify.gaps import diagnoses
from tests.identify.test_structure import as_data

VOID = {"meta", "img", "br", "wbr", "link", "hr"}
PHONE_PX = 375


class Page(HTMLParser):
    """Texts, headings, pictures and tags of a page; open tags must be closed in turn."""

    def __init__(self, content):
        super().__init__()
        self.open, self.tags, self.texts, self.headings, self.images = [], [], [], [], []
        self.feed(re.sub("<span class='option'>(.*?)</span>", r"\1", content))
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
            self.texts.append(data.strip().replace("\xa0", " "))
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def html_of(gap, folder, figures=(), title="title", **options):
    write_page(gap, dict(figures), title, folder / "gap.html", **options)
    return (folder / "gap.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def written(drawn_diagnosis, rig_of, tmp_path_factory):
    """A diagnosis, its pictures, and its page as parsed, with the drawing of the rig."""
    figures, folder, rig = pictures(drawn_diagnosis), tmp_path_factory.mktemp("page"), rig_of(drawn_diagnosis)
    drawing = drawing_html(rig, {}, marks(drawn_diagnosis, rig))
    page = Page(html_of(drawn_diagnosis, folder, figures, "Gap of one & two", drawing=drawing))
    return drawn_diagnosis, figures, page, folder / "gap.html"


def test_the_page_says_the_verdict_then_what_to_do_then_why(written):
    gap, _, page, _ = written
    unknown = "What the rest looks like" if gap.verdict == "partly_explained" else "What is not explained"
    assert page.headings == [
        "What to do next",
        *(["Which further recording?"] if gap.next_experiments else []),
        "How large is the difference?",
        "What causes it?",
        *(["Does the model move as the machine?"] if gap.rollout else []),
        "How was it decided?",
        *(["What differs between the records?"] if gap.between else []),
        *([unknown] if gap.unknown else []),
        "Where does it lie?",
    ]
    assert all(page.texts.index(said) < page.texts.index(page.headings[0]) for said in sentences(gap))
    assert "Gap of one & two" in page.texts


def test_every_number_is_on_the_page(written):
    gap, _, page, _ = written
    said = {percent(gap.matters.motion), probability(gap.probability_nothing), probability(gap.probability_unknown)}
    lefts = [gap.before, *(cause.left for cause in gap.causes)]
    said |= {share_words(s) for left in lefts for s in (left.share, *left.contact_shares.values())}
    for cause in gap.causes:
        said |= {probability(cause.probability), removed_share_words(cause), *cause.places.values(), *cause.parameters}
        said |= {interval(v) for v in cause.parameters.values()}
    where = gap.attribution
    divisions = (where.channels, where.parts, where.modal_equations, where.contact_state, *where.positions_m.values())
    said |= {percent(s) for shares in divisions for s in shares.values()}
    said |= {percent(s.share) for s in (*where.band_hz, *where.time_s)}
    said |= {" / ".join([words, *others]) for words, others in named_effects_with_look_alikes(gap)} | set(
        next_steps(gap)
    )
    said |= {share_words(x) for q in gap.evidence.quantities for x in (q.value, q.upper) if q.upper is not None}
    said |= {words for cause in gap.causes[:1] for words in cause.words}
    if gap.rollout:
        said |= {percent(gap.rollout.whole.nominal), percent(gap.rollout.whole.corrected)}
    said |= set(gap.channel_faults) | set(gap.channel_faults.values())
    if gap.between:
        for one in (*gap.between.cause, *gap.between.differing):
            said |= {one.parameter, one.place, p_value_words(one.p_value), *(interval(v) for v in one.values)}
        said |= {f"record {name}" for name in gap.between.records} | {"grows"}
        differs = "contact_clearance.factor (contact_2) grows (1.0060 ± 0.0039, 1.0060 ± 0.0039, 1.0870 ± 0.0039)"
        assert f"Between the records, {differs}." in gap.sentence
        assert "contact_clearance" in next_steps(gap)[0]
    if gap.unknown:
        said |= {gap.unknown.law, percent(gap.unknown.explained), f"{number(gap.unknown.rms_n, 3)} N rms"}
    assert said <= set(page.texts)
    text = " ".join(page.texts)
    assert p_value_words(gap.evidence.p_value) in text


def test_the_pictures_are_in_the_page_and_nothing_is_fetched(written):
    _, figures, page, path = written
    text = path.read_text(encoding="utf-8")
    assert len(page.images) + text.count('class="plot"') == len(figures)
    for image in page.images:
        kind, _, content = image["src"].partition(",")
        assert kind == "data:image/png;base64"
        png = b64decode(content, validate=True)
        assert png == figures[image["alt"].replace(" ", "_")].png
        assert imread(BytesIO(png)).ndim == 3
    assert not {"link", "iframe"} & set(page.tags)
    assert "http" not in re.sub(r'src="data:[^"]*"|<script>.*?</script>', "", text, flags=re.DOTALL)
    assert "<script src" not in text
    assert len(text) < 3e6


def test_a_limit_that_is_reached_is_said(gaps, tmp_path):
    gap = gaps["explained"]
    assert "The best added_mass.mass_kg is the end of its range" in gap.sentence
    assert "(at the limit of its range)" in html_of(gap, tmp_path)


def test_what_could_not_be_computed_is_noted(gaps, tmp_path):
    gap = replace(gaps["pair"], attribution=Attribution(), notes=(FailedAnalysis("attribution", "singular <matrix>"),))
    said = "Not computed: where the difference lies (singular <matrix>)."
    assert escape(said) in html_of(gap, tmp_path)
    console = Console(width=300, record=True)
    console.print(screen_view(gap))
    assert said in console.export_text()


def test_what_is_not_seen_is_said_with_what_would_show_it(gaps, tmp_path):
    gap = gaps["cannot_tell"]
    assert gap.sentence.startswith("No difference from rig.json stands out")
    assert "but these records do not settle 1 of the" in gap.sentence
    assert "Not settled: the force of contact_1 (noise hides it); excite the rig more strongly." in gap.sentence
    assert next_steps(gap)[:2] == ["Do not rely on rig.json yet.", "Excite the rig more strongly, and diagnose again."]
    assert '<div class="verdict yellow"><b>cannot tell</b>' in html_of(gap, tmp_path)


def test_numbers_stay_on_a_line_with_their_units():
    broken = escape("1.2 % of the motion, < 0.1 % (p = 0.31), 0.141 kg, 3.1 N s/m at 0.99 m in 3 machines")
    assert unbroken_html(broken).split(" ") == [
        *("1.2\xa0%", "of", "the", "motion,", "&lt;\xa00.1\xa0%", "(p\xa0=\xa00.31),"),
        *("0.141\xa0kg,", "3.1\xa0N\xa0s/m", "at", "0.99\xa0m", "in", "3", "machines"),
    ]


def test_names_cannot_break_the_page(gaps, tmp_path):
    gap = gaps["explained"]
    channels = {"<b>": 0.6, "\"&amp;'>": 0.4}
    cause = replace(gap.causes[0], places={"added_mass.body": "</table>"}, words=("a mass on <i>",))
    odd = replace(
        gap,
        attribution=replace(gap.attribution, channels=channels),
        causes=(cause,),
        channel_faults={"<b>": "dead"},
        separate_by=("added_mass: <script>alert(1)</script>",),
    )
    page = Page(html_of(odd, tmp_path, title="</title>"))
    said = {
        *channels,
        "</table>",
        "</title>",
        "Channel <b> is dead and was left out.",
        "To test for added mass: <script>alert(1)</script>.",
    }
    assert said <= set(page.texts)
    assert page.tags.count("b") == 1  # the verdict
    assert "i" not in page.tags
    assert page.tags.count("script") == 1  # the page's own, for the printer


def test_findings_say_that_the_check_knows_no_unmeasured_tone(gaps):
    assert check_findings_introduction(gaps["consistent"]) == "The check of the recordings says:"
    cause_words = "perhaps because of the difference above (mend no channel before that is explained)"
    hum = "an unmeasured tone of 12.2 Hz on the frame at 0.30 m"
    frequency = {"tone.frequency_hz": (12.2, 0.1, "Hz")}
    tone = diagnoses.cause(("tone",), (hum,), 0.99, 0.9, (0.8, 0.95), diagnoses.SMALL, frequency)
    heading = check_findings_introduction(replace(gaps["explained"], causes=(tone,)))
    assert heading == f"The check of the recordings, which does not know {hum}, says, {cause_words}:"
    heading = check_findings_introduction(gaps["unexplained"])
    unknown_words = "which does not know the unmeasured force described above"
    assert heading == f"The check of the recordings, {unknown_words}, says, {cause_words}:"


@pytest.mark.parametrize(("name", "stands_on_top"), [("explained", False), ("consistent", True)])
def test_findings_of_the_check_stand_behind_a_certain_difference(gaps, tmp_path, name, stands_on_top):
    html = html_of(gaps[name], tmp_path, findings=("barrel_6 is upside down <",))
    assert (html.index("barrel_6 is upside down &lt;") < html.index("What to do next")) == stands_on_top


def test_two_findings_stand_on_top_and_the_others_are_counted(gaps, tmp_path):
    findings = [f"barrel_{number} is upside down" for number in range(5)]
    texts = Page(html_of(gaps["explained"], tmp_path, findings=findings)).texts
    assert [text for text in texts if "upside" in text] == findings[:2]
    assert "3 more: identify check lists them." in texts


def test_what_the_records_tell_instead_of_a_strength_stands_below_the_drawing(gaps, rig_of):
    cause = gaps["explained"].causes[0]
    told = "not told, as one mode dominates; told: the frequency of the mode at 4.9 Hz changes by -0.31 ± 0.02 Hz"
    parameters = cause.parameters | {
        "added_mass.mass_kg": replace(cause.parameters["added_mass.mass_kg"], instead=told)
    }
    gap = replace(gaps["explained"], causes=(replace(cause, parameters=parameters),))
    for one, is_there in ((gap, True), (gaps["explained"], False)):
        caption = re.search("<figcaption>The rig, (.*?)</figcaption>", captioned_drawing(one, rig_of(gap)))[1]
        assert (f"Added_mass mass: {told}." in caption.replace("\xa0", " ")) == is_there


def test_an_option_stays_whole():
    assert unbroken_html("use --next-experiment (--out writes") == (
        "use <span class='option'>--next-experiment</span> (<span class='option'>--out</span> writes"
    )


def test_what_the_verdict_names_is_marked_at_its_place(gaps, rig_of):
    gap = gaps["explained"]
    (mark,) = marks(gap, rig_of(gap))
    position_m = gap.causes[0].parameters["added_mass.relative_position"].value * rig_of(gap).body("barrel").length_m
    assert (mark.station.body, mark.station.position_m) == ("barrel", pytest.approx(position_m))
    assert mark.words == gap.causes[0].words[0]
    assert marks(gaps["consistent"], rig_of(gaps["consistent"])) == ()


def test_an_effect_of_all_contacts_is_marked_at_each(gaps, rig_of):
    gap = gaps["explained"]
    (cause, *others) = gap.causes
    cause = replace(cause, places={"added_mass.contact": "all"})
    drawn = marks(replace(gap, causes=(cause, *others)), rig_of(gap))
    assert [mark.station for mark in drawn] == [contact.at for contact in rig_of(gap).contacts]
    assert [mark.words for mark in drawn] == [cause.words[0], "likewise"]


@pytest.fixture(scope="module")
def a_picture():
    return picture(lambda figure: figure.subplots().plot([0, 1]), 3.0, 2.0)


def test_what_decides_stands_beside_the_drawing(gaps, a_picture, tmp_path):
    gap = gaps["explained"]
    motion = Bounded("motion", "1", 0.004, 0.006, 5e-3)
    force = Bounded("force of contact_1", "1", 0.3, 0.4, 3e-2)
    for quantities, first, folded in (
        ((motion, force), "decided_quantities", "large_bands"),
        ((replace(motion, value=0.1), force), "large_bands", "decided_quantities"),
        ((motion, replace(force, value=None, upper=None)), "large_bands", "decided_quantities"),
    ):
        decided = replace(gap, evidence=replace(gap.evidence, quantities=quantities, quantities_after=quantities))
        html = html_of(decided, tmp_path, dict.fromkeys((first, folded), a_picture))
        assert 0 < html.index(CAPTION_BY_FIGURE[first]) < html.index(CAPTION_BY_FIGURE[folded])


def test_a_veto_shows_the_motion_first_and_doubts_what_is_marked(gaps, rig_of, a_picture, tmp_path):
    gap = gaps["vetoed"]
    html = html_of(gap, tmp_path, dict.fromkeys(("large_bands", "prediction_motion"), a_picture))
    assert 0 < html.index(CAPTION_BY_FIGURE["prediction_motion"]) < html.index(CAPTION_BY_FIGURE["large_bands"])
    assert [mark.words for mark in marks(gap, rig_of(gap))] == [f"doubtful: {gap.causes[0].words[0]}"]


def test_what_nothing_bounds_is_drawn_to_the_edge(gaps):
    (axes,) = pictures(gaps["cannot_tell"])["decided_quantities"].figure.axes
    lines = [(line.get_xdata(), line.get_ydata()) for line in axes.lines]
    ends = [x[1] for x, y in lines if len(set(y)) == 1 and len(x) == 2]
    quantities = gaps["cannot_tell"].evidence.quantities
    assert [end > axes.get_xlim()[1] for end in ends[: len(quantities)]] == [q.upper is None for q in quantities]


@pytest.mark.parametrize(
    ("change", "stations", "words"),
    [
        ({}, [("barrel", None)], "unmeasured force"),
        (
            {"kind": "pair", "against_body": "cradle", "against_position_m": 0.7},
            [("barrel", None), ("cradle", 0.7)],
            "unmeasured pair of forces",
        ),
        ({"kind": "sensor", "body": None, "sensor": "cradle_0200mm_acceleration"}, [("cradle", 0.2)], "cradle_0200mm"),
        ({"kind": "contact", "body": None, "contact": "contact_2"}, [("barrel", 0.55)], "contact_2: clearance"),
        (
            {"kind": "distributed", "body": None, "growth": {"barrel": Value(-0.03, 1e-3, "1")}},
            [("barrel", 0.5)],
            "stif",
        ),
    ],
)
def test_every_kind_of_unmeasured_force_is_marked_at_its_place(gaps, rig_of, change, stations, words):
    gap = gaps["unexplained"]
    gap = replace(gap, unknown=replace(gap.unknown, **change))
    drawn = marks(gap, rig_of(gap))
    expected = [(body, pytest.approx(gap.unknown.position_m if x_m is None else x_m)) for body, x_m in stations]
    assert [(mark.station.body, mark.station.position_m) for mark in drawn] == expected
    assert drawn[0].words.startswith(words)


def test_a_page_is_replaced_whole(gaps, tmp_path):
    path = tmp_path / "gap.html"
    path.write_text("old " * 100_000)
    content = html_of(gaps["consistent"], tmp_path)
    assert content.startswith("<!DOCTYPE html>")
    assert content.endswith("</html>\n")
    assert "old old" not in content
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_is_not_written_through(gaps, tmp_path):
    target, link = tmp_path / "target", tmp_path / "gap.html"
    target.write_text("kept")
    link.symlink_to(target)
    with pytest.raises(RigError, match="symbolic link"):
        write_page(gaps["consistent"], {}, "new", link)
    assert target.read_text() == "kept"


def test_the_screen_shows_the_verdict(diagnosis):
    console = Console(width=900, record=True, file=StringIO())
    console.print(screen_view(diagnosis))
    text = console.export_text()
    assert diagnosis.sentence in text
    for cause in diagnosis.causes:
        assert probability(cause.probability) in text
        assert removed_share_words(cause) in text
        assert unexplained_words(cause.left) in text
        for value in cause.parameters.values():
            assert (interval(value) in text) or cause.probability < 0.05
    for step in next_steps(diagnosis):
        assert step in text
    if diagnosis.unknown:
        assert diagnosis.unknown.sentence in text


def test_page_numbers_and_corrected_rig_are_written_together(gaps, rig_of, tmp_path):
    gap = gaps["one_mass"]
    write_all(gap, rig_of(gap), "one mass", tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"gap.html", "gap.json", "rig.json"}
    assert msgspec.json.decode((tmp_path / "out" / "gap.json").read_bytes(), type=Gap) == gap
    assert from_json((tmp_path / "out" / "rig.json").read_bytes(), "rig.json") == rig_of(gap)


def test_a_browser_shows_all_of_it_on_a_phone(opened, written):
    """Nothing is wider than the window, every picture is there, and the console is silent."""
    _, figures, _, path = written
    seen = opened(path, PHONE_PX)
    assert seen.scroll_px <= PHONE_PX
    assert len(seen.pictures_px) + len(seen.plots_px) == len(figures)
    assert min(*seen.pictures_px, *seen.plots_px) > 0
    assert seen.console == ()


def test_the_page_is_accessible(inaccessible, written):
    _, _, _, path = written
    assert inaccessible(path, PHONE_PX) == []


def test_the_page_of_a_structure_is_accessible(inaccessible, gaps, rig_of, tmp_path):
    gap = gaps["partly_explained"]
    rig = as_data(rig_of(gap))
    html = html_of(gap, tmp_path, drawing=captioned_drawing(gap, rig))
    assert html.count(HELD_WORDS) == 2 * sum(body.rigid_modes == 0 for body in rig.bodies) == 2  # wide and narrow
    assert inaccessible(tmp_path / "gap.html", PHONE_PX) == []


def test_what_explains_little_is_marked_as_a_hint_or_not_at_all(gaps, rig_of):
    gap = gaps["unexplained"]
    for explained, begin in (
        (0.6, ["unmeasured force"]),
        (0.3, ["a hint (explains 30.0 % of the mean square): unmeasured force"]),
        (0.05, []),
    ):
        drawn = marks(replace(gap, unknown=replace(gap.unknown, explained=explained)), rig_of(gap))
        assert [mark.words.partition(",")[0] for mark in drawn] == begin
        assert [mark.is_hint for mark in drawn] == [explained < 0.5 for _ in begin]


def test_the_law_of_an_unmeasured_force_is_drawn_as_named_and_its_dots_less_a_linear_part(gaps):
    """The force of the law's own formula over the cells, with a part that is linear in the motion, gives back the law;
    of a law that is linear itself the dots stay."""
    unknown = gaps["unexplained"].unknown
    edges_m, edges_m_per_s = np.linspace(-0.05, 0.05, 41), np.linspace(-1.0, 1.0, 41)
    middle_m, middle_m_per_s = (np.convolve(edges, [0.5, 0.5], "valid") for edges in (edges_m, edges_m_per_s))
    stiffness, w0 = (unknown.law_parameters[name].value for name in ("coefficient", "w0"))
    law_n = stiffness * w0 * np.tanh(middle_m / w0)
    cells_n = (law_n - 20.0 * middle_m)[:, None] - 0.3 * middle_m_per_s + 0.01
    over_motion = MeanForce(tuple(edges_m), tuple(edges_m_per_s), tuple(map(tuple, cells_n)))
    gap = replace(gaps["unexplained"], unknown=replace(unknown, over_motion=over_motion))
    axes = pictures(gap)["unknown_law"].figure.axes[0]
    (line,), dots = axes.lines, axes.collections[0].get_offsets()
    for w_mm, force_n in (line.get_data(), np.transpose(dots)):
        np.testing.assert_allclose(force_n, stiffness * w0 * np.tanh(1e-3 * w_mm / w0), atol=1e-9)
    spring = replace(gap.unknown, law_name="linear spring", law_parameters={"coefficient": Value(50.0, 1.0, "N/m")})
    axes = pictures(replace(gap, unknown=spring))["unknown_law"].figure.axes[0]
    (line,), dots = axes.lines, axes.collections[0].get_offsets()
    np.testing.assert_allclose(line.get_ydata(), 50.0 * 1e-3 * line.get_xdata(), atol=1e-9)
    np.testing.assert_array_equal(dots[:, 1], cells_n.ravel())


def test_the_exported_curves_are_those_of_the_page(diagnosis):
    tables = curves(diagnosis)
    assert list(tables) == ["bands"] * bool(diagnosis.bands)
    if diagnosis.bands:
        np.testing.assert_array_equal(tables["bands"]["from Hz"], [band.low_hz for band in diagnosis.bands])


@pytest.mark.parametrize(
    ("effect", "place", "positions_m"),
    [
        ("support_position", "body", [0.3, 0.9]),
        ("clamp_compliance", "beam", [0.0]),
        ("youngs_modulus", "beam", [0.5]),
    ],
)
def test_a_support_is_marked_where_it_stands(gaps, rig_of, effect, place, positions_m):
    """It was marked in the middle of its beam, as a change of the whole body is."""
    rig = rig_of(gaps["explained"])
    supports = tuple(Support(station=Station("cradle", x_m)) for x_m in (0.3, 0.9))
    rig = replace(rig, supports=supports)
    (cause, *others) = gaps["explained"].causes
    cause = replace(cause, effects=(effect,), places={f"{effect}.{place}": "cradle"}, parameters={})
    drawn = marks(replace(gaps["explained"], causes=(cause, *others)), rig)
    assert [mark.station for mark in drawn] == [Station("cradle", x_m) for x_m in positions_m]
    assert [mark.of_whole_body for mark in drawn] == [effect == "youngs_modulus"] * len(positions_m)
