"""Broken tolerances of rig.json: the nuisance parameters that the linear residual asks for beyond their tolerances.

With the residual r of the linear model (contact forces projected out), columns X of one standard deviation of each
nuisance parameter, and a standard normal prior of all parameters, a column d has the score

    z = d' M r / sqrt(d' M d),   M = I - X (X' X + I)^-1 X'

which is standard normal if all tolerances hold. The parameter with the largest score loses its prior, and the others
are scored again.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.findings import Cause, Finding, force_in_words
from identify.checks.observation import observed_motion
from identify.checks.prediction import LinearCheck, Projector
from identify.linear.model import real_product
from identify.linear.nuisance import SINGLE_FORCE_NAME, Nuisance, NuisanceKind, ObservedSignals, changes_of
from identify.linear.observed_motion import BodyMotion
from rig.model.description import Rig, Sensor, force_names
from rig.model.tolerances import Tolerances

MIN_BROKEN_PULL, MIN_CLOCK_PULL = 5.0, 2.7
"""Smallest scores z of a parameter that is named; a clock is one question, tolerances are many."""
MIN_BROKEN_TOLERANCES = 4.0
"""Smallest error of a parameter that is named, in tolerances."""
MAX_BROKEN_COUNT, MIN_PULL_SHARE = 4, 0.25
"""Most parameters that are named, and the smallest score of one as a share of the first one's."""
BATCH_SAMPLES = 1024
"""Samples of all columns in memory at once."""


@dataclass(frozen=True)
class Suspect:
    """A nuisance parameter, or a common error of several; its column is the change by `unit`, relative or in SI.

    Modes beyond the band are not told from those that a description leaves out: they are no finding.
    """

    kind: str
    of: str
    column_change: float
    is_reportable: bool = True


def suspects_of(
    parameters: list[Nuisance],
    bodies: tuple[BodyMotion, ...],
    sensors: tuple[Sensor, ...],
    acceleration_by_force: Complex[np.ndarray, "forces sensors lines"],
    omega: Float[np.ndarray, " lines"],
    tolerances: Tolerances,
) -> tuple[list[Suspect], Complex[np.ndarray, "added sensors lines"]]:
    """All nuisance parameters; then, with columns of their own, densities, the clock and delays of forces."""
    modes_beyond_band = {
        (body.response.body.name, m + 1)
        for body in bodies
        for m in np.flatnonzero(body.response.dynamics.natural_hz > omega[-1] / (2 * np.pi)).tolist()
    }
    suspects = [_suspect_of(p, tolerances, (p.owner, p.mode_number) not in modes_beyond_band) for p in parameters]
    added_suspects = []
    clock_column = np.zeros_like(acceleration_by_force[0])
    for body in bodies:
        response = body.response
        sensor_indices = [i for i, sensor in enumerate(sensors) if sensor.station.body == response.body.name]
        shapes = response.shapes([sensors[i].station for i in sensor_indices])
        frequency_motion = real_product(shapes, response.sensitivity(by_frequency=True) * body.acceleration)
        clock_column[sensor_indices] += frequency_motion
        if response.body.length_m and tolerances.mass:
            density_column = np.zeros_like(clock_column)
            density_column[sensor_indices] = -tolerances.mass * (
                real_product(shapes, body.acceleration) + 0.5 * frequency_motion
            )
            added_suspects.append((Suspect("density", response.body.name, tolerances.mass), density_column))
    added_suspects.append((Suspect("clock", "", 1.0), clock_column))
    if tolerances.delay_s:
        for name, force_motion in zip(force_names(len(acceleration_by_force)), acceleration_by_force, strict=True):
            added_suspects.append(
                (Suspect("force delay", name, tolerances.delay_s), 1j * omega * tolerances.delay_s * force_motion)
            )
    return [*suspects, *(suspect for suspect, _ in added_suspects)], np.stack([column for _, column in added_suspects])


