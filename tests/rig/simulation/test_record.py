"""Recording in one go: rig, force, plant, sensors, files."""

import importlib.metadata

import msgspec
import numpy as np
import pytest

from rig.errors import RigError
from rig.model.description import Station
from rig.recording import read, read_truth, truth_path
from rig.simulation.excitation import QUIET_S, BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof

FORCE = BandLimitedGaussian(rms_n=14.0, low_hz=0.5, high_hz=100.0)
RIG = BarrelCradle(stations=4, contact_damping_n_s_per_m=3.0).rig()


def recorded(path, rig=RIG, force=FORCE, duration_s=2.3, step_s=2.0**-14, progress=lambda _: None):
    record(rig, force, plant=modal.simulate, duration_s=duration_s, step_s=step_s, path=path, progress=progress)
    return read(path), read_truth(truth_path(path))


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("record") / "r.mcap")


def test_recording_and_truth_have_the_samples_asked_for(pair):
    recording, truth = pair
    assert recording.samples == truth.samples == round(2.3 * RIG.sample_rate_hz)
    assert recording.rig == truth.rig == RIG
    assert recording.provenance["plant"] == "modal"
    assert float(recording.provenance["step_s"]) == 2.0**-14
    assert recording.provenance["seed"] == "1"


def test_a_plant_needs_no_package_of_another(tmp_path, monkeypatch):
    def version(name):
        if name == "exudyn":
            raise importlib.metadata.PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(importlib.metadata, "version", version)
    provenance = recorded(tmp_path / "r.mcap")[0].provenance
    assert provenance["version of numpy"] == "1.0"
    assert "version of exudyn" not in provenance


def test_nothing_moves_in_the_quiet_second(pair):
    recording, _ = pair
    quiet = round(QUIET_S * RIG.sample_rate_hz) - 20  # the filter looks 16 samples ahead
    for signals in recording.signals.values():
        assert not signals.values[:, :quiet].any()
        assert signals.values[:, quiet + 40 :].any()


def test_relative_displacement_and_contact_force_obey_the_law(pair):
    _, truth = pair
    displacement = truth.signals["displacement"]
    displacement_at = dict(zip(displacement.channels.stations, displacement.values, strict=True))
    eta = truth.signals["relative_displacement"].values
    for contact, gap, force in zip(RIG.contacts, eta, truth.signals["contact_force"].values, strict=True):
        np.testing.assert_allclose(gap, displacement_at[contact.at] - displacement_at[contact.against], atol=1e-12)
        depth = contact.law.penetration_m(gap)
        assert not force[depth == 0].any()
        rate = np.gradient(gap, 1 / RIG.sample_rate_hz)
        assert np.abs(depth).max() > 0
        assert np.std(force - contact.law.force_n(gap, rate)) < 0.01 * np.std(force)


def test_a_perfect_displacement_sensor_shows_the_truth(pair):
    recording, truth = pair
    sensed = recording.signals["displacement"]
    displacement_at = dict(
        zip(truth.signals["displacement"].channels.stations, truth.signals["displacement"].values, strict=True)
    )
    for station, values in zip(sensed.channels.stations, sensed.values, strict=True):
        assert np.std(values - displacement_at[station]) < 1e-4 * np.std(
            displacement_at[station]
        )  # but for what lies above the passband


def test_accelerations_are_the_second_derivative_of_the_displacements(pair):
    recording, _ = pair
    rate_hz = recording.rig.sample_rate_hz
    spectra = {
        q: np.fft.rfft(recording.signals[q].values * np.hanning(recording.samples))
        for q in ("displacement", "acceleration")
    }
    frequency_hz = np.fft.rfftfreq(recording.samples, 1 / rate_hz)
    band = (frequency_hz > 20) & (frequency_hz < 400)
    expected = -((2 * np.pi * frequency_hz) ** 2) * spectra["displacement"]
    error = (spectra["acceleration"] - expected)[:, band]
    assert np.linalg.norm(error) < 0.03 * np.linalg.norm(expected[:, band])  # the window's derivatives are left out


