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
from rig.lab.mode_shapes import mode_shapes, nodes_of
from rig.model.description import to_json
from rig.model.quantities import QUANTITIES
from rig.recording import RIG_NAME, Recording
from rig.recording.channels import Channels

_UFF_KINDS = {quantity.name: quantity.uff_kind for quantity in QUANTITIES.values()} | {"force": 13}
_UFF_TIME = 17
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
    names = [name for signals in recording.signals.values() for name in signals.channels.names]
    table = np.vstack([recording.signals["force"].time_s, *(signals.values for signals in recording.signals.values())])
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow([TIME_COLUMN, *names])
        for first in range(0, table.shape[1], LINES_PER_BLOCK):
            np.savetxt(stream, table[:, first : first + LINES_PER_BLOCK].T, fmt="%.17g", delimiter=",")
            progress(first / table.shape[1])


def _write_uff(recording: Recording, path: Path, _: Progress) -> None:
    """Write UFF: nodes and modes of the bodies, then every channel with its node."""
    with needs_extra("lab", f"{path}: a UFF file"):
        import pyuff

    node_by_station = nodes_of(recording.rig)
    datasets = [*mode_shapes(recording.rig, node_by_station)]
    time_axis = {"abscissa_spacing": 1, "abscissa_spec_data_type": _UFF_TIME, "abscissa_axis_units_lab": "s"}
    form: dict[str, object] = {"type": 58, "binary": 1, "func_type": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0}
    form |= time_axis | {"orddenom_spec_data_type": 0, "x": recording.signals["force"].time_s}
    for group, signals in recording.signals.items():
        channels = signals.channels
        kind = {"ordinate_spec_data_type": _UFF_KINDS[group], "ordinate_axis_units_lab": channels.unit}
        for name, station, samples in zip(channels.names, channels.stations, signals.values, strict=True):
            node = node_by_station.get(station, 0) if station else 0  # 0: on the ground, or without a single place
            datasets.append(form | kind | {"id1": name, "rsp_node": node, "data": samples})
    path.unlink(missing_ok=True)
    try:
        pyuff.UFF(str(path)).write_sets(datasets, mode="add")  # its "overwrite" loses the first binary header
    except Exception as error:  # pyuff's own, which does not tell what the disk said
        if isinstance(error.__context__, OSError):
            raise error.__context__ from error
        raise


def _write_mat(recording: Recording, path: Path, _: Progress) -> None:
    from scipy.io import savemat

    variables: dict[str, object] = {"sample_rate_hz": recording.rig.sample_rate_hz}
    for group, signals in recording.signals.items():
        variables[group] = signals.values.T
        variables[f"{group}_names"] = np.array(signals.channels.names, dtype=object)
    savemat(path, variables, appendmat=False, do_compression=True)


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
    columns = [
        Signal(samples=samples, timestamps=time_s, name=name, unit=signals.channels.unit)
        for signals in recording.signals.values()
        for name, samples in zip(signals.channels.names, signals.values, strict=True)
    ]
    buffer = BytesIO()
    with MDF(version="4.10") as file:
        file.append(columns)
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
FILE_ENDINGS: dict[str, tuple[str, ...]] = {
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
    all_names = (name.strip() for channels in channels_by_group.values() for name in channels.names)
    counts = Counter([TIME_COLUMN, *all_names])
    clock = f"sample_rate_hz = {channels_by_group['force'].sample_rate_hz!r}"
    if file_format == "csv":
        clock = f'time = {{ column = {1 if counts[TIME_COLUMN] > 1 else json.dumps(TIME_COLUMN)}, unit = "s" }}'
    force_entries, sensor_lines = [], []
    column_numbers = itertools.count(2 if file_format == "csv" else 1)
    for group, channels in channels_by_group.items():
        for k, name in enumerate(channels.names, start=1):
            key: str | int = next(column_numbers)
            is_kept = counts[name] == 1 and name.isascii() and len(name) <= MAX_UFF_NAME_LENGTH
            if file_format == "mat":
                key = group if len(channels.names) == 1 else f"{group}[{k}]"
            elif is_kept and name == name.strip():
                key = name
            entry = f"{{ column = {json.dumps(key)}, unit = {json.dumps(channels.unit)} }}"
            if group == "force":
                force_entries.append(entry)
            else:
                sensor_lines.append(f"{json.dumps(name, ensure_ascii=False)} = {entry}")
    force = force_entries[0] if len(force_entries) == 1 else f"[{', '.join(force_entries)}]"
    rig_line = f"rig = {json.dumps(RIG_NAME)}"
    return "\n".join([rig_line, clock, f"force = {force}", "", "[sensors]", *sensor_lines, ""])
