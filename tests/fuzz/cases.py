"""One mutated file, what it is given to, and the judgement: the right numbers, or one sentence.

A case returns "right" or "refused". It raises AssertionError for a wrong number or a bad sentence; whatever else it
raises is a fault too.
"""

import csv
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import pyuff
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from rig.contact import DeadZone
from rig.description import (
    BaseMotion,
    Clamp,
    ForceSensor,
    PointMass,
    PointSpring,
    Rig,
    StaticLoad,
    Station,
    from_json,
    to_json,
)
from rig.errors import RigError
from rig.excitation import BandLimitedGaussian
from rig.importing import import_file
from rig.plants import modal
from rig.record import record
from rig.recording import Recording, channel_groups, read, writing
from rig.recovery import recover
from rig.reference import BarrelCradle, Sdof
from rig.units import si_factor
from tests.fuzz.mutate import bytes_changed, cut, text_changed
from tests.fuzz.records import records_changed, rewritten

SDOF = Sdof().rig()
SAMPLES = 5000
FEW = 200
RATE_HZ = SDOF.sample_rate_hz
X, A = (s.name for s in SDOF.sensors)


def _full_barrel() -> Rig:
    """Every field of a rig in use."""
    plain, tip = BarrelCradle(stations=4, noise_density=1e-3, sample_rate_hz=1024.0).rig(), Station("barrel", 1.0)
    first, *others = plain.contacts
    law = DeadZone(
        lower_clearance_m=1e-3,
        upper_clearance_m=2e-3,
        stiffness_n_per_m=1e4,
        damping_n_s_per_m=5.0,
        cubic_n_per_m3=1e8,
        friction_n=0.5,
        wear_m_per_s=1e-6,
    )
    return msgspec.structs.replace(
        plain,
        contacts=(msgspec.structs.replace(first, law=law), *others),
        masses=(PointMass(station=tip, mass_kg=0.1),),
        springs=(PointSpring(station=tip, stiffness_n_per_m=100.0, cubic_n_per_m3=1e5, rotational_n_m_per_rad=1.0),),
        clamps=(Clamp(body="cradle", rotational_n_m_per_rad=1e5),),
        loads=(StaticLoad(station=tip, force_n=1.0),),
        base_motion=BaseMotion(acceleration_rms_m_per_s2=0.1, low_hz=8.0, high_hz=12.0),
        force_sensor=ForceSensor(gain=1.02, lag_s=1e-4),
    )


BARREL = _full_barrel()


@dataclass(frozen=True)
class Sound:
    """The files before they are mutated."""

    recording: bytes
    values: dict[str, np.ndarray]
    provenance: dict[str, str]


@cache
def sound() -> Sound:
    rng = np.random.default_rng(1)
    values = {name: rng.standard_normal((len(g.names), SAMPLES)) for name, g in channel_groups(SDOF).items()}
    provenance = {"made_by": "a test", "asked_duration_s": repr(SAMPLES / RATE_HZ)}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "r.mcap"
        with writing(path, SDOF, channel_groups(SDOF), provenance) as recording:
            for first in range(0, SAMPLES, 1000):
                for name, rows in values.items():
                    recording.append(name, rows[:, first : first + 1000])
        return Sound(path.read_bytes(), values, provenance)


def recording_bytes(rng: np.random.Generator, folder: Path) -> str:
    return _judged_recording(folder, bytes_changed(rng, sound().recording), SDOF)


def recording_records(rng: np.random.Generator, folder: Path) -> str:
    return _judged_recording(folder, records_changed(rng, sound().recording), SDOF)


def recording_contents(rng: np.random.Generator, folder: Path) -> str:
    """Checksums are right, but the description of the rig or of a channel is not."""
    if rng.random() < 0.5:
        return _judged_recording(folder, rewritten(sound().recording, lambda text: text_changed(rng, text), None), None)
    wrong = int(rng.integers(3))  # the channel whose description is changed

    def changed(number: int, metadata: dict[str, str]) -> dict[str, str]:
        if number != wrong:
            return metadata
        key = sorted(metadata)[rng.integers(len(metadata))]
        value = text_changed(rng, metadata[key].encode()).decode(errors="replace")
        return {k: v for k, v in metadata.items() if k != key} | ({key: value} if rng.random() < 0.9 else {})

    return _judged_recording(folder, rewritten(sound().recording, None, changed), SDOF)


def _judged_recording(folder: Path, content: bytes, rig: Rig | None) -> str:
    """Read and recovered; a rig of None is whatever it says it is."""
    path, saved = folder / "bad.mcap", folder / "saved.mcap"
    path.write_bytes(content)

    def read_it() -> None:
        _check_recording(read(path), rig, whole=True)

    def recover_it() -> None:
        losses = recover(path, saved)
        back = read(saved)
        _check_recording(back, rig, whole=False)
        assert all(loss.kept == back.samples for loss in losses)

    outcomes = [_refused_or_right(folder, work) for work in (read_it, recover_it)]
    return "right" if "right" in outcomes else "refused"


def _check_recording(back: Recording, rig: Rig | None, whole: bool) -> None:
    sane = channel_groups(back.rig)
    assert rig is None or back.rig == rig, "another rig"
    assert set(back.signals) == set(sound().values), "other groups"
    for name, rows in sound().values.items():
        assert not whole or back.samples == SAMPLES, f"{back.samples} samples"
        assert np.array_equal(back.signals[name].values, rows[:, : back.samples]), f"other values in {name}"
        about, expected = back.signals[name].channels, sane[name]
        assert (about.quantity, about.unit) == (expected.quantity, expected.unit), f"{name} in {about.unit}"
        assert name == "force" or (about.names, about.stations) == (expected.names, expected.stations)


