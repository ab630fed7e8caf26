"""Replay of a measured force on a rig: simulated and digitised as a recording in memory.

`modal` and `ancf` are the simulators that the package registers as entry points.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from rig.model.description import Rig
from rig.model.sensing import quantities_of
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.motion import Forces, Motion, Plant, Progress
from rig.simulation.sensors import digitise, plant_run_duration_s


@dataclass(frozen=True)
class _SplineForce:
    """Force at a plant's steps from a spline, computed slice by slice."""

    spline_n: "scipy.interpolate.CubicSpline"
    last_sample_s: float
    step_s: float
    step_count: int

    def __len__(self) -> int:
        return self.step_count

    def __getitem__(self, span: slice) -> Float[np.ndarray, " some"]:
        time_s = np.arange(*span.indices(self.step_count)) * self.step_s
        return np.asarray(self.spline_n(np.minimum(time_s, self.last_sample_s)))


def forces_at_steps(
    forces_n: Float[np.ndarray, "forces samples"], sample_rate_hz: float, step_s: float, step_count: int
) -> Forces:
    """Forces at a plant's steps, by cubic splines through their samples; constant after the last one."""
    sample_count = forces_n.shape[1]
    splines = (scipy.interpolate.CubicSpline(np.arange(sample_count) / sample_rate_hz, samples) for samples in forces_n)
    last_sample_s = (sample_count - 1) / sample_rate_hz
    return Forces(tuple(_SplineForce(spline, last_sample_s, step_s, step_count) for spline in splines))


def replayed_recording(
    believed_rig: Rig,
    actual_rig: Rig,
    force_n: Float[np.ndarray, "*forces samples"],
    plant: Plant,
    step_s: float,
    noise_seed: int,
    progress: Progress = lambda _: None,
) -> Recording:
    """Recording of `actual_rig` under forces given at the sampling rate; it states the nominal rig, `believed_rig`.

    Several forces are rows. Each is interpolated by a cubic to the plant's step and stays at its last value while the
    sensors' filters need it. Raises RigError where the rig cannot be simulated so.
    """
    rate_hz, sample_count, forces_n = believed_rig.sample_rate_hz, force_n.shape[-1], np.atleast_2d(force_n)
    step_count = round(plant_run_duration_s(actual_rig, sample_count / rate_hz) / step_s)
    step_forces = forces_at_steps(forces_n, rate_hz, step_s, step_count)
    with threadpool_limits(1):  # the matrices are small
        motion_blocks = _sensors_only(plant(actual_rig, step_forces, step_s, progress))
        sample_blocks = list(digitise(actual_rig, motion_blocks, np.random.default_rng([noise_seed, 1])))
    channels_by_group = channel_groups(believed_rig)
    signals = {"force": Signals(channels_by_group["force"], 0.0, forces_n)}
    for quantity in quantities_of(believed_rig):
        sensor_values = np.concatenate([block.sensed[quantity] for block in sample_blocks], axis=1)[:, :sample_count]
        signals[quantity] = Signals(channels_by_group[quantity], 0.0, sensor_values)
    return Recording(believed_rig, signals, {"made_by": "replay", "seed": str(noise_seed)})


def modal(believed_rig: Rig, actual_rig: Rig, force_n: Float[np.ndarray, "*forces samples"], seed: int) -> Recording:
    """Replay by the plant `modal`, with 24 modes a beam at 32 kHz or more."""
    from rig.simulation.plants.modal import simulate

    plant = partial(simulate, modes_per_beam=24)
    return replayed_recording(believed_rig, actual_rig, force_n, plant, step_s_of(believed_rig, 2.0**15), seed)


def ancf(believed_rig: Rig, actual_rig: Rig, force_n: Float[np.ndarray, "*forces samples"], seed: int) -> Recording:
    """Replay by the plant `ancf`, with 12 elements a beam at 8 kHz or more."""
    from rig.simulation.plants.ancf import simulate

    plant = partial(simulate, min_element_count=12)
    return replayed_recording(believed_rig, actual_rig, force_n, plant, step_s_of(believed_rig, 2.0**13), seed)


def step_s_of(rig: Rig, min_rate_hz: float) -> float:
    """Time step of a plant, s: its rate is the lowest multiple of the sampling rate not below min_rate_hz."""
    return 1 / (rig.sample_rate_hz * max(1, int(np.ceil(min_rate_hz / rig.sample_rate_hz))))


def _sensors_only(blocks: Iterator[Motion]) -> Iterator[Motion]:
    """Motion without stations and contacts, for consumers of the sensors only: the rest is never computed."""
    for block in blocks:
        no_rows = np.zeros((0, block.forces_n.shape[1]))
        yield replace(block, displacement_m=no_rows, eta_m=no_rows, contact_force_n=no_rows)
