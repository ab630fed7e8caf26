"""Export of a recording to the files of other programs, and the map by which `rig import` reads them again."""

import csv
import itertools
import json
from collections import Counter
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path

import numpy as np

from rig.extras import needs_extra
from rig.files import atomic_write, write_bytes
from rig.lab.mode_shapes import mode_shapes, node_number_by_station
from rig.model.description import to_json
from rig.model.quantities import QUANTITIES
from rig.recording import RIG_NAME, Recording
from rig.recording.channels import Channels

_UFF_KIND_BY_GROUP = {quantity.name: quantity.uff_kind for quantity in QUANTITIES.values()} | {"force": 13}
_UFF_TIME_KIND = 17
TIME_COLUMN = "time_s"
MAX_UFF_NAME_LENGTH = 80
LINES_PER_BLOCK = 16384
"""Lines of a table written at once."""

Progress = Callable[[float], None]


def export(
    recording: Recording, file_format: str, out: Path, map_path: Path | None, progress: Progress = lambda _: None
) -> None:
    """Write every channel in SI, and with `map_path` also the map and rig.json beside it.

    CSV holds 17 digits, all others the doubles themselves, so nothing is lost. Raises RigError if a file
    cannot be written.
    """
    with atomic_write(out) as part_path:
        WRITERS[file_format](recording, part_path, progress)
    if map_path is not None:
        channels_by_group = {name: signals.channels for name, signals in recording.signals.items()}
        write_bytes(import_map(channels_by_group, file_format).encode(), map_path)
        write_bytes(to_json(recording.rig), map_path.with_name(RIG_NAME))


def _write_csv(recording: Recording, path: Path, progress: Progress) -> None:
    channel_names = [name for signals in recording.signals.values() for name in signals.channels.names]
    table = np.vstack([recording.signals["force"].time_s, *(signals.values for signals in recording.signals.values())])
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow([TIME_COLUMN, *channel_names])
        for first_sample in range(0, table.shape[1], LINES_PER_BLOCK):
            np.savetxt(stream, table[:, first_sample : first_sample + LINES_PER_BLOCK].T, fmt="%.17g", delimiter=",")
            progress(first_sample / table.shape[1])


def _write_uff(recording: Recording, path: Path, _: Progress) -> None:
    """Write UFF: nodes and modes of the bodies, then every channel with its node."""
    with needs_extra("lab", f"{path}: a UFF file"):
        import pyuff

    node_by_station = node_number_by_station(recording.rig)
    datasets = [*mode_shapes(recording.rig, node_by_station)]
    time_axis = {"abscissa_spacing": 1, "abscissa_spec_data_type": _UFF_TIME_KIND, "abscissa_axis_units_lab": "s"}
    uff_fields: dict[str, object] = {"type": 58, "binary": 1, "func_type": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0}
    uff_fields |= time_axis | {"orddenom_spec_data_type": 0, "x": recording.signals["force"].time_s}
    for group_name, signals in recording.signals.items():
        channels = signals.channels
        ordinate = {"ordinate_spec_data_type": _UFF_KIND_BY_GROUP[group_name], "ordinate_axis_units_lab": channels.unit}
        for channel_name, station, samples in zip(channels.names, channels.stations, signals.values, strict=True):
            node = node_by_station.get(station, 0) if station else 0  # 0: on the ground, or without a single place
            datasets.append(uff_fields | ordinate | {"id1": channel_name, "rsp_node": node, "data": samples})
    path.unlink(missing_ok=True)
    try:
        pyuff.UFF(str(path)).write_sets(datasets, mode="add")  # its "overwrite" loses the first binary header
    except Exception as error:  # pyuff's own, which does not tell what the disk said
        if isinstance(error.__context__, OSError):
            raise error.__context__ from error
        raise


def _write_mat(recording: Recording, path: Path, _: Progress) -> None:
    from scipy.io import savemat

    variable_by_name: dict[str, object] = {"sample_rate_hz": recording.rig.sample_rate_hz}
    for group_name, signals in recording.signals.items():
        variable_by_name[group_name] = signals.values.T
        variable_by_name[f"{group_name}_names"] = np.array(signals.channels.names, dtype=object)
    savemat(path, variable_by_name, appendmat=False, do_compression=True)


