"""The next experiment: which further recording would tell two causes apart that this one leaves alike.

T-optimality (Atkinson and Fedorov, Biometrika 62, 1975): of the experiments that a laboratory can make, the one in
which the rival, fitted as well as it can be, explains the other's recording worst. Each is simulated with each cause.
What the rival would have to change of its parameters is charged by what the record at hand knows of them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace as with_fields
from scipy.signal import butter, sosfiltfilt

from identify.gaps.decision.comparison import TEMPERATURE
from identify.gaps.decision.null_reference import Simulate, phase_randomized
from identify.gaps.residual.extent import REACH
from identify.gaps.residual.likelihood import reference_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import AGAIN, NextExperiment
from identify.gaps.search.hypothesis import ROUNDS, Hypothesis, Search, applied, fit_from
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.model.description import PointMass, Rig, Station
from rig.model.tolerances import Tolerances

LEVELS = (0.4, 2.5)
"""Forces to try, as multiples of the one at hand."""
LONGER = 3
"""Duration to try, likewise."""
SIZED = 2.0
"""A cause is simulated so many standard errors larger than fitted, within this multiple of a typical one."""
PLACES = (0.5, 1.0)
"""Of the force, as shares of every body's length."""
ADDED = 0.1
"""A known mass to hang on, as a share of its body's."""
DISPLACEMENT_NOISE = 2e-7
"""Of displacement sensors, m/sqrt(Hz)."""
SPLIT = 0.4
"""Where the band of the force is split, as a share of its upper end."""
ORDER = 8


@dataclass(frozen=True)
class Experiment:
    """Experiment for the laboratory to do next: in words, the changed machine (and description), and the force."""

    words: str
    changed: Callable[[Rig], Rig]
    forces_n: Float[np.ndarray, "forces samples"]


