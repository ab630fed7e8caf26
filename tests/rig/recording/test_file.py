"""The file: what goes in comes out, and every way of being bad has its sentence."""

import json
from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from rig.errors import RigError
from rig.model.description import UNITS, Station, to_json
from rig.recording import RECORDED, channel_groups, read, read_truth, truth_groups, truth_path, writing
from rig.recording.messages import decode_block
from rig.recording.writer import CHUNK_S, SAMPLES_AT_ONCE, SAMPLES_PER_BLOCK, start_date_ns
from rig.simulation.reference import BarrelCradle, Sdof
from tests.blocks import encode_block

RIG = Sdof().rig()
PROVENANCE = {"made_by": "a test", "seed": "3"}
FORCE, ACCELERATION = "/rig/force/block", "/rig/acceleration/block"


def samples_of(rig, samples, groups=channel_groups):
    rng = np.random.default_rng(samples)
    return {name: rng.standard_normal((len(g.names), samples)) for name, g in groups(rig).items()}


def write(path, values, rig=RIG, groups=channel_groups, stop=None):
    with writing(path, rig, groups(rig), PROVENANCE) as recording:
        for group, rows in values.items():
            recording.append(group, rows)
        if stop:
            raise stop


def rewrite(path, *, message=lambda _, data: data, channel=lambda _, metadata: metadata, attachment=lambda text: text):
    """Copies the file record by record, each passed through a function that may change it or drop it (None)."""
    with path.open("rb") as source:
        reader = make_reader(source)
        channels = reader.get_summary().channels.values()
        schemas = reader.get_summary().schemas
        messages = list(reader.iter_messages(log_time_order=False))
        (rig_json,) = reader.iter_attachments()
    with path.open("wb") as target:
        writer = Writer(target, compression=CompressionType.NONE)
        writer.start()
        if (text := attachment(rig_json.data)) is not None:
            writer.add_attachment(0, 0, rig_json.name, rig_json.media_type, text)
        numbers = {}
        for old in channels:
            if (metadata := channel(old.topic, dict(old.metadata))) is not None:
                schema = schemas[old.schema_id]
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[old.id] = writer.register_channel(old.topic, old.message_encoding, number, metadata)
        for _, old, m in messages:
            if old.id in numbers and (data := message(old.topic, m.data)) is not None:
                writer.add_message(numbers[old.id], m.log_time, data, m.publish_time, m.sequence)
        writer.finish()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20)
@given(total=st.integers(1, 4000), cuts=st.lists(st.integers(0, 4000), max_size=5))
def test_a_recording_survives_exactly_however_it_is_appended(tmp_path, total, cuts):
    values = samples_of(RIG, total)
    path = tmp_path / "r.mcap"
    edges = sorted({min(c, total) for c in cuts} | {0, total})
    with writing(path, RIG, channel_groups(RIG), PROVENANCE) as recording:
        for first, last in pairwise(edges):
            for group, rows in values.items():
                recording.append(group, rows[:, first:last])
    stored = read(path)
    assert stored.rig == RIG
    assert stored.provenance == PROVENANCE
    assert {name: s.channels for name, s in stored.signals.items()} == channel_groups(RIG)
    for group, rows in values.items():
        np.testing.assert_array_equal(stored.signals[group].values, rows)
        np.testing.assert_allclose(stored.signals[group].time_s, np.arange(total) / RIG.sample_rate_hz)
    np.testing.assert_array_equal(stored.force_n, values["force"][0])
    assert stored.samples == total
    assert stored.duration_s == total / RIG.sample_rate_hz
    assert [p.name for p in tmp_path.iterdir()] == ["r.mcap"]


def test_a_recording_has_as_many_force_channels_as_its_rig_has_forces(tmp_path):
    rig = BarrelCradle(stations=4).rig()
    two_forces = msgspec.structs.replace(rig, force_at=(rig.force_at, Station("cradle", 0.6)))
    values = samples_of(two_forces, 1500)
    write(tmp_path / "r.mcap", values, two_forces)
    recording = read(tmp_path / "r.mcap")
    assert recording.signals["force"].channels.names == ("force_1", "force_2")
    assert recording.signals["force"].channels.stations == two_forces.force_at
    np.testing.assert_array_equal(recording.forces_n, values["force"])
    assert recording.samples == 1500
    with pytest.raises(RigError, match="2 forces at once"):
        _ = recording.force_n
    for believed in (rig, msgspec.structs.replace(two_forces, force_at=two_forces.force_at[::-1])):
        rewrite(tmp_path / "r.mcap", attachment=lambda _, believed=believed: to_json(believed))
        with pytest.raises(RigError, match="group force has the channels"):
            read(tmp_path / "r.mcap")


