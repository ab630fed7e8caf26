"""Structure of the part `rollout` of gap.json: prediction by a correction."""

from typing import Literal

import msgspec

Code = Literal["not_vetoed", "worse", "no_improvement", "no_horizon", "too_short", "not_simulated"]
"""Vetoes are `worse` (the corrected rig predicts significantly worse than the believed one within its tolerances) and
`no_improvement` (simulations of machines that are as corrected say that it would predict better, and it does not). The
last three say why nothing was judged: null simulations cannot be predicted either, the record has too few seconds, the
simulator cannot start from these states."""


class PredictionErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Median errors of predictions over the windows, as shares of the motion's root mean square.

    nominal: of the believed rig as it stands, corrected: of the corrected one. null_95 is what the former stays below
    in 95 % of the recordings of rigs within the tolerances, null_median the median once it was fitted to those, which
    is what a right correction reaches. shrunk is the share of the gap that the correction closes, (nominal^2 -
    corrected^2) / (nominal^2 - null_median^2); None at the floor, where nominal lies below null_95.
    """

    nominal: float
    corrected: float
    null_median: float
    null_95: float
    shrunk: float | None

    @property
    def at_floor(self) -> bool:
        return self.shrunk is None


class DecayMode(msgspec.Struct, frozen=True, kw_only=True):
    """A mode of a free decay, as frequency (Hz) and damping ratio: measured, and of the predictions; None where a
    prediction has no such mode."""

    measured: tuple[float, float]
    nominal: tuple[float, float] | None
    corrected: tuple[float, float] | None


class Rollout(msgspec.Struct, frozen=True, kw_only=True):
    """Believed and corrected rig predicted over disjoint windows of a record from measured states.

    within is the median error of the believed rig with what was fitted within its tolerances: its best. log_ratio is
    the mean over blocks of 1 s of ln(corrected / within), with its standard error; expected_log_ratio what it would be
    if the correction were right; falls_short where it is neither so nor better at all, which simulations are to
    confirm. Errors are of velocities, of displacements where those are measured. Without windows
    nothing but the code is told.
    """

    code: Code
    horizon_s: float = 0.0
    windows: int = 0
    whole: PredictionErrors | None = None
    shrunk_95: tuple[float, float] | None = None
    within: float | None = None
    log_ratio: float | None = None
    log_ratio_error: float | None = None
    expected_log_ratio: float | None = None
    falls_short: bool = False
    by_sensor: dict[str, PredictionErrors] = {}
    decay: tuple[DecayMode, ...] = ()

    @property
    def vetoed(self) -> bool:
        return self.code in ("worse", "no_improvement")


class NullErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Median errors on a null recording over horizons of so many samples, by horizon: of all sensors together, then of
    each in their order. nominal: of the believed rig as it stands, within: with what was fitted within its tolerances.
    """

    samples: tuple[int, ...]
    nominal: tuple[tuple[float, ...], ...]
    within: tuple[tuple[float, ...], ...]
