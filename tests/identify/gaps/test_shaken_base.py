"""Rigs on a base that shakes and is measured: what differs is named with its value, what does not stays quiet.

The records come from the equations of motion in space, solved here by scipy, not from a plant.
"""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh
from scipy.signal import StateSpace, lsim, resample_poly

import identify
from identify.pages.wording import COVERED
from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.description import ON_GROUND, Contact, PointMass, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.recording import Recording, Signals, channel_groups

RATE_HZ, DURATION_S, QUIET_S, RISE_S = 512.0, 20.0, 1.0, 0.5
SUBSTEPS = 16
NOISE = {"acceleration": 5e-4, "displacement": 1e-8}
MASS_KG, MASS_HZ, MASS_RATIO = 2.0, 12.0, 0.02
STIFFNESS_N_PER_M, DAMPING_N_S_PER_M, CLEARANCE_M = 4e4, 4.0, 5e-4
BEAM = Beam(name="beam", ends="clamped-free", length_m=0.8, width_m=0.04, thickness_m=0.01, damping_ratio=0.01)
BEAM_STATIONS_M = (0.2, 0.4, 0.6, 0.8)
ELEMENTS = 16


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


def mass_in_space(seed, added_kg):
    """Rows of the base and of a mass on a spring and between stops, both carried by the base."""
    time_s, w, u, a = shaking(seed, 40.0)
    base, velocity = CubicSpline(time_s, w), CubicSpline(time_s, u)
    spring_n_per_m = MASS_KG * (2 * np.pi * MASS_HZ) ** 2
    damping_n_s_per_m = 2 * MASS_RATIO * MASS_KG * 2 * np.pi * MASS_HZ

    def force_n(eta, rate):
        stop_n = STIFFNESS_N_PER_M * (eta - np.clip(eta, -CLEARANCE_M, CLEARANCE_M)) + DAMPING_N_S_PER_M * rate * (
            np.abs(eta) > CLEARANCE_M
        )
        return -spring_n_per_m * eta - damping_n_s_per_m * rate - stop_n

    def derivative(t, state):
        x, v = state
        return v, force_n(x - base(t), v - velocity(t)) / (MASS_KG + added_kg)

    x, v = solve_ivp(derivative, (0.0, time_s[-1]), (0.0, 0.0), "RK45", time_s, rtol=1e-7, atol=1e-11, max_step=1e-3).y
    acceleration = force_n(x - w, v - u) / (MASS_KG + added_kg)
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
    time_s, w, _, a = shaking(seed, 120.0)
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
        system = StateSpace([[0, 1], [-(omega[mode] ** 2), -damping]], [[0], [gain]], np.eye(2), [[0], [0]])
        states = lsim(system, a, time_s)[1].T
        acceleration = gain * a - damping * states[1] - omega[mode] ** 2 * states[0]
        relative += shapes[nodes, mode][:, None] * np.stack([states[0], acceleration])[:, None]
    return {
        name: np.concatenate([base[None], base + rows])
        for name, base, rows in zip(("displacement", "acceleration"), (w, a), relative, strict=True)
    }


def diagnosed(rig, in_space, added_kg):
    """Diagnosis of two records of a rig that is heavier than believed."""
    return identify.gap([recorded(rig, in_space(seed, added_kg), seed) for seed in (1, 2)])
