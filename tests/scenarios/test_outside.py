"""Effects outside the library: each does what its formula says, and changes what the rig's sensors see."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from rig.beam import Beam
from rig.description import Rig, Sensor, Station
from rig.errors import RigError
from rig.excitation import force_history
from rig.motion import Motion, joined
from rig.reference import BarrelCradle
from scenarios.outside import (
    OUTSIDE,
    LooseSensor,
    MainsForce,
    QuadraticDrag,
    SofteningSupport,
    ThermalDrift,
    ThirdContact,
    described,
    outside_drawn,
    outside_named,
    plant,
    strength_of,
)

ELEMENTS = 8
TIP = Station("beam", 1.0)
BEAM = Rig(
    name="one beam",
    bodies=(Beam(name="beam", ends="clamped-free", length_m=1.0, width_m=0.05, thickness_m=0.01, damping_ratio=0.01),),
    contacts=(),
    force_at=TIP,
    sensors=tuple(Sensor(name=q, station=TIP, quantity=q) for q in ("displacement", "velocity", "acceleration")),
    sample_rate_hz=1024.0,
)
BELIEVED = BarrelCradle(sensors="acceleration", noise_density=1e-3, stations=4)


def simulated(outside, rig, force_n, step_s):
    return joined(plant(outside, ELEMENTS)(rig, force_n, step_s, lambda _: None))


@pytest.mark.parametrize(
    "outside",
    [
        QuadraticDrag(body="beam", position_m=1.0, drag_n_s2_per_m2=5.0),
        MainsForce(body="beam", position_m=1.0, amplitude_n=30.0),
        ThirdContact(body="beam", position_m=1.0, stiffness_n_per_m=5e3, clearance_m=3e-3),
        SofteningSupport(body="beam", position_m=1.0, stiffness_n_per_m=2e3, yield_m=2e-3),
    ],
    ids=lambda o: o.name,
)
def test_a_grounded_force_is_the_force_of_its_formula(outside):
    """The beam moves as it does without the effect under the exciting force less the formula's."""
    step_s = 2.0**-13
    time_s = np.arange(6000) * step_s
    force_n = 30 * np.sin(2 * np.pi * 7 * time_s) * np.clip(time_s / 0.05, 0, 1)
    changed = simulated(outside, BEAM, force_n, step_s)
    w_m, rate_m_per_s, _ = changed.sensed
    law_n = outside.force_n(np, time_s, w_m, rate_m_per_s)
    plain = simulated(None, BEAM, force_n, step_s)
    done_m = np.abs(plain.sensed[0] - w_m).max()
    assert done_m > 0.01 * np.abs(w_m).max()
    forced = simulated(None, BEAM, force_n - law_n, step_s)
    np.testing.assert_allclose(forced.sensed[0], w_m, atol=0.02 * done_m)


def test_formulae():
    at = {"body": "beam", "position_m": 1.0}
    drag = QuadraticDrag(drag_n_s2_per_m2=3.0, **at)
    np.testing.assert_allclose(drag.force_n(np, 0.0, 0.0, np.array([-2.0, 0.5])), [-3 * 4, 3 * 0.25])
    stop = ThirdContact(stiffness_n_per_m=1e4, clearance_m=2e-3, **at)
    np.testing.assert_allclose(
        stop.force_n(np, 0.0, np.array([-3e-3, -1e-3, 1.9e-3, 5e-3]), 0.0), [-10, 0, 0, 30], atol=1e-9
    )
    support = SofteningSupport(stiffness_n_per_m=1e3, yield_m=1e-3, **at)
    np.testing.assert_allclose(support.force_n(np, 0.0, np.array([1e-6, -1.0]), 0.0), [1e-3, -1.0], rtol=1e-5)


