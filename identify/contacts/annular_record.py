"""Record of an annular contact: the contact records of both directions, the parameters that they share, and the initial
guess of the law by a regression over the closed samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix, kron, vstack

from identify.contacts.annular_law import CENTER, CLEARANCE, FRICTION, LOG_SPEED, REST, RING, STIFFNESS, RingValues
from identify.contacts.contact_record import (
    CLOSED_FORCE_SHARE,
    LEAST_CLOSED_SHARE,
    NOISE_DEVIATIONS,
    QUIET_DEVIATIONS,
    ContactRecord,
    closed_threshold_n,
)
from identify.contacts.initial_guess import initial_state_pulls, robust_regression
from identify.contacts.refusals import RefusalCode, refused
from identify.linear.nuisance import RECORD_NAME, SINGLE_FORCE_NAME, Nuisance
from identify.signals.drift import DriftSpline
from identify.signals.scores import quiet_interval_std

HALF_SAMPLE_SHARE = 0.5
"""Share of the samples within the shortest interval, halved until the mode of an open contact's force is left."""
LEAST_MODE_SAMPLES = 100
DIRECTIONS = 2
"""Transverse directions y and z."""


@dataclass(frozen=True)
class AnnularRecord:
    """Contact records of y and z, with the nuisance parameters of both.

    pull_indices are those of each direction's nuisance parameters among `parameters`: those of bodies that both
    directions share are one. The fit leaves out the quiet samples before the excitation, of a record that begins at
    rest, as a contact that hardly touches at rest lets slow motion go anywhere.
    """

    planes: tuple[ContactRecord, ContactRecord]
    parameters: tuple[Nuisance, ...]
    pull_indices: tuple[Int[np.ndarray, " nuisances"], Int[np.ndarray, " nuisances"]]
    quiet_sample_count: int

    @property
    def force_n(self) -> Float[np.ndarray, "2 fewer"]:
        """Components of the separated force, N."""
        return np.stack([plane.force_n for plane in self.planes])

    @property
    def samples_per_error(self) -> float:
        return self.planes[0].samples_per_error

    @property
    def decimation(self) -> int:
        return self.planes[0].decimation

    @property
    def sample_rate_hz(self) -> float:
        return self.planes[0].sample_rate_hz

    @cached_property
    def drift_spline(self) -> DriftSpline:
        """Prior of the slow motion of both directions, whose knots take turns, as of one."""
        splines = [plane.drift_spline for plane in self.planes]
        empty_columns = csr_matrix((0, sum(spline.knot_count for spline in splines)))
        curvature = vstack([interleaved(spline.curvature, k) for k, spline in enumerate(splines)]).tocsr()
        curvature_target = np.concatenate([spline.curvature_target for spline in splines])
        return DriftSpline(empty_columns, empty_columns, empty_columns, curvature, curvature_target)

    @property
    def zero_known(self) -> bool:
        """True if sensors show constant displacements."""
        return self.planes[0].drift is None

    @property
    def is_fitted(self) -> Bool[np.ndarray, " fewer"]:
        """Mask of the samples that are fitted."""
        return np.arange(self.force_n.shape[1]) * self.decimation >= self.quiet_sample_count

    @property
    def without_nuisances(self) -> "AnnularRecord":
        """Record without nuisance parameters: without the free motion of a record that begins in motion."""
        planes = [
            replace(
                plane,
                force_n=plane.force_n - self.initial_state_pulls[plane_indices] @ plane.nuisance_n,
                nuisance_n=plane.nuisance_n[:0],
                force_noise_multiple=plane.force_noise_multiple[:0],
                shifts_eta=plane.shifts_eta[:0],
                eta_noise_multiple=plane.eta_noise_multiple[:0],
                nuisance_m=plane.nuisance_m[:0],
                is_initial_state=plane.is_initial_state[:0],
            )
            for plane, plane_indices in zip(self.planes, self.pull_indices, strict=True)
        ]
        no_indices = np.zeros(0, dtype=int)
        return replace(self, planes=(planes[0], planes[1]), parameters=(), pull_indices=(no_indices, no_indices))

    @cached_property
    def initial_state_pulls(self) -> Float[np.ndarray, " nuisances"]:
        """Initial states of the modes of a record that begins in motion; zero for all other parameters."""
        pulls = np.zeros(len(self.parameters))
        for plane, plane_indices in zip(self.planes, self.pull_indices, strict=True):
            pulls[plane_indices] += initial_state_pulls(plane)
        return pulls

    def at_force_samples(self, signals: Float[np.ndarray, "rows samples"]) -> Float[np.ndarray, "rows fewer"]:
        """Samples of signals at which there are forces."""
        return signals[:, :: self.decimation][:, : self.force_n.shape[1]]


def annular_record(
    planes: tuple[ContactRecord, ContactRecord],
    parameters: tuple[Sequence[Nuisance], Sequence[Nuisance]],
    force_names: tuple[Sequence[str], Sequence[str]],
    quiet_sample_count: int,
) -> AnnularRecord:
    """Record of both directions. What a body's modes have in common is one parameter; sensors, forces, single modes and
    initial states are those of their direction."""
    indices: dict[Nuisance, int] = {}
    plane_indices = []
    for direction, plane_force_names, plane_parameters in zip("yz", force_names, parameters, strict=True):
        parameters_in_space = [
            _named_by_direction(parameter, direction, plane_force_names) for parameter in plane_parameters
        ]
        plane_indices.append(np.array([indices.setdefault(p, len(indices)) for p in parameters_in_space], dtype=int))
    return AnnularRecord(planes, tuple(indices), (plane_indices[0], plane_indices[1]), quiet_sample_count)


