"""Broken tolerances of rig.json: the nuisance parameters that the linear residual asks for beyond their tolerances.

With the residual r of the linear model (contact forces projected out), columns X of one standard deviation of each
nuisance parameter, and a standard normal prior of all parameters, a column d has the score

    z = d' M r / sqrt(d' M d),   M = I - X (X' X + I)^-1 X'

which is standard normal if all tolerances hold. The parameter with the largest score loses its prior, and the others
are scored again.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.channels import MIN_ERROR_IN_TOLERANCES, TURNED_MEND, turned_words
from identify.checks.findings import Cause, Finding, force_in_words
from identify.checks.prediction import (
    MIN_MODEL_ERROR_SHARE,
    MODEL_ERROR_SHARE,
    LinearCheck,
    TimeResidual,
    observed_motion,
)
from identify.linear.model import real_product
from identify.linear.nuisance import (
    SINGLE_FORCE_NAME,
    Change,
    Nuisance,
    NuisanceKind,
    ObservedSignals,
    changes_of,
    crosstalk_changes,
)
from identify.linear.observed_motion import BodyMotion
from rig.model.description import Rig, Sensor, force_names
from rig.model.tolerances import Tolerances

MIN_BROKEN_PULL, MIN_CLOCK_PULL = 5.0, 2.7
"""Smallest scores z of a parameter that is named; a clock is one question, tolerances are many."""
MIN_REMOVED_SHARE = 0.25
"""Least share that a named parameter takes away of what a channel has beyond a sound record's residual."""
MAX_BROKEN_COUNT, MIN_PULL_SHARE = 4, 0.25
"""Most parameters that are named, and the smallest score of one as a share of the first one's."""
BATCH_SAMPLES = 1024
"""Samples of all columns in memory at once."""

Pulls = Mapping[Nuisance, float]
"""Estimates of nuisance parameters in standard deviations."""


@dataclass(frozen=True)
class Suspect:
    """A nuisance parameter, or a common error of several; its column is that by column_change, relative or in SI.

    Modes beyond the band are not told from those that a description leaves out, and crosstalk not from gains of
    neighbours: they are no finding.
    """

    kind: str
    of: str
    column_change: float
    is_reportable: bool = True


def suspects_and_further_columns(
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
    further_columns = []
    clock_column = np.zeros_like(acceleration_by_force[0])
    for body in bodies:
        response = body.response
        sensor_indices = [i for i, sensor in enumerate(sensors) if sensor.station.body == response.body.name]
        shapes = response.shapes([sensors[i].station for i in sensor_indices])
        by_frequency = real_product(shapes, response.sensitivity(by_frequency=True) * body.acceleration)
        clock_column[sensor_indices] += by_frequency
        if response.body.length_m and tolerances.mass:
            column = np.zeros_like(clock_column)
            column[sensor_indices] = -tolerances.mass * (real_product(shapes, body.acceleration) + 0.5 * by_frequency)
            suspects.append(Suspect("density", response.body.name, tolerances.mass))
            further_columns.append(column)
    suspects.append(Suspect("clock", "", 1.0))
    further_columns.append(clock_column)
    if delay_s := tolerances.delay_s:
        suspects += [Suspect("force delay", name, delay_s) for name in force_names(len(acceleration_by_force))]
        further_columns += [1j * omega * delay_s * motion for motion in acceleration_by_force]
    return suspects, np.stack(further_columns)


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
        "truncated response": tolerances.truncation,
        "crosstalk": tolerances.crosstalk,
        "cross-axis share": sensor_tolerance.cross_axis,
    }[parameter.kind]
    owner_name = parameter.owner + ("" if parameter.mode_number is None else f" {parameter.mode_number}")
    is_reportable = is_in_band and parameter.kind not in (NuisanceKind.TRUNCATION, NuisanceKind.CROSSTALK)
    return Suspect(parameter.kind, owner_name, column_change, is_reportable)


@dataclass(frozen=True)
class BrokenTolerance:
    """A parameter beyond its tolerance: its error in units of the suspect's column, and its score z (pull).

    channel_index is the channel that it changes most, of whose motion motion_share (rms) is unexplained without it. It
    takes away removed_share of the power that a sound record would not have.
    """

    suspect: Suspect
    size_in_tolerances: float
    pull: float
    channel_index: int
    motion_share: float
    removed_share: float

    @property
    def is_material(self) -> bool:
        return self.removed_share >= MIN_REMOVED_SHARE


