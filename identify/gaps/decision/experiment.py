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
from identify.gaps.residual.extent import BAND_REACH
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
    for experiment_index, experiment in enumerate(possible_experiments):
        nominal_rig = experiment.rig_change(record.rig)
        try:
            cost_differences = [
                _cost_difference(nominal_rig, true_cause, rival_cause, experiment.forces_n, simulate, record.tolerances)
                for true_cause, rival_cause in (rival_pair, rival_pair[::-1])
            ]
        except RigError:
            continue  # the machine cannot be shaken so
        proposals.append(NextExperiment(experiment.instruction, float(np.mean(cost_differences)) / (2 * TEMPERATURE)))
        progress((experiment_index + 1) / len(possible_experiments))
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
    for force_factor in FORCE_FACTORS:
        yield Experiment(f"record with {force_factor:g} times the force", _unchanged_rig, force_factor * repeated_n)
    high_hz = float(record.omega[-1] / (2 * np.pi)) / BAND_REACH
    for band_half, filter_kind in (("lower", "lowpass"), ("upper", "highpass")):
        filter_sections = butter(FILTER_ORDER, SPLIT_SHARE * high_hz, filter_kind, fs=rate_hz, output="sos")
        band_n = sosfiltfilt(filter_sections, repeated_n)
        band_n[:, :start_sample] = 0.0
        scaled_band_n = band_n * (np.std(repeated_n) / max(float(np.std(band_n)), 1e-300))
        yield Experiment(
            f"record with the {band_half} part of the band, split at {SPLIT_SHARE * high_hz:.3g} Hz",
            _unchanged_rig,
            scaled_band_n,
        )
    longer_forces_n, longer_sample_count = forces_n, round(DURATION_FACTOR * forces_n.shape[1])
    while longer_forces_n.shape[1] < longer_sample_count:
        longer_forces_n = np.concatenate(
            [longer_forces_n, longer_forces_n[:, :start_sample:-1]], axis=1
        )  # mirrored, so that it does not jump
    longer_forces_n = randomized(longer_forces_n[:, :longer_sample_count])
    duration_words = f"record {longer_sample_count / rate_hz:.3g} s"
    yield Experiment(duration_words, _unchanged_rig, longer_forces_n)
    yield Experiment(
        f"{duration_words} with {FORCE_FACTORS[-1]:g} times the force",
        _unchanged_rig,
        FORCE_FACTORS[-1] * longer_forces_n,
    )
    for station in _force_stations(rig) if len(rig.forces) == 1 and not rig.base_sensors else ():
        yield Experiment(
            f"move the force to {_station_words(rig, station)}", partial(with_fields, force_at=station), repeated_n
        )
    for body in rig.bodies:
        mass_kg = ADDED_MASS_SHARE * getattr(body, "mass_kg", 1.0)
        tip_station = Station(body.name, body.length_m)
        add_mass = partial(_rig_with_mass, mass=PointMass(station=tip_station, mass_kg=mass_kg))
        yield Experiment(
            f"hang a known {1e3 * mass_kg:.3g} g on {_station_words(rig, tip_station)}", add_mass, repeated_n
        )
    if any(sensor.measures.order and sensor.measures.translates for sensor in rig.sensors):
        yield Experiment("measure displacements in place of accelerations", _rig_with_displacements, repeated_n)


def initial_search(record: Record, rig: Rig) -> Search:
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
    record = search_start.linearization.record
    if fix_parameters or any(candidate.kind.stochastic for candidate in hypothesis.candidates):
        hypothesis_rig = hypothesis.applied_to(record.rig)
        return replace(
            hypothesis,
            misfit=fit_from(search_start, lambda _: hypothesis_rig, (), np.zeros(0), REFIT_ROUNDS).hypothesis.misfit,
        )
    return fit_from(
        search_start,
        partial(with_effects, record.rig, hypothesis.candidates),
        hypothesis.candidates,
        hypothesis.values,
        REFIT_ROUNDS,
    ).hypothesis


def enlarge_strengths(hypothesis: Hypothesis) -> Hypothesis:
    """Hypothesis with every strength `ENLARGED_ERRORS` standard errors further from its neutral value than fitted.

    A typical effect replaces the standard error where it is smaller. A cause that a record hardly shows is fitted as
    almost nothing; simulated so, no experiment would discriminate it from another.
    """
    enlarged_values = hypothesis.values.copy()
    standard_errors = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    typical_values = np.concatenate([np.zeros(0), *(candidate.typical_values for candidate in hypothesis.candidates)])
    for parameter_index, parameter in enumerate(hypothesis.parameters):
        if parameter.neutral is not None:
            strength_sign = np.sign(enlarged_values[parameter_index] - parameter.neutral) or np.sign(
                typical_values[parameter_index] - parameter.neutral
            )
            enlarged_values[parameter_index] += (
                strength_sign
                * ENLARGED_ERRORS
                * min(standard_errors[parameter_index], abs(typical_values[parameter_index] - parameter.neutral))
            )
            enlarged_values[parameter_index] = np.clip(enlarged_values[parameter_index], parameter.low, parameter.high)
    return replace(hypothesis, values=enlarged_values)


def disagreement(first_fit: Hypothesis, second_fit: Hypothesis) -> float:
    """Excess of the joint -2 ln p of two records, with one value of each parameter, over the sum of their own.

    d' (C1 + C2)^-1 d with the difference d of both fits, without the record-specific parameters.
    """
    is_shared = [
        parameter.name not in candidate.kind.of_a_record and not candidate.kind.stochastic
        for candidate in first_fit.candidates
        for parameter in candidate.parameters
    ]
    value_differences = (first_fit.values - second_fit.values)[is_shared]
    covariance = (first_fit.covariance + second_fit.covariance)[np.ix_(is_shared, is_shared)]
    return float(value_differences @ np.linalg.pinv(covariance, hermitian=True) @ value_differences)


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


def _force_stations(rig: Rig) -> Iterator[Station]:
    """Stations of `FORCE_POSITIONS` at which the force does not act yet."""
    for body in rig.bodies:
        for station in {Station(body.name, length_share * body.length_m): None for length_share in FORCE_POSITIONS}:
            if station != rig.force_at:
                yield station


def _station_words(rig: Rig, station: Station) -> str:
    return f"the {station.body} at {station.position_m:.3g} m" if rig.body(station.body).length_m else station.body


def _cost_difference(
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
    simulated_record = record_of(simulate(nominal_rig, actual_rig, forces_n, 5), tolerances=tolerances)
    common_start = initial_search(simulated_record, actual_rig)
    true_refit = refit_hypothesis(common_start, enlarged_cause)
    rival_refit = refit_hypothesis(common_start, rival_cause)
    disagreement_excess = disagreement(rival_cause, rival_refit) - disagreement(true_cause, true_refit)
    return rival_refit.misfit.minus_two_log - true_refit.misfit.minus_two_log + disagreement_excess
