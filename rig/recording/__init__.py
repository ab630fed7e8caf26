"""Recordings in MCAP: what a rig's sensors showed, with the rig's description; read whole, written as they come."""

from rig.recording.file import (
    RIG_NAME,
    Channel,
    Recording,
    RecordingWriter,
    Signals,
    channel_groups,
    read,
    read_truth,
    truth_groups,
    truth_path,
    with_history,
    writing,
)

__all__ = [
    "RIG_NAME",
    "Channel",
    "Recording",
    "RecordingWriter",
    "Signals",
    "channel_groups",
    "read",
    "read_truth",
    "truth_groups",
    "truth_path",
    "with_history",
    "writing",
]
