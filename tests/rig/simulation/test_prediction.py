"""Prediction from states: closed forms of linear motion, energy, and the motion that a simulation goes on with."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import BaseMotion, Station
from rig.model.modes import modes_of
from rig.simulation.excitation import force_history
from rig.simulation.motion import concatenated
from rig.simulation.plants.modal import simulate
from rig.simulation.prediction import modal
from rig.simulation.reference import BarrelCradle, Sdof


def still(rig, samples):
    return np.zeros((len(rig.forces), samples))


def test_a_beam_without_contact_rings_in_the_mode_it_starts_in():
    rig = replace(BarrelCradle(sensors="acceleration", stations=4).rig(), contacts=())
    body, stations = rig.body("cradle"), tuple(s.station for s in rig.sensors)
    places = np.array([s.position_m for s in stations if s.body == "cradle"])
    mode, samples = 2, 800
    shape = modes_of(rig, body).shapes(places, 4)[:, mode]
    omega, zeta = 2 * np.pi * body.frequencies_hz(4)[mode], body.damping_ratios(4)[mode]
    states = np.zeros((1, 2, len(stations)))
    states[0, 0, : shape.size], states[0, 1, : shape.size] = 2e-3 * shape, 0.3 * shape
    predicted = modal(rig, still(rig, 3000), np.array([1000]), samples, stations, states)
    pole = -zeta * omega + 1j * omega * np.sqrt(1 - zeta**2)
    start = 2e-3 - 1j * (0.3 - 2e-3 * pole.real) / pole.imag
    course = start * np.exp(pole * np.arange(samples) / rig.sample_rate_hz)
    np.testing.assert_allclose(predicted[0, 0, : shape.size], np.outer(shape, course.real), atol=1e-9)
    np.testing.assert_allclose(predicted[0, 1, : shape.size], np.outer(shape, (pole * course).real), atol=1e-6)
    assert not np.any(predicted[0, :, shape.size :])


def test_a_floating_body_goes_on_as_it_moves_and_turns():
    rig = replace(BarrelCradle(sensors="acceleration").rig(), contacts=())
    stations = tuple(s.station for s in rig.sensors)
    on = np.array([s.body == "barrel" for s in stations])
    place_m = np.array([s.position_m for s in stations])
    states = np.zeros((1, 2, len(stations)))
    states[0, 1, on] = 0.1 + 0.2 * place_m[on]
    predicted = modal(rig, still(rig, 500), np.array([20]), 400, stations, states)
    time_s = np.arange(400) / rig.sample_rate_hz
    np.testing.assert_allclose(predicted[0, 0, on], np.outer(states[0, 1, on], time_s), atol=1e-10)


def test_a_mass_between_lossless_stops_keeps_its_energy():
    settings = Sdof(damping_ratio=1e-9, stiffness_n_per_m=2e4)
    rig = settings.rig()
    (mass,), law = rig.bodies, rig.contacts[0].law
    states = np.array([[[0.3e-3], [0.2]], [[-0.9e-3], [-0.1]], [[1.4e-3], [0.0]]])
    first = np.array([0, 700, 1000])
    predicted = modal(rig, still(rig, 4000), first, 2000, (Station("mass"),), states)
    depth_m = np.maximum(np.abs(predicted[:, 0, 0]) - settings.clearance_m, 0.0)
    energy_j = (
        mass.mass_kg * predicted[:, 1, 0] ** 2 / 2
        + mass.stiffness_n_per_m * predicted[:, 0, 0] ** 2 / 2
        + law.stiffness_n_per_m * depth_m**2 / 2
    )
    assert np.max(np.abs(predicted[:, 0, 0])) > 1.5 * settings.clearance_m
    np.testing.assert_allclose(energy_j, np.repeat(energy_j[:, :1], 2000, axis=1), rtol=1e-5)


def test_a_prediction_goes_on_as_the_simulation_does_whose_states_it_was_given():
    """A mass, whose state is known, with force and contacts."""
    settings = Sdof(contact_damping_n_s_per_m=5.0, rms_n=2.0)
    rig, step_s = settings.rig(), 2.0**-15
    factor, samples = round(1 / (step_s * rig.sample_rate_hz)), 2048
    force_n = force_history(settings.force(), 5.0, 1 / rig.sample_rate_hz)
    fine = np.repeat(force_n, factor)  # any force at all: the same is predicted with, below
    fine = np.interp(np.arange(fine.size) / factor, np.arange(force_n.size), force_n)
    run = concatenated(simulate(rig, fine, step_s, lambda _: None))
    truth_m = run.displacement_m[0, ::factor]
    velocity = np.gradient(run.displacement_m[0], step_s)[::factor]
    first = np.array([100, 300, 411])
    states = np.stack([truth_m[first], velocity[first]], axis=1)[:, :, None]
    predicted = modal(rig, force_n[None], first, 128, (Station("mass"),), states)
    assert np.count_nonzero(np.abs(truth_m) > settings.clearance_m) > samples / 20
    for window, start in zip(predicted, first, strict=True):
        np.testing.assert_allclose(window[0, 0], truth_m[start : start + 128], atol=2e-3 * truth_m.std())


def test_a_base_motion_is_left_out_and_a_stiff_contact_refused():
    rig = Sdof().rig()
    stations, states = (Station("mass"),), np.array([[[0.0], [0.1]]])
    on_moving_base = replace(rig, base_motion=BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=2.0, high_hz=9.0))
    runs = [modal(machine, still(rig, 900), np.array([10]), 500, stations, states) for machine in (rig, on_moving_base)]
    np.testing.assert_array_equal(*runs)
    stiff = replace(rig, contacts=(replace(rig.contacts[0], law=symmetric_dead_zone(1e-3, 1e10, 0.0)),))
    with pytest.raises(RigError, match="too stiff"):
        modal(stiff, still(rig, 900), np.array([10]), 500, stations, states)
