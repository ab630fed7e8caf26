"""The contact law found by symbolic regression: dead zone, stiffening law, formulas and straight pieces."""

import csv
import dataclasses
import json
import re
import sys
from hashlib import sha256
from html import unescape

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from identify.checks.findings import Finding
from identify.commands.cli import app
from identify.contacts import identify_contact
from identify.laws import CUBIC, FORMULA, PIECEWISE, Laws, identify_law
from identify.laws.report import law_figures, write_page
from identify.laws.results import MAX_LEFT_SHARE, LawReport
from identify.laws.symbolic import Formula, search, simplify
from identify.pages.wording import interval, percent
from identify.signals.spectra import decimated
from rig.errors import RigError
from rig.model.contact_laws import DeadZone, penetration_m
from rig.model.description import Contact, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.recording import Recording, Signals
from rig.recording.channels import Channels

RATE_HZ = 512.0
DURATION_S = 50.0
MASS = Station("mass")
LOWER_M, UPPER_M, STIFFNESS = 0.8e-3, 1.1e-3, 1e4
SOFT, CUBIC_PER_M3 = 2e3, 1e9
SECONDS = 6.0


def motion_m(time_s):
    """Displacement and its first two derivatives: tones about the resonance, of about 3 mm together."""
    tones = ((1.3e-3, 3.1, 0.1), (1.0e-3, 4.37, 1.1), (0.7e-3, 6.83, 2.3))
    derivatives = [
        [a * (2 * np.pi * f) ** n * np.sin(2 * np.pi * f * time_s + p + n * np.pi / 2) for a, f, p in tones]
        for n in range(3)
    ]
    return [np.sum(rows, axis=0) for rows in derivatives]


def mass_with(law, damping_n_s_per_m=0.0):
    """A recording of one mass whose motion is given and whose force is what that motion needs."""
    body = Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01)
    sensors = tuple(
        Sensor(name=quantity, station=MASS, quantity=quantity)
        for quantity in ("displacement", "velocity", "acceleration")
    )
    rig = Rig(
        name="one mass",
        bodies=(body,),
        contacts=(
            Contact(
                name="stop",
                at=MASS,
                against=None,
                law=DeadZone(lower_clearance_m=LOWER_M, upper_clearance_m=UPPER_M, stiffness_n_per_m=STIFFNESS),
            ),
        ),
        force_at=MASS,
        sensors=sensors,
        sample_rate_hz=RATE_HZ,
    )
    fine = 16
    time_s = np.arange(round(DURATION_S * RATE_HZ) * fine) / (RATE_HZ * fine)
    x, v, a = motion_m(time_s)
    needed = body.mass_kg * a + body.damping_n_s_per_m * v + body.stiffness_n_per_m * x
    touching = (x > UPPER_M) | (x < -LOWER_M)
    contact = decimated(law(x) + damping_n_s_per_m * v * touching, fine)
    rows = {"force": needed[::fine] + contact} | {
        s.quantity: values[::fine] for s, values in zip(sensors, (x, v, a), strict=True)
    }
    signals = {
        name: Signals(Channels(name, "", (name,), (MASS,), RATE_HZ), 0.0, row[None, :]) for name, row in rows.items()
    }
    return Recording(rig, signals, {})


def gap(x):
    return STIFFNESS * penetration_m(x, LOWER_M, UPPER_M)


def stiffening(x):
    return SOFT * x + CUBIC_PER_M3 * x**3


def test_a_displacement_that_stands_still_is_no_law():
    still = mass_with(gap)
    rows = still.signals["displacement"]
    rows = dataclasses.replace(rows, values=np.zeros_like(rows.values))
    laws = identify_law(dataclasses.replace(still, signals=still.signals | {"displacement": rows}), seconds=1.0)
    assert [refusal.reason for refusal in laws.report.unanswered] == [
        "its relative displacement stands still; look for a dead displacement sensor"
    ]


