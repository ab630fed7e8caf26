"""States from accelerometers against those of the simulation."""

import numpy as np
import pytest

from identify.gaps.rollout.states import measured_motion
from identify.signals.kinematics import kinematics
from rig.model.description import rig_stations
from rig.model.modes import modes_of
from rig.simulation import prediction
from rig.simulation.motion import concatenated
from rig.simulation.plants.modal import simulate
from rig.simulation.replay import forces_at_steps, step_s_of
from tests.identify.gaps.rollout.conftest import BELIEVED, Case, recorded


@pytest.fixture(scope="module")
def exact():
    """A recording of the very rig that is believed, with its true displacements: at the sensors, and of its modes."""
    case = Case(recorded(BELIEVED, 4))
    step_s = step_s_of(BELIEVED, 2.0**15)
    factor = round(1 / (step_s * BELIEVED.sample_rate_hz))
    samples = round(9.0 * BELIEVED.sample_rate_hz)
    fine = forces_at_steps(case.recording.forces_n[:, :samples], BELIEVED.sample_rate_hz, step_s, samples * factor)
    blocks = list(simulate(BELIEVED, fine, step_s, lambda _: None, modes_per_beam=24))
    coordinates_m = np.concatenate([b.displacement_m.modal_coordinates for b in blocks])[::factor].T
    rows = [rig_stations(BELIEVED).index(s.station) for s in BELIEVED.sensors]
    return case, concatenated(iter(blocks)).displacement_m[rows, ::factor], coordinates_m


def modal(displacements_m):
    """The first three elastic modes of both beams."""
    coordinates_m = []
    for body, first in zip(BELIEVED.bodies, (0, 2), strict=True):
        rows = [i for i, s in enumerate(BELIEVED.sensors) if s.station.body == body.name]
        places = np.array([BELIEVED.sensors[i].station.position_m for i in rows])
        shapes = modes_of(BELIEVED, body).shapes(places, len(rows))
        coordinates_m.append((np.linalg.inv(shapes) @ displacements_m[rows])[first : first + 3])
    return np.concatenate(coordinates_m)


def test_displacements_of_bending_modes_are_exact_where_integration_is_not(exact):
    case, true_m, coordinates_m = exact
    motion = measured_motion(case.recording, BELIEVED, case.fitted())
    now = slice(motion.first_sample, true_m.shape[1] - 100)
    true = coordinates_m[[0, 1, 2, 26, 27, 28]][:, now]  # 24 modes a beam; two of the barrel's are rigid
    estimated, integrated = (
        modal(rows)[:, now] for rows in (motion.modal_states[0], kinematics(case.recording).displacement_m)
    )
    size = true.std(axis=1)
    assert np.all((estimated - true).std(axis=1)[1:] < 0.05 * size[1:])  # beyond the cradle's first, slow mode
    assert np.max((integrated - true).std(axis=1) / size) > 0.2


def test_rates_and_relative_displacements_are_the_true_ones(exact):
    case, true_m, _ = exact
    motion = measured_motion(case.recording, BELIEVED, case.fitted())
    now = slice(motion.first_sample, true_m.shape[1] - 100)
    true = np.gradient(true_m, 1 / BELIEVED.sample_rate_hz, axis=1)[:, now]
    assert np.all((motion.modal_states[1][:, now] - true).std(axis=1) < 0.02 * true.std(axis=1))
    stations = [s.station for s in BELIEVED.sensors]
    for contact in BELIEVED.contacts:
        ends = stations.index(contact.at), stations.index(contact.against)
        missed = motion.modal_states[0] - np.pad(true_m, ((0, 0), (0, motion.modal_states.shape[2] - true_m.shape[1])))
        assert np.std((missed[ends[0]] - missed[ends[1]])[now]) < 6e-5  # of a clearance of 5 mm


def test_a_wrong_gain_makes_no_wrong_displacement_of_high_modes(exact):
    case, true_m, coordinates_m = exact
    residual = case.fitted()
    group = case.recording.signals["acceleration"]
    scaled = group.values * (1 + 3e-3 * np.random.default_rng(1).standard_normal((len(group.values), 1)))
    signals = {**case.recording.signals, "acceleration": type(group)(group.channels, group.start_s, scaled)}
    changed = type(case.recording)(case.recording.rig, signals, case.recording.provenance)
    motion, now = measured_motion(changed, BELIEVED, residual), slice(8000, true_m.shape[1] - 100)
    true, estimated = coordinates_m[[0, 1, 2, 26, 27, 28]][:, now], modal(motion.modal_states[0])[:, now]
    assert np.all((estimated - true).std(axis=1)[1:] < 0.1 * true.std(axis=1)[1:])


def test_the_predictor_takes_the_states(exact):
    case, *_ = exact
    motion = measured_motion(case.recording, BELIEVED, case.fitted())
    first = np.array([motion.first_sample, motion.stop_sample - 100])
    states = motion.modal_states[:, :, first].transpose(2, 0, 1)
    moved = prediction.modal(motion.rig, motion.forces_n, first, 50, motion.stations, states)
    np.testing.assert_allclose(moved[:, :, :, 0], states, rtol=1e-9, atol=1e-12)
