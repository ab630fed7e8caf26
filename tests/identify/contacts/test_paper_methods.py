"""The paper's methods and the figures beside the answers: where one cannot be made, a note says so and no answer is
lost."""

import json

import numpy as np
import pytest

from identify.contacts import figures, identify_contact, paper_methods
from identify.contacts.report import write_results
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.model.description import Rig, Station
from rig.model.structure import ShapeRow, Structure
from rig.recording import read
from rig.simulation.reference import Sdof
from tests.campaigns.topologies import Topology, recorded, rig_of, stop

CLEARANCE_M, STIFFNESS = 1e-4, 1e6


def chain() -> Rig:
    """Three masses of 6.5 kg in a chain on the ground, as a modal basis of three modes: fewer than the four equations.

    K = k [2 -1 0; -1 2 -1; 0 -1 1], its lowest natural frequency at 20 Hz.
    """
    mass_kg, places = 6.5, [0.0, 0.3, 0.6]
    squares, shapes = np.linalg.eigh(np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]))
    body = Structure(
        name="chain",
        length_m=0.6,
        natural_hz=tuple((20.0 * np.sqrt(squares / squares[0])).tolist()),
        ratios=(0.02, 0.01, 0.01),
        rows=tuple(
            ShapeRow(position_m, tuple(row.tolist()))
            for position_m, row in zip(places, shapes / np.sqrt(mass_kg), strict=True)
        ),
    )
    masses = [Station("chain", position_m) for position_m in places]
    bumper = stop("bumper", masses[2], masses[1], CLEARANCE_M, STIFFNESS)
    return rig_of("chain", (body,), (bumper,), masses, masses[0], "displacement")


def written(identification, out):
    """contact.json of its results."""
    write_results(identification, out, "title", {c.name: c.law for c in identification.rig.contacts}, "rig.json")
    return json.loads((out / "contact.json").read_bytes())


@pytest.fixture(scope="module")
def mass(simulate, tmp_path_factory):
    return read(simulate(Sdof(duration_s=30.0, step_s=2.0**-12), tmp_path_factory.mktemp("mass") / "r.mcap"))


def is_right(report):
    (contact,) = report.contacts
    return abs(contact.clearance_m.value - Sdof().clearance_m) < 4 * contact.clearance_m.standard_error


@pytest.mark.study
def test_a_body_of_three_modes_has_three_equations(tmp_path):
    identification = identify_contact(
        read(recorded(Topology(chain(), 200.0, ""), tmp_path / "r.mcap", duration_s=12.0))
    )
    report = written(identification, tmp_path / "out")
    assert [n["equation"] for n in report["nifo"]] == ["chain 1", "chain 2", "chain 3"]
    assert report["notes"] == []
    (bumper,) = identification.report.contacts
    assert bumper.clearance_m.value == pytest.approx(CLEARANCE_M, rel=0.01)
    assert bumper.stiffness_n_per_m.value == pytest.approx(STIFFNESS, rel=0.02)
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"contact.html", "rig.json", "frf.png"}


def test_too_few_blocks_for_nifo_lose_no_answer(mass, tmp_path):
    identification = identify_contact(mass, use="displacement", averaging=Averaging(block_s=20.0))
    assert is_right(identification.report)
    assert identification.report.nifo == ()
    (note,) = identification.report.notes
    assert note.startswith("NIFO of mass 1 cannot be made: 1 blocks for 3 unknowns a line")
    with pytest.raises(RigError, match="1 blocks for 3 unknowns"):
        _ = identification.weak_nifo
    assert written(identification, tmp_path)["notes"] == [note]
    drawn = {path.stem for path in tmp_path.glob("*.png")}
    assert drawn == {"separated", "histogram", "section", "surface"}
    assert "1 blocks for 3 unknowns" in (tmp_path / "contact.html").read_text(encoding="utf-8")


def test_a_surface_that_cannot_be_fitted_loses_no_answer(mass, tmp_path, monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(paper_methods, "fit_surface", fails)
    identification = identify_contact(mass, use="displacement")
    assert is_right(identification.report)
    assert identification.report.surface.surfaces == ()
    assert identification.report.nifo
    assert written(identification, tmp_path)["notes"] == [
        "the restoring force surface of mass 1 cannot be made: SVD did not converge"
    ]
    assert not {"outputs.png", "surface.png", "section.png"} & {path.name for path in tmp_path.iterdir()}


def test_a_figure_that_fails_is_a_note_and_all_else_is_written(mass, tmp_path, monkeypatch):
    def fails(*_):
        raise ValueError("no room for axes")

    monkeypatch.setitem(figures._FIGURES, "frf", fails)
    identification = identify_contact(mass, use="displacement")
    report = written(identification, tmp_path)
    assert report["notes"] == ["the figure of frf cannot be made: no room for axes"]
    assert report["contacts"]
    drawn = {path.stem for path in tmp_path.glob("*.png")}
    assert drawn == {"outputs", "surface", "section", "separated", "histogram", "stiffness"}


def test_an_equation_that_the_body_lacks_is_refused_and_blocks_that_do_not_fit_too(mass):
    with pytest.raises(RigError, match=r"no modal equation 'mass 2' with a measured force; there are mass 1$"):
        identify_contact(mass, use="displacement", equation="mass 2")
    with pytest.raises(RigError, match="a block of 60 s does not fit a record with 30 usable seconds"):
        identify_contact(mass, use="displacement", averaging=Averaging(block_s=60.0))
