"""Histories drawn at random, of machines that change and of machines that do not; and real ones of one mass."""

import csv
import hashlib
import io
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.contacts.results import ContactEstimate, ContactReport, Estimate, Mode, Surfaces
from identify.history.changes import SIGNIFICANCE_LEVEL, Observation, history_of
from identify.history.observations import sources_in
from identify.history.page import history_csv, history_figure, quantity_table, sentence, write_page
from rig.effects.contact_clearance import ContactClearance
from rig.errors import RigError
from rig.files import write_json
from rig.simulation.reference import Sdof
from tests.recorded import recorded

OWN, SHARED = 0.0005, 0.002
"""Standard errors of a record by itself and of rig.json, in shares of the value."""


def report(rng, change=1.0, bias=1.0, rig="machine"):
    def estimate(value):
        error, measured = abs(value) * np.hypot(OWN, SHARED), value * (bias + OWN * rng.normal())
        return Estimate(measured, error, abs(value) * OWN)

    names = ("contact_1", "contact_2")
    contacts = tuple(
        ContactEstimate(
            name=name,
            clearance_m=estimate(1e-3 * (change if name == "contact_2" else 1.0)),
            stiffness_n_per_m=estimate(1e5),
            damping_n_s_per_m=estimate(10.0),
        )
        for name in names
    )
    return ContactReport(
        rig=rig,
        contacts=contacts,
        unanswered=(),
        main_equation="barrel 3",
        modes=(Mode("barrel", 3, 53.0 * (1 + 0.001 * rng.normal()), 0.01),),
        nifo=(),
        surface=Surfaces((), ()),
        transformation=(),
        trusted_hz=(1.0, 100.0),
        channels_used=(),
    )


def history(seed, changes, **report_options):
    rng = np.random.default_rng(seed)
    bias = 1 + SHARED * rng.normal()
    return history_of(
        [Observation(name=str(i), report=report(rng, c, bias, **report_options)) for i, c in enumerate(changes)]
    )


def changed(result):
    return [(q.of, q.quantity) for q in result.quantities if q.changed]


@pytest.mark.parametrize("count", [2, 3, 12])
def test_of_machines_that_do_not_change_hardly_any_is_said_to(count):
    alarms = sum(bool(changed(history(seed, np.ones(count)))) for seed in range(400))
    assert alarms < 400 * SIGNIFICANCE_LEVEL + 2.6 * np.sqrt(400 * SIGNIFICANCE_LEVEL)


def test_wear_of_one_contact_is_found_with_its_size():
    scores = []
    for seed in range(40):
        result = history(seed, np.linspace(1, 1.005, 12))
        assert ("contact_2", "clearance_m") in changed(result)
        worn = next(q for q in result.quantities if (q.of, q.quantity) == ("contact_2", "clearance_m"))
        scores.append((worn.drift.value - 5e-6) / worn.drift.standard_error)
    assert 0.6 < np.std(scores) < 1.5  # the errors of the drift are what they say
    assert sentence(result).startswith("12 recordings of machine: contact_2: clearance drifts by")


def test_a_change_between_two_is_found_although_their_intervals_overlap():
    result = history(1, (1.0, 1.003))
    assert changed(result) == [("contact_2", "clearance_m")]
    assert 1.96 * np.hypot(OWN, SHARED) > 0.003


def test_a_change_is_said_with_its_size_and_the_value_it_leads_to():
    result = history(1, (1.0, 1.003))
    worn = next(q for q in result.quantities if q.changed)
    _, _, change = worn.largest_change
    assert abs(change.value - 3e-6) < 1.96 * change.standard_error
    half = 1.96e6 * np.hypot(*worn.own_errors)
    said = f"contact_2: clearance changes by +{1e6 * change.value:.1f} ± {half:.1f} µm to {1e3 * worn.values[1]:.3f} mm"
    assert f"{said} in 1 against 0 (p = " in sentence(result)


def test_no_column_is_empty_and_every_p_value_has_one_floor():
    headings, rows = quantity_table(history(1, (1.0, 2.0)))
    assert headings == ["", "mean", "largest change", "p"]
    assert {row[3] for row in rows if row[0] == "contact_2: clearance"} == {"< 1e-12"}
    headings, rows = quantity_table(history(1, np.linspace(1, 2, 5)))
    assert len(headings) == 6
    assert all(any(column) for column in zip(*rows, strict=True))


def test_scatter_beyond_the_intervals_is_no_trend():
    rng = np.random.default_rng(5)
    alarms = 0
    for seed in range(200):
        result = history(seed, 1 + 0.005 * rng.normal(size=12))
        worn = next(q for q in result.quantities if (q.of, q.quantity) == ("contact_2", "clearance_m"))
        alarms += worn.p_trend < SIGNIFICANCE_LEVEL
        assert worn.p_different < SIGNIFICANCE_LEVEL
    assert alarms < 200 * SIGNIFICANCE_LEVEL


