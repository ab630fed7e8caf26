"""The next experiment: the further recording that best discriminates two causes which this record leaves alike.

T-optimality (Atkinson and Fedorov, Biometrika 62, 1975): of the experiments that a laboratory can make, the one in
which the refitted rival explains the recording of the true cause worst. Each is simulated with each cause as the true
one. Changes of the rival's parameters are penalised by their covariance from the record at hand.

    log odds = [-2 ln p(rival) + d' (C1 + C2)^-1 d - (-2 ln p(true))] / (2 TEMPERATURE)

d is the change of the rival's parameters from the first fit, C1 and C2 the covariances of both fits: one value has to
serve both records. A cause is simulated `ENLARGED_ERRORS` standard errors larger than fitted, as one that the record
hardly shows is fitted as nothing, and an experiment shows nothing of nothing.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace as with_fields
from scipy.signal import butter, sosfiltfilt

from identify.gaps.decision.comparison import TEMPERATURE
from identify.gaps.decision.null_simulations import phase_randomized
from identify.gaps.residual.extent import REACH
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import SAME_EXPERIMENT, NextExperiment
from identify.gaps.search.hypothesis import ROUNDS, Hypothesis, Search, applied, fit_from
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.model.description import PointMass, Rig, Station
from rig.model.tolerances import Tolerances
from rig.recording.interfaces import Simulate

FORCE_FACTORS = (0.4, 2.5)
"""Forces of the experiments, as multiples of the measured one. Set by hand: what a shaker does without another
setup."""
DURATION_FACTOR = 3
"""Duration of the longer experiment, as a multiple of the record's. Set by hand."""
ENLARGED_ERRORS = 2.0
"""Standard errors by which a simulated cause is larger than fitted; at most this multiple of a typical effect."""
FORCE_POSITIONS = (0.5, 1.0)
"""Positions of the force, as shares of every body's length. Effort."""
ADDED_MASS_SHARE = 0.1
"""Known mass to attach, as a share of the mass of its body. Set by hand."""
DISPLACEMENT_NOISE = 2e-7
"""Noise density of displacement sensors, m/sqrt(Hz)."""
SPLIT_SHARE = 0.4
"""Frequency that splits the band of the force, as a share of its upper end. Set by hand."""
FILTER_ORDER = 8
"""Order of the filter that splits the band. Set by hand."""


@dataclass(frozen=True)
class Experiment:
    """Experiment for the laboratory: its words, the change of the machine and its rig.json, and the forces (N)."""

    words: str
    modify_rig: Callable[[Rig], Rig]
    forces_n: Float[np.ndarray, "forces samples"]


