"""Motion that a plant delivers: the true one of a rig, block by block."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig

Progress = Callable[[float], None]
"""Called with the fraction of the work that is done, 0 to 1."""


@runtime_checkable
class ForceSignal(Protocol):
    """A force over time, had slice by slice; an array is one, and `Forces` are several."""

    def __len__(self) -> int: ...

    def __getitem__(self, now: slice, /) -> Float[np.ndarray, "*forces some"]: ...


@dataclass(frozen=True)
class Forces:
    """Several forces that act at once, in the order of the rig's; one signal each, all equally long."""

    signals: tuple[ForceSignal, ...]

    def __len__(self) -> int:
        return len(self.signals[0])

    def __getitem__(self, now: slice, /) -> Float[np.ndarray, "forces some"]:
        return np.stack([signal[now] for signal in self.signals])


def forces_of(rig: Rig, force_n: ForceSignal) -> Forces:
    """A force, or several, as those of the rig; raises RigError if it has more or fewer."""
    forces = force_n if isinstance(force_n, Forces) else Forces((force_n,))
    if len(forces.signals) != len(rig.forces):
        raise RigError(f"rig {rig.name!r} is driven by {len(rig.forces)} of force, not {len(forces.signals)}")
    return forces


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
    contact_force one row per contact. forces are the measured ones. A plant may compute displacement and eta on
    demand: ask for a slice, `motion.eta_m[:, ::4]`. After `joined` they are arrays.
    """

    start_s: float
    step_s: float
    forces_n: Float[np.ndarray, "forces samples"]
    sensed: Float[np.ndarray, "sensors samples"]
    displacement_m: Rows
    eta_m: Rows
    contact_force_n: Float[np.ndarray, "contacts samples"]

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Exciting force of a rig with one, N."""
        (only,) = self.forces_n
        return np.asarray(only)


@runtime_checkable
class Plant(Protocol):
    """Plant: simulates a rig from rest, with the measured force given at multiples of the step."""

    def __call__(self, rig: Rig, force_n: ForceSignal, step_s: float, progress: Progress) -> Iterator[Motion]: ...


def joined(blocks: Iterator[Motion]) -> Motion:
    """All blocks of a run as one."""
    parts = list(blocks)
    rows = {
        name: np.concatenate([getattr(part, name)[:, :] for part in parts], axis=1)
        for name in ("forces_n", "sensed", "displacement_m", "eta_m", "contact_force_n")
    }
    return Motion(start_s=parts[0].start_s, step_s=parts[0].step_s, **rows)


def sensed_alone(blocks: Iterator[Motion]) -> Iterator[Motion]:
    """The motion without stations and contacts, for consumers of the sensors alone: nothing else is then computed."""
    for block in blocks:
        none = np.zeros((0, block.forces_n.shape[1]))
        yield replace(block, displacement_m=none, eta_m=none, contact_force_n=none)
