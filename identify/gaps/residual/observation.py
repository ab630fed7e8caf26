"""Contacts as a record shows them, independent of their laws: separated forces and relative displacements, the times of
closure, the forces' standard deviations and the slow drift that integration loses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d

from identify.gaps.residual.linear import LinearModel, eta_weights, sensor_places_of
from identify.gaps.residual.record import Record
from identify.linear.joined import GroupLaw
from identify.signals.drift import DriftSpline, slow_force_density, spline
from identify.signals.law_evaluation import evaluated_on_batches, finer_signal_batches
from identify.signals.recent_values import RecentValues

CLOSED_DEVIATIONS = 5.0
"""Standard deviations beyond which a contact force is not noise; ... Derived: exceeded by chance once in 1.7e6
samples."""
CLOSED_SHARE = 0.1
"""... and the share of its rms that it must exceed too where the contact is closed: an open one's error stays below.
Set by hand."""

ENVELOPE_SAMPLES_EACH_SIDE = 2
"""Samples on either side over which the errors of a contact's force are as large as its force: low-passed, it rings
through zero where the contact is closed, and a sample there would weigh far more than its neighbours.
Derived: a period of the highest frequency."""
EDGE_SAMPLE_COUNT = 8
"""Samples at a record's end whose contact force rings on: the law's low-pass lacks what follows them. Set by hand."""

Signal = Float[np.ndarray, "*shape"]
LawValues = Float[np.ndarray, "..."]


FinerMotions = RecentValues[list[LawValues]]
"""Motions and sample times at the rate at which laws are evaluated, of the last ones of a search."""


@dataclass(frozen=True, eq=False)
class ForceAndEta:
    """Contact force before its law, and relative displacement and its rate, with the drift and what parameters add."""

    force_n: Float[np.ndarray, " times"]
    eta_m: Float[np.ndarray, " samples"]
    eta_rate_m_per_s: Float[np.ndarray, " samples"]


@dataclass(frozen=True)
class ContactSignals:
    """Separated force of one contact, and its relative displacement and velocity at the recording's rate.

    decimation is the ratio of the recording's rate to that of the force, slow_stiffness_n_per_m the stiffness of the
    bodies against slow relative motion, and slope_rate_multiple that of the force's rate at which slopes of laws are
    kept (`tangent`).
    """

    force_n: Float[np.ndarray, " times"]
    eta_m: Float[np.ndarray, " samples"]
    eta_rate_m_per_s: Float[np.ndarray, " samples"]
    time_s: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    decimation: int
    slope_rate_multiple: int
    slow_stiffness_n_per_m: float
    finer_motions: FinerMotions = field(repr=False)

    def low_passed(
        self, law_function: Callable[..., LawValues], motion: ForceAndEta, depends_on_time: bool, rate_multiple: int = 1
    ) -> Float[np.ndarray, "*rows times"]:
        """Law of a motion, and of the time if it takes that, low-passed to `rate_multiple` times the force's rate."""

        def finer_signals() -> list[LawValues]:
            signals = [motion.eta_m, motion.eta_rate_m_per_s, *([self.time_s] if depends_on_time else [])]
            return list(finer_signal_batches(np.stack(signals), self.sample_rate_hz))

        batches = self.finer_motions.get((motion, depends_on_time), finer_signals)
        law_values = evaluated_on_batches(
            law_function, batches, motion.eta_m.size, self.sample_rate_hz, self.decimation, rate_multiple
        )
        return law_values[..., : (self.force_n.size - 1) * rate_multiple + 1]


def contact_signals_of(record: Record, model: LinearModel, finer_motions: FinerMotions) -> tuple[ContactSignals, ...]:
    """Signals of every contact by a linear model: the data that its law has to explain."""
    eta_m, eta_rate_m_per_s = record.eta_at_sample_rate(model.eta_m), record.eta_at_sample_rate(model.eta_m, 1)
    time_s = record.counted_slice.start / record.residual_rate_hz + np.arange(eta_m.shape[1]) / record.sample_rate_hz
    forces_n = record.in_time(model.contact_force_n) + model.static_contact_n[:, None]
    slow_stiffnesses = np.diag(model.slow_stiffness_n_per_m)
    return tuple(
        ContactSignals(
            force_n,
            contact_eta_m,
            contact_rate,
            time_s,
            record.sample_rate_hz,
            record.decimation,
            record.slope_rate_multiple,
            stiffness,
            finer_motions,
        )
        for force_n, contact_eta_m, contact_rate, stiffness in zip(
            forces_n, eta_m, eta_rate_m_per_s, slow_stiffnesses, strict=True
        )
    )


