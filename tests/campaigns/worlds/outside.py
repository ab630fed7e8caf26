"""Effects that no library has: what a diagnosis must call unknown, and describe."""

import numpy as np
from msgspec.structs import replace

from tests.campaigns.worlds.kinds import Kind, Size, place_of
from tests.campaigns.worlds.laws import StopLaw
from tests.campaigns.worlds.machine import Machine, with_beams, with_hung, with_laws, with_link, with_sensors
from tests.campaigns.worlds.truth import EffectTruth, Expected


def _quadratic_drag(machine: Machine, truth: EffectTruth) -> Machine:
    law = StopLaw(drag_n_s2_per_m2=truth.parameters["drag_n_s2_per_m2"])
    return with_link(machine, truth.name, place_of(truth), law)


def _third_contact(machine: Machine, truth: EffectTruth) -> Machine:
    """A stop on either side between a beam and the ground."""
    stiffness, gap_m = truth.parameters["stiffness_n_per_m"], truth.parameters["clearance_m"]
    law = StopLaw(lower_m=gap_m, upper_m=gap_m, stiffness_below_n_per_m=stiffness, stiffness_above_n_per_m=stiffness)
    return with_link(machine, truth.name, place_of(truth), law)


def _softening_support(machine: Machine, truth: EffectTruth) -> Machine:
    """A support k w0 tanh(w / w0) that yields."""
    stiffness, yield_m = truth.parameters["stiffness_n_per_m"], truth.parameters["yield_m"]
    return with_link(machine, truth.name, place_of(truth), StopLaw(yield_n=stiffness * yield_m, yield_m=yield_m))


def _thermal_drift(machine: Machine, truth: EffectTruth) -> Machine:
    """The modulus of a beam falls steadily, by this share over fall_s."""
    fall, over_s = truth.parameters["fall"], truth.parameters["fall_s"]
    return with_beams(machine, str(truth.place["beam"]), lambda b: replace(b, fall=fall, fall_s=over_s))


def _loose_sensor(machine: Machine, truth: EffectTruth) -> Machine:
    mount_hz, damping = truth.parameters["frequency_hz"], truth.parameters["damping_ratio"]
    return with_sensors(
        machine, str(truth.place["sensor"]), lambda s: replace(s, mount_hz=mount_hz, mount_damping=damping)
    )


def _rattling_mass(machine: Machine, truth: EffectTruth) -> Machine:
    """A loose mass in a cage on a beam: it strikes either wall, which damps, and a weak spring holds it in between."""
    mass_kg, play_m = truth.parameters["mass_kg"], truth.parameters["play_m"]
    law = StopLaw(
        lower_m=play_m,
        upper_m=play_m,
        stiffness_below_n_per_m=2e4,
        stiffness_above_n_per_m=2e4,
        damping_n_s_per_m=0.2 * float(np.sqrt(2e4 * mass_kg)),
        spring_n_per_m=mass_kg * (2 * np.pi * 3.0) ** 2,
    )
    return with_hung(machine, truth.name, place_of(truth), mass_kg, law)


def _parametric_clearance(machine: Machine, truth: EffectTruth) -> Machine:
    """Both clearances of a contact grow and shrink by a share of themselves, as of a part that turns."""
    share, breath_hz = truth.parameters["share"], truth.parameters["frequency_hz"]
    return with_laws(
        machine,
        str(truth.place["contact"]),
        lambda law: replace(law, breath_m=share * (law.lower_m + law.upper_m) / 2, breath_hz=breath_hz),
    )


def _gap(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    return {"clearance_m": float(rng.uniform(2e-3, 5e-3))}


def _give(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    return {"yield_m": float(rng.uniform(1e-3, 4e-3))}


def _over(_rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    return {"fall_s": 30.0}


def _mounting(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    return {"damping_ratio": float(rng.uniform(0.02, 0.05))}


def _play(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    return {"play_m": float(1e-4 * 10 ** rng.uniform())}


def _breath(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    return {"frequency_hz": float(0.5 * 40 ** rng.uniform())}


def _force(law: str, truth: EffectTruth) -> Expected:
    place = place_of(truth)
    return Expected(where="force", law=law, body=place.body, position_m=place.position_m)


OUTSIDE: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            "loose_sensor",
            Size("frequency_hz", 60.0, 300.0, 130.0),
            "sensor",
            _loose_sensor,
            _mounting,
            expected=lambda t: Expected(
                where="sensor",
                law="resonance",
                sensor=str(t.place["sensor"]),
                frequency_hz=t.parameters["frequency_hz"],
            ),
            library=False,
        ),
        Kind(
            "parametric_clearance",
            Size("share", 0.03, 0.3, 0.1),
            "contacts",
            _parametric_clearance,
            _breath,
            expected=lambda t: Expected(
                where="contact pair",
                law="modulated clearance",
                contact=str(t.place["contact"]),
                frequency_hz=t.parameters["frequency_hz"],
            ),
            library=False,
        ),
        Kind(
            "quadratic_drag",
            Size("drag_n_s2_per_m2", 2.0, 30.0, 8.0),
            "moving",
            _quadratic_drag,
            expected=lambda t: _force("drag", t),
            library=False,
        ),
        Kind(
            "rattling_mass",
            Size("mass_kg", 0.02, 0.3, 0.1),
            "moving",
            _rattling_mass,
            _play,
            expected=lambda t: _force("rattle", t),
            library=False,
        ),
        Kind(
            "softening_support",
            Size("stiffness_n_per_m", 300.0, 5e3, 1200.0),
            "moving",
            _softening_support,
            _give,
            expected=lambda t: _force("softening", t),
            library=False,
        ),
        Kind(
            "thermal_drift",
            Size("fall", 0.03, 0.2, 0.1),
            "beam",
            _thermal_drift,
            _over,
            expected=lambda t: Expected(where="distributed", law="drift", body=str(t.place["beam"])),
            library=False,
        ),
        Kind(
            "third_contact",
            Size("stiffness_n_per_m", 1e3, 1e5, 1e4),
            "moving",
            _third_contact,
            _gap,
            expected=lambda t: _force("stop", t),
            library=False,
        ),
    )
}
"""By name, in alphabetical order."""
