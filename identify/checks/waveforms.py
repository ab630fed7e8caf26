"""Faults that a channel's samples show by themselves, without any model of the rig; see also `background`."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding, named
from rig.model.quantities import QUANTITIES

STUCK = 1e-3
"""A channel that stands at its largest or smallest value for a larger share of the record is clipped."""
COARSE = 0.01
"""Steps of a larger share of a channel's root mean square are too coarse."""
RECUR = 3.0
"""Levels that recur less often are not those of a quantiser."""
LARGEST_FORCE_N = 1e9
HELD = 8
"""So many equal samples in a row are held."""
SPIKE = 25.0
"""A sample that is off what its neighbours say by more than so many times the usual is a spike."""
IMPACT, APART, MOST_SPIKES = 8.0, 2.0, 60

Row = Float[np.ndarray, " samples"]
Rows = Float[np.ndarray, "*rows samples"]


def dead(name: str, row: Row, forces: Sequence[str] = ("force",)) -> Finding | None:
    if np.ptp(row) > 1e-9 * max(abs(float(row[0])), 1e-300) and np.ptp(row) > 0:
        return None
    return Finding(
        cause="dead",
        channels=(name,),
        evidence=f"{name} stands at {row[0]:.4g} throughout",
        mend="check its cable and amplifier, unless it did not act, as in a free decay"
        if name in forces
        else "check its cable and amplifier, or take it out of rig.json",
    )


def beyond_machines(name: str, group: str, row: Row) -> Finding | None:
    """Larger than anything on a test rig: 100 m, 1e4 m/s, 1e7 m/s^2, a strain of 10, a force of 1e9 N.

    The model is linear but for the clearances, and cannot tell when all channels are too large alike.
    """
    largest, unit = (LARGEST_FORCE_N, "N") if group == "force" else (QUANTITIES[group].largest, QUANTITIES[group].unit)
    reached = float(np.abs(row).max())
    if reached <= largest:
        return None
    return Finding(
        cause="units",
        channels=(name,),
        evidence=f"{name} reaches {reached:.3g} {unit}, and nothing on a test rig exceeds {largest:g} {unit}",
        mend="check the unit and the scale that it was recorded or imported with",
    )


def clipped(name: str, row: Row) -> Finding | None:
    """Finding: the signal stands at its largest or smallest value, not only where it is coarse."""
    for side, value in (("largest", row.max()), ("smallest", row.min())):
        share = float(np.mean(row == value))
        if share > STUCK and share * row.size >= 4 and abs(value - row.mean()) > 1.0 * row.std():
            return Finding(
                cause="clipped",
                channels=(name,),
                evidence=f"{name} stands at its {side} value, {value:.4g}, for {100 * share:.2g} % of the record",
                mend="take a larger measuring range or a weaker excitation, and record again",
            )
    return None


