"""Rigs on a base that shakes and is measured: what differs is named with its value, what does not stays quiet.

The records come from the equations of motion in space, solved here, not by a plant.
"""

import numpy as np
import pytest
from msgspec.structs import replace
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh
from scipy.signal import cont2discrete, lfilter, resample_poly, ss2tf

import identify
from identify.gaps.decision.recordings import without_faulty_channels
from identify.gaps.residual.residual import residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import attachment_residual_decrease
from identify.gaps.search.nominal import fit_nuisance
from identify.linear.nuisance import NuisanceKind
from identify.pages.wording import COVERED
from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.description import ON_GROUND, Contact, PointMass, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.model.tolerances import LABORATORY
from rig.recording import Recording, Signals, channel_groups

RATE_HZ, DURATION_S, QUIET_S, RISE_S = 512.0, 20.0, 1.0, 0.5
SUBSTEPS = 16
NOISE = {"acceleration": 5e-4, "displacement": 1e-8}
MASS_KG, MASS_HZ, MASS_RATIO = 2.0, 12.0, 0.02
STIFFNESS_N_PER_M, DAMPING_N_S_PER_M, CLEARANCE_M = 4e4, 4.0, 2e-3
BEAM = Beam(name="beam", ends="clamped-free", length_m=0.8, width_m=0.04, thickness_m=0.01, damping_ratio=0.01)
BEAM_STATIONS_M = (0.25, 0.5, 0.8)
ELEMENTS = 16
ADDED_KG, TIP_KG = 0.08 * MASS_KG, 0.05


def shaking(seed, high_hz):
    """Times, and displacement, velocity and acceleration of the base: sines that set in after the quiet second."""
    time_s = np.arange(round(DURATION_S * RATE_HZ) * SUBSTEPS) / (RATE_HZ * SUBSTEPS)
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * np.sort(rng.uniform(4.0, high_hz, 60))
    phases = rng.uniform(0, 2 * np.pi, omega.size)
    displacement = np.sum([0.8 / w**2 * np.sin(w * time_s + p) for w, p in zip(omega, phases, strict=True)], axis=0)
    s = np.clip((time_s - QUIET_S) / RISE_S, 0, 1)
    spline = CubicSpline(time_s, s**3 * (10 - 15 * s + 6 * s**2) * displacement)
    return time_s, spline(time_s), spline(time_s, 1), spline(time_s, 2)


def recorded(rig, motions, seed):
    """Recording of what the sensors deliver of displacement and acceleration: rows of the base, then of the others."""
    rng, (quantity,) = np.random.default_rng(seed), {sensor.quantity for sensor in rig.sensors}
    rows = resample_poly(motions[quantity], 1, SUBSTEPS, axis=1, window=("kaiser", 10.0))
    rows = rows + NOISE[quantity] * np.sqrt(RATE_HZ / 2) * rng.standard_normal(rows.shape)
    groups = channel_groups(rig)
    values = {"force": np.zeros((1, rows.shape[1])), quantity: rows}
    return Recording(rig, {name: Signals(groups[name], 0.0, values[name]) for name in groups}, {})


def sensors(stations, quantity):
    return tuple(
        Sensor(name=f"s{k}", station=station, quantity=quantity, noise_density=NOISE[quantity])
        for k, station in enumerate((ON_GROUND, *stations))
    )


def mass_rig(quantity="acceleration"):
    law = DeadZone(
        lower_clearance_m=CLEARANCE_M,
        upper_clearance_m=CLEARANCE_M,
        stiffness_n_per_m=STIFFNESS_N_PER_M,
        damping_n_s_per_m=DAMPING_N_S_PER_M,
    )
    return Rig(
        name="mass on a table",
        bodies=(Oscillator(name="mass", mass_kg=MASS_KG, frequency_hz=MASS_HZ, damping_ratio=MASS_RATIO),),
        contacts=(Contact(name="stops", at=Station("mass"), law=law),),
        sensors=sensors([Station("mass")], quantity),
        sample_rate_hz=RATE_HZ,
    )


SPRING_N_PER_M = MASS_KG * (2 * np.pi * MASS_HZ) ** 2
SPRING_N_S_PER_M = 2 * MASS_RATIO * MASS_KG * 2 * np.pi * MASS_HZ


