"""The modal transformation and what the modes beyond the fitted ones do to it."""

import msgspec
import numpy as np
import pytest

from identify.linear.modal import (
    NEARLY_INVISIBLE_SHARE,
    contact_shapes,
    correctable_sample_count,
    equivalent_force_n,
    modal_equations,
    signals_across_contacts,
    transformation,
)
from identify.signals.kinematics import Kinematics, kinematics
from rig.errors import RigError
from rig.model.beam import MAX_MODES
from rig.model.description import Sensor, Station
from rig.recording import read, read_truth, truth_path
from rig.simulation.reference import BarrelCradle, Sdof

RATE_HZ = 4096.0
SAMPLES = 2048
TIME_S = np.arange(SAMPLES) / RATE_HZ


def rig_of(**settings):
    return BarrelCradle(sensors="displacement", **settings).rig()


def motion_at_sensors(rig, responses, force_n=None):
    """What the stations do: `responses` gives a body's modal displacements, velocities and accelerations."""
    stations = tuple(s.station for s in rig.sensors)
    coordinates = {body.name: responses(body) for body in rig.bodies}

    def motion(station, order):
        modal = coordinates[station.body][order]
        return rig.body(station.body).shapes(np.array([station.position_m]), len(modal))[0] @ modal

    rows = [np.stack([motion(station, order) for station in stations]) for order in range(3)]
    return Kinematics(
        stations=stations,
        channels=tuple(s.name for s in rig.sensors),
        sensors=rig.sensors,
        displacement_sensors=rig.sensors,
        sample_rate_hz=rig.sample_rate_hz,
        trusted_hz=(0.0, 1638.4),
        zero_known=True,
        forces_n=np.zeros((1, SAMPLES)) if force_n is None else force_n[None],
        displacement_m=rows[0],
        velocity_m_per_s=rows[1],
        acceleration_m_per_s2=rows[2],
        lost_m_per_s2=np.zeros_like(rows[0]),
        excited_from=0,
    )


def tones(modes, seed):
    """A tone for every mode, with its derivatives."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * rng.uniform(3, 200, modes)[:, None]
    phase = omega * TIME_S + rng.uniform(0, 6, modes)[:, None]
    return np.stack([np.sin(phase), omega * np.cos(phase), -(omega**2) * np.sin(phase)])


@pytest.mark.parametrize("stations", [4, 6, 8, 10])
def test_the_motion_of_the_fitted_modes_is_recovered(stations):
    rig = rig_of(stations=stations)
    true = {body.name: tones(stations, seed) for seed, body in enumerate(rig.bodies)}
    motion = motion_at_sensors(rig, lambda body: true[body.name])
    for body in rig.bodies:
        equations = modal_equations(rig, motion, body, mode_count=stations)
        assert [e.name for e in equations] == [f"{body.name} {i + 1}" for i in range(stations)]
        for order, row in enumerate(("displacement", "velocity", "acceleration")):
            recovered = np.stack([getattr(e, row) for e in equations])
            size = np.abs(true[body.name][order]).max()
            np.testing.assert_allclose(recovered, true[body.name][order], atol=1e-10 * size)


def test_a_modal_equation_carries_its_mode():
    rig = rig_of()
    motion = motion_at_sensors(rig, lambda _: tones(6, 1))
    for body in rig.bodies:
        equations = modal_equations(rig, motion, body)
        np.testing.assert_allclose([e.frequency_hz for e in equations], body.frequencies_hz(4))
        np.testing.assert_allclose([e.damping_ratio for e in equations], body.damping_ratios(4))
    cradle, barrel = (modal_equations(rig, motion, body)[0] for body in rig.bodies)
    assert cradle.shape_at_force == 0
    assert barrel.shape_at_force == pytest.approx(1 / np.sqrt(rig.body("barrel").mass_kg))  # rigid translation
    np.testing.assert_allclose(barrel.shape_at_contacts, barrel.shape_at_force)
    assert (cradle.shape_at_contacts < 0).all()  # eta is barrel less cradle, and a first mode has one sign


def test_forces_push_a_mode_as_much_as_the_one_that_does_the_same_work():
    """The barrel's rigid modes: phi is constant, and proportional to the distance from its middle."""
    rig = rig_of()
    at_end, third = rig.force_at, Station("barrel", 0.25)
    forces_n = np.random.default_rng(4).standard_normal((2, SAMPLES))
    two_forces_rig = msgspec.structs.replace(rig, force_at=(third, at_end))
    motion = motion_at_sensors(rig, lambda _: tones(6, 1))
    translation, rotation = modal_equations(two_forces_rig, motion, rig.body("barrel"))[:2]
    single_force_rotation = modal_equations(rig, motion, rig.body("barrel"))[1]
    assert rotation.shape_at_force == single_force_rotation.shape_at_force
    np.testing.assert_allclose(equivalent_force_n(two_forces_rig, translation, forces_n), forces_n.sum(axis=0))
    np.testing.assert_allclose(equivalent_force_n(two_forces_rig, rotation, forces_n), forces_n[1] - 0.5 * forces_n[0])


