"""The step of Gauss-Newton within bounds."""

import dataclasses

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.residual.fit import bounded_minimum
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.model.components import PointSpring
from rig.model.description import Station
from rig.simulation.reference import BarrelCradle
from tests.fuzz.readers import sound_recording
from tests.identify.gaps.residual.simulated_records import simulated_record

WIDE = np.full(6, 1e3)


def test_the_rounding_of_products_in_single_precision_does_not_hide_the_priors():
    """Six columns that are nearly one, of which the priors alone tell the differences: the sum is as it should be."""
    rng = np.random.default_rng(1)
    columns = 1e5 * (rng.standard_normal((1, 400)) + 1e-5 * rng.standard_normal((6, 400)))
    exact = columns @ columns.T + 7.0 * np.eye(6)
    gradient = columns @ columns.sum(axis=0) / 6
    difference = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    rounded = exact - 1e3 * np.outer(difference, difference)  # a share of 2e-10, less than single precision's 6e-8
    assert np.linalg.eigvalsh(rounded)[0] < 0
    step = bounded_minimum(rounded, gradient, -WIDE, WIDE)
    assert step.sum() == pytest.approx(np.linalg.solve(exact, gradient).sum(), rel=1e-4)


def test_what_is_not_told_apart_at_all_is_refused():
    with pytest.raises(RigError, match="does not tell contact forces and tolerances"):
        bounded_minimum(np.diag([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]), np.ones(6), -WIDE, WIDE)


def test_modes_beyond_any_are_refused():
    recording = sound_recording()
    believed = recording.rig
    absurd = replace(believed, bodies=(replace(believed.bodies[0], frequency_hz=1e29),))
    with pytest.raises(RigError, match="contacts or modes are beyond any"):
        fit_nuisance(record_of(recording), absurd)


def test_sensors_that_show_no_motion_are_refused():
    recording = sound_recording()
    still = {
        name: signals if name == "force" else dataclasses.replace(signals, values=np.zeros_like(signals.values))
        for name, signals in recording.signals.items()
    }
    with pytest.raises(RigError, match="the sensors show no motion"):
        record_of(dataclasses.replace(recording, signals=still))


def test_a_force_of_hardly_any_frequency_is_refused():
    recording = sound_recording()
    force = recording.signals["force"]
    slow = 1e4 * np.sin(2 * np.pi * 0.2 * force.time_s)[None]
    signals = {**recording.signals, "force": dataclasses.replace(force, values=slow)}
    recording = dataclasses.replace(recording, signals=signals)
    with pytest.raises(RigError, match=r"the force excites the rig up to .* Hz alone"):
        record_of(recording)


def test_contact_unknowns_of_a_free_body_give_way_to_those_of_a_held_one():
    """A spring that is tried holds the barrel: its contact has a slow force then, and more unknowns."""
    settings = BarrelCradle(sensors="acceleration", stations=4, sample_rate_hz=1024.0, high_hz=60.0, duration_s=12.0)
    rig = settings.rig()
    held = replace(rig, springs=(PointSpring(station=Station("barrel", 0.5), stiffness_n_per_m=5e4),))
    record = simulated_record(settings, rig)
    free_residual = residual_of(linearized(record, rig), rig)
    free_unknowns = tuple(contact.unknowns for contact in free_residual.contacts)
    residual = residual_of(linearized(record, held), held, None, free_unknowns)
    held_unknowns = [contact.unknowns for contact in residual.contacts]
    assert all(held.size > free.size for held, free in zip(held_unknowns, free_unknowns, strict=True))
    assert np.isfinite(residual.cost)
