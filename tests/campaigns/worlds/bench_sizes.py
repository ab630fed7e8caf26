"""Sizes of effects that suit a machine: shares of its force, motion, mass, damping and stops."""

from dataclasses import replace

import numpy as np

from tests.campaigns.worlds.bench_outside import bench_outside
from tests.campaigns.worlds.kinds import Draw, Kind, Size
from tests.campaigns.worlds.library import BOTH, EFFECTS
from tests.campaigns.worlds.lumped import lumped_modes
from tests.campaigns.worlds.machine import Lumped, Machine, TrueBeam
from tests.campaigns.worlds.outside import OUTSIDE


def mass_of(body: TrueBeam | Lumped) -> float:
    """Of a body with what is fixed to it, kg."""
    if isinstance(body, Lumped):
        return float(np.sum(lumped_modes(body).carried ** 2))
    return body.mass_per_length_kg_per_m * body.length_m + sum(kg for _, kg in body.masses)


def sized(
    machine: Machine,
    force_n: float,
    motion_m: float,
    speed_m_per_s: float,
    sample_rate_hz: float,
    band_hz: tuple[float, float],
) -> dict[str, Kind]:
    """Every kind of effect, in and out of the library; the smallest of a size is hard to see, the largest is not.

    force_n, motion_m and speed_m_per_s: root mean squares of the first record, where the machine is watched.
    """
    mass_kg = mass_of(machine.body(machine.force_at.body))
    lightest_kg = min(mass_of(b) for b in machine.bodies)
    laws = [c.law for c in machine.contacts]
    stop = max((law.stiffness_above_n_per_m for law in laws), default=1.0)
    gap_m = min((min(law.lower_m, law.upper_m) for law in laws), default=1.0)
    spring, damper = force_n / motion_m, force_n / speed_m_per_s
    critical = 2 * float(np.sqrt(stop * lightest_kg))
    sample_s = 1 / sample_rate_hz
    sizes = {
        "added_mass": Size("mass_kg", 0.005 * mass_kg, 0.2 * mass_kg, 0.05 * mass_kg),
        "asymmetric_clearance": Size("shift_m", 0.01 * gap_m, 0.3 * gap_m, 0.1 * gap_m, BOTH),
        "base_motion": Size(
            "acceleration_rms_m_per_s2",
            0.01 * force_n / lightest_kg,
            0.3 * force_n / lightest_kg,
            0.1 * force_n / lightest_kg,
        ),
        "contact_damping": Size("damping_n_s_per_m", 0.01 * critical, 0.3 * critical, 0.05 * critical),
        "coulomb_friction": Size("force_n", 0.01 * force_n, 0.5 * force_n, 0.1 * force_n),
        "force_shift": Size("shift_s", 0.1 * sample_s, 3 * sample_s, sample_s, BOTH),
        "ground_damper": Size("damping_n_s_per_m", 0.01 * damper, 0.5 * damper, 0.1 * damper),
        "ground_friction": Size("force_n", 0.01 * force_n, 0.4 * force_n, 0.1 * force_n),
        "hardening_spring": Size(
            "cubic_n_per_m3",
            0.01 * force_n / motion_m**3,
            0.3 * force_n / motion_m**3,
            0.1 * force_n / motion_m**3,
            BOTH,
            below=0.1,
        ),
        "hertz_stop": Size("exponent", 0.1, 0.5, 0.3, neutral=1.0),
        "linear_spring": Size("stiffness_n_per_m", 0.02 * spring, spring, 0.2 * spring),
        "nonlinear_contact": Size(
            "cubic_n_per_m3",
            0.02 * stop**3 / (3 * force_n) ** 2,
            0.6 * stop**3 / (3 * force_n) ** 2,
            0.2 * stop**3 / (3 * force_n) ** 2,
        ),
        "preload": Size("force_n", 0.02 * force_n, 0.5 * force_n, 0.1 * force_n, BOTH),
        "sensor_delay": Size("delay_s", 0.1 * sample_s, 3 * sample_s, sample_s, BOTH),
        "tone": Size("amplitude_n", 0.005 * force_n, 0.2 * force_n, 0.05 * force_n),
        "quadratic_drag": Size(
            "drag_n_s2_per_m2", 0.02 * damper / speed_m_per_s, damper / speed_m_per_s, 0.2 * damper / speed_m_per_s
        ),
        "softening_support": Size("stiffness_n_per_m", 0.05 * spring, 2 * spring, 0.3 * spring),
    }
    more: dict[str, Draw] = {
        "base_motion": _band(band_hz),
        "tone": _oscillation(band_hz),
        "softening_support": lambda rng, _value, _rms_n: {"yield_m": motion_m * float(rng.uniform(0.3, 1.0))},
        "hertz_stop": lambda _rng, _value, _rms_n: {"reference_force_n": 2 * force_n},
    }
    known = EFFECTS | OUTSIDE | bench_outside(stop, force_n, critical)
    return {
        name: replace(kind, size=sizes.get(name, kind.size), more=more.get(name, kind.more))
        for name, kind in known.items()
    }


def _band(band_hz: tuple[float, float]) -> Draw:
    low, high = 2 * band_hz[0], band_hz[1] / 1.6

    def drawn(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
        low_hz = float(low * (high / low) ** rng.uniform())
        return {"low_hz": low_hz, "high_hz": low_hz * float(rng.uniform(1.2, 1.6))}

    return drawn


def _oscillation(band_hz: tuple[float, float]) -> Draw:
    def drawn(rng: np.random.Generator, amplitude_n: float, _rms_n: float) -> dict[str, float]:
        phase = rng.uniform(0, 2 * np.pi)
        hertz = float(rng.uniform(0.1, 0.9)) * band_hz[1]
        return {
            "cosine_n": float(amplitude_n * np.cos(phase)),
            "sine_n": float(amplitude_n * np.sin(phase)),
            "frequency_hz": hertz,
        }

    return drawn
