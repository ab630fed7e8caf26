"""Numbers that a record does not tell: what acts between the given shapes of a body that is known by its modes alone.

A spring k, a mass m or a damper c at a place x changes mode r by k phi_r(x)^2 and so on. Where one mode dominates, that
product is all that the record tells; and where phi_r(x) is interpolated, the number itself is as wide as the shapes
given beside x allow. Then the shift of the mode is told in its place.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from identify.gaps.search.attached import added
from identify.gaps.search.candidates import Candidate
from identify.pages.wording import interval, number
from rig.errors import RigError
from rig.model.description import PointDamper, PointMass, PointSpring, Rig, Station
from rig.model.modes import Modes, given_beside, modes_of, modes_wanted

DOMINATES = 0.5
"""A mode with more than this share of the changes of all modes in the band (in half bandwidths, squared) dominates."""
WIDE = 1.5
"""A number is not told where the shapes beside its place allow values that differ by more than this factor."""
LEAST_RATIO = 1e-4
"""A damping ratio below this counts as this."""
STEP = 1e-2
"""Of the standard error: the step of derivatives."""


def identifiable_change(
    rig: Rig,
    candidate: Candidate,
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    highest_hz: float,
) -> str:
    """Change of a mode that the record determines in place of an effect's strength; empty where it determines that.

    values and covariance are those of the effect's parameters; modes up to highest_hz are seen.
    """
    more = added(rig, candidate.applied(rig, values))
    places = [*_places(more.springs), *_places(more.dampers), *_places(more.masses)] if more else []
    if len(places) != 1:
        return ""
    (place,) = places
    beside = given_beside(rig.body(place.body), place.position_m)
    mode = _dominant_mode(rig, candidate, values, place, highest_hz) if beside else None
    if mode is None:
        return ""
    modes = modes_of(rig, rig.body(place.body))
    squares = modes.shapes(np.array([place.position_m, *beside]), mode + 1)[:, mode] ** 2
    if squares.max() < WIDE * squares.min():
        return ""
    why = "not told, as no sensor stands there and one mode dominates"
    of = f"the mode at {number(float(modes.frequencies_hz(mode + 1)[mode]))} Hz"
    for index, (what, unit, scale) in enumerate((("frequency", "Hz", 1.0), ("damping ratio", "%", 100.0))):

        def shift(x: Float[np.ndarray, " parameters"], index: int = index) -> float:
            return float(_changes(rig, candidate, x, place.body)[index][mode])

        if found := shift(values):
            said = interval(scale * found, scale * _error(shift, values, covariance), unit)
            return f"{why}; told: the {what} of {of} changes by {said}"
    return f"{why}: {of}"


def _places(attached: Sequence[PointSpring | PointDamper | PointMass]) -> list[Station]:
    return [one.station for one in attached]


def _changes(
    rig: Rig, candidate: Candidate, values: Float[np.ndarray, " parameters"], body_name: str
) -> Float[np.ndarray, "2 modes"]:
    """Changes of each mode of a body by an effect: frequency, Hz, and damping ratio."""
    body, moved = rig.body(body_name), candidate.applied(rig, values)
    count = modes_wanted(body, body.max_modes)
    before, after = modes_of(rig, body), modes_of(moved, body)
    hz = before.frequencies_hz(count)
    ratios = ratios_by_dampers(before, hz, moved.dampers[len(rig.dampers) :])
    return np.array([after.frequencies_hz(count) - hz, ratios])


def ratios_by_dampers(
    modes: Modes, frequencies_hz: Float[np.ndarray, " modes"], dampers: Sequence[PointDamper]
) -> Float[np.ndarray, " modes"]:
    """Damping ratios that dampers on a body give its modes: c phi^2 / (2 omega) each."""
    ratios = np.zeros_like(frequencies_hz)
    for damper in dampers:
        shape = modes.shapes(np.array([damper.station.position_m]), frequencies_hz.size)[0]
        ratios += damper.damping_n_s_per_m * shape**2 / (4 * np.pi * np.maximum(frequencies_hz, 1e-9))
    return ratios


def _dominant_mode(
    rig: Rig, candidate: Candidate, values: Float[np.ndarray, " parameters"], place: Station, highest_hz: float
) -> int | None:
    """The mode that dominates what an effect changes; None if none does, or a rigid-body mode, whose shape is a line.

    What changes neither a frequency nor a damping ratio (friction, a cubic spring) is taken to act as a spring would.
    """
    body = rig.body(place.body)
    modes, count = modes_of(rig, body), modes_wanted(body, body.max_modes)
    hz, ratios = modes.frequencies_hz(count), np.maximum(modes.damping_ratios(count), LEAST_RATIO)
    if body.rigid_modes:
        return None
    by_frequency, by_ratio = _changes(rig, candidate, values, place.body)
    sizes = np.hypot(by_frequency / hz, by_ratio) / ratios
    if not sizes.any():
        sizes = modes.shapes(np.array([place.position_m]), count)[0] ** 2 / (hz**2 * ratios)
    squares = np.where(hz < highest_hz, sizes, 0.0) ** 2
    largest = int(np.argmax(squares))
    return largest if squares[largest] > DOMINATES * squares.sum() else None


def _error(
    of: Callable[[Float[np.ndarray, " parameters"]], float],
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
) -> float:
    """Standard error of a function of the parameters, to first order; zero where it cannot be had."""
    steps = STEP * np.diag(np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    try:
        slopes = np.array([(of(values + s) - of(values - s)) / (2 * s.sum()) if s.any() else 0.0 for s in steps])
    except RigError:
        return 0.0  # at the end of what the rig can be
    return float(np.sqrt(max(slopes @ covariance @ slopes, 0.0)))
