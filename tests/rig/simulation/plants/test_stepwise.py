"""Step by step the plant does what it does with the whole force."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.description import BaseMotion, PointMass, StaticLoad, Station, Tone
from rig.simulation.excitation import force_history
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from rig.simulation.plants.stepwise import Stepwise
from rig.simulation.reference import BarrelCradle, Sdof

BARREL = BarrelCradle().rig()
RIGS = {
    "one mass": (Sdof().rig(), Sdof().force()),
    "two beams": (BARREL, BarrelCradle(high_hz=40.0).force()),
    "all that acts": (
        replace(
            BARREL,
            masses=(PointMass(station=Station("barrel", 0.6), mass_kg=0.1),),
            loads=(StaticLoad(station=Station("barrel", 0.3), force_n=2.0),),
            tones=(Tone(station=Station("cradle", 1.0), frequency_hz=20.0, cosine_n=1.0, sine_n=0.5),),
        ),
        BarrelCradle(high_hz=40.0).force(),
    ),
}


STEP_S = 2.0**-14


@pytest.mark.parametrize("name", ["one mass", "all that acts", pytest.param("two beams", marks=pytest.mark.study)])
def test_the_motion_is_that_under_the_whole_force_until_contacts_were_closed_for_a_while(name):
    rig, force = RIGS[name]
    force_n = force_history(force, 4.0, STEP_S)[: 2**15]
    force_n[0] = 0.0
    motion = concatenated(modal.simulate(one_step_later(rig), force_n, STEP_S, lambda _: None))
    first_contact = int(np.argmax(np.abs(motion.contact_force_n).sum(axis=0) > 0))
    until = first_contact + round(0.2 / STEP_S)
    stepwise, rows = Stepwise(rig, STEP_S), []
    for value in force_n[:until]:
        stepwise.advance(float(value))
        rows.append((stepwise.eta_m, stepwise.contact_force_n))
    eta, contact_n = (np.array(row).T for row in zip(*rows, strict=True))
    assert np.abs(motion.contact_force_n[:, :until]).max() > 1.0
    for stepped, expected, tolerance in (
        (eta, motion.eta_m[:, :until], 2e-4),
        (contact_n, motion.contact_force_n[:, :until], 5e-3),
    ):
        assert np.abs(stepped - expected).max() < tolerance * np.abs(expected).max()
    if first_contact > 2:  # afterwards accelerometers hear corrected contact forces, which need the samples to come
        before = stepwise_sensed(rig, force_n[: first_contact - 1])
        np.testing.assert_allclose(before, motion.sensed[:, first_contact - 2], rtol=1e-4, atol=1e-9)


def one_step_later(rig):
    """Shift the tones by a step: the block-wise plant leaves rest in the step that ends at time 0."""
    turned = []
    for tone in rig.tones:
        turn = np.exp(-2j * np.pi * tone.frequency_hz * STEP_S) * (tone.cosine_n + 1j * tone.sine_n)
        turned.append(replace(tone, cosine_n=turn.real, sine_n=turn.imag))
    return replace(rig, tones=tuple(turned))


def stepwise_sensed(rig, force_n):
    stepwise = Stepwise(rig, STEP_S)
    for value in force_n:
        stepwise.advance(float(value))
    return stepwise.sensed


def test_several_steps_at_once_are_those_one_by_one_under_a_force_that_grows_evenly():
    single, fourfold = Stepwise(BARREL, STEP_S), Stepwise(BARREL, STEP_S)
    for k in range(400):
        single.advance(0.5 * (k + 1))
    for k in range(100):
        fourfold.advance(2.0 * (k + 1), step_count=4)
    assert fourfold.time_s == single.time_s
    np.testing.assert_allclose(fourfold.eta_m, single.eta_m, rtol=1e-9)
    np.testing.assert_allclose(fourfold.sensed, single.sensed, rtol=1e-6, atol=1e-9)


def test_a_shaking_base_is_refused():
    rig = replace(BARREL, base_motion=BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=5.0, high_hz=9.0))
    with pytest.raises(RigError, match="its base shakes"):
        Stepwise(rig, STEP_S)


def test_several_forces_are_refused():
    rig = Sdof().rig()
    with pytest.raises(RigError, match="2 forces act on it, and one is given step by step; leave one in force_at"):
        Stepwise(replace(rig, force_at=(rig.force_at, rig.force_at)), STEP_S)
