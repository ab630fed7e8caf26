"""The notebooks run from their first cell to their last, find what is true, and hold outputs of what they are now."""

import json
import re

import matplotlib
import matplotlib.pyplot as plt
import pytest

from scenarios.notebooks import FOLDER, HTML, PNG, SOURCES_KEY, execute_notebook, sources_sha256

pytestmark = pytest.mark.long

NAMES = [path.stem for path in sorted(FOLDER.glob("*.ipynb"))]


def read(name):
    return json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))


def code_of(name):
    return [cell for cell in read(name)["cells"] if cell["cell_type"] == "code"]


@pytest.fixture
def run(in_folder):
    """The names that a notebook has defined at its end, in a folder of its own."""
    before = matplotlib.get_backend()
    matplotlib.use("Agg")
    del in_folder

    def run_all(name):
        names = {}
        for cell in code_of(name):
            exec("".join(cell["source"]), names)
        return names

    yield run_all
    plt.close("all")
    matplotlib.use(before)


def test_first_steps_find_the_clearance(run):
    names = run("first_steps")
    assert names["stop"].clearance.value == pytest.approx(names["machine"].clearance_m, rel=1e-3)
    assert names["stop"].stiffness.value == pytest.approx(names["machine"].stiffness_n_per_m, rel=5e-3)
    assert plt.gca().get_ylabel() == "displacement, m"


@pytest.mark.study
def test_own_data_give_what_their_own_simulator_has(run, tmp_path):
    names = run("own_data")
    assert names["found"].report.findings == ()
    (low_m, high_m), stiffness = names["stop_found"].clearance.interval, names["stop_found"].stiffness
    assert low_m < names["gap"] < high_m < low_m + 0.02 * names["gap"]
    assert stiffness.interval[0] < names["stop"] < stiffness.interval[1]
    assert (tmp_path / "contact" / "contact.html").exists()


@pytest.mark.study
def test_the_gap_is_the_mass_that_was_added(run, tmp_path):
    names = run("gap")
    assert names["best"].effects == ("added_mass",)
    assert names["best"].parameters["added_mass.mass_kg"].value == pytest.approx(0.05, rel=0.2)
    assert (tmp_path / "gap" / "gap.html").exists()


@pytest.mark.parametrize("name", NAMES)
def test_its_outputs_come_from_its_cells_and_are_small(name):
    notebook = read(name)
    assert notebook["metadata"][SOURCES_KEY] == sources_sha256(notebook), "run python -m scenarios.notebooks"
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", ())]
    assert [
        output for output in outputs if output["output_type"] in ("error", "stream") and output.get("name") != "stdout"
    ] == []
    figures = [output["data"][PNG] for output in outputs if PNG in output.get("data", {})]
    assert figures
    assert all(len(figure) < 60_000 for figure in figures)
    assert len(json.dumps(notebook)) < 150_000


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
def test_executed_again_it_says_the_same_but_for_digits(name):
    pytest.importorskip("nbclient")
    notebook = read(name)
    assert words(execute_notebook(notebook)) == words(notebook)


def words(notebook):
    """What the cells print, as text or as tables, without numbers and spaces."""
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", ())]
    told = [output.get("text", output.get("data", {}).get(HTML, "")) for output in outputs]
    return [re.sub(r"[-+\d.]+(e[-+]?\d+)?|\s", "", "".join(text)) for text in told]
