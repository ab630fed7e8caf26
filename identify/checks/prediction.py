"""Prediction of each channel by all others and the linear model, with the contact forces unknown at every line.

    A = sum_k G_k F_k - sum_j G_j f_j + error

with the accelerances G. The contact forces f_j, and a doubted force F_k, follow by least squares from the channels that
are used. A line's misfit is its squared error per degree of freedom, over the square of a rough error of the model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.checks.spectra import SMOOTHED_LINE_COUNT, Spectra
from identify.linear.model import Response, ResponseCache, accelerances, input_shapes, real_product, response_of
from identify.linear.nuisance import (
    Nuisance,
    NuisanceKind,
    ObservedSignals,
    elastic_mode_indices,
    mode_count_below_band_margin,
)
from identify.linear.observed_motion import BodyMotion, ObservedTransverse
from identify.linear.projection import Projection, projection
from identify.linear.truncation import truncations_of
from identify.signals.scores import INDEPENDENT_RATE_HZ
from rig.model.description import Rig, Station
from rig.model.tolerances import Tolerances

MODEL_ERROR_SHARE = 0.03
"""Rough error of a sound model, as a share of its body's motion at a line: far more than tolerances cause."""
MIN_MODEL_ERROR_SHARE = 0.003
"""Smallest error of any model, likewise."""
MAX_NOISE_SHARE, MIN_INFORMATIVE_SHARE = 0.1, 0.05
"""A line is informative if noise makes less than this share of the squared scale. If no more than the second share of
the lines are, all count."""
DRIVEN_LEVEL_SHARE = 0.05
"""A force drives the lines where it has this share of its largest level."""
STEADY_DURATION_FACTOR = 2.0
"""Motion that lasts for half of the record is taken to last for all of it."""
MODE_BAND_RATIO = 2.0
"""Modes up to this multiple of the band's end may be off: the frequency of one there changes the motion at the band's
end by 0.9 times its own relative error, which is less than `MIN_MODEL_ERROR_SHARE` for the default tolerance."""


TUNED_KINDS = (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)
"""Errors of modes about which the record is linearised."""
MAX_TUNING_FACTOR = 2.0
"""Largest factor on the frequency or damping of a mode about which the record is linearised. Numerical."""


@dataclass(frozen=True)
class Prediction:
    """Prediction of all channels, by the model and some of them.

    misfit is the median over the informative lines of the mean squared error of these channels, or the largest such
    median over the lines that one force drives, if that is larger; nan without a degree of freedom.
    """

    misfit: float
    accelerations: Complex[np.ndarray, "sensors lines"]
    force_spectra: Complex[np.ndarray, "forces lines"]
    contact_force_spectra: Complex[np.ndarray, "contacts lines"]


