"""Mutated tables and import maps: CSV against a plain reading of the same bytes, binary formats where they are cut."""

import csv
import re
import tomllib
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pyuff
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from rig.lab.importing import import_file
from rig.lab.units import si_factor
from rig.model.description import to_json
from rig.recording import Recording, read
from rig.simulation.reference import Sdof
from tests.fuzz.judging import refused_or_right
from tests.fuzz.mutate import bytes_changed, cut, text_changed
from tests.uff_histories import time_history

SDOF = Sdof().rig()
FEW = 200
RATE_HZ = SDOF.sample_rate_hz
X, A = (s.name for s in SDOF.sensors)
MAP = f"""rig = "rig.json"
time = {{ column = "t", unit = "s" }}
force = {{ column = "F", unit = "kN", scale = -2.5 }}
csv = {{ encoding = "utf-8", delimiter = ",", decimal = ".", lines_before_names = 1, lines_after_names = 1 }}
resample = false

[sensors]
{X} = {{ column = 3, unit = "mm" }}
{A} = {{ column = "a", unit = "g" }}
"""


@cache
def table() -> tuple[bytes, dict[str, np.ndarray]]:
    rows = {name: np.random.default_rng(k).standard_normal(FEW) for k, name in enumerate(("force", X, A))}
    time_s = np.arange(FEW) / RATE_HZ
    lines = [",".join(map(repr, row)) for row in np.stack([time_s, *rows.values()], axis=1).tolist()]
    return "\n".join(["run 7", "t,F,x,a", "s,kN,mm,g", *lines, ""]).encode(), rows


def import_map(rng: np.random.Generator, folder: Path) -> str:
    return _judged_csv(folder, table()[0], text_changed(rng, MAP.encode()))


def csv_table(rng: np.random.Generator, folder: Path) -> str:
    change = text_changed if rng.random() < 0.5 else bytes_changed
    return _judged_csv(folder, change(rng, table()[0]), MAP.encode())


def _judged_csv(folder: Path, content: bytes, told: bytes) -> str:
    """Every number is what a plain reading of the table and of the map gives."""

    def check(back: Recording) -> None:
        said = tomllib.loads(told.decode("utf-8"))
        columns = _plainly(content, **said.get("csv", {}))
        entries = {"force": ("force", said["force"])}
        entries |= {s.name: (s.quantity, said["sensors"][s.name]) for s in SDOF.sensors}
        if "history 3" in back.provenance:
            return  # resampled, as asked for
        for name, (quantity, entry) in entries.items():
            column = entry["column"]
            number = column - 1 if isinstance(column, int) else list(columns).index(column)
            values = list(columns.values())[number] * entry.get("scale", 1.0) * si_factor(quantity, entry["unit"])
            (row,) = (
                r for s in back.signals.values() for n, r in zip(s.channels.names, s.values, strict=True) if n == name
            )
            np.testing.assert_allclose(row, values, rtol=1e-14, atol=1e-300)

    return _judged_import(folder, "lab.csv", content, told, check)


def _plainly(
    content: bytes,
    encoding: str = "utf-8-sig",
    delimiter: str = ",",
    decimal: str = ".",
    lines_before_names: int = 0,
    lines_after_names: int = 0,
) -> dict[str, np.ndarray]:
    """A table of numbers below a line of names or above none, cell by cell."""
    lines = re.split(r"\r\n|\r|\n", content.decode(encoding))[lines_before_names:]
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter)]
    try:
        [float(cell.replace(decimal, ".")) for cell in rows[0]]
        names = [f"column {k + 1}" for k in range(len(rows[0]))]
    except ValueError:
        names, rows = rows[0], rows[1:]
    rows = [row for row in rows[lines_after_names:] if any(row)]
    while not any(row[-1] for row in rows):  # last columns may be empty, or have no name
        rows = [row[:-1] for row in rows]
    names = names[: len(rows[0])]
    while not names[-1]:
        names = names[:-1]
    numbers = [[float(c.replace(decimal, ".")) for c in row[: len(names)]] for row in rows]
    return dict(zip(names, np.array(numbers).T, strict=True))


def _judged_import(folder: Path, name: str, content: bytes, told: bytes, check: Callable[[Recording], None]) -> str:
    (folder / "rig.json").write_bytes(to_json(SDOF))
    (folder / name).write_bytes(content)
    (folder / "map.toml").write_bytes(told)

    def work() -> None:
        import_file(folder / name, folder / "map.toml", folder / "r.mcap")
        check(read(folder / "r.mcap"))

    return refused_or_right(folder, work)


