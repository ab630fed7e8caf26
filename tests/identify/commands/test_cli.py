"""The command `identify contact`: what it prints, what it writes, and how it fails."""

import msgspec
import pytest

from identify.contacts.results import ContactReport, Segments
from rig.model.description import read_rig
from rig.simulation.reference import Sdof
from tests.running import exit_status


@pytest.fixture(scope="module")
def recording(simulate, tmp_path_factory):
    """Half a minute of the one-mass rig."""
    return simulate(Sdof(duration_s=30.0, step_s=2.0**-12), tmp_path_factory.mktemp("cli") / "mass.mcap")


@pytest.fixture
def identify(capfd):
    """Runs the command and gives its exit status, standard output and standard error."""

    def run(*words):
        return exit_status("identify", *words), *capfd.readouterr()

    return run


def test_json_on_standard_output_is_the_report_and_the_file(identify, recording, tmp_path):
    status, out, err = identify("contact", recording, "--json", "--out", tmp_path, "--block", 2.5, "--band", 1, 14)
    assert (status, err) == (0, "")
    report = msgspec.json.decode(out, type=ContactReport)
    assert out.count("\n") == 1
    assert msgspec.json.decode((tmp_path / "contact.json").read_bytes(), type=ContactReport) == report
    assert [c.name for c in report.contacts] == ["stop"]
    assert report.contacts[0].clearance_m.value == pytest.approx(Sdof().clearance_m, rel=1e-2)
    (nifo,) = report.nifo
    assert nifo.resolution_hz == pytest.approx(1 / 2.5)
    assert nifo.band_hz[0] >= 1
    assert nifo.band_hz[1] <= 14
    assert len(list(tmp_path.glob("*.png"))) >= 6
    assert (tmp_path / "contact.html").read_text(encoding="utf-8").endswith("</html>\n")
    assert not list(tmp_path.glob("*.part*"))


def test_segments_are_pooled_and_shown_one_by_one(identify, recording, tmp_path):
    status, out, err = identify("contact", recording, "--segment", 10, "--use", "displacement", "--out", tmp_path)
    assert (status, err) == (0, "")
    assert "stop" in out
    segments = msgspec.json.decode((tmp_path / "segments.json").read_bytes(), type=Segments).segments
    report = msgspec.json.decode((tmp_path / "contact.json").read_bytes(), type=ContactReport)
    assert [(p.start_s, p.end_s) for p in segments] == [(0.0, 30.0)]
    assert report.contacts[0].clearance_m.value == pytest.approx(Sdof().clearance_m, rel=1e-2)
    assert (tmp_path / "segments.png").stat().st_size > 10_000
    (contact,) = read_rig(tmp_path / "rig.json").contacts
    assert contact.law.stiffness_n_per_m == report.contacts[0].stiffness_n_per_m.value
    status, _, err = identify("contact", recording, "--segment", 0)
    assert (status, err.count("\n")) == (1, 1)
    assert "10 s or more" in err


def test_tables_show_value_and_half_of_the_interval(identify, recording, tmp_path):
    words = ("--use", "displacement", "--tolerances", "exact", "--out", tmp_path)
    status, out, err = identify("contact", recording, *words, "--details")
    assert (status, err) == (0, "")
    estimate = msgspec.json.decode((tmp_path / "contact.json").read_bytes())["contacts"][0]["clearance_m"]
    row = next(line for line in out.splitlines() if "stop" in line)
    clearance = row.split("│")[2]
    value, half = (float(x) for x in clearance.split("±"))
    assert value == pytest.approx(1e3 * estimate["value"], rel=1e-2)
    assert half == pytest.approx(1e3 * 1.96 * estimate["standard_error"], rel=0.05)
    assert "NIFO by modal equation" in out
    assert "mass 1" in out


