"""HDF5 and MDF 4, written: files of channels with names, units and rates.

MDF is not read: on damaged files its reader (asammdf 8.8) ends the process with a segmentation fault.
"""

from io import BytesIO
from pathlib import Path

from rig.extras import needs_extra
from rig.recording import Recording


def write_hdf5(recording: Recording, path: Path) -> None:
    """A dataset a channel, in their order: channels/0001, ...; with name, unit, sample_rate_hz and group."""
    with needs_extra("lab", f"{path}: an HDF5 file"):
        import h5py
    place = 0
    with h5py.File(path, "w", locking=False) as file:
        for group, signals in recording.signals.items():
            for name, row in zip(signals.channels.names, signals.values, strict=True):
                place += 1
                told = file.create_dataset(f"channels/{place:04d}", data=row).attrs
                told["name"], told["unit"], told["group"] = name, signals.channels.unit, group
                told["sample_rate_hz"] = signals.channels.sample_rate_hz


def write_mdf(recording: Recording, path: Path) -> None:
    """MDF 4.10, all channels in one group over one time."""
    with needs_extra("mdf", f"{path}: an MDF file"):
        from asammdf import MDF, Signal
    time_s = recording.signals["force"].time_s
    channels = [
        Signal(samples=row, timestamps=time_s, name=name, unit=signals.channels.unit)
        for signals in recording.signals.values()
        for name, row in zip(signals.channels.names, signals.values, strict=True)
    ]
    whole = BytesIO()
    with MDF(version="4.10") as file:
        file.append(channels)
        file.save(whole)
    path.write_bytes(whole.getvalue())