@dataclass(frozen=True)
class LinearCheck:
    """A record's spectra and a rig's responses and accelerances, of the forces first, then of the contacts."""

    spectra: Spectra
    responses: tuple[Response, ...]
    accelerance: Complex[np.ndarray, "inputs sensors lines"]
    error_scale: Float[np.ndarray, "sensors lines"]
    driven_masks: Bool[np.ndarray, "forces lines"]

    @property
    def contact_count(self) -> int:
        return len(self.contact_accelerance)

    @property
    def contact_accelerance(self) -> Complex[np.ndarray, "contacts sensors lines"]:
        return self.accelerance[len(self.spectra.forces) :]

    def unknown_input_accelerance(
        self, doubted_force_index: int | None = None
    ) -> Complex[np.ndarray, "inputs sensors lines"]:
        """Accelerances of the unknown inputs: of the doubted force, if there is one, and of the contacts."""
        if doubted_force_index is None:
            return self.contact_accelerance
        return np.concatenate([self.accelerance[[doubted_force_index]], self.contact_accelerance])

    @property
    def acceleration_by_force(self) -> Complex[np.ndarray, "forces sensors lines"]:
        return self.accelerance[: len(self.spectra.forces)] * self.spectra.forces[:, None]

    @property
    def acceleration_by_all_forces(self) -> Complex[np.ndarray, "sensors lines"]:
        """Accelerations by all measured forces."""
        return np.asarray(self.acceleration_by_force.sum(axis=0))

    def with_spectra(self, spectra: Spectra, channel_indices: list[int]) -> "LinearCheck":
        """Check of other spectra of the same sensors and lines; see `linear_check`."""
        error_scale = _error_scale_of(spectra, channel_indices)
        return LinearCheck(spectra, self.responses, self.accelerance, error_scale, driven_masks(spectra.forces))

    def unknown_input_projection(
        self, channel_indices: list[int], doubted_force_index: int | None = None
    ) -> Projection:
        """Projection of the contact forces, and of a doubted force, from these channels."""
        accelerances = self.unknown_input_accelerance(doubted_force_index)[:, channel_indices]
        error_scale = self.error_scale[channel_indices]
        return projection(accelerances / error_scale, error_scale, len(accelerances))

    def prediction(self, channel_indices: list[int], doubted_force_index: int | None = None) -> Prediction:
        """Prediction from these channels and the measured forces, without a doubted one."""
        spectra, unknown_input_accelerance = self.spectra, self.unknown_input_accelerance(doubted_force_index)
        known_by_force = self.acceleration_by_force
        if doubted_force_index is not None:
            known_by_force = np.delete(known_by_force, doubted_force_index, axis=0)
        known_acceleration = np.asarray(known_by_force.sum(axis=0))
        unexplained = (spectra.acceleration - known_acceleration)[channel_indices]
        residual, inputs = self.unknown_input_projection(channel_indices, doubted_force_index).applied_to(unexplained)
        freedom_count = len(channel_indices) - len(unknown_input_accelerance)
        squared_error_by_line = np.sum(np.abs(residual) ** 2, axis=0)
        informative = self._informative_line_mask(channel_indices)
        masks = [informative, *(driven & informative for driven in self.driven_masks if np.any(driven & informative))]
        largest_median_error = max(float(np.median(squared_error_by_line[mask])) for mask in masks)
        misfit = largest_median_error / freedom_count if freedom_count > 0 else np.nan
        force_spectra, contact_force_spectra = spectra.forces, inputs
        if doubted_force_index is not None:
            force_spectra, contact_force_spectra = force_spectra.copy(), inputs[1:]
            force_spectra[doubted_force_index] = inputs[0]
        accelerations = known_acceleration + np.einsum("isl,il->sl", unknown_input_accelerance, inputs)
        return Prediction(misfit, accelerations, force_spectra, contact_force_spectra)

    def misfit(self, spectra: Spectra, channel_indices: list[int]) -> float:
        """Misfit of other spectra, predicted from these channels."""
        return self.with_spectra(spectra, channel_indices).prediction(channel_indices).misfit

    def _informative_line_mask(self, channel_indices: list[int]) -> Bool[np.ndarray, " lines"]:
        """Mask of the lines on which the motion of these channels exceeds their noise."""
        relative_noise = self.spectra.line_noise[channel_indices] / self.error_scale[channel_indices]
        informative = np.mean(relative_noise**2, axis=0) < MAX_NOISE_SHARE
        return np.asarray(informative) if np.mean(informative) > MIN_INFORMATIVE_SHARE else np.ones_like(informative)


def linear_check(
    rig: Rig, spectra: Spectra, channel_indices: list[int] | None = None, cache: ResponseCache | None = None
) -> LinearCheck:
    """Spectra and accelerances of a rig, in the scale of these channels (all by default).

    To try many rigs, share one `cache`.
    """
    channel_indices = list(range(len(spectra.sensors))) if channel_indices is None else channel_indices
    cache = cache or ResponseCache(spectra.omega, 0)
    responses = tuple(response_of(rig, body, cache) for body in rig.bodies)
    accelerance = _accelerance(rig, responses, spectra)
    error_scale = _error_scale_of(spectra, channel_indices)
    return LinearCheck(spectra, responses, accelerance, error_scale, driven_masks(spectra.forces))


