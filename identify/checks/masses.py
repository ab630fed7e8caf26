"""Checks of a single mass, of which no other channel tells: while its contacts are open, a mass on a spring obeys

    m a + c v + k x = F

with the measured force, or 0 where none acts. The equation is fitted to the samples in the middle of the clearances,
with a constant for each p (slow motion that accelerometers miss), and m, c and k are compared with rig.json. The
share of the force that stays unexplained is noise of the acceleration, or passages with closed contacts: both lower the
mass by about that share, and closed contacts raise the stiffness.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from identify.checks.findings import Finding, slipped_samples_finding, two_clocks_finding
from identify.checks.relations import unit_mistake
from identify.linear.joined import contact_groups
from identify.linear.modal import force_on_mass
from identify.signals.kinematics import Kinematics
from identify.signals.scores import INDEPENDENT_RATE_HZ
from identify.signals.spectra import decimated, force_band_hz
from rig.errors import RigError
from rig.model.description import ON_GROUND, Body, Rig, Station, contact_stations
from rig.model.modes import loaded_mass
from rig.model.tolerances import Tolerances

OPEN_QUANTILES, MIN_EXPLAINED_SHARE = (0.4, 0.2, 0.1), 0.95
"""Contacts are open below this quantile of the distance from the median displacement; below the next one, if less than
this share of the force is explained, as closed contacts are then among the samples."""
OPEN_CLEARANCE_SHARE, INNER_CLEARANCE_SHARE = 0.8, 0.5
"""Distances are also below the first share of the smallest clearance in rig.json, as a contact may mostly be closed;
below the second where several contacts join the same places, as a soft one hides in the explained force."""
MIN_PASSAGE_SAMPLES = 8
HALF_RATE_TO_FORCE_RATIO = 3.0
"""Half the decimated rate, over the force's highest frequency."""
MAX_ERROR_SPREADS, MIN_TOLERANCE = 4.0, 2e-3
"""Largest error in standard spreads of tolerances and fit; smallest tolerance."""
MIN_RELATED_SHARE = 0.3
"""Force and motion belong to different records if a smaller share of the force is explained."""
MIN_CLOCK_ERROR_SPREADS, MAX_REMAINDER_SPREADS, MAX_CLOCK_ERROR = 3.5, 2.0, 0.03
"""A clock is wrong if its error exceeds so many standard spreads and leaves mass and frequency at most so many; no
clock errs by more than the last share."""
MAX_DELAY_S = 0.02
DRIFT_TRIALS, SLIP_TRIALS = 9, 9
"""Changes of the delay over the record that are tried, up to twice the largest delay; times of a slip."""
MIN_GAINED_SHARE, MIN_DRIFT_DEVIANCE = 0.2, 25.0
"""Share of what is unexplained that a delay takes away; change of N log(sum of squares) by a delay that changes, with
the N samples that are independent: a constant delay would be the wrong cause."""
MAX_DAMPING_RATIO = 0.5
MIN_FORCE_SHARE = 0.05
"""Smallest force in the open passages, over its root mean square: less is no force, as after a single blow."""


@dataclass(frozen=True)
class MassFit:
    """Force per acceleration, velocity and displacement in the open passages (m, c, k), with standard errors.

    delay_s is the delay of the force against the sensor with the best fit, in the middle of the duration_s that is
    fitted; it changes by delay_change_s over it, at once if it slips. explained_share of the force is explained.
    """

    coefficients: Float[np.ndarray, "3"]
    standard_errors: Float[np.ndarray, "3"]
    delay_s: float
    explained_share: float
    delay_change_s: float
    duration_s: float
    slips: bool = False


