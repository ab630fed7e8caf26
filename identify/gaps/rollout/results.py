"""Part `rollout` of gap.json: prediction errors of the nominal and the corrected rig."""

from typing import Literal

import msgspec

Code = Literal["not_vetoed", "worse", "no_improvement", "no_horizon", "too_short", "not_simulated"]
"""Vetoes are `worse` (the corrected rig predicts significantly worse than the nominal one within its tolerances) and
`no_improvement` (simulated machines that are as corrected are predicted better, this one is not). The last three name
why nothing was judged: null simulations cannot be predicted either, the record is too short, the simulator cannot start
from these states."""


class PredictionErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Median prediction errors over the windows, as shares of the motion's root mean square.

    nominal and corrected are those of the two rigs. null_95 is the upper 95 % limit of nominal for machines within the
    tolerances, null_median the median for such machines after fitting, which a right correction reaches. shrunk is the
    share of the mismatch that the correction removes, (nominal^2 - corrected^2) / (nominal^2 - null_median^2); None at
    the floor, where nominal lies below null_95.
    """

    nominal: float
    corrected: float
    null_median: float
    null_95: float
    shrunk: float | None

    @property
    def is_within_null_errors(self) -> bool:
        """True if the nominal rig predicts as well as machines within the tolerances."""
        return self.shrunk is None


class DecayMode(msgspec.Struct, frozen=True, kw_only=True):
    """Frequency (Hz) and damping ratio of a mode of a free decay, measured and predicted; None where a prediction lacks
    it."""

    measured: tuple[float, float]
    nominal: tuple[float, float] | None
    corrected: tuple[float, float] | None


class PredictionExample(msgspec.Struct, frozen=True, kw_only=True):
    """Measured and predicted motion of a sensor in the window of median error, in `unit`; times are of the record."""

    sensor: str
    unit: str
    time_s: tuple[float, ...]
    measured: tuple[float, ...]
    nominal: tuple[float, ...]
    corrected: tuple[float, ...]


class Rollout(msgspec.Struct, frozen=True, kw_only=True):
    """Prediction of the nominal and the corrected rig over disjoint windows of a record, from measured states.

    whole are the errors of all sensors together, shrunk_95 the 95 % interval of their share removed. within is the
    median error of the nominal rig fitted within its tolerances. log_ratio is the mean of ln(corrected / within) over
    blocks of 1 s, with its standard error; expected_log_ratio that of a right correction; falls_short marks a ratio
    that reaches neither this nor any improvement, for simulations to confirm. Errors are of velocities, or of measured
    displacements. Without windows only the code is given.
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
    example: PredictionExample | None = None

    @property
    def vetoed(self) -> bool:
        """True if prediction rejects the correction."""
        return self.code in ("worse", "no_improvement")


class NullErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Median prediction errors on a null recording by horizon (samples): of all sensors together, then of each.

    nominal are those of the nominal rig, within those of the nominal rig fitted within its tolerances.
    """

    samples: tuple[int, ...]
    nominal: tuple[tuple[float, ...], ...]
    within: tuple[tuple[float, ...], ...]
