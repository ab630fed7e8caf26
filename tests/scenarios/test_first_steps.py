"""The notebook runs from its first cell to its last, and finds the clearance that its rig has."""

import json
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

NOTEBOOK = Path(__file__).parents[2] / "scenarios" / "first_steps.ipynb"
CELLS = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
CODE = [cell for cell in CELLS if cell["cell_type"] == "code"]


@pytest.fixture
def drawn_nowhere():
    before = matplotlib.get_backend()
    matplotlib.use("Agg")
    yield
    plt.close("all")
    matplotlib.use(before)


@pytest.mark.usefixtures("drawn_nowhere")
def test_the_cells_find_the_clearance(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for cell in CODE:
        exec("".join(cell["source"]), names)
    assert names["stop"]["clearance_m"] == pytest.approx(names["machine"].clearance_m, rel=1e-3)
    assert names["stop"]["stiffness_n_per_m"] == pytest.approx(names["machine"].stiffness_n_per_m, rel=5e-3)
    assert plt.gca().get_ylabel() == "displacement, m"


def test_it_is_stored_without_outputs():
    assert not any(cell["outputs"] or cell["execution_count"] for cell in CODE)
