"""A recording against plain files of the same numbers, and against one MCAP message per sample.

A force and 16 accelerometers, 2 million samples each, appended as a plant delivers them.
"""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from zlib_ng.zlib_ng import crc32

from rig.recording import channel_groups, read, writing
from rig.recording.writer import SAMPLES_PER_BLOCK
from rig.simulation.reference import BarrelCradle
from tests.benchmarks.measuring import Figure, least_cpu_s

SAMPLES, AT_ONCE = 2_000_000, 2048
FEW = 20_000
"""Samples of the slow way, whose time is scaled up."""
RIG = BarrelCradle(stations=8, sensors="acceleration").rig()


def figures() -> Iterator[Figure]:
    rng = np.random.default_rng(1)
    values = {name: rng.standard_normal((len(g.names), SAMPLES)) for name, g in channel_groups(RIG).items()}
    with tempfile.TemporaryDirectory() as folder:
        recording, plain, single = (Path(folder) / name for name in ("r.mcap", "plain", "single.mcap"))

        def write() -> None:
            recording.unlink(missing_ok=True)
            with writing(recording, RIG, channel_groups(RIG), {}) as file:
                for first in range(0, SAMPLES, AT_ONCE):
                    for name, rows in values.items():
                        file.append(name, rows[:, first : first + AT_ONCE])

        def write_plain() -> None:
            plain.unlink(missing_ok=True)
            with plain.open("wb") as file:
                for rows in values.values():
                    rows.tofile(file)

        def write_single() -> None:
            single.unlink(missing_ok=True)
            with single.open("wb") as file:
                writer = Writer(file)
                writer.start()
                schema = writer.register_schema("sample", "jsonschema", b"{}")
                channel = writer.register_channel("/samples", "json", schema)
                for k, sample in enumerate(np.concatenate(list(values.values()))[:, :FEW].T):
                    writer.add_message(channel, k, json.dumps(sample.tolist()).encode(), k)
                writer.finish()

        def read_single() -> None:
            with single.open("rb") as file:
                np.array([json.loads(message.data) for _, _, message in make_reader(file).iter_messages()])

        def read_bare() -> None:
            """What is left of reading without messages: blocks are checksummed, looked at and put in place."""
            rows = sum(map(len, values.values()))
            block, whole = np.empty((rows, SAMPLES_PER_BLOCK)), np.empty((rows, SAMPLES))
            with plain.open("rb", buffering=0) as file:
                for first in range(0, SAMPLES - SAMPLES_PER_BLOCK, SAMPLES_PER_BLOCK):
                    file.readinto(block)
                    crc32(block)
                    np.isfinite(block.sum())
                    whole[:, first : first + SAMPLES_PER_BLOCK] = block

        write_s, write_plain_s = least_cpu_s(write), least_cpu_s(write_plain)
        read_s, read_plain_s = least_cpu_s(lambda: read(recording)), least_cpu_s(lambda: np.fromfile(plain))
        times = SAMPLES / FEW
        yield Figure("bytes over those of the numbers", recording.stat().st_size / plain.stat().st_size)
        yield Figure("speed of writing over tofile's", write_plain_s / write_s, at_least=0.3)
        yield Figure("speed of reading over fromfile's", read_plain_s / read_s, at_least=0.5)
        yield Figure("... without messages: checked and put in place alone", read_plain_s / least_cpu_s(read_bare))
        yield Figure(
            "times faster to write than a message a sample", times * least_cpu_s(write_single) / write_s, at_least=20
        )
        yield Figure(
            "times faster to read than a message a sample", times * least_cpu_s(read_single) / read_s, at_least=20
        )