def broken_tolerances_and_pulls(
    rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances
) -> tuple[list[BrokenTolerance], Pulls]:
    """Parameters beyond their tolerances, at most four, the highest score first; and all nuisance parameters' pulls.

    A pull is the estimate in standard deviations, with the broken parameters free.
    """
    if len(channel_indices) <= check.contact_count:
        return [], {}
    observed = observed_motion(rig, check, channel_indices, tolerances)
    projector = TimeResidual(check, channel_indices)
    nuisance_parameters, columns = _nuisances_and_columns(observed, projector)
    if not nuisance_parameters:
        return [], {}
    candidates, added_columns = suspects_and_further_columns(
        nuisance_parameters, observed.bodies, observed.sensors, observed.force_accelerations, observed.omega, tolerances
    )
    columns += [_Column.of(projector(spectra)) for spectra in added_columns]
    residual = projector((check.spectra.acceleration - check.acceleration_by_all_forces)[channel_indices])
    broken, pulls = _violations_and_pulls(
        residual, columns, len(nuisance_parameters), candidates, tolerances, projector
    )
    broken = [replace(b, channel_index=channel_indices[b.channel_index]) for b in broken]
    return broken, dict(zip(nuisance_parameters, pulls.tolist(), strict=True))


def _nuisances_and_columns(observed: ObservedSignals, residual: TimeResidual) -> tuple[list[Nuisance], list["_Column"]]:
    """Nuisance parameters and their columns X."""
    parameters, columns = [], []
    for change in _changes_within_tolerances(observed):
        parameters.append(change.parameter)
        columns.append(_Column.of(residual(change.at_all_sensors(len(observed.sensors)))))
    return parameters, columns


def _changes_within_tolerances(observed: ObservedSignals) -> Iterator[Change]:
    """Changes by every nuisance parameter, crosstalk of neighbouring channels included."""
    yield from changes_of(observed)
    yield from crosstalk_changes(observed)


def cost_within_tolerances(rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances) -> float:
    """Least cost |r - X theta|^2 + |theta|^2 of errors within the tolerances."""
    projector = TimeResidual(check, channel_indices)
    _, columns = _nuisances_and_columns(observed_motion(rig, check, channel_indices, tolerances), projector)
    residual = projector((check.spectra.acceleration - check.acceleration_by_all_forces)[channel_indices])
    pulls = _scores(residual, columns, len(columns), [], np.ones(residual.shape[1], residual.dtype)).pulls
    return float(np.sum((residual - _column_sum(columns, pulls)) ** 2, dtype=float) + pulls @ pulls)


def misfit_within_tolerances(
    rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances, pulls: Pulls
) -> float:
    """Misfit of these channels without the changes by the nuisance parameters' pulls."""
    acceleration = check.spectra.acceleration.copy()
    observed = observed_motion(rig, check, channel_indices, tolerances)
    for change in _changes_within_tolerances(observed):
        acceleration[channel_indices] -= pulls[change.parameter] * change.at_all_sensors(len(channel_indices))
    return check.misfit(check.spectra.with_acceleration(acceleration), channel_indices)


def misfit_over_time_within_tolerances(
    rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances, pulls: Pulls
) -> float:
    """Mean square of what the pulls leave over the compared time, in the unit of a misfit.

    Ringing that the record's end cuts off spreads over the lines, but not over that time.
    """
    projector = TimeResidual(check, channel_indices)
    parameters, columns = _nuisances_and_columns(observed_motion(rig, check, channel_indices, tolerances), projector)
    residual = projector((check.spectra.acceleration - check.acceleration_by_all_forces)[channel_indices])
    unexplained = residual - _column_sum(columns, np.array([pulls[parameter] for parameter in parameters]))
    mean_square = float(np.mean(unexplained**2, dtype=float)) / projector.sound_power
    return mean_square * (MIN_MODEL_ERROR_SHARE / MODEL_ERROR_SHARE) ** 2


