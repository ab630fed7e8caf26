"""Every number that the page of a diagnosis prints, found in gap.json, and its p-values on both sides of what decides.

Fields are found by value and unit: all that a printed number may be are one number of gap.json. The answers are made
such that different fields print differently.
"""

import math
import re
from html.parser import HTMLParser

import msgspec
import pytest
from msgspec.structs import replace

from identify.gaps.page.report import CAPTION_BY_FIGURE, captioned_drawing, write_page
from identify.gaps.results import Attribution, Share
from identify.pages.style import picture
from identify.pages.wording import p_value_words
from tests.identify.gaps.diagnoses import (
    BETWEEN,
    CLAMP,
    CUBIC,
    GAPS,
    MASS,
    PREDICTED,
    RIGS,
    gap,
    left,
    softening,
    tone,
    unsure,
)

ATTRIBUTION = Attribution(
    channels={"cradle_1": 0.137, "barrel_1": 0.863},
    modal_equations={"cradle 1": 0.226, "barrel 1": 0.774},
    positions_m={"cradle": {0.2: 0.318}, "barrel": {0.4: 0.682}},
    band_hz=(Share(3.0, 7.0, 0.354), Share(7.0, 13.0, 0.646)),
    contact_state={"open": 0.442, "contact_1 closed": 0.558},
    time_s=(Share(0.5, 4.5, 0.471), Share(4.5, 8.5, 0.529)),
    parts={"linear": 0.289, "contact_1": 0.711},
)
LARGE = left(0.0671, 0.1093, 0.0214, p_value=3e-4)
SMALL = left(0.0024, 0.0072, 0.0147, p_value=0.31)
REST = left(0.0134, 0.0412, 0.0091, p_value=2e-7)
FAR = left(0.0584, 0.0846, 0.0192, p_value=4e-4)


def answer(*arguments, **options):
    made = gap(
        *arguments, **{"attribution": ATTRIBUTION, "p_value": 3.7e-5, "before": LARGE, "after": SMALL, **options}
    )
    if not made.causes:
        return made
    (first, *others) = made.causes
    return replace(made, causes=(replace(first, left=made.after), *(replace(other, left=FAR) for other in others)))


def with_p_value(shares, p_value):
    return replace(shares, p_value=p_value)


MADE = {
    f"{verdict}, {note}": made
    for verdict, note, made in (
        ("explained", "noise level", answer((MASS, CLAMP), 0.0072, None, rollout=PREDICTED, between=BETWEEN)),
        ("explained", "seen", answer((MASS, CLAMP), 0.0072, None, after=with_p_value(SMALL, 0.016))),
        ("explained", "certain", answer((MASS, CLAMP), 0.0072, None, after=with_p_value(SMALL, 1.5e-6))),
        ("explained", "unsettled", answer((MASS,), 0.0072, None, after=left(0.0024, 0.0072, 0.0279, p_value=0.0593))),
        ("partly_explained", "tone", answer((MASS, CUBIC), 0.0072, tone(), after=REST)),
        ("partly_explained", "usual p", answer((MASS,), 0.0072, None, after=with_p_value(REST, 0.016))),
        ("unexplained", "force", answer((unsure(CUBIC, 1e-4),), 0.0072, softening(), after=LARGE)),
        ("small", "named", answer((MASS, CUBIC), 0.0072, None, before=SMALL, p_value=0.0043)),
        ("small", "nothing", answer((unsure(CLAMP, 0.031),), 0.0072, None, before=SMALL, p_value=0.0043)),
        ("consistent", "below 0.05", answer((unsure(CLAMP, 0.031),), 0.94, None, before=SMALL, p_value=0.016)),
        ("consistent", "above 0.05", answer((unsure(CLAMP, 0.031),), 0.94, None, before=SMALL, p_value=0.42)),
        (
            "cannot_tell",
            "below 0.05",
            answer((unsure(CLAMP, 0.031),), 0.94, None, before=SMALL, p_value=0.016, hidden="force of contact_1"),
        ),
    )
}


@pytest.fixture(params=MADE)
def made(request):
    """Answer and its verdict, as its name says."""
    verdict, _, _ = request.param.partition(",")
    assert MADE[request.param].verdict == verdict
    return MADE[request.param]


