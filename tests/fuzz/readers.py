"""Mutated files given to what answers from them: identify, the viewer, the null reference; and names of all kinds.

Of a recording whose bytes are changed the answer is that of the sound one, or there is none. Of samples or a
description without reason any finite answer is taken, or a sentence.
"""

import json
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import msgspec
import numpy as np
from msgspec.structs import replace

import identify
from identify.gaps.decision.null_reference import NULL_REFERENCE_SUFFIX, NullReference, null_reference_of
from rig.errors import RigError
from rig.lab.exporting import WRITERS, export
from rig.lab.importing import import_file
from rig.model.contact_laws import DeadZone
from rig.model.description import Rig, Station, from_json, to_json
from rig.model.tolerances import LABORATORY, tolerances_named
from rig.recording import Recording, channel_groups, read, writing
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import Sdof
from rig.viewer.gap import read_gap
from rig.viewer.identified import read_identified
from rig.viewer.schematic import draw
from rig.viewer.viewing import write_rrd
from tests.fuzz.judging import refused_or_right
from tests.fuzz.mutate import bytes_changed, text_changed
from tests.fuzz.records import rewritten
from tests.identify.gaps.diagnoses import GAPS, RIGS

MASS = Sdof(frequency_hz=2.0, high_hz=6.0, duration_s=25.0)
ABSURD = (0.0, 1e-300, 1e-12, -1.0, 1e6, 1e150, 1e300)
SIGNS = [
    *"[]/$^_<>&\"'`\\:;,.=#%{}()| aZ0éß中\u202e\u200b\x00\x1b\n\t\ud800",
    "[/]",
    "[bold]",
    "$x^$",
    "time_s",
    ":smile:",
]


@cache
def sound() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "r.mcap"
        ends = {"duration_s": MASS.duration_s, "step_s": MASS.step_s, "path": path, "progress": lambda _: None}
        record(MASS.rig(), MASS.force(), plant=modal.simulate, **ends)
        return path.read_bytes()


@cache
def sound_recording() -> Recording:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "r.mcap"
        path.write_bytes(sound())
        return read(path)


@cache
def sound_answers() -> dict[str, object]:
    """What the sound recording gives."""
    return {name: msgspec.json.encode(answer(sound_recording())) for name, answer in ANSWERS.items()}


def _contact(recording: Recording) -> object:
    return identify.contact(recording).report


def _check(recording: Recording) -> object:
    return identify.check(recording).to_dict()


def _law(recording: Recording) -> object:
    """Its random search is cut short, so that only what does not depend on it is compared."""
    report = identify.law(recording, seconds=1.0).report
    return [u.name for u in report.unanswered], [one.contact for one in report.laws]


def _gap(recording: Recording) -> object:
    """Its first part: the record against the linear model, with all tolerances fitted, of a single null simulation."""
    return null_reference_of(recording, LABORATORY, lambda *_: recording, "modal", simulation_count=1)


ANSWERS: dict[str, Callable[[Recording], object]] = {"contact": _contact, "check": _check, "law": _law, "gap": _gap}
ASKED = {"contact": 0.45, "check": 0.3, "law": 0.1, "gap": 0.15}
"""How often: a law is searched for a second."""


def answer_of_changed_bytes(rng: np.random.Generator, folder: Path) -> str:
    path = folder / "r.mcap"
    path.write_bytes(bytes_changed(rng, sound()))
    name = str(rng.choice(list(ASKED), p=list(ASKED.values())))

    def work() -> None:
        assert msgspec.json.encode(ANSWERS[name](read(path))) == sound_answers()[name]

    return refused_or_right(folder, work)


def answer_of_another_rig(rng: np.random.Generator, folder: Path) -> str:
    """A description that fits the channels, and is wrong."""
    path = folder / "r.mcap"
    path.write_bytes(rewritten(sound(), lambda text: text_changed(rng, text), None))
    return _answered(rng, folder, lambda: read(path))


