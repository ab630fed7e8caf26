"""Changes of modes that a record determines: in place of an effect's strength, and with the level of the motion.

A spring k, a mass m or a damper c at a place x changes mode r by k phi_r(x)^2 and so on. Where one mode dominates, the
record determines only that product. On a body that is known by its modes alone phi_r(x) is interpolated, so that the
strength is as uncertain as the shapes given beside x allow; the change of the mode is then stated in its place.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.gaps.decision.null_reference import LEVEL_FACTOR
from identify.gaps.residual.record import Record
from identify.gaps.results import LevelDependence, ParameterByRecord
from identify.gaps.search.candidates import Candidate, attachments_of
from identify.pages.wording import interval, number
from rig.errors import RigError
from rig.model.description import PointDamper, PointMass, PointSpring, Rig, Station
from rig.model.modes import Modes, mode_count, modes_of, neighbouring_basis_places_m

DOMINANT_SHARE = 0.5
"""Share of the squared changes of all modes in the band, in half bandwidths, above which one mode dominates. Derived:
more than all others together."""
SHAPE_RATIO_LIMIT = 1.5
"""Ratio of the strengths that the neighbouring shapes allow, from which a strength cannot be determined. Set by
hand."""
MIN_DAMPING_RATIO = 1e-4
"""Lower limit of damping ratios."""
UNDRIVEN_SHARE = 1e-3
"""Share of a force's power below the band that it drives. Set by hand."""
DERIVATIVE_STEP = 1e-2
"""Step of derivatives, in standard errors."""


def identifiable_change_words(
    rig: Rig,
    candidate: Candidate,
    effect_values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    highest_hz: float,
) -> str:
    """Change of a mode that the record determines in place of an effect's strength; empty where it determines that.

    values and covariance are those of the effect's parameters; modes up to highest_hz are in the band.
    """
    attachments = attachments_of(rig, candidate.applied(rig, effect_values))
    attached_elements: tuple[PointSpring | PointDamper | PointMass, ...]
    attached_elements = (*attachments.springs, *attachments.dampers, *attachments.masses) if attachments else ()
    if len(attached_elements) != 1:
        return ""
    station = attached_elements[0].station
    body = rig.body(station.body)
    neighbours_m = neighbouring_basis_places_m(body, station.position_m)
    mode_index = _dominant_mode_index(rig, candidate, effect_values, station, highest_hz) if neighbours_m else None
    if mode_index is None:
        return ""
    modes = modes_of(rig, body)
    shapes_squared = modes.shapes(np.array([station.position_m, *neighbours_m]), mode_index + 1)[:, mode_index] ** 2
    if shapes_squared.max() < SHAPE_RATIO_LIMIT * shapes_squared.min():
        return ""
    reason_words = "not told, as no sensor stands there and one mode dominates"
    mode_words = f"the mode at {number(float(modes.frequencies_hz(mode_index + 1)[mode_index]))} Hz"
    for row, (name, unit, unit_factor) in enumerate((("frequency", "Hz", 1.0), ("damping ratio", "%", 100.0))):

        def modal_change(values: Float[np.ndarray, " parameters"], row: int = row) -> float:
            return float(_frequency_and_damping_changes(rig, candidate, values, station.body)[row][mode_index])

        if change := modal_change(effect_values):
            standard_error = _standard_error_of(modal_change, effect_values, covariance)
            change_words = interval(unit_factor * change, unit_factor * standard_error, unit)
            return f"{reason_words}; told: the {name} of {mode_words} changes by {change_words}"
    return f"{reason_words}: {mode_words}"


def _frequency_and_damping_changes(
    rig: Rig, candidate: Candidate, effect_values: Float[np.ndarray, " parameters"], body_name: str
) -> Float[np.ndarray, "2 modes"]:
    """Changes of each mode of a body by an effect: natural frequency (Hz) and damping ratio."""
    body, changed_rig = rig.body(body_name), candidate.applied(rig, effect_values)
    count = mode_count(body, body.max_modes)
    modes, changed_modes = modes_of(rig, body), modes_of(changed_rig, body)
    frequencies_hz = modes.frequencies_hz(count)
    added_damping = damping_ratios_by_dampers(modes, frequencies_hz, changed_rig.dampers[len(rig.dampers) :])
    return np.array([changed_modes.frequencies_hz(count) - frequencies_hz, added_damping])


def damping_ratios_by_dampers(
    modes: Modes, frequencies_hz: Float[np.ndarray, " modes"], dampers: Sequence[PointDamper]
) -> Float[np.ndarray, " modes"]:
    """Damping ratios c phi^2 / (2 omega) that dampers on a body add to its modes."""
    damping_ratios = np.zeros_like(frequencies_hz)
    for damper in dampers:
        shapes = modes.shapes(np.array([damper.station.position_m]), frequencies_hz.size)[0]
        damping_ratios += damper.damping_n_s_per_m * shapes**2 / (4 * np.pi * np.maximum(frequencies_hz, 1e-9))
    return damping_ratios


