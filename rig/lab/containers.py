"""HDF5, read and written, and MDF 4, written: files of channels with names, units and rates.

MDF is not read: on damaged files its reader (asammdf 8.8) ends the process with a segmentation fault.
"""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from rig.errors import RigError
from rig.extras import needs_extra
from rig.lab.column import Column
from rig.recording import Recording

NAMES, UNITS, RATES = ("name",), ("unit", "units"), ("sample_rate_hz", "fs")
"""Attributes of an HDF5 dataset that say these; a dataset without a name is called by its path."""


def read_hdf5(path: Path, most_bytes: int) -> Iterator[Column]:
    """Every dataset of real numbers; of a matrix every row, or column if there are fewer, as NAME[1], NAME[2], ...

    Raises RigError if h5py is not installed, or the datasets have more than most_bytes in all.
    """
    with needs_extra("lab", f"{path}: an HDF5 file"):
        import h5py
    found: list[Any] = []
    if not h5py.is_hdf5(path):
        raise RigError(f"{path}: cannot be read as HDF5 (its beginning is another); export it again")
    with h5py.File(path, "r", locking=False) as file:
        try:
            file.visititems(lambda _, item: found.append(item) if isinstance(item, h5py.Dataset) else None)
        except RuntimeError:  # of HDF5, in words that tell of anything
            raise RigError(f"{path}: cannot be read as HDF5 (damaged); export it again") from None
        left = most_bytes
        for item in found:
            if item.dtype.kind not in "iuf" or item.ndim not in (1, 2) or item.size < 2:
                continue
            left -= item.nbytes
            if left < 0:
                raise RigError(f"{path}: its data swells beyond measure; store it without compression")
            values = np.atleast_2d(item[()].astype(float))
            rows = values if values.shape[0] <= values.shape[1] else values.T
            name, unit, rate = (_told(item.attrs, names) for names in (NAMES, UNITS, RATES))
            called = str(name or item.name.lstrip("/"))
            for number, row in enumerate(rows, start=1):
                shown = called if len(rows) == 1 else f"{called}[{number}]"
                yield Column(shown, row, unit and str(unit), rate and float(rate))


def _told(attributes: Any, names: tuple[str, ...]) -> Any:
    value = next((attributes[name] for name in names if name in attributes), None)
    return value.decode() if isinstance(value, bytes) else value


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