def test_the_truth_survives_beside_the_recording(tmp_path):
    rig = BarrelCradle(stations=4).rig()
    path = truth_path(tmp_path / "r.mcap")
    assert path.name == "r.truth.mcap"
    values = samples_of(rig, 1500, truth_groups)
    write(path, values, rig, truth_groups)
    truth = read_truth(path)
    for group, rows in values.items():
        np.testing.assert_array_equal(truth.signals[group].values, rows)


def test_channels_say_unit_and_place(tmp_path):
    rig = BarrelCradle(stations=4).rig()
    write(tmp_path / "r.mcap", samples_of(rig, 10), rig)
    with (tmp_path / "r.mcap").open("rb") as content:
        channels = {c.topic: c for c in make_reader(content).get_summary().channels.values()}
    for quantity in ("force", "displacement", "acceleration"):
        metadata = channels[f"/rig/{quantity}/block"].metadata
        assert metadata["unit"] == UNITS[quantity]
        assert json.loads(metadata["sample_rate_hz"]) == rig.sample_rate_hz
    named = dict(zip(json.loads(metadata["names"]), json.loads(metadata["stations"]), strict=True))
    assert named == {
        s.name: {"body": s.station.body, "position_m": s.station.position_m}
        for s in rig.sensors
        if s.quantity == "acceleration"
    }


def test_a_preview_is_the_least_and_largest_of_a_fiftieth_of_a_second_at_its_date(tmp_path):
    rig = msgspec.structs.replace(RIG, sample_rate_hz=1000.0)
    values = samples_of(rig, 1024)
    with writing(tmp_path / "r.mcap", rig, channel_groups(rig), {RECORDED: "2026-03-01T12:00:00Z"}) as recording:
        recording.append_all(values)
    with (tmp_path / "r.mcap").open("rb") as content:
        stored = [*make_reader(content).iter_messages()]
    topics = {channel.topic for _, channel, _ in stored}
    names = {t.rsplit("/", 1)[1] for t in topics if "/preview/" in t}
    assert names == {"force", *(s.name for s in rig.sensors)}
    began = 1772366400 * 10**9
    previews = [
        (m.log_time - began, *np.frombuffer(m.data[-16:], "<f8"))
        for _, channel, m in stored
        if channel.topic == "/rig/force/preview/force"
    ]
    times_ns, least, largest = zip(*previews, strict=True)
    assert list(times_ns) == [round(k * 20e6) for k in range(52)]
    blocks = values["force"][0, :1020].reshape(51, 20)
    np.testing.assert_array_equal(least[:51], blocks.min(axis=1))
    np.testing.assert_array_equal(largest[:51], blocks.max(axis=1))
    assert min(m.log_time for _, _, m in stored) == began
    assert read(tmp_path / "r.mcap").signals["force"].start_s == 0


@pytest.mark.parametrize("date", ["", "yesterday", "0001-01-01", "2026-13-40"])
def test_a_date_that_is_none_is_that_of_no_recording(date):
    assert start_date_ns({RECORDED: date}) == 0


@pytest.mark.parametrize(("rate_hz", "at_once"), [(512.0, 1500), (65536.0, 1500), (512.0, 100_000)])
def test_a_chunk_is_small_so_that_a_kill_loses_little(tmp_path, rate_hz, at_once):
    rig = msgspec.structs.replace(RIG, sample_rate_hz=rate_hz)
    values = samples_of(rig, 100_000)
    with writing(tmp_path / "r.mcap", rig, channel_groups(rig), PROVENANCE) as recording:
        for first in range(0, 100_000, at_once):
            for group, rows in values.items():
                recording.append(group, rows[:, first : first + at_once])
    with (tmp_path / "r.mcap").open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert max(c.chunk_length for c in chunks) <= 2**20
    assert (
        max(c.message_end_time - c.message_start_time for c in chunks) * 1e-9
        < CHUNK_S + (SAMPLES_PER_BLOCK + at_once) / rate_hz
    )
    assert len(chunks) > 2