def _dominant_mode_index(
    rig: Rig, candidate: Candidate, effect_values: Float[np.ndarray, " parameters"], station: Station, highest_hz: float
) -> int | None:
    """Mode that an effect changes most by far; None if none dominates, or if the body has rigid modes, whose shapes are
    lines.

    An effect on neither frequencies nor damping ratios (friction, a cubic spring) is treated as a spring.
    """
    body = rig.body(station.body)
    if body.rigid_modes:
        return None
    modes, count = modes_of(rig, body), mode_count(body, body.max_modes)
    frequencies_hz = modes.frequencies_hz(count)
    damping_ratios = np.maximum(modes.damping_ratios(count), MIN_DAMPING_RATIO)
    frequency_changes_hz, damping_changes = _frequency_and_damping_changes(rig, candidate, effect_values, station.body)
    change_in_half_widths = np.hypot(frequency_changes_hz / frequencies_hz, damping_changes) / damping_ratios
    if not change_in_half_widths.any():
        shapes = modes.shapes(np.array([station.position_m]), count)[0]
        change_in_half_widths = shapes**2 / (frequencies_hz**2 * damping_ratios)
    squares_in_band = np.where(frequencies_hz < highest_hz, change_in_half_widths, 0.0) ** 2
    largest_index = int(np.argmax(squares_in_band))
    return largest_index if squares_in_band[largest_index] > DOMINANT_SHARE * squares_in_band.sum() else None


def _standard_error_of(
    quantity_of: Callable[[Float[np.ndarray, " parameters"]], float],
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
) -> float:
    """First-order standard error of a function of the parameters; zero at the end of what the rig allows."""
    parameter_steps = DERIVATIVE_STEP * np.diag(np.sqrt(np.maximum(np.diag(covariance), 0.0)))

    def slope(step: Float[np.ndarray, " parameters"]) -> float:
        return (quantity_of(values + step) - quantity_of(values - step)) / (2 * step.sum()) if step.any() else 0.0

    try:
        quantity_slopes = np.array([slope(step) for step in parameter_steps])
    except RigError:
        return 0.0  # at the end of what the rig can be
    return float(np.sqrt(max(quantity_slopes @ covariance @ quantity_slopes, 0.0)))


def has_several_force_levels(force_levels_n: Sequence[float]) -> bool:
    """True if the forces are of several levels, not all within `LEVEL_FACTOR` of each other."""
    return min(force_levels_n) > 0 and max(force_levels_n) > LEVEL_FACTOR * min(force_levels_n)


def driven_band_hz(records: Sequence[Record]) -> tuple[float, float]:
    """Band in which forces drive the records, Hz: above the frequency below which they have `UNDRIVEN_SHARE`."""
    lowest_hz = [
        float(record.omega[max(1, np.searchsorted(power, UNDRIVEN_SHARE * power[-1]))] / (2 * np.pi))
        for record in records
        for power in [np.cumsum(np.sum(np.abs(record.force_spectra) ** 2, axis=0))]
        if record.has_force
    ]
    return min(lowest_hz, default=0.0), max(record.highest_hz for record in records)


def level_dependence(
    rigs_of: Callable[[Float[np.ndarray, " parameters"]], Sequence[Rig]],
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    force_levels_n: Sequence[float],
    differing: Sequence[ParameterByRecord],
    band_hz: tuple[float, float],
) -> LevelDependence | None:
    """Change, from the lowest to the highest level, of the mode in the band that changes most, with standard errors.

    rigs_of gives the rig of every record at values of the parameters that differ, whose estimate and covariance are
    given. None where a strength does not follow the level, or no mode in the band changes.
    """
    if not differing or any(parameter.by_level not in ("grows", "falls") for parameter in differing):
        return None
    lowest_index, highest_index = int(np.argmin(force_levels_n)), int(np.argmax(force_levels_n))

    def changes_of(values: Float[np.ndarray, " parameters"], body_name: str) -> Float[np.ndarray, "2 modes"]:
        rigs = rigs_of(values)
        lowest = np.array(_modal_parameters(rigs[lowest_index], body_name))
        return np.array(_modal_parameters(rigs[highest_index], body_name)) / np.where(lowest > 0, lowest, np.inf) - 1

    largest_size, dependence, lowest_rig = 0.0, None, rigs_of(values)[lowest_index]
    for body in lowest_rig.bodies:
        lowest_level_hz, lowest_level_damping = _modal_parameters(lowest_rig, body.name)
        is_driven = (lowest_level_hz > band_hz[0]) & (lowest_level_hz < band_hz[1])
        if not is_driven.any():
            continue
        frequency_changes, damping_changes = changes_of(values, body.name)
        change_sizes = np.where(is_driven, np.hypot(frequency_changes / lowest_level_damping, damping_changes), 0.0)
        mode_index = int(np.argmax(change_sizes))
        if change_sizes[mode_index] > largest_size:
            largest_size = float(change_sizes[mode_index])

            def change_of(
                values: Float[np.ndarray, " parameters"], row: int, body_name: str = body.name, index: int = mode_index
            ) -> float:
                return float(changes_of(values, body_name)[row, index])

            frequency_error, damping_error = (
                _standard_error_of(partial(change_of, row=row), values, covariance) for row in range(2)
            )
            dependence = LevelDependence(
                lowest_n=float(force_levels_n[lowest_index]),
                highest_n=float(force_levels_n[highest_index]),
                body=body.name,
                frequency_hz=float(lowest_level_hz[mode_index]),
                frequency_change=float(frequency_changes[mode_index]),
                damping_change=float(damping_changes[mode_index]),
                frequency_change_standard_error=frequency_error,
                damping_change_standard_error=damping_error,
            )
    return dependence


def _modal_parameters(rig: Rig, body_name: str) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, " modes"]]:
    """Natural frequencies (Hz) and damping ratios of a body's modes, including the dampers on it."""
    body = rig.body(body_name)
    modes, count = modes_of(rig, body), mode_count(body, body.max_modes)
    natural_hz, own_damping = modes.frequencies_hz(count), np.maximum(modes.damping_ratios(count), MIN_DAMPING_RATIO)
    dampers = [damper for damper in rig.dampers if damper.station.body == body_name]
    return natural_hz, own_damping + damping_ratios_by_dampers(modes, natural_hz, dampers)
