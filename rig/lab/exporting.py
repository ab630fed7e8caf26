"""Export of a recording to the files of other programs, and the map by which `rig import` reads them again."""

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.extras import needs_extra
from rig.files import atomic_write, write_bytes
from rig.lab.mode_shapes import mode_shapes, nodes_of
from rig.model.description import Station, to_json
from rig.model.quantities import QUANTITIES
from rig.recording import RIG_NAME, Recording
from rig.recording.channels import Channels

_UFF_KINDS = {quantity.name: quantity.uff_kind for quantity in QUANTITIES.values()} | {"force": 13}
_UFF_TIME = 17
TIME_COLUMN = "time_s"
MAX_UFF_NAME_LENGTH = 80
LINES_PER_BLOCK = 16384
"""Lines of a table written at once."""


def export(
    recording: Recording,
    file_format: str,
    out: Path,
    map_path: Path | None,
    progress: Callable[[float], None] = lambda _: None,
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


def _channel_rows(recording: Recording) -> Iterator[tuple[str, int, str, Float[np.ndarray, " samples"]]]:
    """Group, number within it, name and samples of every channel."""
    for group, signals in recording.signals.items():
        for channel_number, (channel_name, samples) in enumerate(
            zip(signals.channels.names, signals.values, strict=True), start=1
        ):
            yield group, channel_number, channel_name, samples


def _write_csv(recording: Recording, path: Path, progress: Callable[[float], None]) -> None:
    channel_rows = list(_channel_rows(recording))
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow([TIME_COLUMN, *(name for _, _, name, _ in channel_rows)])
        time_s = recording.signals["force"].time_s
        table = np.stack([time_s, *(samples for _, _, _, samples in channel_rows)], axis=1)
        for first_line in range(0, len(table), LINES_PER_BLOCK):
            np.savetxt(stream, table[first_line : first_line + LINES_PER_BLOCK], fmt="%.17g", delimiter=",")
            progress(first_line / len(table))


def _write_uff(recording: Recording, path: Path, _: Callable[[float], None]) -> None:
    """Write UFF: nodes and modes of the bodies, then every channel with its node."""
    with needs_extra("lab", f"{path}: a UFF file"):
        import pyuff

    time_s = recording.signals["force"].time_s
    node_by_station = nodes_of(recording.rig)

    def node_number(station: Station | None) -> int:
        return node_by_station.get(station, 0) if station else 0  # 0: on the ground, or without a single place

    datasets = [
        *mode_shapes(recording.rig, node_by_station),
        *(
            {
                "type": 58,
                "binary": 1,
                "id1": channel_name,
                "func_type": 1,
                "rsp_node": node_number(recording.signals[group].channels.stations[channel_number - 1]),
                "rsp_dir": 3,
                "ref_node": 0,
                "ref_dir": 0,
                "abscissa_spacing": 1,
                "abscissa_spec_data_type": _UFF_TIME,
                "abscissa_axis_units_lab": "s",
                "ordinate_spec_data_type": _UFF_KINDS[group],
                "ordinate_axis_units_lab": recording.signals[group].channels.unit,
                "orddenom_spec_data_type": 0,
                "x": time_s,
                "data": samples,
            }
            for group, channel_number, channel_name, samples in _channel_rows(recording)
        ),
    ]
    path.unlink(missing_ok=True)
    try:
        pyuff.UFF(str(path)).write_sets(datasets, mode="add")  # its "overwrite" loses the first binary header
    except Exception as error:  # pyuff's own, which does not tell what the disk said
        if isinstance(error.__context__, OSError):
            raise error.__context__ from error
        raise


def _write_mat(recording: Recording, path: Path, _: Callable[[float], None]) -> None:
    from scipy.io import savemat

    variables: dict[str, object] = {"sample_rate_hz": recording.rig.sample_rate_hz}
    for group, signals in recording.signals.items():
        variables[group] = signals.values.T
        variables[f"{group}_names"] = np.array(signals.channels.names, dtype=object)
    savemat(path, variables, appendmat=False, do_compression=True)


def _write_hdf5(recording: Recording, path: Path, _: Callable[[float], None]) -> None:
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


def _write_mdf(recording: Recording, path: Path, _: Callable[[float], None]) -> None:
    """Write MDF 4.10, with all channels in one group over one time.

    MDF is not read: on damaged files its reader (asammdf 8.8) ends the process with a segmentation fault.
    """
    with needs_extra("mdf", f"{path}: an MDF file"):
        from asammdf import MDF, Signal
    time_s = recording.signals["force"].time_s
    mdf_signals = [
        Signal(samples=samples, timestamps=time_s, name=channel_name, unit=signals.channels.unit)
        for signals in recording.signals.values()
        for channel_name, samples in zip(signals.channels.names, signals.values, strict=True)
    ]
    mdf_buffer = BytesIO()
    with MDF(version="4.10") as file:
        file.append(mdf_signals)
        file.save(mdf_buffer)
    path.write_bytes(mdf_buffer.getvalue())


Writer = Callable[[Recording, Path, Callable[[float], None]], None]
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
    map_lines = [f"rig = {json.dumps(RIG_NAME)}"]
    name_counts = Counter(
        [
            TIME_COLUMN,
            *(channel_name.strip() for channels in channels_by_group.values() for channel_name in channels.names),
        ]
    )
    if file_format == "csv":
        map_lines.append(
            'time = { column = 1, unit = "s" }'
            if name_counts[TIME_COLUMN] > 1
            else f'time = {{ column = "{TIME_COLUMN}", unit = "s" }}'
        )
    else:
        map_lines.append(f"sample_rate_hz = {channels_by_group['force'].sample_rate_hz!r}")
    force_entries, sensor_lines = [], []
    column_number = 1 if file_format == "csv" else 0
    for group, channels in channels_by_group.items():
        for channel_number, channel_name in enumerate(channels.names, start=1):
            column_number += 1
            column_key: str | int = column_number
            if file_format == "mat":
                column_key = group if len(channels.names) == 1 else f"{group}[{channel_number}]"
            elif (
                channel_name == channel_name.strip()
                and name_counts[channel_name] == 1
                and channel_name.isascii()
                and len(channel_name) <= MAX_UFF_NAME_LENGTH
            ):
                column_key = channel_name
            entry = f"{{ column = {json.dumps(column_key)}, unit = {json.dumps(channels.unit)} }}"
            if group == "force":
                force_entries.append(entry)
            else:
                sensor_lines.append(f"{json.dumps(channel_name, ensure_ascii=False)} = {entry}")
    force_value = force_entries[0] if len(force_entries) == 1 else f"[{', '.join(force_entries)}]"
    return "\n".join([*map_lines, f"force = {force_value}", "", "[sensors]", *sensor_lines, ""])
