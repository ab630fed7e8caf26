"""Free, sliding, sticking and whirling motion in a ring, told apart by the relative displacement."""

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_law import CLEARANCE, LOG_SPEED
from identify.pages.wording import percent

BRIDGED_OPENING_S = 0.005
"""Longest opening within a whirl."""
SHOWN_WHIRL_COUNT = 4
SECTOR_COUNT = 36
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
        whirl_times = ", ".join(f"{start_s:.1f} to {end_s:.1f} s" for start_s, end_s in self.whirls[:SHOWN_WHIRL_COUNT])
        ellipsis = ", ..." if len(self.whirls) > SHOWN_WHIRL_COUNT else ""
        whirling = f"whirling {percent(self.whirling)} ({whirl_times}{ellipsis})" if self.whirls else "never whirling"
        return (
            f"free {percent(self.free)} of the time, sliding {percent(self.sliding)}, sticking "
            f"{percent(self.sticking)}; {whirling}; {percent(self.touched_sectors)} of the ring touched"
        )


def ring_shares(estimate: AnnularEstimate, rate_hz: float, first_sample: int, start_s: float) -> RingShares:
    """Shares of an estimate's motion from its sample `first_sample` on; `start_s` is the time of sample zero."""
    (eta_y, eta_z), (rate_y, rate_z) = estimate.eta_m[:, first_sample:], estimate.rate_m_per_s[:, first_sample:]
    radius_m = np.maximum(np.hypot(eta_y, eta_z), 1e-12)
    is_closed = radius_m > estimate.values[CLEARANCE]
    is_sliding = np.abs(eta_y * rate_z - eta_z * rate_y) / radius_m > np.exp(estimate.values[LOG_SPEED])
    angle_rad = np.arctan2(eta_z, eta_y)
    sectors = np.unique(np.floor((angle_rad[is_closed] / (2 * np.pi) + 0.5) * SECTOR_COUNT).astype(int) % SECTOR_COUNT)
    whirl_samples = _whirl_samples(is_closed, angle_rad, round(BRIDGED_OPENING_S * rate_hz))
    return RingShares(
        free=float(np.mean(~is_closed)),
        sliding=float(np.mean(is_closed & is_sliding)),
        sticking=float(np.mean(is_closed & ~is_sliding)),
        whirling=float(np.sum(np.diff(whirl_samples))) / max(is_closed.size, 1),
        touched_sectors=sectors.size / SECTOR_COUNT,
        whirls=tuple(
            (start_s + (first_sample + first) / rate_hz, start_s + (first_sample + last) / rate_hz)
            for first, last in whirl_samples.tolist()
        ),
    )


def _whirl_samples(
    is_closed: Bool[np.ndarray, " samples"], angle_rad: Float[np.ndarray, " samples"], bridged_samples: int
) -> Int[np.ndarray, "whirls 2"]:
    """First and last samples of the times of contact in which the angle goes once around or more."""
    closed = np.flatnonzero(is_closed)
    if not closed.size:
        return np.zeros((0, 2), dtype=int)
    break_indices = np.flatnonzero(np.diff(closed) > bridged_samples)
    first_samples, last_samples = closed[np.r_[0, break_indices + 1]], closed[np.r_[break_indices, closed.size - 1]]
    unwrapped_rad = np.unwrap(angle_rad)
    goes_around = np.abs(unwrapped_rad[last_samples] - unwrapped_rad[first_samples]) >= 2 * np.pi
    return np.stack([first_samples[goes_around], last_samples[goes_around]], axis=1)
