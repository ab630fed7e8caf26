"""Plans of tests against theory, and against tests that are then made."""

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.contacts.space_identification import identify_recording
from identify.planning.planned_test import planned_test
from identify.planning.ranking import NO_EFFECTS_IN_SPACE, ranked_plan
from rig.errors import RigError
from rig.model.tolerances import EXACT
from rig.recording import read
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof
from tests.identify.small_rigs import MASS_IN_RING, MASS_ON_TABLE, RING

pytestmark = pytest.mark.long

MASS = Sdof(sensors="acceleration", noise_density=1e-3, rms_n=0.7, low_hz=0.5)


@pytest.fixture(scope="module")
def scaled():
    """Plan of a test where nothing but mass and force gain is uncertain."""
    tolerances = replace(EXACT, mass=0.02, force_gain=0.02)
    return ranked_plan(planned_test(MASS.rig(), duration_s=12.0, tolerances=tolerances), max_change_count=8)


def test_a_stiffness_is_as_uncertain_as_the_scale_of_the_forces(scaled):
    """The motion gives k / m and the force's gain over m without a scale; the two priors give that:
    sigma^-2 = sigma_m^-2 + sigma_F^-2. Half the mass's tolerance leaves sqrt((1 + 1) / (4 + 1)) of it."""
    (stop,) = scaled.contacts
    share = stop.stiffness_n_per_m.standard_error / stop.stiffness_n_per_m.value
    assert 0.95 < share / (0.02 / np.sqrt(2)) < 2.0  # a single mass: times sqrt(1 + p^2) by the mass's pull p
    assert stop.stiffness_n_per_m.limited_by == "tolerances"
    (known_mass,) = (change for change in scaled.changes if "mass" in change.words and change.kind == "tolerance")
    assert known_mass.widest_factor == pytest.approx(np.sqrt(2 / 5), rel=0.1)
    assert known_mass.helps


def test_changes_are_ranked_and_those_that_change_nothing_do_not_help(scaled):
    factors = [change.widest_factor for change in scaled.changes]
    assert factors == sorted(factors)
    assert all(change.widest_factor <= 0.9 for change in scaled.advice)
    (quieter,) = (change for change in scaled.changes if change.kind == "noise")
    assert quieter.widest_factor == pytest.approx(1.0, abs=0.05)
    assert not quieter.helps


def test_a_force_that_closes_no_contact_is_foretold_and_its_advice_closes_it():
    plan = ranked_plan(planned_test(MASS.rig(), duration_s=20.0, force_rms_n=0.06), max_change_count=4)
    assert not plan.contacts
    (stop,) = plan.undetermined
    assert stop.name == "stop"
    assert "strongly" in stop.remedy
    assert plan.changes[0].gained == ("stop",)
    (stronger,) = (change for change in plan.changes if "(4 times)" in change.words)
    assert stronger.gained == ("stop",)
    assert stronger in plan.advice
    (weaker,) = (change for change in plan.changes if "(0.5 times)" in change.words)
    assert weaker not in plan.advice


@pytest.mark.study
def test_a_noisy_sensor_beside_a_better_one_adds_nothing():
    rig = Sdof(sensors="displacement+acceleration", noise_density=1e-3).rig()
    better = rig.sensors[-1]
    rig = replace(rig, sensors=(*rig.sensors, replace(better, name="spare", noise_density=1.0)))
    plan = ranked_plan(planned_test(rig, duration_s=12.0, tolerances=EXACT))
    assert len(plan.sensors) == 3
    assert "spare" in plan.idle_sensors


def test_a_rig_without_contacts_has_no_plan():
    with pytest.raises(RigError, match="no contacts"):
        identify.plan(replace(MASS.rig(), contacts=()))


@pytest.mark.study
def test_processes_give_the_same_plan():
    test = planned_test(MASS.rig(), duration_s=10.0)
    assert ranked_plan(test, max_change_count=1, workers=2) == ranked_plan(test, max_change_count=1)