def test_a_contact_near_a_node_is_seen_little_and_on_it_not_at_all():
    """The barrel's rotation is zero in its middle and greatest at its ends: a contact at x shows |2 x / l - 1|."""
    for overlap_start_m in (0.45, 0.4999, 0.5):
        rig = rig_of(overlap_start_m=overlap_start_m)
        motion = motion_at_sensors(rig, lambda _: tones(6, 1))
        rotation = modal_equations(rig, motion, rig.body("barrel"))[1]
        expected = (1.0, abs(2 * (1 - overlap_start_m) - 1))
        assert rotation.visibility == pytest.approx(expected, abs=1e-12)
        assert rotation.is_visible == (True, expected[1] > 1e-3)
        assert (rotation.visibility[1] < NEARLY_INVISIBLE_SHARE) == (expected[1] < 0.15)


def test_a_body_without_stations_is_refused():
    full = rig_of(stations=4)
    rig = msgspec.structs.replace(full, sensors=tuple(s for s in full.sensors if s.station.body != "cradle"))
    motion = motion_at_sensors(rig, lambda _: tones(4, 1))
    with pytest.raises(RigError, match="body 'cradle' has no measured station; put a sensor on it"):
        transformation(rig, rig.body("cradle"), motion)


def test_stations_that_coincide_are_refused():
    full = rig_of(stations=4)
    coincident = Station("cradle", full.sensors[0].station.position_m + 1e-5)
    moved_sensor = msgspec.structs.replace(full.sensors[1], station=coincident)
    rig = msgspec.structs.replace(full, sensors=(full.sensors[0], moved_sensor, *full.sensors[2:]))
    motion = motion_at_sensors(rig, lambda _: tones(4, 1))
    with pytest.raises(RigError, match="the stations of 'cradle' do not tell 4 modes apart"):
        transformation(rig, rig.body("cradle"), motion)
    assert transformation(rig, rig.body("barrel"), motion).condition_number < 10


@pytest.mark.parametrize("body", ["cradle", "barrel"])
def test_fewer_stations_lose_more_to_the_higher_modes(body):
    lost = {}
    for stations in (4, 8):
        rig = rig_of(stations=stations)
        motion = motion_at_sensors(rig, lambda _, n=stations: tones(n, 1))
        lost[stations] = transformation(rig, rig.body(body), motion).truncation_shares
        assert lost[stations].shape == (stations,)
        assert (lost[stations] > 0).all()
    assert (lost[8][2:4] < lost[4][2:] / 2).all()  # the first modes hardly lose anything


def test_one_mass_has_one_coordinate_and_loses_nothing():
    rig = Sdof(mass_kg=4.0, sensors="displacement").rig()
    rows = np.stack([np.sin(TIME_S), np.cos(TIME_S), -np.sin(TIME_S)])[:, None]
    motion = motion_at_sensors(rig, lambda _: 2.0 * rows)  # q = sqrt(m) x
    (equation,) = modal_equations(rig, motion, rig.bodies[0])
    np.testing.assert_allclose(motion.displacement_m, rows[0])
    np.testing.assert_allclose(equation.acceleration, 2 * rows[2][0])
    assert equation.shape_at_force == pytest.approx(0.5)
    np.testing.assert_array_equal(transformation(rig, rig.bodies[0], motion).truncation_shares, [0.0])


def forced(rig, body, modes, force_n, contact_n):
    """The periodic response of a body's modes to periodic forces, mode by mode from its receptance."""
    omega = 2 * np.pi * np.fft.rfftfreq(SAMPLES, 1 / RATE_HZ)
    natural, zeta = 2 * np.pi * body.frequencies_hz(modes), body.damping_ratios(modes)
    at_force = body.shapes(np.array([rig.force_at.position_m]), modes)[0] * (rig.force_at.body == body.name)
    at_contacts = np.stack([contact_shapes(rig, body, j, modes) for j in range(len(contact_n))])
    modal_force = np.fft.rfft(np.outer(at_force, force_n) - at_contacts.T @ contact_n)
    below = natural[:, None] ** 2 - omega**2 + 2j * (zeta * natural)[:, None] * omega
    response = np.where(below == 0, 0, modal_force / np.where(below == 0, 1, below))
    return np.stack([np.fft.irfft(response * (1j * omega) ** order, SAMPLES) for order in range(3)])