def _suspect_of(parameter: Nuisance, tolerances: Tolerances, is_in_band: bool) -> Suspect:
    """Nuisance parameter with its tolerance as the unit."""
    sensor_tolerance = tolerances.of_sensor(parameter.owner)
    column_change = {
        "gain": sensor_tolerance.gain,
        "position": sensor_tolerance.position_m,
        "delay": sensor_tolerance.delay_s,
        "high-pass": sensor_tolerance.high_pass_hz,
        "force gain": tolerances.force_gain,
        "mass": tolerances.mass,
        "frequency": tolerances.frequency,
        "damping": tolerances.damping,
        "modes left out at": 1.0,
    }[parameter.kind]
    name = parameter.owner + ("" if parameter.mode_number is None else f" {parameter.mode_number}")
    return Suspect(parameter.kind, name, column_change, is_in_band and parameter.kind != NuisanceKind.TRUNCATION)


@dataclass(frozen=True)
class BrokenTolerance:
    """A parameter beyond its tolerance: its error in units of the suspect's column, and its score z (pull)."""

    suspect: Suspect
    size_in_tolerances: float
    pull: float


def broken_tolerances(
    rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances
) -> tuple[list[BrokenTolerance], Float[np.ndarray, " nuisances"]]:
    """Parameters beyond their tolerances, at most four, the highest score first; and all nuisance parameters' pulls.

    A pull is the estimate in standard deviations, with the broken parameters free.
    """
    if len(channel_indices) <= check.contact_count:
        return [], np.zeros(0)
    observed = observed_motion(rig, check, channel_indices, tolerances)
    projector = Projector(check, channel_indices)
    nuisance_parameters, columns = _nuisance_columns(observed, projector)
    if not nuisance_parameters:
        return [], np.zeros(0)
    candidates, added_columns = suspects_of(
        nuisance_parameters, observed.bodies, observed.sensors, observed.force_accelerations, observed.omega, tolerances
    )
    columns += [_Column.of(projector(spectra)) for spectra in added_columns]
    residual = projector((check.spectra.acceleration - check.acceleration_by_all_forces)[channel_indices])
    return _violations_and_pulls(residual, columns, len(nuisance_parameters), candidates, tolerances)


def _nuisance_columns(observed: ObservedSignals, projector: Projector) -> tuple[list[Nuisance], list["_Column"]]:
    """Nuisance parameters and their columns X."""
    parameters, columns = [], []
    for change in changes_of(observed):
        parameters.append(change.parameter)
        columns.append(_Column.of(projector(change.at_all_sensors(len(observed.sensors)))))
    return parameters, columns


def joint_cost(rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances) -> float:
    """Least cost |r - X theta|^2 + |theta|^2 of errors within the tolerances."""
    projector = Projector(check, channel_indices)
    _, columns = _nuisance_columns(observed_motion(rig, check, channel_indices, tolerances), projector)
    residual = projector((check.spectra.acceleration - check.acceleration_by_all_forces)[channel_indices])
    pulls = _scores(residual, columns, len(columns), [], np.ones(residual.shape[1], residual.dtype)).pulls
    return float(np.sum((residual - _column_sum(columns, pulls)) ** 2, dtype=float) + pulls @ pulls)


def misfit_within_tolerances(
    rig: Rig,
    check: LinearCheck,
    channel_indices: list[int],
    tolerances: Tolerances,
    pulls: Float[np.ndarray, " nuisances"],
) -> float:
    """Misfit of these channels without the changes by the nuisance parameters' pulls."""
    acceleration = check.spectra.acceleration.copy()
    observed = observed_motion(rig, check, channel_indices, tolerances)
    for pull, change in zip(pulls, changes_of(observed), strict=True):
        acceleration[channel_indices] -= pull * change.at_all_sensors(len(channel_indices))
    return check.misfit(check.spectra.with_acceleration(acceleration), channel_indices)


