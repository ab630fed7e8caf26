"""Changes of modes that a record determines: in place of an effect's strength, and with the level of the motion.

A spring k, a mass m or a damper c at a place x changes mode r by k phi_r(x)^2 and so on. Where one mode dominates, the
record determines only that product. On a body that is known by its modes alone phi_r(x) is interpolated, so that the
strength is as uncertain as the shapes given beside x allow; the change of the mode is then stated in its place.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from identify.gaps.decision.null_reference import LEVEL_FACTOR
from identify.gaps.results import LevelDependence, ParameterByRecord
from identify.gaps.search.candidates import Candidate, attachments_of
from identify.pages.wording import interval, number
from rig.errors import RigError
from rig.model.description import Body, PointDamper, PointMass, PointSpring, Rig, Station
from rig.model.modes import Modes, basis_places_beside, mode_count, modes_of

DOMINANT_SHARE = 0.5
"""Share of the squared changes of all modes in the band, in half bandwidths, above which one mode dominates. Derived:
more than all others together."""
SHAPE_RATIO_LIMIT = 1.5
"""Ratio of the strengths that the neighbouring shapes allow, from which a strength cannot be determined. Set by
hand."""
MIN_DAMPING_RATIO = 1e-4
"""Lower limit of damping ratios."""
DERIVATIVE_STEP = 1e-2
"""Step of derivatives, in standard errors."""


def identifiable_change(
    rig: Rig,
    candidate: Candidate,
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    highest_hz: float,
) -> str:
    """Change of a mode that the record determines in place of an effect's strength; empty where it determines that.

    values and covariance are those of the effect's parameters; modes up to highest_hz are in the band.
    """
    attached = attachments_of(rig, candidate.applied(rig, values))
    items: tuple[PointSpring | PointDamper | PointMass, ...]
    items = (*attached.springs, *attached.dampers, *attached.masses) if attached else ()
    stations = [item.station for item in items]
    if len(stations) != 1:
        return ""
    (station,) = stations
    neighbours_m = basis_places_beside(rig.body(station.body), station.position_m)
    mode = _dominant_mode(rig, candidate, values, station, highest_hz) if neighbours_m else None
    if mode is None:
        return ""
    modes = modes_of(rig, rig.body(station.body))
    shapes_squared = modes.shapes(np.array([station.position_m, *neighbours_m]), mode + 1)[:, mode] ** 2
    if shapes_squared.max() < SHAPE_RATIO_LIMIT * shapes_squared.min():
        return ""
    reason = "not told, as no sensor stands there and one mode dominates"
    mode_words = f"the mode at {number(float(modes.frequencies_hz(mode + 1)[mode]))} Hz"
    for index, (quantity, unit, scale) in enumerate((("frequency", "Hz", 1.0), ("damping ratio", "%", 100.0))):

        def shift(parameters: Float[np.ndarray, " parameters"], index: int = index) -> float:
            return float(_modal_changes(rig, candidate, parameters, station.body)[index][mode])

        if change := shift(values):
            change_words = interval(scale * change, scale * _standard_error(shift, values, covariance), unit)
            return f"{reason}; told: the {quantity} of {mode_words} changes by {change_words}"
    return f"{reason}: {mode_words}"


def _modal_changes(
    rig: Rig, candidate: Candidate, values: Float[np.ndarray, " parameters"], body_name: str
) -> Float[np.ndarray, "2 modes"]:
    """Changes of each mode of a body by an effect: natural frequency (Hz) and damping ratio."""
    body, changed = rig.body(body_name), candidate.applied(rig, values)
    count = mode_count(body, body.max_modes)
    before, after = modes_of(rig, body), modes_of(changed, body)
    frequencies_hz = before.frequencies_hz(count)
    ratios = ratios_by_dampers(before, frequencies_hz, changed.dampers[len(rig.dampers) :])
    return np.array([after.frequencies_hz(count) - frequencies_hz, ratios])


def ratios_by_dampers(
    modes: Modes, frequencies_hz: Float[np.ndarray, " modes"], dampers: Sequence[PointDamper]
) -> Float[np.ndarray, " modes"]:
    """Damping ratios c phi^2 / (2 omega) that dampers on a body add to its modes."""
    ratios = np.zeros_like(frequencies_hz)
    for damper in dampers:
        shape = modes.shapes(np.array([damper.station.position_m]), frequencies_hz.size)[0]
        ratios += damper.damping_n_s_per_m * shape**2 / (4 * np.pi * np.maximum(frequencies_hz, 1e-9))
    return ratios


def _dominant_mode(
    rig: Rig, candidate: Candidate, values: Float[np.ndarray, " parameters"], station: Station, highest_hz: float
) -> int | None:
    """Mode that an effect changes most by far; None if none dominates, or if the body has rigid modes, whose shapes are
    lines.

    An effect on neither frequencies nor damping ratios (friction, a cubic spring) is treated as a spring.
    """
    body = rig.body(station.body)
    modes, count = modes_of(rig, body), mode_count(body, body.max_modes)
    frequencies_hz, ratios = modes.frequencies_hz(count), np.maximum(modes.damping_ratios(count), MIN_DAMPING_RATIO)
    if body.rigid_modes:
        return None
    by_frequency, by_ratio = _modal_changes(rig, candidate, values, station.body)
    sizes = np.hypot(by_frequency / frequencies_hz, by_ratio) / ratios
    if not sizes.any():
        sizes = modes.shapes(np.array([station.position_m]), count)[0] ** 2 / (frequencies_hz**2 * ratios)
    in_band = np.where(frequencies_hz < highest_hz, sizes, 0.0) ** 2
    largest = int(np.argmax(in_band))
    return largest if in_band[largest] > DOMINANT_SHARE * in_band.sum() else None


def _standard_error(
    function: Callable[[Float[np.ndarray, " parameters"]], float],
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
) -> float:
    """First-order standard error of a function of the parameters; zero at the end of what the rig allows."""
    steps = DERIVATIVE_STEP * np.diag(np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    try:
        slopes = np.array(
            [
                (function(values + step) - function(values - step)) / (2 * step.sum()) if step.any() else 0.0
                for step in steps
            ]
        )
    except RigError:
        return 0.0  # at the end of what the rig can be
    return float(np.sqrt(max(slopes @ covariance @ slopes, 0.0)))


def have_levels(levels_n: Sequence[float]) -> bool:
    """True if the forces are of several levels, not all within `LEVEL_FACTOR` of each other."""
    return min(levels_n) > 0 and max(levels_n) > LEVEL_FACTOR * min(levels_n)


def level_dependence(
    rigs: Sequence[Rig], levels_n: Sequence[float], differing: Sequence[ParameterByRecord], highest_hz: float
) -> LevelDependence | None:
    """Change, from the lowest to the highest level, of the mode that changes most; `rigs` are those of the records.

    None where a strength does not follow the level, or no mode below `highest_hz` changes.
    """
    if not differing or any(parameter.by_level not in ("grows", "falls") for parameter in differing):
        return None
    low, high = int(np.argmin(levels_n)), int(np.argmax(levels_n))
    largest: tuple[float, LevelDependence] | None = None
    for body in rigs[low].bodies:
        (low_hz, low_ratios), (high_hz, high_ratios) = (
            _modal_parameters(rigs[k], rigs[k].body(body.name)) for k in (low, high)
        )
        elastic = (low_hz > 0) & (low_hz < highest_hz)
        if not elastic.any():
            continue
        by_frequency, by_ratio = high_hz[elastic] / low_hz[elastic] - 1, high_ratios[elastic] / low_ratios[elastic] - 1
        size = np.hypot(by_frequency / low_ratios[elastic], by_ratio)
        mode = int(np.argmax(size))
        dependence = LevelDependence(
            lowest_n=float(levels_n[low]),
            highest_n=float(levels_n[high]),
            body=body.name,
            frequency_hz=float(low_hz[elastic][mode]),
            frequency_change=float(by_frequency[mode]),
            damping_change=float(by_ratio[mode]),
        )
        if size[mode] > 0 and (largest is None or size[mode] > largest[0]):
            largest = float(size[mode]), dependence
    return largest[1] if largest else None


def _modal_parameters(rig: Rig, body: Body) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, " modes"]]:
    """Natural frequencies (Hz) and damping ratios of a body's modes, including the dampers on it."""
    modes, count = modes_of(rig, body), mode_count(body, body.max_modes)
    natural_hz = modes.frequencies_hz(count)
    dampers = [damper for damper in rig.dampers if damper.station.body == body.name]
    return natural_hz, np.maximum(modes.damping_ratios(count), MIN_DAMPING_RATIO) + ratios_by_dampers(
        modes, natural_hz, dampers
    )