@pytest.mark.parametrize("stations", [4, 6])
def test_the_higher_modes_are_taken_off(stations):
    rig = rig_of(stations=stations)
    phases = 2 * np.pi * np.outer(np.arange(2, 150), np.arange(SAMPLES)) / SAMPLES
    shifts = np.random.default_rng(1).uniform(0, 2 * np.pi, (3, len(phases), 1))
    force_n, *contact_n = np.cos(phases + shifts).sum(axis=1)  # periodic, up to 300 Hz
    contact_n = np.stack(contact_n)
    motion = motion_at_sensors(rig, lambda body: forced(rig, body, MAX_MODES, force_n, contact_n), force_n)
    samples = correctable_sample_count(motion)
    assert samples == SAMPLES - RATE_HZ / 4
    for body in rig.bodies:
        true = forced(rig, body, stations, force_n, contact_n)
        for order, row in enumerate(("displacement", "velocity", "acceleration")):
            errors = []
            for contact_force_n in (None, contact_n):
                equations = modal_equations(rig, motion, body, stations, contact_force_n)
                errors.append(np.stack([getattr(e, row)[:samples] for e in equations]) - true[order][:, :samples])
            before, after = (np.linalg.norm(x) / np.linalg.norm(true[order]) for x in errors)
            assert after < 1e-9
            assert before > 1e-5


def test_the_modal_equations_balance_once_the_higher_modes_are_off(barrel_cradle):
    """q'' + 2 zeta omega q' + omega^2 q against phi F - sum phi_j f_j with the true contact forces, up to 200 Hz."""
    recording = read(barrel_cradle)
    contact_n = read_truth(truth_path(barrel_cradle)).signals["contact_force"].values
    rig, motion = recording.rig, kinematics(recording, "displacement")
    contact_n = contact_n[:, : motion.force_n.size]
    samples = correctable_sample_count(motion)
    in_band = np.fft.rfftfreq(samples, 1 / RATE_HZ) < 200.0
    hann = np.hanning(samples)

    def size(signal):
        return np.linalg.norm(np.fft.rfft(hann * signal[:samples])[in_band])

    def imbalance(equation, forced_by):
        q, rate, acceleration = equation.displacement, equation.velocity, equation.acceleration
        natural = 2 * np.pi * equation.frequency_hz
        inertia = acceleration[:samples] + 2 * equation.damping_ratio * natural * rate[:samples]
        return size(inertia + natural**2 * q[:samples] - forced_by[:samples])

    for body in rig.bodies:
        equations = (modal_equations(rig, motion, body, 4, force_n) for force_n in (None, contact_n))
        for measured, clean in zip(*equations, strict=True):
            forced_by = measured.shape_at_force * motion.force_n - measured.shape_at_contacts @ contact_n
            assert imbalance(clean, forced_by) < 5e-3 * size(forced_by)
            assert imbalance(clean, forced_by) < imbalance(measured, forced_by) / 3


def test_relative_displacement_from_the_sensors_at_the_contact():
    rig = rig_of()
    motion = motion_at_sensors(rig, lambda _: tones(9, 1))  # more modes than could be fitted
    for rows, relative in (
        (motion.displacement_m, signals_across_contacts(rig, motion, motion.displacement_m)),
        (motion.velocity_m_per_s, signals_across_contacts(rig, motion, motion.velocity_m_per_s)),
    ):
        by_station = {s.station: row for s, row in zip(rig.sensors, rows, strict=True)}
        for contact, eta in zip(rig.contacts, relative, strict=True):
            np.testing.assert_array_equal(eta, by_station[contact.at] - by_station[contact.against])


def test_relative_displacement_from_the_modes_where_no_sensor_stands():
    full = rig_of()
    places = {"cradle": (0.2, 0.35, 0.6, 0.75, 0.9), "barrel": (0.1, 0.3, 0.5, 0.8, 1.0)}
    sensors = tuple(
        Sensor(name=f"{body} {x}", station=Station(body, x), quantity="displacement")
        for body, positions in places.items()
        for x in positions
    )
    rig = msgspec.structs.replace(full, sensors=sensors)
    true = {body.name: tones(5, seed) for seed, body in enumerate(rig.bodies)}
    motion = motion_at_sensors(rig, lambda body: true[body.name])
    eta = signals_across_contacts(rig, motion, motion.displacement_m)
    for j in range(2):
        expected = sum(contact_shapes(rig, body, j, 5) @ true[body.name][0] for body in rig.bodies)
        np.testing.assert_allclose(eta[j], expected, atol=1e-9 * np.abs(expected).max())
