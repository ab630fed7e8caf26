"""What true effects achieve, on a short recording of the modal plant."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from rig.effects import effect_named
from rig.recording import writing
from rig.simulation.replay import modal
from tests.campaigns.true_effect import ToLay, achieved, log_prior, needed
from tests.campaigns.worlds.believed import believed_rig
from tests.test_campaigns.blind_cases import effect

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
    return lambda *effects: ToLay(str(path), str(path), tuple(e.text for e in effects))


@pytest.mark.study
def test_each_of_a_pair_is_judged_beside_the_other(asked):
    best = achieved(asked(MASS, FAINT))
    mass, faint = best.effects
    assert best.before > mass.made / 2 > 5
    assert (mass.above, faint.above) == (True, False)
    assert mass.limit(1.0) < 1 < faint.limit(1.0)


def test_without_effects_the_gap_alone_is_laid(asked):
    best = achieved(asked())
    assert (best.effects, best.refusal) == ((), "")
    assert best.before > 10


def test_records_that_allow_no_limits_say_why(tmp_path):
    nowhere = str(tmp_path / "none.mcap")
    best = achieved(ToLay(nowhere, nowhere, (MASS.text,)))
    assert best.effects == ()
    assert "none.mcap" in best.refusal


def test_limits_ask_for_the_priors_that_they_were_set_with():
    placed = {"a": 2, "b": 3, "c": 1, "d": 1}
    assert log_prior([], placed) == pytest.approx(np.log(0.3))
    assert log_prior(["a"], placed) == pytest.approx(np.log(0.35 / 4 / 2))
    assert log_prior(["a", "b"], placed) == pytest.approx(np.log(0.15 / 6 / 2 / 3))
    assert log_prior(["a", "b", "b"], placed) == pytest.approx(np.log(0.15 * (0.15 / 0.35) / 4 / 2 / 3 / 3))
    assert needed("a:factor=2", [], placed) == pytest.approx(12 * np.log(0.3 * 4 * 2 / 0.35))
    assert needed("a", ["b"], placed) == pytest.approx(12 * np.log(0.35 / 4 / 3 / (0.15 / 6 / 2 / 3)))


def test_what_the_library_does_not_offer_is_below_its_limit_and_hides_no_other():
    placed = {"a": 2, "b": 3}
    assert needed("z", ["a"], placed) is None
    assert needed("a", ["z"], placed) == needed("a", [], placed)
