"""The next experiment: which further recording would tell two causes apart that this one leaves alike.

T-optimality (Atkinson and Fedorov, Biometrika 62, 1975): of the experiments that a laboratory can make, the one in
which the rival, fitted as well as it can be, explains the other's recording worst. Each is simulated with each cause.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.signal import butter, sosfiltfilt

from identify.gap.decision.comparison import TEMPERATURE
from identify.gap.decision.null_reference import Simulate, phase_randomized
from identify.gap.likelihood import misfit, reference_of
from identify.gap.residual import base_of
from identify.gap.results import NextExperiment
from identify.gap.search.nominal import fit_nuisance
from identify.gap.spectra import REACH, Record, record_of
from rig.description import PointMass, Rig, Station
from rig.errors import RigError
from rig.model.tolerances import Tolerances

LEVELS = (0.3, 0.6, 1.6, 2.5)
"""Forces to try, as multiples of the one at hand."""
ADDED = 0.1
"""A known mass to hang on, as a share of its body's."""
SPLIT = 0.4
"""Where the band of the force is split, as a share of its upper end."""
ORDER = 8


@dataclass(frozen=True)
class Experiment:
    """What a laboratory could do next: in words, to the machine (and so to its description), and with which force."""

    words: str
    changed: Callable[[Rig], Rig]
    force_n: Float[np.ndarray, " samples"]


def next_experiments(
    record: Record,
    force_n: Float[np.ndarray, " samples"],
    rivals: tuple[Rig, Rig],
    simulate: Simulate,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[NextExperiment, ...]:
    """Every experiment that can be simulated with both rivals, two rigs that a record leaves alike; most telling first.

    Its figure is the mean, over which of the two is true, of the logarithm by which the odds of the true one grow.
    """
    tried = list(experiments(record, force_n))
    found = []
    for i, experiment in enumerate(tried):
        try:
            gains = [
                _gain(record.rig, a, b, experiment, simulate, record.tolerances) for a, b in (rivals, rivals[::-1])
            ]
        except RigError:
            continue  # the machine cannot be shaken so
        found.append(NextExperiment(experiment.words, float(np.mean(gains)) / (2 * TEMPERATURE)))
        progress((i + 1) / len(tried))
    return tuple(sorted(found, key=lambda e: -e.log_odds))


def experiments(record: Record, force_n: Float[np.ndarray, " samples"]) -> Iterator[Experiment]:
    """The same again, other levels, halves of the band, a known mass on every body."""
    rate, rig = record.sample_rate_hz, record.rig
    start = round(record.excited_s * rate)
    again = phase_randomized(force_n, start, rate, np.random.default_rng(11))
    yield Experiment("record the same again", _as_it_is, again)
    for level in LEVELS:
        yield Experiment(f"record with {level:g} times the force", _as_it_is, level * again)
    high_hz = float(record.omega[-1] / (2 * np.pi)) / REACH
    for words, kind in (("lower", "lowpass"), ("upper", "highpass")):
        sections = butter(ORDER, SPLIT * high_hz, kind, fs=rate, output="sos")
        part = sosfiltfilt(sections, again)
        part[:start] = 0.0
        same = part * (np.std(again) / max(float(np.std(part)), 1e-300))
        yield Experiment(
            f"record with the {words} part of the band, split at {SPLIT * high_hz:.3g} Hz", _as_it_is, same
        )
    for body in rig.bodies:
        mass_kg = ADDED * getattr(body, "mass_kg", 1.0)
        end = Station(body.name, body.length_m)
        words = f"hang a known {1e3 * mass_kg:.3g} g on the right end of {body.name}"

        def heavier(believed: Rig, end: Station = end, mass_kg: float = mass_kg) -> Rig:
            return replace(believed, masses=(*believed.masses, PointMass(station=end, mass_kg=mass_kg)))

        yield Experiment(words, heavier, again)


def _as_it_is(rig: Rig) -> Rig:
    return rig


def _gain(
    believed: Rig, true: Rig, rival: Rig, experiment: Experiment, simulate: Simulate, tolerances: Tolerances
) -> float:
    """-2 ln p of the rival less that of the true cause, on a recording that is simulated with the true one."""
    known, actual, other = (experiment.changed(rig) for rig in (believed, true, rival))
    record = record_of(simulate(known, actual, experiment.force_n, 5), tolerances=tolerances)
    reference = reference_of(base_of(record, known))
    costs = [misfit(record, reference, fit_nuisance(record, rig, rounds=1)[1]).minus_two_log for rig in (other, actual)]
    return costs[0] - costs[1]
