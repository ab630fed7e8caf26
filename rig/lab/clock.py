"""Is a measured record evenly sampled, and at which rate: refused if not, or resampled if its owner says so."""

from fractions import Fraction

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import resample_poly

from rig.errors import RigError

JITTER = 0.01
"""The largest departure of a time stamp from an even grid, in sampling intervals."""
GAP = 1.5
"""From this many intervals on, two time stamps have a gap between them."""
BRIDGED = 4.5
"""The longest gap that is interpolated over, in intervals."""
RATE_TOLERANCE = 1e-4


def even(
    values: Float[np.ndarray, "channels samples"],
    time_s: Float[np.ndarray, " samples"],
    rate_hz: float,
    resample: bool,
) -> tuple[Float[np.ndarray, "channels evenly"], tuple[str, ...]]:
    """The samples at the times k / rate_hz after the first, and what was done to get them.

    Uneven time stamps are led by a cubic spline to an even grid of nearly their own rate (its error is at most
    5/384 (omega interval)^4 of the amplitude at the frequency omega); another rate is then reached by a linear-phase
    filter, flat within 1e-3 to 0.37 of the new rate and down by 80 dB at 0.63 of it. Both only if `resample` is true.
    Raises RigError, without the name of the file, if the stamps are uneven or at another rate and it is not, and
    always for stamps that do not increase, for long gaps and for a rate below rate_hz.
    """
    found, fault = _examined(time_s)
    if fault and not resample:
        raise RigError(f"{fault}; mend the record, or set resample = true in the map")
    other = abs(found / rate_hz - 1) > RATE_TOLERANCE
    if other and found < rate_hz:
        raise RigError(
            f"it is sampled at {found:.6g} Hz, below sample_rate_hz {rate_hz:g} of the rig; correct rig.json"
        )
    if other and not resample:
        raise RigError(
            f"it is sampled at {found:.6g} Hz, sample_rate_hz of the rig is {rate_hz:g}; correct rig.json, or set "
            "resample = true in the map"
        )
    ratio = Fraction(rate_hz / found).limit_denominator(1000) if other else Fraction(1)
    own_hz = rate_hz / float(ratio)
    done: tuple[str, ...] = ()
    if fault or abs(own_hz / found - 1) > RATE_TOLERANCE:
        grid_s = time_s[0] + np.arange(int((time_s[-1] - time_s[0]) * own_hz * (1 + 1e-12)) + 1) / own_hz
        values = CubicSpline(time_s, values, axis=1)(grid_s)
        done = (f"resampled to an even {own_hz:.9g} Hz by a cubic spline, since {fault or 'the rate is uneven'}",)
    if ratio != 1:
        values = resample_poly(
            values, ratio.numerator, ratio.denominator, axis=1, window=("kaiser", 8.0), padtype="line"
        )
        done = (*done, f"resampled from {own_hz:.9g} to {rate_hz:.9g} Hz by a linear-phase filter")
    return values, done


def _examined(time_s: Float[np.ndarray, " samples"]) -> tuple[float, str]:
    """The sampling rate of time stamps, and what is wrong with them in words, if anything."""
    if time_s.size < 2:
        raise RigError("it holds fewer than two samples; export more")
    steps_s = np.diff(time_s)
    if not (steps_s > 0).all():
        first = int(np.argmin(steps_s > 0))
        raise RigError(f"its time does not increase after {time_s[first]:.6f} s (sample {first}); sort or mend it")
    interval_s = float(np.median(steps_s))
    gaps = np.flatnonzero(steps_s > GAP * interval_s)
    if gaps.size:
        widest = int(np.argmax(steps_s))
        if steps_s[widest] > BRIDGED * interval_s:
            raise RigError(
                f"its time stamps have a gap of {steps_s[widest]:.6g} s after {time_s[widest]:.6f} s; cut the record "
                "there and import the longer part"
            )
        intervals = np.round(steps_s / interval_s).sum()
        return intervals / float(time_s[-1] - time_s[0]), (
            f"its time stamps have {gaps.size} gaps, the first after {time_s[gaps[0]]:.6f} s"
        )
    rate_hz = (time_s.size - 1) / float(time_s[-1] - time_s[0])
    strays = np.abs((time_s - time_s[0]) * rate_hz - np.arange(time_s.size))
    worst = int(np.argmax(strays))
    if strays[worst] > JITTER:
        return rate_hz, (
            f"its time stamps are uneven, by {strays[worst]:.2g} of a sampling interval at {time_s[worst]:.6f} s"
        )
    return rate_hz, ""