def _write_hdf5(recording: Recording, path: Path, _: Progress) -> None:
    """Write HDF5: a dataset per channel (channels/0001, ...) with attributes name, unit, sample_rate_hz and group."""
    with needs_extra("lab", f"{path}: an HDF5 file"):
        import h5py
    dataset_number = 0
    with h5py.File(path, "w", locking=False) as file:
        for group, signals in recording.signals.items():
            for channel_name, samples in zip(signals.channels.names, signals.values, strict=True):
                dataset_number += 1
                attributes = file.create_dataset(f"channels/{dataset_number:04d}", data=samples).attrs
                attributes["name"], attributes["unit"], attributes["group"] = channel_name, signals.channels.unit, group
                attributes["sample_rate_hz"] = signals.channels.sample_rate_hz


def _write_mdf(recording: Recording, path: Path, _: Progress) -> None:
    """Write MDF 4.10, with all channels in one group over one time.

    MDF is not read: on damaged files its reader (asammdf 8.8) ends the process with a segmentation fault.
    """
    with needs_extra("mdf", f"{path}: an MDF file"):
        from asammdf import MDF, Signal
    time_s = recording.signals["force"].time_s
    mdf_signals = [
        Signal(samples=samples, timestamps=time_s, name=name, unit=signals.channels.unit)
        for signals in recording.signals.values()
        for name, samples in zip(signals.channels.names, signals.values, strict=True)
    ]
    buffer = BytesIO()
    with MDF(version="4.10") as file:
        file.append(mdf_signals)
        file.save(buffer)
    path.write_bytes(buffer.getvalue())


Writer = Callable[[Recording, Path, Progress], None]
WRITERS: dict[str, Writer] = {
    "csv": _write_csv,
    "uff": _write_uff,
    "mat": _write_mat,
    "h5": _write_hdf5,
    "mf4": _write_mdf,
}
FILE_ENDINGS_BY_FORMAT: dict[str, tuple[str, ...]] = {
    "csv": (".csv", ".txt"),
    "uff": (".uff", ".unv"),
    "mat": (".mat",),
    "h5": (".h5", ".hdf5"),
    "mf4": (".mf4",),
}
"""Endings of the files of each format."""


def import_map(channels_by_group: Mapping[str, Channels], file_format: str) -> str:
    """Import map, in TOML, of an exported file with these channels; JSON strings are valid TOML strings.

    A column is named by its number if the format may change its name, or if the name occurs twice.
    """
    channel_names = (name.strip() for channels in channels_by_group.values() for name in channels.names)
    name_counts = Counter([TIME_COLUMN, *channel_names])
    clock = f"sample_rate_hz = {channels_by_group['force'].sample_rate_hz!r}"
    if file_format == "csv":
        clock = f'time = {{ column = {1 if name_counts[TIME_COLUMN] > 1 else json.dumps(TIME_COLUMN)}, unit = "s" }}'
    force_entries, sensor_lines = [], []
    column_numbers = itertools.count(2 if file_format == "csv" else 1)
    for group_name, channels in channels_by_group.items():
        for channel_number, name in enumerate(channels.names, start=1):
            column_key: str | int = next(column_numbers)
            is_name_kept = name_counts[name] == 1 and name.isascii() and len(name) <= MAX_UFF_NAME_LENGTH
            if file_format == "mat":
                column_key = group_name if len(channels.names) == 1 else f"{group_name}[{channel_number}]"
            elif is_name_kept and name == name.strip():
                column_key = name
            entry = f"{{ column = {json.dumps(column_key)}, unit = {json.dumps(channels.unit)} }}"
            if group_name == "force":
                force_entries.append(entry)
            else:
                sensor_lines.append(f"{json.dumps(name, ensure_ascii=False)} = {entry}")
    force_entry = force_entries[0] if len(force_entries) == 1 else f"[{', '.join(force_entries)}]"
    rig_line = f"rig = {json.dumps(RIG_NAME)}"
    return "\n".join([rig_line, clock, f"force = {force_entry}", "", "[sensors]", *sensor_lines, ""])
