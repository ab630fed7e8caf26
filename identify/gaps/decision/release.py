"""Null simulations of a free decay: a blow, which the record does not hold, releases the rig before it begins."""

import numpy as np
from jaxtyping import Float

from identify.gaps.decision.null_reference import Simulate
from identify.gaps.decision.recordings import part_of
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.recording import Recording, Signals

SCALINGS = 6
"""Short simulations that scale the blow."""
FIRST_S = 1.0
"""The record's beginning, whose motion the blow is scaled to."""


def released(measured: Recording, simulate: Simulate) -> Simulate:
    """A simulator of free decays as long as the measured one, of a single mass, which take no notice of the force.

    The blow is a half-sine of half the mass's period. It is scaled to the standard deviation that the believed rig's
    sensor has in the first second of the record; a decay begins up to one period behind the blow, by the seed.
    """
    rate = measured.rig.sample_rate_hz
    (body,) = measured.rig.bodies
    period = round(rate / max(float(modes_of(measured.rig, body).frequencies_hz(1)[0]), 1 / FIRST_S))
    blow = np.sin(np.pi * np.arange(period // 2) / (period // 2))
    first = round(FIRST_S * rate)
    level = _level(measured, first)

    def decay(rig: Rig, actual: Rig, peak_n: float, samples: int, seed: int) -> Recording:
        begin = blow.size + round(period * np.random.default_rng([seed, 78]).uniform())
        force_n = np.zeros(begin + samples)
        force_n[: blow.size] = peak_n * blow
        return _unforced(part_of(simulate(rig, actual, force_n, seed), slice(begin, begin + samples)))

    peak_n = body.mass_kg
    for _ in range(SCALINGS):
        peak_n *= level / _level(decay(measured.rig, measured.rig, peak_n, first, 0), first)

    def simulated(rig: Rig, actual: Rig, force_n: Float[np.ndarray, "*forces samples"], seed: int) -> Recording:
        return decay(rig, actual, peak_n, force_n.shape[-1], seed)

    return simulated


def _level(recording: Recording, samples: int) -> float:
    """Standard deviation of the last sensor at the beginning, in its unit."""
    return float(np.std(recording.signals[recording.rig.sensors[-1].quantity].values[-1, :samples]))


def _unforced(recording: Recording) -> Recording:
    force = recording.signals["force"]
    zero = Signals(force.channels, force.start_s, np.zeros_like(force.values))
    return Recording(recording.rig, {**recording.signals, "force": zero}, recording.provenance)
