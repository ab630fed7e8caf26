"""Continuity of the linear model's fit over time: lost samples disturb it for as long as the bodies ring."""

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.checks.prediction import TimeResidual, linear_check
from identify.checks.spectra import Spectra
from rig.model.description import Rig

PART_DURATION_S = 0.25
MIN_DISCONTINUITY_RATIO = 40.0
"""Smallest ratio of the residual power of a discontinuity to the usual one."""
POWER_FLOOR_SHARE = 0.02
"""Added to the power of a part's motion, as a share of the mean power, so that divisions at rest are defined."""


def discontinuity_findings(rig: Rig, spectra: Spectra, channel_indices: list[int]) -> list[Finding]:
    """Finding: a discontinuity in all channels, or in the one channel without which there is none.

    `spectra` hold all lines. None is reported if one of several forces breaks off, such as a hammer's.
    """
    worst_ratio, time_s = discontinuity_ratio_and_time_s(rig, spectra, channel_indices)
    if worst_ratio < MIN_DISCONTINUITY_RATIO or len(channel_indices) < len(rig.contacts) + 3:
        return []
    for k in range(len(spectra.forces) if len(spectra.forces) > 1 else 0):
        if discontinuity_ratio_and_time_s(rig, spectra, channel_indices, k)[0] < MIN_DISCONTINUITY_RATIO:
            return []
    ratio_without, worst_index = min(
        (discontinuity_ratio_and_time_s(rig, spectra, [i for i in channel_indices if i != k])[0], k)
        for k in channel_indices
    )
    if ratio_without < MIN_DISCONTINUITY_RATIO:
        channel_name = spectra.sensors[worst_index].name
        return [
            Finding(
                cause="glitch",
                channels=(channel_name,),
                evidence=f"{channel_name} leaves what all others predict at {time_s:.2f} s",
                mend="check its cable and connector, or leave that part of the record out",
            )
        ]
    return [
        Finding(
            cause="jump",
            channels=tuple(spectra.sensors[i].name for i in channel_indices),
            evidence=f"all channels together leave the linear model at {time_s:.2f} s, and only there",
            mend="samples were lost there, records were joined, or something struck the rig: use the part before it",
        )
    ]


def discontinuity_ratio_and_time_s(
    rig: Rig, spectra: Spectra, channel_indices: list[int], doubted_force_index: int | None = None
) -> tuple[float, float]:
    """Largest residual power of a part over that which is usual, and the part's time, s.

    Usual is the 30 % quantile of the residual power over the motion's, times the motion's in the part, and never less
    than the median residual power: noise does not fall with the motion, as at the beginning of the force.
    """
    check = linear_check(rig, spectra, channel_indices)
    unforced_acceleration = (spectra.acceleration - check.acceleration_by_all_forces)[channel_indices]
    residual = TimeResidual(check, channel_indices, doubted_force_index)(unforced_acceleration)
    scaled_acceleration = spectra.compared_signals((spectra.acceleration / check.error_scale)[channel_indices])
    residual_powers = _mean_square_by_interval(residual, spectra.compared_rate_hz)
    motion_powers = _mean_square_by_interval(scaled_acceleration, spectra.compared_rate_hz)
    motion_powers += POWER_FLOOR_SHARE * motion_powers.mean()
    usual_residual_share = np.quantile(residual_powers / motion_powers, 0.3)
    usual_powers = np.maximum(usual_residual_share * motion_powers, np.median(residual_powers))
    ratios = residual_powers / np.maximum(usual_powers, 1e-300)
    worst_part_index = int(np.argmax(ratios))
    return float(ratios[worst_part_index]), spectra.compared_span_s[0] + (worst_part_index + 0.5) * PART_DURATION_S


def _mean_square_by_interval(
    signals: Float[np.ndarray, "sensors times"], samples_per_s: float
) -> Float[np.ndarray, " parts"]:
    """Mean square of all rows in each part of the record."""
    part_sample_count = max(1, round(PART_DURATION_S * samples_per_s))
    part_count = signals.shape[1] // part_sample_count
    part_signals = signals[:, : part_count * part_sample_count].reshape(len(signals), part_count, part_sample_count)
    return np.asarray(np.mean(part_signals**2, axis=(0, 2)))
