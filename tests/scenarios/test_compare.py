"""What the scenarios set beside each other: identified and true."""

import msgspec
import pytest

from identify.contacts.results import ContactReport
from rig.recording import read
from rig.simulation.reference import Sdof
from scenarios.compare import identify_against_truth, record_reference_rig
from tests.recorded import recorded

TRUE = Sdof(duration_s=30.0, step_s=2.0**-12, sensors="displacement")
BELIEVED = msgspec.structs.replace(TRUE, clearance_m=2.5e-3, stiffness_n_per_m=4e4)


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A rig whose owner is wrong about its contact."""
    folder = tmp_path_factory.mktemp("compare")
    path = recorded(TRUE, folder / "r.mcap", BELIEVED.rig(), TRUE.rig())
    return identify_against_truth(path, use="displacement", out=folder / "results"), folder / "results"


def test_the_true_law_is_found_whatever_is_believed(compared):
    comparison, _ = compared
    assert comparison.identification.rig == BELIEVED.rig()
    assert comparison.true_laws == {"stop": TRUE.rig().contacts[0].law}
    (estimate,) = comparison.identification.report.contacts
    assert estimate.clearance_m.value == pytest.approx(TRUE.clearance_m, rel=1e-3)
    assert estimate.stiffness_n_per_m.value == pytest.approx(TRUE.stiffness_n_per_m, rel=5e-3)


def test_errors_are_relative_to_the_true_law(compared, capsys):
    comparison, _ = compared
    comparison.print_estimates("One mass")
    printed = capsys.readouterr().out
    (estimate,) = comparison.identification.report.contacts
    assert f"{100 * (estimate.clearance_m.value / TRUE.clearance_m - 1):+.4f}" in printed
    assert f"{100 * (estimate.stiffness_n_per_m.value / TRUE.stiffness_n_per_m - 1):+.4f}" in printed


def test_report_and_figures_are_written(compared):
    comparison, folder = compared
    report = msgspec.json.decode((folder / "contact.json").read_bytes(), type=ContactReport)
    assert report == comparison.identification.report
    assert list(folder.glob("*.png"))


def test_tables_name_what_they_compare(compared, capsys):
    comparison, _ = compared
    comparison.print_estimates("One mass")
    comparison.print_nifo_forms("Both forms")
    comparison.print_by_equation("Equations")
    out = capsys.readouterr().out
    for words in ("One mass", "stop", "10000", "Both forms", "weak", "Equations", "mass 1"):
        assert words in out


def test_the_answer_names_its_page_and_what_to_try_next(compared, capsys):
    comparison, folder = compared
    comparison.print_answer("displacements known", folder / "contact.html")
    _, head, value, page, following = capsys.readouterr().out.splitlines()
    assert head == "The answer, displacements known:"
    assert value.startswith("  stop: clearance 1.0000 ± ")
    assert f"(true: {1e3 * TRUE.clearance_m:g} mm), stiffness" in value
    assert page == f"{folder / 'contact.html'}: the page of this answer; open it in a browser"
    assert following.startswith("next: ")


def test_a_scenario_is_recorded_by_the_plant_named(tmp_path):
    settings = msgspec.structs.replace(TRUE, duration_s=2.0)
    recording = read(record_reference_rig(settings, "modal", tmp_path / "new" / "r.mcap"))
    assert recording.provenance["plant"] == "modal"
    assert recording.duration_s == pytest.approx(2.0)