def test_a_ring_is_told_all_around_and_as_well_as_the_scale_of_the_forces():
    """The two forces have a gain each: sigma^-2 = sigma_m^-2 + 2 sigma_F^-2, if both directions tell alike."""
    tolerances = replace(EXACT, mass=0.02, force_gain=0.02)
    test = planned_test(MASS_IN_RING, 12.0, 20.0, (1.0, 50.0), tolerances)
    plan = ranked_plan(test, max_change_count=1)
    (ring,) = plan.contacts
    share = ring.stiffness_n_per_m.standard_error / ring.stiffness_n_per_m.value
    assert 0.9 < share / (0.02 / np.sqrt(3)) < 2.0  # a single mass: times sqrt(1 + p^2) by the mass's pull p
    assert ring.stiffness_n_per_m.limited_by == "tolerances"
    assert ring.friction_coefficient.value == RING.friction_coefficient
    sag_m = RING.clearance_m + 2.0 * 9.81 / RING.stiffness_n_per_m
    assert abs(ring.center_y_m.value - sag_m) < 4 * ring.center_y_m.standard_error
    assert abs(ring.center_z_m.value) < 4 * ring.center_z_m.standard_error
    assert [change.kind for change in plan.changes] == ["add sensor"]
    assert plan.effects == ()
    assert NO_EFFECTS_IN_SPACE in plan.notes
    in_y = replace(test, rig=replace(MASS_IN_RING, sensors=MASS_IN_RING.sensors[:1]))
    (refused,) = ranked_plan(in_y, max_change_count=0).undetermined
    assert refused.code == "one_direction"


def test_on_a_shaken_base_a_stiffness_is_as_uncertain_as_the_mass():
    """The motion gives k / m, and no force tells the scale."""
    tolerances = replace(EXACT, mass=0.02)
    test = planned_test(MASS_ON_TABLE, 12.0, None, (4.0, 40.0), tolerances, 1.5)
    plan = ranked_plan(test, max_change_count=0)
    (stops,) = plan.contacts
    share = stops.stiffness_n_per_m.standard_error / stops.stiffness_n_per_m.value
    assert 0.95 < share / 0.02 < 2.0  # a single mass: times sqrt(1 + p^2) by the mass's pull p
    assert stops.stiffness_n_per_m.limited_by == "tolerances"
    assert (plan.force, plan.base.acceleration_rms_m_per_s2, plan.base.band_hz) == (None, 1.5, (4.0, 40.0))
    assert "sensor_gain" in {effect.effect for effect in plan.effects if "ground" in effect.place}


def standard_errors(report, names) -> np.ndarray:
    return np.array([[getattr(c, name).standard_error for name in names] for c in report.contacts])


def fresh_ratios(settings, simulate, folder) -> np.ndarray:
    """Standard errors that identify contact states on five recordings over the planned ones, recordings x contacts x
    quantities."""
    test = planned_test(settings.rig(), settings.duration_s, settings.rms_n, (settings.low_hz, settings.high_hz))
    plan = ranked_plan(test, max_change_count=0)
    names = [name for name in plan.contacts[0].quantities if not name.startswith("center")]
    planned_errors = standard_errors(plan, names)
    stated = []
    for seed in range(21, 26):
        path = simulate(replace(settings, seed=seed), folder / f"{seed}.mcap")
        stated.append(standard_errors(identify_recording(read(path)).report, names))
    ratios = np.array(stated) / planned_errors
    print("\n", np.round(ratios, 2).tolist())
    return ratios


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(replace(MASS, duration_s=60.0, step_s=2.0**-12), id="mass", marks=pytest.mark.study),
        pytest.param(
            BarrelCradle(sensors="acceleration", noise_density=1e-3, duration_s=30.0),
            id="beams",
            marks=pytest.mark.study,
        ),
        pytest.param(
            BarrelCradleAnnular(sensors="acceleration", noise_density=1e-3, duration_s=20.0),
            id="rings",
            marks=pytest.mark.study,
        ),
    ],
)
def test_fresh_recordings_have_the_planned_standard_errors(settings, simulate, tmp_path):
    """By other seeds, another drawing of the force and another step. Damping, whose error is scatter alone, scatters
    more."""
    ratios = fresh_ratios(settings, simulate, tmp_path)
    middle = np.median(ratios, axis=0)
    assert np.all((middle[:, :2] > 0.7) & (middle[:, :2] < 1.4))
    assert np.all((middle[:, 2:] > 0.5) & (middle[:, 2:] < 2.0))
    in_range = (ratios[..., :2] > 0.7) & (ratios[..., :2] < 1.4)
    assert np.mean(in_range) >= 0.8
