"""One mass between stops, simulated in a moment: the whole road from recordings to a verdict."""

from dataclasses import replace as with_fields
from typing import Annotated, ClassVar

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gap import candidates
from identify.gap.answer import diagnose
from identify.gap.faults import fault_of
from identify.gap.floor import floors_of
from rig.description import Rig
from rig.effect import Effect, Parameter
from rig.effects import effect_named, effects
from rig.errors import RigError
from rig.excitation import force_history
from rig.recording import Recording, Signals
from rig.reference import Sdof
from rig.replay import modal

SETTINGS = Sdof(sensors="displacement", duration_s=20.0)
RIG = SETTINGS.rig()
RIG = replace(RIG, sensors=tuple(replace(s, noise_density=1e-7) for s in RIG.sensors))


def force(seed: int, rms_n: float) -> np.ndarray:
    excitation = replace(SETTINGS, seed=seed, rms_n=rms_n).force()
    return force_history(excitation, SETTINGS.duration_s, 1 / RIG.sample_rate_hz)


@pytest.fixture(scope="session")
def floor_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("floor") / "floor.json"
    floors_of(RIG, force(5, 0.7), modal, lambda _: None, nulls=3, kept=path)
    return path


def records(*actual: Rig) -> list[Recording]:
    return [
        modal(RIG, one, force(seed, rms), seed) for seed, (one, rms) in enumerate(zip(actual, (0.5, 0.7), strict=True))
    ]


def diagnosed(actual: Rig, floor_file):
    return diagnose(*records(actual, actual), modal, floor_file)


def test_the_believed_rig_has_no_gap(floor_file):
    gap, corrected = diagnosed(RIG, floor_file)
    assert gap.verdict == "no_gap"
    assert corrected == RIG
    assert gap.closure.closed_fraction is None


@pytest.mark.parametrize(
    ("text", "parameter", "value"),
    [
        ("contact_clearance:factor=1.1", "contact_clearance.factor", 1.1),
        ("coulomb_friction:force_n=0.1", "coulomb_friction.force_n", 0.1),
        ("added_mass:mass_kg=0.2", "added_mass.mass_kg", 0.2),
    ],
)
def test_an_effect_is_named_with_its_size(text, parameter, value, floor_file):
    actual = effect_named(text).applied_to(RIG)
    gap, corrected = diagnosed(actual, floor_file)
    assert gap.verdict == "effect"
    assert gap.causes[0].effects == (text.partition(":")[0],)
    found = gap.causes[0].parameters[parameter]
    assert found.value == pytest.approx(value, rel=0.02)
    assert abs(found.value - value) < 3 * found.standard_error
    assert gap.causes[0].probability > 0.9
    assert gap.closure.closed_fraction > 0.95
    assert corrected != RIG


def test_an_effect_in_a_file_of_its_own_is_found_by_itself(monkeypatch, floor_file):
    class HeldBySpring(Effect, frozen=True):
        """A linear spring that nobody counted holds the mass."""

        name: ClassVar[str] = "held_by_spring"
        stiffness_n_per_m: Annotated[float, Parameter("N/m", 0.0, 2000.0)] = 200.0

        def applied_to(self, rig: Rig) -> Rig:
            mass = rig.bodies[0]
            omega = 2 * np.pi * mass.frequency_hz
            stiffer = float(np.sqrt(omega**2 + self.stiffness_n_per_m / mass.mass_kg)) / (2 * np.pi)
            return replace(rig, bodies=(replace(mass, frequency_hz=stiffer),))

    monkeypatch.setattr(candidates, "effects", lambda: {**effects(), HeldBySpring.name: HeldBySpring})
    gap, _ = diagnosed(HeldBySpring(stiffness_n_per_m=60.0).applied_to(RIG), floor_file)
    assert gap.causes[0].effects == ("held_by_spring",)
    assert gap.causes[0].parameters["held_by_spring.stiffness_n_per_m"].value == pytest.approx(60.0, rel=0.05)


def test_another_rigs_validation_is_refused(floor_file):
    fit, validation = records(RIG, RIG)
    other = with_fields(validation, rig=replace(RIG, name="other"))
    with pytest.raises(RigError, match="of another rig"):
        diagnose(fit, other, modal, floor_file)


def test_a_floors_of_another_rig_is_refused(floor_file):
    fit, validation = records(RIG, RIG)
    others = [with_fields(one, rig=replace(RIG, name="other")) for one in (fit, validation)]
    with pytest.raises(RigError, match="is the floor of another rig"):
        diagnose(*others, modal, floor_file)


def test_a_short_record_is_refused(floor_file):
    short = [
        with_fields(one, signals={n: Signals(s.channels, 0.0, s.values[:, :2000]) for n, s in one.signals.items()})
        for one in records(RIG, RIG)
    ]
    with pytest.raises(RigError, match=r"lasts 3.91 s; the diagnosis needs"):
        diagnose(*short, modal, floor_file)


@pytest.mark.parametrize(
    ("change", "fault"),
    [(lambda x: 0 * x, "dead"), (lambda x: np.clip(x, -1.0, 1.0), "clipped"), (lambda x: x, None)],
)
def test_dead_and_clipped_channels_are_what_they_are(change, fault):
    assert fault_of(change(np.random.default_rng(1).standard_normal(10_000))) == fault


def test_a_record_of_dead_channels_is_refused(floor_file):
    dead = []
    for one in records(RIG, RIG):
        moved = one.signals["displacement"]
        dead.append(
            with_fields(one, signals={**one.signals, "displacement": with_fields(moved, values=0 * moved.values)})
        )
    with pytest.raises(RigError, match="every channel is dead or clipped"):
        diagnose(*dead, modal, floor_file)