def _violations_and_pulls(
    residual: np.ndarray,
    columns: list["_Column"],
    prior_count: int,
    candidates: list[Suspect],
    tolerances: Tolerances,
    projector: TimeResidual,
) -> tuple[list[BrokenTolerance], Float[np.ndarray, " nuisances"]]:
    """Suspects freed one after the other, the highest score first; the first `prior_count` columns have a prior."""
    broken: list[BrokenTolerance] = []
    free_indices: list[int] = []
    time_weights = np.ones(residual.shape[1], residual.dtype)
    freed: tuple[Suspect, int, float, float, np.ndarray] | None = None
    while True:
        scores = _scores(residual, columns, prior_count, free_indices, time_weights)
        for _ in range(3):  # lines that nothing explains weigh little
            free_sum = _column_sum([columns[k] for k in free_indices], scores.free_errors)
            unexplained = residual - _column_sum(columns[:prior_count], scores.pulls) - free_sum
            unexplained_power = np.mean(unexplained**2, axis=0)
            time_weights = 1 / np.sqrt(1 + unexplained_power / max(4 * np.median(unexplained_power), np.float32(1)))
            scores = _scores(residual, columns, prior_count, free_indices, time_weights)
        if freed is not None:
            broken.append(_broken_tolerance(*freed, unexplained, time_weights, projector))
        min_pull = MIN_PULL_SHARE * abs(broken[0].pull) if broken else 0.0
        violated_indices = [
            k
            for k, candidate in enumerate(candidates)
            if candidate.is_reportable
            and k not in free_indices
            and abs(scores.scores[k]) > max(required_pull(candidate.kind), min_pull)
            and _is_far_beyond_tolerance(candidate, float(scores.errors[k]), tolerances)
        ]
        if not violated_indices or len(broken) == MAX_BROKEN_COUNT:
            return broken, scores.pulls
        worst = max(violated_indices, key=lambda k: abs(scores.scores[k]))
        channel_index = int(np.argmax(np.mean(columns[worst].values() ** 2, axis=1)))
        freed = candidates[worst], channel_index, float(scores.errors[worst]), float(scores.scores[worst]), unexplained
        free_indices.append(worst)


def _broken_tolerance(
    suspect: Suspect,
    channel_index: int,
    error: float,
    pull: float,
    unexplained_before: np.ndarray,
    unexplained_after: np.ndarray,
    time_weights: np.ndarray,
    projector: TimeResidual,
) -> BrokenTolerance:
    """Broken tolerance, with what it takes away at the channel that it changes most."""
    power_before, power_after = (
        float(np.mean((unexplained[channel_index] * time_weights) ** 2) / np.mean(time_weights**2))
        for unexplained in (unexplained_before, unexplained_after)
    )
    excess_power = power_before - projector.sound_power
    removed_share = min((power_before - power_after) / excess_power, 1.0) if excess_power > 0 else 1.0
    motion_share = float(np.sqrt(power_before / max(float(projector.motion_powers[channel_index]), 1e-300)))
    return BrokenTolerance(suspect, error, pull, channel_index, motion_share, removed_share)


@dataclass(frozen=True)
class _Column:
    """Column in half precision, in units of its largest value: there are hundreds, and scores need no more digits."""

    half_values: np.ndarray
    largest_value: np.float32

    @classmethod
    def of(cls, values: np.ndarray) -> "_Column":
        largest_value = np.float32(max(float(np.max(np.abs(values))), 1e-30))
        return cls((values / largest_value).astype(np.float16), largest_value)

    def values(self, sample_slice: slice = slice(None)) -> np.ndarray:
        return np.asarray(self.largest_value * self.half_values[:, sample_slice].astype(np.float32))


def _column_sum(columns: list[_Column], coefficients: np.ndarray) -> np.ndarray | float:
    """Sum of the columns times their coefficients."""
    terms = (np.float32(size) * column.values() for size, column in zip(coefficients, columns, strict=True))
    return sum(terms, start=0.0)


@dataclass(frozen=True)
class _Scores:
    """Scores z of all columns and the parameters' errors, each as if freed next; estimates with and without a prior."""

    scores: Float[np.ndarray, " columns"]
    errors: Float[np.ndarray, " columns"]
    pulls: Float[np.ndarray, " nuisances"]
    free_errors: Float[np.ndarray, " free"]


def _scores(
    residual: np.ndarray, columns: list[_Column], prior_count: int, free_indices: list[int], time_weights: np.ndarray
) -> _Scores:
    """Weighted scores of all columns; the first `prior_count` have a prior, those in `free_indices` none."""
    fitted_indices = [*range(prior_count), *free_indices]
    column_products, residual_products = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
    for first_sample in range(0, residual.shape[1], BATCH_SAMPLES):
        batch = slice(first_sample, first_sample + BATCH_SAMPLES)
        batch_weights = time_weights[batch]
        weighted_rows = np.stack([column.values(batch) * batch_weights for column in columns]).reshape(len(columns), -1)
        column_products += weighted_rows @ weighted_rows.T
        residual_products += weighted_rows @ (residual[:, batch] * batch_weights).reshape(-1)
    prior_precisions = np.r_[np.ones(prior_count), np.full(len(free_indices), 1e-9)]
    covariance = np.linalg.inv(column_products[np.ix_(fitted_indices, fitted_indices)] + np.diag(prior_precisions))
    with_fitted = column_products[:, fitted_indices]
    fitted_estimates = covariance @ residual_products[fitted_indices]
    unexplained_products = residual_products - with_fitted @ fitted_estimates
    explained_variance = np.einsum("ij,jk,ik->i", with_fitted, covariance, with_fitted)
    variances = np.maximum(np.diag(column_products) - explained_variance, 1e-12)
    scores, errors = unexplained_products / np.sqrt(variances), unexplained_products / variances
    return _Scores(scores, errors, pulls=fitted_estimates[:prior_count], free_errors=fitted_estimates[prior_count:])


