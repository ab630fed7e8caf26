"""Rigs drawn within their tolerances."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.channel_errors import ChannelErrors, with_crosstalk, with_lateral_motion
from identify.gaps.decision.null_simulations import draw_rig, simulated_machines
from rig.effects import effect_named
from rig.model.description import Sensor, Station
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.reference import BarrelCradle, Sdof
from rig.simulation.replay import modal

RIG = BarrelCradle(sensors="acceleration").rig()
ODD_M = 1.0272139258614885
"""No number of nine digits."""


def barrel_of_odd_length():
    bodies = tuple(replace(b, length_m=ODD_M) if b.name == "barrel" else b for b in RIG.bodies)
    sensors = tuple(
        replace(s, station=replace_station(s.station)) if s.station.body == "barrel" else s for s in RIG.sensors
    )
    return replace(RIG, bodies=bodies, sensors=sensors)


def replace_station(station):
    return type(station)(station.body, ODD_M) if station.position_m == 1.0 else station


@pytest.mark.parametrize("rig", [RIG, barrel_of_odd_length(), Sdof().rig()])
def test_exact_tolerances_draw_the_rig_itself(rig):
    actual = draw_rig(rig, EXACT, np.random.default_rng(1).standard_normal(600))
    assert actual.sensors == rig.sensors
    assert actual.contacts == rig.contacts
    for body, nominal_body in zip(actual.bodies, rig.bodies, strict=True):
        count = min(8, body.max_modes)
        np.testing.assert_allclose(body.frequencies_hz(count), nominal_body.frequencies_hz(count), rtol=1e-12)
        places = np.array([s.station.position_m for s in rig.sensors if s.station.body == body.name])
        np.testing.assert_allclose(
            body.shapes(places, count), nominal_body.shapes(places, count), rtol=1e-9, atol=1e-12
        )


def test_draws_scatter_as_the_tolerances_say():
    rng = np.random.default_rng(2)
    rigs = [draw_rig(RIG, LABORATORY, rng.standard_normal(600)) for _ in range(200)]
    gains = np.array([[s.gain for s in r.sensors] for r in rigs])
    assert gains.std() == pytest.approx(LABORATORY.gain, rel=0.1)
    corners_hz = np.array([[s.high_pass_hz for s in r.sensors] for r in rigs])
    assert np.sqrt(np.mean(corners_hz**2)) == pytest.approx(LABORATORY.high_pass_hz, rel=0.1)
    first = np.array([r.bodies[0].frequencies_hz(3) / RIG.bodies[0].frequencies_hz(3) for r in rigs])
    assert first.std() == pytest.approx(np.sqrt(2) * LABORATORY.frequency, rel=0.15)  # its own, and all together
    ratios = np.log([r.bodies[0].damping_ratios(3) / RIG.bodies[0].damping_ratios(3) for r in rigs])
    assert ratios.std() == pytest.approx(np.sqrt(2) * LABORATORY.damping, rel=0.15)


def test_channels_show_shares_of_those_beside_them():
    values = np.eye(len(RIG.sensors))
    groups = channel_groups(RIG)["acceleration"]
    recording = Recording(RIG, {"acceleration": Signals(groups, 0.0, values)}, {})
    drawings = [with_crosstalk(recording, 2e-3, np.random.default_rng(seed)) for seed in range(100)]
    mixing = np.array([drawing.signals["acceleration"].values for drawing in drawings])
    adjacent = np.abs(np.subtract.outer(np.arange(len(values)), np.arange(len(values)))) == 1
    np.testing.assert_array_equal(mixing[:, ~adjacent], np.broadcast_to(values[~adjacent], mixing[:, ~adjacent].shape))
    assert mixing[:, adjacent].std() == pytest.approx(2e-3, rel=0.1)
    assert with_crosstalk(recording, 0.0, np.random.default_rng(1)) == recording


def test_accelerometers_show_motion_across_their_axes():
    """It lasts as long as the measured motion, has its spectrum, is one motion a body, and starts with the force."""
    samples, silent = 16384, 4096
    rng, seconds = np.random.default_rng(4), np.arange(samples) / BarrelCradle().sample_rate_hz
    values = np.exp(-seconds / 2) * rng.standard_normal((len(RIG.sensors), samples))
    values[:, :silent] = 0.0
    recording = Recording(RIG, {"acceleration": Signals(channel_groups(RIG)["acceleration"], 0.0, values)}, {})
    drawings = [with_lateral_motion(recording, 3e-3, silent, np.random.default_rng(seed)) for seed in range(60)]
    lateral = np.array([drawing.signals["acceleration"].values for drawing in drawings]) - values
    assert not np.any(lateral[..., :silent])
    for part in (slice(silent, silent + 4096), slice(-4096, None)):
        assert lateral[..., part].std() == pytest.approx(3e-3 * np.sqrt(np.mean(values[:, part] ** 2)), rel=0.3)
    similar = (
        np.einsum("dst,st->ds", lateral, values) / np.linalg.norm(lateral, axis=2) / np.linalg.norm(values, axis=1)
    )
    assert np.sqrt(np.mean(similar**2)) < 0.05
    assert with_lateral_motion(recording, 0.0, silent, np.random.default_rng(1)) == recording


def test_machines_that_confirm_a_veto_are_built_within_the_tolerances():
    """Those without are predicted better than any that is built, so that they vetoed what is right."""
    machines = []
    rows = {"force": 1, "acceleration": len(RIG.sensors)}
    signals = {q: Signals(channel_groups(RIG)[q], 0.0, np.zeros((rows[q], 4096))) for q in rows}
    recording = Recording(RIG, signals, {})

    def simulate(_rig, machine, _forces_n, _seed):
        machines.append(machine)
        return recording

    assert len(list(simulated_machines(recording, RIG, ChannelErrors(np.zeros(1), 0, LABORATORY), simulate, 3))) == 3
    gains = np.array([[sensor.gain for sensor in machine.sensors] for machine in machines])
    assert np.std(gains - 1) == pytest.approx(LABORATORY.gain, rel=0.4)
    assert np.all(np.std(gains, axis=0) > 0)


def test_strain_gauges_keep_their_fibre():
    """The bodies that are drawn are given by their modes, which do not say how thick they are."""
    gauge = Sensor(name="root", station=Station("cradle", 0.0), quantity="strain")
    actual = draw_rig(
        replace(RIG, sensors=(*RIG.sensors, gauge)), LABORATORY, np.random.default_rng(3).standard_normal(600)
    )
    assert actual.sensors[-1].fibre_m == RIG.body("cradle").half_thickness_m


def test_drawn_beams_follow_a_base_that_an_effect_shakes():
    shaken = effect_named("base_motion:acceleration_rms_m_per_s2=1.0,low_hz=5.0,high_hz=40.0").applied_to(RIG)
    drawn = draw_rig(RIG, EXACT, np.random.default_rng(1).standard_normal(600))
    at_rest = np.zeros(2048)
    signals = [modal(RIG, replace(shaken, bodies=bodies), at_rest, 1) for bodies in (RIG.bodies, drawn.bodies)]
    rows = [recording.signals["acceleration"].values for recording in signals]
    np.testing.assert_allclose(rows[1], rows[0], atol=0.01 * np.abs(rows[0]).max())
    assert np.abs(rows[0]).max() > 0.5