@njit
def force_on_mass_n(eta_m, rate_m_per_s):
    """Force of the spring and of the stops at a relative displacement and velocity: numbers or arrays."""
    depth_m = eta_m - np.minimum(np.maximum(eta_m, -CLEARANCE_M), CLEARANCE_M)
    stop_n = STIFFNESS_N_PER_M * depth_m + DAMPING_N_S_PER_M * rate_m_per_s * (depth_m != 0)
    return -SPRING_N_PER_M * eta_m - SPRING_N_S_PER_M * rate_m_per_s - stop_n


@njit
def states_of_mass(base_m, base_m_per_s, step_s, mass_kg):
    """Displacement and velocity of a mass that its base carries, by the classical Runge-Kutta method; the motion of the
    base is given at every half step."""
    states, slopes = np.zeros((base_m.size // 2 + 1, 2)), np.zeros((4, 2))
    for k in range(states.shape[0] - 1):
        for stage, half_steps in enumerate((0, 1, 1, 2)):
            x, v = states[k] + half_steps * step_s / 2 * slopes[stage - 1]
            i = 2 * k + half_steps
            slopes[stage] = v, force_on_mass_n(x - base_m[i], v - base_m_per_s[i]) / mass_kg
        states[k + 1] = states[k] + step_s / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
    return states


def mass_in_space(seed, added_kg):
    """Rows of the base and of a mass on a spring and between stops, both carried by the base."""
    time_s, w, u, a = shaking(seed, 40.0)
    half_steps_s = np.linspace(time_s[0], time_s[-1], 2 * time_s.size - 1)
    base_m, base_m_per_s = CubicSpline(time_s, w)(half_steps_s), CubicSpline(time_s, u)(half_steps_s)
    x, v = states_of_mass(base_m, base_m_per_s, time_s[1], MASS_KG + added_kg).T
    acceleration = force_on_mass_n(x - w, v - u) / (MASS_KG + added_kg)
    return {"displacement": np.stack([w, x]), "acceleration": np.stack([a, acceleration])}


def cantilever_rig(quantity="acceleration"):
    return Rig(
        name="cantilever on a table",
        bodies=(BEAM,),
        contacts=(),
        sensors=sensors([Station("beam", x) for x in BEAM_STATIONS_M], quantity),
        sample_rate_hz=RATE_HZ,
    )


def cantilever_in_space(seed, tip_mass_kg):
    """Rows of the base and of a clamped beam's stations, by finite elements and their modes up to 2 kHz."""
    time_s, w, _, a = shaking(seed, 100.0)
    length = BEAM.length_m / ELEMENTS
    mass, stiffness = np.zeros((2, 2 * ELEMENTS + 2, 2 * ELEMENTS + 2))
    h = length
    element_mass = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h]]
    element_mass += [[54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]]
    element_stiffness = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h]]
    element_stiffness += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]
    for k in range(ELEMENTS):
        rows = np.ix_(range(2 * k, 2 * k + 4), range(2 * k, 2 * k + 4))
        mass[rows] += BEAM.mass_per_length_kg_per_m * h / 420 * np.array(element_mass)
        stiffness[rows] += BEAM.bending_stiffness_n_m2 / h**3 * np.array(element_stiffness)
    mass[-2, -2] += tip_mass_kg
    mass, stiffness = mass[2:, 2:], stiffness[2:, 2:]
    squares, shapes = eigh(mass, stiffness)
    omega = 1 / np.sqrt(squares[::-1])
    shapes = shapes[:, ::-1] * omega
    translation = np.tile([1.0, 0.0], ELEMENTS)
    nodes = [2 * (round(x / length) - 1) for x in BEAM_STATIONS_M]
    relative = np.zeros((2, len(nodes), time_s.size))
    for mode in range(np.count_nonzero(omega < 2 * np.pi * 2000)):
        damping = 2 * BEAM.damping_ratio * omega[mode]
        gain = -(shapes[:, mode] @ mass @ translation)
        matrices = [[0, 1], [-(omega[mode] ** 2), -damping]], [[0], [gain]], np.eye(2), [[0], [0]]
        *sampled, _ = cont2discrete(tuple(map(np.array, matrices)), time_s[1], "foh")
        numerators, denominator = ss2tf(*sampled)
        states = [lfilter(numerator, denominator, a) for numerator in numerators]
        acceleration = gain * a - damping * states[1] - omega[mode] ** 2 * states[0]
        relative += shapes[nodes, mode][:, None] * np.stack([states[0], acceleration])[:, None]
    return {
        name: np.concatenate([base[None], base + rows])
        for name, base, rows in zip(("displacement", "acceleration"), (w, a), relative, strict=True)
    }