def test_what_a_recording_does_not_tell_is_left_out():
    rng = np.random.default_rng(2)
    complete = [report(rng) for _ in range(3)]
    incomplete = replace(complete[1], contacts=complete[1].contacts[:1])
    result = history_of(
        [Observation(name=n, report=r) for n, r in zip("abc", (complete[0], incomplete, complete[2]), strict=True)]
    )
    second = [q for q in result.quantities if q.of == "contact_2"]
    assert all(q.values[1] is None and None not in (q.values[0], q.values[2]) for q in second)
    lines = list(csv.DictReader(io.StringIO(history_csv(result).decode())))
    assert [row["recording"] for row in lines if (row["of"], row["quantity"]) == ("contact_2", "clearance_m")] == [
        "a",
        "c",
    ]
    assert float(lines[0]["value"]) == result.quantities[0].values[0]


def test_what_cannot_be_compared_is_refused():
    rng = np.random.default_rng(3)
    with pytest.raises(RigError, match="recordings of the rigs 'machine' and 'other'; compare those of one machine"):
        history_of([Observation(name=rig, report=report(rng, rig=rig)) for rig in ("machine", "other")])
    with pytest.raises(RigError, match="1 of 2 recordings can be compared; give two or more; it is broken"):
        history_of([Observation(name="a", report=report(rng)), Observation(name="b", reason="it is broken")])


@pytest.mark.parametrize(
    ("days", "label"),
    [
        ((0, 1, 9), "time since 2026-03-01 10:00 UTC, days"),
        ((0, 0.1, 0.2), "time since 2026-03-01 10:00 UTC, hours"),
        ((0, 9, 1), "recording, in order"),  # the trend is along the order
        ((0, None, 1), "recording, in order"),
    ],
)
def test_dates_stand_on_the_axis_where_they_ascend(days, label, tmp_path):
    rng, first = np.random.default_rng(1), datetime(2026, 3, 1, 10, tzinfo=UTC)
    dates = [None if day is None else first + timedelta(days=day) for day in days]
    result = history_of([Observation(name=str(d), recorded=d, report=report(rng)) for d in dates])
    figure = history_figure(result)
    below = figure.figure.axes[1]
    assert below.get_xlabel() == label
    scale = {"days": 1.0, "hours": 24.0}.get(label.split()[-1])
    positions = [scale * day for day in days] if scale else [1, 2, 3]
    middle = np.mean([line.get_xdata() for line in below.lines[::3]], axis=0)  # the contacts stand side by side
    np.testing.assert_allclose(middle, positions, atol=1e-9)
    write_page(result, figure, tmp_path / "history.html")
    text = (tmp_path / "history.html").read_text(encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO(history_csv(result).decode())))
    for date in dates:
        if date:
            assert f"{date:%Y-%m-%d %H:%M}" in text
            assert f"{date:%Y-%m-%dT%H:%M:%SZ}" in {row["recorded"] for row in rows}


def test_the_page_is_accessible(inaccessible, tmp_path):
    rng = np.random.default_rng(1)
    result = history_of([Observation(name=name, recorded=None, report=report(rng)) for name in ("a", "b", "c")])
    write_page(result, history_figure(result), tmp_path / "history.html")
    assert inaccessible(tmp_path / "history.html", 375) == []


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Recordings of one mass whose clearance wears by 2 % in all."""
    folder = tmp_path_factory.mktemp("machine")
    for number in range(4):
        machine = Sdof(seed=number, noise_density=1e-3, high_hz=6.0, duration_s=20.0)
        worn = ContactClearance(factor=1 + 0.02 * number / 3).applied_to(machine.rig())
        recorded(machine, folder / f"run{7 + number}.mcap", actual=worn)
    (folder / "run11.mcap").write_bytes(b"nothing")
    return folder


@pytest.mark.study
def test_wear_of_a_mass_is_found_in_its_recordings_in_the_order_of_their_names(recordings, tmp_path):
    sources = sources_in(recordings)
    assert [path.name for path in sources] == ["run7.mcap", "run8.mcap", "run9.mcap", "run10.mcap", "run11.mcap"]
    comparison = identify.compare(sources)
    assert comparison.changed
    assert changed(comparison.report) == [("stop", "clearance_m")]
    assert all(observation.recorded for observation in comparison.report.compared)
    (worn,) = (q for q in comparison.report.quantities if q.changed)
    assert worn.drift.value == pytest.approx(0.02e-3, abs=1.96 * worn.drift.standard_error)
    comparison.save(tmp_path)
    assert (tmp_path / "history.json").read_text().count('"recorded":') == 4
    page = (tmp_path / "history.html").read_text().replace("\u00a0", " ")
    assert "left out: " in page
    assert "run11.mcap" in page
    assert all(hashlib.sha256(path.read_bytes()).hexdigest()[:12] in page for path in sources[:4])
    assert sentence(comparison.report) in page
    from_reports = identify.compare(
        [write(tmp_path / path.stem, o) for path, o in zip(sources, comparison.report.compared, strict=False)]
    )
    assert [q.values for q in from_reports.report.quantities] == [q.values for q in comparison.report.quantities]


def write(folder, observation):
    folder.mkdir()
    write_json(observation.report, folder / "contact.json")
    return folder