def _violations_and_pulls(
    residual: np.ndarray, columns: list["_Column"], prior_count: int, candidates: list[Suspect], tolerances: Tolerances
) -> tuple[list[BrokenTolerance], Float[np.ndarray, " nuisances"]]:
    """Suspects freed one after the other, the highest score first; the first `prior_count` columns have a prior."""
    broken: list[BrokenTolerance] = []
    free_indices: list[int] = []
    time_weights = np.ones(residual.shape[1], residual.dtype)
    while True:
        scores = _scores(residual, columns, prior_count, free_indices, time_weights)
        for _ in range(3):  # lines that nothing explains weigh little
            free_residual = _column_sum([columns[k] for k in free_indices], scores.free_sizes)
            remaining_residual = residual - _column_sum(columns[:prior_count], scores.pulls) - free_residual
            power_by_time = np.mean(remaining_residual**2, axis=0)
            time_weights = 1 / np.sqrt(1 + power_by_time / max(4 * np.median(power_by_time), np.float32(1)))
            scores = _scores(residual, columns, prior_count, free_indices, time_weights)
        min_pull = MIN_PULL_SHARE * abs(broken[0].pull) if broken else 0.0
        violated_indices = [
            k
            for k, candidate in enumerate(candidates)
            if candidate.is_reportable
            and k not in free_indices
            and abs(scores.scores[k]) > max(required_pull(candidate.kind), min_pull)
            and _exceeds_tolerance(candidate, float(scores.sizes[k]), tolerances)
        ]
        if not violated_indices or len(broken) == MAX_BROKEN_COUNT:
            return broken, scores.pulls
        worst_index = max(violated_indices, key=lambda k: abs(scores.scores[k]))
        broken.append(
            BrokenTolerance(
                candidates[worst_index], float(scores.sizes[worst_index]), float(scores.scores[worst_index])
            )
        )
        free_indices.append(worst_index)


@dataclass(frozen=True)
class _Column:
    """Column in half precision, in units of its largest value: there are hundreds, and scores need no more digits."""

    half_values: np.ndarray
    largest_value: np.float32

    @classmethod
    def of(cls, values: np.ndarray) -> "_Column":
        largest_value = np.float32(max(float(np.max(np.abs(values))), 1e-30))
        return cls((values / largest_value).astype(np.float16), largest_value)

    def values(self, samples: slice = slice(None)) -> np.ndarray:
        return np.asarray(self.largest_value * self.half_values[:, samples].astype(np.float32))


def _column_sum(columns: list[_Column], coefficients: np.ndarray) -> np.ndarray | float:
    """Sum of the columns times their coefficients."""
    return sum(
        (np.float32(coefficient) * column.values() for coefficient, column in zip(coefficients, columns, strict=True)),
        start=0.0,
    )


@dataclass(frozen=True)
class _Scores:
    """Scores z of all columns and the parameters' sizes, each as if freed next; estimates with and without a prior."""

    scores: Float[np.ndarray, " columns"]
    sizes: Float[np.ndarray, " columns"]
    pulls: Float[np.ndarray, " nuisances"]
    free_sizes: Float[np.ndarray, " free"]


def _scores(
    residual: np.ndarray, columns: list[_Column], prior_count: int, free_indices: list[int], time_weights: np.ndarray
) -> _Scores:
    """Weighted scores of all columns; the first `prior_count` have a prior, those in `free_indices` none."""
    fitted_indices = [*range(prior_count), *free_indices]
    products, correlations = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
    for first_sample in range(0, residual.shape[1], BATCH_SAMPLES):
        batch_samples = slice(first_sample, first_sample + BATCH_SAMPLES)
        batch_rows = np.stack(
            [column.values(batch_samples) * time_weights[batch_samples] for column in columns]
        ).reshape(len(columns), -1)
        products += batch_rows @ batch_rows.T
        correlations += batch_rows @ (residual[:, batch_samples] * time_weights[batch_samples]).reshape(-1)
    prior_precision = np.r_[np.ones(prior_count), np.full(len(free_indices), 1e-9)]
    covariance = np.linalg.inv(products[np.ix_(fitted_indices, fitted_indices)] + np.diag(prior_precision))
    products_with_fitted = products[:, fitted_indices]
    estimates = covariance @ correlations[fitted_indices]
    unexplained_correlations = correlations - products_with_fitted @ estimates
    variance = np.maximum(
        np.diag(products) - np.einsum("ij,jk,ik->i", products_with_fitted, covariance, products_with_fitted), 1e-12
    )
    sizes, pulls, free_sizes = (unexplained_correlations / variance, estimates[:prior_count], estimates[prior_count:])
    return _Scores(unexplained_correlations / np.sqrt(variance), sizes, pulls, free_sizes)


