"""A sound recording has no finding; a spoilt one is named by cause and channel."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import butter, sosfilt

from identify.checks import adding_first_finding_to_error, check_recording
from rig.effects import effect_named
from rig.errors import RigError
from rig.model.tolerances import LABORATORY
from rig.recording import Recording, Signals, read
from rig.simulation.reference import BarrelCradle
from tests.campaigns.spoiling.alteration import delayed, mapped, with_rows, with_sensors
from tests.campaigns.spoiling.alterations import alterations
from tests.campaigns.spoilt import names_it
from tests.recorded import recorded

NAMED = (
    "one polarity turned",
    "one channel in g",
    "one channel 10 % too large",
    "one channel 1 ms late",
    "one channel slips 20 samples",
    "one channel low-passed at 60 Hz",
    "one channel integrated",
    "two neighbours swapped",
    "a copy of its neighbour",
    "all sensors in g",
    "all polarities turned",
    "force 1 ms late",
    "force of another record",
    "clock 1 % fast",
    "samples lost in all channels",
    "the first seconds cut off",
    "density 10 % off",
    "damping four times",
    "frequencies 15 % off",
    "one station 50 mm off",
    "beam described as free-free",
)


@pytest.mark.parametrize(
    "rig",
    [
        "frame",
        "two shakers",
        "cantilever",
        "mass",
        "mass with a spring and a mass on it",
        "progressive stop",
        "two stops at one place",
    ],
)
def test_a_sound_recording_has_no_finding(sound, rig):
    assert check_recording(sound(rig)) == ()


@pytest.mark.parametrize("rig", ["two beams, four accelerometers", "cantilever, three accelerometers"])
@pytest.mark.parametrize("seed", [2, 6])
def test_errors_drawn_by_their_tolerances_have_no_finding(off_by_tolerances, rig, seed):
    assert check_recording(off_by_tolerances(rig, seed)) == ()


def test_damping_that_is_off_within_three_tolerances_is_no_finding(damped):
    """Its misfit is that of a gross fault, which errors within the tolerances explain as well."""
    factor = float(np.exp(2.6 * LABORATORY.damping))
    assert check_recording(damped("cantilever, three accelerometers", factor)) == ()


def test_modes_that_a_machine_lacks_have_no_finding(of_few_modes):
    """Far above the band they add a compliance where forces act, as the modes do that every description leaves out."""
    assert check_recording(of_few_modes("cantilever, hard blows")) == ()


def test_the_beginning_of_a_force_is_no_discontinuity(tmp_path):
    settings = BarrelCradle(
        sensors="acceleration",
        noise_density=1e-3,
        stations=4,
        sample_rate_hz=2048.0,
        high_hz=60.0,
        seed=5,
        duration_s=32.0,
    )
    machine = effect_named("contact_clearance:factor=1.1").applied_to(settings.rig())
    assert check_recording(read(recorded(settings, tmp_path / "r.mcap", actual=machine))) == ()


@pytest.mark.parametrize(("rig", "seed"), [("frame", 2), ("frame", 3), ("two shakers", 4)])
def test_crosstalk_of_neighbours_is_not_taken_for_another_fault(off_by_tolerances, rig, seed):
    """Three tolerances of crosstalk on top of all others look like gains, stations, damping or the clock."""
    recording = off_by_tolerances(rig, seed)
    signals, rng = recording.signals["acceleration"], np.random.default_rng(seed)
    count = len(signals.values)
    shares = [3 * LABORATORY.crosstalk * rng.standard_normal(count - 1) for _ in range(2)]
    mixing = np.eye(count) + np.diag(shares[0], 1) + np.diag(shares[1], -1)
    mixed = Signals(signals.channels, signals.start_s, mixing @ signals.values)
    mixed_signals = {**recording.signals, "acceleration": mixed}
    assert check_recording(Recording(recording.rig, mixed_signals, recording.provenance)) == ()


@pytest.mark.parametrize("name", NAMED)
def test_an_alteration_is_named(sound, name):
    recording = sound("cantilever")
    (alteration,) = (a for a in alterations(recording.rig, np.random.default_rng(5)) if a.name == name)
    findings = check_recording(alteration.change(recording))
    assert findings
    assert names_it(findings[0], alteration), findings[0]


@pytest.mark.parametrize(
    ("channel", "corner_hz", "kind", "words"),
    [
        ("force", 8, "high", "it went through a high-pass"),
        ("force", 40, "low", "it went through a low-pass"),
        ("acceleration", 8, "high", "all sensors went through a high-pass"),
        ("acceleration", 40, "low", "all sensors went through a low-pass"),
    ],
)
def test_what_was_filtered_is_told_by_the_end_of_the_band_that_is_right(sound, channel, corner_hz, kind, words):
    recording = sound("cantilever")
    signals, rate_hz = recording.signals, recording.rig.sample_rate_hz
    sections = butter(1 if kind == "high" else 2, corner_hz, kind, fs=rate_hz, output="sos")
    measured = signals[channel]
    filtered = Signals(measured.channels, measured.start_s, sosfilt(sections, measured.values))
    (finding,) = check_recording(Recording(recording.rig, {**signals, channel: filtered}, recording.provenance))
    assert finding.cause == "filtered"
    assert words in finding.evidence


@pytest.mark.parametrize(
    ("change", "cause", "channels"),
    [
        (lambda forces: forces[::-1], "swapped", ("force_1", "force_2")),
        (lambda forces: forces * [[1.0], [-1.0]], "polarity", ("force_2",)),
        (lambda forces: forces * [[1.0], [1e-3]], "units", ("force_2",)),
        (lambda forces: forces * [[1.1], [1.0]], "gain", ("force_1",)),
        (lambda forces: forces * [[1.0], [0.0]], "dead", ("force_2",)),
    ],
)
def test_of_two_forces_the_wrong_one_is_named(sound, change, cause, channels):
    recording = sound("two shakers")
    rows = dict(zip(recording.force_names, change(recording.forces_n), strict=True))
    (finding,) = check_recording(with_rows(recording, rows))
    assert (finding.cause, finding.channels) == (cause, channels)


def test_a_gain_is_told_with_its_size(sound):
    recording = sound("frame")
    (finding,) = check_recording(mapped(("frame_0300",), lambda r: 1.05 * r)(recording))
    assert (finding.cause, finding.channels) == ("gain", ("frame_0300",))
    stated_gain = float(finding.evidence.split("delivers ")[1].split()[0])
    assert min(abs(stated_gain - 1.05), abs(stated_gain - 5)) < 0.6  # as a factor, or in per cent


def test_a_delay_is_told_with_its_size(sound):
    recording = sound("frame")
    late = mapped(("frame_0600",), lambda r: delayed(r, 3e-3, recording.rig.sample_rate_hz))(recording)
    (finding,) = check_recording(late)
    assert (finding.cause, finding.channels) == ("delay", ("frame_0600",))
    assert float(finding.evidence.split("comes ")[1].split()[0]) == pytest.approx(3.0, rel=0.03)


@pytest.mark.parametrize(("share", "cause"), [(-1.0, "polarity"), (1 / 9.80665, "units")])
def test_a_single_mass_is_checked_by_its_open_passages(sound, share, cause):
    findings = check_recording(mapped(("mass_0000",), lambda r: share * r)(sound("mass")))
    assert [f.cause for f in findings] == [cause]


def test_a_believed_frequency_of_a_single_mass_is_corrected(sound):
    recording = sound("mass")
    (body,) = recording.rig.bodies
    wrong = Recording(
        replace(recording.rig, bodies=(body.scale_frequencies(14 / 12),)), recording.signals, recording.provenance
    )
    (finding,) = check_recording(wrong)
    stated_hz = float(finding.evidence.split("its frequency were ")[1].split()[0])
    assert (finding.cause, finding.of) == ("frequency", "mass")
    assert stated_hz == pytest.approx(12.0, rel=0.01)


def test_a_segment_of_a_longer_record_is_checked_by_its_samples(sound):
    recording = sound("frame")
    later = {n: Signals(s.channels, 40.0, s.values[:, 4096:]) for n, s in recording.signals.items()}
    segment = Recording(recording.rig, later, {})
    assert check_recording(segment) == ()
    (finding,) = check_recording(with_rows(segment, {"frame_0300": np.zeros(segment.samples)}))
    assert (finding.cause, finding.channels) == ("dead", ("frame_0300",))


def test_an_error_names_the_first_finding(sound):
    recording = sound("frame")
    dead = check_recording(with_rows(recording, {"frame_0300": np.zeros(recording.samples)}))
    named = r"no answer \(the check of the record found: frame_0300 stands at 0"
    with pytest.raises(RigError, match=named), adding_first_finding_to_error(dead):
        raise RigError("no answer")


def test_positions_that_count_from_the_other_end_are_named(sound):
    recording = sound("cantilever")
    turned = with_sensors(lambda s: replace(s, station=replace(s.station, position_m=1.0 - s.station.position_m)))
    assert [f.cause for f in check_recording(turned(recording))] == ["mirrored"]


def test_a_record_that_runs_backwards_is_named(sound):
    recording = sound("mass")
    turned = {name: Signals(s.channels, s.start_s, s.values[:, ::-1]) for name, s in recording.signals.items()}
    (finding,) = check_recording(Recording(recording.rig, turned, {}))
    assert "as if time ran backwards" in finding.evidence
    beginning = {name: Signals(s.channels, s.start_s, s.values[:, 2048:]) for name, s in recording.signals.items()}
    assert not any("backwards" in f.evidence for f in check_recording(Recording(recording.rig, beginning, {})))


def test_what_no_machine_does_is_named_though_all_channels_agree(sound):
    """Force and motion times the same factor obey the same linear model, and a contact's law scaled in length."""
    recording = sound("mass")

    def scaled(factor):
        signals = {n: Signals(s.channels, s.start_s, factor * s.values) for n, s in recording.signals.items()}
        return Recording(recording.rig, signals, {})

    assert check_recording(scaled(10.0)) == ()
    findings = check_recording(scaled(1e14))
    assert {f.cause for f in findings} == {"units"}
    assert set(recording.force_names) <= {name for f in findings for name in f.channels}
    assert "nothing on a test rig exceeds" in findings[0].sentence
