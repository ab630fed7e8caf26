"""Effects on a bench alone: a support that stands elsewhere, and those that no library has: stops of another law, a
mass that stands elsewhere."""

from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from tests.campaigns.worlds.kinds import Kind, Size
from tests.campaigns.worlds.machine import Machine, with_beams, with_laws
from tests.campaigns.worlds.truth import EffectTruth, Expected

BOTH = (1, -1)
DEPTHS = (0.3, 3.0)
"""Where a power law meets the believed stop: of the depth at twice the force, log-uniform."""


def _power_law_stop(machine: Machine, truth: EffectTruth) -> Machine:
    """f = k d (depth / d)^exponent."""
    exponent, depth_m = truth.parameters["exponent"], truth.parameters["reference_depth_m"]
    return with_laws(
        machine,
        str(truth.place["contact"]),
        lambda law: replace(law, exponent=exponent, reference_depth_m=depth_m),
    )


def _stop_without_pull(machine: Machine, truth: EffectTruth) -> Machine:
    """The stop damps more than believed, and never holds back what leaves it."""
    more = truth.parameters["damping_n_s_per_m"]
    return with_laws(
        machine,
        str(truth.place["contact"]),
        lambda law: replace(law, damping_n_s_per_m=law.damping_n_s_per_m + more, pulls=0.0),
    )


def _support_moved(machine: Machine, truth: EffectTruth) -> Machine:
    shift_m = truth.parameters["shift_m"]
    return with_beams(
        machine,
        str(truth.place["body"]),
        lambda b: replace(b, springs=tuple((at_m + shift_m, k) for at_m, k in b.springs)),
    )


def _mass_moved(machine: Machine, truth: EffectTruth) -> Machine:
    shift_m = truth.parameters["shift_m"]
    return with_beams(
        machine,
        str(truth.place["body"]),
        lambda b: replace(b, masses=tuple((at_m + shift_m, kg) for at_m, kg in b.masses)),
    )


def _stop(law: str) -> Callable[[EffectTruth], Expected]:
    return lambda truth: Expected(where="contact pair", law=law, contact=str(truth.place["contact"]))


def _moved(truth: EffectTruth) -> Expected:
    return Expected(where="force", law="moved", body=str(truth.place["body"]))


def bench_outside(stop_n_per_m: float, force_n: float, damping_n_s_per_m: float) -> dict[str, Kind]:
    """By name; sizes by the stiffness of the stops, the force that they see and a critical damping of theirs."""

    def depth(rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
        low, high = DEPTHS
        return {"reference_depth_m": 2 * force_n / stop_n_per_m * float(low * (high / low) ** rng.uniform())}

    kinds = (
        Kind(
            "power_law_stop",
            Size("exponent", 0.1, 0.5, 0.3, neutral=1.0),
            "contacts",
            _power_law_stop,
            depth,
            expected=_stop("power"),
            library=False,
            stand_ins=("hertz_stop", "contact_stiffness", "nonlinear_contact"),
        ),
        Kind(
            "stop_without_pull",
            Size("damping_n_s_per_m", 0.05 * damping_n_s_per_m, 0.5 * damping_n_s_per_m, 0.1 * damping_n_s_per_m),
            "contacts",
            _stop_without_pull,
            expected=_stop("no pull"),
            library=False,
            stand_ins=("contact_damping",),
        ),
        Kind("support_position", Size("shift_m", 2e-3, 5e-2, 1e-2, BOTH), "beam_itself", _support_moved),
        Kind(
            "mass_moved",
            Size("shift_m", 2e-3, 5e-2, 1e-2, BOTH),
            "beam_itself",
            _mass_moved,
            expected=_moved,
            library=False,
            stand_ins=("added_mass",),
        ),
    )
    return {kind.name: kind for kind in kinds}
