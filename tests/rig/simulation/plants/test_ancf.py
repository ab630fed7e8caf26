"""Motion of beams of finite elements against theory, and the solver in segments."""

import numpy as np
import pytest
from scipy.signal import find_peaks

from rig.errors import RigError
from rig.simulation.motion import concatenated
from rig.simulation.plants import ancf
from rig.simulation.reference import BarrelCradle
from tests.rig.simulation.plants.test_finite_elements import one_beam


def simulated(rig, force_n, step_s):
    return concatenated(ancf.simulate(rig, force_n, step_s, lambda _: None))


@pytest.mark.parametrize("damping_ratio", [0.005, 0.02])
def test_the_first_mode_decays_at_the_set_damping(damping_ratio):
    rig = one_beam("clamped-free", damping_ratio)
    step_s = 2.0**-11
    time_s = np.arange(round(3 / step_s)) * step_s
    blow = np.where(time_s < 0.125, np.sin(np.pi * time_s / 0.125) ** 2, 0.0)
    tip = simulated(rig, blow, step_s).sensed[0]
    late = slice(round(1 / step_s), None)  # the higher modes have gone
    peaks, _ = find_peaks(np.abs(tip[late]))
    decrement = -np.polyfit(time_s[late][peaks], np.log(np.abs(tip[late][peaks])), 1)[0]
    omega = 2 * np.pi * rig.bodies[0].frequencies_hz(1)[0]
    print(f"free decay at {damping_ratio}: damping off by {100 * (decrement / omega / damping_ratio - 1):.2g} %")
    assert decrement / omega == pytest.approx(damping_ratio, rel=0.02)


def test_a_free_beam_keeps_its_momentum():
    rig = one_beam("free-free")
    step_s = 2.0**-11
    force_n = np.zeros(2000)
    force_n[1:40] = 1.0
    motion = simulated(rig, force_n, step_s)
    beam = rig.bodies[0]
    # pushed at its end a free body leaves with F t / m at the centre and turns with 3 times that more at the end
    rate = np.polyfit(np.arange(1000) * step_s, motion.sensed[0, 1000:], 1)[0]
    assert rate == pytest.approx(4 * np.sum(force_n) * step_s / beam.mass_kg, rel=5e-3)


def test_segments_hardly_show(monkeypatch):
    rig = BarrelCradle(stations=4, clearance_1_m=1.0, clearance_2_m=1.0).rig()  # no contact: it would amplify rounding
    step_s = 2.0**-12
    force_n = 40 * np.sin(2 * np.pi * 10 * np.arange(700) * step_s)
    single_run = simulated(rig, force_n, step_s)
    monkeypatch.setattr(ancf, "STEPS_PER_BLOCK", 128)
    blocks = list(ancf.simulate(rig, force_n, step_s, lambda _: None))
    assert [round(b.start_s / step_s) for b in blocks] == [0, 129, 257, 385, 513, 641]
    pieces = concatenated(iter(blocks))
    np.testing.assert_array_equal(pieces.force_n, force_n)
    for name, tolerance in (("displacement_m", 1e-6), ("sensed", 1e-3)):  # displacements and accelerations
        expected, joined_pieces = getattr(single_run, name), getattr(pieces, name)
        np.testing.assert_allclose(expected, joined_pieces, atol=tolerance * np.abs(expected).max())


def test_a_step_that_the_solver_cannot_take_is_one_clear_sentence(capfd):
    rng = np.random.default_rng(1)
    with pytest.raises(RigError) as caught:
        simulated(BarrelCradle().rig(), 14 * rng.standard_normal(600), 2.0**-5)
    assert "the ancf plant failed between 0.000 and 18.719 s at step 0.03125 s" in str(caught.value)
    assert "use a smaller step or a softer contact" in str(caught.value)
    assert "\n" not in str(caught.value)
    output = capfd.readouterr()
    assert output.out + output.err == ""  # nothing from the solver on the screen
