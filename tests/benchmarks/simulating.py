"""What a simulated recording costs: `rig record --plant modal` into a file, and a null recording in memory.

The barrel in its cradle: 60 s of a force, twelve displacements and twelve accelerations at 4096 Hz, 16 + 16 modes at a
step of 2^-14 s; 30 s of twelve accelerations, 24 + 24 modes at 2^-15 s. Beside each the plant's loop alone, with
nothing observed.
"""

import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import msgspec

from rig.simulation import replay
from rig.simulation.excitation import force_history
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from tests.benchmarks.measuring import Figure, least_cpu_s

RECORDED_S, REPLAYED_S = 60.0, 30.0
SETTINGS = BarrelCradle()
RIG, WITH_ACCELEROMETERS = SETTINGS.rig(), BarrelCradle(sensors="acceleration").rig()


def figures() -> Iterator[Figure]:
    yield Figure("CPU s of rig record --plant modal, 60 s", least_cpu_s(_recorded, times=5), "s", at_most=1.5)
    yield Figure("... of the plant's loop alone", _loop_cpu_s(RECORDED_S, SETTINGS.step_s, 16), "s")
    force_n = force_history(SETTINGS.force(), REPLAYED_S, 1 / SETTINGS.sample_rate_hz)
    rig = WITH_ACCELEROMETERS
    replayed_s = least_cpu_s(lambda: replay.modal(rig, rig, force_n, seed=1), times=5)
    yield Figure("CPU s of a null recording of 30 s", replayed_s, "s", at_most=0.7)
    yield Figure("... of the plant's loop alone", _loop_cpu_s(REPLAYED_S, 2.0**-15, 24), "s")


def _recorded() -> None:
    with tempfile.TemporaryDirectory() as folder:
        record(
            RIG,
            SETTINGS.force(),
            plant=modal.simulate,
            duration_s=RECORDED_S,
            step_s=SETTINGS.step_s,
            path=Path(folder) / "recording.mcap",
            progress=lambda _: None,
        )


def _loop_cpu_s(duration_s: float, step_s: float, modes: int) -> float:
    blind = msgspec.structs.replace(RIG, sensors=())
    force_n = force_history(SETTINGS.force(), duration_s, step_s)
    simulate = partial(modal.simulate, blind, force_n, step_s, lambda _: None, modes_per_beam=modes)
    return least_cpu_s(lambda: sum(block.force_n.size for block in simulate()), times=5)
