"""Recording a rig: force, plant, sensors and file in one run."""

import importlib.metadata
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from rig.errors import RigError
from rig.model.description import Rig
from rig.recording import RECORDED, channel_groups, truth_groups, truth_path, writing
from rig.simulation.excitation import QUIET_S, Excitation, force_signal
from rig.simulation.motion import Forces, Plant, Progress
from rig.simulation.sensors import Samples, digitise, plant_run_duration_s

MAX_DURATION_S = 1e6


def record(
    rig: Rig,
    excitation: Excitation | Sequence[Excitation],
    *,
    plant: Plant,
    duration_s: float,
    step_s: float,
    path: Path,
    progress: Progress,
    actual: Rig | None = None,
) -> None:
    """Simulate the rig, write its recording to `path` and the simulated truth to the truth file beside it.

    With `actual`, that rig is simulated while the recording states the nominal `rig`. Both need the same sensors,
    contacts and sampling rate; their properties and places may differ.

    The plant runs a little longer than duration_s, as the anti-aliasing filter needs samples on both sides. The
    sensors' noise comes from the excitation's seed. Of a rig with several forces give one for each; if only one is
    given, each has its settings and a seed of its own. Raises RigError where the rig cannot be simulated so or the file
    not written.
    """
    actual = actual or rig
    if not QUIET_S < duration_s < MAX_DURATION_S:
        raise RigError(
            f"duration is {duration_s} s; give more than {QUIET_S} s, the quiet start of every recording, and less "
            f"than {MAX_DURATION_S:g} s"
        )
    if actual.is_on_ground(actual.forces[0]) and not actual.base_motion:
        raise RigError(
            f"rig {actual.name!r} has no force_at and its base stands still, so nothing moves it; give base_motion"
        )
    for tone in actual.tones:
        if tone.frequency_hz * step_s >= 0.5:
            raise RigError(
                f"tone: frequency_hz is {tone.frequency_hz:g}, which steps of {step_s:g} s do not resolve; give less "
                f"than {0.5 / step_s:g} Hz"
            )
    sample_count = round(duration_s * rig.sample_rate_hz)
    if sample_count == 0:
        raise RigError(
            f"duration is {duration_s} s and sample_rate_hz {rig.sample_rate_hz}, which makes no sample; record longer "
            "or sample faster"
        )
    simulated_s = plant_run_duration_s(actual, sample_count / rig.sample_rate_hz)
    if isinstance(excitation, Excitation):
        excitation = [_with_independent_seed(excitation, force_number) for force_number in range(len(rig.forces))]
    forces = Forces(tuple(force_signal(settings, simulated_s, step_s) for settings in excitation))
    provenance = {
        "made_by": "rig record",
        RECORDED: datetime.now(UTC).isoformat(timespec="seconds"),
        "plant": getattr(plant, "__module__", "").rsplit(".", 1)[-1],
        "step_s": repr(step_s),
        "asked_duration_s": repr(duration_s),
        "excitation": ", ".join(map(repr, excitation)),
        "seed": str(excitation[0].seed),
        **dict(_version_entries("rig-identify", "exudyn", "numpy")),
    }
    rng = np.random.default_rng([excitation[0].seed, 1])
    written_count = 0
    with (
        np.errstate(over="ignore", divide="ignore", invalid="ignore"),  # what becomes of it is refused below
        threadpool_limits(1),  # the matrices are small
        _deferred_interrupt() as check_interrupt,
        writing(path, rig, channel_groups(rig), provenance) as recording_writer,
        writing(truth_path(path), actual, truth_groups(actual), provenance) as truth_writer,
    ):
        for block in digitise(actual, plant(actual, forces, step_s, progress), rng):
            kept_samples = slice(0, sample_count - written_count)
            _check_finite(block)
            for writer, values_by_group in ((recording_writer, block.sensed), (truth_writer, block.truth)):
                for group, group_values in {"force": block.forces_n, **values_by_group}.items():
                    writer.append(group, group_values[:, kept_samples])
            written_count += block.forces_n[:, kept_samples].shape[1]
            check_interrupt()


def _version_entries(*packages: str) -> Iterator[tuple[str, str]]:
    """Provenance entries with the versions of those packages that are installed."""
    for package_name in packages:
        with suppress(importlib.metadata.PackageNotFoundError):
            yield f"version of {package_name}", importlib.metadata.version(package_name)


def _with_independent_seed(excitation: Excitation, force_number: int) -> Excitation:
    """Excitation of force `force_number` (from 0), with a statistically independent seed for each number and seed."""
    if not force_number:
        return excitation
    (seed,) = np.random.SeedSequence([excitation.seed, force_number]).generate_state(1)
    return replace(excitation, seed=int(seed))


def _check_finite(block: Samples) -> None:
    for signal_name, signal_values in (("force", block.forces_n), *block.sensed.items(), *block.truth.items()):
        if not np.isfinite(signal_values).all():
            raise RigError(f"the simulated {signal_name} is no finite number; check the rig for values without reason")


@contextmanager
def _deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C until the yielded function is called, so that it interrupts neither a solver nor a writer."""
    signal_numbers: list[int] = []

    def raise_if_interrupted() -> None:
        if signal_numbers:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # signals reach the main thread alone
        yield raise_if_interrupted
        return
    earlier_handler = signal.signal(signal.SIGINT, lambda signal_number, _: signal_numbers.append(signal_number))
    try:
        yield raise_if_interrupted
    finally:
        signal.signal(signal.SIGINT, earlier_handler)
