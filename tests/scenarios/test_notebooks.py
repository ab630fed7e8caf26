"""The notebooks run from their first cell to their last, and find what is true."""

import json
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

pytestmark = pytest.mark.long

FOLDER = Path(__file__).parents[2] / "scenarios"


def code_of(name):
    cells = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


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
    assert names["stop"]["clearance_m"] == pytest.approx(names["machine"].clearance_m, rel=1e-3)
    assert names["stop"]["stiffness_n_per_m"] == pytest.approx(names["machine"].stiffness_n_per_m, rel=5e-3)
    assert plt.gca().get_ylabel() == "displacement, m"


@pytest.mark.study
def test_own_data_give_what_their_own_simulator_has(run, tmp_path):
    names = run("own_data")
    found = names["stop_found"]
    assert names["found"].report.findings == ()
    assert abs(found["clearance_m"] - names["gap"]) < found["clearance_m_within"] < 0.01 * names["gap"]
    assert abs(found["stiffness_n_per_m"] - names["stop"]) < found["stiffness_n_per_m_within"]
    assert (tmp_path / "contact" / "contact.html").exists()


@pytest.mark.study
def test_the_gap_is_the_mass_that_was_added(run, tmp_path):
    names = run("gap")
    assert names["best"].effects == ("added_mass",)
    assert names["best"].parameters["added_mass.mass_kg"].value == pytest.approx(0.05, rel=0.2)
    assert (tmp_path / "gap" / "gap.html").exists()


@pytest.mark.parametrize("name", [path.stem for path in sorted(FOLDER.glob("*.ipynb"))])
def test_it_is_stored_without_outputs(name):
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code_of(name))