def next_experiments(
    record: Record,
    forces_n: Float[np.ndarray, "forces samples"],
    rivals: tuple[Hypothesis, Hypothesis],
    simulate: Simulate,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[NextExperiment, ...]:
    """Expected gain in log odds of every experiment that can be simulated with both rivals; largest gain first.

    The rivals are two causes that a record leaves alike, or one and the nominal rig. The gain is that of the true one,
    averaged over which of the two is true.
    """
    options = list(experiments(record, forces_n))
    proposals = []
    for i, experiment in enumerate(options):
        nominal_rig = experiment.modify_rig(record.rig)
        try:
            cost_differences = [
                _cost_difference(nominal_rig, true, rival, experiment.forces_n, simulate, record.tolerances)
                for true, rival in (rivals, rivals[::-1])
            ]
        except RigError:
            continue  # the machine cannot be shaken so
        proposals.append(NextExperiment(experiment.words, float(np.mean(cost_differences)) / (2 * TEMPERATURE)))
        progress((i + 1) / len(options))
    return tuple(sorted(proposals, key=lambda proposal: -proposal.log_odds))


def experiments(record: Record, forces_n: Float[np.ndarray, "forces samples"]) -> Iterator[Experiment]:
    """Experiments: the same again, other levels, halves of the band, a longer record, other places of a force that acts
    alone, a known mass on every body, displacement sensors."""
    rate, rig = record.sample_rate_hz, record.rig
    start = round(record.excited_s * rate)
    rng = np.random.default_rng(11)

    def randomized(rows: Float[np.ndarray, "forces samples"]) -> Float[np.ndarray, "forces samples"]:
        return np.array([phase_randomized(row, start, rate, rng) for row in rows])

    repeated_n = randomized(forces_n)
    yield Experiment(SAME_EXPERIMENT, _unchanged, repeated_n)
    for factor in FORCE_FACTORS:
        yield Experiment(f"record with {factor:g} times the force", _unchanged, factor * repeated_n)
    high_hz = float(record.omega[-1] / (2 * np.pi)) / REACH
    for half, kind in (("lower", "lowpass"), ("upper", "highpass")):
        sections = butter(FILTER_ORDER, SPLIT_SHARE * high_hz, kind, fs=rate, output="sos")
        band_n = sosfiltfilt(sections, repeated_n)
        band_n[:, :start] = 0.0
        scaled_n = band_n * (np.std(repeated_n) / max(float(np.std(band_n)), 1e-300))
        yield Experiment(
            f"record with the {half} part of the band, split at {SPLIT_SHARE * high_hz:.3g} Hz", _unchanged, scaled_n
        )
    longer_n, samples = forces_n, round(DURATION_FACTOR * forces_n.shape[1])
    while longer_n.shape[1] < samples:
        longer_n = np.concatenate([longer_n, longer_n[:, :start:-1]], axis=1)  # mirrored, so that it does not jump
    longer_n = randomized(longer_n[:, :samples])
    duration_words = f"record {samples / rate:.3g} s"
    yield Experiment(duration_words, _unchanged, longer_n)
    yield Experiment(
        f"{duration_words} with {FORCE_FACTORS[-1]:g} times the force", _unchanged, FORCE_FACTORS[-1] * longer_n
    )
    for station in _force_stations(rig) if len(rig.forces) == 1 else ():
        yield Experiment(
            f"move the force to {_station_words(rig, station)}", partial(with_fields, force_at=station), repeated_n
        )
    for body in rig.bodies:
        mass_kg = ADDED_MASS_SHARE * getattr(body, "mass_kg", 1.0)
        tip = Station(body.name, body.length_m)
        add_mass = partial(_with_mass, mass=PointMass(station=tip, mass_kg=mass_kg))
        yield Experiment(f"hang a known {1e3 * mass_kg:.3g} g on {_station_words(rig, tip)}", add_mass, repeated_n)
    if any(s.measures.order and s.measures.translates for s in rig.sensors):
        yield Experiment("measure displacements in place of accelerations", _with_displacements, repeated_n)


def initial_search(record: Record, rig: Rig) -> Search:
    """Common start of the fits to a record: scales and slow motion of a rig fitted to it.

    All hypotheses that are compared start here, so that none stays in a worse minimum than another.
    """
    linearization, residual = fit_nuisance(record, rig)
    return Search(nominal_variances_of(linearized(record, record.rig)), linearization, residual, ())


def refit_hypothesis(start: Search, hypothesis: Hypothesis, fix_parameters: bool = False) -> Hypothesis:
    """Refit the parameters of a cause, from their present values, to a record whose rig may differ from the first one.

    Parameters can be fixed; those known by their spectrum alone keep their values. Raises RigError where the rig cannot
    have the cause.
    """
    record = start.linearization.record
    if fix_parameters or any(candidate.kind.stochastic for candidate in hypothesis.candidates):
        rig = hypothesis.applied_to(record.rig)
        return replace(hypothesis, misfit=fit_from(start, lambda _: rig, (), np.zeros(0), ROUNDS).hypothesis.misfit)
    return fit_from(
        start, partial(applied, record.rig, hypothesis.candidates), hypothesis.candidates, hypothesis.values, ROUNDS
    ).hypothesis


def enlarge_strengths(hypothesis: Hypothesis) -> Hypothesis:
    """Hypothesis with every strength `ENLARGED_ERRORS` standard errors further from its neutral value than fitted.

    A typical effect replaces the standard error where it is smaller. A cause that a record hardly shows is fitted as
    almost nothing; simulated so, no experiment would discriminate it from another.
    """
    values, deviations = hypothesis.values.copy(), np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    typical = np.concatenate([np.zeros(0), *(candidate.default for candidate in hypothesis.candidates)])
    for i, parameter in enumerate(hypothesis.parameters):
        if parameter.neutral is not None:
            direction = np.sign(values[i] - parameter.neutral) or np.sign(typical[i] - parameter.neutral)
            values[i] += direction * ENLARGED_ERRORS * min(deviations[i], abs(typical[i] - parameter.neutral))
            values[i] = np.clip(values[i], parameter.low, parameter.high)
    return replace(hypothesis, values=values)


def disagreement(first: Hypothesis, second: Hypothesis) -> float:
    """Excess of the joint -2 ln p of two records, with one value of each parameter, over the sum of their own.

    d' (C1 + C2)^-1 d with the difference d of both fits, without the record-specific parameters.
    """
    shared = [
        parameter.name not in candidate.kind.of_a_record and not candidate.kind.stochastic
        for candidate in first.candidates
        for parameter in candidate.parameters
    ]
    difference = (first.values - second.values)[shared]
    covariance = (first.covariance + second.covariance)[np.ix_(shared, shared)]
    return float(difference @ np.linalg.pinv(covariance, hermitian=True) @ difference)


def _unchanged(rig: Rig) -> Rig:
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


def _force_stations(rig: Rig) -> Iterator[Station]:
    """Stations of `FORCE_POSITIONS` at which the force does not act yet."""
    for body in rig.bodies:
        for station in {Station(body.name, share * body.length_m): None for share in FORCE_POSITIONS}:
            if station != rig.force_at:
                yield station


def _station_words(rig: Rig, station: Station) -> str:
    return f"the {station.body} at {station.position_m:.3g} m" if rig.body(station.body).length_m else station.body


def _cost_difference(
    nominal_rig: Rig,
    true: Hypothesis,
    rival: Hypothesis,
    forces_n: Float[np.ndarray, "forces samples"],
    simulate: Simulate,
    tolerances: Tolerances,
) -> float:
    """-2 ln p of the rival less that of the true cause, on a recording that is simulated with the true cause."""
    enlarged = enlarge_strengths(true)
    actual = enlarged.applied_to(nominal_rig)
    record = record_of(simulate(nominal_rig, actual, forces_n, 5), tolerances=tolerances)
    start = initial_search(record, actual)
    true_refit, rival_refit = refit_hypothesis(start, enlarged), refit_hypothesis(start, rival)
    disagreement_excess = disagreement(rival, rival_refit) - disagreement(true, true_refit)
    return rival_refit.misfit.minus_two_log - true_refit.misfit.minus_two_log + disagreement_excess
