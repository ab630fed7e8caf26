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

_UFF_KINDS = {q.name: q.uff_kind for q in QUANTITIES.values()} | {"force": 13}
_UFF_TIME = 17
TIME_COLUMN = "time_s"
MAX_UFF_NAME = 80
LINES_AT_ONCE = 16384
"""Lines of a table written at once."""


def export(
    recording: Recording,
    form: str,
    out: Path,
    map_path: Path | None,
    progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write every channel in SI, and with `map_path` also the map and rig.json beside it.

    CSV holds 17 digits, all others the doubles themselves, so nothing is lost. Raises RigError if a file
    cannot be written.
    """
    with atomic_write(out) as part_path:
        WRITERS[form](recording, part_path, progress)
    if map_path is not None:
        groups = {name: signals.channels for name, signals in recording.signals.items()}
        write_bytes(import_map(groups, form).encode(), map_path)
        write_bytes(to_json(recording.rig), map_path.with_name(RIG_NAME))


def _rows(recording: Recording) -> Iterator[tuple[str, int, str, Float[np.ndarray, " samples"]]]:
    """Group, number within it, name and samples of every channel."""
    for group, signals in recording.signals.items():
        for number, (name, row) in enumerate(zip(signals.channels.names, signals.values, strict=True), start=1):
            yield group, number, name, row


def _write_csv(recording: Recording, path: Path, progress: Callable[[float], None]) -> None:
    rows = list(_rows(recording))
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow([TIME_COLUMN, *(name for _, _, name, _ in rows)])
        time_s = recording.signals["force"].time_s
        table = np.stack([time_s, *(row for _, _, _, row in rows)], axis=1)
        for first in range(0, len(table), LINES_AT_ONCE):
            np.savetxt(stream, table[first : first + LINES_AT_ONCE], fmt="%.17g", delimiter=",")
            progress(first / len(table))


def _write_uff(recording: Recording, path: Path, _: Callable[[float], None]) -> None:
    """Write UFF: nodes and modes of the bodies, then every channel with its node."""
    with needs_extra("lab", f"{path}: a UFF file"):
        import pyuff

    time_s = recording.signals["force"].time_s
    nodes = nodes_of(recording.rig)

    def node(station: Station | None) -> int:
        return nodes.get(station, 0) if station else 0  # 0: on the ground, or without a single place

    datasets = [
        *mode_shapes(recording.rig, nodes),
        *(
            {
                "type": 58,
                "binary": 1,
                "id1": name,
                "func_type": 1,
                "rsp_node": node(recording.signals[group].channels.stations[number - 1]),
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
                "data": row,
            }
            for group, number, name, row in _rows(recording)
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
    number = 0
    with h5py.File(path, "w", locking=False) as file:
        for group, signals in recording.signals.items():
            for name, row in zip(signals.channels.names, signals.values, strict=True):
                number += 1
                attributes = file.create_dataset(f"channels/{number:04d}", data=row).attrs
                attributes["name"], attributes["unit"], attributes["group"] = name, signals.channels.unit, group
                attributes["sample_rate_hz"] = signals.channels.sample_rate_hz


def _write_mdf(recording: Recording, path: Path, _: Callable[[float], None]) -> None:
    """Write MDF 4.10, with all channels in one group over one time.

    MDF is not read: on damaged files its reader (asammdf 8.8) ends the process with a segmentation fault.
    """
    with needs_extra("mdf", f"{path}: an MDF file"):
        from asammdf import MDF, Signal
    time_s = recording.signals["force"].time_s
    channels = [
        Signal(samples=row, timestamps=time_s, name=name, unit=signals.channels.unit)
        for signals in recording.signals.values()
        for name, row in zip(signals.channels.names, signals.values, strict=True)
    ]
    buffer = BytesIO()
    with MDF(version="4.10") as file:
        file.append(channels)
        file.save(buffer)
    path.write_bytes(buffer.getvalue())


Writer = Callable[[Recording, Path, Callable[[float], None]], None]
WRITERS: dict[str, Writer] = {
    "csv": _write_csv,
    "uff": _write_uff,
    "mat": _write_mat,
    "h5": _write_hdf5,
    "mf4": _write_mdf,
}
ENDINGS: dict[str, tuple[str, ...]] = {
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
    lines = [f"rig = {json.dumps(RIG_NAME)}"]
    times = Counter(
        [TIME_COLUMN, *(name.strip() for channels in channels_by_group.values() for name in channels.names)]
    )
    if file_format == "csv":
        lines.append(
            'time = { column = 1, unit = "s" }'
            if times[TIME_COLUMN] > 1
            else f'time = {{ column = "{TIME_COLUMN}", unit = "s" }}'
        )
    else:
        lines.append(f"sample_rate_hz = {channels_by_group['force'].sample_rate_hz!r}")
    forces, sensors = [], []
    column_number = 1 if file_format == "csv" else 0
    for group, channels in channels_by_group.items():
        for number, name in enumerate(channels.names, start=1):
            column_number += 1
            column: str | int = column_number
            if file_format == "mat":
                column = group if len(channels.names) == 1 else f"{group}[{number}]"
            elif name == name.strip() and times[name] == 1 and name.isascii() and len(name) <= MAX_UFF_NAME:
                column = name
            entry = f"{{ column = {json.dumps(column)}, unit = {json.dumps(channels.unit)} }}"
            if group == "force":
                forces.append(entry)
            else:
                sensors.append(f"{json.dumps(name, ensure_ascii=False)} = {entry}")
    force = forces[0] if len(forces) == 1 else f"[{', '.join(forces)}]"
    return "\n".join([*lines, f"force = {force}", "", "[sensors]", *sensors, ""])