@pytest.fixture(scope="module")
def mass_motions():
    """Motions of the nominal mass and of one that is 8 % heavier, under two shakings each."""
    return {added_kg: [mass_in_space(seed, added_kg) for seed in (1, 2)] for added_kg in (0.0, ADDED_KG)}


@pytest.fixture(scope="module")
def beam_motions():
    """Motions of the nominal cantilever and of one with a mass at its tip, under two shakings each."""
    return {tip_kg: [cantilever_in_space(seed, tip_kg) for seed in (1, 2)] for tip_kg in (0.0, TIP_KG)}


def gap_of(rig, motions):
    return identify.gap([recorded(rig, motion, seed) for seed, motion in enumerate(motions)])


def assert_named(gap, effect, parameter, true):
    """The effect alone is named, and the true value lies in its 95 % interval, which is narrower than a quarter."""
    report = gap.report
    assert report.verdict == "explained"
    assert report.criteria.named == (effect,)
    found = report.causes[0].parameters[parameter]
    assert abs(found.value - true) < COVERED * found.standard_error < 0.125 * true


@pytest.mark.long
def test_a_mass_as_described_between_stops_on_a_shaken_base_is_consistent(mass_motions):
    report = gap_of(mass_rig(), mass_motions[0.0]).report
    assert report.verdict == "consistent"
    assert report.criteria.named == ()


@pytest.mark.long
def test_a_heavier_mass_between_stops_on_a_shaken_base_is_named(mass_motions):
    gap = gap_of(mass_rig(), mass_motions[ADDED_KG])
    assert_named(gap, "added_mass:mass", "added_mass.mass_kg", ADDED_KG)
    rollout = gap.report.rollout
    assert rollout.code == "not_vetoed"
    assert rollout.whole.corrected < 0.5 * rollout.whole.nominal
    (added_mass,) = gap.corrected.masses
    assert (added_mass.station, added_mass.mass_kg) == (Station("mass"), pytest.approx(ADDED_KG, rel=0.1))
    assert gap.corrected.base_sensors


@pytest.mark.study
def test_a_heavier_mass_is_named_by_displacements(mass_motions):
    gap = gap_of(mass_rig("displacement"), mass_motions[ADDED_KG])
    assert_named(gap, "added_mass:mass", "added_mass.mass_kg", ADDED_KG)


@pytest.mark.study
def test_a_mass_at_the_tip_of_a_cantilever_on_a_shaken_base_is_named(beam_motions):
    gap = gap_of(cantilever_rig(), beam_motions[TIP_KG])
    assert_named(gap, "added_mass:beam", "added_mass.mass_kg", TIP_KG)
    assert gap.report.causes[0].parameters["added_mass.relative_position"].value == pytest.approx(1.0, abs=0.01)


@pytest.mark.study
def test_a_wrong_gain_of_the_sensor_on_the_base_is_named(beam_motions, tmp_path):
    recordings = [recorded(cantilever_rig(), motion, seed) for seed, motion in enumerate(beam_motions[0.0])]
    for recording in recordings:
        recording.signals["acceleration"].values[0] *= 1.05
    gap = identify.gap(recordings)
    assert_named(gap, "sensor_gain:s0", "sensor_gain.factor", 1.05)
    assert gap.corrected.base_sensors[0].gain == pytest.approx(1.05, abs=0.01)
    gap.save(tmp_path)
    assert "a gain of sensor s0" in (tmp_path / "gap.html").read_text(encoding="utf-8")


def fitted(rig, motion):
    """Linearisation and fit of a record within the tolerances."""
    (recording,), _ = without_faulty_channels(recorded(rig, motion, 0))
    return fit_nuisance(record_of(recording, LABORATORY), rig)


