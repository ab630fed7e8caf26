"""Effects outside the library: each does what it says, and its expected description names place, law and frequency."""

import numpy as np
import pytest
from msgspec.structs import replace

from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.forces import Gaussian
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.machine import with_sensors
from tests.campaigns.worlds.outside import OUTSIDE
from tests.campaigns.worlds.simulator import STEP_S
from tests.campaigns.worlds.truth import EffectTruth
from tests.test_campaigns.worlds.examples import alone, beam, inputs, ran

MACHINE = with_sensors(
    nominal_machine(believed_rig("own", np.random.default_rng(1))), "all", lambda s: replace(s, noise_density=0.0)
)
BAR = alone(beam())
FORCE = Gaussian(rms_n=20.0, begins_s=0.1)
TIP = {"body": "bar", "position_m": 1.0}


def put_in(name, machine=BAR, place=None, **parameters):
    truth = EffectTruth(name=name, parameters=parameters, place=place or TIP, strength=1.0)
    return OUTSIDE[name].change(machine, truth)


def driven(machine, seconds=0.4):
    """The tip's motion and rate, and the forces of the links, under a force that shakes the first modes."""
    model, states, link_n, acceleration = ran(
        machine, inputs(seconds, lambda t: 30 * np.sin(2 * np.pi * 8 * t) * np.minimum(t / 0.05, 1))
    )
    return states[:, 0] @ model.sensed[0], states[:, 1] @ model.sensed[0], link_n, acceleration


@pytest.mark.parametrize("name", OUTSIDE)
def test_each_changes_what_is_measured_and_is_described(name):
    kind, rng = OUTSIDE[name], np.random.default_rng(2)
    truth = kind.drawn(MACHINE, 20.0, rng, least=0.9)
    changed = kind.change(MACHINE, truth)
    records = [measured(m, FORCE, 6000, 4096.0, 3).delivered for m in (MACHINE, changed)]
    assert np.isfinite(records[1]).all()
    assert np.linalg.norm(records[1] - records[0]) > 1e-3 * np.linalg.norm(records[0])
    told = kind.expected(truth)
    if told.where == "force":
        assert (told.body, told.position_m) == (truth.place["body"], truth.place["position_m"])
        assert told.position_m > 0.5
    assert told.frequency_hz == truth.parameters.get("frequency_hz")
    assert {told.body, told.sensor, told.contact} - {None} == {
        v for k, v in truth.place.items() if k in ("body", "beam", "sensor", "contact")
    }


@pytest.mark.parametrize(
    ("name", "numbers", "law"),
    [
        ("quadratic_drag", {"drag_n_s2_per_m2": 8.0}, lambda _, v: 8.0 * np.abs(v) * v),
        (
            "third_contact",
            {"stiffness_n_per_m": 2e4, "clearance_m": 2e-3},
            lambda w, _: 2e4 * (w - np.clip(w, -2e-3, 2e-3)),
        ),
        (
            "softening_support",
            {"stiffness_n_per_m": 3e3, "yield_m": 2e-3},
            lambda w, _: 6.0 * np.tanh(w / 2e-3),
        ),
    ],
)
def test_a_force_to_the_ground_is_that_of_its_formula(name, numbers, law):
    w, v, link_n, _ = driven(put_in(name, **numbers))
    expected = law(w, v)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(link_n[:, 0], expected, atol=1e-6 * np.abs(expected).max())


def test_a_rattling_mass_takes_no_more_than_it_gives_back_in_momentum():
    """The cage's force is the mass times its acceleration; within the play there is next to none."""
    machine = put_in("rattling_mass", mass_kg=0.1, play_m=3e-4)
    model, states, link_n, _ = ran(machine, inputs(0.4, lambda t: 30 * np.sin(2 * np.pi * 8 * t)))
    rate = states[:, 1, -1] / np.sqrt(0.1)
    impulse = np.cumsum((link_n[1:, 0] + link_n[:-1, 0]) / 2) * STEP_S
    np.testing.assert_allclose(impulse, 0.1 * (rate[1:] - rate[0]), atol=2e-3 * np.ptp(impulse))
    eta = states[:, 0] @ model.rows[0]
    assert np.abs(link_n[np.abs(eta) < 3e-4, 0]).max() < 0.02 * np.abs(link_n).max()
    assert np.abs(eta).max() > 3e-4


def test_a_clearance_breathes():
    contact = put_in("parametric_clearance", MACHINE, {"contact": "contact_2"}, share=0.2, frequency_hz=3.0).contacts
    assert [c.law.breath_m for c in contact] == pytest.approx([0.0, 1e-3])
    assert [c.law.breath_hz for c in contact] == [0.0, 3.0]


def test_a_modulus_falls_on_its_beam():
    machine = put_in("thermal_drift", place={"beam": "bar"}, fall=0.1, fall_s=30.0)
    assert (machine.beams[0].fall, machine.beams[0].fall_s) == (0.1, 30.0)


def test_a_loose_sensor_is_alone():
    machine = put_in(
        "loose_sensor", MACHINE, {"sensor": MACHINE.sensors[4].name}, frequency_hz=100.0, damping_ratio=0.03
    )
    one, other = (measured(m, FORCE, 4096, 4096.0, 3).delivered for m in (MACHINE, machine))
    changed = np.linalg.norm(one - other, axis=1) > 1e-9
    assert np.flatnonzero(changed).tolist() == [4]
    assert machine.sensors[4].at == MACHINE.sensors[4].at