def mass_findings(rig: Rig, motion: Kinematics, tolerances: Tolerances, record_s: float) -> list[Finding]:
    """Findings on the mass on which all forces act; the record lasts record_s."""
    body, station_index = _driven_body_and_row(rig, motion)
    if not body.is_mass or station_index is None:
        return []
    fit = open_contact_mass_fit(rig, motion, station_index)
    if fit is None:
        return []
    sensor = motion.sensors[station_index]
    clock = _clock_finding(body, sensor.measures.order, fit, tolerances)
    channels = (*rig.force_names, sensor.name)
    return [clock] if clock else _mass_fit_findings(body, channels, fit, tolerances, record_s)


def _driven_body_and_row(rig: Rig, motion: Kinematics) -> tuple[Body, int | None]:
    """Body on which the (first) force acts, or that a shaken base carries alone, a mass with what is attached to it;
    and the row of its station, or None if other forces act elsewhere."""
    if rig.base_sensors:
        body = rig.bodies[0]
        return loaded_mass(rig, body), motion.row(Station(body.name)) if rig.inputs == (ON_GROUND,) else None
    station = rig.forces[0]
    return loaded_mass(rig, rig.body(station.body)), motion.row(station) if set(rig.forces) == {station} else None


def mass_pull(rig: Rig, motion: Kinematics, tolerances: Tolerances) -> float:
    """Largest error of mass, frequency or clock of the driven mass, in standard spreads of tolerances and fit.

    0 if nothing tells it, or other bodies' channels tell more.
    """
    body, station_index = _driven_body_and_row(rig, motion)
    if station_index is None or len(rig.bodies) > 1 or not body.is_mass or not np.any(motion.forces_n):
        return 0.0
    fit = open_contact_mass_fit(rig, motion, station_index)
    if fit is None or fit.explained_share < MIN_RELATED_SHARE:
        return 0.0
    sensor_order = motion.sensors[station_index].measures.order
    log_errors, error_spreads, per_clock_error = _log_errors_spreads_clock_slopes(body, sensor_order, fit, tolerances)
    per_clock_error_norm = float(np.linalg.norm(per_clock_error / error_spreads))
    clock_pull = abs(per_clock_error / error_spreads @ (log_errors / error_spreads)) / per_clock_error_norm
    return float(max(clock_pull, *np.abs(log_errors / error_spreads)))


def open_contact_mass_fit(rig: Rig, motion: Kinematics, station_index: int) -> MassFit | None:
    """Fit to the open passages; None if they have too few samples, or no force acts in them."""
    best_fit: MassFit | None = None
    for quantile in OPEN_QUANTILES:
        fit = _fit_near_clearance_middle(quantile, rig, motion, station_index)
        if fit is None or (best_fit and fit.explained_share < best_fit.explained_share):
            break
        best_fit = fit
        if best_fit.explained_share > MIN_EXPLAINED_SHARE:
            break
    return best_fit