@pytest.mark.parametrize("quantity", ["acceleration", pytest.param("displacement", marks=pytest.mark.study)])
def test_a_cantilever_as_described_leaves_noise_and_a_mass_at_its_tip_what_it_adds(beam_motions, quantity):
    rig = cantilever_rig(quantity)
    heavier_rig = replace(rig, masses=(PointMass(station=Station("beam", BEAM.length_m), mass_kg=TIP_KG),))
    levels = {
        (true, believed.masses): float(np.mean(fitted(believed, motions[0])[1].linear_residual ** 2))
        for true, motions in beam_motions.items()
        for believed in (rig, heavier_rig)
    }
    assert max(levels[0.0, ()], levels[TIP_KG, heavier_rig.masses]) < 1.5
    assert min(levels[TIP_KG, ()], levels[0.0, heavier_rig.masses]) > 20.0


def test_the_slope_of_an_attached_mass_is_a_difference_of_residuals(beam_motions):
    """The mass feels the acceleration in space, of which the modes at the sensors are a part only."""
    rig = cantilever_rig()
    linearization, residual = fitted(rig, beam_motions[0.0][0])
    heavier_rig = replace(rig, masses=(PointMass(station=Station("beam", 0.6), mass_kg=1e-4),))
    slope, _ = attachment_residual_decrease(linearization, heavier_rig, residual)
    difference = (
        residual.linear_residual - residual_of(linearization, heavier_rig, residual.nuisance_pulls).linear_residual
    )
    assert np.linalg.norm(slope - difference) < 0.05 * np.linalg.norm(difference)


@pytest.mark.parametrize("sensor", ["s0", "s1"])
@pytest.mark.parametrize("make", ["mass", "beam"])
def test_the_column_of_a_gain_is_a_difference_of_residuals(mass_motions, beam_motions, make, sensor):
    """Gains of the sensors on the base and on the body; they change forces and relative displacements of contacts."""
    rig, motion = (mass_rig(), mass_motions[0.0][0]) if make == "mass" else (cantilever_rig(), beam_motions[0.0][0])
    linearization, _ = fitted(rig, motion)
    columns = linearization.columns
    index = [(p.kind, p.owner) for p in columns.parameters].index((NuisanceKind.GAIN, sensor))
    changed = replace(
        rig, sensors=tuple(replace(s, gain=1 + 1e-2 * LABORATORY.gain) if s.name == sensor else s for s in rig.sensors)
    )
    before, after = (residual_of(linearization, r) for r in (rig, changed))
    difference = 100 * (before.linear_before_nuisance - after.linear_before_nuisance)
    assert np.linalg.norm(columns.residual[index] - difference) < 0.05 * np.linalg.norm(difference) + 1e-3
    for contact in range(len(rig.contacts)):
        force_change_n = 100 * (before.signals[contact].force_n - after.signals[contact].force_n)
        eta_change_m = 100 * (before.model.eta_m - after.model.eta_m)[contact]
        moving = columns.eta_parameter_indices.tolist().index(index)
        assert np.linalg.norm(columns.contact_force_n[index, contact] - force_change_n) < 0.05 * np.linalg.norm(
            force_change_n
        )
        assert np.linalg.norm(columns.eta_m[moving, contact] - eta_change_m) < 0.05 * np.linalg.norm(eta_change_m)


def on_ground(quantity):
    return Sensor(name="table", station=ON_GROUND, quantity=quantity)


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (replace(mass_rig(), force_at=Station("mass")), "a force on 'mass' beside 's0' on the ground; record without"),
        (
            replace(mass_rig(), sensors=(on_ground("velocity"), *mass_rig().sensors[1:])),
            "has velocity on the ground and acceleration on bodies; put an accelerometer on the ground",
        ),
    ],
)
def test_what_the_diagnosis_does_not_take_is_refused_with_what_it_takes(rig, words):
    noise, groups = np.random.default_rng(1).standard_normal((4, 1, 6000)), channel_groups(rig)
    signals = {
        name: Signals(group, 0.0, np.tile(values, (len(group.names), 1)))
        for (name, group), values in zip(groups.items(), noise, strict=False)
    }
    with pytest.raises(RigError, match=words):
        identify.gap(Recording(rig, signals, {}))


def test_a_faulty_sensor_on_the_ground_is_refused(mass_motions):
    recording = recorded(mass_rig(), mass_motions[0.0][0], 0)
    recording.signals["acceleration"].values[0] = 0.0
    with pytest.raises(RigError, match="'s0' on the ground is dead; the diagnosis needs the motion of the base: mend"):
        identify.gap(recording)
