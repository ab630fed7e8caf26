"""What is attached to a point of a body: its column by the measured motion beside that of the whole model."""

import numpy as np
import pytest

from identify.gaps.residual.residual import linearized, residual_decrease, residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import attachment_residual_decrease
from rig.effects import effect_named
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal

SETTINGS = BarrelCradle(sensors="acceleration", duration_s=12.0, noise_density=1e-4)
RIG = SETTINGS.rig()


@pytest.fixture(scope="module")
def believed():
    force_n = force_history(SETTINGS.force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)
    linearization = linearized(record_of(modal(RIG, RIG, force_n, 1)), RIG)
    return linearization, residual_of(linearization, RIG)


@pytest.mark.parametrize("body", ["cradle", "barrel"])
@pytest.mark.parametrize(
    "effect",
    [
        "added_mass:mass_kg=0.001",
        "linear_spring:stiffness_n_per_m=1",
        "hardening_spring:cubic_n_per_m3=1000",
        "ground_damper:damping_n_s_per_m=0.01",
        "ground_friction:force_n=0.001",
        "tone:cosine_n=0.01,frequency_hz=40",
    ],
)
def test_its_column_is_that_of_the_model(believed, effect, body):
    linearization, at = believed
    moved = effect_named(f"{effect},relative_position=0.7,body={body}").applied_to(RIG)
    (linear, contacts), (expected, laws) = (
        attachment_residual_decrease(linearization, moved, at),
        residual_decrease(linearization, moved, at),
    )
    assert np.linalg.norm(linear - expected) < 0.05 * np.linalg.norm(expected)
    assert all(np.corrcoef(a, b)[0, 1] > 0.9 for a, b in zip(contacts, laws, strict=True))


def test_of_any_other_rig_there_is_none(believed):
    linearization, at = believed
    assert attachment_residual_decrease(linearization, RIG, at) is None
    assert (
        attachment_residual_decrease(linearization, effect_named("force_gain:factor=1.1").applied_to(RIG), at) is None
    )
