"""One mutated file, what it is given to, and the judgement: the right numbers, or one sentence.

A case returns "right" or "refused". It raises AssertionError for a wrong number or a bad sentence; whatever else it
raises is a fault too.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np

from rig.errors import RigError
from rig.model.contact_laws import DeadZone
from rig.model.description import (
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
from rig.recording import Recording, channel_groups, read, writing
from rig.recording.recovery import recover
from rig.simulation.excitation import BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof
from tests.fuzz.hostile import decimal_marks, deep_keys, hostile_hdf5, hostile_recording
from tests.fuzz.judging import refused_or_right
from tests.fuzz.mutate import bytes_changed, text_changed
from tests.fuzz.readers import (
    answer_of_absurd_samples,
    answer_of_another_rig,
    answer_of_changed_bytes,
    kept_null_reference,
    names_of_all_kinds,
    tolerances_file,
    viewed_contact_json,
    viewed_gap_json,
)
from tests.fuzz.records import records_changed, rewritten
from tests.fuzz.tables import csv_table, hdf5_table, import_map, mat_table, tdms_table, times_of_channels, uff_table

SDOF = Sdof().rig()
SAMPLES = 5000
RATE_HZ = SDOF.sample_rate_hz


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


def recording_made_to_harm(rng: np.random.Generator, folder: Path) -> str:
    return hostile_recording(rng, folder, sound().recording)


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

    outcomes = [refused_or_right(folder, work) for work in (read_it, recover_it)]
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

    return refused_or_right(folder, work)


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


KINDS: dict[str, Callable[[np.random.Generator, Path], str]] = {
    kind.__name__: kind
    for kind in (
        recording_bytes,
        recording_records,
        recording_contents,
        recording_made_to_harm,
        rig_description,
        import_map,
        csv_table,
        times_of_channels,
        uff_table,
        mat_table,
        tdms_table,
        hdf5_table,
        hostile_hdf5,
        deep_keys,
        decimal_marks,
        answer_of_changed_bytes,
        answer_of_another_rig,
        answer_of_absurd_samples,
        viewed_contact_json,
        viewed_gap_json,
        kept_null_reference,
        tolerances_file,
        names_of_all_kinds,
    )
}
SLOW = {answer_of_another_rig: 2, answer_of_absurd_samples: 2, kept_null_reference: 1}
CYCLE = [name for name, kind in KINDS.items() for _ in range(SLOW.get(kind, 3))]
"""The kinds in the order in which the cases take them: what takes up to a second comes less often."""
