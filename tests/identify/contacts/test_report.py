"""The page of an identification: its values, what it assumed, what would make it surer; and in a browser."""

from dataclasses import replace
from html import escape, unescape

import msgspec
import numpy as np
import pytest

from identify.contacts import identify_contact
from identify.contacts.assumptions import recommendations, variance_shares
from identify.contacts.refusals import REMEDIES
from identify.contacts.report import write_page, write_results
from identify.contacts.results import identified_rig
from identify.pages.wording import interval
from rig.model.tolerances import EXACT, UNKNOWN, Tolerances
from rig.recording import read
from rig.simulation.reference import Sdof

PHONE_PX = 375


@pytest.fixture(scope="module")
def identification(simulate, tmp_path_factory):
    """The one mass by its accelerometer alone, described as a laboratory would believe it."""
    settings = Sdof(duration_s=60.0, step_s=2.0**-12, sensors="acceleration", noise_density=1e-3)
    return identify_contact(read(simulate(settings, tmp_path_factory.mktemp("report") / "mass.mcap")))


@pytest.fixture(scope="module")
def silent(simulate, tmp_path_factory):
    """A force too weak to close the contact."""
    path = simulate(Sdof(duration_s=20.0, step_s=2.0**-12, rms_n=0.01), tmp_path_factory.mktemp("weak") / "weak.mcap")
    return identify_contact(read(path), use="displacement", tolerances=EXACT)


@pytest.fixture
def page(tmp_path):
    """Function that writes the page of an identification without its figures and returns its HTML."""

    def written(identification, title="mass", laws_name="true"):
        path = tmp_path / "contact.html"
        write_page(identification, {}, title, {c.name: c.law for c in identification.rig.contacts}, laws_name, path)
        return path.read_text(encoding="utf-8")

    return written


def _text(html):
    """Return the text of a page, whose numbers stand one ordinary space from their units."""
    return unescape(html).replace("\N{NO-BREAK SPACE}", " ")


def test_what_nobody_believes_is_compared_with_nothing(identification, tmp_path):
    """As of `rig init`, which was not told the contact: its start says nothing about the machine."""
    path = tmp_path / "contact.html"
    write_page(identification, {}, "mass", {}, "rig.json", path)
    text = _text(path.read_text(encoding="utf-8"))
    assert "unknown" in text
    for words in ("agrees<", "differs<", "interval holds", "lie outside"):
        assert words not in text


def test_what_was_unknown_is_known_once_identified(identification):
    unknown = msgspec.structs.replace(
        identification.rig, tolerances=Tolerances(clearance=UNKNOWN, stiffness=UNKNOWN, mass=0.02)
    )
    found = identified_rig(unknown, identification.report)
    assert found.tolerances == Tolerances(mass=0.02)
    nothing_found = msgspec.structs.replace(identification.report, contacts=())
    assert identified_rig(unknown, nothing_found).tolerances == unknown.tolerances


def test_the_values_stand_with_their_intervals_beside_the_true_ones(identification, page):
    text, law = _text(page(identification)), identification.rig.contacts[0].law
    (contact,) = identification.report.contacts
    for estimate, true, scale, name in (
        (contact.clearance_m, law.clearance_m, 1e3, "clearance, mm"),
        (contact.stiffness_n_per_m, law.stiffness_n_per_m, 1.0, "stiffness, N/m"),
    ):
        value = interval(scale * estimate.value, scale * estimate.standard_error, "1")
        assert f'<td>{name}</td><td class="number">{value}</td>' in text
        agrees = abs(estimate.value - true) < 1.96 * estimate.standard_error
        assert f"{round(100 * (estimate.value / true - 1), 3):+.3g} %, {'agrees' if agrees else 'differs'}" in text
    assert "<th>true</th>" in text
    assert "<b>identified</b>" in text


def test_the_answer_says_whether_the_reference_agrees(identification, tmp_path):
    """A reference that is 10 % off lies outside every interval of this record that it concerns."""
    (contact,) = identification.rig.contacts
    lower_m, upper_m = 1.1 * contact.law.lower_clearance_m, 1.1 * contact.law.upper_clearance_m
    wide = msgspec.structs.replace(contact.law, lower_clearance_m=lower_m, upper_clearance_m=upper_m)
    for law, expected in (
        (contact.law, "Every rig.json value lies inside its 95 % interval."),
        (
            wide,
            "These rig.json values lie outside the 95 % intervals: clearance, lower clearance and upper clearance of "
            f"{contact.name}.",
        ),
    ):
        path = tmp_path / "contact.html"
        write_page(identification, {}, "mass", {contact.name: law}, "rig.json", path)
        assert expected in _text(path.read_text(encoding="utf-8"))