def answer_of_absurd_samples(rng: np.random.Generator, folder: Path) -> str:
    """Channels that are dead, huge, swapped, full of steps, spikes or noise, or short."""
    whole, path = sound_recording(), folder / "r.mcap"
    rows = {name: signals.values.copy() for name, signals in whole.signals.items()}
    samples = whole.samples
    for _ in range(rng.integers(1, 4)):
        row = rows[list(rows)[rng.integers(len(rows))]][0]
        begin, end = sorted(int(k) for k in rng.integers(samples, size=2))
        part, kind = row[begin : end + 1], rng.integers(7)
        if kind == 0:
            part[:] = rng.choice(ABSURD)
        elif kind == 1:
            with np.errstate(over="ignore"):
                part *= rng.choice(ABSURD)
        elif kind == 2:
            row[begin] = rng.choice(ABSURD) * rng.choice([-1, 1])
        elif kind == 3:
            part[:] = part[::-1]
        elif kind == 4:
            row[:] = rows[list(rows)[rng.integers(len(rows))]][0]
        elif kind == 5:
            row += rng.choice([1e-9, 1.0, 1e6, 1e150]) * rng.standard_normal(samples)
        else:
            row[:] = np.round(row, int(rng.integers(-2, 4)))
    kept = samples if rng.random() < 0.7 else int(rng.choice([1, 2, 3, 10, 100, 1000]))

    def work() -> Recording:
        with writing(path, whole.rig, channel_groups(whole.rig), dict(whole.provenance)) as file:
            for name, values in rows.items():
                file.append(name, values[:, :kept])
        return read(path)

    return _answered(rng, folder, work)


def _answered(rng: np.random.Generator, folder: Path, recording: Callable[[], Recording]) -> str:
    """An answer of finite numbers that survives JSON, or a sentence."""
    name = str(rng.choice(list(ASKED), p=list(ASKED.values())))

    def work() -> None:
        found = recording()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # as the commands do
                said = json.loads(msgspec.json.encode(ANSWERS[name](found)))
        except RigError as error:
            raise RigError(f"{folder}: {error}") from error
        assert name != "contact" or _is_known(said["contacts"]), f"not a number in {said['contacts']}"

    return refused_or_right(folder, work)


def _is_known(value: object) -> bool:
    """JSON writes null for what is not finite."""
    if isinstance(value, dict):
        return all(
            _is_known(each) for key, each in value.items() if key not in ("lower_clearance_m", "upper_clearance_m")
        )
    return all(map(_is_known, value)) if isinstance(value, list) else value is not None


@cache
def contact_json() -> bytes:
    return msgspec.json.format(msgspec.json.encode(_contact(sound_recording())), indent=2)


@cache
def motion_csv() -> bytes:
    """As `identify contact --export csv` writes it."""
    (contact,) = MASS.rig().contacts
    time_s = np.arange(0.0, 5.0, 0.02)
    rows = np.stack([time_s, 1e-3 * np.sin(time_s), 3.0 * np.cos(time_s)], axis=1)
    head = f"time_s,{contact.name} relative displacement m,{contact.name} contact force N"
    return "\n".join([head, *(",".join(map(repr, row)) for row in rows.tolist()), ""]).encode()


def viewed_contact_json(rng: np.random.Generator, folder: Path) -> str:
    """Laws are those that the text says, beside curves of finite numbers; now and then they are drawn."""
    path, drawn, damaged = folder / "contact.json", rng.random() < 0.05, rng.random() < 0.5
    path.write_bytes(contact_json() if damaged else text_changed(rng, contact_json()))
    if damaged:
        (folder / "motion.csv").write_bytes(text_changed(rng, motion_csv()))

    def work() -> None:
        found = read_identified(folder, MASS.rig(), MASS.duration_s)
        said = {c["name"]: c for c in json.loads(path.read_text(errors="replace"))["contacts"]}
        for name, law in found.laws.items():
            assert isinstance(law, DeadZone)
            assert law.stiffness_n_per_m == said[name]["stiffness_n_per_m"]["value"]
        if found.curves is not None:
            assert np.isfinite(found.curves.interpolate(found.curves.time_s)).all()
        if drawn:
            write_rrd(sound_recording(), None, folder / "r.rrd", identified_contacts=found)

    return refused_or_right(folder, work)


