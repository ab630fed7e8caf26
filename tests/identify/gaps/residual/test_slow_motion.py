"""A mass whose position is measured and that no spring holds: friction and constant forces are seen down to rest."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import lsim

from identify.gaps.residual.extent import OMITTED_EDGE_S, OMITTED_FADES
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search, fit_effects
from identify.gaps.search.nominal import fit_nuisance
from rig.model.contact_laws.dead_zone import FRICTION_SPEED_M_PER_S
from rig.model.description import PointDamper, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.recording import Recording, Signals, channel_groups

RATE_HZ = 500.0
AT = Station("carriage", 0.0)


def carriage(mass_kg: float, viscous_n_s_per_m: float, rate_hz: float, frequency_hz: float = 0.0) -> Rig:
    return Rig(
        name="carriage",
        bodies=(Oscillator(name="carriage", mass_kg=mass_kg, frequency_hz=frequency_hz, damping_ratio=0.0),),
        contacts=(),
        force_at=AT,
        sensors=(Sensor(name="position", station=AT, quantity="displacement"),),
        sample_rate_hz=rate_hz,
        dampers=(PointDamper(station=AT, damping_n_s_per_m=viscous_n_s_per_m),),
    )


def recording_of(rig, force_n, position_m):
    rows = {"force": force_n[None], "displacement": position_m[None]}
    return Recording(rig, {name: Signals(c, 0.0, rows[name]) for name, c in channel_groups(rig).items()}, {})


def simulated(friction_n: float, load_n: float, seed: int = 401) -> Recording:
    """Recording by inverse dynamics: constant speeds to and fro for seconds, plus a little Gaussian motion."""
    rng, time_s = np.random.default_rng(seed), np.arange(round(24 * RATE_HZ)) / RATE_HZ
    steps = np.repeat(rng.uniform(-0.2, 0.2, 8), time_s.size // 8)
    hz = np.fft.rfftfreq(time_s.size, 1 / RATE_HZ)
    speed = np.fft.irfft(np.fft.rfft(steps) * np.exp(-((hz / 2) ** 2)), time_s.size)
    random = np.fft.irfft(np.fft.rfft(rng.standard_normal(time_s.size)) * ((hz > 1) & (hz < 20)), time_s.size)
    speed = speed + 0.005 * random / random.std()
    lines = np.fft.rfft(speed)
    turning = 2j * np.pi * np.append(1.0, hz[1:])
    position = np.fft.irfft(np.append(0.0, lines[1:] / turning[1:]), time_s.size) + lines[0].real / time_s.size * time_s
    acceleration = np.fft.irfft(lines * 2j * np.pi * hz, time_s.size)
    rig = carriage(20.0, 30.0, RATE_HZ)
    force_n = 20.0 * acceleration + 30.0 * speed + friction_n * np.tanh(speed / FRICTION_SPEED_M_PER_S) - load_n
    return recording_of(rig, force_n, position)


def fitted_effects(record, *names):
    """Values and standard errors of effects fitted together, and the share of the acceleration before and after."""
    every_candidate = candidates(
        effect_range_scale(record, record.rig), [s.name for s in record.sensors], record.zero_known
    )
    effects = tuple(next(c for c in every_candidate if c.kind.name == name) for name in names)
    linearization, residual = fit_nuisance(record, record.rig)
    search = Search(nominal_variances_of(linearized(record, record.rig)), linearization, residual, effects)
    estimate = fit_effects(search, effects, np.concatenate([p.typical_values for p in effects]), residual).hypothesis
    shares = search.nominal_fit().hypothesis.misfit.unexplained_share, estimate.misfit.unexplained_share
    return estimate.values, np.sqrt(np.diag(estimate.covariance)), shares


def test_friction_and_a_constant_force_are_found_in_motion_at_constant_speed():
    record = record_of(simulated(friction_n=5.0, load_n=1.2))
    values, errors, (before, after) = fitted_effects(record, "ground_friction", "preload")
    assert np.all(np.abs(values - [5.0, 1.2]) < np.maximum(2 * errors, 1e-3))
    assert np.all(errors < 0.05 * np.array([5.0, 1.2]))
    assert after < 0.02 < before


def test_without_friction_none_is_found_and_nothing_is_left():
    values, errors, (before, _) = fitted_effects(record_of(simulated(0.0, 0.0)), "ground_friction", "preload")
    assert np.all(np.abs(values) < np.maximum(2 * errors, 1e-3))
    assert before < 1e-3


def test_a_held_carriage_rests_where_a_constant_force_holds_it():
    """It does not start to move under that force with the record. The motion is scipy's."""
    rig, load_n = carriage(14.0, 15.0, 512.0, 0.45), -1.2
    spring_n_per_m = 14.0 * (2 * np.pi * 0.45) ** 2
    time_s = np.arange(30 * 512) / 512.0
    hz = np.fft.rfftfreq(time_s.size, 1 / 512.0)
    noise = np.random.default_rng(402).standard_normal(time_s.size) * (time_s > 1)
    force_n = 70.0 * np.fft.irfft(np.fft.rfft(noise) * np.exp(-((hz / 2) ** 2)), time_s.size) * (time_s > 1)
    system = ([[0, 1], [-spring_n_per_m / 14.0, -15.0 / 14.0]], [[0], [1 / 14.0]], [[1, 0]], [[0]])
    motion = lsim(system, force_n, time_s)
    record = record_of(recording_of(rig, force_n, motion[1] + load_n / spring_n_per_m))
    values, _, (before, after) = fitted_effects(record, "preload")
    assert values == pytest.approx([load_n], abs=0.02)
    assert after < 0.05 * before


def test_the_measured_motion_counts_up_to_the_fade():
    free = record_of(simulated(0.0, 0.0))
    assert free.residual_times_s[0] == pytest.approx(OMITTED_FADES, abs=0.05)
    rows = (simulated(0.0, 0.0).signals[name].values[0] for name in ("force", "displacement"))
    held = recording_of(carriage(20.0, 30.0, RATE_HZ, 1.0), *rows)
    assert record_of(held).residual_times_s[0] == pytest.approx(OMITTED_EDGE_S, abs=0.05)


def test_friction_and_offset_of_a_measured_carriage():
    """EMPS: regression with the true velocity finds 20.4 N and 3.2 N (Janot, Gautier, Brunot, 2019)."""
    path = Path(os.environ.get("EMPS", "no folder"), "DATA_EMPS.mat")
    if not path.exists():
        pytest.skip(f"no {path.name}: let the environment variable EMPS name its folder")
    data = {name: np.ravel(values) for name, values in loadmat(path).items() if not name.startswith("__")}
    recording = recording_of(carriage(95.1, 203.0, 1000.0), data["gtau"][0] * data["vir"], data["qm"].astype(float))
    values, errors, (before, after) = fitted_effects(record_of(recording), "ground_friction", "preload", "force_shift")
    assert values[0] == pytest.approx(20.4, rel=0.08)
    assert values[1] == pytest.approx(3.2, abs=0.6)
    assert errors[0] < 0.6
    assert after < 0.15 * before
