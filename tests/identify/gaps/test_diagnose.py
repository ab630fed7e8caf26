"""One mass between stops, simulated in a moment: the whole road from recordings to a verdict."""

import re
from dataclasses import replace as with_fields
from typing import Annotated, ClassVar

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.gaps.decision import answer
from identify.gaps.decision.answer import Simulator, diagnose
from identify.gaps.decision.null_reference import null_reference_key, null_reference_of
from identify.gaps.decision.recordings import channel_fault, cut_recording
from identify.gaps.decision_table import Verdict
from identify.gaps.residual.record import CountedBandAndEnd
from identify.gaps.results import Matters
from identify.gaps.search import candidates
from rig.effects import effect_named, effects
from rig.effects.base import Effect
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.parameters import Parameter
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import Recording
from rig.simulation.excitation import force_history
from rig.simulation.reference import Sdof
from rig.simulation.replay import modal

pytestmark = pytest.mark.long

SETTINGS = Sdof(sensors="displacement", duration_s=20.0)
RIG = SETTINGS.rig()
RIG = replace(RIG, sensors=tuple(replace(s, noise_density=1e-7) for s in RIG.sensors))


def force(seed: int, rms_n: float) -> np.ndarray:
    excitation = replace(SETTINGS, seed=seed, rms_n=rms_n).force()
    return force_history(excitation, SETTINGS.duration_s, 1 / RIG.sample_rate_hz)


SIMULATOR = Simulator("modal", modal)


@pytest.fixture(scope="session")
def null_reference(tmp_path_factory):
    """The null references of the rig at the forces of both records, made once."""
    path = tmp_path_factory.mktemp("null_reference") / "null_reference.json"
    for record in records(RIG, RIG):
        null_reference_of(record, LABORATORY, modal, "modal", path=path)
    return path


def records(*actual: Rig) -> list[Recording]:
    return [
        modal(RIG, machine, force(seed, rms), seed)
        for seed, (machine, rms) in enumerate(zip(actual, (0.5, 0.7), strict=True))
    ]


def diagnosed(actual: Rig, null_reference, **asked):
    return diagnose(*records(actual, actual), SIMULATOR, null_reference, **asked)


def test_the_nominal_rig_is_consistent_within_what_matters(null_reference):
    """Twenty seconds bound the stop's force within 4 %, which is no 3 %."""
    gap, corrected = diagnosed(RIG, null_reference, matters=Matters(contact=0.05))
    assert gap.verdict == "consistent"
    assert gap.not_seen == ()
    (_, force_of_stop, *_) = gap.evidence.quantities
    assert 0.03 < force_of_stop.upper < 0.05
    assert corrected == RIG
    assert gap.evidence.p_value > 0.01
    assert gap.notes == ()
    assert gap.probability_nothing > 0.5


@pytest.mark.parametrize(
    ("text", "parameter", "value"),
    [
        ("contact_clearance:factor=1.1", "contact_clearance.factor", 1.1),
        ("coulomb_friction:force_n=0.3", "coulomb_friction.force_n", 0.3),
        ("added_mass:mass_kg=0.2", "added_mass.mass_kg", 0.2),
    ],
)
def test_an_effect_is_named_with_its_size(text, parameter, value, null_reference):
    actual = effect_named(text).applied_to(RIG)
    gap, corrected = diagnosed(actual, null_reference)
    assert gap.verdict == "explained"
    assert gap.causes[0].effects == (text.partition(":")[0],)
    assert gap.notes == ()
    estimate = gap.causes[0].parameters[parameter]
    assert estimate.value == pytest.approx(value, rel=0.05)
    stated, half_width = map(float, re.search(r"([0-9.]+) ± ([0-9.]+)", gap.sentence).groups())
    scale = {"factor": 100, "mass_kg": 1000}.get(parameter.partition(".")[2], 1)  # a change in per cent, and g
    neutral = 1 if parameter.endswith("factor") else 0
    assert half_width == pytest.approx(scale * 1.96 * estimate.standard_error, rel=0.06)  # to two digits
    assert stated == pytest.approx(scale * (estimate.value - neutral), abs=0.06 * half_width)
    assert gap.causes[0].explained > 0.9
    assert corrected != RIG
    total = sum(c.probability for c in gap.causes) + gap.probability_nothing + gap.probability_unknown
    assert total == pytest.approx(1.0)


