"""The next experiment: the further recording that best discriminates two causes which this record leaves alike.

T-optimality (Atkinson and Fedorov, Biometrika 62, 1975): of the experiments that a laboratory can make, the one in
which the refitted rival explains the recording of the true cause worst. Each is simulated with each cause as the true
one. Changes of the rival's parameters are penalised by their covariance from the record at hand.

    log odds = [-2 ln p(rival) + d' (C1 + C2)^-1 d - (-2 ln p(true))] / (2 TEMPERATURE)

d is the change of the rival's parameters from the first fit, C1 and C2 the covariances of both fits: one value has to
serve both records. A cause is simulated `ENLARGEMENT_IN_ERRORS` standard errors larger than fitted, as one that the
record hardly shows is fitted as nothing, and an experiment shows nothing of nothing.
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
from identify.gaps.residual.extent import FORCE_BAND_RATIO
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import SAME_EXPERIMENT, NextExperiment
from identify.gaps.search.hypothesis import REFIT_ROUNDS, Hypothesis, Search, fit_from, with_effects
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
ENLARGEMENT_IN_ERRORS = 2.0
"""Standard errors by which a simulated cause is larger than fitted; at most this multiple of a typical effect."""
FORCE_POSITIONS = (0.5, 1.0)
"""Positions of the force, as shares of every body's length. Effort."""
ADDED_MASS_SHARE = 0.1
"""Known mass to attach, as a share of the mass of its body. Set by hand."""
DISPLACEMENT_NOISE = 2e-7
"""Noise density of displacement sensors, m/sqrt(Hz)."""
BAND_SPLIT_SHARE = 0.4
"""Frequency that splits the band of the force, as a share of its upper end. Set by hand."""
FILTER_ORDER = 8
"""Order of the filter that splits the band. Set by hand."""


@dataclass(frozen=True)
class Experiment:
    """Experiment for the laboratory: its words, the change of the machine and its rig.json, and the forces (N)."""

    instruction: str
    rig_change: Callable[[Rig], Rig]
    forces_n: Float[np.ndarray, "forces samples"]


