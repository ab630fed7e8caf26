"""What true effects achieve, on a short recording of the modal plant."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from rig.effects import effect_named
from rig.recording import writing
from rig.simulation.replay import modal
from scenarios.true_effect import ToLay, achieved
from scenarios.worlds.believed import believed_rig
from tests.scenarios.blind_cases import effect

SECONDS, LEVEL_N, HIGHEST_HZ = 10.0, 15.0, 150.0
MASS = effect("added_mass", {"body": "barrel", "position_m": 0.5}, mass_kg=0.3, relative_position=0.5)
FAINT = effect("youngs_modulus", {"beam": "cradle"}, factor=1.00001)


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """A recording of the rig with the mass, and what may be asked of it."""
    path = tmp_path_factory.mktemp("records") / "mass.mcap"
    rig = believed_rig("own", np.random.default_rng(1))
    low_pass = butter(4, HIGHEST_HZ, fs=rig.sample_rate_hz, output="sos")
    noise = np.random.default_rng(2).standard_normal(round(SECONDS * rig.sample_rate_hz))
    force_n = sosfilt(low_pass, noise)
    force_n *= LEVEL_N / force_n.std()
    run = modal(rig, effect_named(MASS.text).applied_to(rig), force_n, 1)
    with writing(path, rig, {n: s.channels for n, s in run.signals.items()}, {}) as recording:
        recording.append_all({n: s.values for n, s in run.signals.items()})
    return lambda *effects: ToLay(str(path), str(path), tuple(e.text for e in effects), None)


def test_each_of_a_pair_is_judged_beside_the_other(asked):
    best = achieved(asked(MASS, FAINT))
    mass, faint = best.effects
    assert best.before > mass.made / 2 > 5
    assert (mass.above, faint.above, best.above) == (True, False, False)
    assert mass.limit(1.0) < 1 < faint.limit(1.0)
    assert best.closes > 0.9


def test_without_effects_the_gap_alone_is_laid(asked):
    best = achieved(asked())
    assert (best.effects, best.closes, best.above) == ((), 0.0, False)
    assert best.before > 10
