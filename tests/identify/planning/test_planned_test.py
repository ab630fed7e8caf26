"""The test that is planned: its defaults, its force, and what makes no test."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.planning.planned_test import QUIET_S, planned_test, random_forces_n, simulated_recording
from rig.errors import RigError
from rig.model.description import BaseMotion, Station
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.own import user_rig
from rig.simulation.reference import BarrelCradle, Sdof
from rig.simulation.replay import modal
from tests.identify.small_rigs import MASS_ON_TABLE


@pytest.mark.parametrize("rig", [Sdof().rig(), BarrelCradle().rig()])
def test_level_and_band_are_those_that_rig_record_chooses(rig):
    test, force = planned_test(rig), user_rig(rig, {}).force()
    assert test.band_hz == (force.low_hz, force.high_hz)
    assert test.force_rms_n == (force.rms_n,)
    assert (test.duration_s, test.tolerances) == (60.0, LABORATORY)


def test_the_force_has_its_level_band_and_quiet_start():
    rig = replace(Sdof().rig(), force_at=(Station("mass"), Station("mass")))
    test = planned_test(rig, duration_s=33.0, force_rms_n=2.0, band_hz=(2.0, 20.0))
    forces_n, quiet = random_forces_n(test, 1), round(QUIET_S * rig.sample_rate_hz)
    assert not forces_n[:, :quiet].any()
    np.testing.assert_allclose(np.sqrt(np.mean(forces_n[:, quiet:] ** 2, axis=1)), 2.0)
    assert abs(np.corrcoef(forces_n)[0, 1]) < 0.15  # of 2 x 18 Hz x 32 s independent numbers
    power = np.abs(np.fft.rfft(forces_n[0])) ** 2
    frequency_hz = np.fft.rfftfreq(forces_n.shape[1], 1 / rig.sample_rate_hz)
    in_band = (frequency_hz > 1.9) & (frequency_hz < 20.1)
    assert power[~in_band].sum() < 2e-3 * power.sum()
    below_middle = power[frequency_hz < 11.0].sum() / power.sum()
    assert below_middle == pytest.approx(0.5, abs=0.15)  # flat: 0.5 within four deviations of 288 lines
    assert np.any(random_forces_n(test, 2) != forces_n)


def test_a_recording_gives_duration_level_and_band():
    rig = Sdof(sensors="acceleration").rig()
    planned = planned_test(rig, duration_s=40.0, force_rms_n=3.0, band_hz=(4.0, 30.0))
    force_n = random_forces_n(planned, 5)
    groups = channel_groups(rig)
    signals = {name: Signals(groups[name], 0.0, force_n) for name in ("force", "acceleration")}
    test = planned_test(Recording(rig, signals, {}))
    assert test.duration_s == 40.0
    assert test.force_rms_n[0] == pytest.approx(3.0, rel=0.02)
    assert test.band_hz == pytest.approx((4.0, 30.0), rel=0.1)
    assert planned_test(Recording(rig, signals, {}), force_rms_n=1.0, tolerances=EXACT).force_rms_n == (1.0,)


def test_the_base_moves_the_open_contact_by_four_clearances():
    """eta'' + 2 zeta omega eta' + omega^2 eta = -a_base, under a flat spectrum, whatever the mass."""
    test = planned_test(MASS_ON_TABLE)
    low_hz, high_hz = test.band_hz
    lines, natural = 2 * np.pi * np.linspace(low_hz, high_hz, 100_001), 2 * np.pi * 12.0
    receptance = 1 / (natural**2 - lines**2 + 2j * 0.02 * natural * lines)
    rms_m = test.base_rms_m_per_s2 * np.sqrt(np.mean(np.abs(receptance) ** 2))
    assert rms_m == pytest.approx(4 * 1e-3, rel=0.3)  # the level has one significant digit
    assert test.force_rms_n == ()


def test_a_planned_base_shakes_with_its_level_in_its_band_after_a_quiet_start_and_gives_them_back():
    test = planned_test(MASS_ON_TABLE, 16.0, None, (4.0, 30.0), EXACT, 2.5)
    recording = simulated_recording(test, test.rig, modal, 3)
    assert not recording.forces_n.any()
    base = recording.values_of(MASS_ON_TABLE.base_sensors[0])
    quiet = round(QUIET_S * MASS_ON_TABLE.sample_rate_hz)
    assert base[:quiet].std() < 0.02
    assert base[quiet:].std() == pytest.approx(2.5, rel=0.05)
    again = planned_test(recording)
    assert (again.duration_s, again.force_rms_n) == (16.0, ())
    assert again.base_rms_m_per_s2 == pytest.approx(2.5, rel=0.05)
    assert again.band_hz == pytest.approx((4.0, 30.0), rel=0.1)


def test_base_motion_of_the_description_is_planned_unless_another_is_given():
    base_motion = BaseMotion(acceleration_rms_m_per_s2=0.7, low_hz=3.0, high_hz=20.0)
    test = planned_test(replace(MASS_ON_TABLE, base_motion=base_motion))
    assert (test.base_rms_m_per_s2, test.band_hz) == (0.7, (3.0, 20.0))
    with pytest.raises(RigError, match="shaken by its base alone; give its level with --base-rms"):
        planned_test(MASS_ON_TABLE, force_rms_n=1.0)
    with pytest.raises(RigError, match="shaken by a measured force; give its level with --force-rms"):
        planned_test(Sdof().rig(), base_rms_m_per_s2=1.0)
    with pytest.raises(RigError, match="above zero with --base-rms"):
        planned_test(MASS_ON_TABLE, base_rms_m_per_s2=0.0)
    with pytest.raises(RigError, match="give 0 < low"):
        planned_test(MASS_ON_TABLE, base_rms_m_per_s2=1.0, band_hz=(0.0, 20.0))


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"duration_s": 2.0}, "--duration"),
        ({"duration_s": float("nan")}, "--duration"),
        ({"force_rms_n": 0.0}, "--force-rms"),
        ({"force_rms_n": float("inf")}, "--force-rms"),
        ({"band_hz": (5.0, 5.0)}, "--band"),
        ({"band_hz": (0.0, 300.0)}, "a quarter of sample_rate_hz"),
        ({"band_hz": (5.0, 5.01)}, "no line"),
    ],
)
def test_what_makes_no_test_is_refused(values, word):
    with pytest.raises(RigError, match=word):
        planned_test(Sdof().rig(), **values)
