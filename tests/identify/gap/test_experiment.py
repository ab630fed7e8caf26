"""The next experiment, for one mass between stops."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gap.decision.experiment import experiments, next_experiments
from identify.gap.spectra import record_of
from rig.effects import effect_named
from rig.excitation import force_history
from rig.reference import Sdof
from rig.replay import modal

SETTINGS = Sdof(sensors="displacement", duration_s=15.0)
RIG = replace(SETTINGS.rig(), sensors=tuple(replace(s, noise_density=1e-7) for s in SETTINGS.rig().sensors))


@pytest.fixture(scope="module")
def believed():
    force_n = force_history(SETTINGS.force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)
    return record_of(modal(RIG, RIG, force_n, 1)), force_n


def test_experiments_keep_the_silence_and_the_level_that_they_name(believed):
    record, force_n = believed
    tried = list(experiments(record, force_n))
    same = np.std(tried[0].force_n)
    assert len({t.words for t in tried}) == len(tried)
    for one in tried:
        assert not np.any(one.force_n[: round(0.9 * record.sample_rate_hz)])
        named = [w for w in one.words.split() if w.replace(".", "").isdigit()] if "times" in one.words else ["1"]
        assert np.std(one.force_n) == pytest.approx(float(named[0]) * same, rel=0.01)
    assert tried[-1].changed(RIG).masses != RIG.masses


def test_what_differs_is_told_by_some_experiment_and_what_does_not_by_none(believed):
    record, force_n = believed
    softer, stiffer = (effect_named(f"contact_stiffness:factor={f}").applied_to(RIG) for f in (0.9, 1.1))
    told = next_experiments(record, force_n, (softer, stiffer), modal)
    assert told[0].log_odds > 1
    assert [t.log_odds for t in told] == sorted((t.log_odds for t in told), reverse=True)
    alike = next_experiments(record, force_n, (softer, softer), modal)
    assert max(abs(a.log_odds) for a in alike) < 0.1