def _named_by_direction(parameter: Nuisance, direction: str, force_names: Sequence[str]) -> Nuisance:
    """Parameter with the name that it has in a rig with two directions."""
    if parameter.owner == SINGLE_FORCE_NAME and len(force_names) == 1:
        return Nuisance(parameter.kind, force_names[0])
    if parameter.mode_number is not None or parameter.owner == RECORD_NAME:
        return Nuisance(parameter.kind, f"{parameter.owner} ({direction})", parameter.mode_number)
    return parameter


def interleaved(direction_columns: csr_matrix, direction: int) -> csr_matrix:
    """Columns of one direction among those of both, in turn."""
    return csr_matrix(kron(direction_columns, np.eye(DIRECTIONS)[[direction]]))


def open_force_n(record: AnnularRecord) -> Float[np.ndarray, "2"]:
    """Separated force of the open contact, N: the mode of its components (half-sample mode: Robertson and Cryer, J. Am.
    Stat. Assoc. 69, 1974), first of each alone, then of the samples that are near in the other component."""
    force_n = record.force_n[:, record.is_fitted]
    likeliest_n = np.array([_half_sample_mode(row) for row in force_n])
    near_limit_n = np.maximum(5 * CLOSED_FORCE_SHARE * force_n.std(axis=1), 1e-9)
    for _ in range(3):
        is_near = np.abs(force_n - likeliest_n[:, None]) < near_limit_n[:, None]
        if is_near.all(axis=0).sum() < LEAST_MODE_SAMPLES:
            break
        likeliest_n = np.array([_half_sample_mode(force_n[k, is_near[1 - k]]) for k in range(DIRECTIONS)])
    return likeliest_n


def _half_sample_mode(force_values: Float[np.ndarray, " samples"]) -> float:
    """Half-sample mode: the shortest interval with half the samples, again and again."""
    ordered = np.sort(force_values)
    while ordered.size > LEAST_MODE_SAMPLES:
        half_count = int(np.ceil(HALF_SAMPLE_SHARE * ordered.size))
        start_index = int(np.argmin(ordered[half_count - 1 :] - ordered[: ordered.size - half_count + 1]))
        ordered = ordered[start_index : start_index + half_count]
    return float(np.median(ordered))


def closed_samples(record: AnnularRecord, force_n: Float[np.ndarray, "2 fewer"]) -> Bool[np.ndarray, " fewer"]:
    """Mask of the samples at which the contact is clearly closed, by its whole force."""
    force_size_n = np.hypot(*force_n)
    noise_n = max(min(plane.noise_n, float(quiet_interval_std(plane.force_n))) for plane in record.planes)
    quiet_n = max(plane.quiet_deviation_n for plane in record.planes)
    least_closed_n = max(closed_threshold_n(force_size_n), QUIET_DEVIATIONS * quiet_n, NOISE_DEVIATIONS * noise_n)
    return record.is_fitted & (force_size_n > least_closed_n)


def annular_guess(
    record: AnnularRecord, sliding_speed_m_per_s: float
) -> tuple[RingValues, Float[np.ndarray, " knots"]]:
    """Law and slow motion b by a regression over the closed samples, linear in d, d mu, 1 / k and b:

        eta + b = d g - d mu tanh(v_t / v_0) t + f / k,    g = f / |f|, t across it

    Raises ContactRefusedError if the contact is hardly ever closed or stands still, or no force grows with the motion.
    """
    rest_force_n = -open_force_n(record)
    force_n = record.force_n + rest_force_n[:, None]
    if not all(np.ptp(plane.eta_m) for plane in record.planes):
        raise refused(RefusalCode.STANDS_STILL)
    is_closed = closed_samples(record, force_n)
    if np.mean(is_closed) < LEAST_CLOSED_SHARE:
        raise refused(RefusalCode.HARDLY_CLOSES)
    closed_eta_m = record.at_force_samples(np.stack([plane.eta_m for plane in record.planes]))[:, is_closed]
    closed_rate = record.at_force_samples(np.stack([plane.velocity_m_per_s for plane in record.planes]))[:, is_closed]
    force_n = force_n[:, is_closed]
    normal_unit = force_n / np.hypot(*force_n)
    tangent_unit = np.stack([-normal_unit[1], normal_unit[0]])
    sliding_vector = np.tanh(np.sum(closed_rate * tangent_unit, axis=0) / sliding_speed_m_per_s) * tangent_unit
    center_columns = np.repeat(np.eye(DIRECTIONS), is_closed.sum(), axis=0)
    if not record.zero_known:
        center_columns = center_columns[:, :0]
    law_columns = np.column_stack([normal_unit.ravel(), -sliding_vector.ravel(), force_n.ravel(), center_columns])
    drift_columns = vstack(
        [
            interleaved(plane.at_force_samples(plane.drift_spline.value)[is_closed], k)
            for k, plane in enumerate(record.planes)
        ]
    )
    knots, coefficients = robust_regression(closed_eta_m.ravel(), -drift_columns, law_columns, record.drift_spline)
    clearance_m, friction_clearance, compliance_m_per_n, *center_m = coefficients.tolist()
    if not (compliance_m_per_n > 0 and clearance_m > 0):
        raise refused(RefusalCode.NO_STIFFNESS)
    ring_values = np.zeros(len(RING))
    ring_values[[CLEARANCE, STIFFNESS]] = clearance_m, 1 / compliance_m_per_n
    ring_values[[FRICTION, LOG_SPEED]] = max(friction_clearance / clearance_m, 0.0), np.log(sliding_speed_m_per_s)
    if center_m:
        ring_values[CENTER] = center_m
    ring_values[REST] = rest_force_n
    return ring_values, knots