def with_tuned_modes(
    rig: Rig, check: LinearCheck, pulls: Mapping[Nuisance, float], tolerances: Tolerances
) -> LinearCheck:
    """Check with the frequencies and damping of modes off by their pulls, in tolerances.

    A shift by a share of a resonance's width changes the motion nonlinearly, which linear columns do not follow.
    """

    def factors(body_name: str, mode_count: int, kind: NuisanceKind) -> Float[np.ndarray, " modes"]:
        common = 1 + getattr(tolerances, kind) * pulls.get(Nuisance(kind, body_name), 0.0)
        of_modes = [tolerances.of_mode(body_name, number) for number in range(1, mode_count + 1)]
        single_pulls = [pulls.get(Nuisance(kind, body_name, number), 0.0) for number in range(1, mode_count + 1)]
        single_factors = [1 + getattr(t, kind) * pull for t, pull in zip(of_modes, single_pulls, strict=True)]
        return np.clip(common * np.array(single_factors), 1 / MAX_TUNING_FACTOR, MAX_TUNING_FACTOR)

    responses = tuple(
        response.tuned(*(factors(response.body.name, response.mode_count, kind) for kind in TUNED_KINDS))
        for response in check.responses
    )
    return replace(check, responses=responses, accelerance=_accelerance(rig, responses, check.spectra))


def _accelerance(
    rig: Rig, responses: Sequence[Response], spectra: Spectra
) -> Complex[np.ndarray, "inputs sensors lines"]:
    return accelerances(rig, responses, rig.forces, [sensor.station for sensor in spectra.sensors])


def _error_scale_of(spectra: Spectra, channel_indices: list[int]) -> Float[np.ndarray, "sensors lines"]:
    """Scale of the median channel of each body, among channel_indices if any, so that no single one rules it."""
    body_names = [sensor.station.body for sensor in spectra.sensors]
    error_scale = np.empty(spectra.line_noise.shape)
    for body_name in dict.fromkeys(body_names):
        body_indices = [i for i, name in enumerate(body_names) if name == body_name]
        scale_indices = [index for index in body_indices if index in channel_indices] or body_indices
        error_scale[body_indices] = MODEL_ERROR_SHARE * np.median(spectra.smoothed_line_level[scale_indices], axis=0)
    error_scale = np.hypot(error_scale, spectra.line_noise)
    return np.asarray(np.maximum(error_scale, 1e-9 * float(error_scale.max()) or 1.0))


def predicted_acceleration_at(
    rig: Rig, predicted: Prediction, omega: Float[np.ndarray, " lines"], stations: list[Station]
) -> Complex[np.ndarray, "stations lines"]:
    """Accelerations at any stations by the forces and the estimated contact forces."""
    inputs, cache = np.concatenate([predicted.force_spectra, predicted.contact_force_spectra]), ResponseCache(omega, 0)

    def acceleration_by_body(response: Response) -> Complex[np.ndarray, "stations lines"]:
        modal_force = real_product(input_shapes(rig, response, rig.forces).T, inputs)
        return real_product(response.shapes(stations), response.accelerance * modal_force)

    return np.asarray(sum(acceleration_by_body(response_of(rig, body, cache)) for body in rig.bodies))


def driven_masks(forces: Complex[np.ndarray, "forces lines"]) -> Bool[np.ndarray, "forces lines"]:
    """Mask of the lines on which each force has a share of its largest level."""
    force_level = np.sqrt(np.maximum(uniform_filter1d(np.abs(forces) ** 2, SMOOTHED_LINE_COUNT, axis=1), 0.0))
    return np.asarray(force_level > DRIVEN_LEVEL_SHARE * force_level.max(axis=1, keepdims=True))