def _fit_near_clearance_middle(quantile: float, rig: Rig, motion: Kinematics, station_index: int) -> MassFit | None:
    """Fit to the samples below a quantile of the distance from the middle; None as in `open_contact_mass_fit`."""
    force_high_hz = force_band_hz(motion.forces_n, motion.sample_rate_hz)[1]
    decimation = max(1, int(motion.sample_rate_hz / 2 / (HALF_RATE_TO_FORCE_RATIO * force_high_hz)))
    rate_hz = motion.sample_rate_hz / decimation
    force_n = force_on_mass(rig, rig.body(motion.stations[station_index].body), motion.forces_n)
    motion_rows = (motion.acceleration_m_per_s2, motion.velocity_m_per_s, motion.displacement_m)
    signals = decimated(np.stack([force_n, *(row[station_index] for row in motion_rows)]), decimation)
    is_open = _open_contact_mask(rig, motion, station_index, decimation, quantile)
    passages = _open_contact_passages(is_open, motion.excited_from // decimation + 1)
    if sum(passage.stop - passage.start for passage in passages) < 50:
        return None
    if np.concatenate([signals[0, passage] for passage in passages]).std() < MIN_FORCE_SHARE * signals[0].std():
        return None

    sample_numbers, duration_s = np.arange(signals.shape[1]), signals.shape[1] / rate_hz
    force_at = CubicSpline(sample_numbers, signals[0])
    share_of_record = sample_numbers / sample_numbers.size - 0.5

    motion_segments = [signals[1:, passage] for passage in passages]
    centred_motion = np.concatenate([segment - segment.mean(axis=1, keepdims=True) for segment in motion_segments], 1)
    motion_rms = centred_motion.std(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled_motion = centred_motion / motion_rms[:, None]
    if not np.isfinite(scaled_motion).all():
        raise RigError("while contacts are open nothing moves, or by more than any machine")
    pseudo_inverse = np.linalg.pinv(scaled_motion.T)
    first_samples = np.cumsum([0, *(passage.stop - passage.start for passage in passages)])
    open_samples = np.concatenate([sample_numbers[passage] for passage in passages])
    open_share_of_record = share_of_record[open_samples]

    def fit_at_delay(delay_s: float, delay_change_s: float = 0.0, slip_share: float | None = None) -> MassFit:
        changed_share = open_share_of_record if slip_share is None else (open_share_of_record > slip_share) - 0.5
        force_samples = open_samples + (delay_s + delay_change_s * changed_share) * rate_hz
        delayed = force_at(np.clip(force_samples, 0, sample_numbers[-1]))
        passage_means = np.add.reduceat(delayed, first_samples[:-1]) / np.diff(first_samples)
        centred_force = delayed - np.repeat(passage_means, np.diff(first_samples))
        coefficients = pseudo_inverse @ centred_force / motion_rms
        residual = centred_force - coefficients @ centred_motion
        passage_scores = np.add.reduceat(pseudo_inverse * residual, first_samples[:-1], axis=1)
        standard_errors = np.sqrt(np.sum(np.square(passage_scores), axis=1)) / motion_rms
        explained_share = 1 - float(np.mean(residual**2) / np.mean(centred_force**2))
        slips = slip_share is not None
        return MassFit(coefficients, standard_errors, delay_s, explained_share, delay_change_s, duration_s, slips)

    coarse_s, changes_s = np.arange(-MAX_DELAY_S, MAX_DELAY_S + 1e-9, 0.5 / rate_hz), np.linspace(-2, 2, DRIFT_TRIALS)
    constant_fit = _finest_fit(fit_at_delay, coarse_s, np.zeros(1), rate_hz)
    drifting_fit = _finest_fit(fit_at_delay, coarse_s, MAX_DELAY_S * changes_s, rate_hz)
    undelayed_fit = fit_at_delay(0.0)
    if _gained_share(undelayed_fit, drifting_fit) < MIN_GAINED_SHARE:
        return undelayed_fit
    independent_count = INDEPENDENT_RATE_HZ * sum(passage.stop - passage.start for passage in passages) / rate_hz
    drifts = -np.log1p(-_gained_share(constant_fit, drifting_fit)) * independent_count > MIN_DRIFT_DEVIANCE
    if not drifts and _gained_share(undelayed_fit, constant_fit) >= MIN_GAINED_SHARE:
        return constant_fit
    slipping_fits = (
        _finest_fit(partial(fit_at_delay, slip_share=float(share)), coarse_s, MAX_DELAY_S * changes_s, rate_hz)
        for share in np.linspace(-0.4, 0.4, SLIP_TRIALS)
    )
    return max((drifting_fit, *slipping_fits), key=lambda fit: fit.explained_share)


def _gained_share(fit: MassFit, freer_fit: MassFit) -> float:
    """Share of what a fit leaves unexplained that a freer one explains."""
    return (freer_fit.explained_share - fit.explained_share) / max(1 - fit.explained_share, 1e-12)


def _finest_fit(
    fit_at_delay: Callable[[float, float], MassFit],
    delays_s: Float[np.ndarray, " trials"],
    changes_s: Float[np.ndarray, " changes"],
    rate_hz: float,
) -> MassFit:
    """Fit that explains most: of a grid, and refined from its best point; the change is refined if it is tried."""
    best_fit = max(
        (fit_at_delay(float(delay_s), float(change_s)) for delay_s in delays_s for change_s in changes_s),
        key=lambda fit: fit.explained_share,
    )
    refined_count = 2 if changes_s.size > 1 else 1
    best_point = np.array([best_fit.delay_s, best_fit.delay_change_s][:refined_count])

    def unexplained_share(steps: Float[np.ndarray, " refined"]) -> float:
        return 1 - fit_at_delay(*(best_point + steps / rate_hz)).explained_share

    first_steps = np.vstack([np.zeros(refined_count), 0.5 * np.eye(refined_count)])
    options = {"initial_simplex": first_steps, "xatol": 1e-3, "fatol": 1e-9, "maxfev": 80}
    optimum = minimize(unexplained_share, np.zeros(refined_count), method="Nelder-Mead", options=options)
    return fit_at_delay(*(best_point + optimum.x / rate_hz))


def _open_contact_mask(
    rig: Rig, motion: Kinematics, station_index: int, decimation: int, quantile: float
) -> Bool[np.ndarray, " fewer"]:
    """Mask of the samples at which every contact of the force's body is in the middle of its clearance; none where a
    spring holds the body to another."""
    is_open = np.ones(-(-motion.sample_count // decimation), dtype=bool)
    for group in contact_groups(rig):
        stations = contact_stations(group.joined_contact)
        if motion.stations[station_index].body not in [station.body for station in stations]:
            continue
        group_laws = [rig.contacts[contact_index].law for contact_index in group.contact_indices]
        if not all(law.has_stops for law in group_laws):
            return np.zeros_like(is_open)
        rows = [motion.row(station) for station in stations]
        if None in rows:
            continue
        relative_m = motion.displacement_m[rows[0]] - (motion.displacement_m[rows[1]] if len(rows) > 1 else 0.0)
        from_middle_m = np.abs(relative_m - np.median(relative_m))[::decimation]
        is_open &= from_middle_m < np.quantile(from_middle_m[motion.excited_from // decimation :], quantile)
        clearances_m = [x for law in group_laws for x in (law.lower_clearance_m, law.upper_clearance_m)]
        clearance_share = INNER_CLEARANCE_SHARE if len(group_laws) > 1 else OPEN_CLEARANCE_SHARE
        is_open &= from_middle_m < clearance_share * min(clearances_m)
    return is_open


def _open_contact_passages(is_open: Bool[np.ndarray, " fewer"], min_start: int) -> list[slice]:
    """Runs of open samples that begin at `min_start` or later and are long enough."""
    run_edges = np.flatnonzero(np.diff(np.r_[0, is_open.astype(np.int8), 0]))
    runs = zip(run_edges[::2], run_edges[1::2], strict=True)
    return [slice(start, stop) for start, stop in runs if start >= min_start and stop - start >= MIN_PASSAGE_SAMPLES]


def _mass_fit_findings(
    body: Body, channels: tuple[str, ...], fit: MassFit, tolerances: Tolerances, record_s: float
) -> list[Finding]:
    """First error of, in this order: the relation of force and motion, delay, size, frequency, damping.

    channels are those of the forces and, last, of the sensor; the record lasts record_s.
    """
    mass_kg, damping_n_s_per_m, stiffness_n_per_m = fit.coefficients
    mass_std, damping_std, stiffness_std = fit.standard_errors
    if fit.explained_share < MIN_RELATED_SHARE:
        return [
            Finding(
                cause="force",
                channels=channels,
                evidence=f"while its contacts are open, {100 * max(fit.explained_share, 0):.2g} % of the force shows "
                f"in {channels[-1]}",
                mend="check that both channels are of this record, and the quantity of the sensor",
            )
        ]
    mass_ratio = mass_kg / float(getattr(body, "mass_kg", np.nan)) / fit.explained_share
    if fit.delay_s != 0 and not 0.5 < abs(mass_ratio) < 2:  # fitted by chance
        return []
    if fit.slips:
        return [slipped_samples_finding(channels[-1], -fit.delay_change_s)]
    if fit.delay_change_s:
        first_delay_s, delay_growth = fit.delay_change_s / 2 - fit.delay_s, -fit.delay_change_s / fit.duration_s
        return [two_clocks_finding(channels[-1], "the force", first_delay_s, delay_growth, record_s)]
    findings = []
    if abs(fit.delay_s) > 1e-4:
        findings.append(
            Finding(
                cause="delay",
                channels=channels,
                evidence=f"{channels[-1]} comes {1e3 * abs(fit.delay_s):.2g} ms "
                f"{'late' if fit.delay_s < 0 else 'early'} against the force",
                mend="synchronise the two, or set its delay_s in rig.json",
            )
        )
    mass_tolerances = [tolerances.mass, tolerances.gain, tolerances.force_gain, MIN_TOLERANCE]
    max_error = MAX_ERROR_SPREADS * float(np.hypot.reduce(mass_tolerances))
    if abs(mass_ratio - 1) > max_error + MAX_ERROR_SPREADS * mass_std / abs(mass_kg):
        findings.append(_gain_finding(body, channels, mass_ratio))
    stated_hz = _identifiable_natural_hz(body)
    if stated_hz:
        fitted_hz = float(np.sqrt(max(stiffness_n_per_m / mass_kg, 0.0))) / (2 * np.pi)
        fit_error = 0.5 * float(np.hypot(stiffness_std / abs(stiffness_n_per_m), mass_std / abs(mass_kg)))
        max_error = MAX_ERROR_SPREADS * float(np.hypot(np.sqrt(2) * tolerances.frequency, MIN_TOLERANCE))
        if abs(fitted_hz / stated_hz - 1) > max_error + 1 - fit.explained_share + MAX_ERROR_SPREADS * fit_error:
            findings.append(
                Finding(
                    cause="frequency",
                    of=body.name,
                    evidence=f"while its contacts are open, {body.name} moves as if its frequency were "
                    f"{fitted_hz:.4g} Hz, not {stated_hz:g} Hz",
                    mend="correct its spring or frequency in rig.json, or check the sampling rate",
                )
            )
        stated_damping_per_s = 2 * float(body.damping_ratios(1)[0]) * 2 * np.pi * stated_hz
        damping_over_stated = damping_n_s_per_m / mass_kg / stated_damping_per_s if stated_damping_per_s else 1.0
        fit_error = damping_std / abs(mass_kg) / (stated_damping_per_s or np.inf)
        max_error = MAX_ERROR_SPREADS * float(np.hypot(np.sqrt(2) * tolerances.damping, 10 * MIN_TOLERANCE))
        if not findings and abs(damping_over_stated - 1) > max_error + MAX_ERROR_SPREADS * fit_error:
            findings.append(
                Finding(
                    cause="damping",
                    of=body.name,
                    evidence=f"while its contacts are open, {body.name} is damped {damping_over_stated:.3g} times as "
                    "much as rig.json says",
                    mend="take its damping from a decay or a modal test",
                )
            )
    return findings[:1] if findings and findings[0].cause in ("delay", "polarity", "units") else findings


def _clock_finding(body: Body, sensor_order: int, fit: MassFit, tolerances: Tolerances) -> Finding | None:
    """Finding: a wrong clock explains the errors of both mass and frequency.

    Times that are too short by a factor s raise the frequency by s, and change the mass by s^(sensor_order - 2), the
    order of the derivative that the sensor measures.
    """
    mass_kg, _, stiffness_n_per_m = fit.coefficients
    if sensor_order > 1 or not _identifiable_natural_hz(body) or mass_kg <= 0 or stiffness_n_per_m <= 0:
        return None
    log_errors, error_spreads, per_clock_error = _log_errors_spreads_clock_slopes(body, sensor_order, fit, tolerances)
    per_clock_error_norm = float(np.linalg.norm(per_clock_error / error_spreads))
    clock_error = (per_clock_error / error_spreads @ (log_errors / error_spreads)) / per_clock_error_norm**2
    remainder_spreads = np.abs(log_errors - clock_error * per_clock_error) / error_spreads
    is_plausible = (
        MIN_CLOCK_ERROR_SPREADS / per_clock_error_norm < abs(clock_error) < MAX_CLOCK_ERROR
        and remainder_spreads.max() <= MAX_REMAINDER_SPREADS
    )
    if fit.delay_s or not is_plausible:
        return None
    return Finding(
        cause="clock",
        evidence=f"{body.name} moves as if all times were {100 * abs(clock_error):.2g} % too "
        f"{'short' if clock_error > 0 else 'long'}",
        mend="check the sampling rate, and weigh the mass: one that is off by twice that share looks alike",
    )


def _identifiable_natural_hz(body: Body) -> float:
    """Natural frequency, or 0 if a strong damper hides the spring's force in the middle of a clearance."""
    return float(body.frequencies_hz(1)[0]) if body.damping_ratios(1)[0] < MAX_DAMPING_RATIO else 0.0


def _log_errors_spreads_clock_slopes(
    body: Body, sensor_order: int, fit: MassFit, tolerances: Tolerances
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Errors of mass and frequency as logarithms; their standard spreads; their changes per unit clock error.

    An error is zero if it cannot be identified: of a mass without a spring, or where a sign is wrong.
    """
    mass_kg, _, stiffness_n_per_m = fit.coefficients
    stated_hz = _identifiable_natural_hz(body)
    mass_ratio = mass_kg / float(getattr(body, "mass_kg", np.nan)) / fit.explained_share
    mass_std = fit.standard_errors[0] / abs(mass_kg)
    stiffness_std = fit.standard_errors[2] / abs(stiffness_n_per_m)
    fit_errors = np.array([mass_std, 0.5 * float(np.hypot(mass_std, stiffness_std)) + 1 - fit.explained_share])
    mass_tolerance = float(np.hypot.reduce([tolerances.mass, tolerances.gain, tolerances.force_gain, MIN_TOLERANCE]))
    error_spreads = np.hypot([mass_tolerance, np.hypot(np.sqrt(2) * tolerances.frequency, MIN_TOLERANCE)], fit_errors)
    is_frequency_known = stated_hz > 0 and stiffness_n_per_m > 0 and mass_kg > 0
    frequency_error = (
        np.log(np.sqrt(stiffness_n_per_m / mass_kg) / (2 * np.pi * stated_hz)) if is_frequency_known else 0.0
    )
    log_errors = np.array([np.log(mass_ratio) if mass_ratio > 0 else 0.0, frequency_error])
    return log_errors, error_spreads, np.array([sensor_order - 2.0, 1.0])


def _gain_finding(body: Body, channels: tuple[str, ...], mass_ratio: float) -> Finding:
    """Finding: the sensor delivers 1 / ratio times what the force and the mass make."""
    evidence = f"{channels[-1]} delivers {1 / mass_ratio:.4g} times what the force and the mass of {body.name} make"
    if mass_ratio < 0 and 0.5 < -mass_ratio < 2:
        return Finding(
            cause="polarity", channels=channels, evidence=evidence, mend="turn it, or the force, with scale = -1"
        )
    unit_words = unit_mistake(1 / mass_ratio)
    if unit_words:
        mend = f"correct the unit of the sensor or of the force in the import map, it looks like {unit_words}"
        return Finding(cause="units", channels=channels, evidence=evidence, mend=mend)
    return Finding(
        cause="gain",
        channels=channels,
        of=body.name,
        evidence=evidence,
        mend="weigh the mass, calibrate the sensor and the load cell",
    )
