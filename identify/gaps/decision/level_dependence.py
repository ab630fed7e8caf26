"""Dependence of a machine on the level of its motion, from what differs between records of several forces."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from identify.gaps.decision.identifiability import LEAST_RATIO, ratios_by_dampers
from identify.gaps.decision.null_reference import LEVEL
from identify.gaps.results import Compared, LevelDependence
from rig.model.description import Body, Rig
from rig.model.modes import modes_of, modes_wanted


def have_levels(levels_n: Sequence[float]) -> bool:
    """True if the forces are of more than one level, not within `LEVEL` of each other."""
    return min(levels_n) > 0 and max(levels_n) > LEVEL * min(levels_n)


def level_dependence(
    rigs: Sequence[Rig], levels_n: Sequence[float], differing: Sequence[Compared], highest_hz: float
) -> LevelDependence | None:
    """Change of the mode that changes most from the lowest to the highest level; `rigs` are the records'.

    None where some strength does not follow the level, or no mode below `highest_hz` changes.
    """
    if not differing or any(one.by_level not in ("grows", "falls") for one in differing):
        return None
    low, high = int(np.argmin(levels_n)), int(np.argmax(levels_n))
    largest: tuple[float, LevelDependence] | None = None
    for body in rigs[low].bodies:
        (hz, ratios), (hz_high, ratios_high) = (_tuning(rigs[k], rigs[k].body(body.name)) for k in (low, high))
        elastic = (hz > 0) & (hz < highest_hz)
        if not elastic.any():
            continue
        by_frequency, by_ratio = hz_high[elastic] / hz[elastic] - 1, ratios_high[elastic] / ratios[elastic] - 1
        size = np.hypot(by_frequency / ratios[elastic], by_ratio)
        mode = int(np.argmax(size))
        found = LevelDependence(
            lowest_n=float(levels_n[low]),
            highest_n=float(levels_n[high]),
            body=body.name,
            frequency_hz=float(hz[elastic][mode]),
            frequency_change=float(by_frequency[mode]),
            damping_change=float(by_ratio[mode]),
        )
        if size[mode] > 0 and (largest is None or size[mode] > largest[0]):
            largest = float(size[mode]), found
    return largest[1] if largest else None


def _tuning(rig: Rig, body: Body) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, " modes"]]:
    """Frequencies (Hz) and damping ratios of a body's modes, with the dampers on it."""
    modes, count = modes_of(rig, body), modes_wanted(body, body.max_modes)
    hz = modes.frequencies_hz(count)
    dampers = [d for d in rig.dampers if d.station.body == body.name]
    return hz, np.maximum(modes.damping_ratios(count), LEAST_RATIO) + ratios_by_dampers(modes, hz, dampers)