def test_groups_appended_together_lie_side_by_side(tmp_path):
    values = samples_of(RIG, 50_000)
    with writing(tmp_path / "r.mcap", RIG, channel_groups(RIG), PROVENANCE) as recording:
        recording.append_all(values)
    with (tmp_path / "r.mcap").open("rb") as stream:
        read_in_order = make_reader(stream).iter_messages(log_time_order=False)
        times_s = np.array([m.log_time * 1e-9 for _, channel, m in read_in_order if channel.topic.endswith("block")])
    assert (times_s - np.maximum.accumulate(times_s)).min() >= -SAMPLES_AT_ONCE / RIG.sample_rate_hz
    stored = read(tmp_path / "r.mcap")
    assert all(np.array_equal(stored.signals[group].values, rows) for group, rows in values.items())


def test_an_interrupted_recording_keeps_what_was_recorded(tmp_path):
    path, values = tmp_path / "r.mcap", samples_of(RIG, 1500)
    with pytest.raises(KeyboardInterrupt):
        write(path, values, stop=KeyboardInterrupt)
    np.testing.assert_array_equal(read(path).force_n, values["force"][0])
    assert [p.name for p in tmp_path.iterdir()] == ["r.mcap"]


def test_any_other_error_leaves_nothing_and_keeps_what_was_there(tmp_path):
    path = tmp_path / "r.mcap"
    write(path, samples_of(RIG, 100))
    before = path.read_bytes()
    with pytest.raises(ZeroDivisionError):
        write(path, samples_of(RIG, 5000), stop=ZeroDivisionError)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["r.mcap"]


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    path = tmp_path / "missing" / "r.mcap"
    with pytest.raises(RigError, match=r"r\.mcap: cannot be written \(No such file or directory\)"):
        write(path, samples_of(RIG, 10))


def in_blocks(topic, change, chosen=lambda _: True):
    """Changes or drops (None) the blocks of a topic whose first sample is chosen."""

    def message(name, data):
        if name != topic or not chosen((block := decode_block(data)).first_sample):
            return data
        new = change(block)
        return new and encode_block(new.time_ns, new.first_sample, new.sample_rate_hz, new.values)

    return message


def with_nan(block):
    block = block.with_copied_values()
    block.values[0, 5] = np.nan
    return block


def at_another_rate(block):
    return replace(block, sample_rate_hz=2 * block.sample_rate_hz)


def later(seconds):
    return lambda block: replace(block, time_ns=block.time_ns + seconds * 10**9)


def twice_a_key(text):
    changed = text.replace(b'"frequency_hz": 5.0', b'"frequency_hz": 5.0, "frequency_hz": 50.0', 1)
    assert changed != text
    return changed


TWICE_A_BODY = '[{"body": "mass", "body": "nose", "position_m": 0}]'


def no_block(topic, data):
    return data[:-3] if topic == FORCE else data


def without_topic(topic):
    return lambda name, metadata: None if name == topic else metadata


def with_metadata(topic, **changes):
    return lambda name, metadata: metadata | changes if name == topic else metadata


def believing(**changes):
    return lambda _: to_json(msgspec.structs.replace(RIG, **changes))