@pytest.fixture(scope="module")
def clearance():
    return identify_law(mass_with(gap), seconds=SECONDS).fits[0]


def random_formula(rng, depth, combine):
    """A random tree of the operations, made with `combine`."""
    if depth == 0 or rng.random() < 0.1:
        return Formula("1x"[rng.integers(2)], rng.normal())
    operation = ("+", "-", "*", "min", "max", "abs")[rng.integers(6)]
    operands = [random_formula(rng, depth - 1, combine) for _ in range(1 if operation == "abs" else 2)]
    return combine(operation, tuple(operands))


def plain(operation, operands):
    return Formula(operation, operands=operands)


X = np.linspace(-1.5, 2.0, 101)


@pytest.mark.parametrize("seed", range(40))
def test_a_formula_keeps_its_values_when_simplified_and_scaled(seed):
    as_it_is = random_formula(np.random.default_rng(seed), 4, plain)
    simple = random_formula(np.random.default_rng(seed), 4, simplify)
    size = max(1.0, float(np.abs(as_it_is(X)).max()))
    # constants left away are below NEGLIGIBLE and at most multiplied by what the rest of a formula comes to
    assert np.allclose(simple(X), as_it_is(X), atol=1e-9 * size)
    assert np.allclose(simple.scaled(1e-3, 200.0)(1e-3 * X), 200.0 * simple(X), atol=1e-9 * 200 * size)


@pytest.mark.parametrize("seed", range(20))
def test_the_text_of_a_formula_says_what_it_computes(seed):
    formula = random_formula(np.random.default_rng(seed), 4, simplify)
    said = formula.text("eta").replace(" eta", " * eta")
    for operation in "+-*,":
        said = said.replace(f"{operation} * eta", f"{operation} eta")
    values = [eval(said, {"min": min, "max": max, "abs": abs, "eta": x}) for x in X]
    assert np.allclose(values, formula(X), rtol=1e-3, atol=1e-3 * np.abs(formula(X)).max())


def test_the_search_finds_a_dead_zone_and_repeats_itself():
    rng = np.random.default_rng(3)
    x = np.linspace(-1, 1, 1000)
    noise = 1e-3
    y = 1.5 * penetration_m(x, 0.3, 0.45) + noise * rng.standard_normal(x.size)
    first, repeated = (search(x, y, 60.0, seed=1, thread_count=threads, generation_count=60) for threads in (1, 2))
    assert not first.out_of_time
    assert [f.text("x") for f in first.formulas] == [f.text("x") for f in repeated.formulas]
    errors = [float(np.std(f(x) - y)) for f in first.formulas]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1.1 * noise


def test_without_pyoperon_one_is_told_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoperon.sklearn", None)
    with pytest.raises(RigError, match=r"pip install 'rig-identify\[symbolic\]'"):
        identify_law(mass_with(gap))


def test_the_dead_zone_of_one_mass_is_found_exactly(clearance):
    law = clearance.result
    assert law.verdict.startswith("dead zone with knees at")
    assert law.best == PIECEWISE
    assert [k.value for k in law.fitted_knees_m] == pytest.approx([-LOWER_M, UPPER_M], rel=1e-4)
    lower, inside, upper = (s.value for s in law.fitted_slopes_n_per_m)
    assert (lower, upper) == pytest.approx((STIFFNESS, STIFFNESS), rel=5e-4)
    assert abs(inside) < 5e-4 * STIFFNESS
    errors = {c.law: c.held_out_error_n for c in law.candidates}
    assert errors[PIECEWISE] < 1e-3 * law.force_rms_n < errors[CUBIC]
    assert clearance.searched_eta_m.size == clearance.searched_force_n.size == law.points


