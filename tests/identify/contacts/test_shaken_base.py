"""Rigs on a base that shakes, without a force: contacts by accelerometers on the base and on the bodies.

The records come from the equations of motion in space, solved here, not from a plant.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import resample_poly

import identify
from identify.checks import check_recording
from identify.contacts.acceptance import estimated_contacts
from identify.contacts.separation import separate
from identify.linear.model import ResponseCache, accelerances, responses_of
from identify.linear.nuisance import NuisanceKind
from identify.pages.wording import COVERED
from identify.signals.kinematics import kinematics
from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.description import ON_GROUND, BaseMotion, Contact, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.model.tolerances import LABORATORY
from rig.recording import Recording, Signals, channel_groups

RATE_HZ, DURATION_S, QUIET_S, RISE_S = 1024.0, 20.0, 1.0, 0.5
NOISE, SUBSTEPS = 2e-4, 8
STIFFNESS, DAMPING = 4e4, 4.0


@dataclass(frozen=True)
class Shaking:
    """Displacement of the base: sines of 4 to 40 Hz that set in smoothly after the quiet second."""

    seed: int
    size_m_per_s2: float = 1.5

    def motion(self, time_s):
        """Displacement, velocity and acceleration."""
        rng = np.random.default_rng(self.seed)
        omega = 2 * np.pi * rng.uniform(4.0, 40.0, 16)[:, None]
        angle = omega * time_s + rng.uniform(0, 2 * np.pi, 16)[:, None]
        size_m = self.size_m_per_s2 / omega**2
        w, v = np.sum(size_m * np.sin(angle), axis=0), np.sum(size_m * omega * np.cos(angle), axis=0)
        a = -np.sum(size_m * omega**2 * np.sin(angle), axis=0)
        s = np.clip((time_s - QUIET_S) / RISE_S, 0, 1)
        rise, slope, bend = s**3 * (10 - 15 * s + 6 * s**2), 30 * (s - s**2) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
        slope, bend = slope / RISE_S, bend / RISE_S**2
        return rise * w, slope * w + rise * v, bend * w + 2 * slope * v + rise * a


def stop_force(eta, rate, lower_m, upper_m):
    if -lower_m <= eta <= upper_m:
        return 0.0
    return STIFFNESS * (eta - upper_m if eta > 0 else eta + lower_m) + DAMPING * rate


def one_mass_in_space(base, x, v):
    """Acceleration of 2 kg on a spring (12 Hz, 2 %) and between unequal stops, both carried by the base."""
    (w, u), omega = base, 2 * np.pi * 12.0
    spring_n = 2.0 * (omega**2 * (x[0] - w) + 2 * 0.02 * omega * (v[0] - u))
    return (-(spring_n + stop_force(x[0] - w, v[0] - u, 4e-4, 6e-4)) / 2.0,)


def two_masses_in_space(base, x, v):
    """Accelerations of 3 kg on a spring (15 Hz, 2 %) on the base, and of 1 kg that floats and meets it at a bumper."""
    (w, u), omega = base, 2 * np.pi * 15.0
    bumper_n = stop_force(x[1] - x[0], v[1] - v[0], 5e-4, 5e-4)
    spring_n = 3.0 * (omega**2 * (x[0] - w) + 2 * 0.02 * omega * (v[0] - u))
    return (bumper_n - spring_n) / 3.0, -bumper_n


def law(lower_m, upper_m):
    return DeadZone(
        lower_clearance_m=lower_m, upper_clearance_m=upper_m, stiffness_n_per_m=STIFFNESS, damping_n_s_per_m=DAMPING
    )


def described(bodies, contact, quantity="acceleration"):
    places = (ON_GROUND, *(Station(body.name) for body in bodies))
    noise = {"acceleration": NOISE, "displacement": 1e-8}[quantity]
    sensors = tuple(
        Sensor(name=f"on {place.body}", station=place, quantity=quantity, noise_density=noise) for place in places
    )
    return Rig(name="shaken", bodies=bodies, contacts=(contact,), sensors=sensors, sample_rate_hz=RATE_HZ)


MASS = Oscillator(name="mass", mass_kg=2.0, frequency_hz=12.0, damping_ratio=0.02)
LOWER = Oscillator(name="lower", mass_kg=3.0, frequency_hz=15.0, damping_ratio=0.02)
UPPER = Oscillator(name="upper", mass_kg=1.0, frequency_hz=0.0, damping_ratio=0.0)
STOPS = Contact(name="stops", at=Station("mass"), law=law(4e-4, 6e-4))
BUMPER = Contact(name="bumper", at=Station("upper"), against=Station("lower"), law=law(5e-4, 5e-4))
CASES = {
    "mass": (described((MASS,), STOPS), one_mass_in_space, (4e-4, 6e-4)),
    "two masses": (described((LOWER, UPPER), BUMPER), two_masses_in_space, (5e-4, 5e-4)),
}


def solved(name, seed):
    """Displacement, velocity and acceleration in space of the base and of the bodies, over the record.

    Runge and Kutta's fourth order, SUBSTEPS steps a sample, low-passed as a logger does.
    """
    _, equations, _ = CASES[name]
    samples, base, h = round(DURATION_S * RATE_HZ), Shaking(seed), 1 / (SUBSTEPS * RATE_HZ)
    w, u, _ = (row.tolist() for row in base.motion(np.arange(2 * SUBSTEPS * samples + 1) * h / 2))
    count = len(equations((0.0, 0.0), (0.0, 0.0), (0.0, 0.0)))
    x, v, rows = (0.0,) * count, (0.0,) * count, []

    def moved(start, rates, step):
        return tuple(a + step * b for a, b in zip(start, rates, strict=True))

    for n in range(SUBSTEPS * samples):
        first, middle, last = ((w[k], u[k]) for k in (2 * n, 2 * n + 1, 2 * n + 2))
        a1 = equations(first, x, v)
        rows.append((x, v, a1))
        v2 = moved(v, a1, h / 2)
        a2 = equations(middle, moved(x, v, h / 2), v2)
        v3 = moved(v, a2, h / 2)
        a3 = equations(middle, moved(x, v2, h / 2), v3)
        v4 = moved(v, a3, h)
        a4 = equations(last, moved(x, v3, h), v4)
        x = tuple(p + h / 6 * (a + 2 * b + 2 * c + d) for p, a, b, c, d in zip(x, v, v2, v3, v4, strict=True))
        v = tuple(p + h / 6 * (a + 2 * b + 2 * c + d) for p, a, b, c, d in zip(v, a1, a2, a3, a4, strict=True))
    of_base = np.array(base.motion(np.arange(SUBSTEPS * samples) * h))[:, None]
    in_space = np.concatenate([of_base, np.array(rows).transpose(1, 2, 0)], axis=1)
    return resample_poly(in_space, 1, SUBSTEPS, axis=-1, window=("kaiser", 10.0))


def record(rig, rows, gains=None, seed=0):
    """Recording of what the sensors deliver of these rows, which have one for the base and one for each body."""
    rng, noise = np.random.default_rng(seed), rig.sensors[0].noise_density * np.sqrt(RATE_HZ / 2)
    delivered = np.ones((len(rows), 1)) if gains is None else np.array(gains)[:, None]
    delivered = delivered * rows + noise * rng.standard_normal(rows.shape)
    groups = channel_groups(rig)
    values = {"force": np.zeros((1, rows.shape[1])), rig.sensors[0].quantity: delivered}
    return Recording(rig, {name: Signals(groups[name], 0.0, values[name]) for name in groups}, {})


@pytest.fixture(scope="module")
def motions():
    return {name: solved(name, seed) for seed, name in enumerate(CASES, start=1)}


@pytest.mark.parametrize("name", CASES)
def test_contacts_on_a_shaken_base_are_found_without_a_force(name, motions):
    rig, _, (lower_m, upper_m) = CASES[name]
    result = identify.contact(record(rig, motions[name][2]))
    (estimate,) = result.identification.report.contacts
    for found, true, share in (
        (estimate.clearance_m, (lower_m + upper_m) / 2, 0.01),
        (estimate.stiffness_n_per_m, STIFFNESS, 0.02),
        (estimate.damping_n_s_per_m, DAMPING, 0.3),
    ):
        assert abs(found.value - true) < 1.5 * COVERED * found.standard_error
        assert COVERED * found.standard_error < share * true
    assert not result.identification.report.findings
    assert result.identification.report.channels_used == tuple(s.name for s in rig.sensors)


def test_the_sides_of_a_sprung_mass_are_told_apart(motions):
    (estimate,) = identify.contact(record(CASES["mass"][0], motions["mass"][2])).identification.report.contacts
    for found, true in ((estimate.lower_clearance_m, 4e-4), (estimate.upper_clearance_m, 6e-4)):
        assert abs(found.value - true) < 1.5 * COVERED * found.standard_error < 0.02 * true


def test_displacements_in_space_tell_the_same_as_accelerations(motions):
    rig = described((MASS,), STOPS, "displacement")
    (estimate,) = estimated_contacts(record(rig, motions["mass"][0]), "auto", LABORATORY).outcomes.estimates.values()
    assert estimate.values[:3] == pytest.approx([4e-4, 6e-4, STIFFNESS], rel=0.01)


def test_without_a_force_stiffness_is_known_as_well_as_mass(motions):
    """A rig.json whose mass is 1 % too large makes the stiffness 1 % too large, and no sensor shows it."""
    rig, rows = CASES["mass"][0], motions["mass"][2]
    heavy = replace(rig, bodies=(replace(MASS, mass_kg=2.02),))
    (light_estimate,), (heavy_estimate,) = (
        estimated_contacts(record(r, rows), "auto", LABORATORY).outcomes.estimates.values() for r in (rig, heavy)
    )
    assert heavy_estimate.values[2] / light_estimate.values[2] == pytest.approx(1.01, rel=5e-4)
    assert light_estimate.errors[2] > LABORATORY.mass * STIFFNESS


@pytest.mark.parametrize("sensor", ["on ground", "on lower", "on upper"])
def test_the_change_by_a_gain_is_that_of_another_gain(motions, sensor):
    """Signal of the nuisance parameter against the difference of two separations without tolerances."""
    rig, _, _ = CASES["two masses"]
    number, tolerance = [s.name for s in rig.sensors].index(sensor), LABORATORY.gain
    gains = np.ones(3)
    gains[number] += tolerance
    nominal, spoilt = (
        separate(record(rig, motions["two masses"][2], g), "auto", LABORATORY).forces for g in (None, gains)
    )
    row = [(p.kind, p.owner) for p in nominal.nuisances.parameters].index((NuisanceKind.GAIN, sensor))
    change_n, expected_n = nominal.nuisances.force_n[row, 0], (spoilt.force_n - nominal.force_n)[0]
    middle = slice(len(change_n) // 8, -len(change_n) // 8)
    assert np.linalg.norm((change_n - expected_n)[middle]) < 0.05 * np.linalg.norm(expected_n[middle])


def test_a_cantilever_follows_its_base_as_bernoulli_and_euler_say():
    """E I w'''' = mu omega^2 w with w(0) = w_base, w'(0) = 0 and a free end, in closed form."""
    beam = Beam(name="beam", ends="clamped-free", length_m=0.8, width_m=0.04, thickness_m=0.01, damping_ratio=1e-6)
    places_m = np.array([0.1, 0.4, 0.8])
    sensors = tuple(
        Sensor(name=f"a{k}", station=Station("beam", x), quantity="acceleration") for k, x in enumerate(places_m)
    )
    table = Sensor(name="table", station=ON_GROUND, quantity="acceleration")
    rig = Rig(name="r", bodies=(beam,), contacts=(), sensors=(table, *sensors), sample_rate_hz=2048.0)
    hz = np.array([2.0, 7.0, 30.0, 60.0, 110.0])
    cache = ResponseCache(2 * np.pi * hz, 0)
    (by_base,) = accelerances(rig, responses_of(rig, cache, True), rig.inputs, [s.station for s in sensors])
    for line, omega in enumerate(2 * np.pi * hz):
        number = (beam.mass_per_length_kg_per_m * omega**2 / beam.bending_stiffness_n_m2) ** 0.25
        z = number * beam.length_m
        rows = [
            [1, 0, 1, 0],
            [0, 1, 0, 1],
            [-np.cos(z), -np.sin(z), np.cosh(z), np.sinh(z)],
            [np.sin(z), -np.cos(z), np.sinh(z), np.cosh(z)],
        ]
        weights = np.linalg.solve(rows, [1, 0, 0, 0])
        y = number * places_m
        in_space = weights @ np.stack([np.cos(y), np.sin(y), np.cosh(y), np.sinh(y)])
        np.testing.assert_allclose(-by_base[:, line], in_space - 1, atol=2e-3 * np.abs(in_space - 1).max())


def test_a_body_that_floats_stays_in_space_while_its_base_shakes():
    rig, rows = CASES["two masses"][0], np.array(Shaking(3).motion(np.arange(20480) / RATE_HZ)[2])
    motion = kinematics(record(rig, np.stack([rows, rows, 0 * rows])))
    assert motion.stations == (Station("lower"), Station("upper"))
    cache = ResponseCache(2 * np.pi * np.array([5.0, 20.0]), 0)
    by_base = accelerances(rig, responses_of(rig, cache, True), rig.inputs, motion.stations)[0]
    np.testing.assert_allclose(by_base[1], 1.0, rtol=1e-12)
    np.testing.assert_allclose(motion.acceleration_m_per_s2[1], motion.forces_n[0], atol=0.05)


def test_a_base_motion_without_a_sensor_is_refused_and_one_with_a_sensor_is_not(motions):
    rig, _, _ = CASES["mass"]
    base = BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=4.0, high_hz=40.0)
    measured = replace(rig, base_motion=base)
    assert estimated_contacts(record(measured, motions["mass"][2]), "auto", LABORATORY).outcomes.estimates
    blind = replace(measured, sensors=rig.sensors[1:], force_at=Station("mass"))
    with pytest.raises(RigError, match="no sensor on the ground measures it; measure how the base shakes by a sensor"):
        identify.contact(record(blind, motions["mass"][2][1:]))


def test_the_check_that_knows_forces_alone_says_so(motions):
    recording = record(CASES["mass"][0], motions["mass"][2])
    assert check_recording(recording) == ()
    (note,) = identify.check(recording).notes
    assert note.startswith("only the waveforms are checked: the base of 'shaken' shakes")


@pytest.mark.parametrize("quantity", ["acceleration", pytest.param("displacement", marks=pytest.mark.study)])
def test_the_plan_of_such_a_test_foretells_its_intervals(motions, quantity):
    """Planned by the plant `modal` under Gaussian motion of the record's level and band."""
    rows = motions["two masses"][2 if quantity == "acceleration" else 0]
    recording = record(described((LOWER, UPPER), BUMPER, quantity), rows)
    (estimate,) = identify.contact(recording).report.contacts
    plan = identify.plan(recording, most_changes=0).report
    of_base = motions["two masses"][2][0, round((QUIET_S + RISE_S) * RATE_HZ) :]
    assert plan.base.acceleration_rms_m_per_s2 == pytest.approx(of_base.std(), rel=0.05)
    assert (plan.duration_s, plan.force) == (DURATION_S, None)
    (expected,) = plan.contacts
    for name, true in (("clearance_m", 5e-4), ("stiffness_n_per_m", STIFFNESS)):
        stated, planned = getattr(estimate, name), expected.quantities[name]
        assert 1 / 1.5 < stated.standard_error / planned.standard_error < 1.5
        assert abs(stated.value - true) < 1.5 * COVERED * planned.standard_error
    assert {"added_mass", "contact_clearance"} <= {effect.effect for effect in plan.effects}


def test_a_dead_sensor_on_the_base_is_found(motions):
    rig, _, _ = CASES["mass"]
    rows = motions["mass"][2].copy()
    recording = record(rig, rows, gains=[1.0, 1.0])
    values = recording.signals["acceleration"].values
    values[0] = 0.0
    assert ("dead", ("on ground",)) in [(f.cause, f.channels) for f in check_recording(recording)]
