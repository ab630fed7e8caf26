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
FIRST_S = 4
"""Whole seconds of the record's beginning, whose motion the blow is scaled to."""


def released(measured: Recording, simulate: Simulate) -> Simulate:
    """A simulator of free decays as long as the measured one, which take no notice of the force.

    The blow, at the place of the first force, is a half-sine of half the rig's longest period. It is scaled by what the
    believed rig's last sensor shows in the first seconds of the record; a decay begins up to one period behind the
    blow, by the seed.
    """
    rate = measured.rig.sample_rate_hz
    natural_hz = np.concatenate([modes_of(measured.rig, b).frequencies_hz(b.max_modes) for b in measured.rig.bodies])
    period = round(rate / max(float(np.min(natural_hz[natural_hz > 0], initial=np.inf)), 1.0))
    blow = np.sin(np.pi * np.arange(period // 2) / (period // 2))
    first = FIRST_S * round(rate)
    level = _level(measured)

    def decay(rig: Rig, actual: Rig, peak_n: float, samples: int, seed: int) -> Recording:
        begin = blow.size + round(period * np.random.default_rng([seed, 78]).uniform())
        forces_n = np.zeros((len(rig.forces), begin + samples))
        forces_n[0, : blow.size] = peak_n * blow
        return _unforced(part_of(simulate(rig, actual, forces_n, seed), slice(begin, begin + samples)))

    peak_n = measured.rig.body(measured.rig.forces[0].body).mass_kg
    for _ in range(SCALINGS):
        peak_n *= level / _level(decay(measured.rig, measured.rig, peak_n, first, 0))

    def simulated(rig: Rig, actual: Rig, forces_n: Float[np.ndarray, "forces samples"], seed: int) -> Recording:
        return decay(rig, actual, peak_n, forces_n.shape[1], seed)

    return simulated


def _level(recording: Recording) -> float:
    """Geometric mean of the last sensor's standard deviation in each of the first seconds, in its unit."""
    second = round(recording.rig.sample_rate_hz)
    row = recording.signals[recording.rig.sensors[-1].quantity].values[-1, : FIRST_S * second]
    return float(np.exp(np.mean(np.log(row.reshape(FIRST_S, second).std(axis=1)))))


def _unforced(recording: Recording) -> Recording:
    force = recording.signals["force"]
    zero = Signals(force.channels, force.start_s, np.zeros_like(force.values))
    return Recording(recording.rig, {**recording.signals, "force": zero}, recording.provenance)
