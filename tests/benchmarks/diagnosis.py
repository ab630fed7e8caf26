"""What a diagnosis costs: a null reference, and a case with those of both records at hand; each in its own process.

The barrel in its cradle, 30 s of twelve accelerometers at 4096 Hz, 15 N to fit and 22 N to validate: an added mass, a
pair of effects, and nothing at all.
"""

import os
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from msgspec.structs import replace

from identify.gaps.decision.answer import diagnose
from identify.gaps.decision.null_reference import null_reference_of
from identify.gaps.decision.prepare import simulator_named
from rig.effects import effect_named
from rig.model.tolerances import LABORATORY
from rig.recording import Recording
from rig.simulation import replay
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from tests.benchmarks.measuring import Figure
from tests.campaigns.stage_costs import peak_mb

SETTINGS = BarrelCradle(sensors="acceleration", noise_density=1e-3)
CASES = {
    "an added mass": ("added_mass:mass_kg=0.1,relative_position=0.7",),
    "a pair": ("added_mass:mass_kg=0.1,relative_position=0.7", "contact_clearance:factor=1.1,contact=contact_1"),
    "nothing": (),
}
DURATION_S = 30.0
SIMULATOR = simulator_named("modal")


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "null_reference.json"
        _apart(_null_reference, 0, kept)
        cpu_s, memory_mb = _apart(_null_reference, 1, kept)
        yield Figure("CPU s of a null reference", cpu_s, "s", at_most=60)
        yield Figure("... peak memory", memory_mb, "MB", at_most=1000)
        for name, effects in CASES.items():
            cpu_s, memory_mb = _apart(_case, effects, kept)
            yield Figure(f"CPU s of a case: {name}", cpu_s, "s", at_most=60)
            yield Figure("... peak memory", memory_mb, "MB", at_most=1000)


def _apart(work: object, *given: object) -> tuple[float, float]:
    """In a fresh process without further ones, so that peak memory and CPU time are its own."""
    os.environ["LOKY_MAX_CPU_COUNT"] = "1"
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes:
        return processes.submit(work, *given).result()


def _recordings(effects: tuple[str, ...]) -> tuple[Recording, Recording]:
    believed = SETTINGS.rig()
    actual = believed
    for text in effects:
        actual = effect_named(text).applied_to(actual)
    forces = [
        force_history(replace(SETTINGS, rms_n=rms_n, seed=seed).force(), DURATION_S, 1 / SETTINGS.sample_rate_hz)
        for seed, rms_n in ((1, 15.0), (2, 22.0))
    ]
    first, second = (replay.modal(believed, actual, force_n, seed) for seed, force_n in enumerate(forces))
    return first, second


def _null_reference(which: int, kept: Path) -> tuple[float, float]:
    """Of the first or the second record."""
    recording = _recordings(())[which]
    begin = time.process_time()
    null_reference_of(recording, LABORATORY, SIMULATOR.simulate, SIMULATOR.name, path=kept, predict=SIMULATOR.predict)
    return time.process_time() - begin, peak_mb()


def _case(effects: tuple[str, ...], kept: Path) -> tuple[float, float]:
    first, second = _recordings(effects)
    begin = time.process_time()
    diagnose(first, second, SIMULATOR, kept)
    return time.process_time() - begin, peak_mb()