def times_of_channels(rng: np.random.Generator, folder: Path) -> str:
    """Channels with a time each: what is imported is of the same instants, whatever the starts, rates and units."""
    first, rate_ratio = rng.integers(0, 60, 2), rng.choice([1.0, 1.0, 1.0, 2.0, 0.5], 2)
    part = float(rng.choice([0.0, 0.0, 0.4]))
    times_s = [
        (begin + part * k + np.arange(FEW) / ratio) / RATE_HZ
        for k, (begin, ratio) in enumerate(zip(first, rate_ratio, strict=True))
    ]
    if rng.random() < 0.2:  # the first record is followed by another
        times_s = [np.concatenate([time_s, time_s]) for time_s in times_s]
    unit, unit_s = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("d", 86400.0))[rng.integers(5)]
    digits = int(rng.integers(8, 17))
    if rng.random() < 0.2:
        times_s = [time_s.astype(np.float32).astype(float) for time_s in times_s]
    columns = [column for time_s in times_s for column in (time_s / unit_s, _signal(time_s))]
    lines = [",".join(f"{value:.{digits}g}" for value in row) for row in zip(*columns, strict=True)]
    if rng.random() < 0.3:
        place, word = int(rng.integers(len(lines))), str(rng.choice(["OVL", "", "9.9E+37", "nan"]))
        lines[place] = lines[place].replace(lines[place].split(",")[1], word, 1)
    told = [
        f"resample = {str(bool(rng.random() < 0.5)).lower()}",
        f'force = {{ column = 2, unit = "N", time = {{ column = 1, unit = "{unit}" }} }}',
        "[sensors]",
        *(
            f'{name} = {{ column = {4 + k}, unit = "{si}", time = {{ column = 3, unit = "{unit}" }} }}'
            for k, (name, si) in enumerate(((X, "m"), (A, "m/s^2")))
        ),
    ]
    lines = [f"{line},{line.split(',')[3]}" for line in lines]
    content = "\n".join(["time 1,F,time 2,x,a", *lines, ""]).encode()

    def check(back: Recording) -> None:
        later_s = max(time_s[0] for time_s in times_s)
        expected = _signal(later_s + np.arange(back.samples) / RATE_HZ)
        inside = slice(40, -40) if back.samples > 100 else slice(0, 0)
        for group in ("force", "displacement", "acceleration"):
            np.testing.assert_allclose(back.signals[group].values[0][inside], expected[inside], atol=2e-2)

    return _judged_import(folder, "lab.csv", content, "\n".join(told).encode(), check)


def _signal(time_s: np.ndarray) -> np.ndarray:
    return np.sin(2 * np.pi * 7.3 * time_s) + np.cos(2 * np.pi * 19.1 * time_s + 0.3)


@cache
def uff(binary: int) -> bytes:
    time_s = np.arange(FEW) / RATE_HZ
    datasets = [time_history(name, time_s, rows, binary=binary) for name, rows in table()[1].items()]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lab.uff"
        pyuff.UFF(str(path)).write_sets(datasets, "add")
        return path.read_bytes()


@cache
def mat(kind: int) -> bytes:
    """Version 5, 7 (compressed) and 7.3 (HDF5)."""
    stream = BytesIO()
    if kind < 2:
        savemat(stream, table()[1] | {"note": "by hand"}, do_compression=bool(kind))
        return stream.getvalue()
    with h5py.File(stream, "w", userblock_size=512) as file:
        for name, row in table()[1].items():
            file.create_dataset(name, data=row[:, None]).attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    return head + stream.getvalue()[len(head) :]


@cache
def tdms(_: int) -> bytes:
    stream = BytesIO()
    with TdmsWriter(stream) as writer:
        for half in (slice(None, FEW // 2), slice(FEW // 2, None)):
            writer.write_segment(
                [ChannelObject("run", n, r[half], {"wf_increment": 1 / RATE_HZ}) for n, r in table()[1].items()]
            )
    return stream.getvalue()


@cache
def hdf5(_: int) -> bytes:
    stream = BytesIO()
    with h5py.File(stream, "w") as file:
        for name, row in table()[1].items():
            file.create_dataset(name, data=row)
    return stream.getvalue()


def uff_table(rng: np.random.Generator, folder: Path) -> str:
    return _judged_binary(rng, folder, "lab.uff", uff(int(rng.integers(2))), "{}", 1e-11)


def mat_table(rng: np.random.Generator, folder: Path) -> str:
    return _judged_binary(rng, folder, "lab.mat", mat(int(rng.integers(3))), "{}", 0.0)


def tdms_table(rng: np.random.Generator, folder: Path) -> str:
    return _judged_binary(rng, folder, "lab.tdms", tdms(0), "run/{}", 0.0)


def hdf5_table(rng: np.random.Generator, folder: Path) -> str:
    return _judged_binary(rng, folder, "lab.h5", hdf5(0), "{}", 0.0)


def _judged_binary(
    rng: np.random.Generator, folder: Path, name: str, content: bytes, column: str, precision: float
) -> str:
    """A table that is cut must be seen to be; other changes may hit a value, which has no checksum in these formats."""
    only_cut = rng.random() < 0.3
    content = cut(rng, content) if only_cut else bytes_changed(rng, content)
    lines = [f"sample_rate_hz = {RATE_HZ}", f'force = {{ column = "{column.format("force")}", unit = "N" }}']
    units = ((X, "m"), (A, "m/s^2"))
    sensors = [f'{n} = {{ column = "{column.format(n)}", unit = "{unit}" }}' for n, unit in units]

    def check(back: Recording) -> None:
        for group, sensor in (("force", "force"), ("displacement", X), ("acceleration", A)):
            rows = back.signals[group].values[0]
            if only_cut:
                np.testing.assert_allclose(rows, table()[1][sensor], rtol=precision, atol=precision)

    return _judged_import(folder, name, content, "\n".join([*lines, "[sensors]", *sensors]).encode(), check)
