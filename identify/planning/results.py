"""Structure of plan.json: the test, expected intervals, and what each tried change does to them."""

import msgspec

from identify.planning.changes import ChangeKind
from identify.planning.detectable import DetectableEffect
from identify.planning.expectation import ExpectedContact, Undetermined
from rig.limits import SCHEMA_VERSION

ADDS_NOTHING_FACTOR = 1.05
"""Factor by which no interval may grow without a sensor that adds nothing."""
HELPS_FACTOR = 0.9
"""Factor to which the widest interval must shrink for a change to be advised."""


class PlannedForce(msgspec.Struct, frozen=True, kw_only=True):
    """Measured forces of the planned test: rms of each over its excited part, N, and band, Hz."""

    rms_n: tuple[float, ...]
    band_hz: tuple[float, float]


class PlannedBase(msgspec.Struct, frozen=True, kw_only=True):
    """Motion of the base that alone shakes the rig: rms of its acceleration over the excited part, m/s^2, and band,
    Hz."""

    acceleration_rms_m_per_s2: float
    band_hz: tuple[float, float]


class IntervalFactor(msgspec.Struct, frozen=True, kw_only=True):
    """Length of an interval with a change over that without it."""

    contact: str
    quantity: str
    factor: float


class TriedChange(msgspec.Struct, frozen=True, kw_only=True):
    """Change of the test that was simulated and identified.

    widest_share is the widest 95 % interval of a clearance or stiffness, from its middle to its end, over the value;
    widest_factor is its ratio to that of the unchanged test, in the same draws. A contact that is not
    determined counts with a share of 1. largest is the interval of a clearance or stiffness that changes most.
    """

    kind: ChangeKind
    words: str
    widest_share: float
    widest_factor: float
    largest: IntervalFactor | None
    gained: tuple[str, ...] = ()
    """Contacts that are determined with the change alone."""
    lost: tuple[str, ...] = ()
    """Contacts that are determined without the change alone."""
    simulations: int = 1
    largest_growth: float = 1.0
    """Largest factor of all intervals of clearances and stiffnesses."""

    @property
    def helps(self) -> bool:
        return bool(self.gained and not self.lost) or (not self.lost and self.widest_factor <= HELPS_FACTOR)

    @property
    def is_idle_sensor(self) -> bool:
        """True of a sensor without which no interval grows."""
        return self.kind == "leave out sensor" and not self.lost and self.largest_growth <= ADDS_NOTHING_FACTOR


class PlanReport(msgspec.Struct, frozen=True, kw_only=True):
    """Plan of a test. Changes are ranked: those that make most contacts determined, then those that shrink the widest
    interval most."""

    rig: str
    duration_s: float
    force: PlannedForce | None
    """None where the base alone shakes the rig."""
    contacts: tuple[ExpectedContact, ...]
    undetermined: tuple[Undetermined, ...]
    changes: tuple[TriedChange, ...]
    sensors: tuple[TriedChange, ...]
    """Each sensor left out, the most needed first."""
    simulations: int
    """Number of simulated records behind the expected intervals."""
    simulated_s: float
    base: PlannedBase | None = None
    effects: tuple[DetectableEffect, ...] = ()
    """Smallest effects that a diagnosis of such records would name."""
    notes: tuple[str, ...] = ()
    schema_version: int = SCHEMA_VERSION

    @property
    def advice(self) -> tuple[TriedChange, ...]:
        """Changes that help, the best first."""
        return tuple(change for change in self.changes if change.helps)

    @property
    def idle_sensors(self) -> tuple[str, ...]:
        return tuple(change.words for change in self.sensors if change.is_idle_sensor)