class Texts(HTMLParser):
    """Text of a page beside drawings, tables of pictures and programs; that of each table's row is one text."""

    UNREAD = ("svg", "script", "style", "title")
    BLOCKS = ("p", "li", "tr", "figcaption", "h1", "h2", "h3", "div", "summary")

    def __init__(self, html):
        super().__init__()
        self.unread, self.texts = 0, [""]
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        del attrs
        self.unread += tag in self.UNREAD
        if tag in self.BLOCKS:
            self.texts.append("")
        self.texts[-1] += " | " * (tag in ("td", "th"))

    def handle_endtag(self, tag):
        self.unread -= tag in self.UNREAD
        if tag in self.BLOCKS:
            self.texts.append("")

    def handle_data(self, data):
        if not self.unread:
            self.texts[-1] += data.replace("\xa0", " ")


@pytest.fixture(scope="module")
def figures():
    """A picture of every kind that has a caption."""
    return dict.fromkeys(CAPTION_BY_FIGURE, picture(lambda figure: figure.subplots().plot([0, 1]), 3.0, 2.0))


def texts_of(made, folder, figures=()):
    drawing = captioned_drawing(made, RIGS["explained"])
    write_page(made, dict(figures), "title", folder / "gap.html", drawing=drawing)
    html, _, _ = (folder / "gap.html").read_text(encoding="utf-8").partition("Every number of this page")
    return [text for text in Texts(html).texts if text.strip()]


UNIT = r"(?: (?P<unit>%|Hz|mm|ms|g|kg|N s/m|N/m³|N/m|N|m/s²|m|s)(?![\w/]))?"
NUMBER = re.compile(
    r"(?P<floor>< |> |fewer than |less than )?(?<![\w.])(?P<digits>\d+(?:\.\d+)?)(?:e(?P<exponent>[+-]?\d+))?"
    rf"{UNIT}"
)
FLOORS = ("0.1", "1")
"""Digits of the floors "< 0.1 %" and "< 1e-12"."""
SCALES = {"%": (100.0, "1"), "mm": (1e3, "m"), "ms": (1e3, "s"), "g": (1e3, "kg")}
"""Unit in which a number is printed: its factor, and the unit of the field."""
UNPRINTED = {"bands.before", "bands.after", "bands.usual", "bands.motion_share", "example", "surface", "over_motion"}
UNPRINTED |= {"spectrum", "spectrum_hz", "by_time", "strengths.interval_95", "strengths.neutral"}
"""Fields of curves and maps, and those that the page leaves to others."""
UNIT_BY_NAME_END = {"_hz": "Hz", "_m": "m", "_n": "N", "_s": "s", "_kg": "kg"}
COVERED = 1.96


def fields(value, name="", parent="", unit=""):
    """Number and unit of every number of gap.json, with half-widths of intervals, and lengths of its lists ("count").

    The unit of a share is "1", that of a p-value "p", that of an estimate without one "ratio".
    """
    if isinstance(value, dict):
        own = value.get("unit", "")
        if "standard_error" in value and own == "1":
            own = "ratio"
        for key, part in value.items():
            if re.fullmatch(r"[\d.]+", key):
                yield float(key), "m"
            if key in ("standard_error", "position_error_m") and part is not None:
                yield from fields(COVERED * part, key, name, own or "m")
            elif not UNPRINTED & {key, f"{name}.{key}"}:
                yield from fields(part, key, name, own if key in ("value", "upper", "threshold") else "")
    elif isinstance(value, list):
        yield len(value), "count"
        for part in value:
            yield from fields(part, name, parent, unit)
    elif isinstance(value, int) and not isinstance(value, bool):
        yield value, "count"
    elif isinstance(value, float):
        yield value, (unit or unit_of(name, parent)).replace("^3", "³").replace("^2", "²")


def unit_of(name, parent):
    """Unit of a field without one, from its name; begin and end of a part from that of its division."""
    if "p_value" in name:
        return "p"
    if name in ("begin", "end"):
        name = parent
    return next((unit for end, unit in UNIT_BY_NAME_END.items() if name.endswith(end)), "1")


def strings(value):
    """Texts of gap.json that are printed as they are; their numbers stand there in words."""
    if isinstance(value, dict):
        parts = [part for key, part in value.items() if key != "sentence" or "kind" in value]
        return [text for part in (*parts, *value) for text in strings(part)]
    if isinstance(value, list):
        return [text for part in value for text in strings(part)]
    return [value] if isinstance(value, str) and len(value) > 4 and re.search(r"\d", value) else []


