"""Statistical tests for changes of a machine's clearances, stiffnesses and modes from recording to recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.stats import chi2
from scipy.stats import t as student_t

from identify.contacts.results import ContactReport, Estimate
from rig.errors import RigError

SIGNIFICANCE_LEVEL = 0.05
"""Probability that any change at all is stated of a machine that did not change."""
ERROR_INFLATION = 1.5
"""Factor by which own errors may be too small: for the machines of `tests.campaigns.wear --seed 3` the scatter of a
clearance over its own error is 1.17 (root mean square), at most 2.06; 1.5 is set by hand."""
MIN_TREND_COUNT = 4
"""Fewest recordings of which a trend is tested."""
CONTACT_UNITS = {"clearance_m": "m", "stiffness_n_per_m": "N/m", "damping_n_s_per_m": "N s/m"}
MODAL_UNITS = {"frequency_hz": "Hz", "damping_ratio": "1"}

PerRecording = Float[np.ndarray, " recordings"]


class Observation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One recording: its name, its date if the provenance has one, and its report, or the reason why there is none.

    sha256 is that of the recording, or of the contact.json that was read.
    """

    name: str
    recorded: datetime | None = None
    report: ContactReport | None = None
    reason: str = ""
    sha256: str = ""


class QuantityHistory(msgspec.Struct, frozen=True, kw_only=True):
    """One quantity over the recordings; None where a recording does not determine it.

    standard_errors are of the value alone, own_errors of its differences to other recordings (zero: unknown). mean is
    weighted by the latter. p_different and p_trend are the p-values of the differences and of the trend if nothing
    changed, corrected for the number of tests of the history. drift is the change along the trend from the first
    recording to the last; its standard error includes the share by which rig.json may scale every value.
    """

    of: str
    quantity: str
    unit: str
    values: tuple[float | None, ...]
    standard_errors: tuple[float | None, ...]
    own_errors: tuple[float | None, ...]
    mean: float
    p_different: float | None = None
    p_trend: float | None = None
    drift: Estimate | None = None

    @property
    def largest_change(self) -> tuple[int, int, Estimate] | None:
        """Positions of the first recording that determines it and of the one that differs most from that, and the
        change, with the own errors of both; None with fewer than two."""
        known = [(index, value) for index, value in enumerate(self.values) if value is not None]
        if len(known) < 2:
            return None
        first_index, first = known[0]
        last_index, last = max(known[1:], key=lambda one: abs(one[1] - first))
        error = np.hypot(self.own_errors[first_index] or 0.0, self.own_errors[last_index] or 0.0)
        return first_index, last_index, Estimate(last - first, float(error))

    @property
    def changed(self) -> bool:
        return any(p_value is not None and p_value < SIGNIFICANCE_LEVEL for p_value in (self.p_different, self.p_trend))


class History(msgspec.Struct, frozen=True):
    """Quantities of one machine over its recordings: the structure of history.json."""

    rig: str
    observations: tuple[Observation, ...]
    quantities: tuple[QuantityHistory, ...]

    @property
    def compared(self) -> tuple[Observation, ...]:
        return tuple(observation for observation in self.observations if observation.report is not None)


def history_of(observations: Sequence[Observation]) -> History:
    """History of every quantity over the recordings in their order, tested for changes.

    Raises RigError if fewer than two recordings have a report, or they are of different rigs.
    """
    reports = [observation.report for observation in observations if observation.report is not None]
    if len(reports) < 2:
        reason_text = "".join(f"; {observation.reason}" for observation in observations if observation.reason)
        raise RigError(
            f"{len(reports)} of {len(observations)} recordings can be compared; give two or more{reason_text}"
        )
    rig = reports[0].rig
    for report in reports[1:]:
        if report.rig != rig:
            raise RigError(f"recordings of the rigs {rig!r} and {report.rig!r}; compare those of one machine")
    return History(rig, tuple(observations), holm_corrected([*_contact_histories(reports), *_mode_histories(reports)]))


def _contact_histories(reports: Sequence[ContactReport]) -> list[QuantityHistory]:
    """Histories of the quantities of every contact that any report has."""
    by_recording = [{contact.name: contact for contact in report.contacts} for report in reports]
    contact_names = dict.fromkeys(name for contacts in by_recording for name in contacts)
    return [
        quantity_history(name, field, unit, [getattr(contacts.get(name), field, None) for contacts in by_recording])
        for name in contact_names
        for field, unit in CONTACT_UNITS.items()
    ]


def _mode_histories(reports: Sequence[ContactReport]) -> list[QuantityHistory]:
    """Histories of frequency and damping of the modes that all reports have, without known errors."""
    by_recording = [{f"mode {mode.index} of {mode.beam}": mode for mode in report.modes} for report in reports]
    mode_names = [name for name in by_recording[0] if all(name in modes for modes in by_recording)]
    return [
        quantity_history(name, field, unit, [Estimate(getattr(modes[name], field), 0.0, 0.0) for modes in by_recording])
        for name in mode_names
        for field, unit in MODAL_UNITS.items()
    ]


