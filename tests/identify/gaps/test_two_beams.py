"""Two beams that meet at two contacts, by accelerometers alone: the whole road, on short records."""

from functools import reduce

import pytest
from msgspec.structs import replace

from identify.gaps.decision.answer import DEFAULT_MATTERS, Simulator, diagnose
from identify.gaps.decision.null_reference import null_reference_of
from identify.gaps.results import Matters
from rig.effects import effect_named
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, Station
from rig.model.tolerances import LABORATORY
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal

pytestmark = pytest.mark.long

SETTINGS = BarrelCradle(
    sensors="acceleration", stations=4, duration_s=14.0, noise_density=1e-3, sample_rate_hz=2048.0, high_hz=60.0
)
RIG = SETTINGS.rig()


def records(actual=RIG):
    """Two records of a rig that is described as RIG."""
    made = []
    for seed in (1, 2):
        force_n = force_history(replace(SETTINGS, seed=seed).force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)
        made.append(modal(RIG, actual, force_n, seed))
    return made


@pytest.fixture(scope="module")
def null_reference(tmp_path_factory):
    path = tmp_path_factory.mktemp("null_reference") / "null_reference.json"
    null_reference_of(records()[1], LABORATORY, modal, "modal", path=path)
    return path


def diagnosed(actual, null_reference, matters=DEFAULT_MATTERS):
    return diagnose(*records(actual), Simulator("modal", modal), null_reference, matters=matters)


@pytest.mark.study
def test_the_nominal_rig_is_consistent(null_reference):
    """14 s bound the force of a contact to 4.3 % by these forces; 28 s by others still to 3.8 %."""
    gap, corrected = diagnosed(RIG, null_reference, Matters(contact=0.1))
    assert gap.verdict == "consistent"
    assert corrected == RIG


@pytest.mark.parametrize(
    ("effects", "parameter", "value"),
    [
        pytest.param(
            ("base_motion:acceleration_rms_m_per_s2=0.3,low_hz=10,high_hz=20",),
            "base_motion.acceleration_rms_m_per_s2",
            0.3,
            marks=pytest.mark.study,
        ),
        pytest.param(
            ("contact_clearance:factor=1.2,contact=contact_1", "added_mass:mass_kg=0.2"),
            "added_mass.mass_kg",
            0.2,
            marks=pytest.mark.study,
        ),
    ],
)
def test_effects_are_named_with_their_size(null_reference, effects, parameter, value):
    actual = reduce(lambda rig, text: effect_named(text).applied_to(rig), effects, RIG)
    gap, _ = diagnosed(actual, null_reference)
    assert set(gap.causes[0].effects) == {text.split(":")[0] for text in effects}
    estimate = gap.causes[0].parameters[parameter]
    assert abs(estimate.value - value) < 4 * estimate.standard_error


@pytest.mark.study
def test_what_the_library_lacks_is_unknown_and_described(null_reference):
    """A third contact, of the cradle with the ground."""
    law = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=3e4)
    third = Contact(name="third", at=Station("cradle", 0.75), against=None, law=law)
    gap, corrected = diagnosed(replace(RIG, contacts=(*RIG.contacts, third)), null_reference)
    assert gap.verdict == "unexplained"
    assert "cradle" in gap.unknown.sentence
    assert gap.notes == ()
    assert corrected == RIG