def required_pull(kind: str) -> float:
    """Smallest score that counts: of the clock, which is one question, or of one of many tolerances."""
    return MIN_CLOCK_PULL if kind == "clock" else MIN_BROKEN_PULL


def required_size(kind: str) -> float:
    """Smallest change of rig.json that counts, in tolerances: the pull of one is no larger than it is off."""
    return MIN_CLOCK_PULL if kind == "clock" else MIN_BROKEN_TOLERANCES


def _exceeds_tolerance(candidate: Suspect, error_size: float, tolerances: Tolerances) -> bool:
    """True if the estimated error is far beyond the tolerance; of the clock, beyond that of frequencies."""
    return abs(error_size) > (1.5 * tolerances.frequency if candidate.kind == "clock" else MIN_BROKEN_TOLERANCES)


def tolerance_finding(violation: BrokenTolerance) -> Finding:
    """Finding on a broken tolerance, in words."""
    suspect, error_size = violation.suspect, violation.size_in_tolerances * violation.suspect.column_change
    tolerances_text = f"({abs(violation.size_in_tolerances):.0f} tolerances)"
    if suspect.kind == "clock":
        return Finding(
            cause="clock",
            evidence=f"all modes of all bodies lie {100 * error_size:+.2g} % off the frequencies of rig.json",
            mend="check the sampling rate: a clock that is off shifts all frequencies alike",
        )
    if suspect.kind == "force gain":
        return Finding(
            cause="gain",
            channels=("force" if suspect.of == SINGLE_FORCE_NAME else suspect.of,),
            evidence=f"{suspect.of} is {100 * error_size:+.2g} % off what all sensors imply {tolerances_text}",
            mend="calibrate the load cell, or check all masses of rig.json",
        )
    if suspect.kind == "force delay":
        return Finding(
            cause="delay",
            channels=(suspect.of,),
            evidence=f"{force_in_words(suspect.of)} comes {1e3 * abs(error_size):.2g} ms "
            f"{'late' if error_size > 0 else 'early'} against all sensors",
            mend="synchronise the force's clock with the sensors'",
        )
    if suspect.kind in ("mass", "density"):
        return Finding(
            cause="mass",
            of=suspect.of,
            evidence=f"{suspect.of} moves as if its {suspect.kind} were {100 * error_size:+.2g} % off rig.json "
            f"{tolerances_text}",
            mend="weigh it and correct rig.json",
        )
    if suspect.kind in ("frequency", "damping"):
        return Finding(
            cause="frequency" if suspect.kind == "frequency" else "damping",
            of=suspect.of,
            evidence=f"the {suspect.kind} of {suspect.of} is {100 * error_size:+.2g} % off rig.json {tolerances_text}",
            mend="fit rig.json to a modal test, or widen its tolerance if it is known no better",
        )
    words_by_kind = {
        "gain": f"is {100 * error_size:+.2g} % off in gain against the others and the model",
        "position": f"moves as if it stood {1e3 * error_size:+.3g} mm from its station",
        "delay": f"comes {1e3 * abs(error_size):.2g} ms {'late' if error_size > 0 else 'early'} against the others",
        "high-pass": f"is high-passed at about {abs(error_size):.2g} Hz",
    }
    remedy_by_kind = {
        "gain": "calibrate it again",
        "position": "measure its place and correct rig.json",
        "delay": f"set delay_s = {error_size:.2g} in rig.json, or synchronise its clock",
        "high-pass": "take the coupling off, or widen high_pass_hz of its tolerance",
    }
    causes: dict[str, Cause] = {"gain": "gain", "position": "station", "delay": "delay", "high-pass": "filtered"}
    return Finding(
        cause=causes[suspect.kind],
        channels=(suspect.of,),
        evidence=f"{suspect.of} {words_by_kind[suspect.kind]} {tolerances_text}",
        mend=remedy_by_kind[suspect.kind],
    )
