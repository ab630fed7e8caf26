"""Strain gauges as rows of the linear residual, and the recordings in which they are left out by name."""

from dataclasses import replace as with_fields

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.gaps.decision.null_simulations import draw_rig, standard_normals
from identify.gaps.residual.gauges import gauge_sensors, reason_against_gauges
from identify.gaps.residual.likelihood import misfit, nominal_variances_of
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.residual.shaken_base import unmeasured_base_accelerations
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unmeasured_force.nuisance import whitened_record
from rig.model.description import BaseMotion, Sensor, Station
from rig.model.tolerances import LABORATORY
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal
from tests.campaigns.fifteen_rigs.session import COVERED
from tests.campaigns.gauged_gap import GAUGE_GAIN, WRONG_GAUGE, nominal_rig, recordings

SETTINGS = BarrelCradle(sensors="acceleration", duration_s=12.0, sample_rate_hz=1024.0, noise_density=1e-3, stations=4)
GAUGES = tuple(
    Sensor(name=f"{body}_{x}", station=Station(body, x), quantity="strain", noise_density=1e-9)
    for body, x in (("cradle", 0.1), ("cradle", 0.3), ("cradle", 0.7), ("barrel", 0.5))
)
RIG = replace(SETTINGS.rig(), sensors=(*GAUGES, *SETTINGS.rig().sensors))
FORCE_N = force_history(SETTINGS.force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)


def changed(rig, name, **fields):
    return replace(rig, sensors=tuple(replace(s, **fields) if s.name == name else s for s in rig.sensors))


def test_gauges_of_a_machine_within_its_tolerances_are_explained_down_to_the_slowest_bending():
    machine = draw_rig(RIG, LABORATORY, standard_normals(RIG, 1)[0])
    record = record_of(modal(RIG, machine, FORCE_N, 1))
    assert [s.name for s in record.sensors[-len(GAUGES) :]] == [s.name for s in GAUGES]
    variances = nominal_variances_of(linearized(record, RIG))
    beyond_noise = misfit(record, variances, fit_nuisance(record, RIG)[1]).residual_variance_beyond_noise
    squared_shares = (beyond_noise / variances.acceleration_power)[:, -len(GAUGES) :]
    assert np.all(squared_shares < 0.01**2)


@pytest.fixture(scope="module")
def linearization():
    return linearized(record_of(modal(RIG, RIG, FORCE_N, 1)), RIG)


@pytest.mark.parametrize("kind", ["gain", "position", "delay"])
def test_columns_are_what_a_gauge_that_differs_leaves(linearization, kind):
    small, gauge = 1e-2, GAUGES[1]
    fields = {
        "gain": {"gain": 1 + small * LABORATORY.gain},
        "delay": {"delay_s": small * LABORATORY.delay_s},
        "position": {"station": Station("cradle", gauge.station.position_m + small * LABORATORY.position_m)},
    }[kind]
    differing = residual_of(linearization, changed(RIG, gauge.name, **fields)).linear_before_nuisance
    change = residual_of(linearization, RIG).linear_before_nuisance - differing
    names = [parameter.name for parameter in linearization.columns.parameters]
    column = small * linearization.columns.residual[names.index(f"{kind} of {gauge.name}")]
    assert np.linalg.norm(change - column) < 0.05 * np.linalg.norm(change)


def test_gauges_leave_noise_where_an_unmeasured_force_is_sought(linearization):
    record = linearization.record
    whitened = whitened_record(record, RIG)
    row_count = len(record.sensors) - len(RIG.contacts)
    assert whitened.whitened_residual.shape[1] == row_count
    assert np.mean(np.abs(whitened.whitened_residual) ** 2) < 3.0  # noise alone: 1, and what the 25th mode on would add
    names = {parameter.name for parameter in whitened.nuisance_parameters}
    assert {f"gain of {gauge.name}" for gauge in GAUGES} <= names


def test_a_gauge_on_a_free_body_shows_nothing_of_a_moving_base(linearization):
    model, motion = linearization.model, BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=1.0, high_hz=100.0)
    on_barrel = (GAUGES[-1], Station("barrel", 0.0))
    shown = unmeasured_base_accelerations(RIG, motion, model.responses, on_barrel, linearization.record.sample_count)
    scale = np.abs(unmeasured_base_accelerations(RIG, motion, model.responses, (Station("cradle", 1.0),), 1)).max()
    assert np.abs(shown).max() < 1e-6 * scale


def beside(recording, rig):
    return with_fields(recording, rig=rig)


def test_gauges_are_left_out_by_name_where_the_model_does_not_hold_for_them():
    recording = modal(RIG, RIG, FORCE_N[: round(2 * RIG.sample_rate_hz)], 1)
    assert [s.name for s in gauge_sensors(recording)] == [s.name for s in GAUGES]
    force = recording.signals["force"]
    quiet = {**recording.signals, "force": with_fields(force, values=0 * force.values)}
    shaken = replace(
        RIG, sensors=(*RIG.sensors, Sensor(name="table", station=Station("ground"), quantity="acceleration"))
    )
    stopped = replace(RIG, contacts=tuple(replace(c, at=c.against, against=None) for c in RIG.contacts))
    for other, word in (
        (with_fields(recording, signals=quiet), "measured force"),
        (beside(recording, shaken), "shaken base"),
        (beside(recording, stopped), "between its stops"),
    ):
        assert word in reason_against_gauges(other)
        assert not gauge_sensors(other)


@pytest.mark.study
def test_a_gauge_that_reads_too_much_is_named(tmp_path):
    report = identify.gap(recordings("sensor_gain", 1, nominal_rig(True)), null_reference=tmp_path).report
    (cause, *_) = report.causes
    assert report.verdict == "explained"
    assert (cause.effects, cause.places) == (("sensor_gain",), {"sensor_gain.sensor": WRONG_GAUGE})
    factor = cause.parameters["sensor_gain.factor"]
    assert abs(factor.value - GAUGE_GAIN) < COVERED * factor.standard_error