def test_intervals_are_those_of_the_contact(clearance):
    """Tolerances and misfit included: as long as those of contact.json, never the scatter's alone."""
    (contact,) = identify_contact(mass_with(gap)).report.contacts
    lower, upper = clearance.result.fitted_knees_m
    stiffness = clearance.result.fitted_slopes_n_per_m[2]
    pairs = (
        (lower, contact.lower_clearance_m),
        (upper, contact.upper_clearance_m),
        (stiffness, contact.stiffness_n_per_m),
    )
    for by_law, by_contact in pairs:
        assert 0.7 < by_law.standard_error / by_contact.standard_error < 1.6
        assert abs(abs(by_law.value) - by_contact.value) < 1.96 * by_contact.standard_error


def test_no_law_fits_a_force_that_is_noise(tmp_path):
    rng = np.random.default_rng(5)
    laws = identify_law(mass_with(lambda x: 5.0 * rng.standard_normal(x.size)), seconds=1.0)
    (law,) = laws.report.laws
    assert not law.fits
    assert law.sliding is None
    assert law.verdict.startswith("none of the laws fits: the best, ")
    left_share = law.candidate(law.best).left_share
    assert left_share > MAX_LEFT_SHARE
    assert f"leaves {percent(left_share)} of the force" in law.verdict
    write_page(laws.report, {}, "mass", tmp_path / "law.html")
    html = unescape((tmp_path / "law.html").read_text(encoding="utf-8"))
    assert '<div class="verdict yellow"><b>stop: none of the laws fits</b>' in html
    assert "value ± 95 %" not in html
    assert law.formula not in html


@pytest.mark.study
def test_straight_pieces_lose_against_a_stiffening_law():
    law = identify_law(mass_with(stiffening), seconds=SECONDS).report.laws[0]
    assert law.best in (CUBIC, FORMULA)
    assert law.verdict.startswith("a freely fitted piecewise-linear law is not the best")
    errors = {c.law: c.held_out_error_n for c in law.candidates}
    assert errors[CUBIC] < 1e-3 * law.force_rms_n < errors[PIECEWISE]


def test_damping_in_the_contact_is_told_from_the_scatter():
    damped = identify_law(mass_with(gap, damping_n_s_per_m=5.0), seconds=1.0).report.laws[0]
    assert damped.hysteresis_share > 0.9
    assert [k.value for k in damped.fitted_knees_m] == pytest.approx([-LOWER_M, UPPER_M], rel=1e-2)


def test_the_law_of_two_stops_one_behind_the_other_is_that_of_their_sum():
    """Their damping, by the joint estimate, is taken off: it would hide the knees of the nearer one."""
    farther_m, harder = 2e-3, 1e5
    record = mass_with(lambda x: gap(x) + harder * penetration_m(x, farther_m, farther_m), damping_n_s_per_m=30.0)
    behind = msgspec.structs.replace(
        record.rig.contacts[0],
        name="behind",
        law=DeadZone(lower_clearance_m=1.8e-3, upper_clearance_m=1.8e-3, stiffness_n_per_m=5e4),
    )
    both = msgspec.structs.replace(record.rig, contacts=(*record.rig.contacts, behind))
    (law,) = identify_law(dataclasses.replace(record, rig=both), contact="behind", seconds=2.0).fits
    assert law.result.contact == "stop + behind"
    assert np.allclose(law.pieces.knees_m, [-farther_m, -LOWER_M, UPPER_M, farther_m], atol=1e-5)
    assert np.allclose(law.pieces.slopes_n_per_m[[0, 1, 3, 4]], [1.1e5, 1e4, 1e4, 1.1e5], rtol=0.01)


@pytest.mark.parametrize(("wrong", "words"), [({"contact": "none"}, "there are stop"), ({"seconds": 0.0}, "1 or more")])
def test_what_cannot_be_searched_is_refused(wrong, words):
    with pytest.raises(RigError, match=words):
        identify_law(mass_with(gap), **wrong)


@pytest.fixture
def command(clearance, monkeypatch, tmp_path):
    """`identify law` of a file whose law is that of the fixture."""
    made = Laws(LawReport(rig="one mass", laws=(clearance.result,), unanswered=()), (clearance,))
    (tmp_path / "some.mcap").write_bytes(b"a recording")
    monkeypatch.setattr("identify.api._recording", lambda _: mass_with(gap))
    monkeypatch.setattr("identify.api.identify_law", lambda *_, **__: made)
    return ["law", str(tmp_path / "some.mcap")]


