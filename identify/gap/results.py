"""What a diagnosis says: the structure of gap.json."""

from typing import Literal

import msgspec

Verdict = Literal["no_gap", "effect", "none_of_these"]


class Value(msgspec.Struct, frozen=True):
    """A fitted parameter of an effect."""

    value: float
    standard_error: float
    unit: str


class Cause(msgspec.Struct, frozen=True):
    """Effects that together explain the gap. parameters and places are named EFFECT.FIELD; left is what remains of the
    gap on the validation record, 1 being what nulls leave."""

    effects: tuple[str, ...]
    probability: float
    parameters: dict[str, Value]
    places: dict[str, str]
    left: float


class Share(msgspec.Struct, frozen=True):
    """A part of the record, and its share of the gap."""

    what: str
    share: float


class Surface(msgspec.Struct, frozen=True):
    """Shares of the gap over relative displacement (rows) and velocity (columns) of a contact; edges of the cells."""

    eta_m: tuple[float, ...]
    rate_m_per_s: tuple[float, ...]
    share: tuple[tuple[float, ...], ...]


class Where(msgspec.Struct, frozen=True, kw_only=True):
    """Each list sums to one. surface is the share by cells of (relative displacement, velocity) of each contact;
    without contacts, of displacement and velocity of each single mass."""

    channels: dict[str, float]
    modal_equations: dict[str, float]
    positions_m: dict[str, dict[str, float]]
    """By body: the station, metres from its left end, and its share."""
    band_hz: tuple[Share, ...]
    contact_state: dict[str, float]
    time_s: tuple[Share, ...]
    surface: dict[str, Surface]
    parts: dict[str, float] = {}
    """Of the linear residual, and of each contact's law."""


class Closure(msgspec.Struct, frozen=True):
    """How far the gap on the validation record shrinks: mean squares of the whitened residual.

    No fraction is given where nothing was corrected, or the gap was at the floor before.
    """

    before: float
    floor: float
    after: float
    closed_fraction: float | None
    interval_95: tuple[float, float] | None


class Likeness(msgspec.Struct, frozen=True):
    """A figure that people know, of the measured record and of simulations with its force: believed and corrected."""

    name: str
    unit: str
    measured: float
    believed: float
    corrected: float


class Curve(msgspec.Struct, frozen=True):
    """A curve of the measured record beside those of simulations: believed and corrected."""

    name: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    measured: tuple[float, ...]
    believed: tuple[float, ...]
    corrected: tuple[float, ...]
    logarithmic: bool = False
    """Whether y is best drawn over decades."""


class Gap(msgspec.Struct, frozen=True, kw_only=True):
    """The diagnosis of a recording. size is the gap's, 1 being what nulls leave; channel_faults names dead and clipped
    channels, which were left out."""

    verdict: Verdict
    sentence: str
    size: float
    causes: tuple[Cause, ...]
    equivalent: tuple[tuple[str, ...], ...]
    separate_by: tuple[str, ...]
    where: Where
    closure: Closure
    likeness: tuple[Likeness, ...] = ()
    curves: tuple[Curve, ...] = ()
    channel_faults: dict[str, str] = {}