def test_a_single_touched_stop_has_one_clearance_by_its_side(identification, page):
    (contact,) = identification.report.contacts
    upper = msgspec.structs.replace(contact, clearance_m=contact.upper_clearance_m, lower_clearance_m=None)
    report = msgspec.structs.replace(identification.report, contacts=(upper,))
    text = _text(page(replace(identification, report=report)))
    assert "<td>upper clearance, mm</td>" in text
    assert "<td>clearance, mm</td>" not in text
    assert "half the total play" not in text


def test_what_was_assumed_is_said(identification, silent, page):
    text = _text(page(identification))
    assert all(name in text for name in identification.report.channels_used)
    assert f"gains {100 * identification.tolerances.gain:.2g} %" in text
    assert "believed exactly" not in text
    text = _text(page(silent))
    assert "believed exactly" in text
    for sensor in silent.rig.sensors:
        assert sensor.name in text


def test_a_refused_contact_is_named_with_the_reason_and_what_to_do(silent, page):
    text = _text(page(silent))
    (refused,) = silent.report.unanswered
    assert refused.reason in text
    assert "Simulate with the identified rig.json" not in text
    assert "0 of 1 contacts identified" in text
    assert f"{refused.name}: {REMEDIES[refused.remedy]}." in recommendations(silent)


def test_the_sources_of_error_share_the_variance(identification):
    (estimate,) = identification.outcomes.estimates.values()
    for shares in variance_shares(estimate).values():
        assert sum(shares.values()) == pytest.approx(1.0)
        assert min(shares.values()) >= 0
    trusting = replace(estimate, covariances={**estimate.covariances, "tolerances": np.zeros((4, 4))})
    assert all(shares["tolerances"] == 0 for shares in variance_shares(trusting).values())


@pytest.mark.parametrize(
    ("source", "remedy"), [("tolerances", "calibrate"), ("drift", "displacement sensors"), ("scatter", "record longer")]
)
def test_what_rules_the_error_is_what_is_advised(identification, source, remedy):
    (estimate,) = identification.outcomes.estimates.values()
    dominated = replace(estimate, covariances={source: estimate.covariance})
    ruled = replace(identification, outcomes=replace(identification.outcomes, estimates={"stop": dominated}))
    said = [line for line in recommendations(ruled) if line.startswith("Most of the variance")]
    assert len(said) == 1
    assert remedy in said[0]


def test_names_cannot_break_the_page(identification, page):
    odd = "<i>&\"'</title>"
    text = page(identification, title=odd, laws_name=odd)
    assert text.count(escape(odd)) == 4  # twice the title, once the column, once the answer
    assert "<i>" not in text


@pytest.fixture(scope="module")
def drawn_page(identification, tmp_path_factory):
    """contact.html with its figures, which lie beside it."""
    laws, folder = {c.name: c.law for c in identification.rig.contacts}, tmp_path_factory.mktemp("drawn")
    write_results(identification, folder, "mass", laws, "true")
    return folder / "contact.html"


def test_the_page_is_accessible(inaccessible, drawn_page):
    assert inaccessible(drawn_page, PHONE_PX) == []


@pytest.mark.study
def test_the_page_of_a_refused_record_is_accessible(inaccessible, silent, tmp_path):
    write_results(silent, tmp_path, "mass", {c.name: c.law for c in silent.rig.contacts}, "true")
    assert inaccessible(tmp_path / "contact.html", PHONE_PX) == []


def test_a_browser_shows_all_of_it_on_a_phone(opened, drawn_page):
    browser_page = opened(drawn_page, PHONE_PX)
    assert browser_page.scroll_px <= PHONE_PX
    assert browser_page.pictures_px == ()  # all are plots to work with
    assert len(browser_page.plots_px) == len(list(drawn_page.parent.glob("*.png"))) > 0
    assert min(browser_page.plots_px) > 200
    assert browser_page.console == ()
