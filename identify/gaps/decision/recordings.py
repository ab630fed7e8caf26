"""Recordings of one rig: sound channels, free decays, and the recording that validates.

Channels that are dead or clipped are named and left out.

Notes for maintainers
1. A force channel of zeros is a free decay if no second is louder than `LEVEL_RISE` times an earlier one (all sensors
   of a quantity together) and the quietest has fallen to `DECAYED_SHARE` of the loudest. Displacements are judged by
   their velocities: slow swings between the stops may grow while the energy falls.
2. Force, mass, spring and contact stiffness have a common factor that a free decay does not show; so have clearances
   and gains. Effects of the force and of channels are no candidates there: a gain of 20 let the motion vanish within
   the clearance, and so explained everything.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.signal import butter, sosfiltfilt

from identify.gaps.residual.extent import diagnosis_sensors, sensor_noise_densities
from identify.gaps.residual.ringing import highest_ringing_hz
from identify.gaps.residual.shaken_base import base_sensor, check_base, with_inertial_force
from rig.errors import RigError
from rig.model.description import Rig, to_json
from rig.recording import Recording, Signals, channel_groups

CLIPPED_SHARE = 1e-3
"""Share of the samples at the largest or smallest value above which a channel is clipped. Set by hand."""
LEVEL_RISE, LEVEL_FLOOR_SHARE = 1.2, 0.03
"""Largest ratio of the level of a second to that of an earlier one in a free decay, whose energy only falls; levels
below this share of the loudest count as that share. Set by hand."""
DECAYED_SHARE = 0.5
"""Largest ratio of the quietest to the loudest second of a free decay. Set by hand."""
MIN_INTERVAL_COUNT = 4
"""Number of intervals of a record shorter than so many seconds, in place of the seconds. Set by hand."""
RINGING_BAND_FACTOR = 1.6
"""Band in which a free decay is judged, as a multiple of the frequency up to which it rings. Set by hand."""
LOWPASS_ORDER = 4
"""Order of the low-pass filter, run forwards and backwards, of that band. Set by hand."""
NO_DECAY_MESSAGE = (
    "the exciting force is zero throughout, and this is no free decay, whose motion only falls; measure the force (of "
    "one mass on a shaking base: minus its mass times the base's acceleration), or let the record begin when the rig "
    "has been released"
)

FITTED_SHARE = 0.55
"""Fitted share of a single record; the rest validates. Set by hand."""


def without_faulty_channels(*recordings: Recording) -> tuple[list[Recording], dict[str, str]]:
    """All recordings without the channels that are dead or clipped in any of them, and those faults; where the base is
    measured, with the inertial force.

    Raises RigError if a recording without a force is no free decay.
    """
    faults: dict[str, str] = {}
    for recording in recordings:
        faults |= sound_recording(recording, excluded_channels=tuple(faults))[1]
    sound_recordings = [with_inertial_force(sound_recording(recording, tuple(faults))[0]) for recording in recordings]
    for recording in sound_recordings:
        if not np.any(recording.forces_n):
            check_free_decay(recording)
    return sound_recordings, faults


def ordered_recordings(
    recordings: Recording | Sequence[Recording], validation: Recording | None
) -> tuple[list[Recording], int]:
    """All recordings in their order, and the index of the one that validates."""
    ordered = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not ordered:
        raise RigError("no recording to diagnose; give one or more of the rig")
    rig = ordered[0].rig
    check_base(rig)
    if validation is None and len(ordered) == 1:
        return list(_fitted_and_validating(ordered[0])), 1
    if validation is not None and not any(validation is recording for recording in ordered):
        ordered.append(validation)
    _check_base_motion(rig)
    for index, recording in enumerate(ordered):
        if to_json(recording.rig) != to_json(rig):
            raise RigError(
                f"recording {index + 1} is of another rig (their rig.json differ); give recordings of one rig"
            )
        if any(_have_same_samples(recording, earlier) for earlier in ordered[:index]):
            raise RigError(f"recording {index + 1} is the same as an earlier one; give each recording once")
    if len(ordered) == 1:
        raise RigError("the only recording cannot validate itself; leave --validate out, or give another recording")
    validating_indices = (index for index, recording in enumerate(ordered) if recording is validation)
    return ordered, next(validating_indices, len(ordered) - 1)


def _check_base_motion(rig: Rig) -> None:
    """Raise RigError if a body is held to a moving base: the null reference describes it by its modes, which cannot
    follow."""
    if not rig.base_motion or rig.base_sensors:
        return
    held_bodies = [body.name for body in rig.bodies if not body.is_mass and body.rigid_modes < 2]
    if held_bodies:
        raise RigError(
            f"rig.json of {rig.name!r} has base_motion, and {held_bodies[0]!r} is held to the base: identify gap knows "
            "how single masses and free bodies follow a base; leave base_motion out of rig.json, and it is looked for"
        )


def _have_same_samples(first: Recording, second: Recording) -> bool:
    return all(
        np.array_equal(signals.values, second.signals[quantity].values) for quantity, signals in first.signals.items()
    )


def _fitted_and_validating(recording: Recording) -> tuple[Recording, Recording]:
    """Two parts of a single record: the fitted one, and the one that validates."""
    cut_sample = round(FITTED_SHARE * recording.samples)
    return cut_recording(recording, slice(0, cut_sample)), cut_recording(recording, slice(cut_sample, None))


def cut_recording(recording: Recording, sample_slice: slice) -> Recording:
    """Slice of the samples of a recording, with time zero at its start."""
    cut_signals = {
        quantity: Signals(signals.channels, 0.0, signals.values[:, sample_slice])
        for quantity, signals in recording.signals.items()
    }
    return Recording(recording.rig, cut_signals, recording.provenance)


def sound_recording(recording: Recording, excluded_channels: tuple[str, ...] = ()) -> tuple[Recording, dict[str, str]]:
    """Recording without its faulty channels and those of `excluded_channels`, and the fault of each of the former.

    Raises RigError if the force channel or the sensor on a shaken base is faulty, or no sensor is left.
    """
    faults: dict[str, str] = {}
    for quantity, signals in recording.signals.items():
        for channel, values in zip(signals.channels.names, signals.values, strict=True):
            fault = channel_fault(values)
            if not fault or (quantity == "force" and not np.any(values)):
                continue
            if quantity == "force":
                raise RigError(f"the force channel is {fault}; the diagnosis needs the force: mend it and record again")
            if recording.rig.base_sensors and channel == base_sensor(recording.rig).name:
                raise RigError(
                    f"sensor {channel!r} on the ground is {fault}; the diagnosis needs the motion of the base: mend it "
                    "and record again"
                )
            if channel not in excluded_channels:
                faults[channel] = fault
    dropped_names = {*faults, *excluded_channels}
    if not dropped_names:
        return recording, faults
    sensors = tuple(sensor for sensor in recording.rig.sensors if sensor.name not in dropped_names)
    if not sensors:
        raise RigError("every channel is dead or clipped; check the sensors' cables and ranges, and record again")
    rig, sound_signals = replace(recording.rig, sensors=sensors), {}
    for quantity, channels in channel_groups(rig).items():
        signals = recording.signals[quantity]
        channel_rows = [signals.channels.names.index(name) for name in channels.names]
        sound_signals[quantity] = Signals(channels, signals.start_s, signals.values[channel_rows])
    return Recording(rig, sound_signals, recording.provenance), faults


def check_free_decay(recording: Recording) -> None:
    """Raise RigError if a record without a force is no free decay, by the level of all sensors of a quantity.

    Displacements are judged by their velocity within the band in which the rig rings, as slow swings between stops may
    grow while the energy falls, and noise does not decay.
    """
    rate_hz, sensors = recording.rig.sample_rate_hz, diagnosis_sensors(recording)
    derivative_order = sensors[0].measures.order
    signals = np.stack([recording.values_of(sensor) for sensor in sensors])
    noise_densities = sensor_noise_densities(recording, sensors, 0)
    highest_hz = RINGING_BAND_FACTOR * highest_ringing_hz(signals, rate_hz, derivative_order, noise_densities)
    signals = _low_passed_motion(signals, rate_hz, derivative_order, highest_hz)
    samples_per_interval = round(min(1.0, recording.duration_s / MIN_INTERVAL_COUNT) * rate_hz)
    interval_count = signals.shape[1] // samples_per_interval
    by_interval = signals[:, : interval_count * samples_per_interval].reshape(len(signals), -1, samples_per_interval)
    interval_rms = np.linalg.norm(by_interval.std(axis=2), axis=0)
    lowest_before = np.maximum(np.minimum.accumulate(interval_rms), LEVEL_FLOOR_SHARE * interval_rms.max())
    if np.any(interval_rms > LEVEL_RISE * lowest_before) or interval_rms.min() > DECAYED_SHARE * interval_rms.max():
        raise RigError(NO_DECAY_MESSAGE)


def _low_passed_motion(
    sensor_signals: Float[np.ndarray, "sensors samples"], rate_hz: float, derivative_order: int, highest_hz: float
) -> Float[np.ndarray, "sensors fewer"]:
    """Derivatives of displacements, or other motion as it is, low-passed at highest_hz.

    The filter is not periodic: a spectrum cut off carries the blow at the beginning into the silence at the end.
    """
    if derivative_order == 0:
        sensor_signals = np.diff(sensor_signals) * rate_hz
    if not 0 < highest_hz < rate_hz / 2:
        return sensor_signals
    return sosfiltfilt(butter(LOWPASS_ORDER, highest_hz, fs=rate_hz, output="sos"), sensor_signals)


def channel_fault(channel_values: Float[np.ndarray, " samples"]) -> str | None:
    """ "dead" if a channel never moves, "clipped" if it stands at its extremes, None if it is sound."""
    lowest, highest = float(channel_values.min()), float(channel_values.max())
    if lowest == highest:
        return "dead"
    extreme_share = max(np.mean(channel_values == highest), np.mean(channel_values == lowest))
    return "clipped" if extreme_share > CLIPPED_SHARE else None
