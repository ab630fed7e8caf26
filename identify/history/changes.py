"""Tests for changes of a machine's clearances, stiffnesses and modes from recording to recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.stats import chi2, t

from identify.contacts.results import ContactReport, Estimate
from rig.errors import RigError

LEVEL = 0.05
"""The chance that anything at all is said to have changed of a machine that did not."""
SHORT = 1.5
"""Own errors may be so many times too short: of the machines of `tests.campaigns.wear --seed 3` the scatter of a
clearance is 1.17 times (root mean square) what they say, at most 2.06 times; 1.5 is set by hand."""
FEWEST = 4
"""A trend is tested from so many recordings on."""
UNITS = {"clearance_m": "m", "stiffness_n_per_m": "N/m", "damping_n_s_per_m": "N s/m"}
MODAL_UNITS = {"frequency_hz": "Hz", "damping_ratio": "1"}

Row = Float[np.ndarray, " recordings"]


class Observation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One recording: its name, when it was recorded where its provenance says so, what it tells, or why nothing.

    sha256 is that of the recording, or of the contact.json that was read.
    """

    name: str
    recorded: datetime | None = None
    report: ContactReport | None = None
    reason: str = ""
    sha256: str = ""


class QuantityHistory(msgspec.Struct, frozen=True, kw_only=True):
    """One quantity over the recordings; None where a recording does not tell it.

    standard_errors are of the value by itself, own_errors of its differences to other recordings (zero: not known).
    mean is weighted by the latter. p_different is the chance of such differences if nothing changed, p_trend that of
    such a trend; both are corrected for the number of tests of the history. drift is the change along the trend from
    the first recording to the last; its standard error allows for the share by which rig.json may scale every value.
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
    def changed(self) -> bool:
        return any(p is not None and p < LEVEL for p in (self.p_different, self.p_trend))


class History(msgspec.Struct, frozen=True):
    """history.json."""

    rig: str
    observations: tuple[Observation, ...]
    quantities: tuple[QuantityHistory, ...]

    @property
    def used(self) -> tuple[Observation, ...]:
        return tuple(o for o in self.observations if o.report is not None)


def history_of(observations: Sequence[Observation]) -> History:
    """Every quantity over the recordings in their order, tested for a change.

    Raises RigError if fewer than two tell anything, or they are of different rigs.
    """
    reports = [o.report for o in observations if o.report is not None]
    if len(reports) < 2:
        why = "".join(f"; {o.reason}" for o in observations if o.reason)
        raise RigError(f"{len(reports)} of {len(observations)} recordings can be compared; give two or more{why}")
    for other in reports[1:]:
        if other.rig != reports[0].rig:
            raise RigError(f"recordings of the rigs {reports[0].rig!r} and {other.rig!r}; compare those of one machine")
    return History(reports[0].rig, tuple(observations), corrected([*_of_contacts(reports), *_of_modes(reports)]))


def _of_contacts(reports: Sequence[ContactReport]) -> list[QuantityHistory]:
    by_name = [{c.name: c for c in r.contacts} for r in reports]
    names = list(dict.fromkeys(name for each in by_name for name in each))
    return [
        quantity_of(name, field, unit, [getattr(each[name], field) if name in each else None for each in by_name])
        for name in names
        for field, unit in UNITS.items()
    ]


def _of_modes(reports: Sequence[ContactReport]) -> list[QuantityHistory]:
    by_name = [{f"mode {m.index} of {m.beam}": m for m in r.modes} for r in reports]
    names = [name for name in by_name[0] if all(name in each for each in by_name)]
    return [
        quantity_of(name, field, unit, [Estimate(getattr(each[name], field), 0.0, 0.0) for each in by_name])
        for name in names
        for field, unit in MODAL_UNITS.items()
    ]


def quantity_of(of: str, quantity: str, unit: str, estimates: Sequence[Estimate | None]) -> QuantityHistory:
    """The tests of one quantity, not yet corrected for their number."""
    nothing = Estimate(np.nan, np.nan)
    given = [e or nothing for e in estimates]
    values, errors = np.array([(e.value, e.standard_error) for e in given]).T
    own = np.array([e.standard_error if e.own_error is None else e.own_error for e in given])
    told = np.isfinite(values) & np.isfinite(own)
    known = bool(told.any() and np.all(own[told] > 0))
    weights = np.where(told, 1 / own**2 if known else 1.0, 0.0)
    mean = float(np.average(values[told], weights=weights[told]))
    tests = tested(np.flatnonzero(told).astype(float), values[told], weights[told], known)
    return QuantityHistory(
        of=of,
        quantity=quantity,
        unit=unit,
        values=_known(values),
        standard_errors=_known(errors),
        own_errors=_known(own),
        mean=mean,
        p_different=tests.p_different,
        p_trend=tests.p_trend,
        drift=tests.drift and _scaled(tests.drift, mean, float(np.sqrt(max(0.0, np.mean((errors**2 - own**2)[told]))))),
    )


def _scaled(drift: Estimate, mean: float, shared: float) -> Estimate:
    """The drift, which an error that is common to all values makes larger or smaller by its share of the mean."""
    share = shared / abs(mean) if mean else 0.0
    return Estimate(drift.value, float(np.hypot(drift.standard_error, share * drift.value)))


def _known(row: Row) -> tuple[float | None, ...]:
    return tuple(value if np.isfinite(value) else None for value in row.tolist())


@dataclass(frozen=True)
class Tests:
    """Tests of one quantity: see `QuantityHistory`."""

    p_different: float | None
    p_trend: float | None
    drift: Estimate | None


def tested(at: Row, values: Row, weights: Row, known: bool) -> Tests:
    """Are the values x_i equal, and do they follow a line over `at`?

    With weights w_i = 1 / s_i^2 of known errors s_i, Q = sum of w_i (x_i - mean)^2 / SHORT^2 has a chi-square
    distribution with n - 1 degrees of freedom if nothing changed. The line is fitted by weighted least squares; its
    slope b has the standard error s_b = sqrt(v / sum of w_i (t_i - mean t)^2), v being the residuals' mean square with
    n - 2 degrees of freedom, with known errors not less than 1, so that intervals a little too short give no trend.
    b / s_b is compared with Student's t. Without known errors only the line is tested.
    """
    count = values.size
    if count < 2:
        return Tests(None, None, None)
    centred_at, centred = at - np.average(at, weights=weights), values - np.average(values, weights=weights)
    p_different = float(chi2.sf(weights @ centred**2 / SHORT**2, count - 1)) if known else None
    if count < FEWEST:
        return Tests(p_different, None, None)
    size = weights @ centred_at**2
    slope = float(weights @ (centred_at * centred) / size)
    square = float(weights @ (centred - slope * centred_at) ** 2) / (count - 2)
    error = float(np.sqrt(max(square, 1.0 if known else 0.0) / size))
    span = float(np.ptp(at))
    p_trend = float(2 * t.sf(abs(slope) / error, count - 2)) if error > 0 else float(slope == 0)
    return Tests(p_different, p_trend, Estimate(slope * span, error * span))


def corrected(quantities: Sequence[QuantityHistory]) -> tuple[QuantityHistory, ...]:
    """Tests with p-values for all together (Holm, "A simple sequentially rejective multiple test procedure", 1979)."""
    places = [
        (p, i, name)
        for i, q in enumerate(quantities)
        for name in ("p_different", "p_trend")
        if (p := getattr(q, name)) is not None
    ]
    new: list[dict[str, float]] = [{} for _ in quantities]
    least = 0.0
    for rank, (p, i, name) in enumerate(sorted(places)):
        least = max(least, min(1.0, (len(places) - rank) * p))
        new[i][name] = least
    return tuple(msgspec.structs.replace(q, **changes) for q, changes in zip(quantities, new, strict=True))