def next_experiments(
    record: Record,
    forces_n: Float[np.ndarray, "forces samples"],
    rivals: tuple[Hypothesis, Hypothesis],
    simulate: Simulate,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[NextExperiment, ...]:
    """Every experiment that can be simulated with both rivals, two causes that a record leaves alike (or one, and the
    believed rig); most telling first.

    Its figure is the mean, over which of the two is true, of the logarithm by which the odds of the true one grow.
    """
    tried = list(experiments(record, forces_n))
    found = []
    for i, experiment in enumerate(tried):
        known = experiment.changed(record.rig)
        try:
            gains = [
                _gain(known, a, b, experiment.forces_n, simulate, record.tolerances) for a, b in (rivals, rivals[::-1])
            ]
        except RigError:
            continue  # the machine cannot be shaken so
        found.append(NextExperiment(experiment.words, float(np.mean(gains)) / (2 * TEMPERATURE)))
        progress((i + 1) / len(tried))
    return tuple(sorted(found, key=lambda e: -e.log_odds))


def experiments(record: Record, forces_n: Float[np.ndarray, "forces samples"]) -> Iterator[Experiment]:
    """The same again, other levels, halves of the band, a longer record, other places of a force that acts alone, a
    known mass on every body, displacement sensors."""
    rate, rig = record.sample_rate_hz, record.rig
    start = round(record.excited_s * rate)
    rng = np.random.default_rng(11)

    def random(rows: Float[np.ndarray, "forces some"]) -> Float[np.ndarray, "forces some"]:
        return np.array([phase_randomized(row, start, rate, rng) for row in rows])

    again = random(forces_n)
    yield Experiment(AGAIN, _as_it_is, again)
    for level in LEVELS:
        yield Experiment(f"record with {level:g} times the force", _as_it_is, level * again)
    high_hz = float(record.omega[-1] / (2 * np.pi)) / REACH
    for words, kind in (("lower", "lowpass"), ("upper", "highpass")):
        sections = butter(ORDER, SPLIT * high_hz, kind, fs=rate, output="sos")
        part = sosfiltfilt(sections, again)
        part[:, :start] = 0.0
        same = part * (np.std(again) / max(float(np.std(part)), 1e-300))
        yield Experiment(
            f"record with the {words} part of the band, split at {SPLIT * high_hz:.3g} Hz", _as_it_is, same
        )
    longer, samples = forces_n, round(LONGER * forces_n.shape[1])
    while longer.shape[1] < samples:
        longer = np.concatenate([longer, longer[:, :start:-1]], axis=1)  # mirrored, so that it does not jump
    longer = random(longer[:, :samples])
    length = f"record {samples / rate:.3g} s"
    yield Experiment(length, _as_it_is, longer)
    yield Experiment(f"{length} with {LEVELS[-1]:g} times the force", _as_it_is, LEVELS[-1] * longer)
    for station in _places(rig) if len(rig.forces) == 1 else ():
        yield Experiment(f"move the force to {_said(rig, station)}", partial(with_fields, force_at=station), again)
    for body in rig.bodies:
        mass_kg = ADDED * getattr(body, "mass_kg", 1.0)
        end = Station(body.name, body.length_m)
        hung = partial(_with_mass, mass=PointMass(station=end, mass_kg=mass_kg))
        yield Experiment(f"hang a known {1e3 * mass_kg:.3g} g on {_said(rig, end)}", hung, again)
    if any(s.measures.order and s.measures.translates for s in rig.sensors):
        yield Experiment("measure displacements in place of accelerations", _with_displacements, again)


def begun_on(record: Record, rig: Rig) -> Search:
    """Start of fits to a record: scales and slow motion of a rig fitted to it.

    All that are compared begin there, so that none of them stays in a worse minimum than another.
    """
    linearization, at = fit_nuisance(record, rig, rounds=1)
    return Search(reference_of(linearized(record, record.rig)), linearization, at, ())


def refitted(begun: Search, one: Hypothesis, held: bool = False) -> Hypothesis:
    """A cause with its parameters fitted anew, from where they stand, on a record: of a rig that may differ from that
    of its first fit.

    The parameters may be held; what is known by its spectrum alone keeps its values. Raises RigError where the rig
    cannot have it.
    """
    record = begun.linearization.record
    if held or any(p.kind.stochastic for p in one.parts):
        rig = one.applied_to(record.rig)
        return replace(one, misfit=fit_from(begun, lambda _: rig, (), np.zeros(0), ROUNDS).hypothesis.misfit)
    return fit_from(begun, partial(applied, record.rig, one.parts), one.parts, one.values, ROUNDS).hypothesis


def enlarged(one: Hypothesis) -> Hypothesis:
    """Hypothesis as large as the record leaves it open: every strength is `SIZED` standard errors, or times what is
    typical if that is less, further from nothing than fitted.

    A cause that a record hardly shows is fitted as nothing; simulated so, no experiment would tell it from another.
    """
    values, deviations = one.values.copy(), np.sqrt(np.maximum(np.diag(one.covariance), 0.0))
    typical = np.concatenate([np.zeros(0), *(part.default for part in one.parts)])
    for i, p in enumerate(one.parameters):
        if p.neutral is not None:
            away = np.sign(values[i] - p.neutral) or np.sign(typical[i] - p.neutral)
            values[i] += away * SIZED * min(deviations[i], abs(typical[i] - p.neutral))
            values[i] = np.clip(values[i], p.low, p.high)
    return replace(one, values=values)


def disagreement(one: Hypothesis, other: Hypothesis) -> float:
    """Excess of -2 ln p of two records together over the sum of theirs: one value of a parameter has to serve both.

    d' (C1 + C2)^-1 d of the difference d of both fits. What every record has of its own is left out.
    """
    shared = [
        p.name not in part.kind.of_a_record and not part.kind.stochastic for part in one.parts for p in part.parameters
    ]
    apart = (one.values - other.values)[shared]
    deviations = (one.covariance + other.covariance)[np.ix_(shared, shared)]
    return float(apart @ np.linalg.pinv(deviations, hermitian=True) @ apart)


def _as_it_is(rig: Rig) -> Rig:
    return rig


def _with_mass(rig: Rig, mass: PointMass) -> Rig:
    return with_fields(rig, masses=(*rig.masses, mass))


def _with_displacements(rig: Rig) -> Rig:
    sensors = tuple(
        with_fields(s, quantity="displacement", noise_density=DISPLACEMENT_NOISE, measuring_range=None, bits=None)
        if s.measures.translates
        else s
        for s in rig.sensors
    )
    return with_fields(rig, sensors=sensors)


def _places(rig: Rig) -> Iterator[Station]:
    """Places at which the force could act instead."""
    for body in rig.bodies:
        for station in {Station(body.name, share * body.length_m): None for share in PLACES}:
            if station != rig.force_at:
                yield station


def _said(rig: Rig, station: Station) -> str:
    return f"the {station.body} at {station.position_m:.3g} m" if rig.body(station.body).length_m else station.body


def _gain(
    known: Rig,
    true: Hypothesis,
    rival: Hypothesis,
    forces_n: Float[np.ndarray, "forces samples"],
    simulate: Simulate,
    tolerances: Tolerances,
) -> float:
    """-2 ln p of the rival less that of the true cause, on a recording that is simulated with the true one."""
    larger = enlarged(true)
    actual = larger.applied_to(known)
    record = record_of(simulate(known, actual, forces_n, 5), tolerances=tolerances)
    begun = begun_on(record, actual)
    own, other = refitted(begun, larger), refitted(begun, rival)
    changes = disagreement(rival, other) - disagreement(true, own)
    return other.misfit.minus_two_log - own.misfit.minus_two_log + changes
