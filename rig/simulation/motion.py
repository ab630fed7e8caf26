"""True motion of a rig, as a plant delivers it block by block."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig

Progress = Callable[[float], None]
"""Function that receives the fraction done, 0 to 1."""


@runtime_checkable
class ForceSignal(Protocol):
    """A force over time, computed by slices; an array is one, and `Forces` combine several."""

    def __len__(self) -> int: ...

    def __getitem__(self, span: slice, /) -> Float[np.ndarray, "*forces some"]: ...


@dataclass(frozen=True)
class Forces:
    """Simultaneous forces in the order of the rig's, one signal each, all of equal length."""

    signals: tuple[ForceSignal, ...]

    def __len__(self) -> int:
        return len(self.signals[0])

    def __getitem__(self, span: slice, /) -> Float[np.ndarray, "forces some"]:
        return np.stack([signal[span] for signal in self.signals])


def forces_of(rig: Rig, force_n: ForceSignal) -> Forces:
    """One or several forces as `Forces`; raises RigError if their number is not that of the rig."""
    forces = force_n if isinstance(force_n, Forces) else Forces((force_n,))
    if len(forces.signals) != len(rig.forces):
        raise RigError(f"rig {rig.name!r} is driven by {len(rig.forces)} of force, not {len(forces.signals)}")
    return forces


@runtime_checkable
class SignalRows(Protocol):
    """Signals by row, computed for the requested slice; an array implements this protocol."""

    def __len__(self) -> int: ...

    def __getitem__(self, row_and_sample_slices: tuple[slice, slice], /) -> Float[np.ndarray, "rows some"]: ...


@dataclass(frozen=True)
class ProjectedSignals:
    """Rows w(t) = shapes q(t) + base(t), computed for the requested slice."""

    shapes: Float[np.ndarray, "rows modes"]
    modal_coordinates: Float[np.ndarray, "samples modes"]
    base_m: Float[np.ndarray, " samples"] | None = None

    def __len__(self) -> int:
        return len(self.shapes)

    def __getitem__(self, row_and_sample_slices: tuple[slice, slice], /) -> Float[np.ndarray, "rows some"]:
        row_slice, sample_slice = row_and_sample_slices
        projected = self.shapes[row_slice] @ self.modal_coordinates[sample_slice].T
        return projected if self.base_m is None else projected + self.base_m[sample_slice]


@dataclass(frozen=True)
class Motion:
    """True motion over a segment of time, sampled at the plant's own step.

    sensed has one row per sensor of the rig, in the sensor's quantity, before any instrument; displacement one row per
    station of `rig_stations(rig)`, both in space, also where the base moves; eta (relative displacement)
    and contact_force one row per contact. forces are the measured ones. A plant may compute displacement and eta on
    demand: ask for a slice, `motion.eta_m[:, ::4]`. After `concatenated` they are arrays.
    """

    start_s: float
    step_s: float
    forces_n: Float[np.ndarray, "forces samples"]
    sensed: Float[np.ndarray, "sensors samples"]
    displacement_m: SignalRows
    eta_m: SignalRows
    contact_force_n: Float[np.ndarray, "contacts samples"]

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Force of a rig with a single force, N."""
        (single_force_n,) = self.forces_n
        return np.asarray(single_force_n)


@runtime_checkable
class Plant(Protocol):
    """Simulator of a rig from rest, with the measured force given at multiples of the step."""

    def __call__(self, rig: Rig, force_n: ForceSignal, step_s: float, progress: Progress) -> Iterator[Motion]: ...


def concatenated(blocks: Iterator[Motion]) -> Motion:
    """Blocks of a run as one."""
    motion_segments = list(blocks)
    signals_by_name = {
        signal_name: np.concatenate([getattr(segment, signal_name)[:, :] for segment in motion_segments], axis=1)
        for signal_name in ("forces_n", "sensed", "displacement_m", "eta_m", "contact_force_n")
    }
    return Motion(start_s=motion_segments[0].start_s, step_s=motion_segments[0].step_s, **signals_by_name)
