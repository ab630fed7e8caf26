"""Causes that are named only where they are true: clocks, slower channels, windows, turns, first frequencies; and what
is no fault of a sound record."""

from dataclasses import replace as with_values
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from identify.checks import check_recording, waveforms
from identify.checks.spectra import acceleration_per_signal_unit, spectra_of
from identify.checks.windows import window_finding
from rig.effects import effect_named
from rig.recording import Recording, Signals, read
from rig.simulation.excitation import excitation_of
from rig.simulation.plants import modal
from rig.simulation.record import record
from tests.campaigns import annular, space_simulator
from tests.campaigns.sound import off_centre, through_a_converter
from tests.campaigns.spoiling.alteration import mapped, with_rows
from tests.campaigns.spoiling.rows import stretched
from tests.identify.checks.conftest import CANTILEVER


def on_another_clock(recording, names, ppm):
    """Channels whose samples lie further apart by so many millionths; the last few are lost."""
    count = recording.samples - 20
    rows = {
        name: recording[name].values[:count] for group in recording.signals.values() for name in group.channels.names
    }
    rows |= {name: stretched(recording[name].values, 1 + 1e-6 * ppm)[:count] for name in names}
    return with_rows(recording, rows)


@pytest.mark.parametrize(
    ("rig", "channel", "ppm"),
    [("mass", "mass_0000", 200.0), ("frame", "frame_0300", 100.0), ("cantilever", "force", -150.0)],
)
def test_two_clocks_are_told_with_their_rate(sound, rig, channel, ppm):
    (finding,) = check_recording(on_another_clock(sound(rig), (channel,), ppm))
    assert (finding.cause, finding.channels) == ("two clocks", (channel,))
    assert float(finding.evidence.split("grows by ")[1].split()[0]) == pytest.approx(abs(ppm), rel=0.1)
    assert ("early" if ppm > 0 else "late") in finding.evidence.split(" and ")[1]
    assert "a constant delay_s does not mend it" in finding.mend


@pytest.mark.parametrize("ratio", [1.5, 2.0, 2.56, 7.0])
def test_a_slower_channel_with_repeated_values_is_named(sound, ratio):
    def slower(row):
        return row[(np.floor(np.arange(row.size) / ratio) * ratio).astype(int)]

    (finding,) = check_recording(mapped(("mass_0000",), slower)(sound("mass")))
    assert finding.cause == "repeated values"
    assert float(finding.evidence.split("value ")[1].split()[0]) == pytest.approx(ratio, rel=0.01)


def quiet_then_driven(rms_in_steps):
    """1 s at rest, noise of a third of a step; then motion, then a decay to rest, in whole steps."""
    rng, time_s = np.random.default_rng(3), np.arange(8000) / 1000
    envelope = np.where(time_s < 1, 0, np.exp(-np.maximum(time_s - 4, 0) / 0.3))
    motion = np.sin(2 * np.pi * 11 * time_s) + np.sin(2 * np.pi * 17 * time_s)
    return np.round(rms_in_steps * envelope * motion + 0.3 * rng.standard_normal(time_s.size))


@pytest.mark.parametrize("rms_in_steps", [40, 250])
def test_a_converter_at_rest_holds_no_samples(rms_in_steps):
    row = quiet_then_driven(rms_in_steps)
    force = np.where((np.arange(row.size) > 1000) & (np.arange(row.size) < 4000), 1.0, 0.0)
    assert waveforms.held_samples_finding("x", row, force) is None
    assert waveforms.spikes_finding("x", waveforms.relative_neighbour_deviation(row), []) is None
    row[2000:2012] = row[2000]
    assert waveforms.held_samples_finding("x", row, force).cause == "held samples"


def test_a_sine_in_a_coarse_converter_is_not_clipped():
    row = np.round(100 * np.sin(2 * np.pi * 3 * np.arange(8000) / 1000))
    assert waveforms.clipped_finding("x", row) is None
    assert waveforms.clipped_finding("x", np.clip(row, -100, 60)).cause == "clipped"


def test_stated_noise_of_a_quiet_station_is_no_fault(sound):
    """A station that hardly moves shows its noise as the others do, and it is stated."""
    recording = sound("frame")
    rng, rate_hz = np.random.default_rng(2), recording.rig.sample_rate_hz
    density = 0.3 * recording["frame_0300"].values.std() / np.sqrt(rate_hz / 2)
    noisy = mapped(("frame_0300",), lambda r: r + density * np.sqrt(rate_hz / 2) * rng.standard_normal(r.size))(
        recording
    )
    assert "noise" in {finding.cause for finding in check_recording(noisy)}
    sensors = tuple(replace(s, noise_density=density) if s.name == "frame_0300" else s for s in noisy.rig.sensors)
    stated = Recording(replace(noisy.rig, sensors=sensors), noisy.signals, noisy.provenance)
    assert "noise" not in {finding.cause for finding in check_recording(stated)}


@pytest.mark.parametrize("number", [0, 1])
def test_a_body_that_starts_off_centre_has_no_finding(tmp_path, number):
    off_centre(11, number, tmp_path / "r.mcap")
    recording = read(tmp_path / "r.mcap")
    assert check_recording(recording) == ()
    assert check_recording(through_a_converter(recording, 11, 1.5)) == ()


def windowed(row, block, decay):
    return row * np.exp(-(np.arange(row.size) % block) / decay)