@dataclass(frozen=True)
class ContactObservation:
    """Observation of one contact, independent of its law.

    force_weights are reciprocal standard deviations of its force (1/N), closed_mask is 1 where it is closed.
    law_prior_deviations are the tolerances of clearance and stiffness (relative) and of damping over stiffness (s).
    """

    force_weights: Float[np.ndarray, " times"]
    closed_mask: Float[np.ndarray, " times"]
    drift_spline: DriftSpline
    oversampling: float
    law_prior_deviations: tuple[float, float, float]

    @property
    def tolerance_slice(self) -> slice:
        """Slice of the law's tolerances among a contact's unknowns, after the knots of the drift."""
        return slice(self.drift_spline.knot_count, None)

    def drift_m(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " times"]:
        """Slow part of the relative displacement, m."""
        return np.asarray(self.drift_spline.value @ unknowns[: self.drift_spline.knot_count])

    def unknown_count(self, law: GroupLaw) -> int:
        """Number of the drift's knots and of the tolerances of the laws."""
        return self.drift_spline.knot_count + len(self.law_prior_deviations) * len(law.laws)

    @property
    def pull_prior_weight(self) -> float:
        """Weight of a pull of one standard deviation, sqrt(oversampling)."""
        return float(self.oversampling**0.5)


def contact_observations(
    record: Record, model: LinearModel, laws: Sequence[GroupLaw], contact_variances: Sequence[float]
) -> tuple[ContactObservation, ...]:
    """Observations of a record's contacts by the linear model and the laws of the nominal rig.

    contact_variances are the variances of the contact residuals relative to those by noise and the unmodelled share.
    """
    forces_n, errors_n = record.in_time(model.contact_force_n), model.contact_force_error_n(record)
    tolerances, observations = record.tolerances, []
    error_densities, slow_n_per_m = (
        _eta_independent_force_densities(record, model),
        np.diag(model.slow_stiffness_n_per_m),
    )
    law_prior_deviations = tolerances.clearance, tolerances.stiffness, tolerances.contact_damping_s
    for force_n, error_n, group_law, drift, contact_variance, error_density, spring_n_per_m in zip(
        forces_n, errors_n, laws, record.drifts, contact_variances, error_densities, slow_n_per_m, strict=True
    ):
        envelope_n = maximum_filter1d(np.abs(force_n), 2 * ENVELOPE_SAMPLES_EACH_SIDE + 1)
        is_clearly_closed = envelope_n > CLOSED_DEVIATIONS * error_n
        unfollowed_drift_m = 0.0 if drift is None else drift.noise_above_knot_band_m
        stiffness_n_per_m = sum(single_law.stiffness_n_per_m for single_law in group_law.laws)
        is_moving = record.residual_times_s > record.excitation_start_s  # at rest the side of a stop is unknown
        counted_drift, fast_error_n = drift, error_n
        if drift is not None:
            counted_samples = np.arange(record.counted_slice.start, record.counted_slice.stop) * record.decimation
            counted_drift = replace(drift, acceleration_m_per_s2=drift.acceleration_m_per_s2[counted_samples])
            if spring_n_per_m > 0:
                force_density, fast_error_n = slow_force_density(error_density, record.omega)
                counted_drift = replace(counted_drift, slow_force_density=force_density)
        deviation_n = np.sqrt(
            fast_error_n**2
            + (stiffness_n_per_m * unfollowed_drift_m * is_clearly_closed) ** 2
            + (tolerances.unmodelled_contact * envelope_n) ** 2
            + _cutoff_ringing_n(record, force_n) ** 2
        )
        observations.append(
            ContactObservation(
                is_moving / np.sqrt(contact_variance) / deviation_n,
                is_closed(force_n, error_n).astype(float),
                spline(force_n.size, record.residual_rate_hz, counted_drift),
                record.oversampling,
                law_prior_deviations,
            )
        )
    return tuple(observations)


def _eta_independent_force_densities(record: Record, model: LinearModel) -> Float[np.ndarray, "contacts lines"]:
    """One-sided densities, N^2/Hz, of the contact forces' errors that no errors of the relative displacements make
    through the slow stiffness."""
    places, contact_count = sensor_places_of(record, model.rig), len(model.rig.contacts)
    displacement_errors = record.displacement_per_acceleration * model.error_deviation / model.sensor_response
    force_errors = model.projection.to_inputs[:contact_count].copy()
    for response in model.responses:
        slow_weights_n_per_m = model.slow_stiffness_n_per_m @ eta_weights(model.rig, response, places)
        force_errors += slow_weights_n_per_m[:, :, None] * displacement_errors
    squared_errors = np.sum(np.abs(force_errors) ** 2, axis=1)
    return np.asarray(2 / (record.sample_count * record.sample_rate_hz) * squared_errors)


def is_closed(
    force_n: Float[np.ndarray, " times"], force_error_n: float | Float[np.ndarray, " times"]
) -> Bool[np.ndarray, " times"]:
    """Mask of closure: the force exceeds its error, and a share of its root mean square."""
    return np.abs(force_n) > np.maximum(CLOSED_DEVIATIONS * force_error_n, CLOSED_SHARE * np.sqrt(np.mean(force_n**2)))


def _cutoff_ringing_n(record: Record, force_n: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """Ringing F / (pi n) of an ideal low-pass n samples from where a force is cut off, N."""
    sample_numbers = np.arange(force_n.size) + 1.0
    ringing_n = np.max(np.abs(force_n[-EDGE_SAMPLE_COUNT:])) / (np.pi * sample_numbers[::-1])
    if record.counted_slice.start > 0:
        ringing_n = np.hypot(ringing_n, np.max(np.abs(force_n[:EDGE_SAMPLE_COUNT])) / (np.pi * sample_numbers))
    return np.asarray(ringing_n)
