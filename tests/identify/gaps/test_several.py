"""Several records of one rig: what they share, and what differs between them."""

from dataclasses import replace as with_fields

import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from identify.commands.cli import app
from identify.gaps.decision.answer import Simulator, diagnose
from identify.gaps.decision.differences import differences
from identify.gaps.decision.null_reference import null_reference_of
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search, fit_effects
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.pooled import fitted_to_all_records
from rig.effects import effect_named
from rig.errors import RigError
from rig.model.tolerances import LABORATORY
from rig.recording import writing
from rig.simulation.excitation import force_history
from rig.simulation.reference import Sdof
from rig.simulation.replay import modal

pytestmark = pytest.mark.long

SETTINGS = Sdof(sensors="displacement", duration_s=20.0)
RIG = replace(SETTINGS.rig(), sensors=tuple(replace(s, noise_density=1e-7) for s in SETTINGS.rig().sensors))
LEVELS_N = 0.5, 0.6, 0.7
SIMULATOR = Simulator("modal", modal)


def recordings(*actual):
    made = []
    for seed, (rig, rms_n) in enumerate(zip(actual, LEVELS_N, strict=True)):
        excitation = replace(SETTINGS, seed=seed, rms_n=rms_n).force()
        made.append(modal(RIG, rig, force_history(excitation, SETTINGS.duration_s, 1 / RIG.sample_rate_hz), seed))
    return made


def with_effect(text):
    return effect_named(text).applied_to(RIG)


def library(record):
    return candidates(effect_range_scale(record, RIG), [s.name for s in record.sensors], record.zero_known)


@pytest.fixture(scope="module")
def nominal():
    return recordings(RIG, RIG, RIG)


@pytest.fixture(scope="module")
def null_reference(tmp_path_factory, nominal):
    path = tmp_path_factory.mktemp("null_reference") / "null_reference.json"
    null_reference_of(nominal[2], LABORATORY, modal, "modal", path=path)
    return path


def nominal_variances(records):
    return [nominal_variances_of(linearized(record, record.rig)) for record in records]


def test_a_parameter_shared_by_two_records_is_tighter_and_right():
    mass_kg = 0.1
    records = [record_of(item) for item in recordings(*[with_effect(f"added_mass:mass_kg={mass_kg}")] * 3)[:2]]
    variances, candidates = nominal_variances(records), library(records[0])
    (candidate,) = [c for c in candidates if c.kind.name == "added_mass"]
    context = Search(variances[0], *fit_nuisance(records[0], RIG), tuple(candidates))
    first_record = fit_effects(context, (candidate,), np.array([0.5 * mass_kg]), context.nominal_residual).hypothesis
    first_pooled = fitted_to_all_records(records[:1], variances[:1], first_record)
    both_records = fitted_to_all_records(records, variances, first_record)
    errors = [float(np.sqrt(item.covariance[0, 0])) for item in (first_record, first_pooled, both_records)]
    assert first_pooled.values == pytest.approx(first_record.values, abs=0.5 * errors[0])
    assert errors[0] / 1.5 < errors[1] < 1.5 * errors[0]
    assert errors[2] < errors[1]
    assert both_records.values[0] == pytest.approx(mass_kg, abs=1.96 * errors[2])


@pytest.mark.study
def test_a_clearance_that_grows_is_told_and_a_stiffness_that_does_not_is_not(null_reference):
    wider = with_effect("contact_clearance:factor=1.05")
    gap, _ = diagnose(recordings(RIG, RIG, wider), None, SIMULATOR, null_reference)
    (clearance,) = gap.between.differing
    assert clearance.parameter == "contact_clearance.factor"
    assert clearance.trend == "grows"
    first, second, last = (value.value for value in clearance.values)
    errors = [value.standard_error for value in clearance.values]
    assert last / first == pytest.approx(1.05, abs=1.96 * np.hypot(errors[0], errors[2]))
    assert second == pytest.approx(first, abs=1.96 * np.hypot(errors[0], errors[1]))
    assert "contact_clearance.factor (stop) grows" in gap.sentence


@pytest.mark.study
def test_what_all_records_have_is_a_cause_and_no_difference(null_reference):
    gap, _ = diagnose(recordings(*[with_effect("contact_stiffness:factor=1.2")] * 3), None, SIMULATOR, null_reference)
    assert gap.causes[0].effects == ("contact_stiffness",)
    assert gap.between.differing == ()
    (row,) = gap.between.cause
    assert len(row.values) == 3
    assert gap.between.cause_p_value > 0.05
    assert gap.causes[0].parameters["contact_stiffness.factor"].value == pytest.approx(1.2, rel=0.05)


def test_nothing_differs_between_records_of_the_believed_rig(nominal):
    records = [record_of(recording) for recording in nominal]
    between = differences(
        records, nominal_variances(records), None, library(records[0]), ("1", "2", "3"), (1.0, 1.0, 1.0)
    )
    assert between.differing == between.cause == ()
    assert between.looked_at > 5


def test_any_record_validates_and_a_recording_counts_once(nominal, null_reference):
    of_another_rig = with_fields(nominal[1], rig=replace(RIG, name="other"))
    with pytest.raises(RigError, match="recording 2 is of another rig"):
        diagnose([nominal[0], of_another_rig, nominal[2]], None, SIMULATOR, null_reference)
    with pytest.raises(RigError, match="recording 3 is the same as an earlier one"):
        diagnose([*nominal[:2], with_fields(nominal[0])], None, SIMULATOR, null_reference)
    with pytest.raises(RigError, match="cannot validate itself"):
        diagnose(nominal[0], nominal[0], SIMULATOR, null_reference)
    with pytest.raises(RigError, match="no recording"):
        diagnose([], None, SIMULATOR, null_reference)


def test_a_file_given_twice_or_missing_is_named(nominal, tmp_path):
    paths = [tmp_path / f"{k}.mcap" for k in range(2)]
    for path, recording in zip(paths, nominal, strict=False):
        with writing(path, RIG, {n: s.channels for n, s in recording.signals.items()}, {}) as file:
            file.append_all({n: s.values for n, s in recording.signals.items()})

    def error(*arguments):
        return str(CliRunner().invoke(app, ["gap", *map(str, arguments)]).exception)

    assert "given twice" in error(*paths, tmp_path / "." / "0.mcap")
    assert "missing.mcap" in error(*paths, "--validate", tmp_path / "missing.mcap")
    assert "cannot validate itself" in error(paths[0], "--validate", paths[0])
