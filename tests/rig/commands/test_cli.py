"""The command `rig`: what it prints, its exit statuses, and that it overwrites nothing unasked."""

import json
import re
import signal
import subprocess
import sys
import time
from urllib.error import HTTPError, URLError
from urllib.parse import unquote
from urllib.request import Request, urlopen

import msgspec
import numpy as np
import pytest
from mcap.writer import Writer

from rig.model.description import Station, Support, from_json, to_json
from rig.recording import channel_groups, read, read_truth, truth_path, writing
from rig.simulation.reference import REFERENCES, BarrelCradle, Sdof
from rig.viewer import viewing
from tests.running import exit_status

TWO_SECONDS = ("--plant", "modal", "--duration", "2")


@pytest.fixture
def rig(capsys):
    """Runs the command in this process: exit status, standard output, standard error."""

    def command(*words, **environment):
        return exit_status("rig", *words, columns=80, **environment), *capsys.readouterr()

    return command


@pytest.fixture(scope="module")
def barrel(tmp_path_factory):
    """Any samples will do where it is not looked at what moves."""
    rig = BarrelCradle().rig()
    path = tmp_path_factory.mktemp("cli") / "barrel.mcap"
    rng = np.random.default_rng(1)
    with writing(path, rig, channel_groups(rig), {"made_by": "a test"}) as recording:
        for name, group in channel_groups(rig).items():
            recording.append(name, rng.standard_normal((len(group.names), 3000)))
    return path


