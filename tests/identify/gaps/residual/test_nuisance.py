"""Nuisance parameters applied to rigs, and their columns."""

from dataclasses import replace as replace_fields

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.residual.nuisance import with_nonlinear_nuisance
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.nominal import fit_nuisance
from rig.model.tolerances import LABORATORY
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle, Sdof
from rig.simulation.replay import modal
from tests.identify.gaps.residual.simulated_records import simulated_record

SETTINGS = Sdof(sensors="displacement", duration_s=12.0)
RIG = SETTINGS.rig()


@pytest.fixture(scope="module")
def linearization():
    return linearized(simulated_record(SETTINGS, RIG), RIG)


def test_nuisance_parameters_of_a_single_mass_and_its_sensor_are_put_into_the_rig(linearization):
    values = np.arange(1.0, 1.0 + len(linearization.columns.parameters))
    rig, applied = with_nonlinear_nuisance(RIG, linearization.columns.parameters, values, LABORATORY)
    by_name = {p.name: v for p, v in zip(linearization.columns.parameters, values, strict=True)}
    is_applied = [p.kind in ("frequency", "damping", "gain") for p in linearization.columns.parameters]
    np.testing.assert_array_equal(applied, np.where(is_applied, values, 0.0))
    (body,), (sensor,) = RIG.bodies, RIG.sensors
    assert rig.bodies == (
        replace(
            body,
            frequency_hz=body.frequency_hz * (1 + LABORATORY.frequency * by_name[f"frequency of {body.name}"]),
            damping_ratio=body.damping_ratio * (1 + LABORATORY.damping * by_name[f"damping of {body.name}"]),
        ),
    )
    assert rig.sensors == (
        replace(sensor, gain=sensor.gain * (1 + LABORATORY.gain * by_name[f"gain of {sensor.name}"])),
    )


def test_columns_are_what_another_rig_leaves_through_a_sensor_that_reads_wrong():
    settings = BarrelCradle(sensors="acceleration", duration_s=12.0, rms_n=1.0)
    believed = settings.rig()
    sensors = tuple(replace(s, gain=0.5 if i == 2 else 1.0, delay_s=0.0) for i, s in enumerate(believed.sensors))
    rig = replace(believed, sensors=sensors)
    linearization = linearized(simulated_record(settings, rig), rig)
    small = 1e-2
    for body in rig.bodies:
        modulus = body.youngs_modulus_pa * (1 + small * LABORATORY.frequency) ** 2
        bodies = tuple(replace(b, youngs_modulus_pa=modulus) if b == body else b for b in rig.bodies)
        change = (
            residual_of(linearization, rig).linear_before_nuisance
            - residual_of(linearization, replace(rig, bodies=bodies)).linear_before_nuisance
        )
        names = [p.name for p in linearization.columns.parameters]
        expected = small * linearization.columns.residual[names.index(f"frequency of {body.name}")]
        assert np.linalg.norm(change - expected) < 0.02 * np.linalg.norm(change)


def test_a_mode_whose_frequency_is_off_leaves_its_column_exactly_by_the_measured_motion():
    settings = BarrelCradle(sensors="acceleration", duration_s=12.0, rms_n=1.0)
    rig = settings.rig()
    stiffer = 3.0  # standard deviations: a fifth of the resonance's width
    bodies = tuple(
        b.scale_frequencies(1 + stiffer * LABORATORY.frequency) if b.name == "barrel" else b for b in rig.bodies
    )
    record = simulated_record(settings, rig, replace(rig, bodies=bodies))
    linearization = linearized(record, rig)
    names = [p.name for p in linearization.columns.parameters]
    values = np.zeros(len(names))
    values[names.index("frequency of barrel")] = stiffer
    before, after = (residual_of(linearization, rig, v).linear_residual for v in (np.zeros(len(names)), values))
    assert np.linalg.norm(after) < 0.1 * np.linalg.norm(before)


def test_the_share_of_a_channel_that_the_one_beside_it_shows_is_found():
    settings, share = BarrelCradle(sensors="acceleration", duration_s=20.0, rms_n=1.0, seed=2), 0.006
    rig = settings.rig()
    recording = modal(rig, rig, force_history(settings.force(), settings.duration_s, 1 / rig.sample_rate_hz), 1)
    signals = recording.signals["acceleration"]
    values = signals.values.copy()
    values[4] += share * signals.values[5]
    mixed_recording = replace_fields(
        recording, signals=recording.signals | {"acceleration": replace_fields(signals, values=values)}
    )
    linearization, residual = fit_nuisance(record_of(mixed_recording), rig)
    pulls = dict(zip((p.name for p in linearization.columns.parameters), residual.nuisance_pulls.tolist(), strict=True))
    mixed = f"crosstalk of {rig.sensors[5].name} in {rig.sensors[4].name}"
    estimate = LABORATORY.crosstalk * pulls.pop(mixed)
    assert 0.5 * share < estimate < share  # gain and place of the sensor take the rest, as their priors weigh as much
    assert max(map(abs, pulls.values())) < 0.5 * estimate / LABORATORY.crosstalk


def test_the_fitted_rig_leaves_by_itself_what_was_left_beside_the_nuisance_parameters():
    settings = BarrelCradle(sensors="acceleration", duration_s=12.0, rms_n=1.0)
    rig = settings.rig()
    record = simulated_record(settings, rig)
    linearization = linearized(record, rig)
    held = [
        p.mode_number is None and p.kind not in ("position", "high-pass", "crosstalk")
        for p in linearization.columns.parameters
    ]
    values = np.where(held, 0.3 * np.random.default_rng(1).standard_normal(len(held)), 0.0)
    with_nuisance, nominal = residual_of(linearization, rig, values), residual_of(linearization, rig)
    fitted = residual_of(linearized(record, with_nuisance.corrected_rig), with_nuisance.corrected_rig)
    assert np.linalg.norm(fitted.linear_residual - with_nuisance.linear_residual) < 0.05 * np.linalg.norm(
        nominal.linear_residual - with_nuisance.linear_residual
    )


def test_a_rig_whose_modes_leave_the_band_has_the_same_nuisance_parameters():
    settings = BarrelCradle(sensors="acceleration", duration_s=12.0, rms_n=1.0)
    rig = settings.rig()
    record = simulated_record(settings, rig)
    softer = replace(rig, bodies=tuple(replace(b, youngs_modulus_pa=0.5 * b.youngs_modulus_pa) for b in rig.bodies))
    assert linearized(record, softer).columns.parameters == linearized(record, rig).columns.parameters