def next_experiments(
    record: Record,
    forces_n: Float[np.ndarray, "forces samples"],
    rival_pair: tuple[Hypothesis, Hypothesis],
    simulate: Simulate,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[NextExperiment, ...]:
    """Expected gain in log odds of every experiment that can be simulated with both rivals; largest gain first.

    The rivals are two causes that a record leaves alike, or one and the nominal rig. The gain is that of the true one,
    averaged over which of the two is true.
    """
    possible_experiments = list(experiments(record, forces_n))
    proposals = []
    for index, experiment in enumerate(possible_experiments):
        rig = experiment.rig_change(record.rig)
        try:
            cost_differences = [
                _rival_excess_minus_two_log(
                    rig, true_cause, rival_cause, experiment.forces_n, simulate, record.tolerances
                )
                for true_cause, rival_cause in (rival_pair, rival_pair[::-1])
            ]
        except RigError:
            continue  # the machine cannot be shaken so
        proposals.append(NextExperiment(experiment.instruction, float(np.mean(cost_differences)) / (2 * TEMPERATURE)))
        progress((index + 1) / len(possible_experiments))
    return tuple(sorted(proposals, key=lambda proposal: -proposal.log_odds))


def experiments(record: Record, forces_n: Float[np.ndarray, "forces samples"]) -> Iterator[Experiment]:
    """Experiments: the same again, other levels, halves of the band, a longer record, other places of a force that acts
    alone, a known mass on every body, displacement sensors."""
    rate_hz, rig = record.sample_rate_hz, record.rig
    start_sample = round(record.excitation_start_s * rate_hz)
    rng = np.random.default_rng(11)

    def randomized(given_forces_n: Float[np.ndarray, "forces samples"]) -> Float[np.ndarray, "forces samples"]:
        return np.array([phase_randomized(force_n, start_sample, rate_hz, rng) for force_n in given_forces_n])

    repeated_n = randomized(forces_n)
    yield Experiment(SAME_EXPERIMENT, _unchanged_rig, repeated_n)
    for factor in FORCE_FACTORS:
        yield Experiment(f"record with {factor:g} times the force", _unchanged_rig, factor * repeated_n)
    split_hz = BAND_SPLIT_SHARE * (float(record.omega[-1] / (2 * np.pi)) / FORCE_BAND_RATIO)
    for half, filter_kind in (("lower", "lowpass"), ("upper", "highpass")):
        band_forces_n = sosfiltfilt(butter(FILTER_ORDER, split_hz, filter_kind, fs=rate_hz, output="sos"), repeated_n)
        band_forces_n[:, :start_sample] = 0.0
        scaled_n = band_forces_n * (np.std(repeated_n) / max(float(np.std(band_forces_n)), 1e-300))
        instruction = f"record with the {half} part of the band, split at {split_hz:.3g} Hz"
        yield Experiment(instruction, _unchanged_rig, scaled_n)
    longer_forces_n, sample_count = forces_n, round(DURATION_FACTOR * forces_n.shape[1])
    while longer_forces_n.shape[1] < sample_count:  # mirrored, so that it does not jump
        longer_forces_n = np.concatenate([longer_forces_n, longer_forces_n[:, :start_sample:-1]], axis=1)
    longer_forces_n, factor = randomized(longer_forces_n[:, :sample_count]), FORCE_FACTORS[-1]
    instruction = f"record {sample_count / rate_hz:.3g} s"
    yield Experiment(instruction, _unchanged_rig, longer_forces_n)
    yield Experiment(f"{instruction} with {factor:g} times the force", _unchanged_rig, factor * longer_forces_n)
    for station in _alternative_force_stations(rig) if len(rig.forces) == 1 and not rig.base_sensors else ():
        instruction = f"move the force to {_station_words(rig, station)}"
        yield Experiment(instruction, partial(with_fields, force_at=station), repeated_n)
    for body in rig.bodies:
        mass_kg = ADDED_MASS_SHARE * getattr(body, "mass_kg", 1.0)
        tip = Station(body.name, body.length_m)
        add_mass = partial(_rig_with_mass, mass=PointMass(station=tip, mass_kg=mass_kg))
        yield Experiment(f"hang a known {1e3 * mass_kg:.3g} g on {_station_words(rig, tip)}", add_mass, repeated_n)
    if any(sensor.measures.order and sensor.measures.translates for sensor in rig.sensors):
        yield Experiment("measure displacements in place of accelerations", _rig_with_displacements, repeated_n)


def common_fit_start(record: Record, rig: Rig) -> Search:
    """Common start of the fits to a record: scales and slow motion of a rig fitted to it.

    All hypotheses that are compared start here, so that none stays in a worse minimum than another.
    """
    linearization, residual = fit_nuisance(record, rig)
    return Search(nominal_variances_of(linearized(record, record.rig)), linearization, residual, ())


def refit_hypothesis(search_start: Search, hypothesis: Hypothesis, fix_parameters: bool = False) -> Hypothesis:
    """Refit the parameters of a cause, from their present values, to a record whose rig may differ from the first one.

    Parameters can be fixed; those known by their spectrum alone keep their values. Raises RigError where the rig cannot
    have the cause.
    """
    rig, candidates = search_start.linearization.record.rig, hypothesis.candidates
    if fix_parameters or any(candidate.kind.stochastic for candidate in candidates):
        applied_rig = hypothesis.applied_to(rig)
        nuisance_refit = fit_from(search_start, lambda _: applied_rig, (), np.zeros(0), REFIT_ROUNDS).hypothesis
        return replace(hypothesis, misfit=nuisance_refit.misfit)
    build_rig = partial(with_effects, rig, candidates)
    return fit_from(search_start, build_rig, candidates, hypothesis.values, REFIT_ROUNDS).hypothesis


def enlarge_strengths(hypothesis: Hypothesis) -> Hypothesis:
    """Hypothesis with every strength `ENLARGEMENT_IN_ERRORS` standard errors further from its neutral value.

    A typical effect replaces the standard error where it is smaller. A cause that a record hardly shows is fitted as
    almost nothing; simulated so, no experiment would discriminate it from another.
    """
    values = hypothesis.values.copy()
    standard_errors = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    typical_values = np.concatenate([np.zeros(0), *(candidate.typical_values for candidate in hypothesis.candidates)])
    for index, parameter in enumerate(hypothesis.parameters):
        if parameter.neutral is not None:
            typical_strength = typical_values[index] - parameter.neutral
            sign = np.sign(values[index] - parameter.neutral) or np.sign(typical_strength)
            values[index] += sign * ENLARGEMENT_IN_ERRORS * min(standard_errors[index], abs(typical_strength))
            values[index] = np.clip(values[index], parameter.low, parameter.high)
    return replace(hypothesis, values=values)


def disagreement_cost(first_fit: Hypothesis, second_fit: Hypothesis) -> float:
    """Excess of the joint -2 ln p of two records, with one value of each parameter, over the sum of their own.

    d' (C1 + C2)^-1 d with the difference d of both fits, without the record-specific parameters.
    """
    is_shared = [
        parameter.name not in candidate.kind.of_a_record and not candidate.kind.stochastic
        for candidate in first_fit.candidates
        for parameter in candidate.parameters
    ]
    shared_change = (first_fit.values - second_fit.values)[is_shared]
    covariance = (first_fit.covariance + second_fit.covariance)[np.ix_(is_shared, is_shared)]
    return float(shared_change @ np.linalg.pinv(covariance, hermitian=True) @ shared_change)


def _unchanged_rig(rig: Rig) -> Rig:
    return rig


def _rig_with_mass(rig: Rig, mass: PointMass) -> Rig:
    return with_fields(rig, masses=(*rig.masses, mass))


def _rig_with_displacements(rig: Rig) -> Rig:
    sensors = tuple(
        with_fields(sensor, quantity="displacement", noise_density=DISPLACEMENT_NOISE, measuring_range=None, bits=None)
        if sensor.measures.translates
        else sensor
        for sensor in rig.sensors
    )
    return with_fields(rig, sensors=sensors)


def _alternative_force_stations(rig: Rig) -> Iterator[Station]:
    """Stations of `FORCE_POSITIONS` at which the force does not act yet."""
    for body in rig.bodies:
        for station in {Station(body.name, length_share * body.length_m): None for length_share in FORCE_POSITIONS}:
            if station != rig.force_at:
                yield station


def _station_words(rig: Rig, station: Station) -> str:
    return f"the {station.body} at {station.position_m:.3g} m" if rig.body(station.body).length_m else station.body


def _rival_excess_minus_two_log(
    nominal_rig: Rig,
    true_cause: Hypothesis,
    rival_cause: Hypothesis,
    forces_n: Float[np.ndarray, "forces samples"],
    simulate: Simulate,
    tolerances: Tolerances,
) -> float:
    """-2 ln p of the rival less that of the true cause, on a recording that is simulated with the true cause."""
    enlarged_cause = enlarge_strengths(true_cause)
    actual_rig = enlarged_cause.applied_to(nominal_rig)
    record = record_of(simulate(nominal_rig, actual_rig, forces_n, 5), tolerances=tolerances)
    search_start = common_fit_start(record, actual_rig)
    true_refit, rival_refit = (refit_hypothesis(search_start, cause) for cause in (enlarged_cause, rival_cause))
    excess_cost = disagreement_cost(rival_cause, rival_refit) - disagreement_cost(true_cause, true_refit)
    return rival_refit.misfit.minus_two_log - true_refit.misfit.minus_two_log + excess_cost