def one_line(err):
    assert err.startswith("rig: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1
    return err


def test_from_recording_to_viewing(rig, tmp_path):
    path = tmp_path / "s.mcap"
    status, out, err = rig("record", "sdof", *TWO_SECONDS, "--seed", 7, "--set", "rms_n=0.25", "--out", path)
    assert (status, err) == (0, "")
    assert str(path) in out
    assert str(truth_path(path)) in out
    recording = read(path)
    assert recording.duration_s == 2.0
    assert recording.provenance["seed"] == "7"
    assert "rms_n=0.25" in recording.provenance["excitation"]
    assert read_truth(truth_path(path)).samples == recording.samples

    status, out, err = rig("check", path)
    channels = sum(len(s.channels.names) for s in recording.signals.values())
    assert (status, out, err) == (0, f"{path}: sound, {channels} channels of {recording.samples} samples\n", "")

    status, out, err = rig("info", path)
    assert (status, err) == (0, "")
    assert f"{Sdof().frequency_hz:.2f}" in out
    assert f"{np.sqrt(np.mean(recording.force_n**2)):.4g}" in out

    status, out, err = rig("view", path)
    rrd_path = path.with_suffix(".rrd")
    assert (status, out, err) == (0, f"{rrd_path}: written; open it: rerun --bind 127.0.0.1 {rrd_path}\n", "")
    assert path.with_suffix(".rrd").stat().st_size > 8 * recording.samples


@pytest.mark.parametrize("plant", ["modal", "ancf"])
def test_a_rig_in_space_is_recorded_told_and_drawn(rig, tmp_path, plant):
    path = tmp_path / "s.mcap"
    words = ("--plant", plant, "--duration", 1.25, "--set", "sensors=acceleration")
    status, out, err = rig("record", "barrel_cradle_annular", *words, "--out", path)
    assert (status, err) == (0, "")
    assert "2 forces, each 60 N rms" in out
    status, out, _ = rig("info", path)
    assert status == 0
    assert "2 all around" in out
    assert "barrel_1000mm_z_acceleration" in out
    assert "barrel 1 m, z" in out
    recording, truth = read(path), read_truth(truth_path(path))
    late = slice(round(1.1 * 4096), None)
    assert all(row[late].std() > 0.1 for row in recording.signals["acceleration"].values)
    assert np.abs(recording.signals["acceleration"].values[:, :4000]).max() < 1e-3  # at rest, whatever it weighs
    assert all(np.ptp(row) > 1 for row in truth.signals["contact_force"].values)
    assert rig("draw", path)[0] == 0
    status, _, err = rig("fmu", path, "--out", tmp_path / "s.fmu")
    assert status == 1
    assert "contact 'contact_1' is annular, and" in one_line(err)


def test_effects_of_a_rig_in_space_are_recorded(rig, tmp_path):
    path = tmp_path / "s.mcap"
    words = ("record", "barrel_cradle_annular", "--plant", "modal", "--duration", 1.25, "--out", path)
    effects = ("contact_clearance:factor=1.2", "asymmetric_clearance:shift_m=1e-4,contact=contact_1", "added_mass")
    status, _, err = rig(*words, *(word for effect in effects for word in ("--effect", effect)))
    assert (status, err) == (0, "")
    nominal, actual = read(path).rig, read_truth(truth_path(path)).rig
    for nominal_contact, actual_contact, center_y_m in zip(nominal.contacts, actual.contacts, (1e-4, 0.0), strict=True):
        assert actual_contact.law.clearance_m == pytest.approx(1.2 * nominal_contact.law.clearance_m)
        assert actual_contact.law.center_y_m == pytest.approx(center_y_m)
    assert len(actual.masses) == len(nominal.masses) + 1


def test_json_is_all_that_is_printed(rig, tmp_path):
    path = tmp_path / "s.mcap"
    status, out, err = rig("record", "sdof", *TWO_SECONDS, "--out", path, "--json")
    assert (status, err) == (0, "")
    assert json.loads(out) == {"recording": str(path), "truth": str(truth_path(path))}
    recording = read(path)
    status, out, _ = rig("check", path, "--json")
    assert status == 0
    assert json.loads(out) == {"file": str(path), "sound": True, "samples": recording.samples}
    status, out, _ = rig("info", path, "--json")
    summary = json.loads(out)
    assert status == 0
    assert from_json(json.dumps(summary["rig"]).encode(), "the JSON") == recording.rig
    assert summary["duration_s"] == recording.duration_s
    assert summary["provenance"] == recording.provenance
    rows = [row for s in recording.signals.values() for row in s.values]
    np.testing.assert_allclose([c["rms"] for c in summary["channels"]], [np.sqrt(np.mean(row**2)) for row in rows])


def test_the_tables_fit_a_pipe_and_name_every_channel(rig, barrel):
    status, out, _ = rig("info", barrel)
    assert status == 0
    assert max(len(line) for line in out.splitlines()[1:]) <= 80  # the first has the path of the file
    recording = read(barrel)
    for signals in recording.signals.values():
        for name, row in zip(signals.channels.names, signals.values, strict=True):
            (line,) = [words for words in map(str.split, out.splitlines()) if words[:1] == [name]]
            assert line[-1] == f"{np.sqrt(np.mean(row**2)):.4g}"
    for body in recording.rig.bodies:
        (first, *_) = body.frequencies_hz(1 + body.rigid_modes)[body.rigid_modes :]
        assert f"{first:.2f}," in out
    assert "made_by: a test" in out


def test_a_rig_json_is_told_with_its_supports(rig, tmp_path):
    """A free beam on two rollers at its ends has the frequencies of a simply supported one, not its own."""
    machine = BarrelCradle(sensors="acceleration").rig()
    barrel = machine.body("barrel")
    supports = tuple(Support(station=Station("barrel", position_m)) for position_m in (0.0, barrel.length_m))
    path = tmp_path / "rig.json"
    path.write_bytes(to_json(msgspec.structs.replace(machine, supports=supports)))
    status, out, err = rig("info", path)
    assert (status, err) == (0, "")
    assert out.startswith(f"{path}: rig barrel_cradle, {len(machine.sensors)} sensors at {machine.sample_rate_hz:g} Hz")
    assert "barrel_1000mm_acceleration" in out
    (line,) = [line for line in out.splitlines() if line.split()[:1] == ["barrel"]]
    told_hz = [float(number) for number in re.findall(r"[\d.]+(?=,|$)", line.strip())]
    ratios = np.array([1, 2, 3, 4]) ** 2 * np.pi**2 / 4.730041**2  # to the first of the free beam
    (free_hz,) = barrel.frequencies_hz(3)[2:]
    np.testing.assert_allclose(told_hz, free_hz * ratios, rtol=5e-3)
    status, out, _ = rig("info", path, "--json")
    assert (status, from_json(json.dumps(json.loads(out)["rig"]).encode(), "the JSON").supports) == (0, supports)


def test_names_are_printed_as_they_are(rig, tmp_path):
    """Square brackets are markup for the library that draws the tables."""
    machine = msgspec.structs.replace(Sdof().rig(), name="[bold]a[/bold]", sensors=())
    path = tmp_path / "r.mcap"
    with writing(path, machine, channel_groups(machine), {"note": "[red]"}) as recording:
        recording.append("force", np.zeros((1, 100)))
    _, out, _ = rig("info", path)
    assert "rig [bold]a[/bold]," in out
    assert "note: [red]" in out


def test_nothing_is_overwritten_unasked(rig, tmp_path):
    path = tmp_path / "s.mcap"
    words = ("record", "sdof", *TWO_SECONDS, "--out", path)
    for existing in (path, truth_path(path)):
        existing.write_text("precious")
        status, out, err = rig(*words)
        assert (status, out) == (1, "")
        assert f"{existing}: exists already" in one_line(err)
        assert [p.read_text() for p in tmp_path.iterdir()] == ["precious"]
        existing.unlink()
    path.write_text("not precious")
    assert rig(*words, "--force")[0] == 0
    assert read(path).duration_s == 2.0

    picture = tmp_path / "s.rrd"
    picture.write_text("precious")
    status, out, err = rig("view", path)
    assert (status, out) == (1, "")
    assert f"{picture}: exists already" in one_line(err)
    assert picture.read_text() == "precious"
    status, out, err = rig("view", path, "--out", path, "--force")
    assert (status, out) == (1, "")
    assert "would be written over" in one_line(err)
    assert read(path).duration_s == 2.0
    assert rig("view", path, "--force")[0] == 0
    assert picture.read_bytes() != b"precious"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("record", "pendulum", "--out", "x.mcap"), "pendulum"),
        (("record", "sdof"), "--out"),
        (("record", "sdof", "--out", "x.mcap", "--plant", "adams"), "adams"),
        (("record", "sdof", "--out", "x.mcap", "--duration", "long"), "--duration"),
        (("record", "sdof", "--out", "x.mcap", "--set", "rms_n"), "rms_n"),
        (("record", "sdof", "--out", "x.mcap", "--set", "colour=3"), "colour"),
        (("record", "sdof", "--out", "x.mcap", "--set", "rms_n=much"), "rms_n"),
        (("view", "x.mcap", "--magnification", "0"), "0.0"),
        (("view", "x.mcap", "--magnification", "nan"), "nan"),
        (("forget", "x.mcap"), "forget"),
        (("check",), "file"),
    ],
)
def test_wrong_words_exit_with_2(rig, in_folder, words, said):
    status, out, err = rig(*words)
    assert (status, out) == (2, "")
    assert said.lower() in err.lower()
    assert "Traceback" not in err
    assert not list(in_folder.iterdir())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--duration", "0.5"), "duration is 0.5 s"),
        (("--duration", "nan"), "duration is nan s"),
        (("--duration", "inf"), "duration is inf s"),
        (("--seed", "-1"), "seed is -1"),
        (("--set", "clearance_m=-1"), "contact law: clearance_m is -1"),
        (("--set", "excitation=whisper"), "whisper"),
        (("--set", "stiffness_n_per_m=1e12"), "too stiff"),
        (("--set", "sample_rate_hz=1000"), "sample_rate_hz is 1000"),
        (("--set", "high_hz=5000"), "step is"),
    ],
)
def test_values_that_cannot_be_used_exit_with_1_and_leave_nothing(rig, tmp_path, words, said):
    status, out, err = rig("record", "sdof", *TWO_SECONDS, *words, "--out", tmp_path / "s.mcap")
    assert (status, out) == (1, "")
    assert said in one_line(err)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there_is_said(rig, tmp_path):
    status, _, err = rig("record", "sdof", *TWO_SECONDS, "--out", tmp_path / "none" / "s.mcap")
    assert status == 1
    assert "none/s.mcap: cannot be written" in one_line(err)


