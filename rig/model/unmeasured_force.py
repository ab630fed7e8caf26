"""Unmeasured force on a rig, as gap.json has it: written by `identify gap`, drawn by `rig view`."""

from typing import Literal

import msgspec

UnmeasuredForceKind = Literal["force", "pair", "sensor", "distributed", "contact"]
When = Literal["always", "in contact", "growing with time"]
Against = Literal["displacement", "velocity", "velocity squared", "acceleration", "time", "clearance", "none"]


class Value(msgspec.Struct, frozen=True):
    """An estimate with its unit; at_limit is true if it is at an end of the range that was searched.

    instead is a sentence shown in place of a number that the record does not determine.
    """

    value: float
    standard_error: float
    unit: str
    at_limit: bool = False
    instead: str = ""


class MeanForce(msgspec.Struct, frozen=True):
    """The mean of a force, positive against the motion, over displacement (rows) and velocity (columns) at its place.

    Edges of the cells; zero where the motion never was.
    """

    displacement_m: tuple[float, ...]
    velocity_m_per_s: tuple[float, ...]
    force_n: tuple[tuple[float, ...], ...]


class UnmeasuredForce(msgspec.Struct, frozen=True, kw_only=True):
    """An unmeasured force, or a sensor fault, that no effect of the library represents.

    A force acts at `position_m` of `body`, a pair of forces also, opposite, at `against_position_m` of `against_body`;
    a sensor's signal does not follow the motion; a distributed force is a stiffness that changes over the record, by
    `growth` of each body, relative; a contact's clearance swings.
    """

    sentence: str
    kind: UnmeasuredForceKind
    body: str | None = None
    position_m: float | None = None
    position_error_m: float | None = None
    """Its standard error; None on a mass, which has no length."""
    against_body: str | None = None
    against_position_m: float | None = None
    sensor: str | None = None
    contact: str | None = None
    growth: dict[str, Value] = {}
    same_place: bool = True
    """Whether the validation record alone localises it at the same place."""
    frequency_hz: float | None = None
    band_hz: tuple[float, float]
    """Band that holds 90 % of its power."""
    rms_n: float
    """Rms of the force; for a sensor fault in m/s^2."""
    amplitude_n: float | None = None
    when: When = "always"
    before_excitation: float = 0.0
    """Its rms before the measured force begins over that after; 0 without a quiet start."""
    by_time: tuple[float, ...] = ()
    """Its rms in equal parts of the time from the beginning of the measured force on, N."""
    against: Against = "none"
    """Quantity of the motion at its place on which its law depends."""
    law_name: str = ""
    law: str = ""
    """The force against the motion there: w in m, v in m/s; "" if no law was found."""
    law_parameters: dict[str, Value] = {}
    explained: float
    """The share of the linear residual's mean square that it explains on the validation record."""
    over_motion: MeanForce | None = None
    spectrum_hz: tuple[float, ...] = ()
    spectrum: tuple[float, ...] = ()
    """One-sided power density, N^2/Hz; for a sensor fault (m/s^2)^2/Hz."""