def test_a_warming_beam_swings_slower():
    duration_s, step_s, fall = 4.0, 2.0**-11, 0.3
    time_s = np.arange(round(duration_s / step_s)) * step_s
    blow = np.where(time_s < 0.1, np.sin(np.pi * time_s / 0.1) ** 2, 0.0)
    rig = msgspec.structs.replace(BEAM, bodies=(msgspec.structs.replace(BEAM.bodies[0], damping_ratio=1e-3),))
    tip = simulated(ThermalDrift(fall=fall, beam="beam", duration_s=duration_s), rig, blow, step_s).sensed[0]
    up = np.flatnonzero((tip[:-1] < 0) & (tip[1:] >= 0))
    crossings_s = (up + tip[up] / (tip[up] - tip[up + 1])) * step_s
    middle_s = (crossings_s[4:] + crossings_s[:-4]) / 2
    found_hz = 4 / (crossings_s[4:] - crossings_s[:-4])
    expected_hz = rig.bodies[0].frequencies_hz(1)[0] * np.sqrt(1 - fall * middle_s / duration_s)
    np.testing.assert_allclose(found_hz[middle_s > 0.5], expected_hz[middle_s > 0.5], rtol=5e-3)
    assert expected_hz[-1] < 0.9 * expected_hz[0]


@pytest.mark.parametrize("played_hz", [20.0, 80.0, 160.0])
def test_a_loose_sensor_resonates_across_blocks(played_hz):
    loose = LooseSensor(frequency_hz=100.0, damping_ratio=0.05, sensor="velocity")
    step_s = 2.0**-13
    time_s = np.arange(2 * 8192) * step_s
    tone = np.sin(2 * np.pi * played_hz * time_s)
    nothing = np.zeros((0, time_s.size))
    whole = Motion(0.0, step_s, tone, np.stack([tone] * 3), nothing, nothing, nothing)
    blocks = [
        Motion(time_s[k], step_s, tone[k : k + 999], whole.sensed[:, k : k + 999], *[nothing[:, k : k + 999]] * 3)
        for k in range(0, time_s.size, 999)
    ]
    seen = joined(loose.seen(BEAM, iter(blocks))).sensed
    np.testing.assert_allclose(seen, joined(loose.seen(BEAM, iter([whole]))).sensed, atol=1e-9)
    np.testing.assert_array_equal(seen[[0, 2]], whole.sensed[[0, 2]])
    ratio, turned = played_hz / 100.0, 2j * 0.05 * played_hz / 100.0
    expected = abs((1 + turned) / (1 - ratio**2 + turned))
    assert np.sqrt(2) * seen[1, 8192:].std() == pytest.approx(expected, rel=5e-3)


@pytest.fixture(scope="module")
def plain():
    step_s = 2.0**-13
    force_n = force_history(BELIEVED.force(), 1.35, step_s)
    return SimpleNamespace(force_n=force_n, step_s=step_s, motion=simulated(None, BELIEVED.rig(), force_n, step_s))


@pytest.mark.parametrize("name", OUTSIDE)
def test_the_weakest_shows_above_the_noise(name, plain):
    rig = BELIEVED.rig()
    drawn = outside_drawn(name, rig, 2.0, np.random.default_rng(3))
    weakest = msgspec.structs.replace(drawn, **{drawn.magnitude: drawn.weak})
    assert 0 <= strength_of(drawn) <= 1
    assert strength_of(weakest) == 0
    seen = simulated(weakest, rig, plain.force_n, plain.step_s).sensed
    noise = BELIEVED.noise_density * np.sqrt(BELIEVED.sample_rate_hz / 2)
    assert np.std(seen - plain.motion.sensed, axis=1).max() > 10 * noise


def test_a_mains_force_is_heard_in_the_quiet_second(plain):
    outside = MainsForce(body="barrel", position_m=0.8, amplitude_n=0.1)
    quiet = simulated(outside, BELIEVED.rig(), plain.force_n, plain.step_s).sensed[-1, : round(1 / plain.step_s)]
    spectrum = np.abs(np.fft.rfft(quiet * np.hanning(quiet.size)))
    assert abs(np.argmax(spectrum) - 50) <= 3  # lines of 1 Hz; the barrel's own 53 Hz rings beside
    assert not plain.motion.sensed[-1, : round(1 / plain.step_s)].any()


@pytest.mark.parametrize("name", OUTSIDE)
def test_texts_round_trip(name):
    outside = outside_drawn(name, BELIEVED.rig(), 30.0, np.random.default_rng(1))
    assert outside_named(described(outside, name)) == outside


def test_an_unknown_name_is_refused():
    with pytest.raises(RigError, match="no effect outside the library is called 'gremlin'"):
        outside_named("gremlin:size=1")