def quantity_history(of: str, quantity: str, unit: str, estimates: Sequence[Estimate | None]) -> QuantityHistory:
    """History of one quantity, with p-values not yet corrected for the number of tests."""
    estimate_rows = [
        (e.value, e.standard_error, e.standard_error if e.own_error is None else e.own_error)
        for e in (estimate or Estimate(np.nan, np.nan) for estimate in estimates)
    ]
    values, standard_errors, own_errors = np.array(estimate_rows).T
    is_determined = np.isfinite(values) & np.isfinite(own_errors)
    are_errors_known = bool(is_determined.any() and np.all(own_errors[is_determined] > 0))
    weights = np.where(is_determined, 1 / own_errors**2 if are_errors_known else 1.0, 0.0)[is_determined]
    mean = float(np.average(values[is_determined], weights=weights))
    positions = np.flatnonzero(is_determined).astype(float)
    test_results = change_tests(positions, values[is_determined], weights, are_errors_known)
    common_standard_error = float(np.sqrt(max(0.0, np.mean((standard_errors**2 - own_errors**2)[is_determined]))))
    return QuantityHistory(
        of=of,
        quantity=quantity,
        unit=unit,
        values=_finite_or_none(values),
        standard_errors=_finite_or_none(standard_errors),
        own_errors=_finite_or_none(own_errors),
        mean=mean,
        p_different=test_results.p_different,
        p_trend=test_results.p_trend,
        drift=test_results.drift and _with_common_error(test_results.drift, mean, common_standard_error),
    )


def _with_common_error(drift: Estimate, mean: float, common_error: float) -> Estimate:
    """Drift whose standard error includes a relative error that all values have in common."""
    relative_common_error = common_error / abs(mean) if mean else 0.0
    return Estimate(drift.value, float(np.hypot(drift.standard_error, relative_common_error * drift.value)))


def _finite_or_none(values: PerRecording) -> tuple[float | None, ...]:
    """Values of a row, None for those that are not finite."""
    return tuple(value if np.isfinite(value) else None for value in values.tolist())


@dataclass(frozen=True)
class ChangeTests:
    """Uncorrected p-values and drift of one quantity, as in `QuantityHistory`; None where there is no test."""

    p_different: float | None
    p_trend: float | None
    drift: Estimate | None


def change_tests(
    positions: PerRecording, values: PerRecording, weights: PerRecording, errors_known: bool
) -> ChangeTests:
    """Test whether the values x_i differ, and whether they follow a line over the positions t_i.

    With weights w_i = 1 / s_i^2 of known errors s_i, Q = sum of w_i (x_i - mean)^2 / ERROR_INFLATION^2 has a chi-square
    distribution with n - 1 degrees of freedom if nothing changed. The line is fitted by weighted least squares; its
    slope b has the standard error s_b = sqrt(v / sum of w_i (t_i - mean t)^2), where v is the mean square of the
    residuals with n - 2 degrees of freedom, at least 1 with known errors, so that slightly small errors give no trend.
    b / s_b is compared with Student's t. Without known errors only the line is tested.
    """
    n = values.size
    if n < 2:
        return ChangeTests(None, None, None)
    t = positions - np.average(positions, weights=weights)
    x = values - np.average(values, weights=weights)
    p_different = float(chi2.sf(weights @ x**2 / ERROR_INFLATION**2, n - 1)) if errors_known else None
    if n < MIN_TREND_COUNT:
        return ChangeTests(p_different, None, None)
    t_square_sum = weights @ t**2
    slope = float(weights @ (t * x) / t_square_sum)
    residual_mean_square = float(weights @ (x - slope * t) ** 2) / (n - 2)
    slope_error = float(np.sqrt(max(residual_mean_square, 1.0 if errors_known else 0.0) / t_square_sum))
    position_span = float(np.ptp(positions))
    p_trend = float(2 * student_t.sf(abs(slope) / slope_error, n - 2)) if slope_error > 0 else float(slope == 0)
    return ChangeTests(p_different, p_trend, Estimate(slope * position_span, slope_error * position_span))


def holm_corrected(quantities: Sequence[QuantityHistory]) -> tuple[QuantityHistory, ...]:
    """Quantities with p-values corrected for all tests (Holm, "A simple sequentially rejective multiple test
    procedure", 1979)."""
    indexed_p_values = [
        (p_value, index, field)
        for index, quantity in enumerate(quantities)
        for field in ("p_different", "p_trend")
        if (p_value := getattr(quantity, field)) is not None
    ]
    corrected_quantities, adjusted_p = list(quantities), 0.0
    for rank, (p_value, index, field) in enumerate(sorted(indexed_p_values)):
        adjusted_p = max(adjusted_p, min(1.0, (len(indexed_p_values) - rank) * p_value))
        corrected_quantities[index] = msgspec.structs.replace(corrected_quantities[index], **{field: adjusted_p})
    return tuple(corrected_quantities)