def has_same_digits(number, value):
    """Whether a value in the printed unit is the printed number, within half of its last digit."""
    power = int(number["exponent"] or 0)
    whole, _, decimals = number["digits"].partition(".")
    zeros = 0 if decimals or number["exponent"] else len(whole) - len(whole.rstrip("0"))
    half_digit = 0.5001 * 10.0 ** (power + zeros - len(decimals))
    printed = float(number["digits"]) * 10.0**power
    if number["floor"] and number["digits"] in FLOORS:
        return 0 <= value < printed
    return math.isclose(abs(value), printed, rel_tol=0, abs_tol=half_digit)


def numbers_behind(number, before, after, numbers):
    """Numbers of gap.json that may be printed as this one: of its unit; a p-value where the words beside say so."""
    scale, unit = SCALES.get(number["unit"], (1.0, number["unit"] or "1"))
    if re.search(r"\bp (= )?$|yes (below|from) $", before) or after.startswith(" of tests"):
        unit = "p"
    units = {unit, "%"} if number["unit"] == "%" and unit == "1" else {unit}
    if not number["unit"] and unit == "1":
        units = {"ratio", "count"}
    found = {
        value
        for value, field_unit in numbers
        if field_unit in units and has_same_digits(number, value * (1.0 if field_unit == "%" else scale))
    }
    exact = {value for value in found if scale * value == float(number["digits"])}
    return exact if exact and "." not in number["digits"] else found


def unfound(text, numbers):
    """Numbers of a text that no number of gap.json, or more than one, is printed as."""
    text = re.sub(r"([\d.]+) to ([\d.]+) (%|Hz|s|m)(?!\w)", r"\1 \3 to \2 \3", text)
    unit = r"( (?:%|[NmHkg][\w/³]*(?: s/m)?))?"
    text = re.sub(rf"\(([\d.]+) ± ([\d.]+)\)(e\d+){unit}", r"\1\3\4 ± \2\3\4", text)
    text = re.sub(rf"([\d.]+) ± ([\d.]+){unit}", r"\1\3 ± \2\3", text)
    for match in NUMBER.finditer(text):
        found = numbers_behind(match, text[: match.start()], text[match.end() :], numbers)
        if not found or (len(found) > 1 and not match["floor"]):
            yield f"{match[0]!r} in {text!r}: {sorted(found)}"


def test_every_number_of_the_page_is_one_number_of_gap_json(made, tmp_path, figures):
    data = msgspec.json.decode(msgspec.json.encode(made))
    numbers, said = list(fields(data)), sorted(strings(data), key=len, reverse=True)
    wrong = []
    as_printed = "|".join(re.escape(string) for text in said for string in (text, text[:1].upper() + text[1:]))
    for text in texts_of(made, tmp_path, figures):
        wrong += unfound(re.sub(as_printed or "(?!)", "…", text), numbers)
    assert not wrong, "\n".join(wrong)


def test_each_p_value_has_one_name_and_one_reading(made, tmp_path):
    """`before.p_value`, which is of the validation record alone, is a third number."""
    text, evidence = " ".join(texts_of(made, tmp_path)), made.evidence
    of_all, of_the_rest = p_value_words(evidence.p_value), p_value_words(evidence.p_value_after)
    for said, name in ((of_all, "of all records"), (of_all, "a correct model"), (of_the_rest, "of what is left")):
        assert set(re.findall(rf"(p [=<] [\d.e-]*\d)(?=:? {name})", text)) <= {said}
    assert f"{of_all} of all records" in text
    is_usual = evidence.p_value_after >= 0.05 if made.verdict == "explained" else made.verdict == "consistent"
    assert ("at noise level" in text) == is_usual
    assert ("more than tolerances and noise leave" in text) <= (not is_usual)
    assert ("too little to matter" in text) + ("enough to matter" in text) <= 1
    assert "speaks against" not in text


def test_the_heading_has_one_colour_for_a_verdict(tmp_path):
    colours = {}
    for made in (*MADE.values(), *GAPS.values()):
        for findings in ((), ("barrel_1 is upside down",)):
            write_page(made, {}, "title", tmp_path / "gap.html", findings=findings)
            html = (tmp_path / "gap.html").read_text(encoding="utf-8")
            colours.setdefault(made.verdict, set()).add(re.search('class="verdict ([a-z]+)"', html)[1])
    assert all(len(found) == 1 for found in colours.values())
    assert len(colours) == 6
