"""A plan as a sentence, rows of tables and a page."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.planning import page, ranking
from identify.planning.changes import changes_of
from identify.planning.expectation import (
    ErrorParts,
    ExpectedContact,
    ExpectedQuantity,
    RefusedContact,
    SimulatedTest,
    Undetermined,
)
from identify.planning.planned_test import planned_test
from identify.planning.results import IntervalFactor, PlannedForce, PlanReport, TriedChange
from rig.simulation.reference import BarrelCradle


def quantity(value, standard_error):
    return ExpectedQuantity(value=value, standard_error=standard_error, spread_factor=1.1, limited_by="tolerances")


def change(kind, words, factor, **fields):
    largest = IntervalFactor(contact="contact_1", quantity="clearance_m", factor=factor)
    return TriedChange(
        kind=kind, words=words, widest_share=0.01 * factor, widest_factor=factor, largest=largest, **fields
    )


def test_friction_and_centre_of_a_ring_are_told_in_a_sentence(plan):
    friction = quantity(0.1, 0.001)
    ring = replace(plan.contacts[0], friction_coefficient=friction)
    centred = replace(ring, center_y_m=quantity(2e-3, 1e-5), center_z_m=quantity(0.0, 1e-6))
    assert list(page.annular_contact_sentences(replace(plan, contacts=(ring, centred)))) == [
        "contact_1: friction coefficient 0.1000 ± 0.0020; its centre cannot be determined",
        "contact_1: friction coefficient 0.1000 ± 0.0020; centre in y 2.000 ± 0.020 mm; centre in z 0.0000 ± 0.0020 mm",
    ]
    assert not list(page.annular_contact_sentences(plan))


@pytest.fixture
def plan():
    return PlanReport(
        rig="barrel_cradle",
        duration_s=30.0,
        force=PlannedForce(rms_n=(14.0,), band_hz=(0.5, 100.0)),
        contacts=(
            ExpectedContact(
                name="contact_1",
                determined_share=1.0,
                clearance_m=quantity(5e-3, 5e-6),
                stiffness_n_per_m=quantity(1e5, 500.0),
                damping_n_s_per_m=quantity(0.0, 0.1),
            ),
        ),
        undetermined=(
            Undetermined(
                name="contact_2", determined_share=0.0, reason="it never closes", remedy="hit it", code="hardly_closes"
            ),
        ),
        changes=(
            change("force", "excite with 28 N rms <2 times>", 0.8, gained=("contact_2",)),
            change("noise", "take quieter sensors", 0.99),
        ),
        sensors=(
            change("leave out sensor", "needed", 1.5, largest_growth=1.5),
            change("leave out sensor", "spare", 1.01, largest_growth=1.01),
        ),
        simulations=3,
        simulated_s=30.0,
    )


def test_the_sentence_says_what_will_be_told_and_what_helps(plan):
    text = page.sentence(plan)
    assert "contact_1 can be determined, clearance and stiffness to ± 1.0 %" in text  # 1.96 x 500 / 1e5
    assert "contact_2 cannot be determined by this test (it never closes)" in text
    assert "excite with 28 N rms <2 times>, which determines contact_2, too" in text
    narrower = replace(plan, changes=(change("force", "excite with 28 N rms", 0.46),))
    assert "excite with 28 N rms, which narrows the widest interval by 54 %." in page.sentence(narrower)


def test_rows_have_values_and_half_intervals_in_the_units_of_the_heading(plan):
    assert list(page.contact_rows(plan)) == [("contact_1", "5.0000 ± 0.0098", "100000 ± 980", "0.00 ± 0.20")]
    first, _ = page.change_rows(plan.changes)
    assert first[1:3] == ("± 0.80 %", "20 % narrower")
    assert first[3] == "determines contact_2; clearance of contact_1: 20 % narrower"
    factors = (0.996, 1.32, 231.0)
    rows = page.change_rows([change("noise", "take quieter sensors", factor) for factor in factors])
    assert [row[2] for row in rows] == ["the same", "32 % wider", "230 times as wide"]


def test_what_does_not_help_stands_under_no_heading_of_help(plan, tmp_path):
    page.write_page(plan, BarrelCradle().rig(), tmp_path / "plan.html")
    html = (tmp_path / "plan.html").read_text(encoding="utf-8")
    helping, _, idle = html.partition("What would not help")
    assert "take quieter sensors" not in helping
    assert "take quieter sensors" in idle
    assert "excite with 28 N rms" not in idle


def test_the_colour_is_that_of_the_outcome(plan, tmp_path):
    """A note turned a plan amber that determines all contacts."""
    for undetermined, colour in ((plan.undetermined, "yellow"), ((), "green")):
        noted = replace(plan, undetermined=undetermined, notes=("not every change was tried",))
        page.write_page(noted, BarrelCradle().rig(), tmp_path / "plan.html")
        assert f'class="verdict {colour}"' in (tmp_path / "plan.html").read_text(encoding="utf-8")


def test_a_longer_record_widens_no_interval_by_the_chance_of_another_one(monkeypatch):
    """Its intervals are those of the same record for longer; what it determines alone counts."""
    test = planned_test(BarrelCradle(sensors="acceleration").rig(), duration_s=20.0)
    parts = ErrorParts(
        simulated_value=1.0,
        estimate=1.0,
        scatter_variance=4e-4,
        slow_motion_variance=0.0,
        tolerance_variance=1e-4,
        law_variance=0.0,
        widening_factor=1.0,
    )
    short = SimulatedTest({"contact_1": {"clearance_m": parts}}, {"contact_2": refused()})
    wider = {"clearance_m": replace(parts, scatter_variance=9e-4)}
    longer = SimulatedTest({"contact_1": wider, "contact_2": wider}, {})
    outcomes = {20.0: short, 40.0: longer}
    monkeypatch.setattr(ranking, "_simulated_run", lambda run: outcomes[run[0].duration_s])
    changes = [one for one in changes_of(test) if one.kind == "duration"]
    (tried,) = ranking._tried_changes(test, changes, "modal", lambda runs, _: list(map(ranking._simulated_run, runs)))
    assert tried.largest.factor == pytest.approx(np.sqrt(3 / 5))
    assert tried.gained == ("contact_2",)


def refused():
    return RefusedContact("it never closes", "hit it", "hardly_closes", "excite_more")


def test_advice_and_idle_sensors(plan):
    assert [c.kind for c in plan.advice] == ["force"]
    assert plan.idle_sensors == ("spare",)
    assert "spare" in page.idle_sensor_sentence(plan)
    assert "needed" not in page.idle_sensor_sentence(plan)


def test_the_page_needs_no_other_file_and_writes_words_as_words(plan, tmp_path):
    page.write_page(plan, BarrelCradle().rig(), tmp_path / "plan.html")
    html = (tmp_path / "plan.html").read_text(encoding="utf-8")
    assert html.endswith("</html>\n")
    assert "&lt;2 times&gt;" in html
    assert "<2 times>" not in html
    for text in ("5.0000 ± 0.0098 mm", "cannot be determined", "plan.json", "spare", "calibration"):
        assert text in html


def test_the_page_is_accessible(inaccessible, plan, tmp_path):
    page.write_page(plan, BarrelCradle().rig(), tmp_path / "plan.html")
    assert inaccessible(tmp_path / "plan.html", 375) == []
