"""A time belongs to a channel: what files say of starts, rates and clocks reaches the recording, or one sentence."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from rig.errors import RigError
from rig.lab.importing import import_file
from rig.lab.looking import proposed_import_map
from rig.model.description import to_json
from rig.recording import read
from rig.simulation.reference import Sdof

RATE_HZ = 512.0
SAMPLES = 1500
(A,) = (sensor.name for sensor in Sdof(sensors="acceleration").rig().sensors)
TIME_S = np.arange(-400, 2 * SAMPLES) / RATE_HZ


def motion(time_s):
    """Force, N, and acceleration, m/s^2: continuous signals, low in band, that never repeat."""
    force = np.sin(2 * np.pi * 11.3 * time_s) + 0.5 * np.sin(2 * np.pi * 31.7 * time_s + 1.0)
    return force, 3 * np.cos(2 * np.pi * 17.9 * time_s) + np.sin(2 * np.pi * 5.3 * time_s)


def folder_with(tmp_path, rate_hz=RATE_HZ):
    (tmp_path / "rig.json").write_bytes(to_json(Sdof(sensors="acceleration", sample_rate_hz=rate_hz).rig()))
    return tmp_path


def looked_at(folder, name, changes=()):
    """Proposed map with what its owner changes, the recording that it imports, and all that was said."""
    rig = Sdof(sensors="acceleration", sample_rate_hz=rate_of(folder)).rig()
    proposal = proposed_import_map(folder / name, rig)
    text = proposal.text
    for old, new in dict(changes).items():
        assert old in text
        text = text.replace(old, new)
    (folder / "map.toml").write_text(text)
    steps = import_file(folder / name, folder / "map.toml", folder / "r.mcap")
    return text, read(folder / "r.mcap"), " ".join(steps)


def rate_of(folder):
    from rig.model.description import read_rig

    return read_rig(folder / "rig.json").sample_rate_hz


def table_text(names, *columns, delimiter=",", formats="%.9g"):
    """Lines of columns of any length, empty behind their ends."""
    longest = max(map(len, columns))
    cells = [[formats % v if not isinstance(v, str) else v for v in c] + [""] * (longest - len(c)) for c in columns]
    return "\n".join([delimiter.join(names), *map(delimiter.join, zip(*cells, strict=True)), ""])


def check_motion(recording, start_s, atol=1e-5, inside=slice(None)):
    """Force and acceleration are those of the same instants, from start_s on."""
    time_s = start_s + np.arange(recording.samples) / recording.rig.sample_rate_hz
    force, acceleration = motion(time_s)
    np.testing.assert_allclose(recording.force_n[inside], force[inside], atol=atol)
    np.testing.assert_allclose(recording.signals["acceleration"].values[0][inside], acceleration[inside], atol=atol)


def raster(first, count, rate_hz=RATE_HZ):
    time_s = first / RATE_HZ + np.arange(count) / rate_hz
    return time_s, *motion(time_s)


def h5_groups(path, force_raster, acc_raster):
    with h5py.File(path, "w") as file:
        for group, name, unit, k, (time_s, *values) in (
            ("slow", "force", "N", 0, force_raster),
            ("fast", A, "m/s^2", 1, acc_raster),
        ):
            file[f"{group}/time"] = time_s
            file[f"{group}/time"].attrs["unit"] = "s"
            file[f"{group}/{name}"] = values[k]
            file[f"{group}/{name}"].attrs["unit"] = unit
            file[f"{group}/{name}"].attrs["name"] = f"{group}/{name}"


def mat_structs(path, force_raster, acc_raster):
    savemat(path, {"F": {"t": force_raster[0], "force": force_raster[1]}, "B": {"t": acc_raster[0], A: acc_raster[2]}})


def csv_pairs(path, force_raster, acc_raster):
    names = ["Time 1 [s]", "force [N]", "Time 2 [s]", f"{A} [m/s^2]"]
    path.write_text(table_text(names, *force_raster[:2], acc_raster[0], acc_raster[2], formats="%.12g"))


def lvm_multi(path, force_raster, acc_raster):
    """X columns that begin at zero each; the header states when the channels began."""
    starts = [raster_[0][0] for raster_ in (force_raster, acc_raster)]
    times = "\t\t".join(f"12:00:{10 + start:022.19f}" for start in starts)
    head = [
        "LabVIEW Measurement",
        "X_Columns\tMulti",
        "***End_of_Header***",
        "",
        "Channels\t2",
        f"Samples\t{len(force_raster[0])}\t\t{len(acc_raster[0])}",
        "Date\t2024/03/01\t\t2024/03/01",
        f"Time\t{times}",
        "Y_Unit_Label\tN\t\tm/s^2",
        "X0\t0.0E+0\t\t0.0E+0",
        "Delta_X\t" + "\t\t".join(f"{r[0][1] - r[0][0]:.9g}" for r in (force_raster, acc_raster)),
        "***End_of_Header***",
    ]
    columns = [force_raster[0] - starts[0], force_raster[1], acc_raster[0] - starts[1], acc_raster[2]]
    body = table_text(["X_Value", "force", "X_Value", A, "Comment"], *columns, delimiter="\t", formats="%.12g")
    path.write_text("\r\n".join(head) + "\r\n" + body.replace("\n", "\r\n"), newline="")


WRITERS = {"h5": h5_groups, "mat": mat_structs, "csv": csv_pairs, "lvm": lvm_multi}
OWNER = {
    "mat": {
        f'{{ column = "B.{A}", unit = "?"': f'{{ column = "B.{A}", unit = "m/s^2"',
        'force = { column = "F.force", unit = "?"': 'force = { column = "F.force", unit = "N"',
    },
    "lvm": {},
}


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize(("force_first", "acc_first"), [(128, 0), (0, 77), (5, 5)])
def test_channels_that_begin_apart_are_cut_to_their_common_time(tmp_path, form, force_first, acc_first):
    folder, name = folder_with(tmp_path), f"run.{form}"
    WRITERS[form](folder / name, raster(force_first, SAMPLES), raster(acc_first, SAMPLES))
    _, recording, said = looked_at(folder, name, owner_changes(folder, name, form))
    later = max(force_first, acc_first)
    assert recording.samples == SAMPLES - abs(force_first - acc_first)
    check_motion(recording, later / RATE_HZ)
    assert ("cut to the time that all share" in said) == (force_first != acc_first)


def owner_changes(folder, name, form):
    text = proposed_import_map(folder / name, Sdof(sensors="acceleration", sample_rate_hz=rate_of(folder)).rig()).text
    return {old: new for old, new in OWNER.get(form, {}).items() if old in text}


@pytest.mark.parametrize("form", WRITERS)
def test_channels_a_part_of_a_sample_apart_are_refused_or_resampled(tmp_path, form):
    folder, name = folder_with(tmp_path), f"run.{form}"
    WRITERS[form](folder / name, raster(60.4, SAMPLES), raster(0, SAMPLES))
    changes = owner_changes(folder, name, form)
    with pytest.raises(RigError, match=r"is sampled at 512 Hz from .* and .* set resample = true") as caught:
        looked_at(folder, name, changes | {"resample = true": "resample = false"})
    assert "\n" not in str(caught.value)
    _, recording, said = looked_at(folder, name, changes)
    check_motion(recording, 60.4 / RATE_HZ, atol=4e-3, inside=slice(40, -40))
    assert "by a windowed sinc, right within 1e-3" in said


@pytest.mark.parametrize("form", WRITERS)
def test_of_two_rates_each_has_its_own_time(tmp_path, form):
    """The acceleration has half the rate: nothing is known of it at 512 Hz, and both are brought to 256 Hz."""
    folder, name = folder_with(tmp_path), f"run.{form}"
    WRITERS[form](folder / name, raster(0, SAMPLES), raster(0, SAMPLES // 2, RATE_HZ / 2))
    changes = owner_changes(folder, name, form)
    with pytest.raises(RigError, match=r"512 Hz .* 256 Hz .* above 128 Hz, and sample_rate_hz of the rig is 512"):
        looked_at(folder, name, changes)
    folder_with(tmp_path, RATE_HZ / 2)
    _, recording, said = looked_at(folder, name, changes)
    assert recording.samples == SAMPLES // 2
    check_motion(recording, 0.0, atol=5e-3, inside=slice(20, -20))
    assert "flat within 1e-3 up to 94.72 Hz" in said


@pytest.mark.parametrize("mark", ["", "NaN"])
def test_a_channel_in_every_second_line_is_one_of_half_the_rate(tmp_path, mark):
    folder = folder_with(tmp_path, RATE_HZ / 2)
    time_s, force, acceleration = raster(0, SAMPLES)
    cells = [f"{a:.9g}" if k % 2 == 0 else mark for k, a in enumerate(acceleration)]
    (folder / "run.csv").write_text(table_text(["t [s]", "force [N]", f"{A} [m/s^2]"], time_s, force, cells))
    text, recording, _ = looked_at(folder, "run.csv")
    assert "is sampled at 256 Hz" in text
    check_motion(recording, 0.0, atol=5e-3, inside=slice(20, -20))


def test_a_slower_channel_among_others_is_left_out(tmp_path):
    folder = folder_with(tmp_path)
    time_s, force, acceleration = raster(0, SAMPLES)
    cells = [f"{a:.9g}" if k % 5 == 0 else "" for k, a in enumerate(acceleration)]
    names = ["t [s]", "force [N]", "slow [m/s^2]", f"{A} [m/s^2]"]
    (folder / "run.csv").write_text(table_text(names, time_s, force, cells, acceleration))
    text, recording, _ = looked_at(folder, "run.csv")
    assert "left out: column 3 'slow [m/s^2]' (it is sampled at 102.4 Hz, others at 512 Hz)" in text
    check_motion(recording, 0.0)


def test_channels_that_share_no_time_are_refused(tmp_path):
    folder = folder_with(tmp_path)
    csv_pairs(folder / "run.csv", raster(0, SAMPLES), raster(SAMPLES + 10, SAMPLES))
    with pytest.raises(RigError, match=r"its channels share no time: .* from 0 to 2\.92"):
        looked_at(folder, "run.csv")


@pytest.mark.parametrize(
    ("unit", "factor", "zero", "digits"),
    [
        ("[ns]", 1e9, 1709301906000000000, "%d"),
        ("[us]", 1e6, 0, "%.3f"),
        ("[ms]", 1e3, 0, "%.6f"),
        ("[min]", 1 / 60, 0, "%.12f"),
        ("[h]", 1 / 3600, 0, "%.14f"),
        ("[d]", 1 / 86400, 0, "%.14f"),
        ("", 1 / 86400, 44_123.25, "%.12f"),
        ("", 1 / 86400, 738_946.5, "%.12f"),
        ("", 1.0, 1709301906, "%.9f"),
        ("", 1e3, 1709301906000, "%.6f"),
        ("", 1e6, 1709301906000000, "%.3f"),
        ("", 1e9, 1709301906000000000, "%d"),
    ],
)
@pytest.mark.parametrize("has_rig", [True, False])
def test_units_of_time_are_known_by_name_or_by_their_numbers(tmp_path, unit, factor, zero, digits, has_rig):
    folder = folder_with(tmp_path)
    time_s, force, acceleration = raster(0, SAMPLES)
    stamps = [digits % (zero + (round(t * factor) if digits == "%d" else t * factor)) for t in time_s.tolist()]
    (folder / "run.csv").write_text(
        table_text([f"time {unit}", "force [N]", f"{A} [m/s^2]"], stamps, force, acceleration)
    )
    if not has_rig:
        assert "; 512 Hz by column" in proposed_import_map(folder / "run.csv", None).text
        return
    text, recording, said = looked_at(folder, "run.csv")
    assert "; 512 Hz by column" in text
    assert "correct" not in text
    assert "resampled" not in said
    assert recording.samples == SAMPLES
    np.testing.assert_allclose(recording.force_n, force, atol=1e-8)


@pytest.mark.parametrize("stated", ["t [s]", "t"])
@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us")])
def test_the_unit_of_time_is_doubted_before_the_rig(tmp_path, stated, factor, unit):
    folder = folder_with(tmp_path)
    time_s, force, acceleration = raster(0, SAMPLES)
    path = folder / "run.csv"
    path.write_text(
        table_text([stated, "force [N]", f"{A} [m/s^2]"], time_s * factor, force, acceleration, formats="%.12g")
    )
    text = proposed_import_map(path, Sdof(sensors="acceleration").rig()).text
    assert "correct it to" not in text
    if stated == "t":  # the rate of the rig tells it
        assert f'unit = "{unit}"' in text
        return
    assert f"check the unit of its time: in {unit} it would be 512 Hz" in text
    (folder / "map.toml").write_text(text.replace('unit = "?"', 'unit = "s"'))
    with pytest.raises(RigError, match=f"check the unit of its time: in {unit} it would be 512 Hz"):
        import_file(path, folder / "map.toml", folder / "r.mcap")


@pytest.mark.parametrize("first_s", [0.0, 37.0, 600.0])
@pytest.mark.parametrize("is_text", [False, True])
@pytest.mark.parametrize("is_added_up", [False, True])
def test_stamps_in_single_precision_leave_samples_as_they_are(tmp_path, first_s, is_text, is_added_up):
    rate_hz = 1000.0
    folder = folder_with(tmp_path, rate_hz)
    time_s = np.arange(SAMPLES) / rate_hz
    stamps = (first_s + time_s).astype(np.float32)
    if is_added_up:
        steps = np.full(SAMPLES, 1e-3, dtype=np.float32)
        steps[0] = first_s
        stamps = np.cumsum(steps, dtype=np.float32)
    force, acceleration = motion(time_s)
    if is_text:
        lines = table_text(["t [s]", "force [N]", f"{A} [m/s^2]"], [f"{t:.9g}" for t in stamps], force, acceleration)
        (folder / "run.csv").write_text(lines)
    else:
        with h5py.File(folder / "run.h5", "w") as file:
            for name, unit, values in (("t", "s", stamps), ("force", "N", force), (A, "m/s^2", acceleration)):
                file[name] = values
                file[name].attrs["unit"] = unit
    name = "run.csv" if is_text else "run.h5"
    changes = {}
    if (
        is_added_up and first_s == 600.0
    ):  # steps of 1/1024 s, by a last digit of 6e-5 s: nothing tells 1000 from 1024 Hz
        changes = {'sample_rate_hz = "?"': "sample_rate_hz = 1000.0"}
        assert "too few digits" in proposed_import_map(folder / name, Sdof(sample_rate_hz=rate_hz).rig()).text
    text, recording, said = looked_at(folder, name, changes)
    assert "resample" not in text + said
    assert recording.samples == SAMPLES
    np.testing.assert_allclose(recording.force_n, force, atol=1e-8)


def test_lost_samples_are_no_rounding(tmp_path):
    """At 1000 Hz stamps in whole milliseconds have one step; a longer one is a lost sample."""
    folder = folder_with(tmp_path, 1000.0)
    time_s = np.delete(np.arange(SAMPLES), 700) / 1000.0
    names = ["t [s]", "force [N]", f"{A} [m/s^2]"]
    (folder / "run.csv").write_text(table_text(names, [f"{t:.3f}" for t in time_s], *motion(time_s)))
    with pytest.raises(RigError, match=r"1 gaps, the first after 0\.699"):
        looked_at(folder, "run.csv", {"resample = true": "resample = false"})


@pytest.mark.parametrize("form", ["date_time", "time_of_day", "twelve_hours", "month_first"])
def test_dates_and_times_of_day_go_on_over_midnight(tmp_path, form):
    folder = folder_with(tmp_path)
    time_s, force, acceleration = raster(0, SAMPLES)
    stamps = np.datetime64("2024-03-31T23:59:58.500000") + np.round(time_s * 1e6).astype("timedelta64[us]")
    days, clocks = zip(*(str(stamp).split("T") for stamp in stamps), strict=True)
    if form == "twelve_hours":
        clocks = [f"{(int(c[:2]) - 1) % 12 + 1}{c[2:]} {'PM' if int(c[:2]) > 11 else 'AM'}" for c in clocks]
    leading = {"Date": days, "Time": clocks}
    if form == "time_of_day":
        leading.pop("Date")
    if form == "month_first":
        leading = {"Timestamp": [f"{d[5:7]}/{d[8:]}/{d[:4]} {c}" for d, c in zip(days, clocks, strict=True)]}
    names = [*leading, "force [N]", f"{A} [m/s^2]"]
    (folder / "run.csv").write_text(table_text(names, *leading.values(), force, acceleration))
    text, recording, said = looked_at(folder, "run.csv")
    assert "512 Hz by column" in text
    assert "resampled" not in said
    assert recording.samples == SAMPLES
    np.testing.assert_allclose(recording.force_n, force, atol=1e-8)


@pytest.mark.parametrize("form", ["csv", "h5"])
def test_a_time_that_begins_again_is_a_second_record(tmp_path, form):
    folder, first_count = folder_with(tmp_path), 900
    time_s, force, acceleration = raster(0, SAMPLES)
    stamps = np.concatenate([time_s[:first_count], time_s[: SAMPLES - first_count]])
    if form == "csv":
        (folder / "run.csv").write_text(
            table_text(["X_Value", "force [N]", f"{A} [m/s^2]"], stamps, force, acceleration)
        )
        with pytest.raises(RigError, match=r"its time begins again after .* 2 records follow .* sample_lines = 900"):
            looked_at(folder, "run.csv", {"csv = { sample_lines = 900 }": ""})
        text, recording, _ = looked_at(folder, "run.csv")
        assert "its time begins again in line 902" in text
        assert recording.samples == first_count
        check_motion(recording, 0.0)
        return
    with h5py.File(folder / "run.h5", "w") as file:
        for name, unit, values in (("t", "s", stamps), ("force", "N", force), (A, "m/s^2", acceleration)):
            file[name] = values
            file[name].attrs["unit"] = unit
    with pytest.raises(RigError, match=r"its time begins again after .* 2 records follow one another"):
        looked_at(folder, "run.h5")


@pytest.mark.parametrize("label", ["Samples", "BlockSize", "Number of samples", "Record Length"])
def test_more_lines_than_the_header_states_are_several_records(tmp_path, label):
    folder, stated = folder_with(tmp_path), 500
    _, force, acceleration = raster(0, SAMPLES)
    head = f"{label},{stated}\nSample rate [Hz],512\n"
    (folder / "run.csv").write_text(head + table_text(["force [N]", f"{A} [m/s^2]"], force, acceleration))
    text, recording, said = looked_at(folder, "run.csv")
    assert "its header states 500 samples, and 1500 lines of samples follow: 3 records one after another" in text
    assert "the second from line 504" in text
    assert recording.samples == stated
    assert "the first 500 lines of samples are read" in said
    (folder / "map.toml").write_text((folder / "map.toml").read_text().replace(", sample_lines = 500", ""))
    with pytest.raises(RigError, match="3 records one after another, the second from line 504"):
        import_file(folder / "run.csv", folder / "map.toml", folder / "other.mcap")


def test_a_time_that_goes_on_beyond_the_stated_count_is_one_record(tmp_path):
    folder = folder_with(tmp_path)
    body = table_text(["t [s]", "force [N]", f"{A} [m/s^2]"], *raster(0, SAMPLES))
    (folder / "run.csv").write_text(f"Samples,500\n{body}")
    _, recording, _ = looked_at(folder, "run.csv")
    assert recording.samples == SAMPLES


def test_a_file_of_changes_alone_is_refused_with_the_cause(tmp_path):
    folder = folder_with(tmp_path)
    time_s, *rows = raster(0, SAMPLES)
    force, acceleration = (np.round(row * np.exp(-(((time_s % 1.0) - 0.3) ** 2) / 0.01), 1) for row in rows)
    is_changed = np.concatenate([[True], (np.diff(force) != 0) | (np.diff(acceleration) != 0)])
    columns = (time_s[is_changed], force[is_changed], acceleration[is_changed])
    (folder / "run.csv").write_text(table_text(["t [s]", "force [N]", f"{A} [m/s^2]"], *columns))
    with pytest.raises(RigError, match="samples that did not change were probably not exported") as caught:
        looked_at(folder, "run.csv")
    assert "cut" not in str(caught.value)


@pytest.mark.parametrize("count", [2, 5])
def test_repeated_values_are_said(tmp_path, count):
    folder = folder_with(tmp_path)
    time_s, force, acceleration = raster(0, SAMPLES)
    held = np.repeat(acceleration[::count], count)
    (folder / "run.csv").write_text(table_text(["t [s]", "force [N]", f"{A} [m/s^2]"], time_s, force, held))
    text, _, said = looked_at(folder, "run.csv")
    words = f"changes only once in {count} samples: its values are repeated, and its own rate is {512 / count:g} Hz"
    assert words in text
    assert words in said