def test_the_seed_decides_the_whole_recording(tmp_path):
    rig = Sdof(noise_density=1e-3).rig()
    force = BandLimitedGaussian(rms_n=1.0, low_hz=0.0, high_hz=15.0, seed=5)
    other_force = msgspec.structs.replace(force, seed=6)
    first, repeated, other_seed = (
        recorded(tmp_path / f"{i}.mcap", rig, f, step_s=2.0**-11)[0] for i, f in enumerate([force, force, other_force])
    )
    for name, signals in first.signals.items():
        np.testing.assert_array_equal(signals.values, repeated.signals[name].values)
        assert not np.array_equal(signals.values, other_seed.signals[name].values)
    quiet = slice(0, round(0.9 * rig.sample_rate_hz))
    noise = first.signals["acceleration"].values[0, quiet]
    assert np.std(noise) == pytest.approx(1e-3 * np.sqrt(rig.sample_rate_hz / 2), rel=4 / np.sqrt(2 * noise.size))


def test_several_forces_are_alike_and_independent(tmp_path):
    rig = msgspec.structs.replace(RIG, force_at=(RIG.force_at, Station("cradle", 0.6)))
    recording, truth = recorded(tmp_path / "r.mcap", rig, duration_s=9.0)
    single_force, _ = recorded(tmp_path / "one.mcap", duration_s=9.0)
    np.testing.assert_array_equal(truth.forces_n, recording.forces_n)
    np.testing.assert_array_equal(recording.forces_n[0], single_force.force_n)
    excited = recording.forces_n[:, round(QUIET_S * rig.sample_rate_hz) :]
    np.testing.assert_allclose(excited.std(axis=1), FORCE.rms_n, rtol=0.01)
    assert abs(np.corrcoef(excited)[0, 1]) < 4 / np.sqrt(2 * 100.0 * 8.0)  # of 2 B T independent values
    assert not np.allclose(recording.signals["acceleration"].values, single_force.signals["acceleration"].values)


@pytest.mark.parametrize("duration_s", [1.5, 1.7301])
def test_the_same_recording_at_half_the_step(tmp_path, duration_s):
    rig = Sdof(clearance_m=1.0, sensors="displacement").rig()  # no contact, so no chaos
    force = BandLimitedGaussian(rms_n=1.0, low_hz=0.0, high_hz=15.0)
    (coarse, _), (fine, _) = (
        recorded(tmp_path / f"{step_s}.mcap", rig, force, duration_s, step_s) for step_s in (2.0**-12, 2.0**-13)
    )
    difference = coarse.signals["displacement"].values - fine.signals["displacement"].values
    assert np.abs(difference).max() < 1e-4 * np.abs(fine.signals["displacement"].values).max()


def test_an_interruption_leaves_both_files_readable(tmp_path):
    def interrupt(fraction):
        if fraction > 0.5:
            raise KeyboardInterrupt

    path = tmp_path / "r.mcap"
    with pytest.raises(KeyboardInterrupt):
        recorded(path, duration_s=8.0, progress=interrupt)
    samples = read(path).samples
    assert 0.25 < samples / (8.0 * RIG.sample_rate_hz) < 0.75
    assert read_truth(truth_path(path)).samples == samples


def test_a_failing_simulation_leaves_no_file(tmp_path):
    with pytest.raises(RigError, match="too stiff for the step"):
        recorded(tmp_path / "r.mcap", rig=BarrelCradle(stiffness_1_n_per_m=1e12).rig())
    assert not list(tmp_path.iterdir())


def test_a_record_without_a_sample_is_refused_before_anything_is_simulated(tmp_path):
    slow = msgspec.structs.replace(Sdof().rig(), sample_rate_hz=0.01)
    with pytest.raises(RigError, match=r"duration is 2\.3 s and sample_rate_hz 0\.01, which makes no sample"):
        recorded(tmp_path / "r.mcap", slow, progress=lambda _: pytest.fail("simulated"))
    assert not list(tmp_path.iterdir())
