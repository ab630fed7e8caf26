"""What a plant delivers: the true motion of a rig, block by block."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rig.model.description import Rig

Progress = Callable[[float], None]
"""Called with the fraction of the work that is done, 0 to 1."""


@runtime_checkable
class ForceSignal(Protocol):
    """A force over time, had slice by slice; an array is one."""

    def __len__(self) -> int: ...

    def __getitem__(self, now: slice, /) -> Float[np.ndarray, " some"]: ...


@runtime_checkable
class Rows(Protocol):
    """Signals, one a row, computed for the slice that is asked for; an array is one."""

    def __len__(self) -> int: ...

    def __getitem__(self, at: tuple[slice, slice], /) -> Float[np.ndarray, "rows some"]: ...


@dataclass(frozen=True)
class Projected:
    """The rows w(t) = shapes q(t) + carried(t), computed for the slice that is asked for."""

    shapes: Float[np.ndarray, "rows modes"]
    coordinates: Float[np.ndarray, "samples modes"]
    carried: Float[np.ndarray, " samples"] | None = None

    def __len__(self) -> int:
        return len(self.shapes)

    def __getitem__(self, at: tuple[slice, slice], /) -> Float[np.ndarray, "rows some"]:
        rows, now = at
        found = self.shapes[rows] @ self.coordinates[now].T
        return found if self.carried is None else found + self.carried[now]


@dataclass(frozen=True)
class Motion:
    """True motion over a segment of time, sampled at the plant's own step.

    sensed has one row per sensor of the rig, in the sensor's quantity, before any instrument; displacement one row per
    station of `stations_of(rig)`, both in space, also where the base moves; eta (relative displacement) and
    contact_force one row per contact. force is the measured one. A plant may compute displacement and eta on
    demand: ask for a slice, `motion.eta_m[:, ::4]`. After `joined` they are arrays.
    """

    start_s: float
    step_s: float
    force_n: Float[np.ndarray, " samples"]
    sensed: Float[np.ndarray, "sensors samples"]
    displacement_m: Rows
    eta_m: Rows
    contact_force_n: Float[np.ndarray, "contacts samples"]


@runtime_checkable
class Plant(Protocol):
    """How a rig is simulated: from rest, with the measured force given at multiples of the step."""

    def __call__(self, rig: Rig, force_n: ForceSignal, step_s: float, progress: Progress) -> Iterator[Motion]: ...


def joined(blocks: Iterator[Motion]) -> Motion:
    """All blocks of a run as one."""
    parts = list(blocks)
    rows = {
        name: np.concatenate([getattr(part, name)[:, :] for part in parts], axis=1)
        for name in ("sensed", "displacement_m", "eta_m", "contact_force_n")
    }
    force_n = np.concatenate([part.force_n for part in parts])
    return Motion(start_s=parts[0].start_s, step_s=parts[0].step_s, force_n=force_n, **rows)


def sensed_alone(blocks: Iterator[Motion]) -> Iterator[Motion]:
    """The motion without stations and contacts, for consumers of the sensors alone: nothing else is then computed."""
    for block in blocks:
        none = np.zeros((0, block.force_n.size))
        yield replace(block, displacement_m=none, eta_m=none, contact_force_n=none)
