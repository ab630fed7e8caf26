"""Null simulations of a free decay: a blow, which the record does not hold, releases the rig before it begins."""

import numpy as np
from jaxtyping import Float

from identify.gaps.decision.null_reference import Simulate
from identify.gaps.decision.recordings import part_of
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.recording import Recording, Signals

HALF_SINES = tuple(2.0**-k for k in (1, 2, 3, 4, 5))
"""Durations of the blow that are tried, in the rig's longest period: a short one moves higher modes, which decay
sooner."""
SCALINGS = 4
"""Short simulations that scale each of them."""
FIRST_S, PARTS = 8, 8
"""The record's beginning, whose motion the blow is to make, in so many parts."""


def released(measured: Recording, simulate: Simulate) -> Simulate:
    """A simulator of free decays as long as the measured one, which take no notice of the force.

    The blow, at the place of the first force, is the half-sine after which the believed rig's sensors move most like
    the measured ones, part by part. A decay begins up to one period behind the blow, by the seed.
    """
    rate, wanted = measured.rig.sample_rate_hz, _levels(measured)
    beginning = min(FIRST_S * round(rate), measured.samples)
    natural_hz = np.concatenate([modes_of(measured.rig, b).frequencies_hz(b.max_modes) for b in measured.rig.bodies])
    period = round(rate / max(float(np.min(natural_hz[natural_hz > 0], initial=np.inf)), 1.0))

    def decay(rig: Rig, actual: Rig, blow_n: Float[np.ndarray, " blow"], samples: int, seed: int) -> Recording:
        begin = blow_n.size + round(period * np.random.default_rng([seed, 78]).uniform())
        forces_n = np.zeros((len(rig.forces), begin + samples))
        forces_n[0, : blow_n.size] = blow_n
        return _unforced(part_of(simulate(rig, actual, forces_n, seed), slice(begin, begin + samples)))

    def scaled(half_sine: int) -> tuple[float, Float[np.ndarray, " blow"]]:
        """Distance of the parts' levels, and the blow."""
        blow_n = measured.rig.body(measured.rig.forces[0].body).mass_kg * np.sin(
            np.pi * np.arange(half_sine) / half_sine
        )
        for _ in range(SCALINGS):
            off = wanted - _levels(decay(measured.rig, measured.rig, blow_n, beginning, 0))
            blow_n = blow_n * np.exp(np.mean(off))
        return float(np.std(off)), blow_n

    _, blow_n = min((scaled(max(2, round(share * period))) for share in HALF_SINES), key=lambda found: found[0])

    def simulated(rig: Rig, actual: Rig, forces_n: Float[np.ndarray, "forces samples"], seed: int) -> Recording:
        return decay(rig, actual, blow_n, forces_n.shape[1], seed)

    return simulated


def _levels(recording: Recording) -> Float[np.ndarray, " parts"]:
    """Logarithm of the standard deviation in each part of the beginning, of all sensors of the last one's quantity."""
    part = min(FIRST_S * round(recording.rig.sample_rate_hz), recording.samples) // PARTS
    rows = recording.signals[recording.rig.sensors[-1].quantity].values[:, : PARTS * part]
    return np.asarray(np.log(np.linalg.norm(rows.reshape(len(rows), PARTS, part).std(axis=2), axis=0)))


def _unforced(recording: Recording) -> Recording:
    force = recording.signals["force"]
    zero = Signals(force.channels, force.start_s, np.zeros_like(force.values))
    return Recording(recording.rig, {**recording.signals, "force": zero}, recording.provenance)