def test_the_command_writes_the_law_and_a_figure_and_keeps_what_is_there(clearance, command, tmp_path):
    out = ["--out", str(tmp_path / "results")]
    printed = CliRunner().invoke(app, [*command, *out, "--json"])
    assert printed.exit_code == 0
    written = (tmp_path / "results" / "law.json").read_bytes()
    assert msgspec.json.decode(written, type=LawReport).laws == (clearance.result,)
    assert json.loads(printed.stdout) == json.loads(written)
    for name in ("law.png", "law_over_time.png"):
        assert (tmp_path / "results" / name).read_bytes().startswith(b"\x89PNG")
    assert clearance.result.verdict in CliRunner().invoke(app, command).stdout
    assert isinstance(CliRunner().invoke(app, [*command, *out]).exception, RigError)
    assert (tmp_path / "results" / "law.json").read_bytes() == written


def test_the_page_of_a_law_stands_alone(clearance, command, tmp_path):
    assert CliRunner().invoke(app, [*command, "--out", str(tmp_path)]).exit_code == 0
    html = (tmp_path / "law.html").read_text(encoding="utf-8")
    assert len(html) < 3e6
    assert html.count("Bokeh.embed.embed_item") == 2
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=\"(?!data:)", html)
    text = unescape(html)
    for knee in clearance.result.fitted_knees_m:
        assert interval(1e3 * knee.value, 1e3 * knee.standard_error, "mm") in text
    assert f"some.mcap {sha256(b'a recording').hexdigest()[:12]}" in text
    assert clearance.result.formula in text


def test_the_page_is_accessible(inaccessible, clearance, tmp_path):
    report = LawReport(rig="one mass", laws=(clearance.result,), unanswered=(), findings=())
    write_page(report, law_figures([clearance]), "mass", tmp_path / "law.html")
    assert inaccessible(tmp_path / "law.html", 375) == []


def test_a_finding_makes_the_page_amber(clearance, tmp_path):
    finding = Finding(cause="clock", evidence="all bodies vibrate too fast", mend="check the sampling rate")
    report = LawReport(rig="one mass", laws=(clearance.result,), unanswered=(), findings=(finding,))
    write_page(report, {}, "mass", tmp_path / "law.html")
    html = (tmp_path / "law.html").read_text(encoding="utf-8")
    assert '<div class="verdict yellow"><b>not to be relied on</b>' in html
    assert finding.sentence in html


def test_the_exported_curves_hold_the_law(command, tmp_path):
    """The force drawn beside the separated one leaves 2 % of it, and the motion is the true one."""
    assert CliRunner().invoke(app, [*command, "--out", str(tmp_path), "--export", "csv"]).exit_code == 0
    names, *rows = csv.reader((tmp_path / "law_over_time.csv").read_text().splitlines())
    assert names == ["time_s", "stop relative displacement m", "stop contact force N", "stop straight pieces N"]
    time_s, eta, force, law = np.array(rows, dtype=float).T
    middle = slice(force.size // 4, 3 * force.size // 4)
    np.testing.assert_allclose(eta[middle], motion_m(time_s)[0][middle], atol=1e-5)
    assert np.std((force - law)[middle]) < 0.02 * np.std(force)
    _, *rows = csv.reader((tmp_path / "law_1.csv").read_text().splitlines())
    eta, _, pieces = np.array(rows, dtype=float).T
    closed = eta > 1.2 * UPPER_M
    assert np.polyfit(eta[closed], pieces[closed], 1)[0] == pytest.approx(STIFFNESS, rel=0.02)
    refused = CliRunner().invoke(app, [*command, "--export", "csv"])
    assert refused.exit_code == 2
    assert "its folder" in refused.output