def test_a_side_analysis_that_fails_is_a_note_and_no_loss(monkeypatch, null_reference):
    def fails(*_):
        raise ZeroDivisionError("no such thing")

    monkeypatch.setattr(answer, "attribution", fails)
    gap, corrected = diagnosed(effect_named("contact_clearance:factor=1.1").applied_to(RIG), null_reference)
    assert gap.verdict == "explained"
    assert gap.causes[0].parameters["contact_clearance.factor"].value == pytest.approx(1.1, rel=0.01)
    assert corrected.contacts[0].law.upper_clearance_m == pytest.approx(1.1e-3, rel=0.01)
    assert {note.analysis: note.reason for note in gap.notes} == {"attribution": "ZeroDivisionError: no such thing"}
    assert gap.attribution.time_s == ()


def test_an_effect_in_a_file_of_its_own_is_found_by_itself(monkeypatch, null_reference):
    class GrowingLag(Effect, frozen=True):
        """The force channel is late by more than anybody thought."""

        name: ClassVar[str] = "growing_lag"
        words: ClassVar[str] = "a force channel that is late by {lag_s}"
        lag_s: Annotated[float, Parameter("s", 0.0, 0.02, 0.0)] = 2e-3

        def applied_to(self, rig: Rig) -> Rig:
            return replace(rig, force_sensor=replace(rig.force_sensor, lag_s=rig.force_sensor.lag_s + self.lag_s))

    library = {name: kind for name, kind in effects().items() if name != "force_shift"}
    monkeypatch.setattr(candidates, "effects", lambda: {**library, GrowingLag.name: GrowingLag})
    gap, _ = diagnosed(GrowingLag(lag_s=6e-3).applied_to(RIG), null_reference)
    assert gap.causes[0].effects == ("growing_lag",)
    assert gap.causes[0].parameters["growing_lag.lag_s"].value == pytest.approx(6e-3, rel=0.05)


@pytest.mark.parametrize(
    ("text", "verdict"), [("contact_clearance:factor=1.1", Verdict.EXPLAINED), ("", Verdict.CANNOT_TELL)]
)
@pytest.mark.study
def test_what_the_validation_hardly_reaches_is_not_called_consistent(text, verdict):
    """The contact closes in the record that is fitted, and hardly in the other."""
    actual = effect_named(text).applied_to(RIG) if text else RIG
    gap, corrected = diagnose(modal(RIG, actual, force(0, 0.5), 0), modal(RIG, actual, force(1, 0.03), 1), SIMULATOR)
    assert gap.verdict == verdict
    assert [quantity.name for quantity in gap.not_seen] == ["force of stop"]
    assert (corrected == RIG) == (verdict == Verdict.CANNOT_TELL)
    if verdict == Verdict.EXPLAINED:
        assert gap.sentence.startswith("A clearance of stop that is 9.9")
        assert "shows too little" in gap.sentence


def test_another_rigs_validation_is_refused(null_reference):
    fit, validation = records(RIG, RIG)
    of_another_rig = with_fields(validation, rig=replace(RIG, name="other"))
    with pytest.raises(RigError, match="of another rig"):
        diagnose(fit, of_another_rig, SIMULATOR, null_reference)


def refuse(_believed: Rig, _actual: Rig, _force_n: np.ndarray, _seed: int) -> Recording:
    pytest.fail("the null reference was made again")