def sound(path, values=None, missing=()):
    """A recording of the one-mass rig, with other values for a group or without it."""
    machine = Sdof().rig()
    groups = {name: g for name, g in channel_groups(machine).items() if name not in missing}
    with writing(path, machine, groups, {}) as recording:
        for name in groups:
            recording.append(name, (values or {}).get(name, np.random.default_rng(1).standard_normal((1, 20_000))))


def cut_in_the_middle(path):
    sound(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def with_a_flipped_byte(path):
    """Flip a bit in the middle of the file, which is in the values of a block."""
    sound(path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


def without_rig_json(path):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()


def with_nan(path):
    sound(path, {"acceleration": np.where(np.arange(20_000) == 4096, np.nan, 0.0)[None, :]})


BAD = {
    "not there": (lambda _: None, "cannot be opened (No such file or directory); check the name"),
    "a folder": (lambda path: path.mkdir(), "cannot be opened (Is a directory)"),
    "empty": (lambda path: path.write_bytes(b""), "is empty; record it again"),
    "a picture": (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(1000)), "is no MCAP file"),
    "cut in the middle": (cut_in_the_middle, "is cut off or damaged"),
    "a flipped byte": (with_a_flipped_byte, "damaged"),
    "without rig.json": (without_rig_json, "has no attachment rig.json"),
    "without the force": (lambda path: sound(path, missing=("force",)), "has no channel /rig/force/block"),
    "with NaN": (with_nan, "channel 'mass_0000mm_acceleration' is not a finite number at sample 4096 (8.0000 s)"),
}


@pytest.mark.parametrize("command", ["check", "info", "view"])
@pytest.mark.parametrize(("make", "said"), BAD.values(), ids=BAD)
def test_a_bad_file_gets_one_sentence(rig, tmp_path, command, make, said):
    path = tmp_path / "r.mcap"
    make(path)
    status, out, err = rig(command, path)
    assert (status, out) == (1, "")
    assert f"{path}: " in one_line(err)
    assert said in err
    assert not (tmp_path / "r.rrd").exists()


def test_a_file_without_faults_gets_none(rig, tmp_path):
    """The file from which the bad ones are made is sound."""
    sound(tmp_path / "r.mcap")
    assert rig("check", tmp_path / "r.mcap")[0] == 0


@pytest.mark.parametrize("plant", ["modal", "ancf"])
def test_an_interrupted_recording_is_kept(tmp_path, plant):
    """Ctrl-C, pressed twice by an impatient user, while the plant is at work."""
    path = tmp_path / "s.mcap"
    words = ["record", "sdof", "--plant", plant, "--duration", "400", "--out", str(path)]
    program = [sys.executable, "-c", "from rig.commands.cli import main; main()", *words]
    with subprocess.Popen(program, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as running:
        part_path = tmp_path / "s.mcap.part"
        while not (part_path.exists() and part_path.stat().st_size > 100_000):
            assert running.poll() is None, running.stderr.read()
            time.sleep(0.01)
        running.send_signal(signal.SIGINT)
        running.send_signal(signal.SIGINT)
        out, err = running.communicate()
    assert running.returncode == 130, err
    assert (out, err) == ("", f"rig: interrupted; {path} holds what was recorded until then\n")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["s.mcap", "s.truth.mcap"]
    assert 0 < read(path).samples < 400 * Sdof().sample_rate_hz
    assert read_truth(truth_path(path)).samples == read(path).samples


@pytest.mark.parametrize("option", ["--truth", "--contact"])
def test_what_is_shown_beside_must_be_there(rig, tmp_path, option):
    sound(tmp_path / "r.mcap")
    status, out, err = rig("view", tmp_path / "r.mcap", option, tmp_path / "none")
    assert (status, out) == (1, "")
    assert err.startswith(f"rig: {tmp_path / 'none'}: cannot be opened")
    assert err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["r.mcap"]


@pytest.mark.parametrize(("display", "words", "opened"), [("", (), 0), (":0", (), 1), (":0", ("--out", "o.rrd"), 0)])
def test_the_viewer_opens_where_there_is_a_display(rig, in_folder, monkeypatch, display, words, opened):
    sound(in_folder / "r.mcap")
    started = []
    monkeypatch.setattr(viewing, "open_viewer", started.append)
    assert rig("view", "r.mcap", *words, DISPLAY=display)[0] == 0
    assert len(started) == opened


@pytest.mark.parametrize(("ending", "in_background"), [("SIGINT", False), ("SIGTERM", False), ("SIGTERM", True)])
def test_a_browser_is_served_until_the_command_is_ended(tmp_path, ending, in_background):
    """A shell has the commands that it runs in the background ignore SIGINT."""
    sound(tmp_path / "r.mcap")
    handler = "SIG_IGN" if in_background else "default_int_handler"  # whatever these tests are run in
    program_text = (
        f"import signal; signal.signal(signal.SIGINT, signal.{handler}); from rig.commands.start import rig; rig()"
    )
    program = [sys.executable, "-c", program_text]
    with (tmp_path / "said").open("wb") as said:
        running = subprocess.Popen([*program, "view", str(tmp_path / "r.mcap"), "--web"], stdout=said, stderr=said)
    try:
        until = time.monotonic() + 60
        while b"Ctrl-C" not in (tmp_path / "said").read_bytes():
            assert time.monotonic() < until
            assert running.poll() is None, (tmp_path / "said").read_bytes()
            time.sleep(0.05)
        address = (tmp_path / "said").read_text().split("open ")[1].partition(";")[0]
        page, _, data = address.partition("?url=")
        with urlopen(page, timeout=20) as answer:
            assert b"rerun" in answer.read().lower()
        with urlopen(f"{page}re_viewer_bg.wasm", timeout=20) as answer:
            assert answer.headers["Content-Type"] == "application/wasm"
            assert answer.read(4) == b"\0asm"
        with urlopen(unquote(data), timeout=20) as answer:
            assert answer.read() == (tmp_path / "r.rrd").read_bytes()
            assert "Access-Control-Allow-Origin" not in answer.headers  # other pages may not read it
        for each in (page, unquote(data)):
            with pytest.raises(HTTPError, match="403"):  # as of a name that was made to point here
                urlopen(Request(each, headers={"Host": f"rebound.example:{page.split(':')[2].strip('/')}"}), timeout=20)
            with pytest.raises(URLError, match="refused"):  # a server on all addresses would answer
                urlopen(each.replace("127.0.0.1", "127.0.0.2"), timeout=20)
        with pytest.raises(HTTPError, match="404"):
            urlopen(unquote(data).replace("recording", "r"), timeout=20)
        running.send_signal(getattr(signal, ending))
        assert running.wait(20) == 130
        for url in (page, unquote(data)):
            with pytest.raises(URLError):
                urlopen(url, timeout=5)
    finally:
        running.kill()
        running.wait(20)


@pytest.mark.parametrize("command", ["record", "info", "check", "view"])
def test_help_has_an_example(rig, command):
    status, out, _ = rig(command, "--help")
    assert status == 0
    assert f"Example: rig {command} " in out


def test_help_lists_every_setting(rig):
    _, out, _ = rig("record", "--help")
    for name, kind in REFERENCES.items():
        listed = out.partition(f"Settings of {name}:")[2].split()
        for field in msgspec.structs.fields(kind):
            assert f"{field.name}={field.default}" in [word.rstrip(",") for word in listed]
