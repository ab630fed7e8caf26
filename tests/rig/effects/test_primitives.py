"""The primitives that effects are made of: a sentence for each value that cannot be, and a JSON round trip."""

import msgspec
import pytest

from rig.errors import RigError
from rig.model.description import (
    BaseMotion,
    Clamp,
    ForceSensor,
    PointDamper,
    PointMass,
    PointSpring,
    StaticLoad,
    Station,
    Tone,
    from_json,
    to_json,
)
from rig.simulation.reference import BarrelCradle

MACHINE = BarrelCradle(stations=4).rig()
TIP = Station("barrel", 1.0)
OFF = Station("barrel", 1.5)


@pytest.mark.parametrize(
    ("kind", "values", "sentence"),
    [
        (
            PointMass,
            {"station": TIP, "mass_kg": -1.0},
            "point mass: mass_kg is -1.0; give a finite value, zero or above",
        ),
        (PointSpring, {"station": TIP, "cubic_n_per_m3": float("nan")}, "point spring: cubic_n_per_m3 is nan"),
        (
            Clamp,
            {"body": "cradle", "rotational_n_m_per_rad": -2.0},
            "clamp of 'cradle': rotational_n_m_per_rad is -2.0",
        ),
        (StaticLoad, {"station": TIP, "force_n": float("inf")}, "static load: force_n is inf; give a finite value"),
        (
            BaseMotion,
            {"acceleration_rms_m_per_s2": 1.0, "low_hz": 0.0, "high_hz": 9.0},
            "base motion: the band 0.0 to 9.0 Hz is empty; give 0 < low < high",
        ),
        (
            BaseMotion,
            {"acceleration_rms_m_per_s2": 1.0, "low_hz": 1.0, "high_hz": 9.0, "seed": -1},
            "base motion: seed is -1; give zero or above",
        ),
        (ForceSensor, {"gain": 0.0}, "force sensor: gain is 0.0; give a finite value other than zero"),
        (ForceSensor, {"lag_s": -2.0}, "force sensor: lag_s is -2.0; give a finite value, -1 to 1 s"),
        (PointDamper, {"station": TIP, "friction_n": -1.0}, "point damper: friction_n is -1.0; give a finite value"),
        (Tone, {"station": TIP, "frequency_hz": 0.0}, "tone: frequency_hz is 0.0; give a finite value above zero"),
        (Tone, {"station": TIP, "frequency_hz": 9.0, "sine_n": float("nan")}, "tone: sine_n is nan; give a finite"),
    ],
)
def test_a_primitive_that_cannot_be_is_refused(kind, values, sentence):
    with pytest.raises(RigError) as caught:
        kind(**values)
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"masses": (PointMass(station=OFF, mass_kg=1.0),)},
            "a point mass stands at 1.5 m, off 'barrel'; give 0 to 1.0 m",
        ),
        ({"springs": (PointSpring(station=OFF),)}, "a point spring stands at 1.5 m"),
        ({"loads": (StaticLoad(station=OFF, force_n=1.0),)}, "a point load stands at 1.5 m"),
        ({"dampers": (PointDamper(station=OFF),)}, "a point damper stands at 1.5 m"),
        ({"tones": (Tone(station=OFF, frequency_hz=9.0),)}, "a tone stands at 1.5 m"),
        (
            {"clamps": (Clamp(body="barrel", rotational_n_m_per_rad=1.0),)},
            "a clamp holds 'barrel', which is no clamped beam",
        ),
        (
            {"clamps": (Clamp(body="cradle", rotational_n_m_per_rad=1.0),) * 2},
            "more than one clamp holds the same beam",
        ),
    ],
)
def test_a_rig_that_cannot_have_them_is_refused(changes, sentence):
    with pytest.raises(RigError) as caught:
        msgspec.structs.replace(MACHINE, **changes)
    assert sentence in str(caught.value)


def test_all_of_them_survive_json():
    machine = msgspec.structs.replace(
        MACHINE,
        masses=(PointMass(station=TIP, mass_kg=0.1),),
        springs=(PointSpring(station=TIP, stiffness_n_per_m=1.0, cubic_n_per_m3=-2.0, rotational_n_m_per_rad=3.0),),
        clamps=(Clamp(body="cradle", rotational_n_m_per_rad=4.0),),
        loads=(StaticLoad(station=TIP, force_n=-5.0),),
        base_motion=BaseMotion(acceleration_rms_m_per_s2=6.0, low_hz=7.0, high_hz=8.0, seed=9),
        force_sensor=ForceSensor(gain=-1.0, lag_s=-1e-3),
        dampers=(PointDamper(station=TIP, damping_n_s_per_m=1.0, friction_n=2.0),),
        tones=(Tone(station=TIP, frequency_hz=50.0, cosine_n=-1.0, sine_n=2.0),),
    )
    assert from_json(to_json(machine), "text") == machine