def viewed_gap_json(rng: np.random.Generator, folder: Path) -> str:
    """Shares are those that the text says; now and then the diagnosis is drawn."""
    path, drawn = folder / "gap.json", rng.random() < 0.05
    name = str(rng.choice(["one_mass"] if drawn else list(GAPS)))
    path.write_bytes(text_changed(rng, msgspec.json.format(msgspec.json.encode(GAPS[name]), indent=2)))

    def work() -> None:
        found = read_gap(folder, RIGS[name], 61.0)
        said = json.loads(path.read_text(errors="replace"))
        assert [share for *_, share in found.share_spans] == [part["share"] for part in said["attribution"]["time_s"]]
        if drawn:
            write_rrd(sound_recording(), None, folder / "r.rrd", gap=found)

    return refused_or_right(folder, work)


def _simulated(_believed: Rig, _actual: Rig, forces_n: np.ndarray, _seed: int) -> Recording:
    """The sound recording, whatever is asked for: what is tried is the file that keeps the outcome."""
    assert forces_n.shape == sound_recording().forces_n.shape
    return sound_recording()


@cache
def null_reference() -> tuple[bytes, NullReference]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "one.json"
        made = null_reference_of(sound_recording(), LABORATORY, _simulated, "modal", path=path, simulation_count=1)
        return path.read_bytes(), made


def kept_null_reference(rng: np.random.Generator, folder: Path) -> str:
    """What is kept is believed only as it was written; otherwise it is made again."""
    whole, made = null_reference()
    path = folder / ("one" + (NULL_REFERENCE_SUFFIX if rng.random() < 0.5 else ".json"))
    path.write_bytes((text_changed if rng.random() < 0.5 else bytes_changed)(rng, whole))

    def work() -> None:
        found = null_reference_of(sound_recording(), LABORATORY, _simulated, "modal", path=path, simulation_count=1)
        assert found == made

    return refused_or_right(folder, work)


TOLERANCES = b"""frequency = 0.01
damping = 0.3
mass = 0.01
clearance = 0.05
"""


def tolerances_file(rng: np.random.Generator, folder: Path) -> str:
    path = folder / "t.toml"
    path.write_bytes(text_changed(rng, TOLERANCES))
    return refused_or_right(folder, lambda: tolerances_named(str(path)) and None)


def names_of_all_kinds(rng: np.random.Generator, folder: Path) -> str:
    """A rig whose names are refused, or come back from JSON, a drawing, a table and its map."""
    names = ["".join(rng.choice(SIGNS, size=rng.integers(1, 4))) for _ in range(5)]
    if rng.random() < 0.1:
        names[rng.integers(5)] = "y" * int(rng.choice([200, 201, 10_000, 2**20]))
    form, plain = list(WRITERS)[rng.integers(len(WRITERS))], Sdof().rig()

    def work() -> None:
        try:
            rig = _renamed(plain, names)
        except RigError as error:
            raise RigError(f"{folder}: {error}") from error
        assert from_json(to_json(rig), "again") == rig
        path, told = folder / f"t.{form}", folder / "t.toml"
        draw(rig, folder / "t.svg")
        assert names[1] in "".join(ElementTree.parse(folder / "t.svg").getroot().itertext())
        with writing(folder / "r.mcap", rig, channel_groups(rig), {}) as file:
            for number, name in enumerate(channel_groups(rig)):
                file.append(name, np.random.default_rng(number).standard_normal((1, 50)))
        before = read(folder / "r.mcap")
        export(before, form, path, told)
        import_file(path, told, folder / "back.mcap")
        back = read(folder / "back.mcap")
        assert back.rig == rig
        for name, signals in before.signals.items():
            assert back.signals[name].channels.names == signals.channels.names
            assert np.array_equal(back.signals[name].values, signals.values)

    return refused_or_right(folder, work)


def _renamed(rig: Rig, names: list[str]) -> Rig:
    name, body, contact, *sensors = names
    at = Station(body)
    return replace(
        rig,
        name=name,
        bodies=(replace(rig.bodies[0], name=body),),
        contacts=(replace(rig.contacts[0], name=contact, at=at),),
        force_at=at,
        sensors=tuple(replace(s, name=n, station=at) for s, n in zip(rig.sensors, sensors, strict=True)),
    )
