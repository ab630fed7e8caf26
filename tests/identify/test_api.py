"""What a stranger writes after `import rig, identify`."""

import html
import json

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import norm

import identify
import rig
from identify.gaps.results import Matters
from rig.model.description import read_rig, to_json
from rig.recording import Signals, channel_groups

SOME = Matters(contact=0.1)
"""What a minute of one mass bounds: by two forces 1.2 and 3.4 %; half a minute up to 13 %."""
MASS = rig.Sdof(duration_s=60.0, step_s=2.0**-12, sensors="displacement")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("api") / "mass.mcap"
    made = rig.record(MASS.rig(), path, force=MASS.force(), duration_s=MASS.duration_s, step_s=MASS.step_s)
    assert made.rig == MASS.rig()
    return path


def test_a_channel_is_a_labelled_array(file):
    recording = rig.read(str(file))
    force = recording["force"]
    assert (force.name, force.unit) == ("force", "N")
    assert force.time_s[-1] == pytest.approx(recording.duration_s - 1 / recording.rig.sample_rate_hz)
    np.testing.assert_array_equal(np.asarray(force), recording.force_n)
    assert np.std(force) == np.std(recording.force_n)


def test_a_channel_that_is_not_there_is_refused_with_those_that_are(file):
    with pytest.raises(rig.RigError, match="no channel 'acc_1'; it has force, "):
        rig.read(file)["acc_1"]


def test_a_channel_as_pandas(file):
    series = rig.read(file)["force"].to_pandas()
    assert (series.name, series.index.name) == ("force, N", "time_s")


def test_what_takes_plane_rigs_alone_refuses_rigs_in_space():
    machine = rig.BarrelCradleAnnular().rig()
    groups = channel_groups(machine)
    signals = {n: Signals(channels, 0.0, np.zeros((len(channels.names), 64))) for n, channels in groups.items()}
    with pytest.raises(rig.RigError, match="contact 'contact_1' is annular, and identify law takes rigs that move"):
        identify.law(rig.Recording(machine, signals, {}))


@pytest.mark.parametrize("settings", [rig.BarrelCradle, rig.BarrelCradleAnnular])
@pytest.mark.parametrize("duration_s", [1.2, 2.0])
def test_a_record_of_a_second_or_two_is_refused_in_a_sentence(tmp_path, settings, duration_s):
    machine = settings(sensors="acceleration")
    record = rig.record(machine.rig(), tmp_path / "short.mcap", force=machine.force(), duration_s=duration_s)
    with pytest.raises(rig.RigError, match=r"record (longer|about .* long)"):
        identify.contact(record)
    identify.check(record)


def test_a_recording_as_pandas(file):
    recording = rig.read(file)
    frame = recording.to_pandas()
    assert list(frame.columns) == ["force, N", "mass_0000mm_displacement, m"]
    np.testing.assert_array_equal(frame["force, N"], recording.force_n)
    np.testing.assert_array_equal(frame.index, recording["force"].time_s)


def test_contacts_from_a_file(file, tmp_path):
    result = identify.contact(str(file), use="displacement")
    (row,) = result.table()
    assert abs(row["clearance_m"] - MASS.clearance_m) < 3 * row["clearance_m_within"]
    assert result.to_dict()["contacts"][0]["clearance_m"]["value"] == row["clearance_m"]
    head, line = str(result).splitlines()
    assert head.split("  ")[0] == "contact"
    assert line.split()[:3] == ["stop", f"{1e3 * row['clearance_m']:.4f}", "±"]
    assert f'<td>stop</td><td class="number">{1e3 * row["clearance_m"]:.4f} ± ' in result._repr_html_()
    assert result.figure("section").png.startswith(b"\x89PNG")
    with pytest.raises(rig.RigError, match="no figure 'sections'; there are "):
        result.figure("sections")
    result.save(tmp_path / "results")
    assert json.loads((tmp_path / "results" / "contact.json").read_text())["contacts"] == list(
        result.to_dict()["contacts"]
    )
    assert (tmp_path / "results" / "contact.html").exists()


def test_a_contact_by_its_name(file):
    result = identify.contact(file, use="displacement")
    (estimate,) = result.to_dict()["contacts"]
    for quantity, field, unit, truth in (
        ("clearance", "clearance_m", "m", MASS.clearance_m),
        ("stiffness", "stiffness_n_per_m", "N/m", MASS.stiffness_n_per_m),
        ("damping", "damping_n_s_per_m", "N s/m", MASS.contact_damping_n_s_per_m),
    ):
        found = getattr(result["stop"], quantity)
        assert (found.value, found.standard_error) == (estimate[field]["value"], estimate[field]["standard_error"])
        assert found.unit == unit
        low, high = found.interval
        assert low < truth < high
        assert norm.cdf(high, found.value, found.standard_error) == pytest.approx(0.975, abs=1e-4)
    with pytest.raises(rig.RigError, match="no contact 'stops'; there are stop"):
        result["stops"]


@pytest.mark.study
def test_the_identified_rig_is_believed_instead_of_a_wrong_one(file, tmp_path):
    """An owner believes in 1.2 times the clearance; what `identify contact` finds leaves no gap."""
    right = MASS.rig().contacts[0]
    law = replace(right.law, lower_clearance_m=1.2e-3, upper_clearance_m=1.2e-3)
    wrong = replace(MASS.rig(), contacts=(replace(right, law=law),))
    asked = {"null_reference": tmp_path, "matters": SOME}
    believed = identify.gap(file, rig=wrong, **asked)
    assert believed.report.causes[0].effects == ("contact_clearance",)
    assert believed.report.verdict != "consistent"
    result = identify.contact(file, use="displacement")
    result.save(tmp_path / "found")
    identified = read_rig(tmp_path / "found" / "rig.json")
    assert identified == result.rig
    assert identified == replace(MASS.rig(), contacts=identified.contacts)
    estimate = result.report.contacts[0]
    law = identified.contacts[0].law
    assert (law.lower_clearance_m, law.stiffness_n_per_m) == (
        estimate.lower_clearance_m.value,
        estimate.stiffness_n_per_m.value,
    )
    second = identify.gap(file, rig=tmp_path / "found" / "rig.json", **asked)
    assert second.report.verdict == "consistent"


def test_a_rig_with_other_sensors_is_refused(file, tmp_path):
    path = tmp_path / "other.json"
    path.write_bytes(to_json(rig.Sdof(sensors="velocity").rig()))
    with pytest.raises(
        rig.RigError, match=r"other\.json: its forces, sensors or their sampling rate are not those of .*mass\.mcap"
    ):
        identify.gap(file, rig=path)
    with pytest.raises(rig.RigError, match="rig 'sdof': its forces, sensors"):
        identify.gap(rig.read(file), rig=rig.Sdof(sensors="velocity").rig())


@pytest.mark.study
def test_a_machine_is_consistent_with_its_recording(file, tmp_path):
    result = identify.gap(rig.read(file), matters=SOME)
    assert result.report.verdict == "consistent"
    assert str(result).splitlines()[0] == result.report.sentence
    assert result.report.sentence in html.unescape(result._repr_html_())
    assert result.corrected == MASS.rig()
    result.save(tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"gap.html", "gap.json", "rig.json"}


def test_a_file_given_twice_is_refused(file):
    with pytest.raises(rig.RigError, match="given twice"):
        identify.gap([file, str(file)])


def test_versions():
    assert rig.__version__ == identify.__version__