class TimeResidual:
    """Residual of the linear model over time, real, in standard deviations that a sound record does not exceed.

    The contact forces, and a doubted force, are projected out; INDEPENDENT_RATE_HZ samples a second are independent.
    """

    def __init__(self, check: LinearCheck, channel_indices: list[int], doubted_force_index: int | None = None) -> None:
        line_noise = check.spectra.line_noise[channel_indices]
        levels = np.sqrt(np.maximum(check.error_scale[channel_indices] ** 2 - line_noise**2, 0)) / MODEL_ERROR_SHARE
        error_scale = np.hypot(MIN_MODEL_ERROR_SHARE * levels, line_noise)
        error_scale = np.maximum(error_scale, 1e-9 * error_scale.max())
        accelerances = check.unknown_input_accelerance(doubted_force_index)[:, channel_indices]
        self._projection = projection(accelerances / error_scale, error_scale, len(accelerances))
        self._spectra = check.spectra
        scaled_motion = self._spectra.compared_signals(check.spectra.acceleration[channel_indices] / error_scale)
        duration_s = effective_motion_duration_s(scaled_motion, self._spectra.compared_rate_hz)
        self._count_factor = np.float32(np.sqrt(min(1.0, INDEPENDENT_RATE_HZ * duration_s / len(scaled_motion.T))))
        self.sound_power = float(self._count_factor**2)
        """Mean square of a residual that a sound record does not exceed."""
        self.motion_powers = np.mean(scaled_motion**2, axis=1) * self._count_factor**2
        """Mean squares of the motion, in the same unit."""

    def __call__(self, spectra: Complex[np.ndarray, "sensors lines"]) -> Float[np.ndarray, "sensors times"]:
        return np.asarray(self._spectra.compared_signals(self._projection.applied_to(spectra)[0]) * self._count_factor)


def effective_motion_duration_s(motion: Float[np.ndarray, "sensors times"], samples_per_s: float) -> float:
    """Seconds of motion: all of the record, unless most of the motion falls into less than half of it.

    With the power p, averaged over a second, it is 2 (sum of p)^2 / sum of p^2, at most the record's length.
    """
    power = uniform_filter1d(np.mean(motion**2, axis=0, dtype=float), max(1, round(samples_per_s)))
    return float(min(power.size, STEADY_DURATION_FACTOR * np.sum(power) ** 2 / np.sum(power**2)) / samples_per_s)


def observed_motion(
    rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances
) -> ObservedSignals:
    """Motion as these channels show it, with the contact forces that explain it best.

    Modes near the band may be off, whether or not as many sensors stand on their body.
    """
    sensors, omega = tuple(check.spectra.sensors[i] for i in channel_indices), check.spectra.omega
    prediction, body_responses = check.prediction(channel_indices), list(check.responses)
    accelerations = prediction.accelerations[channel_indices]
    input_spectra = np.concatenate([prediction.force_spectra, prediction.contact_force_spectra])
    sensor_by_row, unit_response = dict(enumerate(sensors)), np.ones_like(accelerations)
    across = check.spectra.across[channel_indices]
    turnable = np.flatnonzero(across.any(axis=1)).tolist()
    transverse = ObservedTransverse(turnable, across[turnable], np.zeros_like(across[turnable]))
    truncations = truncations_of(
        rig, body_responses, rig.forces, sensor_by_row, unit_response, tolerances.truncation, MODE_BAND_RATIO
    )
    return ObservedSignals(
        sensors=sensors,
        displacement_sensors=sensors,
        tolerances=tolerances,
        omega=omega,
        sensor_response=unit_response,
        signals=accelerations,
        force_accelerations=check.acceleration_by_force[:, channel_indices],
        displacements=np.zeros_like(accelerations),
        bodies=tuple(_body_motion(rig, response, input_spectra) for response in body_responses),
        transverse=transverse,
        further_changes=tuple(truncation.change(input_spectra) for truncation in truncations),
    )


def _body_motion(rig: Rig, response: Response, input_spectra: Complex[np.ndarray, "inputs lines"]) -> BodyMotion:
    """Modal accelerations of a body by the forces and the contact forces."""
    modal_force = real_product(input_shapes(rig, response, rig.forces).T, input_spectra)
    elastic_indices = elastic_mode_indices(response, mode_count_below_band_margin(response, MODE_BAND_RATIO))
    return BodyMotion(response, response.accelerance * modal_force, elastic_indices)
