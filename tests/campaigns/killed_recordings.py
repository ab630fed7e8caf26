"""Recordings killed at random moments, and what is left of them.

python -m tests.campaigns.killed_recordings --kills 20 --seed 1

`rig record` runs in a process of its own and is ended by SIGKILL somewhere between its first and its last byte. Every
complete chunk that mcap's own reader finds must come back through `rig recover` with the values of an undisturbed
recording of the same seed, `rig check` must pass, and `identify contact` must answer where enough was saved. Then the
same with a disk that is full half-way, and with Ctrl-C.
"""

import argparse
import json
import signal
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from rig.recording import Recording, read
from rig.recording.messages import decode_block
from rig.simulation.reference import Sdof

DURATION_S = 300.0
ENOUGH_S = 150.0
"""Duration from which a recording of the one-mass rig is long enough for an answer."""
CLEARANCE_M = Sdof().clearance_m


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.killed_recordings", description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    with TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "whole.mcap"
        process = _record(path)
        _, said = process.communicate()
        assert process.returncode == 0, said
        undisturbed, size = read(path), path.stat().st_size
        print(f"whole: {undisturbed.samples} samples, {size} bytes", flush=True)
        for number in range(asked.kills):
            place = folder / f"{number}"
            place.mkdir()
            print(f"kill {number + 1}: {_killed(place / 'r.mcap', int(rng.uniform(0, size)), undisturbed)}", flush=True)
        print(f"full disk: {_out_of_disk(folder / 'full.mcap', size // 2, undisturbed)}", flush=True)
        print(f"Ctrl-C: {_interrupted(folder / 'stopped.mcap', size // 2, undisturbed)}", flush=True)


def _killed(path: Path, after_bytes: int, undisturbed: Recording) -> str:
    process = _record(path)
    _wait_for(path, after_bytes, process)
    process.kill()
    process.communicate()
    assert process.returncode in (0, -signal.SIGKILL)
    if path.exists():
        back = read(path)
        _check_same(back, undisturbed)
        assert back.samples == undisturbed.samples
        return f"after {after_bytes} bytes: it was complete already"
    return f"after {after_bytes} bytes: {_saved(_part_of(path), undisturbed)}"


def _out_of_disk(path: Path, most_bytes: int, undisturbed: Recording) -> str:
    process = _record(path, most_bytes)
    _, said = process.communicate()
    assert process.returncode == 1
    assert "cannot be written to its end (File too large)" in said
    assert said.count("\n") == 1
    assert not path.exists()
    return _saved(_part_of(path), undisturbed)


def _interrupted(path: Path, after_bytes: int, undisturbed: Recording) -> str:
    process = _record(path)
    _wait_for(path, after_bytes, process)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert (process.returncode, said) == (130, f"rig: interrupted; {path} holds what was recorded until then\n"), said
    back = read(path)
    _check_same(back, undisturbed)
    return f"{back.samples} samples kept, complete file"


def _saved(part_path: Path, undisturbed: Recording) -> str:
    """Check of what comes back of a file without its end, and its result in words."""
    stored, saved = stored_samples(part_path), part_path.with_name("saved.mcap")
    if not stored or len(stored) < len(undisturbed.signals):
        done = _run("rig.commands.cli", "recover", part_path, "--out", saved)
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        return f"no complete chunk of every group; {done.stderr.strip()}"
    done = _run("rig.commands.cli", "recover", part_path, "--out", saved, "--json")
    assert done.returncode == 0, done.stderr
    groups = {group["group"]: group for group in json.loads(done.stdout)["groups"]}
    back = read(saved)
    _check_same(back, undisturbed)
    assert back.samples == min(samples.shape[1] for samples in stored.values())
    for name, samples in stored.items():
        np.testing.assert_array_equal(samples, undisturbed.signals[name].values[:, : samples.shape[1]])
        assert (groups[name]["found"], groups[name]["kept"]) == (samples.shape[1], back.samples)
    assert _run("rig.commands.cli", "check", saved).returncode == 0
    kept = f"{back.samples} of {undisturbed.samples} samples kept"
    if back.duration_s < ENOUGH_S:
        return kept
    done = _run("identify.commands.cli", "contact", saved, "--json")
    assert done.returncode == 0, done.stderr
    (contact,) = json.loads(done.stdout)["contacts"]
    clearance_m = contact["clearance_m"]["value"]
    assert abs(clearance_m / CLEARANCE_M - 1) < 0.01
    return f"{kept}, clearance {1e3 * clearance_m:.4f} mm"


def stored_samples(part_path: Path) -> dict[str, np.ndarray]:
    """Samples of every group in the complete chunks, as mcap's reader finds them."""
    found: dict[str, list[np.ndarray]] = {}
    with part_path.open("rb") as content:
        try:
            for _, channel, message in NonSeekingReader(content, validate_crcs=True).iter_messages(
                log_time_order=False
            ):
                if channel.topic.endswith("/block"):
                    found.setdefault(channel.topic.split("/")[2], []).append(decode_block(message.data).values)
        except (McapError, struct.error):
            pass
    return {group: np.concatenate(blocks, axis=1) for group, blocks in found.items()}


def _check_same(back: Recording, undisturbed: Recording) -> None:
    assert back.rig == undisturbed.rig
    assert set(back.signals) == set(undisturbed.signals)
    for name, signals in undisturbed.signals.items():
        np.testing.assert_array_equal(back.signals[name].values, signals.values[:, : back.samples])


def _part_of(path: Path) -> Path:
    return path.with_name(path.name + ".part")


def _record(path: Path, most_bytes: int | None = None) -> subprocess.Popen[str]:
    limit = ""
    if most_bytes is not None:
        limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, {(most_bytes, most_bytes)}); "
    words = ("record", "sdof", "--plant", "modal", "--duration", DURATION_S, "--out", path)
    program = [sys.executable, "-c", f"{limit}from rig.commands.cli import main; main()", *map(str, words)]
    return subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _run(module: str, *words: object) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-c", f"from {module} import main; main()", *map(str, words)]
    return subprocess.run(program, capture_output=True, text=True, check=False)


def _wait_for(path: Path, size: int, process: subprocess.Popen[str]) -> None:
    """Wait until so many bytes are written, or all."""
    part_path = _part_of(path)
    while process.poll() is None:
        with suppress(FileNotFoundError):
            if part_path.stat().st_size > size:
                return
        time.sleep(0.0005)


if __name__ == "__main__":
    main()