@pytest.mark.parametrize(("block", "decay"), [(2000, 600.0), (1500, 400.0)])
def test_a_window_on_blocks_is_named_with_its_decay(block, decay):
    rng, rate_hz = np.random.default_rng(4), 1000.0
    motion = np.convolve(rng.standard_normal(24_000), np.ones(20) / 20, "same")
    row, force = motion + 0.01 * rng.standard_normal(motion.size), rng.standard_normal((1, motion.size))
    assert window_finding("x", rate_hz, row, force) is None
    finding = window_finding("x", rate_hz, windowed(row, block, decay), force)
    assert finding.cause == "windowed"
    assert float(finding.evidence.split("exp(-t / ")[1].split()[0]) == pytest.approx(decay / rate_hz, rel=0.25)


def test_blocks_that_begin_with_a_hit_may_ring():
    """The level falls by itself after each hit."""
    rng, time = np.random.default_rng(5), np.arange(24_000)
    row = windowed(rng.standard_normal(time.size), 2000, 500.0)
    hits = np.where(time % 2000 < 10, 1.0, 0.0)[None]
    assert window_finding("x", 1000.0, row, np.roll(hits, 500, axis=1)).cause == "windowed"
    assert window_finding("x", 1000.0, row, hits) is None


@pytest.fixture(scope="module")
def ring():
    """10 s of two tubes in rings, as a laboratory builds them, and their rig.json."""
    rng, of_building = np.random.default_rng([77, 1]).spawn(2)
    machine = annular.drawn_machine(rng)
    built = annular.as_built(machine, of_building, 0.003)
    samples = round(10 * annular.RATE_HZ)
    return annular.believed_rig(machine), space_simulator.simulated(built, 150.0, samples, annular.RATE_HZ, 5)


@pytest.mark.parametrize(("degrees", "which"), [(0.6, "all"), (5.0, "one"), (5.0, "all")])
def test_turned_sensors_have_a_cause_of_their_own(tmp_path: Path, ring, degrees, which):
    rig, space_record = ring
    turned = space_record.accelerations.copy()
    angle = np.radians(degrees)
    for i in range(turned.shape[1]) if which == "all" else (3,):
        in_y, in_z = space_record.accelerations[:, i]
        turned[:, i] = np.cos(angle) * in_y + np.sin(angle) * in_z, np.cos(angle) * in_z - np.sin(angle) * in_y
    annular.write(tmp_path / "r.mcap", rig, with_values(space_record, accelerations=turned))
    findings = check_recording(read(tmp_path / "r.mcap"))
    assert {finding.cause for finding in findings} == ({"turned"} if degrees > 2 else set())
    for finding in findings:
        assert float(finding.evidence.split("turned by ")[1].split()[0]) == pytest.approx(degrees, rel=0.15)


def test_what_no_single_cause_takes_away_is_unexplained(sound):
    """A sensor that saturates is off by no gain, though a gain fits it a little better."""
    recording = sound("frame")
    bent = mapped(("frame_0300",), lambda r: r - 0.03 * r**3 / np.mean(r**2))(recording)
    (finding,) = check_recording(bent)
    assert (finding.cause, finding.channels) == ("unexplained", ("frame_0300",))
    assert "% of its motion" in finding.evidence


MAST = replace(CANTILEVER.rig, contacts=())


@pytest.mark.parametrize("force", ["gaussian", "free_decay"])
@pytest.mark.parametrize(("tip_mass_kg", "is_told"), [(0.0, False), (1.6, True)])
def test_a_first_frequency_that_is_far_off_is_told(tmp_path, force, tip_mass_kg, is_told):
    actual = MAST
    if tip_mass_kg:
        actual = effect_named(f"added_mass:mass_kg={tip_mass_kg},body=beam,relative_position=1").applied_to(MAST)
    record(
        MAST,
        excitation_of(force, rms_n=20.0, low_hz=0.5, high_hz=60.0),
        plant=modal.simulate,
        duration_s=14.0,
        step_s=2.0**-14,
        path=tmp_path / "r.mcap",
        progress=lambda _: None,
        actual=actual,
    )
    recording = read(tmp_path / "r.mcap")
    if force == "free_decay":
        first = round(1.2 * MAST.sample_rate_hz)
        decayed = {
            n: Signals(s.channels, 0.0, s.values[:, first:] * (n != "force")) for n, s in recording.signals.items()
        }
        recording = Recording(recording.rig, decayed, {})
    told = [finding for finding in check_recording(recording) if finding.evidence.startswith("mode 1 of beam is at 5.")]
    assert len(told) == is_told
    if is_told:
        assert "rig.json has 8.4 Hz" in told[0].evidence
    else:
        assert check_recording(recording) == ()


def test_a_coarse_converter_that_rests_has_the_noise_of_its_rounding(sound):
    coarse = through_a_converter(sound("cantilever"), 8, 2.0)
    spectra = spectra_of(coarse, coarse.rig.sensors)
    samples = np.stack([coarse[sensor.name].values for sensor in coarse.rig.sensors])
    steps = np.array([np.diff(np.unique(row)).min() for row in samples])
    per_step = np.abs([acceleration_per_signal_unit(sensor, spectra.omega) for sensor in coarse.rig.sensors])
    rounding = np.sqrt(coarse.samples / 12) * steps[:, None] * per_step
    assert (spectra.line_noise > 0.99 * rounding).all()
