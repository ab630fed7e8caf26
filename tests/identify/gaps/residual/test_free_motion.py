"""Free decays of two beams: the free motion of their modes as unknowns of the linear model, beside effects."""

import numpy as np
import pytest

from identify.gaps.residual.extent import OMITTED_RELEASE_S
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.nuisance import residual_in_time
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search, fit_effects
from identify.gaps.search.nominal import fit_nuisance
from identify.linear.sampled_motion import free_motion
from rig.effects import effect_named
from tests.campaigns.laboratory_tests import TESTS, recorded

DECAY = TESTS["two beams, free decay, displacements"]


def decay(folder, effect="", jitter=None):
    return record_of(recorded(DECAY, folder / "r.mcap", 14.0, jitter, effect=effect))


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    return decay(tmp_path_factory.mktemp("decay"))


def test_each_column_is_the_free_motion_of_a_mode(record):
    model = linearized(record, record.rig).model
    assert record.residual_times_s[0] == pytest.approx(OMITTED_RELEASE_S, abs=0.01)
    assert len(model.free_modes) > 5
    for motion in model.free_modes:
        dynamics = model.responses[motion.body_index].dynamics
        hz, zeta = dynamics.natural_hz[motion.mode_index], dynamics.damping_ratios[motion.mode_index]
        if not hz:  # rests or drifts
            continue
        rows = [free_motion(hz, zeta, first, record.sample_times_s)[0] for first in (0, 1)]
        sampled = np.array([record.spectrum(row) * (1j * record.omega) ** 2 for row in rows])
        error = np.linalg.norm(record.sample_rate_hz * motion.unit_accelerations - sampled, axis=1)
        assert np.all(error < 0.02 * np.linalg.norm(sampled, axis=1))


def test_the_linear_residual_of_a_free_decay_is_noise_for_the_rig_that_made_it_alone(record):
    softer = effect_named("youngs_modulus:factor=0.95").applied_to(record.rig)
    levels = [
        np.mean(residual_in_time(record, linearized(record, rig).model.residual) ** 2) for rig in (record.rig, softer)
    ]
    assert levels[0] < 3
    assert levels[1] > 100 * levels[0]


@pytest.mark.parametrize(
    ("effect", "strength", "true"),
    [
        pytest.param("contact_clearance:all", "factor", 1.2, marks=pytest.mark.study),
        pytest.param("added_mass:barrel", "mass_kg", 0.1, marks=pytest.mark.study),
        ("contact_stiffness:all", "factor", 1.3),
    ],
)
def test_an_effect_is_fitted_beside_the_free_motion(effect, strength, true, tmp_path):
    """Estimate on the decay of a rig that differs within the tolerances."""
    record = decay(tmp_path, f"{effect.split(':')[0]}:{strength}={true}", jitter=1)
    every_candidate = candidates(effect_range_scale(record, record.rig), (), record.zero_known, has_force=False)
    (candidate,) = [c for c in every_candidate if c.name == effect]
    linearization, residual = fit_nuisance(record, record.rig)
    search = Search(nominal_variances_of(linearized(record, record.rig)), linearization, residual, (candidate,))
    estimate = fit_effects(search, (candidate,), candidate.typical_values, residual).hypothesis
    deviation = np.sqrt(estimate.covariance[0, 0])
    assert abs(estimate.values[0] - true) < 3 * deviation < 0.2 * true