def quantised(name: str, row: Row) -> Finding | None:
    """The most common difference between neighbouring levels is large, and they recur: those of one blow do not."""
    levels, counts = np.unique(row[:: max(1, row.size // 20_000)], return_counts=True)
    recur = (counts.sum() - counts.max()) / levels.size
    if levels.size > 2000 or levels.size < 3 or recur < RECUR:
        return None
    step, rms = float(np.median(np.diff(levels))), float(row.std())
    if step < COARSE * rms:
        return None
    return Finding(
        cause="quantised",
        channels=(name,),
        evidence=f"{name} moves in steps of {step:.3g}, {100 * step / rms:.2g} % of its root mean square",
        mend="take a smaller measuring range or more bits, and record again",
    )


def held(name: str, row: Row, force: Rows, forces: Sequence[str] = ("force",)) -> Finding | None:
    """Runs of equal samples in a channel that else moves: samples that were lost and filled."""
    same = np.diff(row) == 0
    edges = np.flatnonzero(np.diff(np.r_[0, same.astype(np.int8), 0]))
    begins, ends = edges[::2], edges[1::2]
    if not begins.size or np.mean(same) > 0.3:
        return None
    size = np.abs(np.atleast_2d(force))
    from_s = int(np.argmax((size > 0.05 * size.max(axis=1, keepdims=True)).any(axis=0)))
    long = (ends - begins >= HELD) & (begins > from_s) & ~np.isin(row[begins], (row.max(), row.min()))
    if name in forces:
        long &= row[begins] != 0
    if not long.any():
        return None
    most = int(np.max((ends - begins)[long])) + 1
    return Finding(
        cause="held samples",
        channels=(name,),
        evidence=f"{name} repeats one value {most} times in a row, in {int(long.sum())} places, first at sample "
        f"{int(begins[long][0])}: samples were lost there",
        mend="record again, or leave that part of the record out",
    )


def off_neighbours(row: Row) -> Row:
    """Deviation of each sample from what its two neighbours on both sides say, over what is usual around it."""
    off = np.abs(row[2:-2] - (4 * (row[1:-3] + row[3:-1]) - row[:-4] - row[4:]) / 6)
    return np.asarray(np.r_[0, 0, off / np.maximum(_moving_mean(off, 201), 0.02 * off.mean() + 1e-300), 0, 0])


def spikes(name: str, off: Row, others: list[Row]) -> Finding | None:
    """Single samples that their neighbours do not explain, beside neighbours that fit; not at the record's ends.

    What other channels show too is an impact. Of the only channel, spikes stand out from all impacts.
    """
    end = off.size // 50
    inner = off[end:-end]
    found = [int(k) + end for k in np.flatnonzero(inner > SPIKE) if _alone(off, int(k) + end)]
    if others:
        found = [k for k in found if max(float(o[k - 3 : k + 4].max()) for o in others) < IMPACT]
    elif found:
        peaks = np.sort(inner[1:-1][(inner[1:-1] > inner[:-2]) & (inner[1:-1] > inner[2:])])[::-1][: MOST_SPIKES + 1]
        apart = peaks[:-1] / np.maximum(peaks[1:], 1e-300)
        last = int(np.argmax(apart))
        found = [k for k in found if off[k] >= peaks[last]] if apart[last] > APART else []
    if not 0 < len(found) <= MOST_SPIKES:
        return None
    return Finding(
        cause="spikes",
        channels=(name,),
        evidence=f"{name} jumps for single samples in {len(found)} places, first at sample {found[0]}",
        mend="check cables and connectors, and record again",
    )


def _alone(off: Row, k: int) -> bool:
    """Mask of single samples: two thirds of their deviation show at the samples beside them, a sixth at the next."""
    beside, next_ones = off[[k - 1, k + 1]], off[[k - 2, k + 2]]
    return bool(off[k] > 1.3 * beside.max() and beside.min() > 0.45 * off[k] and next_ones.max() < 0.35 * off[k])


def _moving_mean(values: Row, width: int) -> Row:
    """Moving mean of both sides, without the middle."""
    sums = np.cumsum(np.r_[0.0, values])
    low = np.clip(np.arange(values.size) - width // 2, 0, values.size)
    high = np.clip(np.arange(values.size) + width // 2 + 1, 0, values.size)
    return np.asarray((sums[high] - sums[low] - values) / np.maximum(high - low - 1, 1))


def copies(names: list[str], rows: list[Row]) -> Iterator[Finding]:
    """Channels that are the same, but for a factor."""
    thin = [r[:: max(1, r.size // 8192)] for r in rows]
    units = [(t - t.mean()) / n if (n := float(np.linalg.norm(t - t.mean()))) > 0 else np.zeros_like(t) for t in thin]
    alike = np.abs(np.array(units) @ np.array(units).T)
    for i, one in enumerate(names):
        for k in range(i):
            if alike[i, k] > 1 - 1e-9:
                yield Finding(
                    cause="copy",
                    channels=(names[k], one),
                    evidence=f"{named((names[k], one))} hold the same samples",
                    mend="check the channel map: one of them was recorded or imported twice",
                )
