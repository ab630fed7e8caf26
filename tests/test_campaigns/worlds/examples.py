"""Small machines for the tests."""

import numpy as np

from tests.campaigns.worlds.machine import Link, Machine, MotionSensor, Place, TrueBeam
from tests.campaigns.worlds.simulator import STEP_S, model_of, simulate


def beam(name="bar", clamped=True, **changes):
    steel = {"length_m": 1.0, "width_m": 0.05, "thickness_m": 0.01, "youngs_modulus_pa": 210e9}
    return TrueBeam(
        **{"name": name, "clamped": clamped, "density_kg_per_m3": 7850.0, "damping_ratio": 0.01} | steel | changes
    )


def alone(bar, position_m=1.0, links=(), **changes):
    """A machine of one beam with a sensor and the force at a place."""
    at = Place(bar.name, position_m)
    sensors = (MotionSensor(name="tip", at=at),)
    return Machine(beams=(bar,), contacts=tuple(links), force_at=at, sensors=sensors, **changes)


def to_ground(law, body="bar", position_m=1.0):
    return Link(name="link", at=Place(body, position_m), against=None, law=law)


def inputs(seconds, force=None, ground=None, step_s=STEP_S):
    """The simulator's inputs over so many seconds of a machine without tones."""
    steps = round(seconds / step_s)
    time_s = np.arange(steps) * step_s
    rows = [np.zeros(steps) if force is None else force(time_s), np.ones(steps)]
    rows.append(np.zeros(steps) if ground is None else ground(time_s))
    return np.stack(rows, axis=1)


def ran(machine, known, initial=None, step_s=STEP_S):
    """The model, its states (samples, 2, coordinates), the links' forces, and the accelerations."""
    model = model_of(machine)
    blocks = list(simulate(model, known, 0.0, step_s, initial))
    states = np.concatenate([b.states for b in blocks])
    return model, states, np.concatenate([b.link_n for b in blocks]), accelerations(blocks)


def accelerations(blocks):
    return np.concatenate([b.acceleration_m_per_s2 for b in blocks], axis=1)
