"""The recipes of scenarios/RECIPES.md run as they stand, and find what was simulated."""

import json
import re
from contextlib import chdir
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import rig

pytestmark = pytest.mark.long

TEXT = (Path(__file__).parents[2] / "scenarios/RECIPES.md").read_text(encoding="utf-8")
RECIPES = dict(re.findall(r"^## (.+?)\n.*?^```python\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE))
FIRST = "Record and identify"


def defined(title):
    """The names that a recipe has defined at its end."""
    names = {}
    exec(compile(RECIPES[title], title, "exec"), names)
    return names


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The names of the first recipe, and its folder, in which all others run."""
    folder = tmp_path_factory.mktemp("recipes")
    with chdir(folder):
        return defined(FIRST), folder


@pytest.fixture
def run(first):
    before = matplotlib.get_backend()
    matplotlib.use("Agg")
    with chdir(first[1]):
        yield defined
    matplotlib.use(before)


def covers(quantity, truth):
    low, high = quantity.interval
    return low < truth < high


def test_there_are_ten_of_about_ten_lines():
    assert len(RECIPES) == TEXT.count("\n## ") == 10
    assert all(len([line for line in code.splitlines() if line]) <= 12 for code in RECIPES.values())


def test_record_and_identify(first):
    names, folder = first
    clearance = names["found"]["stop"].clearance
    assert covers(clearance, names["machine"].clearance_m)
    assert clearance.unit == "m"
    assert json.loads((folder / "contact/contact.json").read_text())["contacts"][0]["clearance_m"]["value"] == (
        clearance.value
    )


def test_from_a_csv(first, run):
    assert run("From a CSV")["found"]["stop"] == first[0]["found"]["stop"]


def test_read_a_channel_and_plot_it(first, run):
    names = run("Read a channel and plot it")
    assert (first[1] / "acceleration.png").stat().st_size > 10_000
    frame, acceleration = names["frame"], names["acceleration"]
    assert frame.loc[10:20, "mass_0000mm_acceleration, m/s^2"].iloc[0] == acceleration.values[10 * 512]


def test_compare_two_recordings(run):
    history = run("Compare two recordings")["history"]
    (changed,) = (q for q in history.report.quantities if q.changed)
    assert changed.quantity == "clearance_m"
    assert changed.values[1] / changed.values[0] == pytest.approx(1.02, rel=2e-3)


@pytest.mark.study
def test_diagnose(run):
    best = run("Diagnose")["answer"].report.causes[0]
    assert best.effects == ("added_mass",)
    assert best.parameters["added_mass.mass_kg"].value == pytest.approx(0.05, rel=0.2)


@pytest.mark.study
def test_believe_another_rig(run):
    assert run("Believe another rig")["answer"].report.verdict in ("consistent", "not seen")


def test_correct_the_rig_and_simulate_again(run):
    run("Correct the rig and simulate again")
    believed, corrected, measured = (
        rig.read(f"{name}.mcap")["mass_0000mm_displacement"].values[: 3 * 512]
        for name in ("believed", "corrected", "measured")
    )
    assert np.std(corrected - measured) < 0.01 * np.std(measured)
    assert np.std(believed - measured) > 0.5 * np.std(measured)


def test_export_to_matlab(run):
    contents = run("Export to MATLAB")["contents"]
    recording = rig.read("monday.mcap")
    assert contents["sample_rate_hz"].item() == recording.rig.sample_rate_hz
    assert (contents["force"].ravel() == recording.force_n).all()


def test_many_rigs_in_a_loop(run):
    errors = run("Many rigs in a loop")["errors"]
    assert len(errors) == 3
    assert all(abs(error) < 1e-3 for error in errors.values())


def test_a_law(run):
    (law,) = run("A law")["law"].report.laws
    assert [knee.value for knee in law.fitted_knees_m] == pytest.approx([-1e-3, 1e-3], rel=5e-3)