@pytest.mark.parametrize(
    "damaged",
    [
        lambda _: b"nothing of the kind",
        lambda _: b"",
        lambda content: content[: len(content) // 2],
        lambda content: content.replace(b'"law":', b'"law":1', 1),
        lambda content: content.replace(b'"key":"', b'"key":"0', 1),
    ],
    ids=["other", "empty", "cut", "another number", "of another rig"],
)
def test_a_null_reference_that_is_damaged_or_of_another_rig_is_made_anew(tmp_path, damaged):
    path = tmp_path / "one.null_reference.json"
    _, validation = records(RIG, RIG)
    made = null_reference_of(validation, LABORATORY, modal, "modal", path=path, simulation_count=2)
    content = path.read_bytes()
    assert null_reference_of(validation, LABORATORY, refuse, "modal", path=path, simulation_count=2) == made
    path.write_bytes(damaged(content))
    assert null_reference_of(validation, LABORATORY, modal, "modal", path=path, simulation_count=2) == made
    assert path.read_bytes() == content


def test_the_key_of_a_null_reference_tells_all_that_it_depends_on(monkeypatch):
    _, validation = records(RIG, RIG)
    force, counted = with_values(validation, "force", 1.5 * validation.forces_n), CountedBandAndEnd(8, 9.0)
    keys = [
        null_reference_key(validation, counted, LABORATORY, "modal"),
        null_reference_key(validation, counted, EXACT, "modal"),
        null_reference_key(validation, counted, LABORATORY, "ancf"),
        null_reference_key(validation, counted, LABORATORY, "modal", simulation_count=5),
        null_reference_key(with_fields(validation, rig=replace(RIG, name="other")), counted, LABORATORY, "modal"),
        null_reference_key(force, counted, LABORATORY, "modal"),
        null_reference_key(validation, CountedBandAndEnd(8, 6.0), LABORATORY, "modal"),
        null_reference_key(validation, CountedBandAndEnd(4, 9.0), LABORATORY, "modal"),
    ]
    monkeypatch.setattr("importlib.metadata.version", lambda _: "another version")
    keys.append(null_reference_key(validation, counted, LABORATORY, "modal"))
    assert len(set(keys)) == len(keys)


def with_values(recording: Recording, quantity: str, values: np.ndarray) -> Recording:
    changed = with_fields(recording.signals[quantity], values=values)
    return with_fields(recording, signals={**recording.signals, quantity: changed})


def test_a_file_of_something_else_is_not_lost_to_a_null_reference(tmp_path):
    path = tmp_path / "notes.json"
    path.write_text("my notes")
    with pytest.raises(RigError, match=r"notes.json: is no null reference, and is not written over"):
        null_reference_of(records(RIG, RIG)[1], LABORATORY, refuse, "modal", path=path, simulation_count=2)
    assert path.read_text() == "my notes"


def test_a_short_record_is_refused(null_reference):
    short = [cut_recording(recording, slice(2000)) for recording in records(RIG, RIG)]
    with pytest.raises(RigError, match=r"lasts 3.91 s; the diagnosis needs"):
        diagnose(*short, SIMULATOR, null_reference)


@pytest.mark.parametrize(
    ("change", "fault"), [(lambda x: 0 * x, "dead"), (lambda x: np.clip(x, -1.0, 1.0), "clipped"), (lambda x: x, None)]
)
def test_dead_and_clipped_channels_are_what_they_are(change, fault):
    assert channel_fault(change(np.random.default_rng(1).standard_normal(10_000))) == fault


def test_a_record_of_dead_channels_is_refused(null_reference):
    dead = [with_values(recording, "displacement", np.zeros((1, recording.samples))) for recording in records(RIG, RIG)]
    with pytest.raises(RigError, match="every channel is dead or clipped"):
        diagnose(*dead, SIMULATOR, null_reference)


def test_what_the_named_effects_account_for_is_no_finding_of_the_check(null_reference):
    heavier = effect_named("added_mass:mass_kg=0.1").applied_to(RIG)
    measured = records(heavier, heavier)
    assert identify.check(measured[0]).findings
    result = identify.gap(measured, null_reference=null_reference)
    assert result.report.verdict == "explained"
    assert result.findings == ()