def simulate(rig: Rig, path: Path) -> None:
    """A short recording."""
    force = BandLimitedGaussian(rms_n=0.5, low_hz=0.0, high_hz=50.0)
    record(rig, force, plant=modal.simulate, duration_s=1.1, step_s=2.0**-12, path=path, progress=lambda _: None)


def rig_description(rng: np.random.Generator, folder: Path) -> str:
    """A mutated rig.json is read, and simulated if it is taken for one."""
    rig = SDOF if rng.random() < 0.4 else BARREL
    text = text_changed(rng, to_json(rig))

    def work() -> None:
        found = from_json(text, str(folder / "rig.json"))
        _check_said(json.loads(text), msgspec.to_builtins(found))
        assert from_json(to_json(found), "again") == found, "does not survive JSON"
        try:
            simulate(found, folder / "r.mcap")
        except RigError as error:
            raise RigError(f"{folder / 'rig.json'}: {error}") from error
        read(folder / "r.mcap")

    return _refused_or_right(folder, work)


def _check_said(said: object, taken: object) -> None:
    """What the text says is what was taken from it."""
    if isinstance(said, dict):
        assert isinstance(taken, dict)
        for key, value in said.items():
            _check_said(value, taken[key])
    elif isinstance(said, list):
        assert isinstance(taken, list | tuple)
        for one, other in zip(said, taken, strict=True):
            _check_said(one, other)
    else:
        assert said == taken, f"{said!r} was taken for {taken!r}"


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
    lines = content.decode(encoding).splitlines()[lines_before_names:]
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter)]
    try:
        [float(cell.replace(decimal, ".")) for cell in rows[0]]
        names = [f"column {k + 1}" for k in range(len(rows[0]))]
    except ValueError:
        names, rows = rows[0], rows[1:]
    numbers = [[float(c.replace(decimal, ".")) for c in row] for row in rows[lines_after_names:] if any(row)]
    return dict(zip(names, np.array(numbers).T, strict=True))


def _judged_import(folder: Path, name: str, content: bytes, told: bytes, check: Callable[[Recording], None]) -> str:
    (folder / "rig.json").write_bytes(to_json(SDOF))
    (folder / name).write_bytes(content)
    (folder / "map.toml").write_bytes(told)

    def work() -> None:
        import_file(folder / name, folder / "map.toml", folder / "r.mcap")
        check(read(folder / "r.mcap"))

    return _refused_or_right(folder, work)


@cache
def uff(binary: int) -> bytes:
    datasets = [
        {
            "type": 58,
            "binary": binary,
            "id1": name,
            "func_type": 1,
            "rsp_node": 1,
            "rsp_dir": 3,
            "ref_node": 0,
            "ref_dir": 0,
            "abscissa_spacing": 1,
            "ordinate_axis_units_lab": "NONE",
            "orddenom_spec_data_type": 0,
            "x": np.arange(FEW) / RATE_HZ,
            "data": rows,
        }
        for name, rows in table()[1].items()
    ]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lab.uff"
        pyuff.UFF(str(path)).write_sets(datasets, "add")
        return path.read_bytes()


@cache
def mat(compressed: int) -> bytes:
    stream = BytesIO()
    savemat(stream, table()[1] | {"note": "by hand"}, do_compression=bool(compressed))
    return stream.getvalue()


@cache
def tdms(_: int) -> bytes:
    stream = BytesIO()
    with TdmsWriter(stream) as writer:
        for half in (slice(None, FEW // 2), slice(FEW // 2, None)):
            writer.write_segment(
                [ChannelObject("run", n, r[half], {"wf_increment": 1 / RATE_HZ}) for n, r in table()[1].items()]
            )
    return stream.getvalue()


def uff_table(rng: np.random.Generator, folder: Path) -> str:
    return _judged_binary(rng, folder, "lab.uff", uff(int(rng.integers(2))), "{}", 1e-11)


def mat_table(rng: np.random.Generator, folder: Path) -> str:
    return _judged_binary(rng, folder, "lab.mat", mat(int(rng.integers(2))), "{}", 0.0)


def tdms_table(rng: np.random.Generator, folder: Path) -> str:
    return _judged_binary(rng, folder, "lab.tdms", tdms(0), "run/{}", 0.0)


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


def _refused_or_right(folder: Path, work: Callable[[], None]) -> str:
    try:
        work()
    except RigError as error:
        sentence = str(error)
        assert sentence.startswith("/"), f"names no file: {sentence[:300]}"
        assert sentence.isprintable(), f"not one printable line: {sentence[:300]!r}"
        assert len(sentence) < 2000, f"a sentence of {len(sentence)} characters: {sentence[:300]}"
        assert "memory" not in sentence, "needs too much memory"
        assert not list(folder.glob("*.part")), f"leaves {list(folder.glob('*.part'))}"
        return "refused"
    return "right"


KINDS: dict[str, Callable[[np.random.Generator, Path], str]] = {
    kind.__name__: kind
    for kind in (
        recording_bytes,
        recording_records,
        recording_contents,
        rig_description,
        import_map,
        csv_table,
        uff_table,
        mat_table,
        tdms_table,
    )
}
