"""Recordings in MCAP: the signals of a rig's sensors with the rig's description, read as a whole or in segments."""

from rig.recording.file import (
    RECORDED,
    Channel,
    Recording,
    Signals,
    channel_groups,
    read,
    read_truth,
    recorded_at,
    recordings_in,
    truth_groups,
    truth_path,
    with_processing_steps,
)
from rig.recording.foreign import RIG_NAME
from rig.recording.planes import plane_recording
from rig.recording.writer import RecordingWriter, writing

__all__ = [
    "RECORDED",
    "RIG_NAME",
    "Channel",
    "Recording",
    "RecordingWriter",
    "Signals",
    "channel_groups",
    "plane_recording",
    "read",
    "read_truth",
    "recorded_at",
    "recordings_in",
    "truth_groups",
    "truth_path",
    "with_processing_steps",
    "writing",
]
