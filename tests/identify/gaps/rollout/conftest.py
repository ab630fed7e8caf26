"""Two-beam records of 30 s by the modal plant, accelerometers alone, each with an effect, and fits of rigs to them."""

from dataclasses import dataclass

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import norm

from identify.gaps.decision.null_simulations import draw_rig
from identify.gaps.residual.residual import Residual
from identify.gaps.residual.spectra import record_of
from identify.gaps.rollout.judge import judge_correction
from identify.gaps.rollout.results import NullErrors, Rollout
from identify.gaps.rollout.windows import null_errors
from identify.gaps.search.nominal import fit_nuisance
from rig.effects import effect_named
from rig.model.tolerances import LABORATORY
from rig.recording import Recording
from rig.simulation import prediction, replay
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle

SETTINGS = BarrelCradle(sensors="acceleration", noise_density=1e-3, duration_s=30.0, rms_n=18.0)
BELIEVED = SETTINGS.rig()
CLEARANCE = "contact_clearance:factor=1.1,contact=contact_1"
DAMPING = "contact_damping:damping_n_s_per_m=40"
FRICTION = "coulomb_friction:force_n=0.8"


@dataclass(frozen=True)
class Case:
    """A recording of a machine that is believed to be the reference rig."""

    recording: Recording

    def fitted(self, *effects: str) -> Residual:
        """The believed rig with effects, fitted to the recording."""
        return fit_nuisance(record_of(self.recording), with_effects(BELIEVED, *effects))[1]

    def judged(self, nulls: list[NullErrors], *effects: str) -> Rollout:
        """The believed rig corrected by effects."""
        return judge_correction(self.recording, self.fitted(), self.fitted(*effects), nulls, prediction.modal)


def machine(seed):
    """The reference rig as a laboratory builds it."""
    return draw_rig(BELIEVED, LABORATORY, norm.ppf(np.random.default_rng(seed).uniform(0.2, 0.8, 700)))


def recorded(actual, seed):
    force_n = force_history(replace(SETTINGS, seed=seed).force(), SETTINGS.duration_s, 1 / BELIEVED.sample_rate_hz)
    return replay.modal(BELIEVED, actual, force_n, seed)


def with_effects(rig, *effects):
    for effect in effects:
        rig = effect_named(effect).applied_to(rig)
    return rig


@pytest.fixture(scope="session")
def null():
    return Case(recorded(machine(1), 1))


@pytest.fixture(scope="session")
def wide_clearance():
    return Case(recorded(with_effects(machine(2), CLEARANCE), 2))


@pytest.fixture(scope="session")
def damped():
    return Case(recorded(with_effects(machine(3), DAMPING), 3))


@pytest.fixture(scope="session")
def nulls():
    """Errors of three null simulations."""
    cases = [Case(recorded(machine(seed), seed)) for seed in (11, 12, 13)]
    return [null_errors(case.recording, case.fitted(), prediction.modal) for case in cases]
