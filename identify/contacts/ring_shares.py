"""Free, sliding, sticking and whirling motion in a ring, told apart by the relative displacement."""

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_law import CLEARANCE, LOG_SPEED
from identify.pages.wording import percent

BRIDGED_S = 0.005
"""Longest opening within a whirl."""
SHOWN_WHIRLS = 4
SECTORS = 36
"""Sectors of the ring whose touching is counted."""


class RingShares(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Shares of the used time from the first force on: free (open), sliding (closed, faster along the wall than the
    sliding speed), sticking (closed and slower), whirling (once around or more, with openings of 5 ms at most; these
    times count above, too); and the share of 36 sectors that are touched. whirls are beginnings and ends, s."""

    free: float
    sliding: float
    sticking: float
    whirling: float
    touched_sectors: float
    whirls: tuple[tuple[float, float], ...] = ()

    @property
    def sentence(self) -> str:
        """Shares in words, without a full stop."""
        times = ", ".join(f"{first:.1f} to {last:.1f} s" for first, last in self.whirls[:SHOWN_WHIRLS])
        more = ", ..." if len(self.whirls) > SHOWN_WHIRLS else ""
        whirling = f"whirling {percent(self.whirling)} ({times}{more})" if self.whirls else "never whirling"
        return (
            f"free {percent(self.free)} of the time, sliding {percent(self.sliding)}, sticking "
            f"{percent(self.sticking)}; {whirling}; {percent(self.touched_sectors)} of the ring touched"
        )


def ring_shares(estimate: AnnularEstimate, rate_hz: float, first: int, start_s: float) -> RingShares:
    """Shares of an estimate's motion from its `first` sample on; `start_s` is the time of sample zero."""
    (y, z), (vy, vz) = estimate.eta_m[:, first:], estimate.rate_m_per_s[:, first:]
    radius = np.maximum(np.hypot(y, z), 1e-12)
    closed = radius > estimate.values[CLEARANCE]
    slides = np.abs(y * vz - z * vy) / radius > np.exp(estimate.values[LOG_SPEED])
    angle = np.arctan2(z, y)
    sectors = np.unique(np.floor((angle[closed] / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS)
    whirls = _whirls(closed, angle, round(BRIDGED_S * rate_hz))
    return RingShares(
        free=float(np.mean(~closed)),
        sliding=float(np.mean(closed & slides)),
        sticking=float(np.mean(closed & ~slides)),
        whirling=float(np.sum(np.diff(whirls))) / max(closed.size, 1),
        touched_sectors=sectors.size / SECTORS,
        whirls=tuple((start_s + (first + a) / rate_hz, start_s + (first + b) / rate_hz) for a, b in whirls.tolist()),
    )


def _whirls(
    closed: Bool[np.ndarray, " samples"], angle: Float[np.ndarray, " samples"], bridged: int
) -> Int[np.ndarray, "whirls 2"]:
    """First and last samples of the times of contact in which the angle goes once around or more."""
    samples = np.flatnonzero(closed)
    if not samples.size:
        return np.zeros((0, 2), dtype=int)
    breaks = np.flatnonzero(np.diff(samples) > bridged)
    starts, stops = samples[np.r_[0, breaks + 1]], samples[np.r_[breaks, samples.size - 1]]
    turned = np.unwrap(angle)
    goes_around = np.abs(turned[stops] - turned[starts]) >= 2 * np.pi
    return np.stack([starts[goes_around], stops[goes_around]], axis=1)
