"""The next experiment, for one mass between stops."""

from dataclasses import replace as with_fields

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision import experiment
from identify.gaps.decision.experiment import (
    common_fit_start,
    disagreement_cost,
    experiments,
    next_experiments,
    refit_hypothesis,
)
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import SAME_EXPERIMENT
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search
from identify.gaps.search.nominal import fit_nuisance
from rig.effects import effect_named
from rig.errors import RigError
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle, Sdof
from rig.simulation.replay import modal

SETTINGS = Sdof(sensors="displacement", duration_s=15.0)
RIG = replace(SETTINGS.rig(), sensors=tuple(replace(s, noise_density=1e-7) for s in SETTINGS.rig().sensors))


@pytest.fixture(scope="module")
def believed():
    force_n = force_history(SETTINGS.force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)
    return record_of(modal(RIG, RIG, force_n, 1)), force_n[None]


@pytest.fixture(scope="module")
def cause(believed):
    """A cause at some value, known as exactly as its standard error says."""
    record, _ = believed
    search = Search(nominal_variances_of(linearized(record, RIG)), *fit_nuisance(record, RIG), ())
    nothing = search.nominal_fit().hypothesis
    library = candidates(effect_range_scale(record, RIG), [s.name for s in RIG.sensors], record.zero_known)

    def hypothesis(name, value, error):
        candidate = next(c for c in library if c.kind.name == name)
        values, covariance = np.array([value]), np.array([[error**2]])
        return with_fields(nothing, candidates=(candidate,), values=values, covariance=covariance)

    return hypothesis


def test_experiments_keep_the_silence_and_the_level_that_they_name(believed):
    record, force_n = believed
    options = list(experiments(record, force_n))
    start = round(record.excitation_start_s * record.sample_rate_hz)
    rms_n = np.std(options[0].forces_n[:, start:])
    assert options[0].instruction == SAME_EXPERIMENT
    assert len({option.instruction for option in options}) == len(options)
    for option in options:
        assert not np.any(option.forces_n[:, : round(0.9 * record.sample_rate_hz)])
        before, times, _ = option.instruction.partition(" times the force")
        factor = float(before.split()[-1]) if times else 1.0
        assert np.std(option.forces_n[:, start:]) == pytest.approx(factor * rms_n, rel=0.01)
    lengths_s = {round(option.forces_n.shape[1] / record.sample_rate_hz, 2) for option in options}
    assert lengths_s == {15.0, 45.0}
    assert sum(option.rig_change(RIG).masses != RIG.masses for option in options) == 1


def test_of_beams_the_force_moves_and_displacements_are_measured():
    rig = BarrelCradle(sensors="acceleration", duration_s=12.0).rig()
    force_n = force_history(BarrelCradle().force(), 12.0, 1 / rig.sample_rate_hz)
    changed = [e.rig_change(rig) for e in experiments(record_of(modal(rig, rig, force_n, 1)), force_n[None])]
    places = {(r.force_at.body, r.force_at.position_m) for r in changed}
    assert places == {(body, x) for body in ("barrel", "cradle") for x in (0.5, 1.0)}
    assert [{s.quantity for s in r.sensors} for r in changed].count({"displacement"}) == 1


@pytest.fixture
def three_experiments(monkeypatch):
    """Two experiments, as each costs seconds."""
    all_experiments = experiment.experiments
    monkeypatch.setattr(experiment, "experiments", lambda *given: list(all_experiments(*given))[:3])


@pytest.mark.usefixtures("three_experiments")
@pytest.mark.study
def test_what_differs_is_told_by_some_experiment_and_what_does_not_by_none(believed, cause):
    record, force_n = believed
    softer, stiffer = (cause("contact_stiffness", factor, 0.01) for factor in (0.9, 1.1))
    proposals = next_experiments(record, force_n, (softer, stiffer), modal)
    assert proposals[0].log_odds > 1
    log_odds = [proposal.log_odds for proposal in proposals]
    assert log_odds == sorted(log_odds, reverse=True)
    alike = next_experiments(record, force_n, (softer, softer), modal)
    assert max(abs(a.log_odds) for a in alike) < 0.1


@pytest.mark.usefixtures("three_experiments")
@pytest.mark.study
def test_a_rival_that_is_hardly_known_may_change(believed, cause):
    """Of one effect at two values that the first record leaves open, no record can say which is the true one."""
    record, force_n = believed
    softer, stiffer = (cause("contact_stiffness", factor, 1.0) for factor in (0.9, 1.1))
    proposals = next_experiments(record, force_n, (softer, stiffer), modal)
    assert max(abs(proposal.log_odds) for proposal in proposals) < 0.2


def test_refitted_finds_the_value_and_two_values_disagree_by_their_errors(believed, cause):
    _, force_n = believed
    actual = effect_named("contact_stiffness:factor=1.1").applied_to(RIG)
    record = record_of(modal(RIG, actual, force_n, 2))
    start = common_fit_start(record, RIG)
    refit = refit_hypothesis(start, cause("contact_stiffness", 0.9, 0.1))
    assert refit.values[0] == pytest.approx(1.1, abs=0.02)
    first, second = cause("contact_stiffness", 1.0, 0.03), cause("contact_stiffness", 1.1, 0.04)
    assert disagreement_cost(first, second) == pytest.approx((0.1 / 0.05) ** 2)
    with pytest.raises(RigError):
        refit_hypothesis(start, cause("contact_stiffness", -1.0, 0.1))