def required_pull(kind: str) -> float:
    """Smallest score that counts: of the clock, which is one question, or of one of many tolerances."""
    return MIN_CLOCK_PULL if kind == "clock" else MIN_BROKEN_PULL


def required_distance_in_tolerances(kind: str) -> float:
    """Smallest change of rig.json that counts, in tolerances: the pull of one is no larger than it is off."""
    return MIN_CLOCK_PULL if kind == "clock" else MIN_ERROR_IN_TOLERANCES


def _is_far_beyond_tolerance(candidate: Suspect, error_size: float, tolerances: Tolerances) -> bool:
    """True if the estimated error is far beyond the tolerance; of the clock, beyond that of frequencies."""
    return abs(error_size) > (1.5 * tolerances.frequency if candidate.kind == "clock" else MIN_ERROR_IN_TOLERANCES)


def _body_finding(kind: str, name: str, deviation_words: str) -> Finding:
    """Finding on a body whose mass, frequency or damping is off."""
    if kind in ("mass", "density"):
        return Finding(
            cause="mass",
            of=name,
            evidence=f"{name} moves as if its {kind} were {deviation_words}",
            mend="weigh it and correct rig.json",
        )
    return Finding(
        cause="frequency" if kind == "frequency" else "damping",
        of=name,
        evidence=f"the {kind} of {name} is {deviation_words}",
        mend="fit rig.json to a modal test, or widen its tolerance if it is known no better",
    )


def tolerance_finding(violation: BrokenTolerance) -> Finding:
    """Finding on a broken tolerance, in words."""
    kind, name = violation.suspect.kind, violation.suspect.of
    error = violation.size_in_tolerances * violation.suspect.column_change
    percent_words, delay_words = (
        f"{100 * error:+.2g} % off",
        f"comes {1e3 * abs(error):.2g} ms {'late' if error > 0 else 'early'}",
    )
    tolerance_words = f"({abs(violation.size_in_tolerances):.0f} tolerances)"
    if kind == "clock":
        return Finding(
            cause="clock",
            evidence=f"all modes of all bodies lie {percent_words} the frequencies of rig.json",
            mend="check the sampling rate: a clock that is off shifts all frequencies alike",
        )
    if kind == "force gain":
        return Finding(
            cause="gain",
            channels=("force" if name == SINGLE_FORCE_NAME else name,),
            evidence=f"{name} is {percent_words} what all sensors imply {tolerance_words}",
            mend="calibrate the load cell, or check all masses of rig.json",
        )
    if kind == "force delay":
        return Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{force_in_words(name)} {delay_words} against all sensors",
            mend="synchronise the force's clock with the sensors'",
        )
    if kind in ("mass", "density", "frequency", "damping"):
        return _body_finding(kind, name, f"{percent_words} rig.json {tolerance_words}")
    finding_parts_by_kind: dict[str, tuple[Cause, str, str]] = {
        "gain": ("gain", f"is {percent_words} in gain against the others and the model", "calibrate it again"),
        "position": (
            "station",
            f"moves as if it stood {1e3 * error:+.3g} mm from its station",
            "measure its place and correct rig.json",
        ),
        "delay": (
            "delay",
            f"{delay_words} against the others",
            f"set delay_s = {error:.2g} in rig.json, or synchronise its clock",
        ),
        "cross-axis share": ("turned", turned_words(error), TURNED_MEND),
        "high-pass": (
            "filtered",
            f"is high-passed at about {abs(error):.2g} Hz",
            "take the coupling off, or widen high_pass_hz of its tolerance",
        ),
    }
    cause, evidence, mend = finding_parts_by_kind[kind]
    return Finding(cause=cause, channels=(name,), evidence=f"{name} {evidence} {tolerance_words}", mend=mend)