RENAMED = msgspec.structs.replace(RIG.sensors[0], name="other")
MORE = msgspec.structs.replace(RIG.sensors[0], name="more")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"message": in_blocks(FORCE, lambda _: None, (1024).__eq__)},
            "group force has samples 1024 to 2048 missing or doubled",
        ),
        ({"message": in_blocks(ACCELERATION, lambda _: None, (2048).__eq__)}, "its groups differ in length"),
        (
            {"message": in_blocks(ACCELERATION, with_nan)},
            "channel 'mass_0000mm_acceleration' is not a finite number at sample 5 (0.0098 s)",
        ),
        ({"message": in_blocks(FORCE, at_another_rate)}, "a block of group force does not fit its channel's metadata"),
        (
            {"message": in_blocks(FORCE, later(3600), (2048).__le__)},
            "group force: sample 2048 is stamped 3604 s where 4 s follows from its number",
        ),
        (
            {"message": in_blocks(ACCELERATION, later(1))},
            "group acceleration: sample 0 is stamped 1 s where 0 s follows",
        ),
        ({"message": no_block}, "is damaged"),
        ({"message": lambda *_: None}, "group force holds no samples"),
        ({"channel": without_topic(FORCE)}, "has no channel /rig/force/block"),
        ({"channel": without_topic(ACCELERATION)}, "sensor 'mass_0000mm_acceleration' of rig.json has no channel"),
        ({"channel": with_metadata(FORCE, names="[")}, "the metadata of channel /rig/force/block cannot be read"),
        ({"channel": with_metadata(FORCE, names='["a", "b"]')}, "2 names (2 different), 1 stations"),
        ({"channel": with_metadata(FORCE, names="[]", stations="[]")}, "0 names (0 different), 0 stations"),
        ({"channel": with_metadata(FORCE, sample_rate_hz="-1")}, "-1 Hz"),
        ({"channel": with_metadata(FORCE, sample_rate_hz="Infinity")}, "inf Hz"),
        ({"channel": with_metadata(FORCE, sample_rate_hz="9" * 400)}, "cannot be read: give names"),
        ({"channel": with_metadata(FORCE, names="[" * 100_000)}, "cannot be read: give names"),
        ({"channel": with_metadata(FORCE, unit="kN")}, "group force holds 'force' in 'kN'; write force in N"),
        ({"channel": with_metadata(ACCELERATION, unit="g")}, "write acceleration in m/s^2"),
        (
            {"channel": with_metadata(ACCELERATION, quantity="velocity")},
            "group acceleration holds 'velocity' in 'm/s^2'",
        ),
        (
            {"channel": with_metadata(FORCE, stations='[{"body": "nose", "position_m": 1}]')},
            "group force has the channels ('force',) at (Station(body='nose'",
        ),
        ({"channel": with_metadata(FORCE, stations=TWICE_A_BODY)}, "the key 'body' is given twice in one object"),
        ({"attachment": twice_a_key}, "rig.json: the key 'frequency_hz' is given twice in one object; give it once"),
        ({"attachment": lambda _: None}, "has no attachment rig.json"),
        ({"attachment": lambda text: text[1:]}, "rig.json: not a rig description"),
        ({"attachment": believing(sample_rate_hz=100.0)}, "is sampled at 512.0 Hz, rig.json says 100.0 Hz"),
        ({"attachment": believing(sensors=(RENAMED, RIG.sensors[1]))}, "is no sensor of rig.json"),
        ({"attachment": believing(sensors=(*RIG.sensors, MORE))}, "sensor 'more' of rig.json has no channel"),
    ],
)
def test_a_recording_that_disagrees_with_itself_is_refused(tmp_path, changes, sentence):
    path = tmp_path / "r.mcap"
    write(path, samples_of(RIG, 2500))
    rewrite(path)
    assert read(path).samples == 2500  # the copy alone changes nothing
    rewrite(path, **changes)
    assert_refused(path, sentence)


def assert_refused(path, sentence):
    with pytest.raises(RigError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def flipped(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda _: b"", "is empty; record it again"),
        (lambda _: b"time,force\n0,1\n", "is no MCAP file"),
        (lambda content: content[:-100], "is cut off or damaged"),
        (lambda content: content[: len(content) // 2], "is cut off or damaged"),
        (lambda content: content[:20], "is cut off or damaged"),
        (flipped, "damaged"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path, damage, sentence):
    path = tmp_path / "r.mcap"
    write(path, samples_of(RIG, 5000))
    path.write_bytes(damage(path.read_bytes()))
    assert_refused(path, sentence)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(st.floats(0, 1, exclude_max=True), st.integers(1, 255))
def test_a_flipped_byte_never_comes_back_as_data(tmp_path, fraction, change):
    path, values = tmp_path / "r.mcap", samples_of(RIG, 1500)
    write(path, values)
    content = bytearray(path.read_bytes())
    content[int(fraction * len(content))] ^= change
    path.write_bytes(content)
    try:
        recording = read(path)
    except RigError:
        return
    assert recording.rig == RIG  # the byte was in what reading does not need
    for group, rows in values.items():
        np.testing.assert_array_equal(recording.signals[group].values, rows)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(RigError, match="cannot be opened"):
        read(tmp_path / "none.mcap")