def test_results_are_not_overwritten_unless_forced(identify, recording, tmp_path):
    existing = tmp_path / "contact.json"
    existing.write_text("mine")
    status, out, err = identify("contact", recording, "--out", tmp_path)
    assert (status, out) == (1, "")
    assert err == f"identify: {existing}: exists already; give another name, or --force to overwrite it\n"
    assert existing.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [existing]
    (tmp_path / "believed").mkdir()
    (tmp_path / "believed" / "rig.json").write_text("mine too")
    status, _, err = identify("contact", recording, "--out", tmp_path / "believed")
    assert (status, "rig.json: exists already" in err) == (1, True)
    status, _, err = identify("gap", recording, "--out", tmp_path / "believed")
    assert (status, "rig.json: exists already" in err) == (1, True)
    status, out, err = identify("contact", recording, "--out", tmp_path, "--force")
    assert (status, err) == (0, "")
    assert out.splitlines()[-1].startswith(f"{tmp_path / 'contact.html'}: written, open it in a browser")
    assert msgspec.json.decode(existing.read_bytes(), type=ContactReport).rig == "sdof"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--averages", 1), "averages is 1; give 2 or more"),
        (("--block", 1000), "a block of 1000 s does not fit a record with"),
        (("--overlap", 1.5), "overlap is 1.5; give a value from 0 to below 1"),
        (("--band", 5, 4), "the band 5.0 to 4.0 Hz is empty"),
        (("--use", "velocity"), "the recording has no velocity sensors"),
        (("--equation", "barrel 3"), "no modal equation 'barrel 3' with a measured force; there are mass 1"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(identify, recording, words, sentence):
    status, out, err = identify("contact", recording, *words)
    assert (status, out) == (1, "")
    assert err.startswith(f"identify: {sentence}")
    assert err.count("\n") == 1


def test_a_file_that_is_no_recording_is_named(identify, tmp_path):
    missing, other_recording = tmp_path / "none.mcap", tmp_path / "other.mcap"
    other_recording.write_text("time,force\n")
    for path, sentence in ((missing, "cannot be opened"), (other_recording, "is no MCAP file")):
        status, out, err = identify("contact", path)
        assert (status, out) == (1, "")
        assert err.startswith(f"identify: {path}: {sentence}")
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--use", "jerk"), "'jerk' is none of auto, acceleration"),
        (("--averages", "many"), "Invalid value for '--averages'"),
        (("--nonsense",), "No such option: --nonsense"),
        (("other.mcap",), "unexpected extra argument"),
    ],
)
def test_wrong_words_are_exit_status_2(identify, recording, words, said):
    status, out, err = identify("contact", recording, *words)
    assert (status, out) == (2, "")
    assert said in " ".join(err.replace("│", " ").split())


@pytest.mark.parametrize("command", ["check", "contact", "law", "gap", "compare"])
def test_tolerances_that_are_neither_a_name_nor_a_file_are_refused_in_a_sentence(identify, recording, command):
    status, out, err = identify(command, recording, "--tolerances", "none")
    assert (status, out) == (1, "")
    assert "none: no tolerances can be read there" in err
    assert err.count("\n") == 1


def test_help_shows_an_example(identify):
    status, out, _ = identify("contact", "--help")
    assert status == 0
    assert "identify contact barrel_cradle.mcap" in out


def test_a_contact_that_is_not_told_is_no_failure(identify, simulate, tmp_path):
    """The force is too weak to close it: the reason is printed, results and figures are written all the same."""
    path = simulate(Sdof(duration_s=20.0, step_s=2.0**-12, rms_n=0.01), tmp_path / "weak.mcap")
    status, out, err = identify("contact", path, "--use", "displacement", "--out", tmp_path / "results")
    assert (status, err) == (0, "")
    assert "stop: not determined by this record: " in out
    report = msgspec.json.decode((tmp_path / "results" / "contact.json").read_bytes(), type=ContactReport)
    assert report.contacts == ()
    assert [u.name for u in report.unanswered] == ["stop"]
