"""Recordings in memory, and the chain from the modal plant to a channel, against filters at the plant's full rate."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import upfirdn
from scipy.signal.windows import kaiser
from threadpoolctl import threadpool_info, threadpool_limits

from rig.model.description import BaseMotion, StaticLoad, Station, rig_stations
from rig.simulation import replay
from rig.simulation.excitation import force_history
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from rig.simulation.sensors import digitise, plant_run_duration_s

SETTINGS = BarrelCradle(rms_n=40.0, stations=4)
RIG = SETTINGS.rig()
RATE_HZ, FACTOR = RIG.sample_rate_hz, 4
STEP_S = 1 / (RATE_HZ * FACTOR)
BURDENED = msgspec.structs.replace(
    RIG,
    sensors=tuple(
        msgspec.structs.replace(s, delay_s=delay, gain=1.01 + 0.01 * k)
        for k, (s, delay) in enumerate(zip(RIG.sensors, 4 * (0.0, 1.7e-4, 0.0, -6.1e-3), strict=True))
    ),
    base_motion=BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=5.0, high_hz=40.0),
    loads=(StaticLoad(station=Station("barrel", 0.5), force_n=2.0),),
)


def sampled(row, delay_s, step_s, samples):
    """A row at the plant's rate, at rest before, through the windowed sinc of 16 samples a side, sample by sample."""
    factor = round(1 / (RATE_HZ * step_s))
    half = 16 + 0.5 / factor
    reach = (16 + int(np.ceil(abs(delay_s) * RATE_HZ))) * factor
    time = np.arange(-reach, reach + 1) / factor - delay_s * RATE_HZ
    window = np.interp(time, np.linspace(-half, half, 4096), kaiser(4096, 10.0)) * (np.abs(time) < half)
    taps = window * np.sinc(time)
    filtered = upfirdn(taps / taps.sum(), np.concatenate([row, np.zeros(reach)]))
    return filtered[reach::factor][:samples]


@pytest.mark.parametrize("rig", [RIG, BURDENED], ids=["plain", "burdened"])
def test_a_recording_is_the_motion_of_every_step_filtered_row_by_row(rig, monkeypatch):
    monkeypatch.setattr(modal, "STEPS_PER_BLOCK", 5003)  # which no sampling interval divides
    duration_s = 1.5
    force_n = force_history(SETTINGS.force(), plant_run_duration_s(rig, duration_s), STEP_S)
    motion = concatenated(modal.simulate(rig, force_n, STEP_S, lambda _: None))
    assert motion.contact_force_n.any()
    segments = list(digitise(rig, modal.simulate(rig, force_n, STEP_S, lambda _: None), np.random.default_rng(1)))
    for quantity in ("displacement", "acceleration"):
        delivered = np.concatenate([p.sensed[quantity] for p in segments], axis=1)[:, : round(duration_s * RATE_HZ)]
        rows = [k for k, s in enumerate(rig.sensors) if s.quantity == quantity]
        for k, row in zip(rows, delivered, strict=True):
            sensor = rig.sensors[k]
            expected = sensor.gain * sampled(motion.sensed[k], sensor.delay_s, STEP_S, row.size)
            np.testing.assert_allclose(row, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    stations = rig_stations(rig)
    for sensor, row in zip(rig.sensors, motion.sensed, strict=True):
        if sensor.quantity == "displacement":
            at_station = motion.displacement_m[stations.index(sensor.station)]
            np.testing.assert_allclose(at_station, row, rtol=0, atol=1e-12 * np.abs(row).max())
    truth = {"displacement": motion.displacement_m, "relative_displacement": motion.eta_m}
    for name, rows in {**truth, "contact_force": motion.contact_force_n}.items():
        delivered = np.concatenate([p.truth[name] for p in segments], axis=1)
        expected = rows[:, ::FACTOR][:, : delivered.shape[1]]
        np.testing.assert_allclose(delivered, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_replay_holds_what_the_sensors_make_of_the_plant_under_that_force():
    force_n = force_history(SETTINGS.force(), 1.5, 1 / RATE_HZ)
    made = replay.modal(RIG, BURDENED, force_n, seed=3)
    np.testing.assert_array_equal(made.signals["force"].values, force_n[None])
    assert made.rig == RIG
    step_s = 2.0**-15
    time_s = np.arange(round(plant_run_duration_s(BURDENED, 1.5) / step_s)) * step_s
    fine = CubicSpline(np.arange(force_n.size) / RATE_HZ, force_n)(np.minimum(time_s, (force_n.size - 1) / RATE_HZ))
    motion = concatenated(modal.simulate(BURDENED, fine, step_s, lambda _: None, modes_per_beam=24))
    for quantity in ("displacement", "acceleration"):
        rows = [k for k, s in enumerate(BURDENED.sensors) if s.quantity == quantity]
        for k, row in zip(rows, made.signals[quantity].values, strict=True):
            sensor = BURDENED.sensors[k]
            expected = sensor.gain * sampled(motion.sensed[k], sensor.delay_s, step_s, row.size)
            np.testing.assert_allclose(row, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


class NotAsked:
    """Rows that must not be looked at."""

    def __len__(self):
        return 1

    def __getitem__(self, index):
        raise AssertionError(f"rows that nobody needs were computed: {index}")


def test_a_replay_asks_for_no_truth():
    def plant(*given):
        for block in modal.simulate(*given):
            yield replace(block, displacement_m=NotAsked(), eta_m=NotAsked())

    force_n = force_history(SETTINGS.force(), 1.1, 1 / RATE_HZ)
    made, expected = (replay.replayed_recording(RIG, RIG, force_n, p, STEP_S, 1) for p in (plant, modal.simulate))
    np.testing.assert_array_equal(made.signals["displacement"].values, expected.signals["displacement"].values)


def recorded(folder, plant):
    record(
        RIG,
        SETTINGS.force(),
        plant=plant,
        duration_s=1.1,
        step_s=STEP_S,
        path=folder / "recording.mcap",
        progress=lambda _: None,
    )


def replayed(_folder, plant):
    replay.replayed_recording(RIG, RIG, force_history(SETTINGS.force(), 1.1, 1 / RATE_HZ), plant, STEP_S, 1)


@pytest.mark.parametrize("made", [recorded, replayed])
def test_products_of_small_matrices_keep_to_one_thread(made, tmp_path):
    """More threads do not make them faster, and spend their time waiting."""
    thread_counts = []

    def plant(*given):
        for block in modal.simulate(*given):
            thread_counts.append(
                {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}
            )
            yield block

    with threadpool_limits(2):
        made(tmp_path, plant)
    assert thread_counts
    assert all(threads == {1} for threads in thread_counts)
