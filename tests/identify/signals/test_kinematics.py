"""From any measured quantity to displacement, velocity and acceleration."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

import rig
from identify.signals.beginning import force_onset
from identify.signals.kinematics import CORNER_HZ, TAPER_S, kinematics
from identify.signals.noise import acceleration_noise_m_per_s2
from rig.errors import RigError
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.model.sensing import PASSBAND
from rig.recording import Recording, Signals
from rig.recording.channels import Channels
from rig.simulation.reference import BarrelCradle

RATE_HZ = 512.0
DURATION_S = 16.0
MASS = Station("mass")
ORDERS = {"displacement": 0, "velocity": 1, "acceleration": 2}
TONES = ((3e-3, 1.3, 0.2), (1e-3, 17.0, 1.0), (2e-5, 150.0, 2.0))
"""Amplitude (m), frequency (Hz), phase."""
SLOW = ((5e-3, 0.1, 0.4),)


def motion_of_tones(order, time_s, tones=TONES):
    """The order-th derivative of tones that set in over three seconds after the first; the product rule written out."""
    phase = np.pi / 2 * np.clip((time_s - 1) / 3, 0, 1)
    rate = np.where((time_s > 1) & (time_s < 4), np.pi / 6, 0.0)
    s, c = np.sin(phase), np.cos(phase)
    rise = (s**8, 8 * rate * s**7 * c, 8 * rate**2 * (7 * s**6 * c**2 - s**8))
    total = np.zeros(time_s.size)
    for amplitude, frequency_hz, shift in tones:
        omega = 2 * np.pi * frequency_hz
        tone = [amplitude * omega**n * np.sin(omega * time_s + shift + n * np.pi / 2) for n in range(3)]
        total += {
            0: rise[0] * tone[0],
            1: rise[1] * tone[0] + rise[0] * tone[1],
            2: rise[2] * tone[0] + 2 * rise[1] * tone[1] + rise[0] * tone[2],
        }[order]
    return total


def sensor(quantity, **chain):
    return Sensor(name=quantity, station=MASS, quantity=quantity, **chain)


def recorded(*sensors, tones=TONES, duration_s=DURATION_S, rng=None, quiet_s=1.0):
    """What these sensors of one mass deliver: gain times the motion of delay_s ago, and noise."""
    law = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e4)
    rig = Rig(
        name="r",
        bodies=(Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01),),
        contacts=(Contact(name="stop", at=MASS, against=None, law=law),),
        force_at=MASS,
        sensors=sensors,
        sample_rate_hz=RATE_HZ,
    )
    time_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    groups = {"force": (["force"], [(time_s >= quiet_s) * 1.0])}
    for s in sensors:
        delivered = s.gain * motion_of_tones(ORDERS[s.quantity], time_s - s.delay_s, tones)
        if rng is not None:
            delivered += s.noise_density * np.sqrt(RATE_HZ / 2) * rng.standard_normal(time_s.size)
        names, rows = groups.setdefault(s.quantity, ([], []))
        names.append(s.name)
        rows.append(delivered)
    signals = {
        quantity: Signals(Channels(quantity, "", tuple(names), (MASS,) * len(names), RATE_HZ), 0.0, np.stack(rows))
        for quantity, (names, rows) in groups.items()
    }
    return Recording(rig, signals, {})


def rows(motion):
    return {
        "displacement": motion.displacement_m[0],
        "velocity": motion.velocity_m_per_s[0],
        "acceleration": motion.acceleration_m_per_s2[0],
    }


def errors(motion, tones=TONES):
    """rms of the error over rms of the motion, by quantity."""
    time_s = np.arange(motion.force_n.size) / RATE_HZ
    true = {quantity: motion_of_tones(order, time_s, tones) for quantity, order in ORDERS.items()}
    return {q: float(np.std(row - true[q]) / np.std(true[q])) for q, row in rows(motion).items()}


@pytest.mark.parametrize(
    ("quantity", "expected"),
    [("displacement", (0, 1e-5, 1e-4)), ("velocity", (5e-3, 0, 1e-4)), ("acceleration", (1e-2, 1e-3, 0))],
)
def test_one_quantity_gives_the_others(quantity, expected):
    motion = kinematics(recorded(sensor(quantity)))
    assert motion.trusted_hz == (0.0 if quantity == "displacement" else CORNER_HZ, PASSBAND * RATE_HZ)
    assert motion.zero_known == (quantity == "displacement")
    for error, bound in zip(errors(motion).values(), expected, strict=True):
        assert error <= max(bound, 1e-9)


@pytest.mark.parametrize("quantity", ORDERS)
def test_a_record_gives_no_motion_before_it_began(quantity):
    """The end of a record, which integration falsifies, does not come round to its start."""
    motion = kinematics(recorded(sensor(quantity)))
    for row in rows(motion).values():
        assert np.abs(row[: round(0.9 * RATE_HZ)]).max() < 5e-3 * np.abs(row).max()


def test_what_integration_loses_is_told():
    """The second derivative of the displacement and the lost acceleration together are the acceleration."""
    motion = kinematics(recorded(sensor("acceleration"), tones=TONES + SLOW, duration_s=60.0))
    time_s = np.arange(motion.force_n.size) / RATE_HZ
    middle = (time_s > 10) & (time_s < 45)
    lost = motion.lost_m_per_s2[0][middle]
    slow = motion_of_tones(2, time_s, SLOW)[middle]
    displacement_error_m = motion.displacement_m[0][middle] - motion_of_tones(0, time_s)[middle]
    assert np.std(displacement_error_m) < 2e-2 * np.std(motion_of_tones(0, time_s, SLOW))
    assert np.std(lost - slow) < 2e-2 * np.std(slow)


def test_nothing_is_lost_where_the_displacement_was_measured():
    motion = kinematics(recorded(sensor("displacement"), sensor("acceleration"), tones=TONES + SLOW))
    assert errors(motion, TONES + SLOW)["displacement"] < 1e-9
    assert not motion.lost_m_per_s2.any()


@pytest.mark.parametrize("quantity", ORDERS)
def test_gain_and_delay_are_undone(quantity):
    plain = kinematics(recorded(sensor(quantity)))
    late = kinematics(recorded(sensor(quantity, gain=-1.7, delay_s=3.3e-3)))
    for plain_row, late_row in zip(rows(plain).values(), rows(late).values(), strict=True):
        assert np.std(plain_row - late_row) < 2e-3 * np.std(plain_row)


@pytest.mark.parametrize("order", [("displacement", "acceleration"), ("acceleration", "displacement")])
def test_each_motion_comes_from_the_sensor_that_needs_least(order):
    """Told apart by a gain that the description does not know of."""
    recording = recorded(*(sensor(quantity) for quantity in order))
    twice = {**recording.signals}
    twice["acceleration"] = replace(twice["acceleration"], values=2 * twice["acceleration"].values)
    motion = kinematics(Recording(recording.rig, twice, {}))
    time_s = np.arange(motion.force_n.size) / RATE_HZ
    for derivative, factor in ((0, 1.0), (1, 1.0), (2, 2.0)):
        row = list(rows(motion).values())[derivative]
        assert np.std(row - factor * motion_of_tones(derivative, time_s)) < 1e-3 * np.std(row)
    assert motion.channels == ("displacement", "acceleration")


def test_only_the_sensors_asked_for_are_used():
    recording = recorded(sensor("displacement"), sensor("acceleration"))
    assert kinematics(recording, "displacement").channels == ("displacement",)
    assert kinematics(recording, "acceleration").channels == ("acceleration",)
    with pytest.raises(RigError, match="the recording has no velocity sensors; it has acceleration, displacement"):
        kinematics(recording, "velocity")


def test_a_station_without_sensor_has_no_row():
    motion = kinematics(recorded(sensor("displacement")))
    assert motion.row(MASS) == 0
    assert motion.row(Station("mass", 0.1)) is None


def test_a_record_without_a_usable_half_is_refused():
    left_out_s = TAPER_S + 2 / CORNER_HZ
    kinematics(recorded(sensor("acceleration"), duration_s=2.1 * left_out_s))
    with pytest.raises(RigError, match=f"of which {left_out_s:.3g} s at its end cannot be used; record longer"):
        kinematics(recorded(sensor("acceleration"), duration_s=1.9 * left_out_s))
    kinematics(recorded(sensor("acceleration"), duration_s=1.9 * left_out_s), corner_hz=2 * CORNER_HZ)


def test_the_force_begins_where_it_begins():
    assert kinematics(recorded(sensor("displacement"), quiet_s=1.5)).excited_from == round(1.5 * RATE_HZ)


def test_forces_begin_with_the_first_that_acts():
    forces_n = np.random.default_rng(1).standard_normal((3, 3000))
    forces_n[0, :1500], forces_n[1, :1200], forces_n[2] = 0.0, 0.0, 0.0
    assert force_onset(forces_n, RATE_HZ) == 1200


@pytest.mark.parametrize(("quiet_s", "noise_n"), [(1.5, 0.0), (1.5, 2e-3), (1.5, 0.05), (0.2, 0.05), (0.0, 0.05)])
def test_noise_of_the_force_channel_is_no_force(quiet_s, noise_n):
    rng = np.random.default_rng(3)
    motion = kinematics(recorded(sensor("displacement"), quiet_s=quiet_s))
    noisy = replace(motion, forces_n=motion.forces_n * rng.standard_normal(motion.sample_count))
    noisy = replace(noisy, forces_n=noisy.forces_n + noise_n * rng.standard_normal(noisy.sample_count))
    assert round(quiet_s * RATE_HZ) <= noisy.excited_from <= round(quiet_s * RATE_HZ) + 8 * (quiet_s > 0)


@pytest.mark.parametrize("quiet_s", [1.0, 0.0])
def test_noise_is_heard_before_the_force_or_else_described(quiet_s):
    density = 2e-3
    noisy = sensor("acceleration", noise_density=density)
    recording = recorded(noisy, rng=np.random.default_rng(1), quiet_s=quiet_s)
    (noise,) = acceleration_noise_m_per_s2(kinematics(recording), recording.rig)
    quiet_samples = max(1.0, (quiet_s - 0.05) * RATE_HZ)
    tolerance = 4 / np.sqrt(2 * quiet_samples) if quiet_s else 1e-12
    assert noise == pytest.approx(density * np.sqrt(RATE_HZ / 2), rel=tolerance)


def test_strain_gauges_are_recorded_and_left_out(tmp_path):
    settings = BarrelCradle(sensors="displacement", duration_s=4.0)
    plain, how = settings.rig(), {"force": settings.force(), "duration_s": 4.0, "step_s": settings.step_s}
    gauge = Sensor(name="root", station=Station("cradle", 0.0), quantity="strain", noise_density=1e-9)
    gauged = msgspec.structs.replace(plain, sensors=(*plain.sensors, gauge))
    without_gauge, with_gauge = (rig.record(r, tmp_path / f"{len(r.sensors)}.mcap", **how) for r in (plain, gauged))
    assert with_gauge["root"].unit == "m/m"
    assert 1e-6 < np.std(with_gauge["root"]) < 1e-2
    np.testing.assert_array_equal(kinematics(without_gauge).displacement_m, kinematics(with_gauge).displacement_m)
